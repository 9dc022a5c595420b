"""The catalogue as a record: what each effect is, and whether a robot and its poses can show it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from robacc.effects.base import REGISTRY, About, Effect, effect_class
from robacc.effects.specification import every_column
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True)
class Offer:
    """Whether an effect can be fitted to a robot's poses."""

    why: str | None
    """Why not; None where it can."""
    joints: tuple[str, ...]
    """That it can act on."""
    coefficients: tuple[tuple[str, str], ...]
    """Name and unit of each, of the effect in its default form."""


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One effect of the catalogue."""

    name: str
    about: About
    per_joint: bool
    is_constant: bool
    offer: Offer | None
    """None where no robot is given."""


def catalogue(
    name: str | None = None, robot: Robot | None = None, data: Measurements | None = None
) -> tuple[CatalogueEntry, ...]:
    """Every effect, or the one called ``name``; judged for ``robot``, and for its poses where they are given.

    Raises:
        UsageError: there is no such effect.
    """
    classes = tuple(REGISTRY.values()) if name is None else (effect_class(name),)
    arm = None if robot is None else Arm.of(robot)
    return tuple(
        CatalogueEntry(
            cls.name, cls.about, cls.per_joint, cls.is_constant, None if arm is None else _offer(cls, arm, data)
        )
        for cls in classes
    )


def _offer(cls: type[Effect], arm: Arm, data: Measurements | None) -> Offer:
    # Without poses only what the robot lacks is judged.
    poses = every_column(arm) if data is None else data
    joints = cls.possible_joints(arm)
    why = cls.missing(arm, poses)
    if why is None and cls.per_joint and not joints:
        why = "no joint that it can act on"
    if why is not None:
        return Offer(why, (), ())
    terms = cls.default(arm, poses).terms(arm, poses)
    return Offer(None, joints, tuple((term.name, term.unit) for term in terms))


def document(entries: tuple[CatalogueEntry, ...]) -> dict[str, Any]:
    """The keys of ``robacc.effects/1``."""
    return {"effects": [_entry_document(entry) for entry in entries]}


def _entry_document(entry: CatalogueEntry) -> dict[str, Any]:
    found: dict[str, Any] = {"name": entry.name, **dataclasses.asdict(entry.about)}
    found |= {"per_joint": entry.per_joint, "is_constant": entry.is_constant}
    if entry.offer is not None:
        found |= {
            "offered": entry.offer.why is None,
            "why": entry.offer.why,
            "joints": list(entry.offer.joints),
            "coefficients": [{"name": name, "unit": unit} for name, unit in entry.offer.coefficients],
        }
    return found
