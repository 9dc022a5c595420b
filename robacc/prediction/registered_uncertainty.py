"""Uncertainty of a model at measured poses whose base or tool was fitted to other measured poses.

A registration spreads the errors of the model at its poses over all poses, and takes part of them away. With W the
weights of the registration, A the columns of the frames, and e the errors at its poses, the error at another pose is

    e_i - A_i N^-1 A^T W e,    N = A^T W A.

Errors of the coefficients, and of effects beyond their ranges, are the same functions of the joints at all poses. Their
columns G change to G_i - A_i N^-1 A^T W G. Scatter of the joints, unexplained error and noise are independent from pose
to pose.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robacc.chain import BLOCK
from robacc.fitting.apply_fit import absorb_constants, apply_fit
from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import independent_covariance, pose_sources
from robacc.robots.description import Robot

_RANK = 1e-12
"""Eigenvalue of the scaled normal matrix, over the largest, below which a direction of the frames is not fitted."""


def registered_uncertainty(
    robot: Robot, fit: ModelFit, data: Measurements, registration: Fit, used: Measurements
) -> tuple[Array, Array]:
    """Return covariances ``(3, 3, N)`` of position (m²) and orientation (rad²), measuring frame, noise included.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        data: Poses to judge, with their circumstances.
        registration: Fit of the frames.
        used: Poses of the registration.
    """
    frames = Model.of(absorb_constants(apply_fit(registration)), registration.model.free)
    robot = absorb_constants(robot)
    size = len(registration.names)
    normal, scatter = np.zeros((size, size)), np.zeros((size, size))
    crossed: Array | None = None
    weight = np.where(registration.inliers, registration.weight, 0.0)
    for block, columns, correlated, independent in _blocks(robot, fit, used, data, frames):
        rows = weight.shape[0]
        weighed = np.square(weight[:, block])[:, None] * columns[:rows]
        normal += np.einsum("ipn,iqn->pq", weighed, columns[:rows])
        scatter += np.einsum("ipn,ijn,jqn->pq", weighed, independent[:rows, :rows], weighed, optimize=True)
        part = np.einsum("ipn,ikn->pk", weighed, correlated[:rows], optimize=True)
        crossed = part if crossed is None else crossed + part
    assert crossed is not None
    inverse = _pseudo_inverse(normal)
    moved, spread = inverse @ crossed, inverse @ scatter @ inverse
    position, orientation = np.empty((3, 3, data.n)), np.empty((3, 3, data.n))
    for block, columns, correlated, independent in _blocks(robot, fit, data, data, frames):
        changed = correlated - np.einsum("ipn,pk->ikn", columns, moved, optimize=True)
        for result, part in ((position, slice(0, 3)), (orientation, slice(3, 6))):
            result[..., block] = np.einsum("ikn,jkn->ijn", changed[part], changed[part], optimize=True)
            result[..., block] += np.einsum("ipn,pq,jqn->ijn", columns[part], spread, columns[part], optimize=True)
            result[..., block] += independent[part, part]
    return position, orientation


def _blocks(
    robot: Robot, fit: ModelFit, data: Measurements, sample: Measurements, frames: Model
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield blocks of poses: columns of the frames and of correlated errors, and the covariance of the others."""
    for start in range(0, data.n, BLOCK):
        block = slice(start, min(start + BLOCK, data.n))
        part = data.subset(block)
        bound = frames.bind(part)
        sources = pose_sources(robot, fit, part, True)
        independent = independent_covariance(fit, sources, part)
        yield block, bound.linearise(np.zeros(len(bound.names)))[1], sources.columns(fit, sample), independent


def _pseudo_inverse(normal: Array) -> Array:
    """Return the inverse of a normal matrix without its undetermined directions."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    kept = values > _RANK * values[-1]
    result: Array = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T * scale[:, None] * scale
    return result
