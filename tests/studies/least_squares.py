"""Least squares in plain NumPy: what the studies compare robacc's fits with."""

from dataclasses import dataclass

import numpy as np
from arm import Setup


@dataclass(frozen=True)
class Fit:
    """Coefficients (P,) and remaining error (rms per axis)."""

    values: np.ndarray
    rms: float


def fit(
    setup: Setup,
    q: np.ndarray,
    xyz: np.ndarray,
    mask: np.ndarray,
    cutoff: float = 1e-7,
) -> Fit:
    """Levenberg-Marquardt from the nominal model over the coefficients of ``mask``.

    Directions that the nominal Jacobian cannot identify (singular values of its scaled columns below ``cutoff`` of the
    largest) stay at nominal.
    """
    free = np.flatnonzero(mask)
    values = np.zeros(len(setup.names))
    scale = np.linalg.norm(setup.jacobian(values, q, mask), axis=0)
    scale[scale < 1e-12 * scale.max()] = 1.0

    def residual(values: np.ndarray) -> np.ndarray:
        return (xyz - setup.positions(values, q)).ravel()

    def slope(values: np.ndarray) -> np.ndarray:
        return setup.jacobian(values, q, mask) / scale

    _, singular, rows = np.linalg.svd(np.linalg.qr(slope(values), mode="r"))
    basis = rows[singular > cutoff * singular[0]].T
    r, damping = residual(values), 1e-4
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
            break
    return Fit(values, float(np.sqrt(np.mean(r**2))))


def identifiable(jacobian: np.ndarray, cutoff: float = 1e-7) -> np.ndarray:
    """Mask of the columns that no combination of the others can stand for."""
    scaled = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    _, singular, rows = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
    rank = int(np.sum(singular > cutoff * singular[0]))
    return np.all(np.abs(rows[rank:]) < 1e-5, axis=0) if rank < len(rows) else np.ones(len(rows), bool)
