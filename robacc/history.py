"""Results of one arm over time, and of many arms: what changed, when, and which arm is unlike the others.

Stored tests: changes of one arm over its tests (what, when, by how much, and how), and differences between arms.

A series is ``y = c + k T + changes + e``: the value of each test, with the temperature T where it was recorded. A
change is a step (a collision, a new mastering, a frame set up anew) or a ramp (wear) that begins after one of the
tests; a single test may be unlike the others. The error e has the variance that the fit of the test states, times a
factor that the series itself shows: tests differ by more than their noise. Few tests show the factor of one series
badly, so that it is estimated together with those of the other series.

Source of the factor: G. K. Smyth, "Linear models and empirical Bayes methods for assessing differential expression in
microarray experiments", Statistical Applications in Genetics and Molecular Biology 3, 2004, section 6. Degrees of
freedom of successive differences: J. von Neumann, Annals of Mathematical Statistics 12, 1941. Number of independent
values in a correlated series: M. S. Bartlett, Journal of the Royal Statistical Society 98, 1935.
"""

import json
import math
import os
import re
import sqlite3
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from robacc.comparison.stored_results import FITS, read_compared_result, unit_of
from robacc.documents.envelope import StoredResult, understood
from robacc.documents.history import date_text
from robacc.effects.frames import JointOffset, LinkGeometry
from robacc.effects.specification import absorbed
from robacc.errors import InputError, Problem, by_key, refuse
from robacc.fitting.levels import ACCEPTED, NEW, NORMAL_95
from robacc.fitting.parameters import apply_fit
from robacc.fitting.solver import fit
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model, residuals
from robacc.prediction.model_uncertainty import ModelFit, blocks_with_frames, fitted_jacobian
from robacc.robots.description import Robot
from robacc.statistics.intervals import TINY, chi2_quantile, f_sf, normal_cdf, normal_quantile, root, student_quantile

YEAR = 365.25 * 86400.0
"""s"""
_MOST_LEVEL = 0.05
"""Level of tests that are rare."""
POWER = 0.95
"""Probability that a change of the size of the detection limit is found in the first test after it."""
SETUP = ("base_frame.", "tool_frame.")
"""Coefficients of the set-up."""
Entry = Mapping[str, Any]
"""Change, limit, coefficient over the arms, arm unlike the others, or covariance, by the keys of the result."""
_SHAPES = ("step", "ramp", "single test")
_SAFE = 0.999
"""Share of a critical value above which a series is searched on its own, so that rounding hides no change."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmSeries:
    """Values of one coefficient or figure in the tests of an arm, in the order of time."""

    key: str
    unit: str
    times: Array
    """``(n,)`` s since 1970"""
    values: Array
    """``(n,)``"""
    stds: Array
    """``(n,)`` standard deviations that the tests state."""
    temperatures: Array
    """``(n,)`` °C; NaN where a test recorded none."""
    rivals: tuple[str, ...] = ()
    """Coefficients that the poses of the tests cannot distinguish from this one."""

    @property
    def is_of_setup(self) -> bool:
        """Whether a change is one of the set-up: where the robot stands, or where the target sits."""
        return self.key.startswith(SETUP)


class Spread(NamedTuple):
    """Distribution of the factors of variance over the series: scaled inverse chi-square."""

    factor: float
    dof: float

    @classmethod
    def of(cls, series: Sequence[ArmSeries]) -> "Spread":
        """Return the distribution that the differences of successive tests show."""
        from scipy.special import digamma, polygamma

        several = [one for one in series if len(one.values) > 1]
        if len(several) < 2:
            return cls(1.0, 0.0)
        n = np.array([len(one.values) for one in several])
        half = (n - 1.0) ** 2 / (3.0 * n - 4.0)
        values, variances = (np.concatenate([getattr(one, name) for one in several]) for name in ("values", "stds"))
        variances = np.square(variances)
        ratios = np.square(np.diff(values, append=0.0)) / (variances + np.append(variances[1:], 0.0))
        ratios[np.cumsum(n) - 1] = 0.0  # from one series to the next
        squares = np.add.reduceat(ratios, np.cumsum(n) - n) / (n - 1)
        logs = np.log(np.maximum(squares, TINY)) - digamma(half) + np.log(half)
        excess = float(np.var(logs, ddof=1) - np.mean(polygamma(1, half)))
        if excess <= 0.0:
            return cls(math.exp(float(np.mean(logs))), math.inf)
        own = math.exp(root(lambda log: float(polygamma(1, math.exp(log))) - excess, -20.0, 20.0))
        return cls(math.exp(float(np.mean(logs) + digamma(own)) - math.log(own)), 2.0 * own)


class _Fit:
    """Weighted least squares of ``values (…, n)`` with standard deviations ``stds`` and columns ``x (…, b, n)``."""

    def __init__(self, values: Array, stds: Array, x: Array, spread: Spread) -> None:
        self.weights = 1.0 / np.square(stds)
        self.weighted = x * self.weights[..., None, :]
        self.inverse = np.linalg.inv(self.weighted @ np.swapaxes(x, -1, -2))
        self.coefficients = (self.inverse @ (self.weighted @ values[..., None]))[..., 0]
        self.rest = values - (self.coefficients[..., None, :] @ x)[..., 0, :]
        n = x.shape[-1]
        self.dof = n - x.shape[-2] + spread.dof
        squares = np.sum(self.weights * np.square(self.rest), axis=-1)
        has_own = math.isfinite(self.dof) and self.dof > 0.0
        factor = (spread.dof * spread.factor + squares) / self.dof if has_own else spread.factor
        rest = self.rest * np.sqrt(self.weights)
        lag = np.sum(rest[..., 1:] * rest[..., :-1], axis=-1) / np.maximum(np.sum(np.square(rest), axis=-1), TINY)
        # White errors have a correlation of up to 1.6 / sqrt(n) by chance.
        lag = np.where(lag > normal_quantile(0.95) / math.sqrt(n), np.minimum(lag, 1.0 - 1.0 / n), 0.0)
        self.factor: Array = np.maximum(1.0, factor) * (1.0 + lag) / (1.0 - lag)

    def stds(self) -> Array:
        """Return the standard deviations of the coefficients ``(…, b)``."""
        return np.sqrt(self.factor[..., None] * np.diagonal(self.inverse, axis1=-2, axis2=-1))

    def ratios(self) -> Array:
        """Return the sizes of the coefficients over their standard deviations ``(…, b)``."""
        return np.abs(self.coefficients) / self.stds()

    def row(self, i: int) -> "_Fit":
        """Return the fit of one series among several."""
        fit = object.__new__(_Fit)
        for name, value in vars(self).items():
            setattr(fit, name, value if name == "dof" else value[i])
        return fit

    def p_value(self, column: int) -> float:
        """Return the probability of a coefficient as far from 0 without a change."""
        ratio = float(self.ratios()[column])
        return 2.0 * normal_cdf(-ratio) if math.isinf(self.dof) else f_sf(ratio**2, 1.0, self.dof)

    def gains(self, times: Array) -> Array:
        """Return the fall of the weighted sum of squares by each of :data:`_SHAPES` at each test ``(…, 3, n)``.

        Sums over the tests from each one on give all of them at once.
        """
        w, n = self.weights, len(times)
        rest, start = w * self.rest, np.concatenate([times[:1], times[:-1]])

        def after(values: Array) -> Array:
            return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]

        step = after(rest), after(w), after(self.weighted)
        ramp = (
            after(times * rest) - start * step[0],
            after(times**2 * w) - 2.0 * start * after(times * w) + start**2 * step[1],
            after(times * self.weighted) - start * step[2],
        )
        gains = []
        # With two tests behind its start, a ramp is told from a step by chance; the last test alone is a step too.
        for row, (along, size, cross) in enumerate((step, ramp, (rest, w, self.weighted))):
            left = size - np.sum(cross * (self.inverse @ cross), axis=-2)
            is_known = left > NEW * size
            is_known[..., : row < 2] = False
            is_known[..., n - (0, 2, 1)[row] :] = False
            gains.append(np.where(is_known, np.square(along) / np.where(is_known, left, 1.0), 0.0))
        return np.stack(gains, axis=-2)


def control_chart(own: ArmSeries, centre: Array, half: Array) -> Entry:
    """Return the control chart of a series by the keys of the result.

    ``centre`` ``(n,)`` are the values expected with the changes found, ``half`` ``(n,)`` the distance from it beyond
    which a test alone is an alarm.
    """
    columns = (own.values, own.stds, centre, centre - half, centre + half)
    rows = zip(map(date_text, own.times.tolist()), *(column.tolist() for column in columns), strict=True)
    names = ("at", "value", "std", "expected", "low", "high")
    return {"key": own.key, "unit": own.unit, "values": [dict(zip(names, row, strict=True)) for row in rows]}


def level_of(times: Array) -> float:
    """Return the probability of a false alarm in a test: one is expected in a year of tests."""
    gaps = np.diff(np.unique(times))
    return min(_MOST_LEVEL, float(np.median(gaps)) / YEAR) if gaps.size else _MOST_LEVEL


def find_changes(series: Sequence[ArmSeries], level: float) -> tuple[list[Entry], list[Entry], list[Entry]]:
    """Return the changes of an arm's series whose probability without a change is below ``level``, limits and charts.

    A detection limit, with the keys of the result, is the change that the next test finds with a probability of 95 %.
    """
    spread = Spread.of([one for one in series if not one.is_of_setup] or series)
    together = by_key(((one.times.tobytes(), one.temperatures.tobytes()), one) for one in series)
    found = {
        one.key: of_series
        for some in together.values()
        for one, of_series in zip(some, _changes(some, level, len(series), spread), strict=True)
    }
    changes = (change for one in series for change in found[one.key][0])
    limits: list[Entry] = [{"key": one.key, "limit": found[one.key][1], "unit": one.unit} for one in series]
    controls = [control_chart(one, *found[one.key][2:]) for one in series]
    return sorted(changes, key=lambda change: float(change["p_value"])), limits, controls


def slope_of(times: Array, values: Array, stds: Array) -> tuple[float, float, float]:
    """Return the slope of a straight line, per year, and the ends of its 95 % interval."""
    fit = _Fit(values, stds, np.stack([np.ones(len(times)), (times - times.mean()) / YEAR]), Spread(1.0, 0.0))
    value, half = float(fit.coefficients[1]), student_quantile(0.975, fit.dof) * float(fit.stds()[1])
    return value, value - half, value + half


def _changes(
    some: Sequence[ArmSeries], level: float, n_series: int, spread: Spread
) -> Iterator[tuple[list[Entry], float, Array, Array]]:
    """Yield the changes of each of some series of the same tests, its detection limit and its control chart.

    The most probable change is taken until none is improbable without a change.
    """
    one, n = some[0], len(some[0].values)
    times = (one.times - one.times[-1]) / YEAR
    heat = one.temperatures - np.mean(one.temperatures)
    # Tests beyond which a dependence on temperature is told from the values.
    has_heat = n > 3 and float(np.ptp(heat)) > 0.0  # false for NaN
    base = np.stack([np.ones(n), *([heat] if has_heat else [])])
    start = np.concatenate([times[:1], times[:-1]])
    order = np.arange(n)
    values, stds = (np.array([getattr(series, name) for series in some]) for name in ("values", "stds"))
    # Steps, ramps and single tests of a series of n tests.
    count = n_series * max(1, 3 * n - 5)

    def column(shape: Any, at: Any) -> Array:
        shape, at = np.asarray(shape)[..., None], np.asarray(at)[..., None]
        ramp = np.maximum(times - start[at], 0.0)
        return np.asarray(np.where(shape == 0, order >= at, np.where(shape == 1, ramp, order == at)), dtype=float)

    def fitted(rows: Any, changes: Sequence[tuple[Any, Any]]) -> _Fit:
        y, columns = values[rows], [column(*change) for change in changes]
        every = [*(np.broadcast_to(row, y.shape) for row in base), *columns]
        return _Fit(y, stds[rows], np.stack(every, axis=-2), spread)

    def best(fit: _Fit) -> tuple[Any, Any, Any]:
        """Return shape, test and gain of the most probable change."""
        gains = fit.gains(times)
        flat = gains.reshape(*gains.shape[:-2], -1)
        return *np.divmod(flat.argmax(axis=-1), n), flat.max(axis=-1)

    def searched(row: int) -> tuple[_Fit, list[tuple[int, int]]]:
        """Return the fit of a series and its changes.

        One more change is tried, or two where one alone leaves a rest that does not look like noise: up, and down
        again.
        """
        found: list[tuple[int, int]] = []
        more: list[tuple[int, int]] = []
        whole = with_more = fitted(row, found)
        while len(more) < 2 and n > len(base) + len(found) + len(more):
            *change, gain = best(with_more)
            if gain <= 0.0:
                break
            more.append((int(change[0]), int(change[1])))
            with_more = fitted(row, [*found, *more])
            if with_more.dof <= 0.0 or any(with_more.p_value(-1 - i) * count >= level for i in range(len(more))):
                continue
            found, whole, more = [*found, *more], with_more, []
            if len(found) > 1:
                for i in range(len(found)):
                    shape, at, gain = best(fitted(row, found[:i] + found[i + 1 :]))
                    found[i] = (int(shape), int(at)) if gain > 0.0 else found[i]
                whole = with_more = fitted(row, found)
        return whole, found

    def suspects() -> set[int]:
        """Return the series of which a change, or two of them, may be improbable without one."""
        rows, fit, changes = np.arange(len(some)), plain, list[tuple[Any, Any]]()
        found = set[int]()
        if has_heat:
            critical = _SAFE * student_quantile(1.0 - 0.5 * level / n_series, fit.dof)
            found = {*rows[fit.ratios()[:, 1] > critical].tolist()}
        for _ in range(2):
            shape, at, gain = best(fit)
            is_left = gain > 0.0
            rows, changes = rows[is_left], [(each[0][is_left], each[1][is_left]) for each in (*changes, (shape, at))]
            fit = fitted(rows, changes)
            critical = _SAFE * student_quantile(1.0 - 0.5 * level / count, fit.dof)
            found |= {*rows[(fit.ratios()[:, -len(changes) :] > critical).all(axis=1)].tolist()}
        return found

    plain, usual = fitted(slice(None), []), np.median(np.square(stds), axis=1)
    # From eight tests on, series are searched together first.
    searched_rows = suspects() if n >= 8 else {*range(len(some))}
    for row, series in enumerate(some):
        whole, found = searched(row) if row in searched_rows else (plain.row(row), [])
        changes: list[Entry] = []
        for i, (shape, at) in enumerate(found):
            if shape == _SHAPES.index("single test"):
                continue
            gains = fitted(row, found[:i] + found[i + 1 :]).gains(times) / whole.factor
            near = np.flatnonzero(gains[shape] > gains[shape, at] - NORMAL_95**2)
            # Another kind within the odds of acceptance is named, too.
            others = [
                _SHAPES[kind] for kind in (1 - shape, 2) if np.max(gains[kind]) > gains[shape, at] - 2.0 * ACCEPTED
            ]
            kind = "setup" if series.is_of_setup else "ramp" if shape else "step"
            length = -float(start[at]) if shape else 1.0
            tests = series.times[[at, near[0], near[-1]]]
            others = [*others, *(["temperature"] if shape and not has_heat else []), *series.rivals]
            changes.append(_change(series, whole, len(base) + i, length, kind, tests, count, n - at > 1, others))
        if has_heat and row in searched_rows and whole.p_value(1) * n_series < level:
            tests = series.times[[-1, 0, -1]]
            changes.append(_change(series, whole, 1, 1.0, "temperature", tests, n_series, True, []))
        # Of one test more.
        critical = student_quantile(1.0 - 0.5 * level / (n_series * max(1, 3 * n - 2)), max(whole.dof, 1.0))
        # The next test against all: its own variance and that of the mean.
        variance = float(whole.factor) * (float(whole.inverse[0, 0]) + float(usual[row]))
        half = critical * math.sqrt(whole.factor) * stds[row]
        limit = (critical + normal_quantile(POWER)) * math.sqrt(variance)
        yield changes, limit, values[row] - whole.rest, half


def _change(
    series: ArmSeries,
    fit: _Fit,
    column: int,
    length: float,
    kind: str,
    tests: Array,
    count: int,
    confirmed: bool,
    alternatives: Sequence[str],
) -> Entry:
    value, half = (
        float(fit.coefficients[column]),
        student_quantile(0.975, max(fit.dof, 1.0)) * float(fit.stds()[column]),
    )
    return {
        "key": series.key,
        "kind": kind,
        **dict(zip(("at", "earliest", "latest"), map(date_text, tests.tolist()), strict=True)),
        "size": length * value,
        "low": length * (value - half),
        "high": length * (value + half),
        "unit": f"{series.unit}/K" if kind == "temperature" else series.unit,
        "p_value": min(1.0, fit.p_value(column) * count),
        "confirmed": confirmed,
        "alternatives": tuple(alternatives),
    }


# Quick test of an arm: a few poses against the model of its last full fit show whether one of its coefficients moved.
#
# The poses cannot show all coefficients anew. But their error is known as far as nothing changed: the model's own
# covariance, the scatter of the joints, what the fit left unexplained, and the noise. Base and target may be set up
# anew and are free. Each coefficient in turn is put to the test with the weights of that error, and the most
# significant one is taken, as long as one is improbable without a change.

_MOST_POSES = 1000
"""The errors of all poses are correlated: one matrix of all of them is made."""


def quick_test(
    robot: Robot, record: ModelFit, data: Measurements, level: float, factor: float, dates: tuple[float, float]
) -> tuple[tuple[Entry, ...], Sequence[Entry], tuple[str, ...], float]:
    """Return which coefficients of the model ``robot`` moved since its fit.

    Beside them are the change of each coefficient that such poses show with a probability of 95 %, the coefficients
    that the poses cannot distinguish from the set-up, and the rms position error of the model with base and target
    registered, m.

    Args:
        robot: Model that a fit wrote.
        record: Record of that fit.
        data: Poses measured now.
        level: Probability of a false alarm.
        factor: How much more the variance of a coefficient is from test to test than within one.
        dates: Of the last test before, and of this one, s since 1970.

    Raises:
        InputError: Fewer measured components than the frames have parameters, or more than :data:`_MOST_POSES` poses.
    """
    from robacc.tracing.calibrating import default_frames

    many = Problem(f"a quick test takes at most {_MOST_POSES} poses, found {data.n}", data.source, fix="use calibrate")
    refuse((data.n > _MOST_POSES, many))
    frames = default_frames(robot, data)
    robot = apply_fit(fit(Model.of(robot, frames), data))
    model = Model.of(robot, record.effects)
    poses, jacobian, covariance = fitted_jacobian(model, record, data)
    error = residuals(data, poses)
    rows, n = error.shape
    _, free, common, alone = zip(*blocks_with_frames(robot, record, data, data, Model.of(robot, frames)), strict=True)
    single = np.zeros((n, rows, n, rows))
    # A covariance that few poses of a fit showed may have nothing along some direction. One pose more, whose errors are
    # the same along all, gives it the least information (unit information prior; R. E. Kass and L. Wasserman, JASA 90,
    # 1995). m or rad: no instrument measures finer than a nanometre, and exact data have no noise.
    of_a_pose = np.sqrt(np.diag(record.unexplained).reshape(-1, 3).mean(axis=1) / (record.n_poses + 1))
    # Sockets, planes, distances and images have the noise of the fit: the unexplained error is of the target.
    of_position, of_rotation = np.append(np.maximum(of_a_pose, 1e-9), 1e-9)[:2] if data.kind is None else record.noise
    stds = np.repeat((of_position, of_rotation or 1e-9), 3)[:rows]
    each = np.concatenate(alone, axis=2)[:rows, :rows].T + np.diag(np.square(stds))
    single[np.arange(n), :, np.arange(n)] = each

    def flat(columns: Array) -> Array:
        """Return columns ``(M, K, N)`` with the components of each pose together ``(N M, K)``."""
        return columns.transpose(2, 0, 1).reshape(n * rows, -1)

    shared = flat(np.concatenate(common, axis=2)[:rows])
    shared[:, : len(covariance)] *= math.sqrt(max(1.0, factor))
    whitener = np.linalg.cholesky(single.reshape(n * rows, n * rows) + shared @ shared.T)
    setup, moved, rest = (
        np.linalg.solve(whitener, flat(columns))
        for columns in (np.concatenate(free, axis=2)[:rows], jacobian[:rows], error[:, None, :])
    )
    setup = setup[:, np.linalg.norm(setup, axis=0) > 0.0]  # without orientations, a target has no turn
    few = Problem(f"{n} poses say nothing beyond where base and target are; measure more", data.source)
    refuse((n * rows < setup.shape[1] + 2, few))
    terms = {term.name: term for term in model.bind(data).terms}
    names = [name for name in dict.fromkeys(record.coefficients) if name in terms]
    columns = {name: moved[:, i] for i, name in enumerate(names) if not name.startswith(SETUP)}
    found: list[str] = []
    rivals: dict[str, tuple[str, ...]] = {}
    while True:
        chosen = np.column_stack([setup, *(columns[name] for name in found)])
        basis, triangle = np.linalg.qr(chosen)
        left = rest[:, 0] - basis @ (basis.T @ rest[:, 0])
        dof = left.size - chosen.shape[1] - 1
        free_of = {name: column - basis @ (basis.T @ column) for name, column in columns.items()}
        sizes = {name: float(column @ column) for name, column in free_of.items()}
        known = [name for name in columns if sizes[name] > NEW * float(columns[name] @ columns[name])]
        gains = {name: float(free_of[name] @ left) ** 2 / sizes[name] for name in known}
        if not known or dof < 1:
            break
        best = max(known, key=lambda name: gains[name])
        variance = max(1.0, (float(left @ left) - gains[best]) / dof)
        if len(known) * f_sf(gains[best] / variance, 1.0, dof) >= level:
            break
        found.append(best)
        least = gains[best] - 2.0 * ACCEPTED * variance
        rivals[best] = tuple(name for name in known if name != best and gains[name] > least)
    variance = max(1.0, float(left @ left) / (dof + 1))
    critical = student_quantile(1.0 - 0.5 * level / max(len(known), 1), max(dof, 1))
    values = np.linalg.solve(triangle, basis.T @ rest[:, 0])
    stds = np.sqrt(variance * np.sum(np.square(np.linalg.inv(triangle)), axis=1))
    half = student_quantile(0.975, dof + 1) * stds
    before, now = map(date_text, dates)
    changes = tuple(
        {
            "key": name,
            "kind": "step",
            "at": now,
            "earliest": before,
            "latest": now,
            "size": float(values[i]),
            "low": float(values[i] - half[i]),
            "high": float(values[i] + half[i]),
            "unit": terms[name].unit,
            "p_value": min(1.0, len(columns) * f_sf(float(values[i] / stds[i]) ** 2, 1.0, dof + 1)),
            "confirmed": False,
            "alternatives": rivals[name],
        }
        for i, name in enumerate(found, setup.shape[1])
    )
    least = (critical + normal_quantile(POWER)) * math.sqrt(variance)
    limits = [{"key": name, "limit": least / math.sqrt(sizes[name]), "unit": terms[name].unit} for name in known]
    hidden = tuple(name for name in terms if name not in (*known, *found) and not name.startswith(SETUP))
    return changes, limits, hidden, rms_length(error[:3])


# Coefficients over many arms of a model: mean and standard deviation of each, and arms unlike the others.
#
# The coefficient of an arm is normal about the fleet's mean, and its estimate about it with the variance of its fit.
# The weighted sum of squares about the mean, with the variance between arms added, has a chi-square distribution: its
# value gives the estimate of that variance and the ends of its interval, exactly for normal coefficients.
#
# Sources: R. C. Paule and J. Mandel, "Consensus values and weighting factors", Journal of Research of the National
# Bureau of Standards 87, 1982; W. Viechtbauer, "Confidence intervals for the amount of heterogeneity in meta-analysis",
# Statistics in Medicine 26, 2007; G. Knapp and J. Hartung, Statistics in Medicine 22, 2003 (interval of the mean);
# B. Rosner, "Percentage points for a generalized ESD many-outlier procedure", Technometrics 25, 1983.


class ArmFit(NamedTuple):
    """Coefficients of one arm."""

    arm: str
    values: Mapping[str, tuple[float, float, str]]
    """Value, standard deviation and unit by key."""
    covariance: Mapping[tuple[str, str], float]
    dropped: frozenset[str] = frozenset()
    """Coefficients that its poses do not identify: the others make up for them."""
    robot: str = "None"
    """Name of the robot file."""
    is_shrunk: bool = False
    """Whether coefficients may be shrunk to nominal."""
    measured: frozenset[str] = frozenset()
    """Digests of its files of poses."""


def arm_fit(document: Mapping[str, Any], arm: str) -> ArmFit:
    """Return the coefficients in a result of ``calibrate`` or ``trace``.

    Those of the set-up are left out, and those whose variance is mostly that of weakly identifiable ones, which a prior
    draws to nominal: their standard deviations say what a badly made arm may have, not how estimates scatter.
    """
    stored = document.get("parameter_covariance") or {"names": [], "lower_triangle": []}
    names, matrix = stored["names"], np.zeros((len(stored["names"]),) * 2)
    for i, row in enumerate(stored["lower_triangle"]):
        matrix[i, : i + 1] = matrix[: i + 1, i] = row
    weak = {name for prior in document["priors"] for name in prior["weakly_identifiable"]}
    is_weak = np.array([name in weak for name in names], dtype=bool)
    shared = matrix[:, is_weak] @ np.linalg.pinv(matrix[np.ix_(is_weak, is_weak)]) @ matrix[is_weak]
    weak |= {names[i] for i in np.flatnonzero(np.diag(shared) > 0.5 * np.diag(matrix))}
    values = {
        entry["name"]: (float(entry["value"]), float(entry["std"]), str(entry["unit"]))
        for entry in document["parameters"]
        if entry["std"] is not None and entry["name"] not in weak and not entry["name"].startswith(SETUP)
    }
    covariance = {(a, b): float(matrix[i, j]) for i, a in enumerate(names) for j, b in enumerate(names[: i + 1])}
    dropped = frozenset(entry["name"] for entry in document["parameters"] if entry["std"] is None)
    robot, is_shrunk = (document.get("robot") or {}).get("name"), bool(document["options"].get("shrink"))
    measured = frozenset(entry["sha256"] for entry in document["inputs"] if entry["kind"] == "poses")
    return ArmFit(arm, values, covariance, dropped, str(robot), is_shrunk, measured)


def _squares(values: Array, variances: Array, between: float) -> float:
    weights = 1.0 / (variances + between)
    return float(weights @ np.square(values - weights @ values / weights.sum()))


def between_variance(values: Array, variances: Array, sum_of_squares: float) -> float:
    """Return the variance between arms at which the weighted sum of squares is ``sum_of_squares``; 0 if it is less."""
    if _squares(values, variances, 0.0) <= sum_of_squares:
        return 0.0
    high = float(np.sum(np.square(values - values.mean()))) / sum_of_squares
    return root(lambda between: _squares(values, variances, between) - sum_of_squares, 0.0, high * (1.0 + 1e-9), 1e-9)


def _coefficient(key: str, unit: str, values: Array, variances: Array) -> Entry:
    """Return mean and standard deviation between the arms with their 95 % intervals, by the keys of the result."""
    dof = len(values) - 1
    between, low, high = (
        between_variance(values, variances, size)
        for size in (float(dof), chi2_quantile(0.975, dof), chi2_quantile(0.025, dof))
    )
    weights = 1.0 / (variances + between)
    mean = float(weights @ values / weights.sum())
    excess = max(1.0, _squares(values, variances, between) / dof)
    half = student_quantile(0.975, dof) * math.sqrt(excess / float(weights.sum()))
    ends = {"mean": mean, "mean_low": mean - half, "mean_high": mean + half}
    stds = {"std": math.sqrt(between), "std_low": math.sqrt(low), "std_high": math.sqrt(high)}
    return {"key": key, "unit": unit, "n_arms": len(values), **ends, **stds}


def fleet_of(arms: Sequence[ArmFit]) -> tuple[list[Entry], list[Entry], Entry]:
    """Return the coefficients over the arms, the arms unlike the others, and the covariance of the coefficients.

    The figures are of the fleet without its strangers, each left out where it is one. The covariance is that of the
    arms' estimates less the mean of their own covariances, as far as it is positive semidefinite.

    Raises:
        UsageError: No coefficient is known of two arms.
    """
    keys = [*dict.fromkeys(key for arm in arms for key in arm.values)]
    coefficients: list[Entry] = []
    strangers: list[Entry] = []
    for key in keys:
        own = [arm for arm in arms if key in arm.values and arm.values[key][1] > 0.0]
        if len(own) < 2:
            continue
        unit = own[0].values[key][2]
        while True:
            values, variances = np.array([(arm.values[key][0], arm.values[key][1] ** 2) for arm in own]).T
            found = _coefficient(key, unit, values, variances)
            if len(own) < 4:  # arms from which one can be unlike the others
                break
            far = int(np.argmax(np.abs(values - found["mean"]) / np.sqrt(variances + found["std"] ** 2)))
            rest = np.arange(len(own)) != far
            others = _coefficient(key, unit, values[rest], variances[rest])
            spreads = variances + others["std"] ** 2
            square = (values[far] - others["mean"]) ** 2 / (spreads[far] + 1.0 / np.sum(1.0 / spreads[rest]))
            p_value = len(own) * len(keys) * f_sf(float(square), 1.0, len(own) - 2.0)
            # Probability that any arm of a fleet without a stranger is called one.
            if p_value >= 0.05:
                break
            strangers.append(
                {
                    **{"arm": own[far].arm, "key": key, "unit": unit},
                    **{"value": float(values[far]), "expected": others["mean"], "p_value": p_value},
                }
            )
            own = [arm for arm in own if arm is not own[far]]
        coefficients.append(found)
    refuse(
        (not coefficients, "the fits of two arms identify no coefficient alike; fit the same effects to the same poses")
    )
    names = [one["key"] for one in coefficients]
    apart = {stranger["arm"] for stranger in strangers}
    whole = [arm for arm in arms if arm.arm not in apart and set(names) <= set(arm.values)]
    covariance = np.diag([one["std"] ** 2 for one in coefficients])
    if len(whole) > 2:
        values = np.array([[arm.values[name][0] for name in names] for arm in whole])
        pairs = [[(a, b) if i >= j else (b, a) for j, b in enumerate(names)] for i, a in enumerate(names)]
        noise = np.mean([[[arm.covariance.get(pair, 0.0) for pair in row] for row in pairs] for arm in whole], axis=0)
        scale = np.sqrt(np.where(np.diag(covariance) > 0.0, np.diag(covariance), 1.0))
        shares, axes = np.linalg.eigh((np.cov(values.T) - noise) / scale[:, None] / scale)
        covariance = scale[:, None] * (axes * np.maximum(shares, 0.0)) @ axes.T * scale
    return coefficients, strangers, {"names": names, "matrix": covariance}


def joint_tolerances(coefficients: Sequence[Entry], urdf: bool) -> dict[str, dict[str, float]]:
    """Return standard deviations between arms by joint and parameter, as robot and tolerance files name them."""
    found: dict[str, dict[str, float]] = {}
    for one in coefficients:
        effect, joint, *label = one["key"].split(".")
        zero = "offset" if urdf else "theta" if one["unit"] == "rad" else "d"
        names = {"joint_offset": [zero], "link_geometry": label}.get(effect, [])
        if len(names) == 1:
            found.setdefault(joint, {})[names[0]] = one["std"]
    return found


def typical_robot(robot: Robot, coefficients: Sequence[Entry]) -> Robot:
    """Return a nominal robot with the means of the fleet in its numbers and its standard deviations as tolerances."""
    names = tuple(joint.name for joint in robot.variables)
    own = joint_tolerances(coefficients, robot.convention == "urdf")
    robot = absorbed(
        robot, [JointOffset(names), LinkGeometry(names)], {one["key"]: one["mean"] for one in coefficients}
    )
    joints = (replace(joint, tolerance=own.get(joint.name, {})) for joint in robot.joints)
    return replace(robot, joints=tuple(joints))


# Database of results: one SQLite file with every result of one arm or of many, and what robacc compares of them.
#
# Tables, for other programs that read the file:
#
# - ``results``: ``id``, ``sha256`` of the result file, ``at`` (s since 1970, of the test), ``name`` of the file,
#   ``arm`` (serial number, else the robot's name), ``model`` (command, robot file and effects, which must be the same
#   in results that are compared), ``command``, ``version`` of robacc, ``n_poses``, ``grade``, ``temperature_c``
#   (mean), ``document`` (JSON without its lists of poses, compressed by zlib).
# - ``figures``: ``result``, ``key`` as gates name it (``position.rms``), ``value``, ``low``, ``high`` (95 %), ``unit``.
# - ``coefficients``: ``result``, ``key`` (``joint_offset.j3``), ``value``, ``std``, ``unit``, or ``why`` without std.
#
# A result is added as a whole or not at all, by one transaction; write-ahead logging lets several programs add and
# read.

_SCHEMAS = (
    """
    CREATE TABLE results (id INTEGER PRIMARY KEY, sha256 TEXT NOT NULL UNIQUE, at REAL NOT NULL, name TEXT NOT NULL,
        arm TEXT NOT NULL, model TEXT NOT NULL, command TEXT NOT NULL, version TEXT NOT NULL, n_poses INTEGER NOT NULL,
        grade TEXT, temperature_c REAL, document BLOB NOT NULL);
    CREATE TABLE figures (result INTEGER NOT NULL REFERENCES results, key TEXT NOT NULL, value REAL NOT NULL,
        low REAL, high REAL, unit TEXT NOT NULL, PRIMARY KEY (result, key)) WITHOUT ROWID;
    CREATE TABLE coefficients (result INTEGER NOT NULL REFERENCES results, key TEXT NOT NULL, value REAL, std REAL,
        unit TEXT NOT NULL, why TEXT, PRIMARY KEY (result, key)) WITHOUT ROWID;
    CREATE INDEX results_by_arm ON results (arm, at);
    """,
)
"""Statements that bring a database of each version to the next; its version is SQLite's ``user_version``."""
_OTHER = "is not a database of robacc history"
_WITHOUT = ("poses", "poses_apart", "candidates", "worst_poses", "detection_limits", "next_poses")
"""Lists that the stored document lacks: they are long, and the result file has them."""
_STD = f"(t.high - t.low) / {2.0 * normal_quantile(0.975)!r}"
_COMPARED = "(t.key LIKE '%.rms' OR t.key LIKE 'iso9283.%') AND t.high > t.low AND r.command IN ('estimate', 'iso9283')"
"""Figures that are series of their own: the others say the same of the same poses."""


Test = Mapping[str, Any]
"""A result of the database, by :data:`_TEST`."""
_TEST = ("id", "at", "name", "arm", "model", "command", "n_poses", "grade", "temperature_c")


@contextmanager
def opened(path: str, *, writes: bool = False) -> Iterator[sqlite3.Connection]:
    """Yield the database in a file; it is made if it is to be written, and is brought to this version of its tables.

    Raises:
        InputError: The file does not exist, is no such database, is of a later version, or cannot be written.
    """
    missing = Problem("no such database", path, fix="robacc history add makes it")
    refuse(
        (not writes and not os.path.exists(path), missing),
        (not path or os.path.isdir(path), Problem(f"expected the name of a database file, found {path!r}")),
    )
    try:
        # A folder that cannot be written has no place for the files of the log. A reader that may not write leaves them
        # behind, because it cannot remove them.
        is_fixed = not os.access(os.path.dirname(path) or ".", os.W_OK)
        reads = "ro&immutable=1" if is_fixed else "rw" if os.access(path, os.W_OK) else "ro"
        uri = f"file:{quote(path)}?mode={'rwc' if writes else reads}"
        # 30 s is the time to wait for another program that writes.
        with closing(sqlite3.connect(uri, 30.0, uri=True, isolation_level=None)) as db:
            db.execute(f"PRAGMA query_only = {int(not writes)}")
            if writes:
                db.execute("PRAGMA journal_mode = WAL")
                db.execute("BEGIN IMMEDIATE")
            version = db.execute("PRAGMA user_version").fetchone()[0]
            is_empty = version == 0 and not db.execute("SELECT 1 FROM sqlite_master").fetchall()
            later = f"has tables of version {version}; this robacc knows {len(_SCHEMAS)}"
            refuse(
                (is_empty and not writes, missing),
                (version == 0 and not is_empty, Problem(_OTHER, path, fix="name another file")),
                (version > len(_SCHEMAS), Problem(later, path, fix="use a later version of robacc")),
            )
            if writes:
                for statement in ";".join(_SCHEMAS[version:]).split(";"):
                    db.execute(statement)
                db.execute(f"PRAGMA user_version = {len(_SCHEMAS)}")
            yield db
            if writes:
                db.execute("COMMIT")
    except sqlite3.Error as error:
        text = _OTHER if "not a database" in str(error) else f"cannot be used as a database: {error}"
        raise InputError(Problem(text, path)) from None


def arm_of(document: Mapping[str, Any]) -> str:
    """Return the serial number of the arm of a result, else the robot's name."""
    identities = (entry.get("identity") or {} for entry in document["inputs"] if entry["kind"] == "robot")
    serial = next((identity["serial_number"] for identity in identities if "serial_number" in identity), None)
    return str(serial or (document.get("robot") or {}).get("name") or "unnamed")


def add(db: sqlite3.Connection, result: StoredResult, at: float, arm: str | None = None) -> bool:
    """Add a result of ``arm``, by default of :func:`arm_of`; return whether it was new.

    Raises:
        UsageError: The command's results cannot be compared.
        InputError: The document lacks what its command writes.
    """
    document = result.document
    with understood(result.name, result.command):
        figures = read_compared_result(document, result.name, result.name, result.sha256).figures
        robot: dict[str, Any] = next((entry for entry in document["inputs"] if entry["kind"] == "robot"), {})
        heat = [value for value in (document.get("poses") or {}).get("temperature_c") or () if value is not None]
        # Options that say which effects a result has.
        effects = [document["options"].get(name) for name in ("fit", "declared", "align")]
        values = {
            "sha256": result.sha256,
            "at": at,
            "name": os.path.basename(result.name),
            "arm": arm or arm_of(document),
            "model": f"{result.command} {robot.get('sha256')} {effects}",
            "command": result.command,
            "version": document["robacc"],
            "n_poses": document["n_poses"],
            "grade": (document.get("grade") or {}).get("grade"),
            "temperature_c": float(np.mean(heat)) if heat else None,
            "document": zlib.compress(json.dumps({k: v for k, v in document.items() if k not in _WITHOUT}).encode()),
        }
        names, marks = ", ".join(values), ", ".join("?" * len(values))
        added = db.execute(f"INSERT OR IGNORE INTO results ({names}) VALUES ({marks})", [*values.values()])
        if not added.rowcount:
            return False
        number = added.lastrowid
        of_figures = (
            (number, key, figure.value, getattr(own, "lower", None), getattr(own, "upper", None), unit_of(key))
            for key, figure in figures.items()
            for own in [figure.interval]
        )
        of_coefficients = (
            (number, e["name"], e["value"] if e["std"] is not None else None, e["std"], e["unit"], e.get("why"))
            for e in document.get("parameters", [])
        )
        for table, rows in (("figures", of_figures), ("coefficients", of_coefficients)):
            db.executemany(f"INSERT INTO {table} VALUES (?, ?, ?, ?, ?, ?)", rows)
    return True


def tests(db: sqlite3.Connection, arm: str | None) -> list[Test]:
    """Return the results of an arm, or of all, by arm and date.

    Raises:
        UsageError: The database has no such arm.
    """
    query = f"SELECT {', '.join(_TEST)} FROM results WHERE ifnull(arm = ?1, 1) ORDER BY arm, at, id"
    found: list[Test] = [dict(zip(_TEST, row, strict=True)) for row in db.execute(query, [arm])]
    arms = ", ".join(name for (name,) in db.execute("SELECT DISTINCT arm FROM results ORDER BY arm LIMIT 20"))
    refuse((arm is not None and not found, f"the database has no arm {arm!r}; it has {arms or 'no results'}"))
    return found


def document_of(db: sqlite3.Connection, test: Test) -> dict[str, Any]:
    """Return the stored document of a test."""
    (packed,) = db.execute("SELECT document FROM results WHERE id = ?", [test["id"]]).fetchone()
    document: dict[str, Any] = json.loads(zlib.decompress(packed))
    return document


COLUMNS = ("arm", "at", "result", "key", "value", "std", "unit")
"""Columns of :func:`rows_of`, and the id of the test."""


def rows_of(db: sqlite3.Connection, arm: str | None, key: str | None = None) -> list[tuple[Any, ...]]:
    """Return :data:`COLUMNS` of the figures and coefficients of an arm or of all, by key, arm and date.

    With ``key``, they are those of one key. The standard deviation of a figure is the width of its 95 % interval over
    twice the normal distribution's quantile.
    """
    one = "SELECT r.arm, r.at, r.name, t.key, t.value, {}, t.unit, r.id FROM {} t JOIN results r ON r.id = t.result"
    where = "WHERE ifnull(r.arm = ?1, 1) AND ifnull(t.key = ?2, 1)"
    both = f"{one.format(_STD, 'figures')} {where} UNION ALL {one.format('t.std', 'coefficients')} {where}"
    return db.execute(f"{both} ORDER BY 4, 1, 2, 8", [arm, key]).fetchall()


def counted(own: Sequence[Test]) -> list[Test]:
    """Return the tests of an arm that can be compared with the last of their kind: the same robot file and effects."""
    latest = {test["command"] in FITS or test["command"]: test["model"] for test in own}
    return [test for test in own if test["model"] == latest[test["command"] in FITS or test["command"]]]


def series_of(db: sqlite3.Connection, own: Sequence[Test]) -> list[ArmSeries]:
    """Return the series of tests of one arm: coefficients, and errors that estimates and ISO 9283 tests measured."""
    ids = json.dumps([test["id"] for test in own])
    when, warmth = (np.array([test[name] for test in own], dtype=float) for name in ("at", "temperature_c"))
    # SQLite runs through the left table of a cross join first, so that rows come in the order of the tests.
    of_tests = "FROM json_each(?) j CROSS JOIN results r ON r.id = j.value JOIN {} t ON t.result = r.id WHERE {}"
    is_hidden = of_tests.format("coefficients", "t.std IS NULL")
    rivals: dict[str, set[str]] = {}
    for key, why in db.execute(f"SELECT DISTINCT t.key, t.why {is_hidden}", [ids]):
        # A reason that names one other coefficient.
        if (match := re.search(r"is not distinguishable from (\S+) on these poses", why or "")) is not None:
            rivals.setdefault(match[1], set()).add(key)
    series: list[ArmSeries] = []
    for std, *source in ((_STD, "figures", _COMPARED), ("t.std", "coefficients", "t.std > 0")):
        rows = db.execute(f"SELECT t.key, t.unit, j.key, t.value, {std} {of_tests.format(*source)}", [ids]).fetchall()
        numbers: dict[tuple[str, str], int] = {}
        number = np.array([numbers.setdefault(row[:2], len(numbers)) for row in rows], dtype=np.int64)
        order = np.argsort(number, kind="stable")
        place, *columns = (np.array([row[i] for row in rows], dtype=float)[order] for i in (2, 3, 4))
        ends = np.cumsum(np.bincount(number, minlength=len(numbers)))
        for (key, unit), last, n in sorted(zip(numbers, ends, np.diff(ends, prepend=0), strict=True)):
            if n > 1:
                values, stds = (column[last - n : last] for column in columns)
                at = place[last - n : last].astype(np.int64)
                own_rivals = tuple(sorted(rivals.get(key, ())))
                series.append(ArmSeries(key, unit, when[at], values, stds, warmth[at], own_rivals))
    return series
