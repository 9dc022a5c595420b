"""Catalogue of effects as a record, with whether each can be fitted to a robot and its poses."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import REGISTRY, Effect, effect_class, load_plug_ins
from robacc.effects.specification import every_column
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One effect of the catalogue."""

    effect: type[Effect]
    for_robot: bool
    """True if it was compared with a robot, which the following are of."""
    why: str | None = None
    """Reason if it is not available; None if it is."""
    joints: tuple[str, ...] = ()
    """Joints that it can act on."""
    coefficients: tuple[tuple[str, str], ...] = ()
    """Name and unit of each coefficient of the effect in its default form."""


def catalogue(
    name: str | None = None, robot: Robot | None = None, data: Measurements | None = None
) -> tuple[CatalogueEntry, ...]:
    """Return every effect, or the effect called ``name``, with its availability for ``robot`` and its poses if given.

    Raises:
        UsageError: there is no such effect.
    """
    load_plug_ins()
    classes = tuple(REGISTRY.values()) if name is None else (effect_class(name),)
    if robot is None:
        return tuple(CatalogueEntry(cls, False) for cls in classes)
    arm = Arm.of(robot)
    # Without poses, every column is assumed to be present.
    poses = every_column(arm) if data is None else data
    entries = []
    for cls in classes:
        joints, why = cls.possible_joints(arm), cls.missing(arm, poses)
        if why is None and cls.traits.per_joint and not joints:
            why = "no joint that it can act on"
        terms = cls.default(arm, poses).terms(arm, poses) if why is None else ()
        names = tuple((term.name, term.unit) for term in terms)
        entries.append(CatalogueEntry(cls, True, why, () if why else joints, names))
    return tuple(entries)
