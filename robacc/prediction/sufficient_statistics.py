r"""Sufficient statistics of measured poses for the parameters' errors: as many numbers as there are parameters.

All poses of one robot share the same parameter errors Δ. The residual of all poses together is

    e = J Δ + ε,   Δ ~ N(0, V),   ε ~ N(0, Σ),   so   cov e = J V J^T + Σ,

not a separate covariance for each pose. With W = Σ^(-1/2), A = W J V^(1/2) and the singular values A = U S Z^T,

    y = U^T W e  has independent components  y_i ~ N(0, 1 + S_i²),
    and W e is N(0, 1) in all other directions,

exactly, with matrices no larger than the number of parameters. If base or tool were fitted to the same poses, the span
of their columns is first projected out of A and e (the degrees of freedom that the fit used).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE, BLOCK, TOOL, Scalar
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals
from robacc.prediction.measurement_noise import (
    RANK_TOLERANCE,
    MeasurementNoise,
    file_weights,
    noise_record,
    noise_scales,
)
from robacc.prediction.parameters import ToleranceParameter
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

NEGLIGIBLE = 1e-4
"""Combinations of parameters with a predicted effect on all poses below this fraction of one standard deviation of the
noise are ignored: 1 + S² differs from 1 by 1e-8."""
_FRAME_MOTIONS = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


@dataclass(frozen=True, slots=True)
class SufficientStatistics:
    """Whitened residual of all poses in the directions that the parameters' errors move."""

    names: tuple[str, ...]
    """Names of the P parameters."""
    effect: Array
    """``(R, P)`` U^T A: whitened effect of one standard deviation of each parameter; R directions."""
    strength: Array
    """``(R,)`` S, descending."""
    y: Array
    """``(R,)`` whitened residual in the R directions."""
    noise_squares: float
    """Sum of squares in all other directions, which contain noise only."""
    noise_dof: int
    n_poses: int
    n_values: int
    """Measured numbers: 3 or 6 a pose."""
    n_aligned: int
    """Combinations of base and tool coordinates that were fitted to the same poses."""
    noise: MeasurementNoise

    @property
    def noise_is_estimated(self) -> bool:
        """True if noise of position or orientation was estimated from the same poses."""
        return "estimated" in (self.noise.source_position, self.noise.source_orientation)


def reduce_residuals(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    noise: tuple[float | None, float | None] = (None, None),
    aligned: Sequence[str] = (),
) -> SufficientStatistics:
    """Reduce the residuals of measured poses to :class:`SufficientStatistics`.

    Args:
        robot: Robot with base and tool as registered; its effects are part of the command.
        data: Measured poses with joint variables.
        parameters: Parameters with predicted errors.
        noise: Standard deviation of position (m) and of orientation (rad) along each axis; None: from the file's
            columns, else estimated by restricted maximum likelihood from the part that no parameter explains.
        aligned: ``base_frame``, ``tool_frame`` or both, if fitted to these poses.

    Raises:
        InputError: There are too few poses to estimate the noise, or the noise is zero.
    """
    triangles, counts = _triangles(robot, data, parameters, noise, aligned)
    n_fixed = triangles[0].shape[1] - len(parameters) - 1
    sigma, sources = noise_scales(data, noise, triangles, counts)
    stacked = np.concatenate([triangle / s for triangle, s in zip(triangles, sigma, strict=True)])
    projected, n_aligned = _project_out_registered(stacked, n_fixed)
    scaled, residual = projected[:, :-1], projected[:, -1]
    directions, strength, _ = np.linalg.svd(scaled, full_matrices=False)
    significant = strength > NEGLIGIBLE
    directions, strength = directions[:, significant], strength[significant]
    y = directions.T @ residual
    noise_squares = max(float(residual @ residual - y @ y), 0.0)
    return SufficientStatistics(
        tuple(parameter.name for parameter in parameters),
        directions.T @ scaled,
        strength,
        y,
        noise_squares,
        sum(counts) - n_aligned - int(significant.sum()),
        data.n,
        sum(counts),
        n_aligned,
        noise_record(data, sigma, sources),
    )


def _triangles(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    noise: tuple[float | None, float | None],
    aligned: Sequence[str],
) -> tuple[list[Array], list[int]]:
    """Return the R factors of [fitted columns, A, residual] and the numbers of rows, of position and of orientation.

    Rows are divided by the file's measuring uncertainty if it is used, else they are in m and rad.
    """
    predicted = Model.of(robot).bind(data).poses(np.zeros(0))
    arm = Arm.of(robot)
    # Effects move the columns of the Jacobian in second order only.
    scalars = Model.of(dataclasses.replace(robot, effects=())).bind(data).nominal
    fixed = _registered_motions(arm, data, aligned)
    motions = [*(motion for motion, _ in fixed), *(parameter.motion for parameter in parameters)]
    weights = file_weights(data, noise)
    parts = 1 if data.rotation is None else 2
    n_columns = len(motions) + 1
    triangles = [np.zeros((0, n_columns)) for _ in range(parts)]
    for start in range(0, data.n, BLOCK):
        block = slice(start, min(start + BLOCK, data.n))
        columns = np.empty((6, n_columns, block.stop - block.start))
        local: list[Scalar] = [scalar if isinstance(scalar, float) else scalar[block] for scalar in scalars]
        columns[:, :-1] = arm.chain.sweep(local, block.stop - block.start, motions).jacobian
        for k, (_, rows) in enumerate(fixed):
            columns[:, k] *= 1.0 if rows is None else rows[block]
        for k, parameter in enumerate(parameters):
            columns[:, len(fixed) + k] *= parameter.sd
        rows = residuals(data.subset(np.arange(block.start, block.stop)), _poses_in_block(predicted, block))
        columns[: 3 * parts, -1] = rows
        for part in range(parts):
            weighted = columns[3 * part : 3 * part + 3] * weights[part][:, None, block]
            stacked = np.concatenate((triangles[part], weighted.transpose(0, 2, 1).reshape(-1, n_columns)))
            triangles[part] = _triangle(stacked)
    return triangles, [3 * data.n] * parts


def _triangle(rows: Array) -> Array:
    """Return the R factor of a QR decomposition."""
    result: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    return result


def _poses_in_block(poses: Poses, block: slice) -> Poses:
    return Poses(poses.rotation[..., block], poses.translation[..., block])


def _registered_motions(arm: Arm, data: Measurements, aligned: Sequence[str]) -> list[tuple[int, Array | None]]:
    """Return the motions that were fitted, each with the rows that it moves (None: all)."""
    columns: list[tuple[int, Array | None]] = []
    if "base_frame" in aligned:
        columns += [(arm.chain.index(BASE, label), None) for label in _FRAME_MOTIONS]
    if "tool_frame" in aligned:
        targets = tuple(arm.robot.targets) if data.target is not None else ()
        for target in targets or (None,):
            rows = None if target is None else (np.asarray(data.target) == target).astype(float)
            columns += [(arm.chain.index(TOOL, label), rows) for label in _FRAME_MOTIONS]
    return columns


def _project_out_registered(stacked: Array, n_fixed: int) -> tuple[Array, int]:
    """Return the other columns outside the span of the first ``n_fixed``, and the dimension of that span."""
    if n_fixed == 0:
        return stacked, 0
    fixed = stacked[:, :n_fixed]
    column_norms = np.sqrt(np.sum(np.square(fixed), axis=0))
    u, singular_values, _ = np.linalg.svd(fixed / np.where(column_norms > 0, column_norms, 1.0), full_matrices=True)
    absorbed = int(np.sum(singular_values > RANK_TOLERANCE * singular_values[0]))
    return u[:, absorbed:].T @ stacked[:, n_fixed:], absorbed
