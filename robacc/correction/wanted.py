"""Wanted poses of targets, and the nominal joints at which the controller would reach them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.correction.circumstances import Circumstances
from robacc.correction.robots import RobotPair, arm_length
from robacc.correction.solving import JointSpace, solve
from robacc.effects.base import Part, Term
from robacc.errors import InputError, Problem
from robacc.geometry import Array, Poses, compose, log_so3, transpose
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.inverse_kinematics import inverse_kinematics, joint_ranges

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


@dataclass(frozen=True)
class PoseEvaluator:
    """Errors of a model's poses against wanted poses, and their Jacobian to the joints."""

    model: Model
    """Without free effects."""
    wanted: Poses
    oriented: bool
    setting: Circumstances
    motion: tuple[Array | None, Array | None]
    """Direction and speed of approach ``(J, N)`` of all targets."""

    def __call__(self, q: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the errors ``(R, M)`` and ``(R, J, M)`` at joints ``q`` ``(J, M)`` of the targets ``index``.

        The Jacobian is that of the model's geometry, without how its effects change with the joints, which are some
        thousandths of it. The errors are exact, so this costs a step at most.
        """
        arm, data = self.model.arm, self.setting.at(q, self.motion, index)
        rigid = dataclasses.replace(Model(arm).bind(data), terms=_variables(arm), owners=tuple(range(len(arm.names))))
        poses, jacobian = rigid.linearise(np.zeros(len(arm.names)))
        if self.model.known:
            poses = self.model.bind(data).poses(np.zeros(0))
        error = pose_error(part_of(self.wanted, index), poses, self.oriented)
        return error, jacobian[: error.shape[0]]


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
    evaluate = PoseEvaluator(Model(pair.nominal), wanted, oriented, setting, (None, None))
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
    middle = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * (low + high), 0.0)
    result = np.empty((low.size, wanted.translation.shape[1]))
    previous = middle
    for start in range(0, result.shape[1], _BLOCK):
        index = np.arange(start, min(start + _BLOCK, result.shape[1]))
        solutions = inverse_kinematics(pair.nominal, part_of(wanted, index), oriented=oriented)
        for column, number in enumerate(index):
            distance = np.sum(np.square(solutions.q[:, column] - previous[:, None]), axis=0)
            cost = np.where(solutions.converged[column], distance, np.inf)
            best = int(np.argmin(cost if np.isfinite(cost).any() else solutions.error[column]))
            previous = result[:, number] = solutions.q[:, column, best]
    return result
