"""Registration of base and targets for many hypotheses at once, in closed form.

With F the arm's own pose (base to last link), R the rotation from the measuring frame to the base and g the target on
the last link, a measured position p obeys R p = p_F + R_F g + u. For a given R the best g and u are linear in R, so
that the squared error is a quadratic form in the nine elements of R, whatever the number of poses. Its minimum without
the constraint, made orthogonal, is the start of a few Gauss-Newton steps on the rotation. Orientations obey R_B R_F R_G
= measured; R_B and R_G come from the leading singular vectors of the mean of R_F ⊗ measured.

Hypotheses are the leading axis H of every array; a stack of H matrices has the shape ``(H, m, m)``.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from robacc.fitting.closed_form import nearest_rotation
from robacc.geometry import Array, skew
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Frame, Robot

_PASSES = 3
"""Fits of a registration, each with the rows weighted by their errors in the one before."""
_CAUCHY = 3.0
"""Median errors at which a row has half its weight."""
_STEPS = 5
"""Gauss-Newton steps of the rotation, which converge quadratically."""
_RIDGE = 1e-9
"""Share of the trace by which normal matrices are regularised: directions that are not identifiable (the height of a
SCARA's target) stay where they are."""
_GENERATORS = np.moveaxis(skew(np.eye(3)), 2, 0)


@dataclass(frozen=True, slots=True)
class Registration:
    """Registration of positions for each of H hypotheses."""

    rotation: Array
    """``(H, 3, 3)`` rotation from the measuring frame to the base."""
    vectors: Array
    """``(H, N, 3)`` the remaining errors, measured minus predicted, in the base, m."""

    @property
    def median(self) -> Array:
        """Return the median length ``(H,)`` of the remaining error, m."""
        return np.asarray(np.median(np.linalg.norm(self.vectors, axis=2), axis=1))


def arm_poses(robot: Robot, data: Measurements, q: Array) -> tuple[Array, Array]:
    """Return the last link's rotations ``(H, N, 3, 3)`` and positions ``(H, N, 3)`` at joints ``(H, J, N)``."""
    h, joints, n = q.shape
    rows = data.subset(np.tile(np.arange(n), h))
    rows = dataclasses.replace(rows, q=q.transpose(1, 0, 2).reshape(joints, h * n))
    poses = predict(dataclasses.replace(robot, tool=Frame(), targets={}), rows)
    return np.moveaxis(poses.rotation, 2, 0).reshape(h, n, 3, 3), poses.translation.T.reshape(h, n, 3)


def rows_by_target(robot: Robot, data: Measurements) -> Array:
    """Return ``(T, N)``, 1 where a row is of a target that occurs, else 0."""
    if data.target is None or not robot.targets:
        return np.ones((1, data.n))
    return np.asarray(np.unique(data.target)[:, None] == data.target, dtype=np.float64)


def register_positions(
    rotation: Array,
    translation: Array,
    measured: Array,
    by_target: Array,
    *,
    turn: Array | None = None,
    passes: int = _PASSES,
) -> Registration:
    """Register base and targets to measured positions.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        translation: ``(H, N, 3)`` its position, m.
        measured: ``(H or 1, N, 3)`` measured positions, m.
        by_target: ``(T, N)`` as :func:`rows_by_target` returns it; without rows only the base is registered.
        turn: ``(H, 3, 3)`` known rotation from the measuring frame to the base; None to fit it.
        passes: Fits.
    """
    h, n = translation.shape[:2]
    # Columns of shift and targets, to eliminate, and of the nine elements of R and the arm.
    shift = np.broadcast_to(np.eye(3), (h, n, 3, 3))
    offsets = np.concatenate([shift, *(rotation * rows[:, None, None] for rows in by_target)], axis=3)
    columns = np.zeros((h, n, 3, 10))
    for axis in range(3):
        columns[:, :, axis, 3 * axis : 3 * axis + 3] = measured - measured.mean(axis=1, keepdims=True)
    columns[..., 9] = translation - translation.mean(axis=1, keepdims=True)
    weight = np.ones((h, n))
    for _ in range(passes):
        root = np.repeat(np.sqrt(weight), 3, axis=1)[..., None]
        free, wanted = offsets.reshape(h, 3 * n, -1) * root, columns.reshape(h, 3 * n, 10) * root
        solved = np.linalg.solve(_regular(np.swapaxes(free, 1, 2) @ free), np.swapaxes(free, 1, 2) @ wanted)
        rest = wanted - free @ solved
        start = (np.swapaxes(wanted, 1, 2) @ wanted)[:, :9, 9]
        fitted = _best_rotation(np.swapaxes(rest, 1, 2) @ rest, start) if turn is None else turn
        vectors = ((rest @ _with_arm(fitted)) / root).reshape(h, n, 3)
        weight = _weights(np.linalg.norm(vectors, axis=2))
    return Registration(fitted, vectors)


def register_orientations(rotation: Array, measured: Array) -> tuple[Array, Array]:
    """Return the rotations ``(H, 3, 3)`` from the measuring frame to the base, and the median errors ``(H,)``, rad.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H, N, 3, 3)`` measured orientations.
    """
    h, n = rotation.shape[:2]
    weight = np.ones((h, n))
    for _ in range(_PASSES):
        # (i, j), (l, k) of R_F and the measured orientation; see robacc.fitting.closed_form.
        weighted = np.swapaxes((rotation * weight[..., None, None]).reshape(h, n, 9), 1, 2)
        mixed = (weighted @ measured.reshape(h, n, 9)).reshape(h, 3, 3, 3, 3)
        left, _, right = np.linalg.svd(mixed.transpose(0, 2, 4, 3, 1).reshape(h, 9, 9))
        tool, base = left[:, :, 0].reshape(h, 3, 3), right[:, 0, :].reshape(h, 3, 3)
        sign = np.sign(np.linalg.det(tool))[:, None, None]
        tool, base = nearest_rotation(sign * tool), nearest_rotation(sign * base)
        errors = _angles(base[:, None] @ rotation @ tool[:, None], measured)
        weight = _weights(errors)
    return np.swapaxes(base, 1, 2), np.asarray(np.median(errors, axis=1))


def orientation_errors(rotation: Array, measured: Array, base: Array) -> Array:
    """Return the median orientation error ``(H,)``, rad, with the target registered and the base's rotation known.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H, N, 3, 3)`` measured orientations.
        base: ``(H, 3, 3)`` rotation from the measuring frame to the base.
    """
    turned = base[:, None] @ measured
    tool = nearest_rotation(np.einsum("hnji,hnjk->hik", rotation, turned))
    return np.asarray(np.median(_angles(rotation @ tool[:, None], turned), axis=1))


def _best_rotation(form: Array, start: Array) -> Array:
    """Return the rotation ``(H, 3, 3)`` of least cost; ``form`` ``(H, 10, 10)`` is of the elements of R and -1.

    Gauss-Newton starts from the minimum without the constraint and from ``start`` ``(H, 9)``.
    """
    h = len(form)
    a, b = form[:, :9, :9], form[:, :9, 9:]
    free = np.linalg.solve(_regular(a), b)[..., 0]
    turns = nearest_rotation(np.stack([free, start]).reshape(2, h, 3, 3))
    for _ in range(_STEPS):
        tangent = np.einsum("kij,shjl->shilk", _GENERATORS, turns).reshape(2, h, 9, 3)
        across = np.swapaxes(tangent, 2, 3)
        gradient = across @ (a @ turns.reshape(2, h, 9, 1) - b)
        step = -np.linalg.solve(_regular(across @ a @ tangent), gradient)[..., 0]
        turns = nearest_rotation(turns + np.einsum("shk,kij,shjl->shil", step, _GENERATORS, turns))
    vector = _with_arm(turns)
    cost = (np.swapaxes(vector, 2, 3) @ form @ vector)[..., 0, 0]
    return np.asarray(turns[np.argmin(cost, axis=0), np.arange(h)])


def _with_arm(turn: Array) -> Array:
    """Return the coefficients ``(..., 10, 1)`` of the columns of positions: the elements of R, and -1 of the arm."""
    flat = turn.reshape(*turn.shape[:-2], 9)
    return np.concatenate([flat, np.full((*flat.shape[:-1], 1), -1.0)], axis=-1)[..., None]


def _regular(normal: Array) -> Array:
    """Return normal matrices ``(..., m, m)`` that can be inverted."""
    size = np.trace(normal, axis1=-2, axis2=-1)[..., None, None] + 1e-30
    return np.asarray(normal + _RIDGE * size * np.eye(normal.shape[-1]))


def _weights(errors: Array) -> Array:
    """Return the weights ``(H, N)`` of rows with these errors."""
    typical = np.maximum(np.median(errors, axis=1, keepdims=True), 1e-12)
    return np.asarray(1.0 / (1.0 + np.square(errors / (_CAUCHY * typical))))


def _angles(predicted: Array, measured: Array) -> Array:
    """Return the angles ``(H, N)`` between orientations ``(H, N, 3, 3)``, rad."""
    trace = np.einsum("hnij,hnij->hn", predicted, measured)
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
