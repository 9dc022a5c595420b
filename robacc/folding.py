"""A fit written back into a robot: constants into its own numbers, the rest into its list of effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from robacc.effects.base import Effect
from robacc.effects.specification import Known, entry_of
from robacc.fitting import Fit
from robacc.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


def fold(fit: Fit) -> Robot:
    """The robot that predicts what the fit predicts, to rounding.

    The fitted values are near the nominal ones by construction: coefficients the poses cannot tell apart stay at zero.
    """
    values = {name: float(value) for name, value in zip(fit.names, fit.theta, strict=True)}
    return fold_values(fit.model, values)


def fold_values(model: Model, values: Mapping[str, float]) -> Robot:
    """The same for coefficients given by name."""
    robot = model.arm.robot
    listed = [Known(known.effect, dict(known.values)) for known in model.known]
    for effect in model.free:
        # Base and tool terms of the chain are about the robot as it stands, so each effect is folded on the last.
        arm = Arm.of(robot)
        if effect.is_constant:
            robot = effect.apply(arm, values)
            continue
        own = {name: value for name, value in values.items() if _belongs(name, effect) and value != 0}
        same = next((i for i, known in enumerate(listed) if known.effect.key() == effect.key()), None)
        if same is not None:
            before = listed[same].values
            merged = {name: before.get(name, 0.0) + own.get(name, 0.0) for name in {**before, **own}}
            listed[same] = Known(effect, merged)
        elif own:
            listed.append(Known(effect, own))
    entries: list[Mapping[str, Any]] = [entry_of(known.effect, known.values) for known in listed]
    return dataclasses.replace(robot, effects=tuple(entries), effect_units=(1.0, 1.0))


def _belongs(name: str, effect: Effect) -> bool:
    if name == effect.name:
        return True
    prefix = f"{effect.name}."
    if not name.startswith(prefix):
        return False
    return not effect.joints or any(
        name == prefix + joint or name.startswith(f"{prefix}{joint}.") for joint in effect.joints
    )
