"""Reader and writer of the effects that a robot file lists, in its units."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect, Term, effect_class
from robacc.effects.beyond_range import limits_of
from robacc.effects.drivers import Periods, Validity, is_outside, read_validity
from robacc.errors import InputError, Problem, UsageError
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot, effect_key

_COMMON_KEYS = ("effect", "joints", "values", "validity")
"""Keys of an entry that are no setting of its effect."""
_MAX_NAMES = 12
"""Coefficients that a message lists."""


_NO_POSES = Measurements(position=np.zeros((3, 0)))


@dataclass(frozen=True)
class Known:
    """An effect with the values of its coefficients, by full name, SI."""

    effect: Effect
    values: Mapping[str, float]
    validity: Validity = field(default_factory=dict)
    """Range of each driver over the poses that the values were fitted to; empty if unknown."""

    def is_held_at(self, arm: Arm, data: Measurements) -> NDArray[np.bool_]:
        """Return ``(N,)`` the mask of poses where a driver of the effect is held at the end of its range."""
        return is_outside(arm, data, *self.held_limits(arm))

    def held_limits(self, arm: Arm) -> tuple[Validity, Periods]:
        """Return the ranges of the drivers that the effect does not extrapolate, and their periods."""
        return limits_of(self.effect, arm, self.validity)

    def fading_limits(self, arm: Arm) -> tuple[Validity, Periods]:
        """Return the ranges of the drivers beyond which the effect fades, and their periods."""
        return limits_of(self.effect, arm, self.validity, fading=True)


def known_effects(robot: Robot) -> tuple[Known, ...]:
    """Return the effects that a robot file lists, in SI.

    An entry is ``{effect: backlash, joints: [j2], values: {j2: 1e-4}, …settings}``; a value's key is its name without
    the effect's, or ``value`` for an effect of a single coefficient. Values are in the file's units: a leading rad or m
    of the coefficient's unit is the file's unit of angle or length; what it is divided by is SI.

    Raises:
        InputError: an entry cannot be read, or has a value of a coefficient that does not exist, which would otherwise
            silently do nothing; every problem at once.
    """
    if not robot.effects:
        return ()
    arm = Arm.of(robot)
    known: list[Known] = []
    problems: list[Problem] = []
    first: dict[tuple[Any, ...], str] = {}
    for i, entry in enumerate(robot.effects):
        key = effect_key(i)
        try:
            known_effect = _read(arm, entry)
        except (ValueError, TypeError, UsageError) as error:
            problems.append(Problem(str(error), column=key))
            continue
        known.append(known_effect)
        if (earlier := first.setdefault(known_effect.effect.key(), key)) != key:
            message = f"repeats {known_effect.effect} of {earlier}; their values would add up"
            problems.append(Problem(message, column=key, fix="give one entry with the sum of the values"))
    if problems:
        raise InputError(problems)
    return tuple(known)


def coefficients(robot: Robot) -> tuple[tuple[str, float, str], ...]:
    """Return name, value and unit of each coefficient that a robot file's effects give a value for; SI.

    Raises:
        InputError: see :func:`known_effects`.
    """
    arm = Arm.of(robot)
    return tuple(
        (term.name, known.values[term.name], term.unit)
        for known in known_effects(robot)
        for term in known.effect.terms(arm, every_column(arm))
        if term.name in known.values
    )


def _read(arm: Arm, entry: Mapping[str, Any]) -> Known:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("effect"), str):
        raise ValueError(f"expected a mapping with the key effect, found {entry!r}")
    cls = effect_class(entry["effect"])
    settings = {key: value for key, value in entry.items() if key not in _COMMON_KEYS}
    effect = cls.from_settings(_joints(cls, arm, entry.get("joints", [])), settings)
    effect = effect.from_units(arm, *arm.robot.effect_units)
    terms = {term.name: term for term in effect.terms(arm, every_column(arm))}
    if "values" not in entry:
        raise ValueError(f"{effect} has no values, so it would do nothing; write values: {{name: number}}")
    entry_values = entry["values"]
    if not isinstance(entry_values, Mapping):
        raise ValueError(f"values must be a mapping of name to number, found {entry_values!r}")
    values = {}
    for key, value in entry_values.items():
        name = cls.name if key == "value" else f"{cls.name}.{key}"
        if name not in terms:
            names = [short_name(effect, term) for term in terms]
            more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
            raise ValueError(f"{effect} has no coefficient {key!r}; it has {', '.join(names[:_MAX_NAMES])}{more}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"values.{key} must be a finite number, found {value!r}")
        values[name] = value * unit_size(terms[name], *arm.robot.effect_units)
        if terms[name].unit == "rad" and abs(values[name]) > 2 * math.pi:
            raise ValueError(f"values.{key} is more than a turn; expected a small angle, found {value:g}")
    if "validity" not in entry:
        return Known(effect, values, effect.validity(arm, _NO_POSES))
    drivers = effect.validity_drivers(arm)
    return Known(effect, values, read_validity(arm, drivers, entry["validity"], *arm.robot.effect_units))


def _joints(cls: type[Effect], arm: Arm, joints: Any) -> tuple[str, ...]:
    """Return the entry's joints, checked."""
    if not cls.traits.per_joint:
        if joints:
            raise ValueError(f"{cls.name} acts on no joint in particular; leave joints out")
        return ()
    if not isinstance(joints, list | tuple) or any(joint not in arm.names for joint in joints):
        raise ValueError(f"joints must be a list of {', '.join(arm.names)}; found {joints!r}")
    possible = cls.possible_joints(arm)
    if not joints and cls.traits.joints_optional:
        return ()
    if not joints or len(set(joints)) < len(joints):
        raise ValueError(f"{cls.name} needs joints, each once: some of {', '.join(possible)}; found {list(joints)!r}")
    for joint in joints:
        if joint not in possible:
            raise ValueError(f"{cls.name} cannot act on {joint}; it can on {', '.join(possible)}")
    return tuple(joints)


def every_column(arm: Arm) -> Measurements:
    """Return two poses with every column, each varying: an effect that is still missing lacks a part of the robot.

    Names and units of coefficients do not depend on the poses, so these poses give them too.
    """
    varying = np.array([0.0, 1.0])
    joints = np.tile(varying, (len(arm.names), 1))
    return Measurements(
        position=np.zeros((3, 2)),
        q=joints,
        target=np.repeat(list(arm.robot.targets)[:1], 2) if arm.robot.targets else None,
        time=varying,
        temperature=varying,
        payload=varying,
        direction=2 * joints - 1,
        speed=joints,
        read_back=joints + 1e-3 * varying,
    )


def unit_size(term: Term, length: float, angle: float) -> float:
    """Return the size of a value of a coefficient in a file with units of ``length`` m and ``angle`` rad."""
    leading = term.unit.split("/")[0].split()[0]
    return {"rad": angle, "m": length}.get(leading, 1.0)


def short_name(effect: Effect, name: str) -> str:
    """Return the key of a coefficient in a robot file's ``values``: its name without the effect's."""
    return "value" if name == effect.name else name.removeprefix(f"{effect.name}.")


def entry_of(effect: Effect, values: Mapping[str, float], validity: Validity | None = None) -> dict[str, Any]:
    """Return the entry of a robot file for an effect with values, and the ranges of its drivers if they are known."""
    entry: dict[str, Any] = {"effect": effect.name}
    if effect.joints:
        entry["joints"] = list(effect.joints)
    short = {short_name(effect, name): value for name, value in values.items()}
    entry = {**entry, **effect.settings(), "values": short}
    return {**entry, "validity": {name: list(pair) for name, pair in validity.items()}} if validity else entry


# Entries of a robot file's effects in other units of length and angle.


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
    units = {name: {"rad": angle, "m": length}[arm.unit(name)] for name in stated.validity if name in arm.names}
    validity = {
        name: (low / units.get(name, 1.0), high / units.get(name, 1.0)) for name, (low, high) in stated.validity.items()
    }
    return entry_of(effect, values, validity)
