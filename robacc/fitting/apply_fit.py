"""A fit written back into a robot: constants into its own numbers, the rest into its list of effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from robacc.effects.specification import Known, entry_of, known_effects
from robacc.fitting.solver import Fit
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


def apply_fit(fit: Fit) -> Robot:
    """The robot that predicts what the fit predicts, to rounding.

    The fitted values are near the nominal ones by construction: coefficients the poses cannot tell apart stay at zero.
    """
    values: list[dict[str, float]] = [{} for _ in fit.model.free]
    for name, owner, value in zip(fit.names, fit.owners, fit.theta, strict=True):
        values[owner][name] = float(value)
    return apply_values(fit.model, values)


def apply_values(model: Model, values: Sequence[Mapping[str, float]]) -> Robot:
    """The same for coefficients given by name, for each of the model's free effects."""
    robot = model.arm.robot
    listed = [Known(known.effect, dict(known.values)) for known in model.known]
    for effect, found in zip(model.free, values, strict=True):
        # Base and tool terms of the chain are about the robot as it stands, so each effect is folded on the last.
        arm = Arm.of(robot)
        if effect.is_constant:
            robot = effect.apply(arm, found)
            continue
        own = {name: value for name, value in found.items() if value != 0}
        same = next((i for i, known in enumerate(listed) if known.effect.key() == effect.key()), None)
        if same is not None:
            before = listed[same].values
            merged = {name: before.get(name, 0.0) + own.get(name, 0.0) for name in {**before, **own}}
            listed[same] = Known(effect, merged)
        elif own:
            listed.append(Known(effect, own))
    entries: list[Mapping[str, Any]] = [entry_of(known.effect, known.values) for known in listed]
    return dataclasses.replace(robot, effects=tuple(entries), effect_units=(1.0, 1.0))


def absorb_constants(robot: Robot) -> Robot:
    """The robot with the constant effects of its file written into its own numbers; the others stay listed, in SI.

    Raises:
        InputError: the file's ``effects:`` cannot be read.
    """
    rest = []
    for known in known_effects(robot):
        if known.effect.is_constant:
            robot = known.effect.apply(Arm.of(robot), known.values)
        else:
            rest.append(entry_of(known.effect, known.values))
    return dataclasses.replace(robot, effects=tuple(rest), effect_units=(1.0, 1.0))
