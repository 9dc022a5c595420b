"""Least squares in plain NumPy: what the studies compare robacc's fits with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from arm import Setup


@dataclass(frozen=True)
class Fit:
    """Coefficients (P,), remaining error (rms per axis), whether the steps died out.

    ``std`` (P,) is each coefficient's standard error per unit of noise, infinite where the nominal Jacobian cannot
    identify it, zero where it was not fitted.
    """

    values: np.ndarray
    rms: float
    converged: bool
    std: np.ndarray


def fit(
    setup: Setup,
    q: np.ndarray,
    target: np.ndarray,
    xyz: np.ndarray,
    mask: np.ndarray,
    prior: np.ndarray | None = None,
    noise: float = 1.0,
    cutoff: float = 1e-7,
) -> Fit:
    """Levenberg-Marquardt from the nominal model over the coefficients of ``mask``.

    Directions that the nominal Jacobian cannot identify (singular values of its scaled columns below ``cutoff`` of the
    largest) stay at nominal. ``prior`` (P,): one standard deviation each, infinite for none; then the result is
    the maximum a posteriori estimate at measurement noise ``noise`` per axis.
    """
    free = np.flatnonzero(mask)
    pull = np.zeros(len(free)) if prior is None else noise / prior[free]
    values = np.zeros(len(setup.names))
    scale = np.linalg.norm(setup.jacobian(values, q, target, mask), axis=0) + pull
    scale[scale < 1e-12 * scale.max()] = 1.0

    def residual(values: np.ndarray) -> np.ndarray:
        return np.concatenate([(xyz - setup.positions(values, q, target)).ravel(), -pull * values[free]])

    def slope(values: np.ndarray) -> np.ndarray:
        return np.vstack([setup.jacobian(values, q, target, mask), np.diag(pull)]) / scale

    _, singular, rows = np.linalg.svd(np.linalg.qr(slope(values), mode="r"))
    basis = rows[singular > cutoff * singular[0]].T
    r, damping, converged = residual(values), 1e-4, False
    for _ in range(100):
        j = slope(values) @ basis
        normal, right = j.T @ j, j.T @ r
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right)
        gain = step @ right
        moved = values.copy()
        moved[free] += basis @ step / scale
        new = residual(moved)
        if new @ new <= r @ r:
            values, r, damping = moved, new, max(damping / 10, 1e-14)
        else:
            damping *= 10
        if gain <= 1e-12 * (r @ r) or gain <= 1e-26 * len(r):
            converged = True
            break
    inverse = np.linalg.pinv(np.linalg.qr(slope(values) @ basis, mode="r"), rcond=1e-13)
    std = np.zeros(len(values))
    std[free] = np.linalg.norm(basis @ inverse, axis=1) / scale
    std[free[np.sum(basis**2, axis=1) < 1 - 1e-9]] = np.inf
    return Fit(values, float(np.sqrt(np.mean(r[: xyz.size] ** 2))), converged, std)


def identifiable(jacobian: np.ndarray, cutoff: float = 1e-7) -> np.ndarray:
    """Mask of the columns that no combination of the others can stand for."""
    scaled = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    _, singular, rows = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
    rank = int(np.sum(singular > cutoff * singular[0]))
    return np.all(np.abs(rows[rank:]) < 1e-5, axis=0) if rank < len(rows) else np.ones(len(rows), bool)
