"""Comparison of the prediction with measured poses of one robot: tests and estimated variance components."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.fitting import registration
from robacc.fitting.registration import Alignment
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.observation import residuals
from robacc.prediction.components import SufficientStatistics, VarianceComponents, reduce_residuals, variance_components
from robacc.prediction.tolerances import ToleranceParameter
from robacc.robots.description import Robot
from robacc.statistics.distributions import chi2_cdf, chi2_quantile, chi2_sf

# Tests of the measured errors against the prediction, with all poses of one robot treated jointly.
#
# Both tests use :class:`robacc.prediction.components.SufficientStatistics`: y_i ~ N(0, 1 + S_i²)
# independent, all other directions N(0, 1).
#
# - Chi-square: the normalised squared error e^T (J V J^T + Σ)^-1 e is Σ y_i²/(1 + S_i²) + |other directions|², with as
#   many degrees of freedom as measured numbers (less those used by registration). Most of these depend on the noise
#   only;
#   the first sum, with one degree of freedom for each direction that the parameters move, depends on the tolerances.
# - Likelihood ratio of the predicted covariance V against s² V with s² estimated. With about twenty directions of very
#   different strength the chi-square limit is inaccurate, so the null distribution is simulated from the prediction.

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


_MIN_REGISTERED_POSES = 3
"""With fewer poses, base and tool absorb everything that was measured."""
_HINT_FACTOR = 20.0
"""Errors larger than the prediction by this factor come from frames or units, not from tolerances."""

Noise = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class MeasuredComparison:
    """Result of :func:`compare_with_measured`."""

    n_poses: int
    source: str
    position_rms: float
    """RMS of the measured errors after registration, m."""
    orientation_rms: float | None
    """rad; None if no orientation was measured."""
    alignment: Alignment | None
    statistics: SufficientStatistics
    consistency: Consistency
    components: VarianceComponents | None
    hint: str | None
    """Likely cause of errors that are too large for tolerances."""
    one_draw: str
    """Effect of the single robot on the tests, and how they account for it."""


def compare_with_measured(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    align: Sequence[str] = (),
    noise: Noise = (None, None),
    confidence: float = 0.95,
    seed: int = 0,
) -> MeasuredComparison:
    """Test the measured errors against the prediction, and estimate the tolerances from them.

    Args:
        robot: Nominal robot; its effects are part of the command.
        data: Measured poses with joint variables.
        parameters: Parameters with predicted errors.
        align: ``base_frame``, ``tool_frame`` or both are fitted to the poses first.
        noise: See :func:`robacc.prediction.components.reduce_residuals`.
        confidence: Confidence of the components' intervals.
        seed: Seed of the likelihood ratio's null distribution.

    Raises:
        InputError: There are no poses or no joints, or the noise cannot be estimated.
        UsageError: The noise is not positive, the confidence is out of range, or a frame cannot be fitted.
    """
    _check_arguments(data, noise, confidence)
    alignment = registration.align(robot, data, align) if align else None
    registered_robot = robot if alignment is None else alignment.robot
    if alignment is not None and data.n < _MIN_REGISTERED_POSES:
        fix = "measure more poses, or leave out `align`"
        text = f"fitting frames to {data.n} poses leaves no errors to compare"
        raise InputError(Problem(text, data.source, fix=fix))
    statistics = reduce_residuals(registered_robot, data, parameters, noise=noise, aligned=tuple(align))
    errors = residuals(data, predict(registered_robot, data))
    tests = consistency(statistics, seed=seed)
    hint = None
    if tests.scale is not None and tests.scale.factor >= _HINT_FACTOR:
        hint = "errors this large come from units, joint signs or the order of the joints, not from tolerances"
        if alignment is None:
            hint = 'errors this large come from frames that do not agree; try `align="base_frame,tool_frame"`'
    return MeasuredComparison(
        data.n,
        data.source or "the data",
        rms_length(errors[:3]),
        None if data.rotation is None else rms_length(errors[3:]),
        alignment,
        statistics,
        tests,
        variance_components(statistics, parameters, confidence),
        hint,
        _one_draw(statistics),
    )


def _check_arguments(data: Measurements, noise: Noise, confidence: float) -> None:
    if data.n == 0:
        raise InputError(Problem("has no poses to compare with the prediction", data.source))
    if data.q is None:
        fix = "add q1, q2, …"
        raise InputError(Problem("has no joint columns: the comparison needs the joint values", data.source, fix=fix))
    if any(value is not None and not (math.isfinite(value) and value > 0.0) for value in noise):
        raise UsageError("`noise` is a standard deviation above 0")
    if not 0.5 <= confidence < 1.0:
        raise UsageError(f"the confidence must be at least 0.5 and less than 1, not {confidence:g}")


def _one_draw(statistics: SufficientStatistics) -> str:
    n_directions = statistics.y.size
    text = (
        f"all {statistics.n_poses} poses are of one robot and share the same parameter errors, so they are not "
        f"{statistics.n_poses} independent tests of the tolerances. The tests use the covariance of all poses, "
        f"J V Jᵀ + noise. Of {statistics.n_values} measured numbers, {n_directions} depend on the parameters"
    )
    if n_directions:
        # The standard deviation of a variance from n Gaussian numbers is sqrt(2/n), of its root half that.
        relative_std = 100.0 / math.sqrt(2.0 * n_directions)
        text += f": the size of the tolerances is known to about {relative_std:.0f} %"
        text += (
            "; more robots improve it, more poses do not" if statistics.noise_dof else "; more poses would improve it"
        )
    if statistics.n_aligned:
        text += f". Fitting the frames used {statistics.n_aligned} degrees of freedom, which are not counted"
    return text
