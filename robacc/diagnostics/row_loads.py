"""Loads at the flange that differ from row to row and that nobody logged.

A load of m_k kg on row k moves the tool by m_k sum_j c_j u_jk, with u_jk the displacement by the torque of 1 kg on
joint j and c_j the compliance of the joint. Both factors are unknown, so they are fitted in turn (alternating least
squares), together with every coefficient of the model and a constant load. Loads come in a few sizes: the fitted loads
are then grouped, and each group has a common load.

The groups count as loads if they explain the error far better than chance, than a continuum of loads divided into as
many groups, and than constant shifts of the same joints, which clearance or a jump of a zero would need.

Source of alternating least squares for a product of two unknown vectors: H. Wold, "Estimation of principal components
and related models by iterative least squares", in: Multivariate Analysis (1966), 391-420.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.geometry import Array
from robacc.gravity.loads import payload
from robacc.gravity.torques import gravity_torques
from robacc.measurements import Measurements

_FEWEST_ROWS = 40
_MOST_ROWS = 400
"""Largest number of rows that are grouped; of more, an even share is used."""
_MOST_GROUPS = 4
_SMALLEST_GROUP = 0.05
"""Least share of the rows in a group."""
_STEPS = 40
"""Steps of the alternation."""
_SETTLED = 1e-4
"""Share of the sum of squares by which the last step of the alternation lowers it."""
_LEAST_NEW = 1e-9
"""Share of a column, given others, below which it adds nothing."""
_REGROUPED = 10
"""Largest number of times that rows are grouped anew."""
_LEAST_GAIN = 4.0
"""Factor by which groups of loads lower the sum of squares. Chance gives 1.5 at most: one coordinate of three a row."""
_LEAST_BETTER = 2.0
"""Factor by which loads leave a smaller sum of squares than shifts of the same joints."""
_LARGEST_SPREAD = 2.0
"""Factor by which groups may leave a larger sum of squares than a load of its own for each row, but for its freedom."""
_LEAST_TORQUE = 0.1
"""Least torque of 1 kg on a joint that may deflect, over the largest on any joint."""


@dataclass(frozen=True, slots=True)
class RowLoads:
    """Groups of rows that carry different loads."""

    rows: tuple[NDArray[np.int64], ...]
    """Numbers of the rows of each group, lightest load first."""
    loads: tuple[float, ...]
    """Load of each group above that of the first, over that of the last."""

    @property
    def text(self) -> str:
        """Return the groups and what to do."""
        sizes, shares = (" : ".join(entries) for entries in ([str(rows.size) for rows in self.rows], self._shares()))
        return (
            f"a load at the flange that differs from row to row explains the errors: {len(self.rows)} groups of "
            f"{sizes} rows, whose loads above the lightest are in the ratio {shares}; the payload was not logged: if "
            "it changed, write payload_kg for each row, or the load's name in payload_group, and trace again; if it "
            "did not change, the cause is outside the catalogue"
        )

    def _shares(self) -> list[str]:
        return [f"{load:.2g}" for load in self.loads]


def unlogged_loads(fit: Fit, data: Measurements) -> RowLoads | None:
    """Return the groups of rows with different loads that explain the remaining error; None if there are none."""
    if data.payload is not None or data.q is None or data.n < _FEWEST_ROWS:
        return None
    rows = np.unique(np.linspace(0, data.n - 1, min(data.n, _MOST_ROWS)).round().astype(np.int64))
    part = data.subset(rows)
    torque = gravity_torques(fit.model.arm, part.q, payload(fit.model.arm, np.ones(part.n)))  # type: ignore[arg-type]
    size = np.sqrt(np.mean(np.square(torque), axis=1))
    loaded = np.flatnonzero(size > _LEAST_TORQUE * size.max())
    if size.max() == 0.0:
        return None
    shifts = joint_columns(fit.model, part)[:3, loaded]
    moved = shifts * torque[loaded]
    _, jacobian = fit.model.bind(part).linearise(fit.theta)
    residual = fit.residual[:3, rows]
    by_load = _grouped(residual, np.concatenate((jacobian[:3], moved), axis=1), moved)
    if by_load is None:
        return None
    by_shift = _grouped(residual, np.concatenate((jacobian[:3], shifts), axis=1), shifts)
    if by_shift is not None and by_shift.squares < _LEAST_BETTER * by_load.squares:
        return None
    order = np.argsort(by_load.levels)
    levels = by_load.levels[order] - by_load.levels.min()
    groups = tuple(rows[by_load.labels == label] for label in order)
    return RowLoads(groups, tuple((levels / levels[-1]).tolist()))


@dataclass(frozen=True, slots=True)
class _Grouping:
    labels: NDArray[np.int64]
    levels: Array
    squares: float


def _grouped(residual: Array, common: Array, moved: Array) -> _Grouping | None:
    """Return the fewest groups of rows whose products with ``moved`` ``(3, J, N)`` explain the residual ``(3, N)``.

    ``common`` ``(3, P, N)`` are columns with one coefficient for all rows.
    """
    common = _orthonormal(common)
    squares = float(np.sum(np.square(residual - _times(common, _products(common, residual)))))
    amounts, precision, free = _amounts(residual, common, moved)
    n = residual.shape[1]
    if squares <= _LEAST_GAIN * free:
        # Groups of loads explain no more than a load of its own for each row.
        return None
    for count in range(2, _MOST_GROUPS + 1):
        grouping = _settled(residual, common, moved, _labels(amounts, precision, count))
        if np.bincount(grouping.labels, minlength=count).min() < max(_SMALLEST_GROUP * n, 3):
            continue
        gain = squares / max(grouping.squares, 1e-300)
        cost = n * np.log(count) + 0.5 * np.log(3 * n) * (count + moved.shape[1])
        # Each row's own amount takes one of its three coordinates. Equal groups of evenly spread amounts gain count^2.
        is_tight = grouping.squares < _LARGEST_SPREAD * 1.5 * free or gain > 2.0 * count**2
        if gain > _LEAST_GAIN and is_tight and 1.5 * n * np.log(gain) > cost:
            return grouping
    return None


def _orthonormal(columns: Array) -> Array:
    """Return orthonormal ``(3, R, N)`` columns that span ``(3, P, N)`` columns."""
    scale = np.maximum(np.sqrt(np.sum(np.square(columns), axis=(0, 2))), 1e-300)
    matrix = np.moveaxis(columns / scale[:, None], 1, 2).reshape(-1, scale.size)
    left, sizes, _ = np.linalg.svd(matrix, full_matrices=False)
    left = left[:, sizes > _LEAST_NEW * sizes.max(initial=0.0)]
    return np.ascontiguousarray(np.moveaxis(left.reshape(3, -1, left.shape[1]), 2, 1))


def _products(columns: Array, values: Array) -> Array:
    """Return ``(P,)`` products of ``(3, P, N)`` columns with ``values`` ``(3, N)``."""
    return np.asarray(sum(column @ value for column, value in zip(columns, values, strict=True)))


def _times(columns: Array, coefficients: Array) -> Array:
    """Return ``(3, N)`` the sum of ``(3, P, N)`` columns times coefficients ``(P,)``."""
    return np.asarray(coefficients @ columns)


def _fit(residual: Array, common: Array, columns: Array) -> tuple[Array, Array, float]:
    """Fit ``common`` and ``columns`` ``(3, J, N)`` to the residual by least squares.

    Returns:
        Coefficients of the orthonormal ``common``, those of ``columns``, and the sum of squares that remains.
    """
    shared = _products(common, residual)
    mimicked = np.einsum("mpn,mjn->pj", common, columns, optimize=True)
    gram = np.einsum("min,mjn->ij", columns, columns) - mimicked.T @ mimicked
    rhs = _products(columns, residual) - mimicked.T @ shared
    coefficients = np.linalg.lstsq(gram, rhs, rcond=_LEAST_NEW)[0]
    squares = float(np.sum(np.square(residual)) - shared @ shared - coefficients @ rhs)
    return shared - mimicked @ coefficients, np.asarray(coefficients), squares


def _amounts(residual: Array, common: Array, moved: Array) -> tuple[Array, Array, float]:
    """Return each row's own amount ``(N,)`` of the same mixture of ``moved``, its precision, and the sum of squares."""
    mixture = 1.0 / np.sqrt(np.mean(np.sum(np.square(moved), axis=0), axis=1))
    amounts, precision, squares = np.zeros(residual.shape[1]), np.ones(residual.shape[1]), np.inf
    for _ in range(_STEPS):
        direction = _times(moved, mixture)
        precision = np.maximum(np.sum(np.square(direction), axis=0), 1e-300)
        unit = direction / np.sqrt(precision)
        # What no row's own amount can explain decides the common coefficients.
        along = np.einsum("mn,mpn->pn", unit, common)
        gram = np.eye(common.shape[1]) - along @ along.T
        across = residual - unit * np.sum(unit * residual, axis=0)
        shared = np.linalg.lstsq(gram, _products(common, across), rcond=_LEAST_NEW)[0]
        amounts = np.sum(direction * (residual - _times(common, shared)), axis=0) / precision
        amounts = amounts - np.average(amounts, weights=precision)
        previous = squares
        _, mixture, squares = _fit(residual, common, moved * amounts)
        mixture = mixture / max(float(np.abs(mixture).max()), 1e-300)
        if previous - squares < _SETTLED * squares:
            break
    return amounts, precision, squares


def _labels(amounts: Array, precision: Array, count: int) -> NDArray[np.int64]:
    """Return the best grouping ``(N,)`` of weighted numbers, from starts at quantiles."""
    levels = np.quantile(amounts, (np.arange(count) + 0.5) / count)
    labels = np.zeros(amounts.size, dtype=np.int64)
    for _ in range(_STEPS):
        labels = np.argmin(np.abs(amounts[:, None] - levels), axis=1)
        weight = np.bincount(labels, precision, count)
        levels = np.where(
            weight > 0, np.bincount(labels, precision * amounts, count) / np.maximum(weight, 1e-300), levels
        )
    return labels


def _settled(residual: Array, common: Array, moved: Array, labels: NDArray[np.int64]) -> _Grouping:
    """Return the grouping with the levels, the mixture and the common coefficients fitted together, in turn."""
    count = int(labels.max()) + 1
    levels = np.arange(count, dtype=float)
    squares = np.inf
    for _ in range(_REGROUPED):
        shared, mixture, squares = _fit(residual, common, moved * levels[labels])
        direction = _times(moved, mixture)
        error = residual - _times(common, shared)
        products, sizes = np.sum(direction * error, axis=0), np.sum(np.square(direction), axis=0)
        weight = np.bincount(labels, sizes, count)
        levels = np.bincount(labels, products, count) / np.maximum(weight, 1e-300)
        away = np.sum(np.square(error[:, :, None] - direction[:, :, None] * levels), axis=0)
        labels = np.argmin(away, axis=1)
    return _Grouping(labels, levels, squares)
