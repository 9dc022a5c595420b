"""Whitening of residuals with shared scatter: rows of a visit share the arm's scatter, rows of a pose its error.

The covariance of the rows of a block (one commanded pose, or one visit where each pose is visited once) is

    R = D + sum_v B_v diag(s_1^2 ... s_J^2) B_v^T + B diag(p_1^2 ... p_J^2) B^T,

D the diagonal covariance of the measurement, B_v the columns of the joint variables in the Jacobian, for the rows of
visit v (equation (7) of Wu and Lee within the measurement model), and s_j the intrinsic repeatability of joint j. The
last term is common to all visits of a pose. Rows are whitened by the symmetric R^(-1/2), which does not depend on their
order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of the joints' scatter, rad or m."""

    visit_std: Array
    """``(J,)`` scatter from visit to visit: intrinsic repeatability."""
    pose_std: Array
    """``(J,)`` error common to all visits of a commanded pose; zero if no pose was visited twice."""

    @property
    def is_none(self) -> bool:
        """Return whether all standard deviations are zero."""
        return not (self.visit_std.any() or self.pose_std.any())


@dataclass(frozen=True, slots=True)
class BlockFactor:
    """Whitening factors of the blocks with a given number of rows."""

    rows: NDArray[np.int64]
    """``(V, n)`` numbers of the rows."""
    factor: Array
    """``(V, M n, M n)`` symmetric inverse root of each block's covariance, of values scaled by their weights."""


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

    def apply(self, values: Array) -> Array:
        """Return ``(..., M, N)`` whitened."""
        return self.apply_inplace(values.copy())

    def apply_inplace(self, scaled: Array) -> Array:
        """Whiten a contiguous array ``(..., M, N)`` in place, and return it."""
        scaled *= self.weight
        flat = scaled.reshape(-1, *self.weight.shape)
        for block in self.blocks:
            part = flat.transpose(2, 1, 0)[block.rows].swapaxes(1, 2)  # (V, M, n, Q), as few products as can be
            product = (block.factor @ part.reshape(*block.factor.shape[:2], -1)).reshape(part.shape)
            flat[..., block.rows] = product.transpose(3, 1, 0, 2)
        return scaled

    def apply_transposed(self, values: Array) -> Array:
        """Return ``(..., M, N)`` multiplied by the transposed map: the factors first, then the weights."""
        plain = Whitening(np.ones_like(self.weight), self.blocks)
        result: Array = plain.apply(values) * self.weight
        return result

    def subset(self, rows: NDArray[np.int64]) -> Whitening:
        """Return the map of the given rows; each block must be included or excluded as a whole."""
        place = np.full(self.weight.shape[1], -1, dtype=np.int64)
        place[rows] = np.arange(rows.size)
        blocks = []
        for block in self.blocks:
            inside = place[block.rows]
            included = (inside >= 0).all(axis=1)
            if included.any():
                blocks.append(BlockFactor(inside[included], block.factor[included]))
        marginal = None if self.marginal_weight is None else self.marginal_weight[:, rows]
        return Whitening(self.weight[:, rows], tuple(blocks), marginal)


def whitening(
    weight: Array, joint_columns: Array, scatter: Scatter, visits: NDArray[np.int64], poses: NDArray[np.int64]
) -> Whitening:
    """Build the map from the measurement's weights and the scatter of the joints.

    Args:
        weight: ``(M, N)`` reciprocal standard deviations, zero for rows that are ignored.
        joint_columns: ``(M, J, N)`` Jacobian of the joint variables.
        scatter: Standard deviations of the joints.
        visits: ``(N,)`` number of the visit of each row.
        poses: ``(N,)`` number of the commanded pose of each row; all rows of a visit share it.
    """
    if scatter.is_none:
        return Whitening(weight)
    scaled = joint_columns * weight[:, None, :]
    blocks = []
    for rows in blocks_of(poses if scatter.pose_std.any() else visits):
        covariance = _covariance(scaled, rows, scatter, visits)
        values, vectors = np.linalg.eigh(covariance)
        factor = (vectors / np.sqrt(1.0 + np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        blocks.append(BlockFactor(rows, factor))
    variance = np.einsum("mjn,j->mn", np.square(scaled), np.square(scatter.visit_std) + np.square(scatter.pose_std))
    return Whitening(weight, tuple(blocks), weight / np.sqrt(1.0 + variance))


def blocks_of(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the blocks of rows with equal numbers, ``(V, n)`` for each block size n."""
    order = np.argsort(numbers, kind="stable")
    _, first, counts = np.unique(numbers[order], return_index=True, return_counts=True)
    return [order[first[counts == n][:, None] + np.arange(n)].astype(np.int64) for n in np.unique(counts).tolist()]


def block_columns(columns: Array, rows: NDArray[np.int64]) -> Array:
    """Return the columns ``(M, J, N)`` of the rows of each block, all components under each other: ``(V, M n, J)``."""
    count, n = rows.shape
    components, joints = columns.shape[:2]
    return np.moveaxis(columns[:, :, rows], (2, 0, 3, 1), (0, 1, 2, 3)).reshape(count, components * n, joints)


def _covariance(scaled: Array, rows: NDArray[np.int64], scatter: Scatter, visits: NDArray[np.int64]) -> Array:
    """Return ``(V, M n, M n)`` scatter covariance of the scaled rows of each block."""
    columns = block_columns(scaled, rows)
    components = scaled.shape[0]
    same = np.tile((visits[rows][:, :, None] == visits[rows][:, None, :]), (1, components, components))
    result = (columns * np.square(scatter.visit_std)) @ np.swapaxes(columns, 1, 2) * same
    if scatter.pose_std.any():
        result = result + (columns * np.square(scatter.pose_std)) @ np.swapaxes(columns, 1, 2)
    return np.asarray(result, dtype=np.float64)
