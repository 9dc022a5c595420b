"""Measurement noise of the poses: given, from the file's columns, or estimated from the poses themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.measurements import Measurements

NoiseSource = Literal["file", "given", "estimated"]

RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest are rounding."""
_MAX_REML_ROUNDS = 200


@dataclass(frozen=True, slots=True)
class MeasurementNoise:
    """Standard deviation of the measurement noise along each axis."""

    position: float
    """m, root mean square over poses and axes."""
    orientation: float | None
    """rad; None if no orientation was measured."""
    source_position: NoiseSource
    source_orientation: NoiseSource | None


def file_weights(data: Measurements, noise: tuple[float | None, float | None]) -> list[Array]:
    """Return reciprocals ``(3, N)`` of the file's uncertainty of position and orientation; 1 if it is not used."""
    position, orientation = np.ones((3, data.n)), np.ones((3, data.n))
    zero_columns = []
    if noise[0] is None and data.sigma_position is not None:
        zero_columns += [] if np.all(data.sigma_position > 0) else ["sigma_x, sigma_y, sigma_z"]
        position = 1.0 / np.where(data.sigma_position > 0, data.sigma_position, 1.0)
    if noise[1] is None and data.sigma_rotation is not None:
        zero_columns += [] if np.all(data.sigma_rotation > 0) else ["sigma_r"]
        sigma = np.where(data.sigma_rotation > 0, data.sigma_rotation, 1.0)
        orientation = np.broadcast_to(1.0 / sigma, (3, data.n))
    if zero_columns:
        fix = "remove the column, or give `noise`"
        raise InputError(
            [
                Problem("the measuring uncertainty is 0, expected above 0", data.source, None, column, fix)
                for column in zero_columns
            ]
        )
    return [position, orientation]


def noise_scales(
    data: Measurements,
    given_noise: tuple[float | None, float | None],
    triangles: Sequence[Array],
    counts: Sequence[int],
) -> tuple[list[float], list[NoiseSource]]:
    """Return the standard deviation of each triangle in addition to the file's weights, and its source."""
    in_file = (data.sigma_position is not None, data.sigma_rotation is not None)
    sigma: list[float | None] = []
    sources: list[NoiseSource] = []
    for part in range(len(triangles)):
        value = given_noise[part]
        sources.append("given" if value is not None else "file" if in_file[part] else "estimated")
        sigma.append(value if value is not None else 1.0 if in_file[part] else None)
    if None not in sigma:
        return [float(value) for value in sigma if value is not None], sources
    return _restricted_likelihood(data, triangles, counts, sigma), sources


def _restricted_likelihood(
    data: Measurements, triangles: Sequence[Array], counts: Sequence[int], given_sigma: Sequence[float | None]
) -> list[float]:
    """Return standard deviations of position and orientation by REML, all columns treated as fixed effects.

    Fixed point of |r_k|² = σ_k² (n_k - tr(G^-1 G_k)), G_k the rows' part of the normal matrix G: H. D. Patterson,
    R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58 (1971).
    """
    sigma = [
        given if given is not None else _rms_residual(triangle, n)
        for given, triangle, n in zip(given_sigma, triangles, counts, strict=True)
    ]
    for _ in range(_MAX_REML_ROUNDS):
        stacked = np.concatenate([triangle / std for triangle, std in zip(triangles, sigma, strict=True)])
        column_norms = np.sqrt(np.sum(np.square(stacked[:, :-1]), axis=0))
        column_norms[column_norms == 0.0] = 1.0
        u, singular_values, vt = np.linalg.svd(stacked[:, :-1] / column_norms, full_matrices=False)
        independent = (
            singular_values > RANK_TOLERANCE * singular_values[0] if singular_values.size else singular_values > 0
        )
        inverse = vt[independent].T / singular_values[independent]
        solution = inverse @ (u[:, independent].T @ stacked[:, -1])
        change = 0.0
        for k, (triangle, given) in enumerate(zip(triangles, given_sigma, strict=True)):
            if given is not None:
                continue
            rows = triangle[:, :-1] / column_norms
            residual = triangle[:, -1] - rows @ solution
            dof = counts[k] - float(np.sum(np.square((rows / sigma[k]) @ inverse)))
            if dof < 1.0:
                fix = "measure more poses, or give the noise with `noise` or sigma columns"
                raise InputError(Problem("too few poses to estimate the measurement noise", data.source, fix=fix))
            new_sigma = float(np.sqrt(residual @ residual / dof))
            if new_sigma < 1e-12 * _rms_residual(triangle, counts[k]) or new_sigma == 0.0:
                fix = "give the noise with `noise` or sigma columns"
                raise InputError(
                    Problem(
                        "the parameters explain every pose exactly, so the noise cannot be estimated",
                        data.source,
                        fix=fix,
                    )
                )
            change = max(change, abs(new_sigma / sigma[k] - 1.0))
            sigma[k] = new_sigma
        if change < 1e-10:
            break
    return sigma


def _rms_residual(triangle: Array, n: int) -> float:
    """Return the RMS residual as a start value; 1 if it is zero."""
    return float(np.linalg.norm(triangle[:, -1])) / np.sqrt(n) or 1.0


def noise_record(data: Measurements, sigma: Sequence[float], sources: Sequence[NoiseSource]) -> MeasurementNoise:
    """Return the noise with its sources; for ``file``, the root mean square of the file's columns."""
    values = [
        stated if source == "file" and stated is not None else estimated
        for estimated, source, stated in zip(sigma, sources, data.stated_noise, strict=False)
    ]
    if len(sources) == 1:
        return MeasurementNoise(values[0], None, sources[0], None)
    return MeasurementNoise(values[0], values[1], sources[0], sources[1])
