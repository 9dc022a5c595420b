"""Registration of the base and of each target for many hypotheses at once, in closed form.

With F the arm's own pose (base to last link), R the rotation from the measuring frame to the base and g the target on
the last link, a measured position p obeys R p = p_F + R_F g + u. For a given R the best g and u are linear in R, so
that the squared error is a quadratic form in the nine elements of R, whatever the number of poses. Its minimum without
the constraint, made orthogonal, is the start of a few Gauss-Newton steps on the rotation. Orientations obey
R_B R_F R_G = measured; R_B and R_G come from the leading singular vectors of the mean of R_F ⊗ measured.

Hypotheses are the leading axis H of every array; a stack of H matrices has the shape ``(H, m, m)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array

_PASSES = 3
"""Fits of a registration that outliers do not disturb."""
_STEPS = 5
"""Gauss-Newton steps of the rotation."""
_LONGEST_STEP = 0.5
"""rad; longest step of the rotation."""
_CAUCHY = 3.0
"""Median errors at which a row has half its weight."""
_RIDGE = 1e-9
"""Share of the largest diagonal element by which normal matrices are regularised: directions that are not identifiable
(the height of a SCARA's target) stay where they are."""
_GENERATORS = np.array(
    [
        [[0, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
    ],
    dtype=float,
)


@dataclass(frozen=True, slots=True)
class BatchFit:
    """Registration of positions or of orientations for each of H hypotheses."""

    errors: Array
    """``(H, N)`` length (m) or angle (rad) of the remaining error."""
    rotation: Array
    """``(H, 3, 3)`` rotation from the measuring frame to the base."""

    @property
    def median(self) -> Array:
        """Return the median error ``(H,)``, m or rad."""
        return np.asarray(np.median(self.errors, axis=1))


def register_positions(
    rotation: Array,
    translation: Array,
    measured: Array,
    target: NDArray[np.int64],
    n_targets: int,
    *,
    turn: Array | None = None,
    passes: int = _PASSES,
) -> BatchFit:
    """Register base and targets to measured positions.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        translation: ``(H, N, 3)`` its position, m.
        measured: ``(H or 1, N, 3)`` measured positions, m.
        target: ``(N,)`` number of each row's target.
        n_targets: Number of targets.
        turn: ``(H, 3, 3)`` known rotation from the measuring frame to the base; None to fit it.
        passes: Fits, each with the rows weighted by their errors in the one before.
    """
    measured = measured - measured.mean(axis=1, keepdims=True)
    translation = translation - translation.mean(axis=1, keepdims=True)
    mask = np.zeros((n_targets, target.size))
    mask[target, np.arange(target.size)] = 1.0
    weight = np.ones(translation.shape[:2])
    for _ in range(passes):
        form = _QuadraticForm(rotation, translation, measured, mask, weight)
        fitted = form.best_rotation() if turn is None else turn
        errors = form.errors(fitted)
        typical = np.maximum(np.median(errors, axis=1, keepdims=True), 1e-12)
        weight = 1.0 / (1.0 + np.square(errors / (_CAUCHY * typical)))
    return BatchFit(errors, fitted)


def register_orientations(rotation: Array, measured: Array) -> BatchFit:
    """Register base and target to measured orientations.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H or 1, N, 3, 3)`` measured orientations.
    """
    h, n = rotation.shape[:2]
    measured = np.broadcast_to(measured, rotation.shape)
    weight = np.ones((h, n))
    for _ in range(_PASSES):
        # (i, j), (l, k) of R_F and the measured orientation; see robacc.fitting.closed_form.
        first = (rotation * weight[..., None, None]).reshape(h, n, 9)
        mixed = (np.swapaxes(first, 1, 2) @ measured.reshape(h, n, 9)).reshape(h, 3, 3, 3, 3)
        left, _, right = np.linalg.svd(mixed.transpose(0, 2, 4, 3, 1).reshape(h, 9, 9))
        tool, base = left[:, :, 0].reshape(h, 3, 3), right[:, 0, :].reshape(h, 3, 3)
        sign = np.where(np.linalg.det(tool) < 0, -1.0, 1.0)[:, None, None]
        tool, base = nearest_rotation(sign * tool), nearest_rotation(sign * base)
        predicted = base[:, None] @ rotation @ tool[:, None]
        trace = np.einsum("hnij,hnij->hn", predicted, measured)
        errors = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        typical = np.maximum(np.median(errors, axis=1, keepdims=True), 1e-12)
        weight = 1.0 / (1.0 + np.square(errors / (_CAUCHY * typical)))
    return BatchFit(errors, np.swapaxes(base, 1, 2))


def orientation_errors(rotation: Array, measured: Array, base: Array) -> Array:
    """Return the median orientation error ``(H,)``, rad, with the target registered and the base's rotation known.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H or 1, N, 3, 3)`` measured orientations.
        base: ``(H, 3, 3)`` rotation from the measuring frame to the base.
    """
    turned = base[:, None] @ measured
    tool = nearest_rotation(np.einsum("hnji,hnjk->hik", rotation, turned))
    trace = np.einsum("hnij,hnij->hn", rotation @ tool[:, None], turned)
    return np.asarray(np.median(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)), axis=1))


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotations nearest to a stack of 3 x 3 matrices (polar factor; Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    result: Array = u @ vt
    return result


class _QuadraticForm:
    """Squared position error as a function of the nine elements of R, row by row: ``r A r - 2 b r + c``."""

    def __init__(self, rotation: Array, translation: Array, measured: Array, mask: Array, weight: Array) -> None:
        """Eliminate shift and targets; ``mask`` ``(T, N)`` assigns rows to targets."""
        h, n = weight.shape
        targets = mask.shape[0]
        self._arm = (rotation, translation, np.broadcast_to(measured, translation.shape), mask)
        size = 3 + 3 * targets
        total = weight.sum(axis=1)
        weights = mask[:, None, :] * weight[None]  # (T, H, N)
        point = self._arm[2]
        # Sums of weight x R_F, weight x R_F[c, a] p[b], weight x R_F^T p_F, by target.
        turned = np.einsum("thn,hnca->thca", weights, rotation, optimize=True)
        by_row = rotation.reshape(h, n, 9)
        mixed = np.stack([np.swapaxes(by_row * w[..., None], 1, 2) @ point for w in weights])  # (T, H, 9, 3)
        mixed = mixed.reshape(targets, h, 3, 3, 3)  # (T, H, c, a, b)
        own = np.einsum("hnca,hnc->hna", rotation, translation)
        normal = np.zeros((h, size, size))
        columns = np.zeros((h, size, 9))
        rhs = np.zeros((h, size))
        normal[:, :3, :3] = total[:, None, None] * np.eye(3)
        sums = np.einsum("hn,hnb->hb", weight, point)
        for c in range(3):
            columns[:, c, 3 * c : 3 * c + 3] = sums
        rhs[:, :3] = np.einsum("hn,hnc->hc", weight, translation)
        for k in range(targets):
            at = slice(3 + 3 * k, 6 + 3 * k)
            normal[:, :3, at] = turned[k]
            normal[:, at, :3] = np.swapaxes(turned[k], 1, 2)
            normal[:, at, at] = weights[k].sum(axis=1)[:, None, None] * np.eye(3)
            columns[:, at] = np.swapaxes(mixed[k], 1, 2).reshape(h, 3, 9)
            rhs[:, at] = np.einsum("hn,hna->ha", weights[k], own)
        normal += _RIDGE * total[:, None, None] * np.eye(size)
        self._solved = np.linalg.solve(normal, np.concatenate([columns, rhs[..., None]], axis=2))
        weighted = point * weight[..., None]
        second = np.swapaxes(weighted, 1, 2) @ point
        self._a = np.zeros((h, 9, 9))
        for c in range(3):
            self._a[:, 3 * c : 3 * c + 3, 3 * c : 3 * c + 3] = second
        self._covariance = (np.swapaxes(translation, 1, 2) @ weighted).reshape(h, 9)
        across = np.swapaxes(columns, 1, 2)
        self._a -= across @ self._solved[..., :9]
        self._b = self._covariance - (across @ self._solved[..., 9:])[..., 0]

    def best_rotation(self) -> Array:
        """Return the rotation ``(H, 3, 3)`` of least squared error that two starts lead to."""
        scale = np.trace(self._a, axis1=1, axis2=2)[:, None, None] / 9.0 + 1e-30
        free = np.linalg.solve(self._a + 1e-8 * scale * np.eye(9), self._b[..., None])[..., 0]
        starts = (free, self._covariance)
        best, least = None, None
        for start in starts:
            turn, cost = self._refined(nearest_rotation(start.reshape(-1, 3, 3)))
            if best is None or least is None:
                best, least = turn, cost
            else:
                better = cost < least
                best = np.where(better[:, None, None], turn, best)
                least = np.where(better, cost, least)
        assert best is not None
        return best

    def _refined(self, turn: Array) -> tuple[Array, Array]:
        """Return the rotation after Gauss-Newton steps, and its cost."""
        best, least = turn, self._cost(turn)
        for _ in range(_STEPS):
            tangent = np.einsum("kij,hjl->hilk", _GENERATORS, turn).reshape(-1, 9, 3)
            gradient = np.einsum("hmn,hn->hm", self._a, turn.reshape(-1, 9)) - self._b
            transposed = np.swapaxes(tangent, 1, 2)
            normal = transposed @ self._a @ tangent
            size = np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-30
            step = -np.linalg.solve(normal + 1e-9 * size * np.eye(3), transposed @ gradient[..., None])[..., 0]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(length, 1e-30))
            turn = nearest_rotation(turn + np.einsum("hk,kij,hjl->hil", step, _GENERATORS, turn))
            cost = self._cost(turn)
            better = cost < least
            best, least = np.where(better[:, None, None], turn, best), np.where(better, cost, least)
        return best, least

    def _cost(self, turn: Array) -> Array:
        r = turn.reshape(-1, 9)
        return np.asarray(np.einsum("hm,hmn,hn->h", r, self._a, r) - 2.0 * np.sum(r * self._b, axis=1))

    def errors(self, turn: Array) -> Array:
        """Return the length of each row's error ``(H, N)`` with the best shift and targets for these rotations."""
        rotation, translation, point, mask = self._arm
        solved = (self._solved[..., :9] @ turn.reshape(-1, 9, 1) - self._solved[..., 9:])[..., 0]
        offset = solved[:, 3:].reshape(solved.shape[0], -1, 3)[:, np.argmax(mask, axis=0)]  # (H, N, 3)
        predicted = translation + solved[:, None, :3] + np.einsum("hnca,hna->hnc", rotation, offset)
        return np.asarray(np.linalg.norm(point @ np.swapaxes(turn, 1, 2) - predicted, axis=2))
