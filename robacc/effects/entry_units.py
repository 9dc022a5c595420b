"""Entries of a robot file's effects in other units of length and angle."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from robacc.effects.specification import Known, entry_of, every_column, known_effects, unit_size
from robacc.effects.validity import driver_unit
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


def with_effect_units(robot: Robot, length: float = 1.0, angle: float = 1.0) -> Robot:
    """Return the robot with the entries of its effects in units of ``length`` m and ``angle`` rad.

    Raises:
        InputError: Its effects cannot be read.
    """
    campaign = robot.campaign
    if robot.effect_units == (length, angle):
        return robot
    if not (robot.effects or (campaign and campaign.effects)):
        return dataclasses.replace(robot, effect_units=(length, angle))
    arm = Arm.of(robot)

    def converted(effects: Sequence[Mapping[str, Any]]) -> tuple[Mapping[str, Any], ...]:
        stated = known_effects(dataclasses.replace(robot, effects=tuple(effects)))
        return tuple(_entry(arm, entry, length, angle) for entry in stated)

    if campaign is not None:
        campaign = dataclasses.replace(campaign, effects=converted(campaign.effects))
    return dataclasses.replace(robot, effects=converted(robot.effects), effect_units=(length, angle), campaign=campaign)


def _entry(arm: Arm, stated: Known, length: float, angle: float) -> dict[str, Any]:
    """Return the entry of an effect, whose values are in SI, in units of ``length`` m and ``angle`` rad."""
    effect = stated.effect.from_units(arm, 1 / length, 1 / angle)
    sizes = {term.name: unit_size(term, length, angle) for term in stated.effect.terms(arm, every_column(arm))}
    values = {name: value / sizes[name] for name, value in stated.values.items()}
    validity = {}
    for name, (low, high) in stated.validity.items():
        unit = driver_unit(arm, name) if name in arm.names else ""
        size = {"rad": angle, "m": length}.get(unit, 1.0)
        validity[name] = (low / size, high / size)
    return entry_of(effect, values, validity)
