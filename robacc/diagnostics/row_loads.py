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

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.diagnostics.row_mistakes import MOST_ROWS
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.geometry import Array
from robacc.gravity import gravity_torques, payload
from robacc.measurements import Measurements, even_rows

_FEWEST_ROWS = 40
_MOST_GROUPS = 4
_SMALLEST_GROUP = 0.05
"""Least share of the rows in a group."""
_STEPS = 40
"""Steps of the alternations, which bounds the time."""
_SETTLED = 1e-3
"""Share of the sum of squares that a step gains at the end: far below the factors that decide."""
_LEAST_NEW = 1e-5
"""Share of a column, given others, below which it adds nothing."""
_LEAST_GAIN = 4.0
"""Factor by which groups of loads lower the sum of squares. Chance gives 1.5 at most: one coordinate of three a row."""
_CLEARLY = 2.0
"""Factor by which loads leave a smaller sum of squares than shifts of the same joints, and up to which groups may leave
a larger one than a load of its own for each row, but for its freedom."""


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
        sizes = " : ".join(str(rows.size) for rows in self.rows)
        shares = " : ".join(f"{load:.2g}" for load in self.loads)
        return (
            f"a load at the flange that differs from row to row explains the errors: {len(self.rows)} groups of "
            f"{sizes} rows, whose loads above the lightest are in the ratio {shares}; the payload was not logged: if "
            "it changed, write payload_kg for each row, or the load's name in payload_group, and trace again; if it "
            "did not change, the cause is outside the catalogue"
        )


def unlogged_loads(fit: Fit, data: Measurements) -> RowLoads | None:
    """Return the groups of rows with different loads that explain the remaining error; None if there are none."""
    if data.payload is not None or data.q is None or data.n < _FEWEST_ROWS:
        return None
    rows = even_rows(data.n, MOST_ROWS)
    part = data.subset(rows)
    torque = gravity_torques(fit.model.arm, part.q, payload(fit.model.arm, np.ones(part.n)))  # type: ignore[arg-type]
    size = np.linalg.norm(torque, axis=1)
    if size.max() == 0.0:
        return None
    # Joints that 1 kg hardly loads do not show it.
    loaded = np.flatnonzero(size > 0.1 * size.max())
    shifts = joint_columns(fit.model, part)[:3, loaded]
    jacobian = fit.model.bind(part).linearise(fit.theta)[1][:3]
    by_load, by_shift = (
        _grouped(fit.residual[:3, rows], np.concatenate((jacobian, moved), axis=1), moved)
        for moved in (shifts * torque[loaded], shifts)
    )
    if by_load is None or (by_shift is not None and by_shift[2] < _CLEARLY * by_load[2]):
        return None
    labels, levels, _ = by_load
    order = np.argsort(levels)
    shares = (levels[order] - levels.min()) / np.ptp(levels)
    return RowLoads(tuple(rows[labels == label] for label in order), tuple(shares.tolist()))


_Grouping = tuple[NDArray[np.int64], Array, float]
"""Group of each row ``(N,)``, level of each group, and the sum of squares that remains."""


def _grouped(residual: Array, common: Array, moved: Array) -> _Grouping | None:
    """Return the fewest groups of rows whose products with ``moved`` ``(3, J, N)`` explain the residual ``(3, N)``.

    ``common`` ``(3, P, N)`` are columns with one coefficient for all rows.
    """
    n = residual.shape[1]
    columns = _flat(common)
    left, sizes, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    basis = left[:, sizes > _LEAST_NEW * sizes.max()]
    squares = float(np.sum(np.square(residual.ravel() - basis @ (basis.T @ residual.ravel()))))
    amounts, free = _amounts(residual, basis, moved)
    if squares <= _LEAST_GAIN * free:
        # Groups of loads explain no more than a load of its own for each row.
        return None
    for count in range(2, _MOST_GROUPS + 1):
        limits = np.quantile(amounts, np.arange(1, count) / count)
        grouping = _settled(residual, basis, moved, np.searchsorted(limits, amounts), count)
        labels, _, remaining = grouping
        if np.bincount(labels, minlength=count).min() < max(_SMALLEST_GROUP * n, 3):
            continue
        gain = squares / max(remaining, 1e-300)
        cost = n * np.log(count) + 0.5 * np.log(3 * n) * (count + moved.shape[1])
        # Each row's own amount takes one of its three coordinates. Equal groups of evenly spread amounts gain count^2.
        is_tight = remaining < _CLEARLY * 1.5 * free or gain > 2.0 * count**2
        if gain > _LEAST_GAIN and is_tight and 1.5 * n * np.log(gain) > cost:
            return grouping
    return None


def _flat(columns: Array) -> Array:
    """Return columns ``(3, P, N)`` as a matrix ``(3 N, P)``."""
    return np.moveaxis(columns, 1, 2).reshape(-1, columns.shape[1])


def _fit(residual: Array, basis: Array, moved: Array) -> tuple[Array, Array, float]:
    """Fit ``moved`` ``(3, J, N)`` and the orthonormal ``basis`` ``(3 N, R)`` to the residual by least squares.

    Returns:
        The residual ``(3, N)`` without the part of the basis, the coefficients of ``moved``, and the sum of squares
        that remains.
    """
    columns = _flat(moved)
    coefficients = np.linalg.lstsq(columns - basis @ (basis.T @ columns), residual.ravel(), rcond=_LEAST_NEW)[0]
    rest = residual.ravel() - columns @ coefficients
    shared = basis @ (basis.T @ rest)
    return residual - shared.reshape(residual.shape), np.asarray(coefficients), float(np.sum(np.square(rest - shared)))


def _amounts(residual: Array, basis: Array, moved: Array) -> tuple[Array, float]:
    """Return each row's own amount ``(N,)`` of the same mixture of ``moved``, and the sum of squares."""
    mixture, squares = 1.0 / np.sqrt(np.mean(np.sum(np.square(moved), axis=0), axis=1)), math.inf
    for _ in range(_STEPS):
        before = squares
        direction = mixture @ moved
        precision = np.maximum(np.sum(np.square(direction), axis=0), 1e-300)
        unit = direction / np.sqrt(precision)
        # What no row's own amount can explain decides the common coefficients.
        along = np.sum(unit[:, :, None] * basis.reshape(3, -1, basis.shape[1]), axis=0)
        across = residual - unit * np.sum(unit * residual, axis=0)
        gram = (1.0 + _LEAST_NEW**2) * np.eye(basis.shape[1]) - along.T @ along
        shared = basis @ np.linalg.solve(gram, basis.T @ across.ravel())
        amounts = np.sum(direction * (residual - shared.reshape(residual.shape)), axis=0) / precision
        amounts = amounts - np.average(amounts, weights=precision)
        _, mixture, squares = _fit(residual, basis, moved * amounts)
        mixture = mixture / max(float(np.abs(mixture).max()), 1e-300)
        if before - squares <= _SETTLED * before < math.inf:
            break
    return amounts, squares


def _settled(residual: Array, basis: Array, moved: Array, labels: NDArray[np.int64], count: int) -> _Grouping:
    """Return the grouping with the levels, the mixture and the common coefficients fitted together, in turn."""
    levels = np.arange(count, dtype=float)
    for _ in range(_STEPS):
        error, mixture, squares = _fit(residual, basis, moved * levels[labels])
        direction = mixture @ moved
        products, sizes = np.sum(direction * error, axis=0), np.sum(np.square(direction), axis=0)
        levels = np.bincount(labels, products, count) / np.maximum(np.bincount(labels, sizes, count), 1e-300)
        away = np.sum(np.square(error[:, :, None] - direction[:, :, None] * levels), axis=0)
        labels = np.argmin(away, axis=1)
    return labels, levels, squares
