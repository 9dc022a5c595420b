"""Registration of base and target before errors are judged, and the direction of gravity in a tilted frame.

Without a robot, the commanded poses of the file stand for its arm: a gantry whose joints are x, y, z and yaw, pitch,
roll of the commanded pose. Its base and its tool are then registered as those of any arm.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from robacc.effects import effect_class
from robacc.errors import InputError, Problem, RobaccError, refuse
from robacc.fitting.closed_form import gravity_turned, register_frames
from robacc.fitting.fit_result import Fit, Options, held_out_poses
from robacc.fitting.levels import DECISIVE, MANY
from robacc.fitting.parameters import FittedParameter, apply_fit, parameters
from robacc.fitting.solver import fit
from robacc.fitting.visits import random_rows
from robacc.geometry import Array, NDArray, Poses, rotation_from_rpy, rpy_from_rotation
from robacc.gravity import LEVEL
from robacc.measurements import Measurements, different
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, Robot, Vector

# Direction of gravity where the measuring frame is not level.
#
# A robot file states gravity in the measuring frame. Cameras and trackers are often not level, or have another axis
# up; registration then finds the base tilted. Either the robot leans or the measuring frame does, and the deflections
# of the arm under its own weight tell which, if the poses show them.

_PER_COMPONENT = 0.07
"""Log likelihood ratio for each measured component that decides against the robot file: errors lower by 7 %. In frames
turned by 20 and 90 degrees, arms of a physics engine reach 0.05 by errors that are not white noise, and 0.1 or more by
springs."""


def with_gravity_direction(model: Model, data: Measurements) -> Model:
    """Return the model with gravity along the base where the deflections show that the measuring frame is not level.

    Springs at all joints are fitted with the free effects, with gravity as the robot file states it in the measuring
    frame, with gravity turned as registration turned the base, and along the base's own axis. The robot file holds
    unless another direction fits better by odds of 150 to 1 and leaves errors at least 7 % smaller.

    Raises:
        InputError: There are too few poses for the free effects.
    """
    names = {effect.name for effect in model.free}
    if data.n > MANY:
        data = data.subset(random_rows(data, MANY))
    robot, frames = model.arm.robot, ("base_frame" in names, "tool_frame" in names)
    # Images do not show what is level.
    others = [] if data.is_placed_by_images else list(_other_directions(robot, register_frames(robot, data, *frames)))
    first = _with_springs(model, data, None) if others else None
    if first is None:
        return model
    # Rows that one direction leaves out as outliers and another does not would decide otherwise.
    kept = data.subset(np.flatnonzero(first.inliers))
    models = [model, *(_with_gravity(model, other) for other in others)]
    return models[_likeliest([_with_springs(each, kept, first) for each in models], kept)]


def _likeliest(fits: Sequence[Fit | None], data: Measurements) -> int:
    """Return which fit has the right gravity: the first, unless another is better by odds that decide."""
    best, stated = 0, fits[0]
    most = max(DECISIVE, _PER_COMPONENT * data.n * (3 if data.rotation is None else 6))
    for number, other in enumerate(fits[1:], 1):
        if stated is not None and other is not None:
            rows = stated.inliers & other.inliers
            before, after = (_log_likelihood(one, stated.weight * rows) for one in (stated, other))
            if (worth := after - before) >= most:
                best, most = number, worth
    return best


def _with_gravity(model: Model, gravity: Vector) -> Model:
    return dataclasses.replace(model, arm=Arm.of(dataclasses.replace(model.arm.robot, gravity=gravity)))


def _other_directions(robot: Robot, turned: Robot) -> Iterator[Vector]:
    """Yield gravity turned as registration turned the base, and downwards along the base, where they differ."""
    stated = np.array(robot.gravity)
    size = float(np.linalg.norm(stated))
    known = [stated]
    down = -size * rotation_from_rpy(np.array(turned.base.rpy))[:, 2]
    for direction in (np.array(gravity_turned(robot, turned)), down):
        if size and all(_angle(direction, other) > LEVEL for other in known):
            known.append(direction)
            yield cast(Vector, tuple(direction.tolist()))


def _angle(one: Array, other: Array) -> float:
    """Return the angle between two vectors, rad."""
    return math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other))


def _with_springs(model: Model, data: Measurements, like: Fit | None) -> Fit | None:
    """Return the fit with springs at all joints; None if the poses do not allow one.

    With the misfit of the fit ``like`` and of all rows if it is given, else with its own and without outliers.
    """
    springs = dataclasses.replace(effect_class("joint_compliance").default(model.arm, data), deflection="rigid")  # type: ignore[call-arg]
    free = (*(effect for effect in model.free if effect.name != springs.name), springs)
    options = Options() if like is None else Options(misfit=like.misfit, robust=False)
    try:
        return fit(dataclasses.replace(model, free=free), data, options)
    except RobaccError:
        return None


def _log_likelihood(one: Fit, weight: Array) -> float:
    """Return the log likelihood with relative weights, up to a constant, less the cost of negative compliances.

    Upside down, the same deflections need springs of negative compliance, which none is, if the masses are
    known. The cost is that of setting each to zero.
    """
    squares = float(np.sum(np.square(one.residual * weight)))
    compliances = {f"joint_compliance.{joint}" for joint in one.model.arm.names if one.model.arm.chain.bodies}
    values = zip(one.names, one.theta.tolist(), np.diag(one.covariance).tolist(), strict=True)
    cost = math.fsum(value**2 / var for name, value, var in values if name in compliances and value < 0.0 < var)
    return -0.5 * (float(np.count_nonzero(weight)) * math.log(max(squares, 1e-300)) + cost)


def gravity_warning(stated: Vector, shown: Vector) -> tuple[str, ...]:
    """Return that gravity is not as the robot file states it, and what to do; empty if it is."""
    if stated == shown:
        return ()
    angle = math.degrees(_angle(np.array(stated), np.array(shown)))
    numbers = ", ".join(f"{value:.3g}" for value in shown)
    return (
        f"the measuring frame is not level: the deflections of the arm show gravity {angle:.3g} degrees from the "
        f"direction in the robot file; gravity: [{numbers}] is used instead, so state it in the robot file, or level "
        "the measuring frame",
    )


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
    commanded: Poses
    """Registered commanded pose of each row; held out, that of the frames fitted to the other poses."""
    share: float = 1.0
    """Share of the measured components that the frames leave as degrees of freedom of held-out errors."""


def align(robot: Robot, data: Measurements, frames: Sequence[str], *, held_out: bool = False) -> Alignment:
    """Fit base, tool or both to the measured poses, by least squares from a closed form, from any start.

    With ``held_out``, each row is predicted with the frames fitted to the other commanded poses.

    Raises:
        UsageError: ``frames`` is empty or names anything else than ``base_frame`` and ``tool_frame``.
        InputError: too few poses, or without one of them the others do not determine a frame.
    """
    check_frames(frames)
    measured = _measured_components(data, frames) if held_out else 0
    fitted = registration_fit(robot, data, frames)
    count = int(fitted.identifiability.columns.size)

    def undetermined(rows: NDArray[np.int64]) -> None:
        place = data.place(int(rows.min()))
        message = f"the other poses do not determine the fitted frames without the pose of {place}"
        fix = "measure more poses, turned about more axes, or fit fewer frames"
        raise InputError(Problem(message, data.source, fix=fix))

    poses: Poses | None = None
    if held_out:
        (poses,) = held_out_poses(fitted, data, data.groups(), undetermined=undetermined)
    return Alignment(
        robot=apply_fit(fitted),
        effects=tuple(effect.name for effect in fitted.model.free),
        n_parameters=count,
        parameters=parameters(fitted),
        notes=(
            *(coefficient.why for coefficient in fitted.identifiability.dropped),
            *gravity_warning(robot.gravity, fitted.model.arm.robot.gravity),
        ),
        commanded=poses or fitted.poses,
        share=1.0 - count / measured if held_out else 1.0,
    )


def _measured_components(data: Measurements, frames: Sequence[str]) -> int:
    """Return the number of measured components, repetitions counted once.

    Raises:
        InputError: They are too few for the frames and for errors.
    """
    poses = data.groups()
    n_poses, n_targets = different(poses), 1 if data.target is None else np.unique(data.target).size
    size, kind = (3, "position") if data.rotation is None else (6, "pose")
    measured = size * different(data.points(poses))
    count = 6 * ("base_frame" in frames) + size * n_targets * ("tool_frame" in frames)
    if measured < count + 3:
        needed = math.ceil((count + 3) * n_poses / max(measured, 1))
        raise InputError(
            f"{n_poses} commanded {kind}{'s' * (n_poses != 1)}, {measured} numbers measured: the {count} parameters "
            f"of {' and '.join(frames)} and the errors need {count + 3}; measure at least {needed} {kind}s, "
            f"{'register base_frame alone, ' * (len(frames) > 1)}or state the frames in the robot file and omit `align`"
        )
    return measured


def registration_fit(robot: Robot, data: Measurements, frames: Sequence[str]) -> Fit:
    """Return the fit of base, tool or both to the measured poses, with gravity as the poses show it; see :func:`align`.

    Without known effects gravity has no influence.
    """
    check_frames(frames)
    model = Model.of(robot)
    model = model.with_free(*(effect_class(name).default(model.arm, data) for name in ALIGNABLE if name in frames))
    fits = [fit(model, data)]
    if model.known:
        others = _other_directions(robot, fits[0].model.arm.robot)
        fits += [fit(_with_gravity(model, other), data) for other in others]
    return fits[_likeliest(fits, data)]


def align_commands(data: Measurements, frames: Sequence[str], *, held_out: bool = False) -> Alignment:
    """Register the commanded poses of the file with the measured poses; see the top of this module.

    Raises:
        UsageError: As :func:`align`; or ``tool_frame`` is named and no orientation was commanded.
        InputError: There are too few poses.
    """
    oriented = data.commanded_rotation is not None
    refuse(
        (
            not oriented and "tool_frame" in frames,
            "tool_frame turns with the commanded orientation, which the poses do not have: add the columns cmd_qw, "
            "cmd_qx, cmd_qy, cmd_qz, or use `align` with base_frame alone",
        )
    )
    return align(_gantry(data, oriented), as_gantry(data), frames, held_out=held_out)


def as_gantry(data: Measurements) -> Measurements:
    """Return the poses with the coordinates of their commanded poses as joint variables."""
    position, rotation = data.commanded_position, data.commanded_rotation
    assert position is not None
    q = position if rotation is None else np.vstack((position, rpy_from_rotation(rotation)[::-1]))
    return dataclasses.replace(data, q=q, direction=None, speed=None)


def _gantry(data: Measurements, oriented: bool) -> Robot:
    """Return an arm whose pose at q is the commanded pose with those coordinates."""
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    origin = dict.fromkeys(ORIGIN_PARAMETERS, 0.0)
    turns = {"yaw": axes["z"], "pitch": axes["y"], "roll": axes["x"]} if oriented else {}
    joints = [Joint(f"cmd_{name}", "prismatic", origin, axis=axis) for name, axis in axes.items()]
    joints += [Joint(f"cmd_{name}", "revolute", origin, axis=axis) for name, axis in turns.items()]
    targets = {} if data.target is None else {str(name): Frame() for name in np.unique(data.target)}
    return Robot("commanded poses", "urdf", tuple(joints), targets=targets)


def check_frames(frames: Sequence[str]) -> None:
    """Raise UsageError if ``frames`` is empty or names anything else than ``base_frame`` and ``tool_frame``."""
    unknown = [name for name in frames if name not in ALIGNABLE]
    refuse(
        (unknown or not frames, f"cannot align {', '.join(unknown) or 'nothing'}; choose among {', '.join(ALIGNABLE)}")
    )
