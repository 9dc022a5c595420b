"""Registering the instrument's frame and the target before errors are judged: closed form, then least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from robacc.effects import effect_class
from robacc.errors import UsageError
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.parameters import FittedParameter, parameters
from robacc.fitting.solver import Options, fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

ALIGNABLE = ("base_frame", "tool_frame")


@dataclass(frozen=True, slots=True)
class Alignment:
    """What was aligned, and how."""

    robot: Robot
    effects: tuple[str, ...]
    n_parameters: int
    """Numbers that were fitted: those the poses show."""
    parameters: tuple[FittedParameter, ...]
    """Of the frames found: x, y, z (m), roll, pitch, yaw (rad)."""
    notes: tuple[str, ...]
    """What the poses could not show, in words."""


def align(robot: Robot, data: Measurements, what: Sequence[str]) -> Alignment:
    """Fit base, tool or both to the measured poses, by least squares from a closed form, from any start.

    Raises:
        UsageError: something else than ``base_frame`` and ``tool_frame`` is named.
        InputError: too few poses.
    """
    unknown = [name for name in what if name not in ALIGNABLE]
    if unknown or not what:
        raise UsageError(f"cannot align {', '.join(unknown) or 'nothing'}; choose among {', '.join(ALIGNABLE)}")
    effects = tuple(name for name in ALIGNABLE if name in what)
    arm = Arm.of(robot)
    found = fit(Model.of(robot, [effect_class(name).default(arm, data) for name in effects]), data, Options())
    notes = tuple(dropped.why for dropped in found.dropped)
    return Alignment(apply_fit(found), effects, int(found.identifiability.kept.size), parameters(found), notes)
