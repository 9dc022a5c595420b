"""Effects as a robot file lists them: read into effects with values, and written back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robacc.effects.base import REGISTRY, Effect, effect_class
from robacc.errors import InputError, Problem, UsageError
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


@dataclass(frozen=True)
class Known:
    """An effect with the values of its coefficients, by full name, SI."""

    effect: Effect
    values: Mapping[str, float]


def known_effects(robot: Robot) -> tuple[Known, ...]:
    """The effects that a robot file lists.

    An entry is ``{effect: backlash, joints: [j2], values: {j2: 1e-4}, …settings}``; a value's key is its name without
    the effect's, or ``value`` for an effect of a single coefficient.

    Raises:
        InputError: an entry cannot be read; every problem at once.
    """
    known, problems = [], []
    for i, entry in enumerate(robot.effects):
        try:
            known.append(_read(robot, entry))
        except (ValueError, TypeError, UsageError) as error:
            problems.append(Problem(str(error), column=f"effects[{i}]"))
    if problems:
        raise InputError(problems)
    return tuple(known)


def _read(robot: Robot, entry: Mapping[str, Any]) -> Known:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("effect"), str):
        raise ValueError(f"expected a mapping with the key effect, found {entry!r}")
    cls = effect_class(entry["effect"])
    names = robot.variable_names
    joints = entry.get("joints", [])
    if not isinstance(joints, list | tuple) or any(joint not in names for joint in joints):
        raise ValueError(f"joints must be a list of {', '.join(names)}; found {joints!r}")
    settings = {key: value for key, value in entry.items() if key not in ("effect", "joints", "values")}
    effect = cls.from_settings(tuple(joints), settings)
    raw = entry.get("values", {})
    if not isinstance(raw, Mapping):
        raise ValueError(f"values must be a mapping of name to number, found {raw!r}")
    values = {}
    for key, value in raw.items():
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or value != value
            or abs(value) == float("inf")
        ):
            raise ValueError(f"values.{key} must be a finite number, found {value!r}")
        values[cls.name if key == "value" else f"{cls.name}.{key}"] = float(value)
    return Known(effect, values)


def check_values(model_known: Sequence[Known], arm: Arm, data: Measurements) -> None:
    """Refuse values whose coefficient does not exist, which would otherwise silently do nothing.

    Raises:
        InputError: naming each, and the coefficients there are.
    """
    problems = []
    for i, known in enumerate(model_known):
        names = {term.name for term in known.effect.terms(arm, data)}
        for name in known.values:
            if name not in names:
                there = ", ".join(sorted(one.removeprefix(f"{known.effect.name}.") for one in names)[:12])
                problems.append(
                    Problem(f"{known.effect} has no coefficient {name}; it has {there}", column=f"effects[{i}]")
                )
    if problems:
        raise InputError(problems)


def entry_of(effect: Effect, values: Mapping[str, float]) -> dict[str, Any]:
    """The entry of a robot file for an effect with values."""
    prefix = f"{effect.name}."
    short = {"value" if name == effect.name else name.removeprefix(prefix): value for name, value in values.items()}
    entry: dict[str, Any] = {"effect": effect.name}
    if effect.joints:
        entry["joints"] = list(effect.joints)
    return {**entry, **effect.settings(), "values": short}


def catalogue_order(effect: Effect) -> int:
    """Place of an effect in the catalogue: what comes first keeps its parameters where poses cannot tell two apart."""
    return list(REGISTRY).index(effect.name)
