"""Wanted poses of targets and their circumstances, on the model and the nominal robot in common frames."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.correction.solving import Evaluate, JointSpace, solve
from robacc.effects.base import Effect, Part, Term
from robacc.errors import InputError, Problem
from robacc.fitting.parameters import absorb_constants
from robacc.geometry import Array, Poses, compose, log_so3, rms_length, transpose
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.poses.motion import motion_between_visits, visits_in_order
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.robots.inverse_kinematics import inverse_kinematics, joint_ranges

# Circumstances of targets other than the joints: from columns, from the order of the targets, and from options.


@dataclass(frozen=True, slots=True)
class Circumstances:
    """Columns of the targets without their joints, and the source of direction and speed."""

    columns: Measurements
    """Targets; time, temperature and payload are complete as far as they are known."""
    follows_order: bool
    """Direction and speed of approach follow from the moves between the targets, in their order."""
    visits: NDArray[np.int64]
    """``(N,)`` number of the arrival that each row belongs to: rows of several measured targets share one."""

    def motion(self, q: Array) -> tuple[Array | None, Array | None]:
        """Return direction and speed of approach ``(J, N)`` of commands ``q`` in their order; None where unknown."""
        if not self.follows_order:
            return self.columns.direction, self.columns.speed
        direction, speed = motion_between_visits(q, self.visits)
        return (
            direction if self.columns.direction is None else self.columns.direction,
            speed if self.columns.speed is None else self.columns.speed,
        )

    def at(self, q: Array, motion: tuple[Array | None, Array | None], index: NDArray[np.int64]) -> Measurements:
        """Return the poses of the targets ``index`` at commands ``q`` ``(J, M)``, with their circumstances."""
        direction, speed = (None if part is None else part[:, index] for part in motion)
        return dataclasses.replace(
            self.columns.subset(index), position=np.zeros((3, index.size)), q=q, direction=direction, speed=speed
        )


def circumstances(
    data: Measurements,
    *,
    ordered: bool = True,
    payload: float | None = None,
    temperature: float | None = None,
    time: float | None = None,
) -> Circumstances:
    """Return the circumstances of targets; a column of the file has precedence over a constant."""

    def filled(column: Array | None, value: float | None) -> Array | None:
        return column if column is not None or value is None else np.full(data.n, float(value))

    columns = Measurements(
        position=np.zeros((3, data.n)),
        target=data.target,
        payload_group=data.payload_group,
        branches=data.branches,
        branch_names=data.branch_names,
        direction=data.direction,
        speed=data.speed,
        rows=data.rows,
        payload=filled(data.payload, payload),
        temperature=filled(data.temperature, temperature),
        time=filled(data.time, time),
    )
    visits = visits_in_order(data.groups(), data.visit, data.cycle, data.target)
    return Circumstances(columns, ordered, visits)


# Model and nominal robot of a correction, in common frames.

FrameName = Literal["measuring", "base"]


@dataclass(frozen=True, slots=True)
class RobotPair:
    """Real arm as the model describes it, and the arm that the controller computes with, in the same frames."""

    model: Model
    """Effects of the arm; those of the measurement are left out."""
    nominal: Arm
    frame: FrameName
    left_out: tuple[Effect, ...]
    """Effects of the measurement in the model file, which no command can correct."""

    @property
    def base(self) -> Poses:
        """Pose of the robot's base in the measuring frame."""
        return self.model.arm.robot.base.pose

    def to_measuring(self, poses: Poses) -> Poses:
        """Return Cartesian targets in the measuring frame."""
        return poses if self.frame == "measuring" else self.base @ poses

    def from_measuring(self, poses: Poses) -> Poses:
        """Return poses of the measuring frame in the frame of the Cartesian targets."""
        return poses if self.frame == "measuring" else self.base.inverse() @ poses


def robot_pair(model: Robot, nominal: Robot, frame: FrameName) -> RobotPair:
    """Return model and nominal robot in common frames.

    The nominal robot stands where the model stands, because a controller knows no measuring frame. With ``frame``
    ``measuring``, both carry the model's tool, the measured target; with ``base``, both carry the nominal tool, with
    which the controller works.

    Raises:
        InputError: The two robots have different joints, or their effects cannot be read.
    """
    model = absorb_constants(model)
    nominal = dataclasses.replace(nominal, effects=(), effect_units=(1.0, 1.0))
    check_same_joints(model, nominal)
    if frame == "base":
        com = Arm.of(model).payload_com
        model = dataclasses.replace(model, tool=nominal.tool, targets=nominal.targets, payload_com=com)
    nominal = dataclasses.replace(nominal, base=model.base, tool=model.tool, targets=model.targets)
    full = Model.of(model)
    known = tuple(entry for entry in full.known if not entry.effect.traits.is_of_measurement)
    left_out = tuple(entry.effect for entry in full.known if entry.effect.traits.is_of_measurement)
    return RobotPair(dataclasses.replace(full, known=known), Arm.of(nominal), frame, left_out)


def check_same_joints(model: Robot, nominal: Robot) -> None:
    """Raise InputError unless both robots have the same joint variables."""
    pairs = [[(joint.name, joint.type) for joint in robot.variables] for robot in (model, nominal)]
    if [kind for _, kind in pairs[0]] != [kind for _, kind in pairs[1]]:
        texts = [", ".join(f"{name} ({kind})" for name, kind in pair) for pair in pairs]
        message = f"the model has the joints {texts[0]}, the nominal robot has {texts[1]}"
        raise InputError(Problem(message, nominal.name, fix="give the robot file that the model was fitted from"))


def arm_length(arm: Arm, q: Array) -> float:
    """Return the size of the arm, m: RMS distance of its target from its base at joints ``q`` ``(J, N)``."""
    poses = arm.chain.forward(q)
    base = np.array(arm.robot.base.xyz)[:, None]
    return max(rms_length(poses.translation - base), 1e-3)


Given = Literal["joints", "poses", "poses and joints"]

_REACHED = 1e-7
"""m and rad: error at which the nominal robot reaches a Cartesian target."""
_BLOCK = 256
"""Cartesian targets without joints whose configurations are searched at a time."""


@dataclass(frozen=True, slots=True)
class WantedPoses:
    """Wanted poses, and nominal joints that keep the commanded configuration."""

    given: Given
    poses: Poses
    """``(N)`` wanted poses of the target in the measuring frame; rotations are nominal if none were given."""
    oriented: bool
    """The orientation is wanted too, not only the position."""
    q: Array
    """``(J, N)`` nominal joints, rad or m."""
    reached: NDArray[np.bool_]
    """``(N,)`` whether the nominal robot reaches the wanted pose."""


def joint_space(pair: RobotPair, q: Array) -> JointSpace:
    """Return limits and scales of the joints; a slide counts in lengths of the arm at joints ``q`` ``(J, N)``."""
    variables = pair.model.arm.robot.variables
    low, high = np.array([joint.limits or (-np.inf, np.inf) for joint in variables]).T
    length = arm_length(pair.nominal, q)
    scale = np.array([1.0 if joint.type == "revolute" else length for joint in variables])
    return JointSpace(low, high, scale)


def wanted_poses(data: Measurements, pair: RobotPair, setting: Circumstances) -> WantedPoses:
    """Return the wanted poses of targets.

    Joints mean the pose that the nominal robot has there. Commanded poses (``cmd_`` columns) are wanted as they are,
    and joints beside them only choose the configuration. Without either, ``x, y, z`` are the wanted poses.

    Raises:
        InputError: The targets have neither joints nor poses.
    """
    position, rotation = data.commanded_position, data.commanded_rotation
    if position is None and data.q is not None:
        poses = nominal_poses(pair, setting, data.q)
        return WantedPoses("joints", poses, True, data.q, np.ones(data.n, dtype=bool))
    if position is None:
        position, rotation = data.position, data.rotation
    if data.n and data.q is None and not np.any(position):
        fix = "add joints q1, q2, …, or wanted poses cmd_x, cmd_y, cmd_z with cmd_qw …"
        raise InputError(Problem("the targets have neither joints nor poses", data.source, fix=fix))
    oriented = rotation is not None
    turned = rotation if rotation is not None else np.repeat(np.eye(3)[:, :, None], data.n, axis=2)
    wanted = pair.to_measuring(Poses(turned, position))
    start = _searched_joints(pair, wanted, oriented) if data.q is None else data.q
    q, reached = _nominal_joints(pair, setting, wanted, oriented, start)
    if not oriented:
        wanted = Poses(nominal_poses(pair, setting, q).rotation, wanted.translation)
    return WantedPoses("poses" if data.q is None else "poses and joints", wanted, oriented, q, reached)


def nominal_poses(pair: RobotPair, setting: Circumstances, q: Array) -> Poses:
    """Return poses of the target, measuring frame, that the controller computes for joints ``q`` ``(J, N)``."""
    data = setting.at(q, (None, None), np.arange(q.shape[1]))
    return Model(pair.nominal).bind(data).poses(np.zeros(0))


def pose_error(wanted: Poses, poses: Poses, oriented: bool) -> Array:
    """Return the way from ``poses`` to ``wanted``: m, and for oriented targets a rotation vector in rad."""
    position = wanted.translation - poses.translation
    if not oriented:
        return position
    return np.concatenate((position, log_so3(compose(wanted.rotation, transpose(poses.rotation)))))


def row_weights(oriented: bool, n_joints: int, length: float, weight: float) -> Array:
    """Return the weight of each component of a pose's error.

    An arm with six axes or more reaches position and orientation, so its weight is only a scale: the arm's length. An
    arm with fewer axes gets ``weight`` (m per rad), which decides what it corrects.
    """
    if not oriented:
        return np.ones(3)
    return np.array([1.0] * 3 + [length if n_joints >= 6 else weight] * 3)


def part_of(poses: Poses, index: NDArray[np.int64]) -> Poses:
    """Return some of the poses."""
    return Poses(poses.rotation[..., index], poses.translation[:, index])


def pose_evaluator(
    model: Model,
    wanted: Poses,
    oriented: bool,
    setting: Circumstances,
    motion: tuple[Array | None, Array | None],
    targets: NDArray[np.int64],
) -> Evaluate:
    """Return errors ``(R, K)`` of a model's poses against wanted poses, and ``(R, J, K)`` to the joints, as a function.

    The Jacobian is that of the model's geometry, without how its effects change with the joints, which are some
    thousandths of it. The errors are exact, so this costs a step at most.

    Args:
        model: Without free effects.
        wanted: ``(M)`` wanted poses.
        oriented: Whether their orientation is wanted too.
        setting: Circumstances of all targets.
        motion: Direction and speed of approach ``(J, N)`` of all targets.
        targets: ``(M,)`` numbers of the targets whose poses are wanted.
    """
    arm = model.arm
    terms, owners = _variables(arm), tuple(range(len(arm.names)))

    def evaluate(q: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
        data = setting.at(q, motion, targets[index])
        rigid = dataclasses.replace(Model(arm).bind(data), terms=terms, owners=owners)
        poses, jacobian = rigid.linearise(np.zeros(len(owners)))
        if model.known:
            poses = model.bind(data).poses(np.zeros(0))
        error = pose_error(part_of(wanted, index), poses, oriented)
        return error, jacobian[: error.shape[0]]

    return evaluate


def _variables(arm: Arm) -> tuple[Term, ...]:
    """Return each joint variable as a term: it turns its joint with the joint's sign, and those that mimic it."""
    parts: list[list[Part]] = [[] for _ in arm.names]
    for drive in arm.chain.drives:
        parts[drive.joint].append(Part(drive.motion, drive.coefficient))
    return tuple(Term(name, "", 1.0, tuple(moved)) for name, moved in zip(arm.names, parts, strict=True))


def _nominal_joints(
    pair: RobotPair, setting: Circumstances, wanted: Poses, oriented: bool, start: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return nominal joints ``(J, N)`` near ``start`` for the wanted poses, and where they reach them."""
    evaluate = pose_evaluator(Model(pair.nominal), wanted, oriented, setting, (None, None), np.arange(start.shape[1]))
    length = arm_length(pair.nominal, start)
    weights = row_weights(oriented, start.shape[0], length, length)
    solution = solve(evaluate, start, joint_space(pair, start), weights)
    error = np.max(np.abs(solution.error), axis=0, initial=0.0)
    return solution.q, (error < _REACHED) | (oriented and start.shape[0] < 6) & solution.settled


def _searched_joints(pair: RobotPair, wanted: Poses, oriented: bool) -> Array:
    """Return joints ``(J, N)`` for targets without joints: each the solution nearest to that of the target before."""
    if pair.nominal.robot.targets:
        raise InputError(Problem("targets without joints need a robot with one tool", fix="add joints q1, q2, …"))
    low, high = joint_ranges(pair.nominal)
    # The first is nearest to the middle of the ranges.
    previous = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * (low + high), 0.0)
    result = np.empty((low.size, wanted.translation.shape[1]))
    for start in range(0, result.shape[1], _BLOCK):
        index = np.arange(start, min(start + _BLOCK, result.shape[1]))
        solutions = inverse_kinematics(pair.nominal, part_of(wanted, index), oriented=oriented)
        for column, number in enumerate(index):
            distance = np.sum(np.square(solutions.q[:, column] - previous[:, None]), axis=0)
            cost = np.where(solutions.converged[column], distance, np.inf)
            best = int(np.argmin(cost if np.isfinite(cost).any() else solutions.error[column]))
            previous = result[:, number] = solutions.q[:, column, best]
    return result
