"""Expected result of a campaign before anything is measured: standard errors, accuracy over the number of poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.parameters import CORRELATED, Correlation
from robacc.fitting.priors import BADLY_MADE
from robacc.geometry import Array
from robacc.planning.design import DesignProblem, exchanged, information_of, region_variance
from robacc.planning.linear_model import PlannedCoefficients

ENOUGH_GAIN = 0.1
"""Ten more poses are not worth their time if they reduce the predicted error by less than this share."""
BATCH = 10
_RANDOM_DRAWS = 10
_CURVE_POINTS = 8
"""Numbers of poses, besides the planned number, that the curve has at most."""
CURVE_EXCHANGED = 200
"""Candidates that exchange looks at for a point of the curve."""
_SINGULAR = 1e14
"""Condition number above which an information matrix counts as singular."""


@dataclass(frozen=True, slots=True)
class ExpectedCoefficient:
    """Predicted standard error of one coefficient."""

    name: str
    unit: str
    std: float | None
    """Standard error after the fit; None if it is not identifiable."""
    prior_std: float | None
    why: str | None = None


@dataclass(frozen=True, slots=True)
class AccuracyPoint:
    """Predicted error over the task's region after a fit to ``n`` poses, m."""

    n: int
    rms: float
    """Square root of the mean variance over the region, from the coefficients' uncertainty."""
    worst: float
    """The same at the worst task pose."""
    total: float
    """RMS with the repeatability and the unexplained error, which no fit removes."""
    random_rms: float | None
    """Mean RMS of random feasible poses in the same number; None if they do not identify the model."""


@dataclass(frozen=True, slots=True)
class ExpectedAccuracy:
    """Accuracy over the number of poses."""

    points: tuple[AccuracyPoint, ...]
    knee: int | None
    """Number of poses from which ten more reduce the total error by less than a tenth; None beyond the curve."""
    planned: AccuracyPoint | None
    """The planned poses; None if they do not identify the model."""


@dataclass(frozen=True, slots=True)
class Worth:
    """Predicted RMS error over the region for equal effort spent in different ways, m."""

    new_poses: float | None
    repeated_poses: float | None
    """Half as many poses, each visited twice."""
    readings: float | None
    """The same poses, each read twice at one visit: less instrument noise, the same repeatability."""
    verdict: str


@dataclass(frozen=True, slots=True)
class Sufficiency:
    """Answer to whether the poses measured so far are enough."""

    n: int
    """Poses measured already, or those of the model's fit."""
    enough: bool
    why: str
    now: float | None
    """Predicted error now, m rms; None where the poses do not identify the model."""
    later: float | None
    """Predicted error with the next poses."""
    of_model: bool = False
    """The poses are those that the model was fitted to."""


def expected_coefficients(planned: PlannedCoefficients, covariance: Array | None) -> tuple[ExpectedCoefficient, ...]:
    """Return the predicted standard error of every coefficient, in the order of the effects."""
    place = {int(column): i for i, column in enumerate(planned.columns)}
    why = {entry.name: entry.why for entry in planned.dropped}
    too_few = None if covariance is not None else "the planned poses are too few for this model"
    result = []
    for number, term in enumerate(planned.terms):
        if (i := place.get(number)) is None:
            result.append(ExpectedCoefficient(term.name, term.unit, None, None, why.get(term.name)))
        else:
            std = None if covariance is None else float(np.sqrt(covariance[i, i]))
            result.append(ExpectedCoefficient(term.name, term.unit, std, float(planned.prior_std[i]), too_few))
    return tuple(result)


def expected_correlations(planned: PlannedCoefficients, covariance: Array | None) -> tuple[Correlation, ...]:
    """Return pairs of coefficients whose estimates will be strongly correlated, strongest first."""
    if covariance is None:
        return ()
    std = np.sqrt(np.diag(covariance))
    matrix = covariance / std[:, None] / std
    names = planned.names
    first, second = np.nonzero(np.triu(np.abs(matrix) > CORRELATED, 1))
    pairs = [
        Correlation(names[i], names[j], float(matrix[i, j]))
        for i, j in zip(first.tolist(), second.tolist(), strict=True)
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.value)))


@dataclass(frozen=True, slots=True)
class Expectation:
    """Computation of predicted errors for sets of candidates."""

    rows: Array
    """``(N, M, P)`` whitened columns of the candidates, identifiable coefficients."""
    region: Array
    """``(3, T, P)`` displacement of the target at the task's poses, m."""
    planned: PlannedCoefficients
    already: Array
    """``(P, P)`` information of poses measured already."""
    floor: float
    """Error that no fit removes, m: repeatability and unexplained error, length of the vector, rms."""

    def covariance(self, rows: Array) -> Array | None:
        """Return ``(P, P)`` covariance of the errors of a fit to poses ``(n, M, P)`` and those measured already.

        It is the mean over arms whose constants deviate by their usual size. Constants have the fit's broad prior
        (:mod:`robacc.fitting.priors`). None where the poses do not suffice.
        """
        normal = self.already + information_of(rows)
        precision = np.diag(self.planned.broad_std**-2.0)
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = (normal + precision) / scale[:, None] / scale
        if np.linalg.cond(scaled) > _SINGULAR:
            return None
        gain = np.linalg.inv(scaled) / scale[:, None] / scale
        # The prior is wider than the usual deviations, so the error is less than the posterior covariance says.
        result: Array = gain @ (normal + precision / BADLY_MADE**2) @ gain
        return result

    def point(self, rows: Array, n: int, random_rms: float | None = None) -> AccuracyPoint | None:
        """Return the predicted accuracy of poses ``(n, M, P)``."""
        covariance = self.covariance(rows)
        if covariance is None:
            return None
        variance = region_variance(self.region, covariance)
        mean = float(np.mean(variance))
        return AccuracyPoint(n, mean**0.5, float(variance.max()) ** 0.5, (mean + self.floor**2) ** 0.5, random_rms)

    def random_rms(self, n: int, seed: int) -> float | None:
        """Return the mean RMS of ``n`` random feasible poses over several draws; None if a draw does not suffice."""
        generator, count = np.random.default_rng([seed, n]), self.rows.shape[0]
        draws = [generator.choice(count, min(n, count), replace=False) for _ in range(_RANDOM_DRAWS)]
        points = [self.point(self.rows[at], n) for at in draws]
        values = [point.rms for point in points if point is not None]
        return float(np.mean(values)) if len(values) == _RANDOM_DRAWS else None


def expected_accuracy(
    expectation: Expectation, problem: DesignProblem, order: NDArray[np.int64], chosen: NDArray[np.int64], seed: int
) -> ExpectedAccuracy:
    """Return the predicted accuracy over the number of poses, planned and random, and of the chosen poses.

    The curve ends at the number of poses in ``order``, a greedy design.
    """
    _, n_rows, n_coefficients = problem.rows.shape
    first = BATCH // 2 if expectation.already.any() else -(-n_coefficients // n_rows) + 2
    numbers = np.unique(np.round(np.geomspace(min(first, order.size), order.size, _CURVE_POINTS)).astype(int))
    points = {}
    for n in {*numbers.tolist(), chosen.size}:
        design = chosen if n == chosen.size else exchanged(problem, order[:n], CURVE_EXCHANGED)
        points[n] = expectation.point(expectation.rows[design], n, expectation.random_rms(n, seed))
    known = [point for _, point in sorted(points.items()) if point is not None]
    return ExpectedAccuracy(tuple(known), _knee(known), points[chosen.size])


def _knee(points: Sequence[AccuracyPoint]) -> int | None:
    """Return the smallest number from which ten more poses gain little; between the points, log error over log n."""
    if len(points) < 2:
        return None
    log_n = np.log([point.n for point in points])
    log_total = np.log([point.total for point in points])
    for n in range(points[0].n, points[-1].n - BATCH + 1):
        now, later = np.interp(np.log([n, n + BATCH]), log_n, log_total)
        if later - now > np.log(1.0 - ENOUGH_GAIN):
            return n
    return None


def worth_of(expectation: Expectation, efforts: tuple[Array, Array, Array]) -> Worth:
    """Return the comparison of rows ``(n, M, P)`` of new poses, repeats, and readings, and its verdict in words."""
    points = [expectation.point(rows, rows.shape[0]) for rows in efforts]
    names = ("new poses are", "a second visit of half as many poses is", "a second reading at every pose is")
    known = [(point.total, name) for name, point in zip(names, points, strict=True) if point is not None]
    verdict = f"{min(known)[1]} worth most" if known else "the planned poses are too few for this model"
    new, repeated, readings = (None if point is None else point.rms for point in points)
    return Worth(new, repeated, readings, verdict)


def sufficiency_of(
    expectation: Expectation, chosen: NDArray[np.int64], n: int, target: float | None, of_model: bool
) -> Sufficiency:
    """Return whether ``n`` known poses are enough, with the next poses ``chosen``.

    Args:
        expectation: Predicted errors, with the information of the known poses.
        chosen: Next poses.
        n: Number of known poses.
        target: Predicted error that is good enough, m; None to ask what the next poses gain.
        of_model: The known poses are those that the model was fitted to.
    """
    now = expectation.point(expectation.rows[:0], 0)
    later = expectation.point(expectation.rows[chosen], chosen.size)
    if now is None or later is None:
        enough, why = False, "the poses so far do not identify all coefficients"
    elif target is not None:
        enough = now.rms <= target
        why = f"the predicted error of {now.rms * 1e3:.3g} mm {'meets' if enough else 'exceeds'} the target"
    else:
        gain = 1.0 - later.total / now.total
        enough, why = gain < ENOUGH_GAIN, f"{chosen.size} more poses reduce the predicted error by {100 * gain:.0f} %"
    totals = [None if point is None else point.total for point in (now, later)]
    return Sufficiency(n, enough, why, totals[0], totals[1], of_model)
