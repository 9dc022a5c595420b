"""Errors that are correlated in time, and standard errors of coefficients that allow for them.

An instrument's mounting that creeps, the hall's temperature and the air give errors that wander: visits that follow
each other share most of them. Least squares counts every visit as independent, and coefficients that the order of the
visits imitates get standard errors that are too small. The whitened errors of each component are described as

    e_i = sqrt(c / (1 + g)) (n_i + sqrt(g) w(t_i)),   cov(w(s), w(t)) = exp(-|s - t| / tau),   var(n_i) = 1,

an Ornstein-Uhlenbeck process plus white noise (G. E. Uhlenbeck, L. S. Ornstein, Phys. Rev. 36 (1930) 823). c, g and
tau are those of the largest restricted likelihood (H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545), g and tau
on a grid, for position and for orientation. The inverse K^-1 of the process' correlations is tridiagonal, so that

    (I + g A K A^T)^-1 = I - A (K^-1 / g + A^T A)^-1 A^T

takes a time proportional to the visits; A assigns rows to visits. The fit stays that of equal weights, which wandering
errors of another kind cannot mislead. Its covariance becomes

    H (X^T R X + P) H,   H = (X^T X + P)^-1,

R the covariance of the errors and P the precision of priors, and no variance becomes smaller than without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.coefficient_covariance import sandwich, with_covariance
from robacc.fitting.fit_result import Fit
from robacc.fitting.linear_algebra import solved
from robacc.fitting.repeatability import MANY_COEFFICIENTS, MOST_ROWS
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitened_rows import whitened_rows
from robacc.geometry import Array
from robacc.measurements import Measurements

SIGNIFICANT = 6.0
"""Smallest gain of twice the restricted log-likelihood for which the correlation counts. Of 200 simulated sets with
independent errors one in a hundred gained 5 and none gained 8."""
_SUSPECT = 0.5
"""Least correlation of successive visits, in standard errors, for which the likelihood is computed: of 160 simulated
sets with a significant correlation, two had less."""
_FEWEST = 20
"""Visits from which a correlation is estimated."""
_AMPLITUDES = np.geomspace(0.03, 100.0, 12)
"""Grid of the wander's variance over that of the independent errors."""
_SHORTEST, _TIMES = 1.5, 7
"""Shortest time constant, in median times between visits, and number of time constants up to all visits."""
_UNITS = ((3600.0, "h"), (60.0, "min"), (1.0, "s"))
_LEAST_IN_UNIT = 2.0
"""Time constant, in a unit, from which it is stated in that unit."""
_LEAST_INTERVAL = 1e-6
"""Least time between visits over the median one: rows of equal time are no division by zero."""


@dataclass(frozen=True, slots=True)
class CorrelatedErrors:
    """Correlation of a fit's remaining errors in time."""

    share: float
    """Share of the variance that wanders, of the position or else of the orientation."""
    time_constant: float
    """Of that wander, in the unit of ``in_seconds``."""
    in_seconds: bool
    """Whether the time constant is in seconds; else in visits, because the poses have no times."""
    gain: float
    """Twice the gain in restricted log-likelihood over independent errors."""
    covariance: Array
    """``(K, K)`` covariance of the identifiable coefficients under these errors."""

    @property
    def warning(self) -> str:
        """Return a sentence for readers of the result."""
        constant, unit = self.time_constant, "visits"
        if self.in_seconds:
            divisor, unit = next(entry for entry in _UNITS if constant >= _LEAST_IN_UNIT * entry[0] or entry[0] == 1.0)
            constant /= divisor
        return (
            f"the remaining errors are correlated in time ({100 * self.share:.0f} % of their variance; time "
            f"constant about {constant:.2g} {unit}); standard errors of coefficients and p-values of findings "
            "allow for it"
        )


@dataclass(frozen=True, slots=True)
class _Wander:
    """Wander of one kind of errors: variance over that of the independent errors, and time constant."""

    amplitude: float = 0.0
    tau: float = 1.0


@dataclass(frozen=True, slots=True)
class _Kind:
    """Position or orientation, or both: products of K whitened columns, the last one the errors, and sums by visit."""

    gram: Array
    """``(K, K)``"""
    sums: Array
    """``(V, m K)`` sums over the rows of each visit, of m components."""
    values: int
    """Number of whitened values."""

    @classmethod
    def of(cls, columns: Array, places: NDArray[np.int64]) -> _Kind:
        """Return the products of ``columns`` ``(K, m, n)``, n rows of the visits ``places`` ``(n,)``."""
        order = np.argsort(places, kind="stable")
        first = np.flatnonzero(np.diff(places[order], prepend=-1))
        sums = np.add.reduceat(columns[:, :, order], first, axis=2)
        flat = columns.reshape(columns.shape[0], -1)
        return cls(flat @ flat.T, sums.transpose(2, 1, 0).reshape(first.size, -1), columns[0].size)

    def contracted(self, other: Array) -> Array:
        """Return ``(K, K)`` products of the sums with ``other`` ``(V, m K)``, over visits and components."""
        size = self.gram.shape[0]
        product: Array = self.sums.reshape(-1, size).T @ other.reshape(-1, size)
        return product


@dataclass(frozen=True, slots=True)
class _Process:
    """Correlations K of a wander over the visits: the tridiagonal matrix K^-1."""

    diagonal: Array
    beside: Array
    log_determinant: float

    @classmethod
    def of(cls, interval: Array, tau: float) -> _Process:
        """Return the process of time constant ``tau`` with the given times between visits."""
        memory, fresh = np.exp(-interval / tau), -np.expm1(-2.0 * interval / tau)
        diagonal = np.ones(interval.size + 1)
        diagonal[1:] = 1.0 / fresh
        diagonal[:-1] += np.square(memory) / fresh
        return cls(diagonal, -memory / fresh, -float(np.log(fresh).sum()))

    def solved(self, amplitude: float, counts: Array | float, values: Array) -> tuple[Array, float]:
        """Return (K^-1 / amplitude + counts)^-1 values, and the logarithm of that matrix' determinant."""
        from scipy.linalg.lapack import dpttrf, dpttrs

        diagonal, beside, _ = dpttrf(self.diagonal / amplitude + counts, self.beside / amplitude)
        return np.asarray(dpttrs(diagonal, beside, values)[0], dtype=np.float64), float(np.log(diagonal).sum())


@dataclass(frozen=True)
class _Series:
    """Whitened linearisation of a fit in the order of time."""

    kinds: list[_Kind]
    """Position, and orientation if measured."""
    precision: Array
    """``(K - 1,)`` prior precision of the columns."""
    counts: Array
    """``(V,)`` rows of each visit."""
    interval: Array
    """``(V - 1,)`` time between visits."""

    def most_likely(self, times: Array) -> tuple[list[_Wander], float, float]:
        """Return the wander of each kind, c, and twice the gain in restricted log-likelihood over independent errors.

        ``times`` is the grid of time constants.
        """
        chosen = [(_Wander(), kind.gram, 0.0) for kind in self.kinds]
        first, scale = self._likelihood(chosen)
        best, found = first, chosen
        for number in range(len(chosen)):
            for candidate in self._candidates(number, times):
                tried = [*chosen[:number], candidate, *chosen[number + 1 :]]
                likelihood, c = self._likelihood(tried)
                if likelihood > best:
                    best, scale, found = likelihood, c, tried
            chosen = found
        return [wander for wander, _, _ in chosen], scale, 2.0 * (best - first)

    def _candidates(self, number: int, times: Array) -> Iterator[tuple[_Wander, Array, float]]:
        """Yield each wander of the grid, with X^T R^-1 X and the logarithm of the determinant of R, for c = 1."""
        kind = self.kinds[number]
        components = kind.sums.shape[1] // kind.gram.shape[0]
        for tau in times.tolist():
            process = _Process.of(self.interval, tau)
            for amplitude in _AMPLITUDES.tolist():
                smooth, determinant = process.solved(amplitude, self.counts, kind.sums)
                determinant -= process.log_determinant - self.counts.size * np.log(amplitude)
                gram = (1.0 + amplitude) * (kind.gram - kind.contracted(smooth))
                total = components * determinant - kind.values * np.log1p(amplitude)
                yield _Wander(amplitude, tau), gram, float(total)

    def _likelihood(self, parts: list[tuple[_Wander, Array, float]]) -> tuple[float, float]:
        """Return the restricted log-likelihood at the best c, and that c."""
        gram: Array = np.sum([part[1] for part in parts], axis=0)
        matrix = gram[:-1, :-1] + np.diag(self.precision)
        diagonal = sum((np.diag(kind.gram)[:-1] for kind in self.kinds), self.precision)
        scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, np.inf))
        scaled, rhs = matrix * scale[:, None] * scale, gram[:-1, -1] * scale
        scaled += np.diag(diagonal == 0.0)  # of a column that the thinned rows do not show
        square = float(gram[-1, -1] - rhs @ solved(scaled, rhs))
        dof = sum(kind.values for kind in self.kinds) - int(np.count_nonzero(self.precision == 0.0))
        c = max(square / dof, np.finfo(float).tiny)
        determinant = sum(part[2] for part in parts) + float(np.linalg.slogdet(scaled)[1])
        return -0.5 * (determinant + dof * float(np.log(c))), c


def correlated_errors(fit: Fit, data: Measurements) -> CorrelatedErrors | None:
    """Estimate the correlation of a fit's remaining errors in time; None if it is not significant."""
    visits, time = _visits_in_time(fit, data)
    if not fit.identifiability.columns.size or time.size < _FEWEST:
        return None
    thinning = -(-time.size // MOST_ROWS)
    time, rows = time[::thinning], np.flatnonzero((visits >= 0) & (visits % thinning == 0))
    places = visits[rows] // thinning
    if not _may_wander(fit, rows, places):
        return None
    interval = np.diff(time)
    usual = float(np.median(interval[interval > 0.0])) if np.any(interval > 0.0) else 1.0
    interval = np.maximum(interval, _LEAST_INTERVAL * usual)
    whitened = _whitened(fit, data, rows)
    estimated = np.append((fit.precision == 0.0) | (fit.precision.size <= MANY_COEFFICIENTS), True)
    kinds = [_Kind.of(values[estimated], places) for values in whitened]
    series = _Series(kinds, fit.precision[estimated[:-1]], np.bincount(places).astype(np.float64), interval)
    times = usual * np.geomspace(_SHORTEST, time.size, _TIMES)
    wanders, scale, gain = series.most_likely(times)
    if gain <= SIGNIFICANT:
        return None
    meat = np.zeros_like(fit.gram)
    part = rows.size / np.count_nonzero(fit.inliers)
    for values, wander in zip(whitened, wanders, strict=True):
        meat = meat + scale * _meat(_Kind.of(values[:-1], places), wander, interval, float(part))
    largest = max(wanders, key=lambda wander: wander.amplitude)
    return CorrelatedErrors(
        share=largest.amplitude / (1.0 + largest.amplitude),
        time_constant=largest.tau,
        in_seconds=data.time is not None,
        gain=gain,
        covariance=sandwich(fit.gram, meat, fit.precision),
    )


def with_correlated_errors(fit: Fit, errors: CorrelatedErrors | None) -> Fit:
    """Return the fit with standard errors that allow for the correlation; unchanged without one."""
    if errors is None:
        return fit
    return with_covariance(fit, errors.covariance)


def _visits_in_time(fit: Fit, data: Measurements) -> tuple[NDArray[np.int64], Array]:
    """Return the place in time ``(N,)`` of each row's visit, -1 for visits with outliers, and the times ``(V,)``.

    Without times the order of the rows counts.
    """
    numbers = visit_numbers(data)
    count = np.bincount(numbers)
    time = np.arange(data.n, dtype=np.float64) if data.time is None else data.time
    mean = np.bincount(numbers, weights=time) / np.maximum(count, 1)
    whole = (count > 0) & (np.bincount(numbers, weights=~data.first_measured(fit.inliers)) == 0)
    order = np.flatnonzero(whole)[np.argsort(mean[whole], kind="stable")]
    place = np.full(count.size, -1, dtype=np.int64)
    place[order] = np.arange(order.size)
    return place[numbers], mean[order] if data.time is not None else np.arange(order.size, dtype=np.float64)


def _may_wander(fit: Fit, rows: NDArray[np.int64], places: NDArray[np.int64]) -> bool:
    """Return whether whitened errors of successive visits agree in sign more often than not, at little cost."""
    white = fit.whitening.subset(rows).apply(fit.residual[:, rows])
    sums = np.stack([np.bincount(places, weights=row) for row in white])
    for start in range(0, len(sums), 3):
        products = np.einsum("mv,mv->v", sums[start : start + 3, 1:], sums[start : start + 3, :-1])
        if products.sum() > _SUSPECT * float(np.sqrt(np.sum(np.square(products)))):
            return True
    return False


def _whitened(fit: Fit, data: Measurements, rows: NDArray[np.int64]) -> list[Array]:
    """Return ``(K + 1, 3, n)`` for position, and orientation if measured: columns, and errors that they can explain.

    Shrunk coefficients are estimated about zero, so the part that they explain is added to the residual, unless they
    are too many to be estimated anew.
    """
    columns = fit.identifiability.columns
    by_component, error = whitened_rows(fit, data, rows)
    design = np.moveaxis(by_component, 1, 0)
    if columns.size <= MANY_COEFFICIENTS:
        shrunk = np.where(fit.precision > 0.0, fit.theta[columns], 0.0)
        error += np.einsum("kmn,k->mn", design, shrunk)
    values = np.concatenate((design, error[None]))
    return [values[:, start : start + 3] for start in range(0, len(error), 3)]


def _meat(kind: _Kind, wander: _Wander, interval: Array, part: float) -> Array:
    """Return X^T R X of all rows for c = 1, of which ``kind`` has the given part."""
    independent = kind.gram / part
    if wander.amplitude == 0.0:
        return independent
    wandering, _ = _Process.of(interval, wander.tau).solved(1.0, 0.0, kind.sums)
    total: Array = independent + wander.amplitude / part**2 * kind.contracted(wandering)
    return total / (1.0 + wander.amplitude)
