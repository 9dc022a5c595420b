"""Registration of the instrument's frame and the target before errors are judged: closed form, then least squares.

Without a robot, the commanded poses of the file stand for its arm: a gantry whose joints are x, y, z and yaw, pitch,
roll of the commanded pose. Its base and its tool are then registered as those of any arm.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects import effect_class
from robacc.errors import UsageError
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.fit_result import Fit
from robacc.fitting.gravity_direction import fit_frames, gravity_warning
from robacc.fitting.parameters import FittedParameter, parameters
from robacc.geometry import Poses, rpy_from_rotation
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, Robot

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
    """Coefficients that are not identifiable on the poses, and gravity if the measuring frame is not level."""
    commanded: Poses | None = None
    """Registered commanded poses, where these are columns of the file; None where the robot predicts them."""


def align(robot: Robot, data: Measurements, frames: Sequence[str]) -> Alignment:
    """Fit base, tool or both to the measured poses, by least squares from a closed form, from any start.

    Raises:
        UsageError: ``frames`` is empty or names anything else than ``base_frame`` and ``tool_frame``.
        InputError: too few poses.
    """
    fitted = registration_fit(robot, data, frames)
    effects = tuple(effect.name for effect in fitted.model.free)
    dropped = (coefficient.why for coefficient in fitted.dropped)
    notes = (*dropped, *gravity_warning(robot.gravity, fitted.model.arm.robot.gravity))
    return Alignment(apply_fit(fitted), effects, int(fitted.identifiability.columns.size), parameters(fitted), notes)


def registration_fit(robot: Robot, data: Measurements, frames: Sequence[str]) -> Fit:
    """Return the fit of base, tool or both to the measured poses; see :func:`align`."""
    check_frames(frames)
    arm = Arm.of(robot)
    effects = [effect_class(name).default(arm, data) for name in ALIGNABLE if name in frames]
    return fit_frames(Model.of(robot, effects), data)


def align_commands(data: Measurements, frames: Sequence[str]) -> Alignment:
    """Register the commanded poses of the file with the measured poses; see the top of this module.

    Raises:
        UsageError: As :func:`align`; or ``tool_frame`` is named and no orientation was commanded.
        InputError: There are too few poses.
    """
    check_frames(frames)
    position, rotation = data.commanded_position, data.commanded_rotation
    assert position is not None
    if rotation is None and "tool_frame" in frames:
        raise UsageError(
            "tool_frame turns with the commanded orientation, which the poses do not have: add the columns cmd_qw, "
            "cmd_qx, cmd_qy, cmd_qz, or use `align` with base_frame alone"
        )
    q = position if rotation is None else np.vstack((position, rpy_from_rotation(rotation)[::-1]))
    moves = dataclasses.replace(data, q=q, direction=None, speed=None)
    alignment = align(_gantry(data, oriented=rotation is not None), moves, frames)
    poses = predict(alignment.robot, moves)
    return dataclasses.replace(alignment, commanded=poses)


def _gantry(data: Measurements, oriented: bool) -> Robot:
    """Return an arm whose pose at q is the commanded pose with those coordinates."""
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    joints = [
        Joint(f"cmd_{name}", "prismatic", dict.fromkeys(ORIGIN_PARAMETERS, 0.0), axis=axes[name]) for name in axes
    ]
    if oriented:
        joints += [
            Joint(f"cmd_{name}", "revolute", dict.fromkeys(ORIGIN_PARAMETERS, 0.0), axis=axes[axis])
            for name, axis in (("yaw", "z"), ("pitch", "y"), ("roll", "x"))
        ]
    targets = {} if data.target is None else {str(name): Frame() for name in np.unique(data.target)}
    return Robot("commanded poses", "urdf", tuple(joints), targets=targets)


def check_frames(frames: Sequence[str]) -> None:
    """Raise UsageError if ``frames`` is empty or names anything else than ``base_frame`` and ``tool_frame``."""
    unknown = [name for name in frames if name not in ALIGNABLE]
    if unknown or not frames:
        raise UsageError(f"cannot align {', '.join(unknown) or 'nothing'}; choose among {', '.join(ALIGNABLE)}")
