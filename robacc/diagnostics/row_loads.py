"""Loads at the flange that differ from row to row and that nobody logged.

A load of m_k kg on row k moves the tool by m_k sum_j c_j u_jk, with u_jk the displacement by the torque of 1 kg on
joint j and c_j the compliance of the joint. Both factors are unknown, so they are fitted in turn (alternating least
squares), beside every coefficient of the model and beside a constant load. Loads come in a few sizes: the fitted loads
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
_REGROUPED = 10
"""Largest number of times that rows are grouped anew."""
_LEAST_GAIN = 4.0
"""Factor by which groups of loads lower the sum of squares. Chance gives 1.5 at most: one coordinate of three a row."""
_LEAST_BETTER = 2.0
"""Factor by which loads leave a smaller sum of squares than shifts of the same joints."""
_LARGEST_SPREAD = 2.0
"""Factor by which groups may leave a larger sum of squares than a load of its own for each row, but for its freedom."""
_LEAST_TORQUE = 0.1
"""Least torque of 1 kg on a joint that may give way, over the largest on any joint."""


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
            f"the errors are those of a load at the flange that differs from row to row: {len(self.rows)} groups of "
            f"{sizes} rows, their loads above the lightest as {shares}; the payload was not logged: write payload_kg "
            "for each row and trace again"
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
    common = common / np.maximum(np.sqrt(np.sum(np.square(common), axis=(0, 2), keepdims=True)), 1e-300)
    squares = _fit(residual, common)[1]
    amounts, precision, free = _amounts(residual, common, moved)
    n = residual.shape[1]
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


def _fit(residual: Array, columns: Array) -> tuple[Array, float]:
    """Return least-squares coefficients of ``(3, P, N)`` columns and the sum of squares that remains."""
    matrix = np.moveaxis(columns, 1, 2).reshape(residual.size, -1)
    solution = np.asarray(np.linalg.lstsq(matrix, residual.ravel(), rcond=1e-9)[0], dtype=np.float64)
    return solution, float(np.sum(np.square(residual.ravel() - matrix @ solution)))


def _amounts(residual: Array, common: Array, moved: Array) -> tuple[Array, Array, float]:
    """Return each row's own amount ``(N,)`` of the same mixture of ``moved``, its precision, and the sum of squares."""
    mixture = 1.0 / np.sqrt(np.mean(np.sum(np.square(moved), axis=0), axis=1))
    amounts, precision, squares = np.zeros(residual.shape[1]), np.ones(residual.shape[1]), 0.0
    for _ in range(_STEPS):
        direction = np.einsum("mjn,j->mn", moved, mixture)
        precision = np.maximum(np.sum(np.square(direction), axis=0), 1e-300)
        unit = direction / np.sqrt(precision)
        across = common - unit[:, None] * np.einsum("mn,mpn->pn", unit, common)
        shared = _fit(residual - unit * np.sum(unit * residual, axis=0), across)[0]
        amounts = np.sum(direction * (residual - np.einsum("mpn,p->mn", common, shared)), axis=0) / precision
        amounts = amounts - np.average(amounts, weights=precision)
        solution, squares = _fit(residual, np.concatenate((common, moved * amounts), axis=1))
        mixture = solution[common.shape[1] :]
        mixture = mixture / max(float(np.abs(mixture).max()), 1e-300)
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
        solution, squares = _fit(residual, np.concatenate((common, moved * levels[labels]), axis=1))
        shared, mixture = np.split(solution, [common.shape[1]])
        direction = np.einsum("mjn,j->mn", moved, mixture)
        error = residual - np.einsum("mpn,p->mn", common, shared)
        products, sizes = np.sum(direction * error, axis=0), np.sum(np.square(direction), axis=0)
        weight = np.bincount(labels, sizes, count)
        levels = np.bincount(labels, products, count) / np.maximum(weight, 1e-300)
        away = np.sum(np.square(error[:, :, None] - direction[:, :, None] * levels), axis=0)
        labels = np.argmin(away, axis=1)
    return _Grouping(labels, levels, squares)
