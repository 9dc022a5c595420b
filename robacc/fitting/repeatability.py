"""Intrinsic repeatability of the joints, estimated with the measurement noise by restricted maximum likelihood.

Newton's step on the average information (:mod:`robacc.fitting.restricted_likelihood`) is taken in the logarithms of the
variances, so that they stay positive. Where it does not raise the likelihood, the step

    v_c <- v_c ( |B_c^T P r|^2 / tr(P B_c B_c^T) )^(1/2)

does (H. Zhou, L. Hu, J. Zhou, K. Lange, "MM algorithms for variance components models", J. Comput. Graph. Stat. 28
(2019) 350-361). Independent observations are visits: three targets measured at one arrival share the same scatter of
each joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.fitting.restricted_likelihood import MixedModel, RestrictedLikelihood, Variances
from robacc.fitting.whitening import Scatter, block_columns, blocks_of, noise_of_rows
from robacc.geometry import Array

MOST_ROWS = 1200
"""Largest number of rows that variances are estimated from."""
MANY_COEFFICIENTS = 120
"""Coefficients from which shrunk coefficients are not estimated again with the variances: the time grows with their
square."""
_ROUNDS = 80
_SETTLED = 1e-2
"""Change of the restricted log-likelihood below which the iteration stops."""
_RETURNING = 0.1
"""Least share of the usual start at which a standard deviation starts if an earlier estimate is known."""
_NEGLIGIBLE = 1e-4
"""Share of the largest variance at the target below which a joint's scatter is set to zero."""


@dataclass(frozen=True, slots=True)
class Components:
    """Estimated variance components and their gain in likelihood."""

    scatter: Scatter
    noise: tuple[float, float]
    """Standard deviation of position (m) and orientation (rad) beyond the stated measurement uncertainty."""
    gain: float
    """Twice the gain in restricted log-likelihood over a model without scatter."""
    visit_std_error: Array
    """``(J,)`` standard error of each ``visit_std``, from the expected information; inf where it is zero."""


def estimate(model: MixedModel, earlier: Scatter | None = None) -> Components:
    """Estimate the joints' scatter and the noise beyond the stated measurement uncertainty.

    ``model`` holds inliers only. The iteration starts from ``earlier``, an earlier estimate, if there is one.
    """
    none = np.zeros(model.columns.shape[1])
    null, null_likelihood = _ascend(model, Variances(Scatter(none, none), _remaining(model)))
    size = np.sqrt(np.mean(np.sum(np.square(model.columns[:3]), axis=0), axis=1))
    start = np.where(size > 0, null.noise[0] / np.maximum(size, 1e-12) / 2.0, none)
    # A variance that starts at zero stays there.
    visit_std = start if earlier is None else np.maximum(earlier.visit_std, _RETURNING * start)
    pose_std = start if earlier is None else np.maximum(earlier.pose_std, _RETURNING * start)
    initial = Scatter(visit_std, pose_std if model.is_repeated else none)
    variances, likelihood = _ascend(model, Variances(initial, null.noise))
    scatter = _without_negligible(variances.scatter, size)
    errors = _standard_errors(model, scatter, variances.noise)
    return Components(scatter, variances.noise, 2.0 * (likelihood - null_likelihood), errors)


def _remaining(model: MixedModel) -> tuple[float, float]:
    """Return the root mean square of the residuals of position and orientation."""
    position = float(np.sqrt(np.mean(np.square(model.residual[:3])))) or 1e-9
    rotation = float(np.sqrt(np.mean(np.square(model.residual[3:])))) if model.residual.shape[0] == 6 else 0.0
    return position, rotation


def _ascend(model: MixedModel, variances: Variances) -> tuple[Variances, float]:
    """Improve all variances that are not zero until the restricted likelihood converges; return that likelihood too."""
    current = RestrictedLikelihood.at(model, variances)
    for _ in range(_ROUNDS):
        stds = variances.stds
        free = np.flatnonzero(stds)
        slopes = current.slopes(free)
        better = None
        for factor in (np.exp(0.5 * slopes.newton(np.square(stds[free]))), slopes.ratio**0.25):
            tried = stds.copy()
            tried[free] *= factor
            tried_variances = Variances.of(tried)
            moved = RestrictedLikelihood.at(model, tried_variances)
            if moved.log_likelihood > current.log_likelihood:
                better = moved
                break
        if better is None:
            break
        gain = better.log_likelihood - current.log_likelihood
        variances, current = tried_variances, better
        if gain < _SETTLED:
            break
    return variances, current.log_likelihood


def _without_negligible(scatter: Scatter, size: Array) -> Scatter:
    """Return the scatter without joints whose effect at the target is negligible next to the largest."""
    at_target = np.maximum(scatter.visit_std, scatter.pose_std) * size
    largest = float(at_target.max(initial=0.0))
    keep_visit = np.square(scatter.visit_std * size) > _NEGLIGIBLE * largest**2
    keep_pose = np.square(scatter.pose_std * size) > _NEGLIGIBLE * largest**2
    return Scatter(np.where(keep_visit, scatter.visit_std, 0.0), np.where(keep_pose, scatter.pose_std, 0.0))


def _standard_errors(model: MixedModel, scatter: Scatter, noise: tuple[float, float]) -> Array:
    """Return ``(J,)`` standard errors of ``visit_std`` from the information 1/2 tr(R^-1 B_i R^-1 B_j), with noise."""
    weight = model.weight(noise)
    joints = model.columns.shape[1]
    information = np.zeros((joints + 1, joints + 1))
    scaled = model.columns * weight[:, None, :]
    for rows in blocks_of(model.visits):
        columns = block_columns(scaled, rows)
        count, size = columns.shape[:2]
        covariance = np.eye(size) + (columns * np.square(scatter.visit_std)) @ np.swapaxes(columns, 1, 2)
        if model.correlated_noise is not None:
            covariance += noise_of_rows(weight, rows, model.correlated_noise)
        values, vectors = np.linalg.eigh(covariance)
        inverse = (vectors / np.maximum(values, 1.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        cross = np.swapaxes(columns, 1, 2) @ inverse @ columns
        information[:joints, :joints] += 0.5 * np.sum(np.square(cross), axis=0)
        squared = np.moveaxis(np.square(weight)[:, rows], 1, 0).reshape(count, 1, size)
        half = inverse * squared  # R^-1 D' with D' the derivative by the noise variance, in scaled units
        information[joints, joints] += 0.5 * float(np.einsum("vij,vji->", half, half))
        mixed = np.einsum("vaj,vab,vbj->j", columns, inverse @ (inverse * squared), columns)
        information[joints, :joints] += 0.5 * mixed
        information[:joints, joints] += 0.5 * mixed
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information * scale[:, None] * scale, rcond=1e-10, hermitian=True)
    variance_error = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * scale
    std = np.maximum(scatter.visit_std, 1e-300)
    return np.where(scatter.visit_std > 0, variance_error[:joints] / (2.0 * std), np.inf)
