"""Symmetric systems that rounding or absent data can make singular."""

from __future__ import annotations

import numpy as np

from robacc.geometry import Array

_RIDGE = 1e-11
"""Added to a unit diagonal that is singular to rounding: far below any weight that data give."""

_LARGE = 250
"""Coefficients from which Cholesky's factor is worth the import of SciPy."""


def solved(matrix: Array, rhs: Array) -> Array:
    """Return the solution of ``matrix x = rhs`` for a positive semidefinite matrix with a diagonal of about one.

    A direction without information stays near zero, where an exact solution does not exist.
    """
    try:
        return np.asarray(np.linalg.solve(matrix, rhs), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.solve(_definite(matrix), rhs), dtype=np.float64)


def inverted(matrix: Array) -> Array:
    """Return the inverse of a positive semidefinite matrix with a diagonal of about one, regularised if singular."""
    if len(matrix) >= _LARGE and (inverse := _inverted_definite(matrix)) is not None:
        return inverse
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.inv(_definite(matrix)), dtype=np.float64)


def _inverted_definite(matrix: Array) -> Array | None:
    """Return the inverse by Cholesky's factor, in half of the time; None if rounding leaves the matrix without one."""
    from scipy.linalg.lapack import dpotrf, dpotri

    factor, failed = dpotrf(matrix, lower=True)
    inverse, failed = (factor, failed) if failed else dpotri(factor, lower=True)
    if failed:
        return None
    lower = np.tril(inverse)
    return np.asarray(lower + np.tril(lower, -1).T, dtype=np.float64)


def posterior(gram: Array, prior: Array) -> Array:
    """Return ``(K, K)`` the inverse of the normal matrix with the priors' precision ``(K,)``, through unit diagonal."""
    with np.errstate(divide="ignore"):
        scale = 1.0 / np.sqrt(np.diag(gram) + prior)
    scale[~np.isfinite(scale)] = 0.0
    inverse: Array = scale[:, None] * inverted((gram + np.diag(prior)) * scale[:, None] * scale) * scale
    return inverse


def _definite(matrix: Array) -> Array:
    """Return the matrix with a ridge, and a diagonal of one for rows without any information."""
    diagonal = np.diag(matrix)
    scale = float(np.max(np.abs(diagonal), initial=0.0)) or 1.0
    return np.asarray(matrix + np.diag(np.where(diagonal == 0.0, 1.0, _RIDGE) * scale), dtype=np.float64)
