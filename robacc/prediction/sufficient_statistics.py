r"""What measured poses say of the parameters' errors, brought down to as many numbers as there are parameters.

One robot has one Δ, and all its poses share it. The residual of all poses together is

    e = J Δ + ε,   Δ ~ N(0, V),   ε ~ N(0, Σ),   so   cov e = J V J^T + Σ,

not a covariance for each pose. With W = Σ^(-1/2), A = W J V^(1/2) and the singular values A = U S Z^T,

    y = U^T W e  has independent components  y_i ~ N(0, 1 + S_i²),
    and what is left of W e is N(0, 1) in all other directions,

exactly, with matrices no larger than the number of parameters. Where base or tool were fitted to the same poses, what
their columns could have absorbed is taken out of A and e first (the degrees of freedom that the fit used).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.chain import BASE, BLOCK, TOOL, Scalar
from robacc.errors import InputError, Problem
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals
from robacc.prediction.parameters import ToleranceParameter
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

NoiseSource = Literal["file", "given", "estimated"]

NEGLIGIBLE = 1e-4
"""A combination of parameters whose predicted effect on all poses together is below this share of one measuring
standard deviation is noise to all intents: 1 + S² differs from 1 by 1e-8."""
_ABSORBED = 1e-9
"""Singular values of the scaled aligned columns below this share of the largest are rounding."""
_REML_ROUNDS = 200
_TURNS = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


@dataclass(frozen=True, slots=True)
class MeasuringNoise:
    """Standard deviation of what the parameters do not explain, along each axis."""

    position: float
    """m, root mean square over poses and axes."""
    orientation: float | None
    """rad; None where no orientation was measured."""
    source_position: NoiseSource
    source_orientation: NoiseSource | None


@dataclass(frozen=True, slots=True)
class Evidence:
    """The residual of all poses in the directions that the parameters' errors move it, whitened."""

    names: tuple[str, ...]
    """Of the P parameters."""
    effect: Array
    """``(R, P)`` U^T A: whitened effect of one standard deviation of each parameter; R directions."""
    strength: Array
    """``(R,)`` S, descending."""
    y: Array
    """``(R,)``"""
    rest: float
    """Sum of squares in all other directions."""
    rest_dof: int
    n_poses: int
    n_components: int
    """Measured numbers: 3 or 6 a pose."""
    n_aligned: int
    """Combinations of base and tool coordinates that were fitted to the same poses."""
    noise: MeasuringNoise

    @property
    def noise_is_estimated(self) -> bool:
        """Whether some of the noise was estimated from these same poses."""
        return "estimated" in (self.noise.source_position, self.noise.source_orientation)


def gather_evidence(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    noise: tuple[float | None, float | None] = (None, None),
    aligned: Sequence[str] = (),
) -> Evidence:
    """Bring the residuals of measured poses down to :class:`Evidence`.

    Args:
        robot: With base and tool as aligned; its effects are part of what it commands.
        data: Measured poses with joint variables.
        parameters: Whose errors are predicted.
        noise: Standard deviation of position (m) and of orientation (rad) along each axis, where given; else the
            file's own columns; else estimated by restricted maximum likelihood from what no parameter explains.
        aligned: Of ``base_frame`` and ``tool_frame``, what was fitted to these poses.

    Raises:
        InputError: too few poses for the noise to be estimated, or the noise is zero.
    """
    triangles, counts = _triangles(robot, data, parameters, noise, aligned)
    n_fixed = triangles[0].shape[1] - len(parameters) - 1
    sigma, sources = _noise(data, noise, triangles, counts)
    stacked = np.concatenate([triangle / s for triangle, s in zip(triangles, sigma, strict=True)])
    projected, n_aligned = _without_aligned(stacked, n_fixed)
    scaled, residual = projected[:, :-1], projected[:, -1]
    u, strength, _ = np.linalg.svd(scaled, full_matrices=False)
    kept = strength > NEGLIGIBLE
    u, strength = u[:, kept], strength[kept]
    y = u.T @ residual
    rest = max(float(residual @ residual - y @ y), 0.0)
    return Evidence(
        tuple(parameter.name for parameter in parameters),
        u.T @ scaled,
        strength,
        y,
        rest,
        sum(counts) - n_aligned - int(kept.sum()),
        data.n,
        sum(counts),
        n_aligned,
        _noise_record(data, sigma, sources),
    )


def _triangles(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    noise: tuple[float | None, float | None],
    aligned: Sequence[str],
) -> tuple[list[Array], list[int]]:
    """R factors of [aligned columns, A, residual], position rows and orientation rows apart; numbers of rows.

    Rows are divided by the file's measuring uncertainty where that is what counts, else left in m and rad.
    """
    predicted = Model.of(robot).bind(data).poses(np.zeros(0))
    arm = Arm.of(robot)
    # Effects move the columns of the Jacobian in second order only.
    scalars = Model.of(dataclasses.replace(robot, effects=())).bind(data).nominal
    fixed = _aligned_columns(arm, data, aligned)
    motions = [*(motion for motion, _ in fixed), *(parameter.motion for parameter in parameters)]
    weights = _file_weights(data, noise)
    parts = 1 if data.rotation is None else 2
    width = len(motions) + 1
    triangles = [np.zeros((0, width)) for _ in range(parts)]
    for start in range(0, data.n, BLOCK):
        block = slice(start, min(start + BLOCK, data.n))
        columns = np.empty((6, width, block.stop - block.start))
        local: list[Scalar] = [scalar if isinstance(scalar, float) else scalar[block] for scalar in scalars]
        columns[:, :-1] = arm.chain.sweep(local, block.stop - block.start, motions).jacobian
        for k, (_, rows) in enumerate(fixed):
            columns[:, k] *= 1.0 if rows is None else rows[block]
        for k, parameter in enumerate(parameters):
            columns[:, len(fixed) + k] *= parameter.sd
        rows = residuals(data.subset(np.arange(block.start, block.stop)), _slice(predicted, block))
        columns[: 3 * parts, -1] = rows
        for part in range(parts):
            weighted = columns[3 * part : 3 * part + 3] * weights[part][:, None, block]
            stacked = np.concatenate((triangles[part], weighted.transpose(0, 2, 1).reshape(-1, width)))
            triangles[part] = _triangle(stacked)
    return triangles, [3 * data.n] * parts


def _triangle(rows: Array) -> Array:
    """The R factor."""
    result: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    return result


def _slice(poses: Poses, block: slice) -> Poses:
    return Poses(poses.rotation[..., block], poses.translation[..., block])


def _file_weights(data: Measurements, noise: tuple[float | None, float | None]) -> list[Array]:
    """``(3, N)`` reciprocals of the file's uncertainty for position and orientation; ones where it does not count."""
    position, orientation = np.ones((3, data.n)), np.ones((3, data.n))
    bad = []
    if noise[0] is None and data.sigma_position is not None:
        bad += [] if np.all(data.sigma_position > 0) else ["sigma_x, sigma_y, sigma_z"]
        position = 1.0 / np.where(data.sigma_position > 0, data.sigma_position, 1.0)
    if noise[1] is None and data.sigma_rotation is not None:
        bad += [] if np.all(data.sigma_rotation > 0) else ["sigma_r"]
        sigma = np.where(data.sigma_rotation > 0, data.sigma_rotation, 1.0)
        orientation = np.broadcast_to(1.0 / sigma, (3, data.n))
    if bad:
        fix = "leave the column out, or give --noise"
        raise InputError([Problem("a measuring uncertainty of zero cannot be", data.source, None, c, fix) for c in bad])
    return [position, orientation]


def _aligned_columns(arm: Arm, data: Measurements, aligned: Sequence[str]) -> list[tuple[int, Array | None]]:
    """Motions that were fitted, each with the rows it moves (None: all)."""
    columns: list[tuple[int, Array | None]] = []
    if "base_frame" in aligned:
        columns += [(arm.chain.index(BASE, label), None) for label in _TURNS]
    if "tool_frame" in aligned:
        targets = tuple(arm.robot.targets) if data.target is not None else ()
        for target in targets or (None,):
            rows = None if target is None else (np.asarray(data.target) == target).astype(float)
            columns += [(arm.chain.index(TOOL, label), rows) for label in _TURNS]
    return columns


def _noise(
    data: Measurements, given: tuple[float | None, float | None], triangles: Sequence[Array], counts: Sequence[int]
) -> tuple[list[float], list[NoiseSource]]:
    """What to divide each triangle by besides the file's weights, and where that is from."""
    in_file = (data.sigma_position is not None, data.sigma_rotation is not None)
    sigma: list[float | None] = []
    sources: list[NoiseSource] = []
    for part in range(len(triangles)):
        value = given[part]
        sources.append("given" if value is not None else "file" if in_file[part] else "estimated")
        sigma.append(value if value is not None else 1.0 if in_file[part] else None)
    if None not in sigma:
        return [float(value) for value in sigma if value is not None], sources
    return _restricted_likelihood(data, triangles, counts, sigma), sources


def _restricted_likelihood(
    data: Measurements, triangles: Sequence[Array], counts: Sequence[int], known: Sequence[float | None]
) -> list[float]:
    """Standard deviations of position and orientation by REML, all columns counted as fixed effects.

    The fixed point of |r_k|² = σ_k² (n_k - tr(G^-1 G_k)), G_k the rows' part of the normal matrix G: H. D. Patterson,
    R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58 (1971).
    """
    sigma = [
        value if value is not None else _scale(triangle, n)
        for value, triangle, n in zip(known, triangles, counts, strict=True)
    ]
    for _ in range(_REML_ROUNDS):
        stacked = np.concatenate([triangle / s for triangle, s in zip(triangles, sigma, strict=True)])
        length = np.sqrt(np.sum(np.square(stacked[:, :-1]), axis=0))
        length[length == 0.0] = 1.0
        u, s, vt = np.linalg.svd(stacked[:, :-1] / length, full_matrices=False)
        kept = s > _ABSORBED * s[0] if s.size else s > 0
        inverse = vt[kept].T / s[kept]
        solution = inverse @ (u[:, kept].T @ stacked[:, -1])
        change = 0.0
        for k, (triangle, value) in enumerate(zip(triangles, known, strict=True)):
            if value is not None:
                continue
            rows = triangle[:, :-1] / length
            left = triangle[:, -1] - rows @ solution
            dof = counts[k] - float(np.sum(np.square((rows / sigma[k]) @ inverse)))
            if dof < 1.0:
                fix = "measure more poses, or give the measuring noise: --noise, or sigma columns"
                raise InputError(Problem("too few poses to estimate the measuring noise from", data.source, fix=fix))
            new = float(np.sqrt(left @ left / dof))
            if new < 1e-12 * _scale(triangle, counts[k]) or new == 0.0:
                fix = "give it: --noise, or sigma columns"
                raise InputError(
                    Problem(
                        "the parameters explain every pose exactly, so no noise can be estimated", data.source, fix=fix
                    )
                )
            change = max(change, abs(new / sigma[k] - 1.0))
            sigma[k] = new
        if change < 1e-10:
            break
    return sigma


def _scale(triangle: Array, n: int) -> float:
    """RMS residual, to start from; one where there is none."""
    return float(np.linalg.norm(triangle[:, -1])) / np.sqrt(n) or 1.0


def _without_aligned(stacked: Array, n_fixed: int) -> tuple[Array, int]:
    """The rest of the columns in the directions that the first ``n_fixed`` cannot reach, and how many those reach."""
    if n_fixed == 0:
        return stacked, 0
    fixed = stacked[:, :n_fixed]
    length = np.sqrt(np.sum(np.square(fixed), axis=0))
    u, s, _ = np.linalg.svd(fixed / np.where(length > 0, length, 1.0), full_matrices=True)
    reached = int(np.sum(s > _ABSORBED * s[0]))
    return u[:, reached:].T @ stacked[:, n_fixed:], reached


def _noise_record(data: Measurements, sigma: Sequence[float], sources: Sequence[NoiseSource]) -> MeasuringNoise:
    values = list(sigma)
    if sources[0] == "file" and data.sigma_position is not None:
        values[0] = float(np.sqrt(np.mean(np.square(data.sigma_position))))
    if len(sources) == 1:
        return MeasuringNoise(values[0], None, sources[0], None)
    if sources[1] == "file" and data.sigma_rotation is not None:
        values[1] = float(np.sqrt(np.mean(np.square(data.sigma_rotation))))
    return MeasuringNoise(values[0], values[1], sources[0], sources[1])
