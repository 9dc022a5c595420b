"""Is the measured error what the tolerances predict? Chi-square and likelihood-ratio tests that respect the one draw.

Both work on :class:`robacc.prediction.sufficient_statistics.Evidence`: y_i ~ N(0, 1 + S_i²) independent, the rest N(0, 1).

- The normalised squared error e^T (J V J^T + Σ)^-1 e is Σ y_i²/(1 + S_i²) + rest, chi-square with as many degrees of
  freedom as numbers were measured (less those that an alignment used). Most of these speak of the noise alone; the
  first sum, with one degree of freedom for each direction that the parameters move, speaks of the tolerances.
- Likelihood ratio of the predicted covariance V against s² V with s² estimated. With some twenty directions of very
  unequal strength the chi-square limit is only near, so the null distribution is drawn from the prediction itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robacc.geometry import Array
from robacc.prediction.sufficient_statistics import Evidence
from robacc.statistics.distributions import chi2_cdf, chi2_quantile, chi2_sf

DRAWS = 1999
"""Of the likelihood ratio's null distribution; the p-value is a multiple of 1/2000 and its error at 5 % is 0.5 %."""
SIGNIFICANT = 0.05

_WIDEST = 14.0
"""exp(± 14) times the predicted variance is looked at: a millionfold."""
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
        """None where there is nothing to test."""
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
    """Likelihood ratio of the predicted covariance against the same one scaled to fit."""

    factor: float
    """The estimated scale of all tolerances alike: 1 as predicted, 2 twice as large."""
    statistic: float
    p_value: float
    """From ``draws`` drawn from the prediction."""
    p_value_asymptotic: float
    """From a chi-square with one degree of freedom, for comparison."""
    draws: int


@dataclass(frozen=True, slots=True)
class Consistency:
    """Measured against predicted."""

    total: ChiSquare | None
    """All measured numbers; None where the noise was estimated from them."""
    parameters: ChiSquare | None
    """The directions that the parameters' errors move; None where no parameter moves any."""
    noise: ChiSquare | None
    """All other directions: the measuring noise; None where it was estimated from them."""
    scale: ScaleTest | None
    verdict: str
    """In plain words."""


def consistency(evidence: Evidence, *, seed: int = 0) -> Consistency:
    """Test the prediction; ``seed`` is of the likelihood ratio's null distribution."""
    weighed = float(np.sum(np.square(evidence.y) / (1.0 + np.square(evidence.strength))))
    directions = evidence.y.size
    parameters = ChiSquare.of(weighed, directions)
    known = not evidence.noise_is_estimated
    total = ChiSquare.of(weighed + evidence.rest, directions + evidence.rest_dof) if known else None
    noise = ChiSquare.of(evidence.rest, evidence.rest_dof) if known else None
    scale = scale_test(evidence.y, np.square(evidence.strength), seed) if directions else None
    return Consistency(total, parameters, noise, scale, _verdict(parameters, noise, scale))


def scale_test(y: Array, variances: Array, seed: int = 0) -> ScaleTest:
    """Test y_i ~ N(0, 1 + v_i) against N(0, 1 + s² v_i).

    Args:
        y: ``(R,)``
        variances: ``(R,)`` v, above zero.
        seed: Of the null distribution.
    """
    best, statistic = _ratio(y[None], variances)
    null = _null(variances.tobytes(), seed)
    beyond = int(null.size - np.searchsorted(null, statistic[0] - 1e-9, side="left"))
    p = (1.0 + beyond) / (1.0 + null.size)
    return ScaleTest(
        math.sqrt(float(best[0])), float(statistic[0]), p, chi2_sf(float(statistic[0]), 1.0), int(null.size)
    )


@lru_cache(maxsize=16)
def _null(variances: bytes, seed: int) -> Array:
    """The likelihood ratio's distribution where the prediction is right, ascending."""
    v = np.frombuffer(variances)
    y = np.random.default_rng(seed).standard_normal((DRAWS, v.size)) * np.sqrt(1.0 + v)
    return np.sort(_ratio(y, v)[1])


def _log_likelihood(squares: Array, variances: Array, factor: Array) -> Array:
    """Twice the log-likelihood, ``(D, F)``, of squares ``(D, R)`` at factors ``(D, F)`` or ``(F,)`` of s²."""
    total = 1.0 + factor[..., None] * variances
    result: Array = -np.sum(np.log(total) + squares[:, None, :] / total, axis=-1)
    return result


def _ratio(y: Array, variances: Array) -> tuple[Array, Array]:
    """The most likely s² and the likelihood ratio, ``(D,)`` each, for draws ``(D, R)``.

    A grid over log s² finds the highest of what may be several maxima; grids within it refine that one.
    """
    squares = np.square(y)
    grid = np.linspace(-_WIDEST, _WIDEST, _GRID)
    height = _log_likelihood(squares, variances, np.exp(np.broadcast_to(grid, (y.shape[0], _GRID))))
    best = grid[np.argmax(height, axis=1)]
    step = grid[1] - grid[0]
    for _ in range(_ROUNDS):
        trial = best[:, None] + step * np.linspace(-1.0, 1.0, 9)
        height = _log_likelihood(squares, variances, np.exp(trial))
        best = np.take_along_axis(trial, np.argmax(height, axis=1)[:, None], axis=1)[:, 0]
        step /= 4.0
    # No effect of the parameters at all is the limit that the grid cannot reach.
    none = -np.sum(squares, axis=1)
    top = np.maximum(np.max(height, axis=1), none)
    factor = np.where(none >= np.max(height, axis=1), 0.0, np.exp(best))
    at_one = _log_likelihood(squares, variances, np.ones((y.shape[0], 1)))[:, 0]
    return factor, np.maximum(top - at_one, 0.0)


def _verdict(parameters: ChiSquare | None, noise: ChiSquare | None, scale: ScaleTest | None) -> str:
    if parameters is None or scale is None:
        return "the parameters' predicted errors are far below the noise at these poses: nothing can be said of them"
    sentences = []
    if min(parameters.p_value, scale.p_value) >= SIGNIFICANT:
        sentences.append("the measured errors are consistent with the tolerances")
    elif scale.p_value < SIGNIFICANT:
        word = "larger" if scale.factor > 1.0 else "smaller"
        sentences.append(
            f"the measured errors are {word} than the tolerances predict: about {scale.factor:.2g} times "
            "the predicted size"
        )
    else:
        sentences.append(
            "the measured errors are of the predicted size on the whole but not of the predicted pattern: some "
            "parameters err by more, or something other than these parameters errs"
        )
    if noise is not None and noise.p_value < SIGNIFICANT:
        size = math.sqrt(noise.ratio)
        word = "more" if size > 1.0 else "less"
        cause = ": effects other than these parameters, or noise beyond the stated one" if size > 1.0 else ""
        sentences.append(f"what no parameter explains is {word} than the stated noise, {size:.2g} times{cause}")
    return "; ".join(sentences)
