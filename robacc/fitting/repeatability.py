"""Intrinsic repeatability of the joints, estimated beside the measurement noise by restricted maximum likelihood.

With residuals r = X theta + sum_c B_c a_c + e, a_c ~ N(0, v_c I), e ~ N(0, D) as in :mod:`robacc.fitting.whitening`,
and P = R^-1 - R^-1 X (X^T R^-1 X)^-1 X^T R^-1, the restricted log-likelihood has the slopes and average information

    g_c = (|B_c^T P r|^2 - tr(P B_c B_c^T)) / 2,   A_cd = (w_c^T P w_d) / 2,   w_c = B_c B_c^T P r

by the variances (A. R. Gilmour, R. Thompson, B. R. Cullis, "Average information REML", Biometrics 51 (1995) 1440-1450).
Newton's step is taken in their logarithms, so that they stay positive. Where it does not raise the likelihood,

    v_c <- v_c ( |B_c^T P r|^2 / tr(P B_c B_c^T) )^(1/2)

does (H. Zhou, L. Hu, J. Zhou, K. Lange, "MM algorithms for variance components models", J. Comput. Graph. Stat. 28
(2019) 350-361). Independent observations are visits: three targets measured at one arrival share the same scatter of
each joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.whitening import Scatter, Whitening, block_columns, blocks_of, whitening
from robacc.geometry import Array

MOST_ROWS = 1200
"""Largest number of rows that variances are estimated from."""
_ROUNDS = 80
_SETTLED = 1e-2
"""Change of the restricted log-likelihood below which the iteration stops."""
_LARGEST_CHANGE = 3.0
"""Largest change of a variance's logarithm in one step."""
_RETURNING = 0.1
"""Least share of the usual start at which a standard deviation starts if an earlier estimate is known."""
_DAMPING = 0.25
"""Share of a slope that is added to its information: it bounds the step of a variance that goes to zero."""
_LEAST_NOISE = 1e-8
"""Least standard deviation of the noise, m or rad: exact data would leave only rounding errors to estimate from."""
_LARGEST_INVERSE = 1e12
"""Largest entry of the inverse of a matrix that is not singular."""
MANY_COEFFICIENTS = 120
"""Coefficients from which shrunk ones are not estimated anew beside the variances: the time grows with their square."""
_NEGLIGIBLE = 1e-4
"""Share of the largest variance at the target below which a joint's scatter is set to zero."""


@dataclass(frozen=True, slots=True)
class Components:
    """Estimated variance components and their gain in likelihood."""

    scatter: Scatter
    noise: tuple[float, float]
    """Standard deviation of position (m) and orientation (rad) beyond the stated measurement uncertainty."""
    gain: float
    """Twice the gain in restricted log-likelihood over a model without scatter."""
    visit_std_error: Array
    """``(J,)`` standard error of each ``visit_std``, from the expected information; inf where it is zero."""


@dataclass(frozen=True, slots=True)
class _Data:
    residual: Array
    """``(M, N)``"""
    design: Array
    """``(M, K, N)`` Jacobian of the fitted coefficients."""
    columns: Array
    """``(M, J, N)`` Jacobian of the joint variables."""
    known_var: Array
    """``(M, N)`` variance of the stated measurement uncertainty."""
    visits: NDArray[np.int64]
    poses: NDArray[np.int64]


def estimate(
    residual: Array,
    design: Array,
    joint_columns: Array,
    known_var: Array,
    visits: NDArray[np.int64],
    poses: NDArray[np.int64],
    prior_precision: Array | None = None,
    earlier: Scatter | None = None,
) -> Components:
    """Estimate the joints' scatter and the noise beyond the stated measurement uncertainty.

    Args:
        residual: ``(M, N)`` m and rad, inliers only.
        design: ``(M, K, N)`` Jacobian of the fitted coefficients.
        joint_columns: ``(M, J, N)`` Jacobian of the joint variables.
        known_var: ``(M, N)`` variance of the stated measurement uncertainty; zero where none is stated.
        visits: ``(N,)`` number of the visit of each row.
        poses: ``(N,)`` number of the commanded pose of each row.
        prior_precision: ``(K,)`` of coefficients with a prior; zero for none.
        earlier: Earlier estimate, from which the iteration starts.
    """
    data = _Data(residual, design, joint_columns, known_var, visits, poses)
    repeated = np.unique(poses).size < np.unique(visits).size
    prior = np.zeros(design.shape[1]) if prior_precision is None else prior_precision
    zero = Scatter(np.zeros(joint_columns.shape[1]), np.zeros(joint_columns.shape[1]))
    start = _start(data)
    noise, _, null_likelihood = _ascend(data, prior, zero, start)
    size = np.sqrt(np.mean(np.sum(np.square(joint_columns[:3]), axis=0), axis=1))
    initial_std = np.where(size > 0, noise[0] / np.maximum(size, 1e-12) / 2.0, 0.0)
    initial = Scatter(initial_std, initial_std if repeated else np.zeros_like(initial_std))
    if earlier is not None:
        # A variance that starts at zero would stay there.
        initial = Scatter(
            np.maximum(earlier.visit_std, _RETURNING * initial.visit_std),
            np.maximum(earlier.pose_std, _RETURNING * initial.pose_std) if repeated else initial.pose_std,
        )
    noise, scatter, likelihood = _ascend(data, prior, initial, noise)
    scatter = _without_negligible(scatter, size)
    return Components(scatter, noise, 2.0 * (likelihood - null_likelihood), _standard_errors(data, scatter, noise))


def _start(data: _Data) -> tuple[float, float]:
    position = float(np.sqrt(np.mean(np.square(data.residual[:3])))) or 1e-9
    rotation = float(np.sqrt(np.mean(np.square(data.residual[3:])))) if data.residual.shape[0] == 6 else 0.0
    return position, rotation


def _weight(data: _Data, noise: tuple[float, float]) -> Array:
    extra = np.full(data.residual.shape, noise[0] ** 2)
    extra[3:] = noise[1] ** 2
    return np.asarray(1.0 / np.sqrt(np.maximum(data.known_var + extra, _LEAST_NOISE**2)), dtype=np.float64)


def _ascend(
    data: _Data, prior: Array, scatter: Scatter, noise: tuple[float, float]
) -> tuple[tuple[float, float], Scatter, float]:
    """Improve all variances that are not zero until the restricted likelihood converges."""
    stds = np.concatenate((scatter.visit_std, scatter.pose_std, noise))
    step = _step_at(data, prior, stds)
    for _ in range(_ROUNDS):
        free = np.flatnonzero(stds)
        slopes = step.slopes(free)
        moved_stds = stds.copy()
        moved_stds[free] *= np.exp(0.5 * slopes.newton(np.square(stds[free])))
        moved = _step_at(data, prior, moved_stds)
        if not moved.likelihood > step.likelihood:
            moved_stds[free] = stds[free] * slopes.ratio**0.25
            moved = _step_at(data, prior, moved_stds)
        gain = moved.likelihood - step.likelihood
        stds, step = moved_stds, moved
        if gain < _SETTLED:
            break
    joints = scatter.visit_std.size
    return (float(stds[-2]), float(stds[-1])), Scatter(stds[:joints], stds[joints : 2 * joints]), step.likelihood


def _step_at(data: _Data, prior: Array, stds: Array) -> _Step:
    """Return the linear solve at standard deviations of visits, poses and noise ``(2 J + 2,)``."""
    joints = data.columns.shape[1]
    weight = _weight(data, (stds[-2], stds[-1]))
    scatter = Scatter(stds[:joints], stds[joints : 2 * joints])
    return _Step.of(data, prior, whitening(weight, data.columns, scatter, data.visits, data.poses))


@dataclass(frozen=True, slots=True)
class _RestrictedSlopes:
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
class _Step:
    """Linear solve at given variances, with its restricted likelihood."""

    data: _Data
    white: Whitening
    score: Array
    """``(M, N)`` P r"""
    solved: Array
    """``(M, K, N)`` R^-1 X"""
    covariance: Array
    """``(K, K)`` inverse of X^T R^-1 X"""
    by_visit: Array
    """``(J, M, N)`` columns of the joint variables, whitened visit by visit."""
    likelihood: float

    @staticmethod
    def of(data: _Data, prior: Array, white: Whitening) -> _Step:
        design = white.apply(np.moveaxis(data.design, 1, 0))
        residual = white.apply(data.residual)
        flat = design.reshape(design.shape[0], residual.size)
        gram = flat @ flat.T + np.diag(prior)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        matrix = gram * scale[:, None] * scale
        covariance = _inverse(matrix) * scale[:, None] * scale
        theta = covariance @ (flat @ residual.ravel())
        remainder = residual - np.tensordot(theta, design, axes=1)
        # W is symmetric on scaled values, so applying its transpose once more gives R^-1.
        score = white.apply_transposed(remainder)
        solved = np.moveaxis(white.apply_transposed(design), 0, 1)
        sign, logdet = np.linalg.slogdet(matrix)
        logdet = float(logdet) - 2.0 * float(np.log(scale).sum()) if sign > 0 else 0.0
        by_visit = white.apply_by_visit(np.moveaxis(data.columns, 1, 0).copy())
        cost = float(np.sum(np.square(remainder))) + float(prior @ np.square(theta))
        return _Step(data, white, score, solved, covariance, by_visit, -0.5 * (white.log_determinant + logdet + cost))

    def slopes(self, variances: NDArray[np.int64]) -> _RestrictedSlopes:
        """Return the slopes by the given variances of visits, poses and noise (numbers below 2 J + 2)."""
        components, joints, n = self.data.columns.shape
        numerator, trace, moved = (
            np.zeros(variances.size),
            np.zeros(variances.size),
            np.zeros((variances.size, components, n)),
        )
        groupings = [_RowGroups.of(self.data.visits), _RowGroups.of(self.data.poses)]
        diagonal = self._noise_diagonal if (variances >= 2 * joints).any() else np.zeros_like(self.score)
        for i, number in enumerate(variances.tolist()):
            if number < 2 * joints:
                grouping, column = groupings[number // joints], self.data.columns[:, number % joints]
                shared = grouping.sums(np.sum(column * self.score, axis=0))
                numerator[i] = float(shared @ shared)
                trace[i] = self._trace(number % joints, grouping)
                moved[i] = column * shared[grouping.number]
            else:
                part = slice(0, 3) if number == 2 * joints else slice(3, 6)
                numerator[i] = float(np.sum(np.square(self.score[part])))
                trace[i] = float(np.sum(diagonal[part]))
                moved[i, part] = self.score[part]
        used = np.tensordot(moved, self.solved, axes=([1, 2], [0, 2]))
        white = self.white.apply_inplace(moved).reshape(variances.size, -1)
        return _RestrictedSlopes(numerator, trace, 0.5 * (white @ white.T - used @ self.covariance @ used.T))

    def _trace(self, joint: int, grouping: _RowGroups) -> float:
        """Return tr(P B B^T) of a joint whose scatter the rows of a group share.

        A group is a union of visits within a pose.
        """
        model = grouping.sums(np.einsum("mn,mkn->kn", self.data.columns[:, joint], self.solved))
        column = self.by_visit[joint]
        total = float(np.sum(np.square(column))) - float(np.sum((self.covariance @ model) * model))
        if self.white.pose_errors is None:
            return total
        sums = grouping.sums(np.einsum("mjn,mn->jn", self.white.pose_errors.columns, column))
        return total - float(np.einsum("ig,gij,jg->", sums, self._inner[grouping.order[grouping.first]], sums))

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

    @property
    def _noise_diagonal(self) -> Array:
        """``(M, N)`` the diagonal of P."""
        used = [np.einsum("kn,kn->n", rows, self.covariance @ rows) for rows in self.solved]
        return np.asarray(self._inverse_diagonal() - np.stack(used))


@dataclass(frozen=True, slots=True)
class _RowGroups:
    """Rows in groups."""

    number: NDArray[np.int64]
    """``(N,)`` group of each row."""
    order: NDArray[np.int64]
    """``(N,)`` rows sorted by group."""
    first: NDArray[np.int64]
    """``(G,)`` place in :attr:`order` where each group begins."""

    @classmethod
    def of(cls, groups: NDArray[np.int64]) -> _RowGroups:
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


def _without_negligible(scatter: Scatter, size: Array) -> Scatter:
    """Return the scatter without joints whose effect at the target is negligible next to the largest."""
    at_target = np.maximum(scatter.visit_std, scatter.pose_std) * size
    largest = float(at_target.max(initial=0.0))
    keep_visit = np.square(scatter.visit_std * size) > _NEGLIGIBLE * largest**2
    keep_pose = np.square(scatter.pose_std * size) > _NEGLIGIBLE * largest**2
    return Scatter(np.where(keep_visit, scatter.visit_std, 0.0), np.where(keep_pose, scatter.pose_std, 0.0))


def _standard_errors(data: _Data, scatter: Scatter, noise: tuple[float, float]) -> Array:
    """Return ``(J,)`` standard errors of ``visit_std`` from the information 1/2 tr(R^-1 B_i R^-1 B_j), with noise."""
    weight = _weight(data, noise)
    joints = data.columns.shape[1]
    information = np.zeros((joints + 1, joints + 1))
    scaled = data.columns * weight[:, None, :]
    for rows in blocks_of(data.visits):
        columns = block_columns(scaled, rows)
        count, size = columns.shape[:2]
        covariance = np.eye(size) + (columns * np.square(scatter.visit_std)) @ np.swapaxes(columns, 1, 2)
        values, vectors = np.linalg.eigh(covariance)
        inverse = (vectors / np.maximum(values, 1.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        cross = np.swapaxes(columns, 1, 2) @ inverse @ columns
        information[:joints, :joints] += 0.5 * np.sum(np.square(cross), axis=0)
        squared = np.moveaxis(np.square(weight)[:, rows], 1, 0).reshape(count, 1, size)
        half = inverse * squared  # R^-1 D' with D' the derivative by the noise variance, in scaled units
        information[joints, joints] += 0.5 * float(np.einsum("vij,vji->", half, half))
        mixed = np.einsum("vaj,vab,vbj->j", columns, inverse @ (inverse * squared), columns)
        information[joints, :joints] += 0.5 * mixed
        information[:joints, joints] += 0.5 * mixed
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information * scale[:, None] * scale, rcond=1e-10, hermitian=True)
    variance_error = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * scale
    std = np.maximum(scatter.visit_std, 1e-300)
    return np.where(scatter.visit_std > 0, variance_error[:joints] / (2.0 * std), np.inf)
