"""Write a fit into a robot: constants into its own numbers, other effects into its list of effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from robacc.effects.specification import Known, entry_of, known_effects
from robacc.effects.validity import Validity, united
from robacc.fitting.fit_result import Fit
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


def apply_fit(fit: Fit) -> Robot:
    """Return the robot that predicts the same as the fit, to rounding.

    Coefficients that are not identifiable on the poses stay at their nominal value.
    """
    values: list[dict[str, float]] = [{} for _ in fit.model.free]
    for name, owner, value in zip(fit.names, fit.owners, fit.theta, strict=True):
        values[owner][name] = float(value)
    return apply_values(fit.model, values, fit.validity)


def apply_values(
    model: Model, values: Sequence[Mapping[str, float]], validity: Sequence[Validity] | None = None
) -> Robot:
    """Return the robot with coefficients given by name, for each of the model's free effects.

    ``validity`` holds the ranges that each effect was fitted on, if known.
    """
    limits = validity if validity is not None else ({},) * len(model.free)
    constant = [Known(effect, v) for effect, v in zip(model.free, values, strict=True) if effect.is_constant]
    classes = {type(known.effect) for known in constant}
    # Listed constants that add to fitted ones are absorbed with them: turns of one frame do not commute.
    constant += [known for known in model.known if type(known.effect) in classes]
    robot = _with_constants(model.arm.robot, constant)
    listed = [known for known in model.known if type(known.effect) not in classes]
    for effect, coefficients, limit in zip(model.free, values, limits, strict=True):
        if effect.is_constant:
            continue
        nonzero = {name: value for name, value in coefficients.items() if value != 0}
        place = next((i for i, known in enumerate(listed) if known.effect.key() == effect.key()), None)
        if place is not None:
            before = listed[place].values
            sums = {name: before.get(name, 0.0) + nonzero.get(name, 0.0) for name in {**before, **nonzero}}
            listed[place] = Known(effect, sums, united(listed[place].validity, limit))
        elif nonzero:
            listed.append(Known(effect, nonzero, limit))
    entries: list[Mapping[str, Any]] = [entry_of(known.effect, known.values, known.validity) for known in listed]
    return dataclasses.replace(robot, effects=tuple(entries), effect_units=(1.0, 1.0))


def absorb_constants(robot: Robot) -> Robot:
    """Return the robot with the constant effects of its file in its own numbers; other effects stay listed, in SI.

    Raises:
        InputError: the file's ``effects:`` cannot be read.
    """
    known = known_effects(robot)
    entries = [entry_of(k.effect, k.values, k.validity) for k in known if not k.effect.is_constant]
    robot = _with_constants(robot, [k for k in known if k.effect.is_constant])
    return dataclasses.replace(robot, effects=tuple(entries), effect_units=(1.0, 1.0))


def _with_constants(robot: Robot, constants: Sequence[Known]) -> Robot:
    """Return the robot with constants written into its numbers: all of one class at once, as the chain adds them."""
    classes = dict.fromkeys(type(known.effect) for known in constants)
    for cls in classes:
        of_class = [known for known in constants if type(known.effect) is cls]
        sums: dict[str, float] = {}
        for known in of_class:
            for name, value in known.values.items():
                sums[name] = sums.get(name, 0.0) + value
        robot = cls.covering([known.effect for known in of_class]).apply(Arm.of(robot), sums)
    return robot
