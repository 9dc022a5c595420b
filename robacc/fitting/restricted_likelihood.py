"""Restricted likelihood of variance components: its value, slopes and average information at given variances.

With residuals r = X theta + sum_c B_c a_c + e, a_c ~ N(0, v_c I), e ~ N(0, D) as in :mod:`robacc.fitting.whitening`,
and P = R^-1 - R^-1 X (X^T R^-1 X)^-1 X^T R^-1, the restricted log-likelihood is

    l = -(log|R| + log|X^T R^-1 X| + r^T P r) / 2

up to a constant (H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554). Its slopes by the variances and its
average information (A. R. Gilmour, R. Thompson, B. R. Cullis, Biometrics 51 (1995) 1440-1450) are

    g_c = (|B_c^T P r|^2 - tr(P B_c B_c^T)) / 2,   A_cd = (w_c^T P w_d) / 2,   w_c = B_c B_c^T P r.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.whitening import Scatter, Whitening, whitening
from robacc.geometry import Array

_LARGEST_CHANGE = 3.0
"""Largest change of a variance's logarithm in one step."""
_DAMPING = 0.25
"""Share of a slope that is added to its information: it bounds the step of a variance that goes to zero."""
_LEAST_NOISE = 1e-8
"""Least standard deviation of the noise, m or rad: exact data would leave only rounding errors to estimate from."""
_LARGEST_INVERSE = 1e12
"""Largest entry of the inverse of a matrix that is not singular."""


@dataclass(frozen=True, slots=True)
class MixedModel:
    """Residuals of N rows, M components each, with K fitted coefficients and the scatter of J joints."""

    residual: Array
    """``(M, N)`` m and rad."""
    design: Array
    """``(M, K, N)`` Jacobian of the fitted coefficients."""
    prior_precision: Array
    """``(K,)`` of coefficients with a prior; zero for none."""
    columns: Array
    """``(M, J, N)`` Jacobian of the joint variables."""
    known_var: Array
    """``(M, N)`` variance of the stated measurement uncertainty; zero where none is stated."""
    visits: NDArray[np.int64]
    """``(N,)`` number of the visit of each row."""
    poses: NDArray[np.int64]
    """``(N,)`` number of the commanded pose of each row."""
    correlated_noise: Array | None = None
    """``(3, 3)`` known covariance of each position in addition to :attr:`known_var`, m²; None without."""

    @property
    def is_repeated(self) -> bool:
        """Whether a commanded pose was visited more than once."""
        return bool(np.unique(self.poses).size < np.unique(self.visits).size)

    def weight(self, noise: tuple[float, float]) -> Array:
        """Return ``(M, N)`` reciprocal standard deviations; ``noise`` (m, rad) adds to the stated uncertainty."""
        variance = self.known_var + np.square(noise[0])
        variance[3:] = self.known_var[3:] + np.square(noise[1])
        return np.asarray(1.0 / np.sqrt(np.maximum(variance, _LEAST_NOISE**2)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Variances:
    """Variance components of a mixed model."""

    scatter: Scatter
    noise: tuple[float, float]
    """Standard deviation of position (m) and orientation (rad) beyond the stated measurement uncertainty."""

    @property
    def stds(self) -> Array:
        """``(2 J + 2,)`` standard deviations: joints from visit to visit, joints from pose to pose, and noise."""
        return np.concatenate((self.scatter.visit_std, self.scatter.pose_std, self.noise))

    @classmethod
    def of(cls, stds: Array) -> Variances:
        """Return the variances of :attr:`stds`."""
        joints = stds.size // 2 - 1
        return cls(Scatter(stds[:joints], stds[joints : 2 * joints]), (float(stds[-2]), float(stds[-1])))


@dataclass(frozen=True, slots=True)
class LikelihoodSlopes:
    """Slopes and average information of the restricted log-likelihood by F variances."""

    numerator: Array
    """``(F,)`` |B^T P r|^2"""
    trace: Array
    """``(F,)`` tr(P B B^T)"""
    information: Array
    """``(F, F)``"""

    @property
    def ratio(self) -> Array:
        """``(F,)`` numerator over trace; zero where both vanish."""
        good = self.trace > 1e-12 * np.maximum(self.numerator, 1e-300)
        return np.where(good, self.numerator / np.where(good, self.trace, 1.0), 0.0)

    def newton(self, variances: Array) -> Array:
        """Return ``(F,)`` Newton's step in the logarithms of the variances."""
        slope = 0.5 * (self.numerator - self.trace) * variances
        information = self.information * variances[:, None] * variances
        information[np.diag_indices_from(information)] += _DAMPING * np.abs(slope)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        solution = np.linalg.lstsq(information * scale[:, None] * scale, slope * scale, rcond=1e-12)[0]
        return np.clip(solution * scale, -_LARGEST_CHANGE, _LARGEST_CHANGE)


@dataclass(frozen=True)
class RestrictedLikelihood:
    """Restricted likelihood of a mixed model at given variances, with the generalised least-squares solution."""

    model: MixedModel
    white: Whitening
    score: Array
    """``(M, N)`` P r"""
    solved: Array
    """``(M, K, N)`` R^-1 X"""
    covariance: Array
    """``(K, K)`` inverse of X^T R^-1 X"""
    log_likelihood: float

    @classmethod
    def at(cls, model: MixedModel, variances: Variances) -> RestrictedLikelihood:
        """Solve the model at the given variances."""
        weight = model.weight(variances.noise)
        noise = model.correlated_noise
        return cls.of(model, whitening(weight, model.columns, variances.scatter, model.visits, model.poses, noise))

    @classmethod
    def of(cls, model: MixedModel, white: Whitening) -> RestrictedLikelihood:
        """Solve the model with residuals of the covariance that ``white`` turns into unity."""
        design = white.apply(np.moveaxis(model.design, 1, 0))
        residual = white.apply(model.residual)
        flat = design.reshape(design.shape[0], residual.size)
        gram = flat @ flat.T + np.diag(model.prior_precision)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        matrix = gram * scale[:, None] * scale
        covariance = _inverse(matrix) * scale[:, None] * scale
        theta = covariance @ (flat @ residual.ravel())
        remainder = residual - np.tensordot(theta, design, axes=1)
        # W is symmetric on scaled values, so applying its transpose once more gives R^-1.
        score = white.apply_transposed(remainder)
        solved = np.moveaxis(white.apply_transposed(design), 0, 1)
        sign, log_determinant = np.linalg.slogdet(matrix)
        log_determinant = float(log_determinant) - 2.0 * float(np.log(scale).sum()) if sign > 0 else 0.0
        cost = float(np.sum(np.square(remainder))) + float(model.prior_precision @ np.square(theta))
        return cls(model, white, score, solved, covariance, -0.5 * (white.log_determinant + log_determinant + cost))

    def slopes(self, variances: NDArray[np.int64]) -> LikelihoodSlopes:
        """Return the slopes by F variances, given by their numbers in :attr:`Variances.stds`."""
        components, joints, n = self.model.columns.shape
        numerator, trace = np.zeros(variances.size), np.zeros(variances.size)
        moved = np.zeros((variances.size, components, n))
        groupings = RowGroups.of(self.model.visits), RowGroups.of(self.model.poses)
        for i, number in enumerate(variances.tolist()):
            if number < 2 * joints:
                groups, column = groupings[number // joints], self.model.columns[:, number % joints]
                shared = groups.sums(np.sum(column * self.score, axis=0))
                numerator[i] = float(shared @ shared)
                trace[i] = self._trace(number % joints, groups)
                moved[i] = column * shared[groups.number]
            else:
                part = slice(0, 3) if number == 2 * joints else slice(3, 6)
                numerator[i] = float(np.sum(np.square(self.score[part])))
                trace[i] = float(np.sum(self.diagonal[part]))
                moved[i, part] = self.score[part]
        used = np.tensordot(moved, self.solved, axes=([1, 2], [0, 2]))
        white = self.white.apply_inplace(moved).reshape(variances.size, -1)
        return LikelihoodSlopes(numerator, trace, 0.5 * (white @ white.T - used @ self.covariance @ used.T))

    def _trace(self, joint: int, groups: RowGroups) -> float:
        """Return tr(P B B^T) of a joint whose scatter the rows of a group share.

        A group is a union of visits within a pose.
        """
        model = groups.sums(np.einsum("mn,mkn->kn", self.model.columns[:, joint], self.solved))
        column = self._by_visit[joint]
        total = float(np.sum(np.square(column))) - float(np.sum((self.covariance @ model) * model))
        if self.white.pose_errors is None:
            return total
        sums = groups.sums(np.einsum("mjn,mn->jn", self.white.pose_errors.columns, column))
        return total - float(np.einsum("ig,gij,jg->", sums, self._inner[groups.order[groups.first]], sums))

    @cached_property
    def _by_visit(self) -> Array:
        """``(J, M, N)`` columns of the joint variables, whitened visit by visit."""
        return self.white.apply_by_visit(np.moveaxis(self.model.columns, 1, 0).copy())

    @cached_property
    def _inner(self) -> Array:
        """``(N, J, J)`` inner matrix of the errors that visits share, for each row."""
        assert self.white.pose_errors is not None
        return self.white.pose_errors.inner()

    def _inverse_diagonal(self) -> Array:
        """Return ``(M, N)`` the diagonal of R^-1."""
        result = np.square(self.white.weight)
        components = result.shape[0]
        for block in self.white.blocks:
            diagonal = np.sum(np.square(block.factor), axis=1).reshape(-1, components, block.rows.shape[1])
            result[:, block.rows] *= np.moveaxis(diagonal, 1, 0)
        if self.white.pose_errors is None:
            return result
        shared = self.white.multiply_by_visit(np.moveaxis(self.white.pose_errors.columns, 1, 0).copy())
        shared *= self.white.weight
        return np.asarray(result - np.einsum("imn,nij,jmn->mn", shared, self._inner, shared))

    @cached_property
    def diagonal(self) -> Array:
        """``(M, N)`` the diagonal of P."""
        used = [np.einsum("kn,kn->n", rows, self.covariance @ rows) for rows in self.solved]
        return np.asarray(self._inverse_diagonal() - np.stack(used))


@dataclass(frozen=True, slots=True)
class RowGroups:
    """Rows in groups."""

    number: NDArray[np.int64]
    """``(N,)`` group of each row."""
    order: NDArray[np.int64]
    """``(N,)`` rows sorted by group."""
    first: NDArray[np.int64]
    """``(G,)`` place in :attr:`order` where each group begins."""

    @classmethod
    def of(cls, groups: NDArray[np.int64]) -> RowGroups:
        """Number the groups without gaps."""
        number = np.unique(groups, return_inverse=True)[1]
        order = np.argsort(number, kind="stable")
        return cls(number, order, np.searchsorted(number[order], np.arange(int(number.max(initial=-1)) + 1)))

    def sums(self, values: Array) -> Array:
        """Return ``(..., G)`` sums over the rows of each group of ``(..., N)``."""
        if self.first.size == self.number.size:
            return values[..., self.order]
        return np.add.reduceat(values[..., self.order], self.first, axis=-1)


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric matrix of unit diagonal; the pseudo-inverse if it is singular."""
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.inf)
    largest = float(np.abs(inverse).max(initial=0.0))
    if largest < _LARGEST_INVERSE:
        return np.asarray(inverse, dtype=np.float64)
    return np.asarray(np.linalg.pinv(matrix, hermitian=True), dtype=np.float64)
