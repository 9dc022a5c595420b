"""Tests of the measured errors against the prediction, with all poses of one robot treated jointly.

Both tests use :class:`robacc.prediction.sufficient_statistics.SufficientStatistics`: y_i ~ N(0, 1 + S_i²) independent,
all other directions N(0, 1).

- Chi-square: the normalised squared error e^T (J V J^T + Σ)^-1 e is Σ y_i²/(1 + S_i²) + |other directions|², with as
  many degrees of freedom as measured numbers (less those used by registration). Most of these depend on the noise only;
  the first sum, with one degree of freedom for each direction that the parameters move, depends on the tolerances.
- Likelihood ratio of the predicted covariance V against s² V with s² estimated. With about twenty directions of very
  different strength the chi-square limit is inaccurate, so the null distribution is simulated from the prediction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robacc.geometry import Array
from robacc.prediction.sufficient_statistics import SufficientStatistics
from robacc.statistics.distributions import chi2_cdf, chi2_quantile, chi2_sf

DRAWS = 1999
"""Samples of the likelihood ratio's null distribution; a p-value is a multiple of 1/2000, its error at 5 % is 0.5 %."""
SIGNIFICANT = 0.05

_LOG_SCALE_RANGE = 14.0
"""Range of log s² that is searched, ±: a factor of a million in variance."""
_GRID = 57
_ROUNDS = 7


@dataclass(frozen=True, slots=True)
class ChiSquare:
    """A sum of squares against its chi-square distribution."""

    statistic: float
    dof: int
    lower: float
    upper: float
    """The statistic lies between them with 95 % probability if the prediction is right."""
    p_value: float
    """Two-sided."""

    @classmethod
    def of(cls, statistic: float, dof: int) -> ChiSquare | None:
        """Return the test, or None without degrees of freedom."""
        if dof < 1:
            return None
        tail = 0.5 * SIGNIFICANT
        p = 2.0 * min(chi2_cdf(statistic, dof), chi2_sf(statistic, dof))
        return cls(statistic, dof, chi2_quantile(tail, dof), chi2_quantile(1.0 - tail, dof), min(1.0, p))

    @property
    def ratio(self) -> float:
        """Statistic over its expectation."""
        return self.statistic / self.dof


@dataclass(frozen=True, slots=True)
class ScaleTest:
    """Likelihood ratio of the predicted covariance against a scaled one."""

    factor: float
    """Estimated common scale of all tolerances: 1 as predicted, 2 twice as large."""
    statistic: float
    p_value: float
    """From ``draws`` samples of the prediction."""
    p_value_asymptotic: float
    """From a chi-square distribution with one degree of freedom, for comparison."""
    draws: int


@dataclass(frozen=True, slots=True)
class Consistency:
    """Tests of the measured errors against the prediction."""

    total: ChiSquare | None
    """All measured numbers; None if the noise was estimated from them."""
    parameters: ChiSquare | None
    """Directions that the parameters' errors move; None if there are none."""
    noise: ChiSquare | None
    """All other directions: the measurement noise; None if it was estimated from them."""
    scale: ScaleTest | None
    verdict: str
    """Conclusion as text."""


def consistency(statistics: SufficientStatistics, *, seed: int = 0) -> Consistency:
    """Test the prediction; ``seed`` is the seed of the likelihood ratio's null distribution."""
    normalised_squares = float(np.sum(np.square(statistics.y) / (1.0 + np.square(statistics.strength))))
    n_directions = statistics.y.size
    parameters = ChiSquare.of(normalised_squares, n_directions)
    noise_is_known = not statistics.noise_is_estimated
    total = (
        ChiSquare.of(normalised_squares + statistics.noise_squares, n_directions + statistics.noise_dof)
        if noise_is_known
        else None
    )
    noise = ChiSquare.of(statistics.noise_squares, statistics.noise_dof) if noise_is_known else None
    scale = scale_test(statistics.y, np.square(statistics.strength), seed) if n_directions else None
    return Consistency(total, parameters, noise, scale, _verdict(parameters, noise, scale))


def scale_test(y: Array, variances: Array, seed: int = 0) -> ScaleTest:
    """Test y_i ~ N(0, 1 + v_i) against N(0, 1 + s² v_i).

    Args:
        y: ``(R,)``
        variances: ``(R,)`` v, above zero.
        seed: Seed of the null distribution.
    """
    factors, statistic = _likelihood_ratios(y[None], variances)
    null_statistics = _null_distribution(variances.tobytes(), seed)
    n_exceeding = int(null_statistics.size - np.searchsorted(null_statistics, statistic[0] - 1e-9, side="left"))
    p_value = (1.0 + n_exceeding) / (1.0 + null_statistics.size)
    return ScaleTest(
        math.sqrt(float(factors[0])),
        float(statistic[0]),
        p_value,
        chi2_sf(float(statistic[0]), 1.0),
        int(null_statistics.size),
    )


@lru_cache(maxsize=16)
def _null_distribution(variances: bytes, seed: int) -> Array:
    """Return samples of the likelihood ratio under the prediction, ascending."""
    variance_array = np.frombuffer(variances)
    y = np.random.default_rng(seed).standard_normal((DRAWS, variance_array.size)) * np.sqrt(1.0 + variance_array)
    return np.sort(_likelihood_ratios(y, variance_array)[1])


def _log_likelihood(squares: Array, variances: Array, factor: Array) -> Array:
    """Return twice the log-likelihood, ``(D, F)``, of squares ``(D, R)`` at factors ``(D, F)`` or ``(F,)`` of s²."""
    total = 1.0 + factor[..., None] * variances
    result: Array = -np.sum(np.log(total) + squares[:, None, :] / total, axis=-1)
    return result


def _likelihood_ratios(y: Array, variances: Array) -> tuple[Array, Array]:
    """Return the most likely s² and the likelihood ratio, ``(D,)`` each, for samples ``(D, R)``.

    A grid over log s² locates the highest of possibly several maxima; finer grids refine it.
    """
    squares = np.square(y)
    grid = np.linspace(-_LOG_SCALE_RANGE, _LOG_SCALE_RANGE, _GRID)
    log_likelihood = _log_likelihood(squares, variances, np.exp(np.broadcast_to(grid, (y.shape[0], _GRID))))
    best = grid[np.argmax(log_likelihood, axis=1)]
    step = grid[1] - grid[0]
    for _ in range(_ROUNDS):
        candidates = best[:, None] + step * np.linspace(-1.0, 1.0, 9)
        log_likelihood = _log_likelihood(squares, variances, np.exp(candidates))
        best = np.take_along_axis(candidates, np.argmax(log_likelihood, axis=1)[:, None], axis=1)[:, 0]
        step /= 4.0
    # s² = 0, no effect of the parameters, is a limit that the grid cannot reach.
    no_effect = -np.sum(squares, axis=1)
    highest = np.maximum(np.max(log_likelihood, axis=1), no_effect)
    factor = np.where(no_effect >= np.max(log_likelihood, axis=1), 0.0, np.exp(best))
    at_prediction = _log_likelihood(squares, variances, np.ones((y.shape[0], 1)))[:, 0]
    return factor, np.maximum(highest - at_prediction, 0.0)


def _verdict(parameters: ChiSquare | None, noise: ChiSquare | None, scale: ScaleTest | None) -> str:
    if parameters is None or scale is None:
        return "the predicted errors are far below the noise on these poses, so the tolerances cannot be tested"
    sentences = []
    if min(parameters.p_value, scale.p_value) >= SIGNIFICANT:
        sentences.append("the measured errors are consistent with the tolerances")
    elif scale.p_value < SIGNIFICANT:
        comparative = "larger" if scale.factor > 1.0 else "smaller"
        sentences.append(
            f"the measured errors are {comparative} than the tolerances predict: about {scale.factor:.2g} times "
            "the predicted size"
        )
    else:
        sentences.append(
            "the measured errors have the predicted size but not the predicted pattern: some parameters have larger "
            "errors, or there are causes other than these parameters"
        )
    if noise is not None and noise.p_value < SIGNIFICANT:
        noise_ratio = math.sqrt(noise.ratio)
        cause = ": effects other than these parameters, or more noise than stated" if noise_ratio > 1.0 else ""
        sentences.append(f"the part that no parameter explains is {noise_ratio:.2g} times the stated noise{cause}")
    return "; ".join(sentences)
