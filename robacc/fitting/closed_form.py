"""Registration of base and target in closed form, from any start, before least squares refines them.

With F the arm's own pose (base to last link, known effects included), B the base and G the target on the last link, a
measured pose is B F G. Position only: p = R_B (p_F + R_F g) + t_B.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError
from robacc.geometry import (
    Array,
    Poses,
    compose,
    rotate_back,
    rpy_from_rotation,
    transpose,
)
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Frame, Robot

_TRIM = 6.0
"""Median errors beyond which a pose is left out of the second pass, as a beam break is."""
_ALTERNATIONS = 50
_SETTLED = 1e-9
"""Decrease of the cost, as a share, at which the alternation ends."""
_LEAST_TURN = 1e-2
"""rad: spread of the last link's turns below which a target's place along an axis stays as the robot file has it."""
_LEAST_POSITION_VAR = 1e-4
"""m^2; least weight of orientations, which decide if all positions are close together."""
_RELUCTANCE = 1e-3
"""Scale of a target's columns: the solution of least norm moves the base rather than a target."""
_ONE_AXIS = 1e-4
"""Second smallest eigenvalue over the largest, below which axes are parallel within about a degree."""


def register_frames(robot: Robot, data: Measurements, base: bool, tool: bool) -> Robot:
    """Return the robot with its base, its tool (or each target's), or both, registered in closed form.

    Raises:
        InputError: too few poses for it.
    """
    if not (base or tool):
        return robot
    needed = 1 if data.rotation is not None else 3
    if data.n < needed:
        raise InputError(
            f"{data.n} pose{'s' * (data.n != 1)}: registration of base_frame or tool_frame needs at least {needed}"
        )
    inliers = np.ones(data.n, dtype=bool)
    registered = robot
    for _ in range(2):
        registered = _register(robot, data.subset(np.flatnonzero(inliers)), base, tool)
        error = np.linalg.norm(data.position - predict(registered, data).translation, axis=0)
        trimmed = error <= _TRIM * np.median(error)
        if trimmed.all() or trimmed.sum() < max(needed, data.n // 2):
            break
        inliers = trimmed
    return registered


def _register(robot: Robot, data: Measurements, base: bool, tool: bool) -> Robot:
    names, index = _targets(robot, data)
    frames = [robot.targets.get(name, robot.tool) for name in names]
    tools = [Poses.from_xyz_rpy(np.array(f.xyz), np.array(f.rpy)) for f in frames]
    base_now = Poses.from_xyz_rpy(np.array(robot.base.xyz)[:, None], np.array(robot.base.rpy)[:, None])
    per_row = _stack(tools, index)
    arm = base_now.inverse() @ predict(robot, data) @ per_row.inverse()
    if not tool:
        return _with_frames(robot, _base_from(arm @ per_row, data), None, names)
    if not base:
        return _with_frames(robot, None, _tools_from(base_now @ arm, data, index, tools), names)
    new_base, new_tools = _base_and_tools(arm, data, index, tools)
    return _with_frames(robot, new_base, new_tools, names)


def _base_and_tools(
    arm: Poses, data: Measurements, index: NDArray[np.int64], tools: Sequence[Poses]
) -> tuple[Poses, list[Poses]]:
    """Return base and targets together: from the orientations if they were measured, else by alternation."""
    start = None
    if data.rotation is not None and data.n >= 3:
        start = _rotations_by_svd(arm.rotation, data.rotation)
    base, placed = _alternate(arm, data, index, list(tools), start)
    if data.rotation is not None and start is None:
        row = Poses(base.rotation[..., None], base.translation[:, None])
        turned = _tools_from(row @ arm, data, index, placed)
        placed = [Poses(new.rotation, old.translation) for new, old in zip(turned, placed, strict=True)]
    return base, placed


def _alternate(
    arm: Poses, data: Measurements, index: NDArray[np.int64], tools: list[Poses], start: tuple[Array, Array] | None
) -> tuple[Poses, list[Poses]]:
    """Solve t_B and every g linearly for a given R_B, then R_B by registration for given g, to convergence."""
    if start is not None:
        rotation, turn = start
        tools = [Poses(turn, tool.translation) for tool in tools]
    else:
        base = _base_from(arm @ _stack(tools, index), data, orientation=False)
        rotation = base.rotation
    previous_cost = np.inf
    translation = np.zeros(3)
    for _ in range(_ALTERNATIONS):
        translation, offsets, residual = _linear_offsets(arm, data, index, tools, rotation)
        tools = [Poses(tool.rotation, offset) for tool, offset in zip(tools, offsets, strict=True)]
        if start is not None or previous_cost - residual <= _SETTLED * previous_cost:
            break
        previous_cost = residual
        rotation = _base_from(arm @ _stack(tools, index), data, orientation=False).rotation
    return Poses(rotation, translation), tools


def _linear_offsets(
    arm: Poses, data: Measurements, index: NDArray[np.int64], tools: Sequence[Poses], rotation: Array
) -> tuple[Array, list[Array], float]:
    """Solve for t_B and each target's g by least squares in R_B^T p - p_F = R_B^T t_B + R_F g.

    Along a direction that is not identifiable (a SCARA's axes) the base moves and the targets stay.
    """
    count = len(tools)
    rhs = np.einsum("ji,jn->in", rotation, data.position) - (arm @ _stack(tools, index)).translation
    matrix = np.zeros((data.n, 3, 3 + 3 * count))
    matrix[:, :, :3] = np.eye(3)
    for target in range(count):
        rows = np.flatnonzero(index == target)
        matrix[rows, :, 3 + 3 * target : 6 + 3 * target] = _RELUCTANCE * np.moveaxis(arm.rotation[:, :, rows], 2, 0)
    solution, *_ = np.linalg.lstsq(matrix.reshape(-1, 3 + 3 * count), rhs.T.ravel(), rcond=_LEAST_TURN * _RELUCTANCE)
    residual = matrix.reshape(-1, 3 + 3 * count) @ solution - rhs.T.ravel()
    offsets = [tool.translation + _RELUCTANCE * solution[3 + 3 * i : 6 + 3 * i] for i, tool in enumerate(tools)]
    return rotation @ solution[:3], offsets, float(residual @ residual)


def _rotations_by_svd(arm: Array, measured: Array) -> tuple[Array, Array] | None:
    """Return R_B and R_G with R_B R_F R_G = R measured: the null vector of the linear equations R_F R_G - R_B^T R = 0.

    None if it is not unique: turns about one axis only, as of a SCARA, do not distinguish a turn of the base about it
    from a turn of the target.

    Source: robot-world/hand-eye calibration by Kronecker products, A. Li, L. Wang, D. Wu 2010.
    """
    # Element (i, k): sum_j F[i, j] G[j, k] - sum_j B[j, i] R[j, k]. Columns of G among themselves and of B among
    # themselves are orthonormal, so the normal matrix is n [1, -C; -C^T, 1] and C alone decides.
    n = arm.shape[-1]
    mixed = (arm.reshape(9, n) @ measured.reshape(9, n).T / n).reshape(3, 3, 3, 3)
    left, values, right = np.linalg.svd(mixed.transpose(1, 3, 2, 0).reshape(9, 9))
    if 1.0 - values[1] < _ONE_AXIS * (1.0 + values[0]):
        return None
    tool, base = left[:, 0].reshape(3, 3), right[0].reshape(3, 3)
    if np.linalg.det(tool) < 0:
        tool, base = -tool, -base
    return nearest_rotation(base), nearest_rotation(tool)


def _base_from(target: Poses, data: Measurements, orientation: bool = True) -> Poses:
    """Return B with B X = measured, X the target in the base: registration of points (Kabsch) and orientations."""
    predicted, measured = target.translation, data.position
    predicted_mean, measured_mean = predicted.mean(axis=1), measured.mean(axis=1)
    matrix = (measured - measured_mean[:, None]) @ (predicted - predicted_mean[:, None]).T
    if orientation and data.rotation is not None:
        # Weighted as points at the scatter of the positions, so that neither kind dominates.
        position_var = max(float(np.sum(np.square(predicted - predicted_mean[:, None]))) / data.n, _LEAST_POSITION_VAR)
        matrix = matrix + position_var * np.einsum("ijn,kjn->ik", data.rotation, target.rotation)
    rotation = nearest_rotation(matrix)
    return Poses(rotation, measured_mean - rotation @ predicted_mean)


def _tools_from(arm: Poses, data: Measurements, index: NDArray[np.int64], tools: Sequence[Poses]) -> list[Poses]:
    """Return each target's mean pose on the last link."""
    local = rotate_back(arm.rotation, data.position - arm.translation)
    mean_tools = []
    for target, tool in enumerate(tools):
        rows = index == target
        if not rows.any():
            mean_tools.append(tool)
            continue
        rotation = tool.rotation
        if data.rotation is not None:
            turned = compose(transpose(arm.rotation[..., rows]), data.rotation[..., rows])
            rotation = nearest_rotation(turned.sum(axis=2))
        mean_tools.append(Poses(rotation, local[:, rows].mean(axis=1)))
    return mean_tools


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotations nearest to ``(..., 3, 3)`` matrices (polar factor by SVD; Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    result: Array = u @ vt
    return result


def _targets(robot: Robot, data: Measurements) -> tuple[list[str], NDArray[np.int64]]:
    names = list(robot.targets) or [""]
    if data.target is None or not robot.targets:
        return names, np.zeros(data.n, dtype=np.int64)
    place = {name: i for i, name in enumerate(names)}
    return names, np.array([place[name] for name in data.target], dtype=np.int64)


def _stack(poses: Sequence[Poses], index: NDArray[np.int64]) -> Poses:
    rotation = np.stack([pose.rotation for pose in poses], axis=-1)
    translation = np.stack([pose.translation for pose in poses], axis=-1)
    return Poses(rotation[..., index], translation[..., index])


def _with_frames(robot: Robot, base: Poses | None, tools: Sequence[Poses] | None, names: Sequence[str]) -> Robot:
    if base is not None:
        robot = dataclasses.replace(robot, base=_frame(base))
    if tools is not None:
        if robot.targets:
            frames = {name: _frame(tool) for name, tool in zip(names, tools, strict=True)}
            robot = dataclasses.replace(robot, targets=frames)
        else:
            robot = dataclasses.replace(robot, tool=_frame(tools[0]))
    return robot


def _frame(pose: Poses) -> Frame:
    x, y, z = (float(value) for value in pose.translation)
    roll, pitch, yaw = (float(value) for value in rpy_from_rotation(pose.rotation))
    return Frame((x, y, z), (roll, pitch, yaw))
