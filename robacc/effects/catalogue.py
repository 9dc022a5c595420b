"""Catalogue of effects as a record, with whether each can be fitted to a robot and its poses."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from robacc.effects.base import REGISTRY, Effect, effect_class
from robacc.effects.specification import every_column
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True)
class Availability:
    """Availability of an effect for a robot and its poses."""

    why: str | None
    """Reason if it is not available; None if it is."""
    joints: tuple[str, ...]
    """Joints that it can act on."""
    coefficients: tuple[tuple[str, str], ...]
    """Name and unit of each coefficient of the effect in its default form."""


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One effect of the catalogue."""

    effect: type[Effect]
    availability: Availability | None
    """None if no robot is given."""


def catalogue(
    name: str | None = None, robot: Robot | None = None, data: Measurements | None = None
) -> tuple[CatalogueEntry, ...]:
    """Return every effect, or the effect called ``name``, with its availability for ``robot`` and its poses if given.

    Raises:
        UsageError: there is no such effect.
    """
    classes = tuple(REGISTRY.values()) if name is None else (effect_class(name),)
    arm = None if robot is None else Arm.of(robot)
    return tuple(CatalogueEntry(cls, None if arm is None else _availability(cls, arm, data)) for cls in classes)


def _availability(cls: type[Effect], arm: Arm, data: Measurements | None) -> Availability:
    # Without poses, every column is assumed to be present.
    poses = every_column(arm) if data is None else data
    joints = cls.possible_joints(arm)
    why = cls.missing(arm, poses)
    if why is None and cls.traits.per_joint and not joints:
        why = "no joint that it can act on"
    if why is not None:
        return Availability(why, (), ())
    terms = cls.default(arm, poses).terms(arm, poses)
    return Availability(None, joints, tuple((term.name, term.unit) for term in terms))


def document(entries: tuple[CatalogueEntry, ...]) -> dict[str, Any]:
    """Return the keys of ``robacc.effects/1``."""
    return {"effects": [_entry_document(entry.effect, entry.availability) for entry in entries]}


def _entry_document(cls: type[Effect], availability: Availability | None) -> dict[str, Any]:
    record: dict[str, Any] = {"name": cls.name, **dataclasses.asdict(cls.about)}
    record |= {"per_joint": cls.traits.per_joint, "is_constant": cls.traits.is_constant}
    if availability is not None:
        record |= {
            "offered": availability.why is None,
            "why": availability.why,
            "joints": list(availability.joints),
            "coefficients": [{"name": name, "unit": unit} for name, unit in availability.coefficients],
        }
    return record
