"""Whitening of residuals: rows of a visit share the arm's scatter.

The covariance of the rows of a visit is

    R = D + B diag(s_1^2 ... s_J^2) B^T,

D the covariance of the measurement, B the columns of the joint variables in the Jacobian (equation (7) of Wu and Lee
within the measurement model), and s_j the intrinsic repeatability of joint j. Rows are whitened by its symmetric
inverse root, which does not depend on their order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array

_MOST_NUMBERS = 2**21
"""Numbers of which copies are made at a time."""


def sum_of_squares(values: Array, weight: Array | None = None) -> float:
    """Return the sum of the squares of ``(M, N)``, times ``weight`` ``(M, N)`` if given, a part at a time."""
    total = 0.0
    for start in range(0, values.shape[1], _MOST_NUMBERS // 32):
        part = slice(start, start + _MOST_NUMBERS // 32)
        total += float(np.sum(np.square(values[:, part] if weight is None else values[:, part] * weight[:, part])))
    return total


@dataclass(frozen=True, slots=True)
class BlockFactor:
    """Whitening factors of the visits with a given number of rows."""

    rows: NDArray[np.int64]
    """``(V, n)`` numbers of the rows."""
    factor: Array
    """``(V, M n, M n)`` symmetric inverse root of each visit's covariance, of values scaled by their weights."""


@dataclass(frozen=True)
class Whitening:
    """Linear map that gives residuals unit covariance; rows of weight zero are ignored."""

    weight: Array
    """``(M, N)`` reciprocal standard deviations of the measurement."""
    blocks: tuple[BlockFactor, ...] = ()
    marginal_weight: Array | None = None
    """``(M, N)`` reciprocal standard deviations of measurement and scatter together; None without scatter."""

    @property
    def row_weight(self) -> Array:
        """``(M, N)`` reciprocal standard deviation of each component, without correlations."""
        return self.weight if self.marginal_weight is None else self.marginal_weight

    @property
    def mixes_rows(self) -> bool:
        """Whether rows are whitened together."""
        return bool(self._together.any())

    @cached_property
    def _together(self) -> NDArray[np.bool_]:
        """``(N,)`` mask of the rows that are whitened together with others."""
        together = np.zeros(self.weight.shape[1], dtype=bool)
        for numbers in [block.rows for block in self.blocks if block.rows.shape[1] > 1]:
            together[numbers] = True
        return together

    @cached_property
    def parts(self) -> tuple[tuple[NDArray[np.int64], Whitening], ...]:
        """Return the rows that are whitened one by one and those that are whitened together, each with its map."""
        parts = [np.flatnonzero(mask) for mask in (~self._together, self._together)]
        return tuple((rows, self.subset(rows)) for rows in parts if rows.size)

    def apply(self, values: Array) -> Array:
        """Return ``(..., M, N)`` whitened."""
        return self.apply_inplace(values.copy())

    def apply_inplace(self, scaled: Array) -> Array:
        """Whiten ``(..., M, N)`` in place, and return it."""
        scaled *= self.weight
        return self._by_visit(scaled)

    def cost(self, values: Array) -> float:
        """Return the sum of the squares of ``(M, N)`` whitened."""
        if self.blocks:
            return sum_of_squares(self.apply(values))
        return sum_of_squares(values, self.weight)

    def apply_transposed(self, values: Array) -> Array:
        """Return ``(..., M, N)`` multiplied by the transposed map."""
        scaled = self._by_visit(values.copy())
        scaled *= self.weight
        return scaled

    def _by_visit(self, scaled: Array) -> Array:
        """Multiply ``(..., M, N)`` of scaled values in place by the factors of the visits, and return it."""
        for block in self.blocks:
            step = max(1, _MOST_NUMBERS * scaled.shape[-1] // max(1, scaled.size * block.rows.shape[1]))
            for start in range(0, block.rows.shape[0], step):
                rows, factor = block.rows[start : start + step], block.factor[start : start + step]
                _put(scaled, rows, factor @ _stacked(scaled, rows))
        return scaled

    def subset(self, rows: NDArray[np.int64] | slice) -> Whitening:
        """Return the map of the given rows; each visit must be included or excluded as a whole."""
        weight, blocks = self.weight[:, rows], []
        if self.blocks:
            place = np.full(self.weight.shape[1], -1, dtype=np.int64)
            place[rows] = np.arange(weight.shape[1])
        for block in self.blocks:
            inside = place[block.rows]
            included = (inside >= 0).all(axis=1)
            if included.any():
                blocks.append(BlockFactor(inside[included], block.factor[included]))
        marginal = None if self.marginal_weight is None else self.marginal_weight[:, rows]
        return Whitening(weight, tuple(blocks), marginal)


def whitening(
    weight: Array, joint_columns: Array, scatter: Array, visits: NDArray[np.int64], noise: Array | None = None
) -> Whitening:
    """Build the map from the measurement's weights and the scatter of the joints.

    Args:
        weight: ``(M, N)`` reciprocal standard deviations, zero for rows that are ignored.
        joint_columns: ``(M, J, N)`` Jacobian of the joint variables.
        scatter: ``(J,)`` standard deviation of each joint from visit to visit, rad or m.
        visits: ``(N,)`` number of the visit of each row.
        noise: ``(3, 3)`` covariance of each position in addition to the weights, m²; None without.
    """
    scaled = joint_columns * weight[:, None, :]
    blocks = []
    for rows in blocks_of(visits):
        columns = _block_columns(scaled, rows) * scatter
        scattered = columns @ np.swapaxes(columns, 1, 2)
        blocks.append(
            _block_factor(rows, scattered if noise is None else scattered + _noise_of_rows(weight, rows, noise))
        )
    variance = np.einsum("mjn,j->mn", np.square(scaled), np.square(scatter))
    if noise is not None:
        variance[:3] += np.square(weight[:3]) * np.diag(noise)[:, None]
    return Whitening(weight, tuple(blocks), weight / np.sqrt(1.0 + variance))


def whitening_of_noise(weight: Array, noise: Array) -> Whitening:
    """Build the map from the measurement's weights ``(M, N)`` and the covariance ``noise`` ``(3, 3)`` of a position."""
    rows = np.arange(weight.shape[1])[:, None]
    marginal = weight.copy()
    marginal[:3] /= np.sqrt(1.0 + np.square(weight[:3]) * np.diag(noise)[:, None])
    return Whitening(weight, (_block_factor(rows, _noise_of_rows(weight, rows, noise)),), marginal)


def _noise_of_rows(weight: Array, rows: NDArray[np.int64], noise: Array) -> Array:
    """Return ``(V, M n, M n)`` covariances of blocks of rows by ``noise`` ``(3, 3)`` of each position, scaled."""
    components, (count, n) = weight.shape[0], rows.shape
    result = np.zeros((count, components, n, components, n))
    scaled = weight[:3, rows]
    for i in range(n):
        each = scaled[:, :, i]
        result[:, :3, i, :3, i] = np.einsum("av,ab,bv->vab", each, noise, each)
    return result.reshape(count, components * n, components * n)


def _block_factor(rows: NDArray[np.int64], scaled: Array) -> BlockFactor:
    """Return the symmetric inverse root of the unit matrix plus ``scaled`` ``(V, M n, M n)``."""
    values, vectors = np.linalg.eigh(scaled)
    factor = (vectors / np.sqrt(1.0 + np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return BlockFactor(rows, factor)


def blocks_of(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the blocks of rows with equal numbers, ``(V, n)`` for each block size n."""
    order = np.argsort(numbers, kind="stable")
    _, first, counts = np.unique(numbers[order], return_index=True, return_counts=True)
    return [order[first[counts == n][:, None] + np.arange(n)].astype(np.int64) for n in np.unique(counts).tolist()]


def whole_groups(numbers: NDArray[np.int64], size: int) -> Iterator[NDArray[np.int64]]:
    """Yield the rows in blocks of ``size`` rows, or a few more, that leave rows with equal numbers together.

    Numbers come in the order of their first rows, so that a block's rows lie close together.
    """
    first = np.empty(int(numbers.max(initial=-1)) + 1, dtype=np.int64)
    first[numbers[::-1]] = np.arange(numbers.size)[::-1]
    order = np.argsort(first[numbers], kind="stable")
    last = np.flatnonzero(np.diff(numbers[order], append=-1)) + 1
    start = 0
    while start < order.size:
        end = int(last[np.searchsorted(last, min(start + size, order.size))])
        yield order[start:end]
        start = end


def _block_columns(columns: Array, rows: NDArray[np.int64]) -> Array:
    """Return the columns ``(M, J, N)`` of the rows of each block, all components under each other: ``(V, M n, J)``."""
    count, n = rows.shape
    components, joints = columns.shape[:2]
    return np.moveaxis(columns[:, :, rows], (2, 0, 3, 1), (0, 1, 2, 3)).reshape(count, components * n, joints)


def _stacked(values: Array, rows: NDArray[np.int64]) -> Array:
    """Return the rows of each block of ``(..., M, N)``, all components under each other: ``(V, M n, L)``."""
    by_row = values.reshape(-1, *values.shape[-2:]).transpose(2, 1, 0)
    return by_row[rows].swapaxes(1, 2).reshape(rows.shape[0], values.shape[-2] * rows.shape[1], -1)


def _put(values: Array, rows: NDArray[np.int64], stacked: Array) -> None:
    """Store what :func:`_stacked` returns in ``values``."""
    count, n = rows.shape
    components = values.shape[-2]
    part = stacked.reshape(count, components, n, -1).transpose(3, 1, 0, 2)
    values[..., rows] = part.reshape(*values.shape[:-1], count, n)
