"""Covariance of all rows, its likelihood with the effects' coefficients integrated out, and the gradient.

The residuals y of N rows of M components are

    y = X b + e,    b ~ N(0, S),    e ~ N(0, V),    V = D + sum of the terms' F_c K_c F_c',

with D the independent noise. The log marginal likelihood is -(log|V| + log|I + Q'Q| + y'P y) / 2, with Q the whitened
columns of X times S^(1/2); with S broad it is the restricted likelihood (Rasmussen and Williams 2006, section 2.7). Its
derivative by a parameter t is tr((a a' - P) dV/dt) / 2 with a = P y (section 5.4.1), where P is the inverse of
V + X S X'.

Inside, vectors of all rows are ordered component by component, so that kernels are added to whole blocks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from robacc.error_model.rows import Linearised
from robacc.error_model.terms import TERMS
from robacc.geometry import Array


@dataclass(frozen=True)
class CovarianceParameters:
    """Parameters of the covariance."""

    log_std: Array
    """Log standard deviation of independent noise beyond what the file states: ``(1,)`` of position, m, ``(2,)`` of
    position and orientation, rad; ``(3,)`` or ``(4,)`` where x, y and z have their own."""
    factor: Array
    """``(N,)`` factor on the standard deviation of each row: above 1 for gross errors."""
    terms: dict[str, Array] = dataclasses.field(default_factory=dict)
    """Parameters of the terms in the covariance, by name."""

    @property
    def std(self) -> Array:
        """Standard deviations of the noise, m and rad."""
        return np.exp(self.log_std)

    @property
    def has_axes(self) -> bool:
        """Return whether x, y and z have noise of their own."""
        return len(self.log_std) > 2

    def _kinds(self, components: int) -> NDArray[np.int64]:
        """Return ``(M,)`` the number of the standard deviation of each component."""
        return np.minimum(np.arange(components) // (1 if self.has_axes else 3), len(self.log_std) - 1)

    def own_variance(self, components: int) -> Array:
        """Return ``(N, M)`` variances of the noise beyond what the file states."""
        variance: Array = np.square(self.std[self._kinds(components)]) * np.square(self.factor)[:, None]
        return variance

    def by_kind(self, values: Array) -> Array:
        """Return the sums of ``values`` ``(N, M)`` over the rows and the components of each standard deviation."""
        sums: Array = np.bincount(self._kinds(values.shape[1]), weights=values.sum(axis=0)).astype(np.float64)
        return sums

    @property
    def packed(self) -> Array:
        """All parameters but the factors of the rows."""
        return np.concatenate((self.log_std, *self.terms.values()))

    def unpacked(self, packed: Array) -> CovarianceParameters:
        """Return the same terms with other parameters."""
        at, terms = len(self.log_std), {}
        for name, values in self.terms.items():
            terms[name] = packed[at : at + len(values)]
            at += len(values)
        return CovarianceParameters(packed[: len(self.log_std)], self.factor, terms)

    def with_term(self, name: str, parameters: Array) -> CovarianceParameters:
        """Return the noise with one more term."""
        return dataclasses.replace(self, terms={**self.terms, name: parameters})

    def without(self, name: str) -> CovarianceParameters:
        """Return the noise without a term."""
        return dataclasses.replace(self, terms={n: p for n, p in self.terms.items() if n != name})

    def independent(self, stated: Array) -> Array:
        """Return ``(N, M)`` standard deviations of the independent noise beside ``stated`` variances."""
        variance = stated + np.square(self.std[self._kinds(stated.shape[1])])
        return np.sqrt(variance) * self.factor[:, None]


@dataclass(frozen=True)
class Whitened:
    """Rows whitened by V, and the posterior of the coefficients."""

    columns: Array
    """``(n, P)`` whitened columns times the prior's standard deviations, Q."""
    y: Array
    """``(n,)``"""
    triangle: Array
    """``(P, P)`` lower factor of I + Q'Q."""
    reduced: Array
    """``(P,)`` triangle^-1 Q'y."""
    log_likelihood: float
    apply: Callable[[Array], Array]
    """Whitens ``(N, M, …)`` to ``(n, …)``."""
    factor: Array
    """``(n, n)`` lower factor of V, or ``(n,)`` its standard deviations where it is diagonal."""

    @property
    def coefficients(self) -> Array:
        """Return the posterior mean ``(P,)`` in units of the prior's standard deviations."""
        mean: Array = solve_triangular(self.triangle, self.reduced, lower=True, trans="T")
        return mean

    def weighted_residual(self, components: int, kept: NDArray[np.int64] | None = None) -> Array:
        """Return P y ``(N, M)``, with some of the columns if ``kept`` names them."""
        if kept is None:
            white = self.y - self.columns @ self.coefficients
        else:
            columns = self.columns[:, kept]
            system = columns.T @ columns + np.eye(kept.size)
            white = self.y - columns @ np.linalg.solve(system, columns.T @ self.y)
        if self.factor.ndim == 1:
            white = white / self.factor
        else:
            white = solve_triangular(self.factor, white, lower=True, trans="T", check_finite=False)
        return white.reshape(components, -1).T


def whitened(noise: CovarianceParameters, linear: Linearised) -> Whitened:
    """Whiten a linearised model.

    Raises:
        numpy.linalg.LinAlgError: The covariance is singular.
    """
    independent = noise.independent(linear.rows.stated)
    if not noise.terms:
        factor = _flat(independent)
        log_det = 2.0 * float(np.sum(np.log(factor)))

        def apply(a: Array) -> Array:
            flat = _flat(a)
            return flat / factor.reshape((-1,) + (1,) * (flat.ndim - 1))

    else:
        lower, info = dpotrf(covariance(noise, linear).T, lower=0, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError
        factor = np.tril(lower.T)
        log_det = _log_det(factor)

        def apply(a: Array) -> Array:
            flat = _flat(a)
            white: Array = solve_triangular(factor, flat.reshape(len(flat), -1), lower=True, check_finite=False)
            return white.reshape(flat.shape)

    columns, y = apply(linear.columns * linear.prior_std), apply(linear.y)
    triangle: Array = np.asarray(np.linalg.cholesky(columns.T @ columns + np.eye(columns.shape[1])), dtype=np.float64)
    reduced = solve_triangular(triangle, columns.T @ y, lower=True)
    log_likelihood = -0.5 * (log_det + _log_det(triangle) + float(y @ y - reduced @ reduced))
    return Whitened(columns, y, triangle, reduced, log_likelihood, apply, factor)


def covariance(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return ``(n, n)`` V, of which only the blocks on and below the diagonal are filled."""
    components, count = linear.y.shape[1], len(linear.y)
    matrix = np.zeros((components, count, components, count))
    kernels: list[Array | None] = [None] * len(linear.joints)
    for name, parameters in noise.terms.items():
        if TERMS[name].of_joints:
            added = TERMS[name].kernels(parameters, linear.rows)
            kernels = [a if b is None else b if a is None else a + b for a, b in zip(kernels, added, strict=True)]
        else:
            for axis, of_axis in enumerate(TERMS[name].kernels(parameters, linear.rows)):
                matrix[axis, :, axis] += 0.0 if of_axis is None else of_axis
    for joint, kernel in zip(linear.joints, kernels, strict=True):
        if kernel is not None:
            for b in range(components):
                right = kernel * joint[b]
                for a in range(b, components):
                    matrix[a, :, b] += joint[a][:, None] * right
    flat = matrix.reshape(components * count, components * count)
    flat[np.diag_indices(len(flat))] += np.square(_flat(noise.independent(linear.rows.stated)))
    return flat


def likelihood_and_gradient(noise: CovarianceParameters, linear: Linearised) -> tuple[float, Array]:
    """Return the log likelihood and its derivatives by :attr:`CovarianceParameters.packed`.

    Raises:
        numpy.linalg.LinAlgError: The covariance is singular.
    """
    components, count = linear.y.shape[1], len(linear.y)
    own = noise.own_variance(components)
    if not noise.terms:
        white = whitened(noise, linear)
        independent = _flat(noise.independent(linear.rows.stated))
        error = white.y - white.columns @ white.coefficients
        spread = solve_triangular(white.triangle, white.columns.T, lower=True)
        slope = (np.square(error) - 1.0 + np.sum(np.square(spread), axis=0)) / np.square(independent) * _flat(own)
        return white.log_likelihood, noise.by_kind(slope.reshape(components, -1).T)
    columns, y = _flat(linear.columns * linear.prior_std), _flat(linear.y)
    matrix = covariance(noise, linear)
    matrix += columns @ columns.T
    # The lower triangle by rows is LAPACK's upper triangle by columns.
    factor, info = dpotrf(matrix.T, lower=0, overwrite_a=1)
    if info:
        raise np.linalg.LinAlgError
    log_det = _log_det(factor)
    weighted = dpotrs(factor, y, lower=0)[0]
    slopes = dpotri(factor, lower=0, overwrite_c=1)[0].T
    np.subtract(np.multiply.outer(weighted, weighted), slopes, out=slopes)
    blocks = slopes.reshape(components, count, components, count)
    of_axes = [np.tril(blocks[a, :, a]) for a in range(components)]
    of_axes = [lower + np.tril(lower, -1).T for lower in of_axes]
    gradient = [noise.by_kind(np.diag(slopes).reshape(components, -1).T * own)]
    of_joints = (
        _joint_weights(blocks, of_axes, linear.joints) if any(TERMS[name].of_joints for name in noise.terms) else []
    )
    for name, parameters in noise.terms.items():
        term = TERMS[name]
        gradient.append(term.gradient(parameters, linear.rows, of_joints if term.of_joints else of_axes))
    return -0.5 * (log_det + float(y @ weighted)), np.concatenate(gradient)


def _joint_weights(blocks: Array, of_axes: list[Array], joints: Array) -> list[Array]:
    """Return for each joint ``(N, N)`` weights of its kernel: F' A F summed over components, in sums with symmetric.

    Only the lower triangle of A is there; blocks below the diagonal count twice.
    """
    weights = np.zeros((len(joints), *blocks.shape[1:4:2]))
    for a, diagonal in enumerate(of_axes):
        left = np.zeros_like(weights)
        for b in range(a):
            left += blocks[a, :, b] * joints[:, b, None]
        left *= 2.0
        left += diagonal * joints[:, a, None]
        left *= joints[:, a, :, None]
        weights += left
    return list(weights)


def unaccounted(noise: CovarianceParameters, linear: Linearised, white: Whitened) -> Array:
    """Return ``(N, M)`` what noise and scatter must account for: y less the posterior mean of all else."""
    weighted = white.weighted_residual(linear.y.shape[1])
    left = np.square(noise.independent(linear.rows.stated)) * weighted
    if "scatter" in noise.terms:
        by_row = np.einsum("jan,na->jn", linear.joints, weighted)
        by_visit = np.stack([np.bincount(linear.rows.visit, weights=moved) for moved in by_row])
        variance = np.exp(2.0 * noise.terms["scatter"])
        left = left + np.einsum("jan,jn->na", linear.joints, variance[:, None] * by_visit[:, linear.rows.visit])
    return left


def scatter_covariance(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return ``(N, M, M)`` the covariance of each row by scatter of the joints."""
    if "scatter" not in noise.terms:
        return np.zeros((len(linear.y), linear.y.shape[1], linear.y.shape[1]))
    moved = linear.joints * np.exp(noise.terms["scatter"])[:, None, None]
    result: Array = np.einsum("jan,jbn->nab", moved, moved)
    return result


def row_std(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return ``(N, M)`` standard deviations of noise and scatter together."""
    shared = np.einsum("naa->na", scatter_covariance(noise, linear))
    return np.asarray(np.sqrt(np.square(noise.independent(linear.rows.stated)) + shared))


def usual_std(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return the root mean squares of noise and scatter together, m and rad: what a further term starts from."""
    variance = np.mean(np.square(row_std(noise, linear) / noise.factor[:, None]), axis=0)
    return np.asarray(np.sqrt(variance.reshape(-1, 3).mean(axis=1)))


def score_statistics(noise: CovarianceParameters, linear: Linearised, name: str, slopes: Sequence[float]) -> float:
    """Return about how much the likelihood gains by a small term: half the sum of squares of its score statistics.

    ``slopes`` are derivatives by the log standard deviations of the term ``name`` in ``noise``, which are small. The
    information of a variance is half the sum of squares of its kernel in units of noise and scatter.
    """
    term, parameters = TERMS[name], noise.terms[name]
    kernels = term.kernels(parameters, linear.rows)
    weight = 1.0 / row_std(noise, linear).T
    components = linear.y.shape[1]
    information = []
    if term.of_joints:
        moved = linear.joints * weight
        gains = [
            0.0 if kernel is None else float(np.sum(np.square((joint.T @ joint) * kernel)))
            for joint, kernel in zip(moved, kernels, strict=True)
        ]
        if len(slopes) == 1:
            products = np.zeros((len(linear.y),) * 2)
            for a in range(components):
                for b in range(components):
                    products += np.square(moved[:, a].T @ moved[:, b])
            gains = [float(np.sum(products * np.square(kernels[0])))] if kernels[0] is not None else [0.0]
        information = gains
    else:
        by_axis = [
            float(np.sum(np.square(weight[a][:, None] * kernel * weight[a])))
            for a, kernel in enumerate(kernels)
            if kernel is not None
        ]
        information = [sum(by_axis[3 * i : 3 * i + 3]) for i in range(len(slopes))]
    return sum(
        max(slope, 0.0) ** 2 / (4.0 * gain) for slope, gain in zip(slopes, information, strict=True) if gain > 0.0
    )


def _flat(a: Array) -> Array:
    """Return ``(N, M, …)`` as ``(M N, …)``, component by component."""
    return np.ascontiguousarray(np.moveaxis(a, 1, 0)).reshape((a.shape[0] * a.shape[1], *a.shape[2:]))


def _log_det(triangle: Array) -> float:
    """Return the log determinant of a matrix from its triangular factor."""
    return 2.0 * float(np.sum(np.log(np.diag(triangle)))) if len(triangle) else 0.0
