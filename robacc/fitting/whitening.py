"""Whitening of residuals whose rows share scatter: rows of one visit share the arm's, rows of one pose its own error.

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
    """``(J,)`` drawn anew at each arrival: intrinsic repeatability."""
    pose_std: Array
    """``(J,)`` common to all visits of a commanded pose; zero where no pose was visited twice."""

    @property
    def is_none(self) -> bool:
        """Return whether there is no scatter at all."""
        return not (self.visit_std.any() or self.pose_std.any())


@dataclass(frozen=True, slots=True)
class Block:
    """Blocks with the same number of rows."""

    rows: NDArray[np.int64]
    """``(V, n)`` numbers of the rows."""
    factor: Array
    """``(V, M n, M n)`` symmetric inverse root of each block's covariance, of values scaled by their weights."""


@dataclass(frozen=True)
class Whitening:
    """Linear map that gives residuals unit covariance; a row of weight zero takes no part."""

    weight: Array
    """``(M, N)`` reciprocal standard deviations of the measurement."""
    blocks: tuple[Block, ...] = ()
    marginal_weight: Array | None = None
    """``(M, N)`` reciprocal standard deviations of measurement and scatter together; None where there is no scatter."""

    @property
    def row_weight(self) -> Array:
        """``(M, N)`` reciprocal standard deviation of each component, correlations aside."""
        return self.weight if self.marginal_weight is None else self.marginal_weight

    def apply(self, values: Array) -> Array:
        """Return ``(..., M, N)`` whitened."""
        return self.apply_inplace(values.copy())

    def apply_inplace(self, scaled: Array) -> Array:
        """Whiten ``(..., M, N)`` in place, and return it."""
        scaled *= self.weight
        lead = scaled.shape[:-2]
        components = self.weight.shape[0]
        for block in self.blocks:
            count, n = block.rows.shape
            part = scaled[..., block.rows]  # (..., M, V, n)
            part = np.moveaxis(part, -2, -3).reshape(*lead, count, components * n, 1)
            part = (block.factor @ part).reshape(*lead, count, components, n)
            scaled[..., block.rows] = np.moveaxis(part, -3, -2)
        return scaled

    def subset(self, rows: NDArray[np.int64]) -> Whitening:
        """Return the map of some rows; blocks must be in or out as a whole."""
        place = np.full(self.weight.shape[1], -1, dtype=np.int64)
        place[rows] = np.arange(rows.size)
        blocks = []
        for block in self.blocks:
            inside = place[block.rows]
            whole = (inside >= 0).all(axis=1)
            if whole.any():
                blocks.append(Block(inside[whole], block.factor[whole]))
        marginal = None if self.marginal_weight is None else self.marginal_weight[:, rows]
        return Whitening(self.weight[:, rows], tuple(blocks), marginal)


def whitening(
    weight: Array, joint_columns: Array, scatter: Scatter, visits: NDArray[np.int64], poses: NDArray[np.int64]
) -> Whitening:
    """Build the map from the measurement's weights and the scatter of the joints.

    Args:
        weight: ``(M, N)`` reciprocal standard deviations, zero for rows that take no part.
        joint_columns: ``(M, J, N)`` what a unit of each joint variable does to a row.
        scatter: Standard deviations of the joints.
        visits: ``(N,)`` number of the visit of each row.
        poses: ``(N,)`` number of the commanded pose of each row; rows of one visit have one.
    """
    if scatter.is_none:
        return Whitening(weight)
    scaled = joint_columns * weight[:, None, :]
    blocks = []
    for rows in blocks_of(poses if scatter.pose_std.any() else visits):
        covariance = _covariance(scaled, rows, scatter, visits)
        values, vectors = np.linalg.eigh(covariance)
        factor = (vectors / np.sqrt(1.0 + np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        blocks.append(Block(rows, factor))
    variance = np.einsum("mjn,j->mn", np.square(scaled), np.square(scatter.visit_std) + np.square(scatter.pose_std))
    return Whitening(weight, tuple(blocks), weight / np.sqrt(1.0 + variance))


def blocks_of(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return rows ``(V, n)`` of equal numbers, blocks of one size together."""
    order = np.argsort(numbers, kind="stable")
    _, first, counts = np.unique(numbers[order], return_index=True, return_counts=True)
    return [order[first[counts == n][:, None] + np.arange(n)].astype(np.int64) for n in np.unique(counts).tolist()]


def _covariance(scaled: Array, rows: NDArray[np.int64], scatter: Scatter, visits: NDArray[np.int64]) -> Array:
    """``(V, M n, M n)`` scatter of the scaled rows of each block."""
    count, n = rows.shape
    components, joints = scaled.shape[:2]
    columns = np.moveaxis(scaled[:, :, rows], (2, 0, 3, 1), (0, 1, 2, 3)).reshape(count, components * n, joints)
    same = np.tile((visits[rows][:, :, None] == visits[rows][:, None, :]), (1, components, components))
    result = (columns * np.square(scatter.visit_std)) @ np.swapaxes(columns, 1, 2) * same
    if scatter.pose_std.any():
        result = result + (columns * np.square(scatter.pose_std)) @ np.swapaxes(columns, 1, 2)
    return np.asarray(result, dtype=np.float64)
