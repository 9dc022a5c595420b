"""Linear system of a fit: residuals and columns of measured poses, whitened, and their normal equations.

Rows that the arm reached in one visit share its scatter. Their covariance is

    R = D + B diag(s_1^2 ... s_J^2) B^T,

D the covariance of the measurement, also between the coordinates of a row where the file states that, B the columns of
the joint variables in the Jacobian (equation (7) of Wu and Lee within the measurement model), and s_j the intrinsic
repeatability of joint j. Rows are whitened by its symmetric inverse root, which does not depend on their order.

Orientation residuals are r = log(R_measured R_predicted^T), whose exact derivative is -J_l^-1(-r) dphi. As r is an
eigenvector of J_l(r) to eigenvalue 1 and a pose's three orientations have one weight, the gradient is the same without
that factor; the normal matrix changes by the order of r^2, which Gauss-Newton neglects anyway. So rows dphi are used
unchanged.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robacc.fitting.levels import BLOCK_NUMBERS, EPSILON, NEGLIGIBLE, STEPS
from robacc.geometry import Array, NDArray
from robacc.measurements import Measurements
from robacc.modelling.model import JacobianByMotion, Model, residuals
from robacc.robots.arm import BLOCK

# Positive semidefinite systems that rounding or absent data can make singular, solved with a diagonal of one.


def unit_diagonal(matrix: Array) -> tuple[Array, Array]:
    """Return a positive semidefinite matrix ``(K, K)`` scaled to a diagonal of one, and the scale ``(K,)`` of it.

    A coefficient without any information has the scale 0.
    """
    diagonal = np.diag(matrix)
    scale = np.sqrt(np.divide(1.0, diagonal, out=np.zeros(len(matrix)), where=diagonal > 0.0))
    return matrix * scale[:, None] * scale, scale


def solved(matrix: Array, rhs: Array, damping: float = 0.0) -> Array:
    """Return the solution of ``matrix x = rhs`` for a positive semidefinite matrix ``(K, K)``.

    A direction without information stays near zero, where an exact solution does not exist. ``damping`` is added to the
    diagonal of the scaled matrix, which is one.
    """
    from scipy.linalg.lapack import dposv  # Its import takes as long as an estimate of 100 poses.

    matrix, scale = unit_diagonal(matrix)
    scale = scale.reshape(-1, *(1,) * (rhs.ndim - 1))
    matrix += damping * np.eye(len(matrix))
    _, result, is_singular = dposv(matrix, scale * rhs) if rhs.size else (None, rhs, 0)
    if is_singular:
        result = np.linalg.lstsq(matrix, scale * rhs, rcond=None)[0]
    return np.asarray(scale * result, dtype=np.float64)


def posterior(gram: Array, prior: Array) -> Array:
    """Return ``(K, K)`` the inverse of the normal matrix with the priors' precision ``(K,)``."""
    from scipy.linalg.lapack import dpotrf, dtrtri

    if not len(gram):
        return gram
    matrix, scale = unit_diagonal(gram + np.diag(prior))
    factor, is_singular = dpotrf(matrix.T, lower=1, overwrite_a=1)
    if is_singular:
        return solved(gram + np.diag(prior), np.eye(len(gram)))
    root = dtrtri(factor, lower=1, overwrite_c=1)[0] * scale
    return np.asarray(root.T @ root)


GAIN = 0.01
"""Least gain of a log likelihood that is worth a step: smaller ones are rounding."""


def most_likely(
    likelihood: Callable[[Array, float], tuple[float, Array, Array]],
    start: Array,
    bounds: Array,
    gains: float = GAIN,
    least: float = -math.inf,
) -> tuple[Array, float]:
    """Return the parameters ``(K,)`` between ``bounds`` ``(2, K)`` of largest log likelihood, and that.

    ``likelihood`` returns the log likelihood at parameters, its gradient ``(K,)`` and the information ``(K, K)``; of a
    likelihood not above its second argument, the others may be anything. Parameters are logarithms of standard
    deviations or variances: steps of scoring are damped (Marquardt 1963), and of each at most 2 long, beyond which
    exponentials are far from linear. They end when the next would gain less than ``gains``, or next to nothing of what
    a likelihood of ``least`` lacks.
    """
    low, high = bounds
    at, damping = np.clip(start, low, high), 0.1
    best, gradient, information = likelihood(at, -math.inf)
    for _ in range(STEPS):
        free = np.flatnonzero(((at > low) | (gradient > 0.0)) & ((at < high) | (gradient < 0.0)))
        ahead = np.linalg.solve(information[np.ix_(free, free)] + damping * np.eye(free.size), gradient[free])
        if 0.5 * gradient[free] @ ahead < max(gains, NEGLIGIBLE * (least - best)):
            break
        step = at.copy()
        step[free] += np.clip(ahead, -2.0, 2.0)
        step = np.clip(step, low, high)
        found, *derivatives = likelihood(step, best)
        if is_better := found > best:
            at, best, (gradient, information) = step, found, derivatives
        damping *= 0.1 if is_better else 10.0
    return at, best


# Whitening.


@dataclass(frozen=True)
class Whitening:
    """Linear map that gives residuals unit covariance; rows of weight zero are ignored."""

    weight: Array
    """``(M, N)`` reciprocal standard deviations of the measurement."""
    blocks: tuple[tuple[NDArray[np.int64], Array], ...] = ()
    """Visits of n rows, for each n: ``(V, n)`` numbers of the rows, and ``(V, M n, M n)`` the symmetric inverse root of
    each visit's covariance, of values scaled by their weights."""

    def apply(self, values: Array) -> Array:
        """Return ``(..., M, N)`` whitened."""
        scaled = np.multiply(values, self.weight, order="C")
        self._mix(scaled.reshape(-1, *self.weight.shape))
        return scaled

    def apply_transposed(self, values: Array) -> Array:
        """Return ``(..., M, N)`` multiplied by the transposed map."""
        scaled = values.copy()
        self._mix(scaled.reshape(-1, *self.weight.shape))
        scaled *= self.weight
        return scaled

    def rows(self, columns: Array, residual: Array) -> Array:
        """Return ``(M, P + 1, N)`` the columns ``(M, P, N)`` and the residual ``(M, N)``, whitened."""
        rows = np.empty((len(columns), columns.shape[1] + 1, columns.shape[2]))
        np.multiply(columns, self.weight[:, None], out=rows[:, :-1])
        np.multiply(residual, self.weight, out=rows[:, -1])
        self._mix(rows.swapaxes(0, 1))
        return rows

    def costs(self, values: Array) -> Array:
        """Return ``(2,)`` the sums of the squares of ``(M, N)`` whitened: of positions, and of orientations."""
        totals, step = np.zeros(2), values.shape[1] if self.blocks else BLOCK_NUMBERS // 32
        for start in range(0, values.shape[1], step):
            rows = slice(start, start + step)
            white = (self if self.blocks else self.subset(rows)).apply(values[:, rows])
            totals += [np.vdot(part, part) for part in (white[:3], white[3:])]
        return totals

    def _mix(self, scaled: Array) -> None:
        """Multiply scaled values ``(L, M, N)`` in place by the factors of the visits."""
        for rows, factor in self.blocks:
            step = max(1, BLOCK_NUMBERS // (len(scaled) * factor.shape[1]))
            for start in range(0, len(rows), step):
                part = rows[start : start + step]
                stacked = scaled[:, :, part].transpose(2, 1, 3, 0)
                mixed = factor[start : start + step] @ stacked.reshape(len(part), factor.shape[1], -1)
                scaled[:, :, part] = mixed.reshape(stacked.shape).transpose(3, 1, 0, 2)

    def subset(self, rows: NDArray[np.int64] | slice) -> "Whitening":
        """Return the map of the given rows; each visit must be included or excluded as a whole."""
        weight, blocks = self.weight[:, rows], []
        if self.blocks:
            place = np.full(self.weight.shape[1], -1, dtype=np.int64)
            place[rows] = np.arange(weight.shape[1])
            for numbers, factor in self.blocks:
                included = (place[numbers] >= 0).all(axis=1)
                blocks.append((place[numbers][included], factor[included]))
        return Whitening(weight, tuple(blocks))


def whitening(
    weight: Array,
    joint_columns: Array | None = None,
    scatter: Array | None = None,
    visits: NDArray[np.int64] | None = None,
    noise: Array | None = None,
) -> Whitening:
    """Build the map from the measurement's weights, its correlation, and the scatter of the joints.

    Args:
        weight: ``(M, N)`` reciprocal standard deviations of the measurement, zero for rows that are ignored.
        joint_columns: ``(M, J, N)`` Jacobian of the joint variables; None without scatter.
        scatter: ``(J,)`` standard deviation of each joint from visit to visit, rad or m; None or ``(0,)`` without.
        visits: ``(N,)`` number of the visit of each row; by default each row is one.
        noise: ``(3, 3, N)`` covariance between the coordinates of each position, m², 0 on its diagonal; None without.
    """
    components, n = weight.shape
    scaled = np.zeros((components, 0, n))
    if scatter is not None and scatter.size and joint_columns is not None:
        scaled = joint_columns * weight[:, None, :] * scatter[:, None]
    elif noise is None:
        return Whitening(weight)
    blocks = []
    for rows in blocks_of(np.arange(n) if visits is None else visits):
        count, n = rows.shape
        columns = scaled[:, :, rows].transpose(2, 0, 3, 1).reshape(count, components * n, -1)
        covariance = columns @ columns.swapaxes(1, 2)
        if noise is not None:
            each, position = covariance.reshape(count, components, n, components, n), weight[:3, rows]
            each[:, :3, :, :3] += np.einsum("avi,abvi,bvi,ij->vaibj", position, noise[..., rows], position, np.eye(n))
        values, vectors = np.linalg.eigh(covariance)
        factor = (vectors / np.sqrt(np.maximum(1.0 + values, EPSILON))[:, None, :]) @ vectors.swapaxes(1, 2)
        blocks.append((rows, factor))
    return Whitening(weight, tuple(blocks))


def blocks_of(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the blocks of rows with equal numbers, ``(V, n)`` for each block size n."""
    order = np.argsort(numbers, kind="stable")
    _, first, counts = np.unique(numbers[order], return_index=True, return_counts=True)
    return [order[first[counts == n][:, None] + np.arange(n)].astype(np.int64) for n in np.unique(counts).tolist()]


# Normal equations.


@dataclass(frozen=True)
class NormalEquations:
    """Least squares linearised at ``theta``, for the K sought coefficients: gram step = gradient."""

    theta: Array
    """``(K,)`` the point of linearisation."""
    grams: Array
    """``(2, K, K)`` of measured positions, and of orientations."""
    gradients: Array
    """``(2, K)``"""
    costs: Array
    """``(2,)`` sums of whitened squares at ``theta``."""

    @cached_property
    def gram(self) -> Array:
        """Return ``(K, K)`` the normal matrix of positions and orientations together."""
        return np.asarray(self.grams.sum(axis=0))

    @property
    def gradient(self) -> Array:
        """Return ``(K,)``."""
        return np.asarray(self.gradients.sum(axis=0))

    @property
    def cost(self) -> float:
        """Return the sum of whitened squares at ``theta``."""
        return float(self.costs.sum())

    @property
    def rhs(self) -> Array:
        """Return ``(K,)`` the right-hand side for the coefficients themselves: gram theta = rhs."""
        return np.asarray(self.gradient + self.gram @ self.theta)

    def step(self, prior: Array, damping: float = 0.0) -> Array:
        """Return ``(K,)`` the step to the minimum with priors of precision ``(K,)``; see :func:`solved`."""
        return solved(self.gram + np.diag(prior), self.gradient - prior * self.theta, damping)

    def subset(self, columns: NDArray[np.int64]) -> "NormalEquations":
        """Return the equations of some of the coefficients, the others fixed."""
        grams = self.grams[:, columns[:, None], columns]
        return NormalEquations(self.theta[columns], grams, self.gradients[:, columns], self.costs)

    def at(self, theta: Array, costs: Array) -> "NormalEquations":
        """Return the same linearisation at coefficients ``theta`` ``(K,)``, where the squares sum to ``costs``."""
        return NormalEquations(theta, self.grams, self.gradients - self.grams @ (theta - self.theta), costs)

    def scaled(self, factors: Array) -> "NormalEquations":
        """Return the equations with the squares of positions and of orientations times ``factors`` ``(2,)``."""
        grams, gradients = self.grams * factors[:, None, None], self.gradients * factors[:, None]
        return NormalEquations(self.theta, grams, gradients, self.costs * factors)

    def root(self) -> Array:
        """Return a matrix ``(K, K)`` whose Gram matrix is ``gram``, which resolves independent parts of 1e-7."""
        values, vectors = np.linalg.eigh(unit_diagonal(self.gram)[0])
        return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * np.sqrt(np.diag(self.gram)))


class PoseEquations:
    """A model and measured poses, in blocks."""

    def __init__(self, model: Model, data: Measurements) -> None:
        """Bind every block."""
        self.components, self.n = 3 if data.rotation is None else 6, data.n
        slices = [slice(start, min(start + BLOCK, data.n)) for start in range(0, max(data.n, 1), BLOCK)]
        parts = [data if len(slices) == 1 else data.subset(rows) for rows in slices]
        self._blocks = [(rows, part, model.bind(part)) for rows, part in zip(slices, parts, strict=True)]
        self.terms, self.owners = self._blocks[0][2].terms, self._blocks[0][2].owners
        self.nominal = self._blocks[0][2].nominal
        """Scalars of the nominal chain at the poses of the first block."""
        self.columns: NDArray[np.int64] = np.arange(len(self.terms))
        """Numbers of the sought coefficients: all at first, then the identifiable ones."""

    def residual(self, theta: Array) -> Array:
        """Return ``(M, N)`` measured minus predicted.

        Raises:
            EquilibriumError: the arm is softer than its weight allows.
        """
        residual = np.empty((self.components, self.n))
        for rows, part, bound in self._blocks:
            residual[:, rows] = residuals(part, bound.poses(theta))
        return residual

    def linearise(self, theta: Array, white: Whitening) -> tuple[Array, NormalEquations]:
        """Return the residual ``(M, N)``, and the normal equations of the sought coefficients.

        Visits that a block's end divides count as two.

        Raises:
            EquilibriumError: the arm is softer than its weight allows.
        """
        residual, size = np.empty((self.components, self.n)), self.columns.size
        # Gram matrices of positions and of orientations, with the residual as the last column.
        grams = np.zeros((2, size + 1, size + 1))
        for rows, part, bound in self._blocks:
            poses, jacobian = bound.linearise_by_motion(theta, self.columns, self.components)
            residual[:, rows] = residuals(part, poses)
            of_block = white if len(self._blocks) == 1 else white.subset(rows)
            grams += _grams(jacobian, residual[:, rows], of_block)
        equations = NormalEquations(theta[self.columns], grams[:, :-1, :-1], grams[:, :-1, -1], grams[:, -1, -1])
        return residual, equations


def _grams(jacobian: JacobianByMotion, residual: Array, white: Whitening) -> Array:
    """Return Gram matrices ``(2, P + 1, P + 1)`` of whitened positions and orientations, the residual as last column.

    Parts of one motion share its column: of the parts of two motions with columns a, b and regressors R, S, the block
    is R diag(a'b) S', for a fraction of the products of whole columns.
    """
    grams = np.zeros((2, jacobian.size + 1, jacobian.size + 1))
    is_row_by_row = all(len(numbers[0]) == 1 for numbers, _ in white.blocks)
    if jacobian.parts is None or jacobian.size < 4 * jacobian.motions.shape[1] or not is_row_by_row:
        for number, component in enumerate(white.rows(jacobian.dense, residual)):
            grams[number // 3] += component @ component.T
        return grams
    rows = white.rows(jacobian.motions, residual)
    place, slot, factor = jacobian.parts
    place, slot = np.append(place, jacobian.size), np.append(slot, rows.shape[1] - 1)
    # Parts of one motion stand together, those of motions with one part come last.
    is_shared = np.bincount(slot)[slot] > 1
    order = np.argsort(np.where(is_shared, slot, rows.shape[1]), kind="stable")
    place, slot, factor = place[order], slot[order], np.concatenate((factor, np.ones((1, rows.shape[2]))))[order]
    alone = int(np.count_nonzero(is_shared))
    for gram, kind in zip(grams, (rows[:3], rows[3:]), strict=True):
        of_parts = np.zeros((slot.size, slot.size))
        of_parts[alone:, alone:] = sum(a @ a.T for a in kind[:, slot[alone:]] * factor[alone:])
        for start in np.unique(slot[:alone], return_index=True)[1].tolist():
            group = slice(start, start + int(np.count_nonzero(slot == slot[start])))
            products = np.einsum("mn,mwn->wn", kind[:, slot[start]], kind)
            block = factor[group] @ (factor[start:] * products[slot[start:]]).T
            of_parts[group, start:], of_parts[start:, group] = block, block.T
        at = (place[:, None] * len(gram) + place).ravel()
        gram += np.bincount(at, of_parts.ravel(), gram.size).reshape(gram.shape)
    return grams
