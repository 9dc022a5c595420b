"""Registration of the instrument's frame and the target before errors are judged: closed form, then least squares."""

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
    """A registered robot, and its fitted frames."""

    robot: Robot
    effects: tuple[str, ...]
    n_parameters: int
    """Identifiable coefficients."""
    parameters: tuple[FittedParameter, ...]
    """Coordinates of the fitted frames: x, y, z (m), roll, pitch, yaw (rad)."""
    notes: tuple[str, ...]
    """Coefficients that are not identifiable on the poses, one sentence each."""


def align(robot: Robot, data: Measurements, frames: Sequence[str]) -> Alignment:
    """Fit base, tool or both to the measured poses, by least squares from a closed form, from any start.

    Raises:
        UsageError: ``frames`` is empty or names anything else than ``base_frame`` and ``tool_frame``.
        InputError: too few poses.
    """
    unknown = [name for name in frames if name not in ALIGNABLE]
    if unknown or not frames:
        raise UsageError(f"cannot align {', '.join(unknown) or 'nothing'}; choose among {', '.join(ALIGNABLE)}")
    effects = tuple(name for name in ALIGNABLE if name in frames)
    arm = Arm.of(robot)
    fitted = fit(Model.of(robot, [effect_class(name).default(arm, data) for name in effects]), data, Options())
    notes = tuple(dropped.why for dropped in fitted.dropped)
    return Alignment(apply_fit(fitted), effects, int(fitted.identifiability.columns.size), parameters(fitted), notes)
