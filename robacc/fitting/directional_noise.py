"""Noise that is larger along one direction than along others, and scatter of the joints that only stands for it.

A camera measures its depth some three times worse than the two other coordinates, a tracker its angles worse than its
range. Scatter of the joints describes such a residual better than equal noise along all axes, because it, too, is
larger along some directions. It is reported as scatter only where it is more likely, too, than errors e ~ N(0, S) of
any covariance S of the three coordinates. Along the eigenvectors of the residual's covariance S is diagonal. Its
variances v_k, and that of the orientation, maximise the restricted likelihood of
:mod:`robacc.fitting.restricted_likelihood` by

    v_k <- v_k |(P r)_k|^2 / tr(P_kk).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from robacc.fitting.fit_repeatability import SIGNIFICANT, Repeatability, mixed_model
from robacc.fitting.fit_result import Fit
from robacc.fitting.noise import LackOfFit, lack_of_fit
from robacc.fitting.restricted_likelihood import MixedModel, RestrictedLikelihood, Variances
from robacc.fitting.whitening import Scatter
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import Noise

_PENALTY = 10.0
"""Akaike's penalty of the five numbers of S beyond one variance, in twice the log-likelihood."""
_ROUNDS = 30
_SETTLED = 1e-2
"""Change of the restricted log-likelihood below which the iteration stops."""


@dataclass(frozen=True, slots=True)
class NoiseAndScatter:
    """What the residual of a fit says of the instrument and of the arm."""

    noise: LackOfFit
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant beside the noise."""
    warnings: tuple[str, ...] = ()


def noise_and_scatter(fit: Fit, repeatability: Repeatability | None, data: Measurements) -> NoiseAndScatter:
    """Return noise and repeatability; directional noise without repeatability where scatter is not more likely."""
    if repeatability is None or fit.scatter is None or fit.scatter.is_none:
        return NoiseAndScatter(lack_of_fit(fit, data), repeatability)
    model = mixed_model(fit, data)[1]
    scattered = RestrictedLikelihood.at(model, Variances(fit.scatter, fit.misfit)).log_likelihood
    axes = _axes(model)
    variances, likelihood = _directional(_turned(model, axes), fit.misfit)
    if 2.0 * (scattered - likelihood) + _PENALTY > SIGNIFICANT:
        return NoiseAndScatter(lack_of_fit(fit, data), repeatability)
    total = variances[:3] + np.mean(model.known_var[:3])
    orientation = None
    if model.residual.shape[0] == 6:
        orientation = float(np.sqrt(variances[3] + np.mean(model.known_var[3:])))
    noise = Noise(float(np.sqrt(np.mean(total))), orientation, fit.noise.source)
    alone = dataclasses.replace(fit, scatter=None, noise=noise)
    return NoiseAndScatter(lack_of_fit(alone, data), None, (_warning(np.sqrt(total), axes),))


def _warning(std: Array, axes: Array) -> str:
    """Return the direction of the largest of three standard deviations (m) along the rows of ``axes``."""
    k = int(np.argmax(std))
    across = float(np.sqrt(np.mean(np.square(np.delete(std, k)))))
    axis = axes[k] * np.sign(axes[k][np.argmax(np.abs(axes[k]))])
    return (
        f"the error that remains is {std[k] / across:.2g} times as large along the direction "
        f"({', '.join(f'{value:.2f}' for value in axis + 0.0)}) of the measuring frame as across it, as noise of an "
        "instrument along its line of sight is; columns sigma_x, sigma_y, sigma_z make the fit allow for it"
    )


def _axes(model: MixedModel) -> Array:
    """Return ``(3, 3)`` eigenvectors of the residual's covariance, in rows.

    Where the stated uncertainty differs between the axes of the measuring frame, these are kept.
    """
    if not np.allclose(model.known_var[:3], model.known_var[:1], rtol=1e-6, atol=0.0):
        return np.eye(3)
    position = model.residual[:3]
    return np.asarray(np.linalg.eigh(position @ position.T)[1].T, dtype=np.float64)


def _turned(model: MixedModel, axes: Array) -> MixedModel:
    """Return the model with positions along ``axes``."""
    residual, design = model.residual.copy(), model.design.copy()
    residual[:3] = axes @ model.residual[:3]
    design[:3] = np.tensordot(axes, model.design[:3], axes=1)
    return dataclasses.replace(model, residual=residual, design=design)


def _directional(model: MixedModel, start: tuple[float, float]) -> tuple[Array, float]:
    """Return variances beyond the stated ones of x, y, z and all orientations, and the restricted log-likelihood.

    The iteration starts from standard deviations ``start`` of position (m) and orientation (rad).
    """
    count = model.residual.shape[0]
    groups = [slice(0, 1), slice(1, 2), slice(2, 3), slice(3, 6)][: 3 if count == 3 else 4]
    still = Scatter(np.zeros(model.columns.shape[1]), np.zeros(model.columns.shape[1]))
    floor = float(np.mean(np.square(model.residual[:3])))
    variances = np.array([max(start[0] ** 2, floor)] * 3 + [max(start[1] ** 2, 1e-16)])[: len(groups)]

    def at(values: Array) -> RestrictedLikelihood:
        known = model.known_var.copy()
        for group, value in zip(groups, values, strict=True):
            known[group] += value
        return RestrictedLikelihood.at(dataclasses.replace(model, known_var=known), Variances(still, (0.0, 0.0)))

    current = at(variances)
    for _ in range(_ROUNDS):
        traces = np.array([current.diagonal[group].sum() for group in groups])
        squares = np.array([np.sum(np.square(current.score[group])) for group in groups])
        moved = variances * squares / np.maximum(traces, 1e-300)
        following = at(moved)
        change = following.log_likelihood - current.log_likelihood
        if change <= 0.0:
            break
        variances, current = moved, following
        if change < _SETTLED:
            break
    return variances, current.log_likelihood
