"""Registration of the instrument's frame and the target before errors are judged: closed form, then least squares.

Without a robot, the commanded poses of the file stand for its arm: a gantry whose joints are x, y, z and yaw, pitch,
roll of the commanded pose. Its base and its tool are then registered as those of any arm.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects import effect_class
from robacc.errors import InputError, Problem, UsageError
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.fit_result import Fit
from robacc.fitting.gravity_direction import fit_frames, gravity_warning
from robacc.fitting.held_out import held_out_poses
from robacc.fitting.parameters import FittedParameter, parameters
from robacc.geometry import Poses, rpy_from_rotation
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.poses.motion import numbered
from robacc.robots.arm import Arm
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, Robot

ALIGNABLE = ("base_frame", "tool_frame")
_LEAST_LEFT = 3
"""Degrees of freedom that held-out errors need: one for each axis."""


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
    commanded: Poses
    """Registered commanded pose of each row; held out, that of the frames fitted to the other poses."""
    share: float = 1.0
    """Share of the measured components that the frames leave as degrees of freedom of held-out errors."""


def align(robot: Robot, data: Measurements, frames: Sequence[str], *, held_out: bool = False) -> Alignment:
    """Fit base, tool or both to the measured poses, by least squares from a closed form, from any start.

    With ``held_out``, each row is predicted with the frames fitted to the other commanded poses.

    Raises:
        UsageError: ``frames`` is empty or names anything else than ``base_frame`` and ``tool_frame``.
        InputError: too few poses.
    """
    check_frames(frames)
    measured = _measured_components(data, frames) if held_out else 0
    fitted = registration_fit(robot, data, frames)
    poses = _held_out(fitted, data) if held_out else fitted.poses
    effects = tuple(effect.name for effect in fitted.model.free)
    dropped = (coefficient.why for coefficient in fitted.dropped)
    notes = (*dropped, *gravity_warning(robot.gravity, fitted.model.arm.robot.gravity))
    count = int(fitted.identifiability.columns.size)
    share = 1.0 - count / measured if held_out else 1.0
    return Alignment(apply_fit(fitted), effects, count, parameters(fitted), notes, poses, share)


def _held_out(fitted: Fit, data: Measurements) -> Poses:
    """Return each row as the frames that were fitted to the other commanded poses predict it.

    Raises:
        InputError: The other poses do not determine a frame.
    """

    def undetermined(rows: NDArray[np.int64]) -> None:
        place = data.place(int(rows.min()))
        message = f"the other poses do not determine the fitted frames without the pose of {place}"
        fix = "measure more poses, turned about more axes, or fit fewer frames"
        raise InputError(Problem(message, data.source, fix=fix))

    repetitions = data.repetitions()
    groups = np.arange(data.n) if repetitions is None else repetitions.numbers
    (poses,) = held_out_poses(fitted, data, groups, undetermined=undetermined)
    assert poses is not None
    return poses


def _measured_components(data: Measurements, frames: Sequence[str]) -> int:
    """Return the number of measured components, repetitions counted once.

    Raises:
        InputError: They are too few for the frames and for errors.
    """
    repetitions = data.repetitions()
    poses = np.arange(data.n) if repetitions is None else repetitions.numbers
    points = poses if data.target is None else numbered(poses, data.target)
    n_poses, n_targets = np.unique(poses).size, 1 if data.target is None else np.unique(data.target).size
    size, kind = (3, "position") if data.rotation is None else (6, "pose")
    measured = size * np.unique(points).size
    count = 6 * ("base_frame" in frames) + size * n_targets * ("tool_frame" in frames)
    if measured < count + _LEAST_LEFT:
        needed = math.ceil((count + _LEAST_LEFT) * n_poses / max(measured, 1))
        raise InputError(
            f"{n_poses} commanded {kind}{'s' * (n_poses != 1)}, {measured} numbers measured: the {count} parameters "
            f"of {' and '.join(frames)} and the errors need {count + _LEAST_LEFT}; measure at least {needed} {kind}s, "
            f"{'register base_frame alone, ' * (len(frames) > 1)}or state the frames in the robot file and omit `align`"
        )
    return measured


def registration_fit(robot: Robot, data: Measurements, frames: Sequence[str]) -> Fit:
    """Return the fit of base, tool or both to the measured poses; see :func:`align`."""
    check_frames(frames)
    arm = Arm.of(robot)
    effects = [effect_class(name).default(arm, data) for name in ALIGNABLE if name in frames]
    return fit_frames(Model.of(robot, effects), data)


def align_commands(data: Measurements, frames: Sequence[str], *, held_out: bool = False) -> Alignment:
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
    return align(_gantry(data, oriented=rotation is not None), moves, frames, held_out=held_out)


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
