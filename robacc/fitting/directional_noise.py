"""Noise that is larger along one direction than along others, and scatter of the joints that only stands for it.

A camera measures its depth some three times worse than the two other coordinates, a tracker its angles worse than its
range. Equal weights then spoil the good coordinates with the bad one, so the fit is repeated with weights by direction
(:mod:`robacc.tracing.directional_weights`).

Scatter of the joints describes such a residual better than equal noise along all axes, because it, too, is larger along
some directions. It is reported as scatter only where it is more likely, too, than errors e ~ N(0, S) of any covariance
S of the three coordinates. Along the eigenvectors of the residual's covariance S is diagonal. Its variances v_k, and
that of the orientation, maximise the restricted likelihood of :mod:`robacc.fitting.restricted_likelihood` by

    v_k <- v_k |(P r)_k|^2 / tr(P_kk).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.fitting.fit_repeatability import SIGNIFICANT, Repeatability, mixed_model
from robacc.fitting.fit_result import Fit
from robacc.fitting.noise import LackOfFit, lack_of_fit, variances_of_repeats
from robacc.fitting.restricted_likelihood import MixedModel, RestrictedLikelihood, Variances
from robacc.fitting.whitening import Scatter
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import Noise

_PENALTY = 10.0
"""Akaike's penalty of the five numbers of S beyond one variance, in twice the log-likelihood."""
_EACH_AXIS = (slice(0, 1), slice(1, 2), slice(2, 3))
_EQUAL_AXES = (slice(0, 3),)
_ROUNDS = 30
_SETTLED = 1e-2
"""Change of the restricted log-likelihood below which the iteration stops."""
_CLEAR = 30.0
"""Twice the log-likelihood by which directional noise must be more likely than equal noise: 1 in 70,000 by chance
(chi-square of five degrees), some times as often with few poses."""
_LEAST_RATIO = 2.0
"""Ratio of the largest standard deviation to the smallest from which a fit allows for it: a smaller one costs the
coefficients less than a fifth of their accuracy."""
_SUSPECTED = 1.5
"""The same ratio in the residual, below which nothing is tested."""


@dataclass(frozen=True, slots=True)
class DirectionalNoise:
    """Noise of different size along three axes."""

    axes: Array
    """``(3, 3)`` axes in the measuring frame, in rows."""
    std: Array
    """``(3,)`` standard deviations along them, m."""

    @property
    def ratio(self) -> float:
        """Return the ratio of the largest standard deviation to the smallest."""
        return float(self.std.max() / max(self.std.min(), 1e-300))

    @property
    def beyond_least(self) -> tuple[tuple[float, float, float], ...]:
        """Return the covariance in the measuring frame beyond equal noise of the least standard deviation, m²."""
        excess = np.square(self.std) - np.square(self.std.min())
        return tuple((x, y, z) for x, y, z in (self.axes.T @ (excess[:, None] * self.axes)).tolist())

    @property
    def _structure(self) -> str:
        """Return the direction that differs from the two others, and by how much."""
        small, middle, large = np.sort(self.std)
        is_smaller = middle / small > large / middle
        k = int(np.argmin(self.std) if is_smaller else np.argmax(self.std))
        across = float(np.sqrt(np.mean(np.square(np.delete(self.std, k)))))
        axis = self.axes[k] * np.sign(self.axes[k][np.argmax(np.abs(self.axes[k]))])
        direction = f"the direction ({', '.join(f'{value:.2f}' for value in axis + 0.0)}) of the measuring frame"
        if is_smaller:
            return f"the error that remains is {across / self.std[k]:.2g} times as large across {direction} as along it"
        return f"the error that remains is {self.std[k] / across:.2g} times as large along {direction} as across it"

    @property
    def warning(self) -> str:
        """Return the direction that differs, for a fit that weighted all directions equally."""
        return (
            f"{self._structure}: the model lacks an effect, or the instrument's noise differs along its line of sight; "
            "if it is noise, state it in the columns sigma_x, sigma_y, sigma_z, and the fit allows for it"
        )

    @property
    def message(self) -> str:
        """Return the direction that differs, for a fit that allowed for it."""
        sizes = ", ".join(f"{1e3 * std:.3g}" for std in self.std)
        return (
            f"{self._structure} (an instrument's noise may differ along its line of sight): {sizes} mm along three "
            "axes; the fit weights each direction by its own noise"
        )


@dataclass(frozen=True, slots=True)
class NoiseAndScatter:
    """What the residual of a fit says of the instrument and of the arm."""

    noise: LackOfFit
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant given the noise."""
    directional: DirectionalNoise | None = None
    """Noise that is much larger along one direction than along others; None if it is not."""

    def noise_unless(self, shared: Sequence[str]) -> DirectionalNoise | None:
        """Return the directional noise, unless errors that poses share make it an error of the model."""
        return None if shared else self.directional

    def warnings_if(self, shared: Sequence[str]) -> tuple[str, ...]:
        """Return the warning of an error of the model that is larger along a direction."""
        return (self.directional.warning,) if shared and self.directional is not None else ()


def noise_and_scatter(fit: Fit, repeatability: Repeatability | None, data: Measurements) -> NoiseAndScatter:
    """Return noise and repeatability; directional noise without repeatability where scatter is not more likely."""
    if data.noise_covariance is not None:
        return NoiseAndScatter(lack_of_fit(fit, data), repeatability)
    if repeatability is None or fit.scatter is None or fit.scatter.is_none:
        return NoiseAndScatter(lack_of_fit(fit, data), repeatability, _beside_equal_noise(fit, data))
    model = mixed_model(fit, data)[1]
    scattered = RestrictedLikelihood.at(model, Variances(fit.scatter, fit.misfit)).log_likelihood
    noise, likelihood, variance_of_angles = _directional_noise(model, fit.misfit)
    if 2.0 * (scattered - likelihood) + _PENALTY > SIGNIFICANT:
        return NoiseAndScatter(lack_of_fit(fit, data), repeatability)
    orientation = None
    if model.residual.shape[0] == 6:
        orientation = float(np.sqrt(variance_of_angles + np.mean(model.known_var[3:])))
    along = np.square(noise.axes.T) @ np.square(noise.std)
    alone = dataclasses.replace(fit, scatter=None, noise=Noise.of_variances(along, orientation, fit.noise.source))
    return NoiseAndScatter(lack_of_fit(alone, data), None, noise)


def _beside_equal_noise(fit: Fit, data: Measurements) -> DirectionalNoise | None:
    """Return directional noise that is significantly more likely than noise that is equal along all axes."""
    residual = fit.residual[:3, fit.inliers]
    if data.q is None or data.position_variance is not None or residual.shape[1] < 2:
        return None
    squares = np.linalg.eigvalsh(residual @ residual.T)
    if squares[2] <= _SUSPECTED**2 * max(squares[0], 1e-300):
        return None
    model = mixed_model(fit, data)[1]
    equal = _most_likely(model, fit.misfit, _EQUAL_AXES)[1]
    noise, likelihood, _ = _directional_noise(model, fit.misfit)
    if 2.0 * (likelihood - equal) <= _CLEAR or noise.ratio < _LEAST_RATIO:
        return None
    return noise if _in_repeats(noise, fit, data) else None


def _directional_noise(model: MixedModel, start: tuple[float, float]) -> tuple[DirectionalNoise, float, float]:
    """Return noise of any covariance, the restricted log-likelihood and the variance of the orientation (rad²).

    The axes are those of the measuring frame, unless others are more likely: coordinates are then not correlated.
    """
    (variances, likelihood), axes = _most_likely(model, start, _EACH_AXIS), np.eye(3)
    turned_axes = _axes(model)
    turned = _most_likely(_turned(model, turned_axes), start, _EACH_AXIS)
    if 2.0 * (turned[1] - likelihood) > SIGNIFICANT:
        (variances, likelihood), axes = turned, turned_axes
    noise = DirectionalNoise(axes, np.sqrt(variances[:3] + np.mean(model.known_var[:3])))
    return noise, likelihood, float(variances[-1])


def _in_repeats(noise: DirectionalNoise, fit: Fit, data: Measurements) -> bool:
    """Return whether repeats of a pose, if there are any, differ along the axes as much as the residual does."""
    repeats = variances_of_repeats(noise.axes @ fit.residual[:3], fit, data)
    if repeats is None:
        return True
    largest, smallest = np.argmax(noise.std), np.argmin(noise.std)
    return bool(repeats[0][largest] >= _SUSPECTED**2 * repeats[0][smallest])


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


def _most_likely(model: MixedModel, start: tuple[float, float], axes: tuple[slice, ...]) -> tuple[Array, float]:
    """Return the most likely variances beyond the stated ones, and the restricted log-likelihood.

    The variances are those of the groups ``axes`` of coordinates, and of all orientations. The iteration starts from
    standard deviations ``start`` of position (m) and orientation (rad).
    """
    groups = axes if model.residual.shape[0] == 3 else (*axes, slice(3, 6))
    floor = float(np.mean(np.square(model.residual[:3])))
    variances = np.array([max(start[0] ** 2, floor)] * len(axes) + [max(start[1] ** 2, 1e-16)])[: len(groups)]

    def at(values: Array) -> RestrictedLikelihood:
        known = model.known_var.copy()
        for group, value in zip(groups, values, strict=True):
            known[group] += value
        return RestrictedLikelihood.at(
            dataclasses.replace(model, known_var=known), Variances(_still(model), (0.0, 0.0))
        )

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


def _still(model: MixedModel) -> Scatter:
    """Return no scatter of the joints."""
    joints = model.columns.shape[1]
    return Scatter(np.zeros(joints), np.zeros(joints))
