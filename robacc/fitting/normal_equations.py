"""Linearised and whitened rows of measured poses, and their normal equations, summed over blocks.

Rows are whitened by ``weight`` ``(M, N)``, reciprocal standard deviations, zero for rows left out. Orientation
residuals are r = log(R_measured R_predicted^T), whose exact derivative is -J_l^-1(-r) dphi. As r is an eigenvector of
J_l(r) to eigenvalue 1 and a pose's three orientations have one weight, the gradient is the same without that factor;
the normal matrix changes by the order of r^2, which Gauss-Newton neglects anyway. So rows dphi are used unchanged.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BLOCK
from robacc.effects.base import SCALE_OF_INSTRUMENT, Part, Term
from robacc.effects.frames import JointOffset
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import BoundModel, Model
from robacc.modelling.observation import residuals

# Symmetric systems that rounding or absent data can make singular.

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


# Linearised and whitened rows of measured poses, and their Gram matrix.
#
# A joint's profile has many coefficients, whose columns are all the column of one motion times regressors over the
# poses. They are not built: with c and d whitened columns of two motions, f and g regressors, the product of two such
# columns is the sum over the poses of (c . d) f g. Rows that are whitened together mix their regressors, so that
# theirs are built.


@dataclass(frozen=True, slots=True)
class Profile:
    """Coefficients whose columns are the whitened ``column`` ``(M, n)`` of a motion times ``factors`` ``(Q, n)``."""

    places: NDArray[np.int64]
    """``(Q,)`` indices among the sought coefficients."""
    column: Array
    factors: Array


@dataclass(frozen=True, slots=True)
class LinearisedRows:
    """Linearisation of n rows, not whitened, with D columns and the motions of F profiles."""

    built: NDArray[np.int64]
    """``(D,)`` indices of the columns among the sought coefficients."""
    columns: Array
    """``(M, D, n)``"""
    residual: Array
    """``(M, n)``"""
    places: tuple[NDArray[np.int64], ...]
    """Indices of each profile's coefficients among the sought ones, ``(Q,)``."""
    motions: Array
    """``(M, F, n)``"""
    factors: tuple[Array, ...]
    """Regressors of each profile, ``(Q, n)``."""

    def subset(self, rows: NDArray[np.int64]) -> LinearisedRows:
        """Return some of the rows."""
        return LinearisedRows(
            self.built,
            self.columns[:, :, rows],
            self.residual[:, rows],
            self.places,
            self.motions[:, :, rows],
            tuple(factors[:, rows] for factors in self.factors),
        )

    def whitened(self, white: Whitening) -> WhitenedRows:
        """Return the rows whitened; of rows that are whitened together every column is built, as regressors mix."""
        if white.mixes_rows and self.places:
            return self._completed().whitened(white)
        count, motions = self.built.size, self.motions.swapaxes(0, 1)
        rows = np.empty((count + 1 + len(motions), *self.residual.shape))
        rows[:count], rows[count], rows[count + 1 :] = self.columns.swapaxes(0, 1), self.residual, motions
        white.apply_inplace(rows)
        return WhitenedRows(
            self.built, rows[: count + 1], tuple(map(Profile, self.places, rows[count + 1 :], self.factors))
        )

    def _completed(self) -> LinearisedRows:
        """Return the same with every column built."""
        size = self.built.size + sum(places.size for places in self.places)
        columns = np.empty((len(self.columns), size, self.residual.shape[1]))
        columns[:, self.built] = self.columns
        for i, places in enumerate(self.places):
            columns[:, places] = self.motions[:, i, None] * self.factors[i]
        return LinearisedRows(np.arange(size), columns, self.residual, (), self.motions[:, :0], ())


@dataclass(frozen=True, slots=True)
class WhitenedRows:
    """Whitened linearisation of rows."""

    places: NDArray[np.int64]
    """``(D,)`` indices of the built columns among the sought coefficients."""
    rows: Array
    """``(D + 1, M, n)`` built columns, and the residual."""
    profiles: tuple[Profile, ...]

    @property
    def flat(self) -> Array:
        """Return ``(D + 1, M n)`` built columns and the residual."""
        return self.rows.reshape(self.rows.shape[0], -1)

    def gram(self, components: slice) -> Array:
        """Return ``(K + 1, K + 1)`` the Gram matrix of all columns and the residual, of some of their M components."""
        rows = self.rows[:, components]
        flat = rows.reshape(len(rows), -1)
        built: Array = flat @ flat.T
        if not self.profiles:
            return built
        size = self.places.size + sum(profile.places.size for profile in self.profiles)
        result = np.empty((size + 1, size + 1))
        at = np.append(self.places, size)
        result[np.ix_(at, at)] = built
        for i, profile in enumerate(self.profiles):
            column = profile.column[components]
            cross = np.einsum("kmn,mn->kn", rows, column) @ profile.factors.T
            result[np.ix_(at, profile.places)], result[np.ix_(profile.places, at)] = cross, cross.T
            scaled = profile.factors * np.sqrt(np.einsum("mn,mn->n", column, column))
            result[np.ix_(profile.places, profile.places)] = scaled @ scaled.T
            for other in self.profiles[:i]:
                scaled = profile.factors * np.einsum("mn,mn->n", column, other.column[components])
                cross = scaled @ other.factors.T
                result[np.ix_(profile.places, other.places)], result[np.ix_(other.places, profile.places)] = (
                    cross,
                    cross.T,
                )
        return result


_FEWEST_FACTORS = 8
"""Coefficients that share a motion, from which their columns are not built."""


@dataclass(frozen=True, slots=True)
class PredictedPoses:
    """Residuals of the poses that coefficients predict."""

    theta: Array
    """``(P,)`` coefficients."""
    residual: Array
    """``(M, N)`` measured minus predicted."""


@dataclass(frozen=True)
class NormalEquations:
    """Least squares linearised at ``theta``, for the K sought coefficients: gram step = gradient."""

    theta: Array
    """``(K,)`` the point of linearisation."""
    gram: Array
    """``(K, K)``"""
    of_position: Array
    """``(K, K)`` the part of ``gram`` that measured positions are; the rest is of orientations."""
    gradient: Array
    """``(K,)``"""
    cost: float
    """Sum of whitened squares at ``theta``."""

    @cached_property
    def rhs(self) -> Array:
        """Return ``(K,)`` the right-hand side for the coefficients themselves: gram theta = rhs."""
        rhs: Array = self.gradient + self.gram @ self.theta
        return rhs

    def posterior(self, prior: Array) -> Array:
        """Return ``(K, K)`` the inverse of the normal matrix with the priors' precision ``(K,)``; the last is kept."""
        key = prior.tobytes()
        if key not in self._inverses:
            self._inverses.clear()
            self._inverses[key] = posterior(self.gram, prior)
        return self._inverses[key]

    @cached_property
    def _inverses(self) -> dict[bytes, Array]:
        return {}

    def moved_to(self, theta: Array, cost: float) -> NormalEquations:
        """Return the same linearisation at coefficients ``theta`` ``(K,)`` nearby, where the cost is ``cost``."""
        gradient = self.gradient - self.gram @ (theta - self.theta)
        return dataclasses.replace(self, theta=theta, gradient=gradient, cost=cost)

    def subset(self, columns: NDArray[np.int64]) -> NormalEquations:
        """Return the equations of some of the coefficients, the others fixed."""
        own = np.ix_(columns, columns)
        return NormalEquations(
            self.theta[columns], self.gram[own], self.of_position[own], self.gradient[columns], self.cost
        )

    def expected_cost(self, theta: Array) -> float:
        """Return the cost that the linearisation predicts at ``theta`` ``(K,)``."""
        step = theta - self.theta
        return float(self.cost - 2.0 * step @ self.gradient + step @ self.gram @ step)


class PoseEquations:
    """A model and measured poses, in blocks; the Jacobian of a single block is cached while coefficients stay."""

    def __init__(self, model: Model, data: Measurements) -> None:
        """Bind every block."""
        self.data = data
        self.rows = 3 if data.rotation is None else 6
        starts = range(0, max(data.n, 1), BLOCK)
        self._slices = [slice(start, min(start + BLOCK, data.n)) for start in starts]
        is_single = len(self._slices) == 1
        self._parts = [data if is_single else data.subset(s) for s in self._slices]
        bound = [model.bind(block) for block in self._parts]
        self.terms = bound[0].terms
        self.owners = bound[0].owners
        self._factored = _factored(self.terms)
        # The column of a motion that several coefficients share is that of one more coefficient, which is zero.
        motions = tuple(Term(f"motion {motion}", "", 1.0, (Part(motion),)) for motion, _ in self._factored)
        self._bound: list[BoundModel] = [dataclasses.replace(b, terms=(*b.terms, *motions)) for b in bound]
        self.columns: NDArray[np.int64] = np.arange(len(self.terms))
        """Numbers of the sought coefficients: all at first, then the identifiable ones."""
        self._cache: tuple[Array, NDArray[np.int64], Poses, Array] | None = None

    def predict(self, theta: Array, *, ahead: bool = False) -> PredictedPoses:
        """Predict; ``ahead`` if the Jacobian is needed at the same coefficients next.

        Raises:
            EquilibriumError: the arm is softer than its weight allows.
        """
        if ahead and len(self._slices) == 1:
            return PredictedPoses(theta, residuals(self.data, self._linearised(theta, 0)[0]))
        whole = self._with_motions(theta)
        residual = np.empty((self.rows, self.data.n))
        for rows, part, bound in zip(self._slices, self._parts, self._bound, strict=True):
            residual[:, rows] = residuals(part, bound.poses(whole))
        return PredictedPoses(theta, residual)

    def linearise(self, theta: Array, white: Whitening) -> tuple[PredictedPoses, NormalEquations]:
        """Predict, and sum the normal equations of the sought coefficients.

        Raises:
            EquilibriumError: the arm is softer than its weight allows.
        """
        return self._summed(theta, white)[:2]

    def _summed(self, theta: Array, white: Whitening) -> tuple[PredictedPoses, NormalEquations, list[WhitenedRows]]:
        """Predict, and sum the normal equations over the blocks; return the whitened rows of the last block too."""
        # Gram matrices of all components and, beside orientations, of positions, with the residual as the last column.
        grams = np.zeros((self.rows // 3, self.columns.size + 1, self.columns.size + 1))
        residual, parts = np.empty((self.rows, self.data.n)), list[WhitenedRows]()
        for index, white_block in enumerate(self._block_maps(white)):
            residual[:, self._slices[index]], parts = self._whitened(theta, white_block, index)
            for rows in parts:
                for total, components in zip(grams, (slice(None), slice(3)), strict=False):
                    total += rows.gram(components)
        gram, of_position = grams[0], grams[-1, :-1, :-1]
        cost = float(gram[-1, -1])
        normal = NormalEquations(theta[self.columns], gram[:-1, :-1], of_position, gram[:-1, -1], cost)
        return PredictedPoses(theta, residual), normal, parts

    def factorise(self, theta: Array, white: Whitening, free: NDArray[np.int64]) -> tuple[Array, NormalEquations]:
        """Return a factor ``(R, F)`` of whitened columns, and the normal equations of all sought coefficients.

        Orthogonal factorisation keeps twice the digits that the normal matrix has. Of several blocks, the root of the
        scaled normal matrix resolves independent parts of 1e-7, which is enough. ``free`` ``(F,)`` are the indices of
        the columns among the sought coefficients; none is of a group.
        """
        _, normal, parts = self._summed(theta, white)
        if len(self._slices) == 1:
            columns = [rows.flat[np.append(np.searchsorted(rows.places, free), rows.places.size)] for rows in parts]
            triangle = np.asarray(np.linalg.qr(np.concatenate(columns, axis=1).T, mode="r"))
            if free.size == self.columns.size:
                gram = triangle.T @ triangle
                normal = dataclasses.replace(
                    normal, gram=gram[:-1, :-1], gradient=gram[:-1, -1], cost=float(gram[-1, -1])
                )
            return triangle[:, :-1], normal
        gram = normal.gram[np.ix_(free, free)]
        length = np.sqrt(np.diag(gram))
        scale = np.where(length > 0.0, length, 1.0)
        values, vectors = np.linalg.eigh(gram / scale[:, None] / scale)
        return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * scale, normal

    def _with_motions(self, theta: Array) -> Array:
        return np.concatenate((theta, np.zeros(len(self._factored))))

    def _linearised(self, theta: Array, index: int) -> tuple[Poses, Array]:
        """Return poses and the Jacobian ``(M, D + F, n)`` of the built columns, and of the motions of the others."""
        motions = [len(self.terms) + i for i, _ in self._sought]
        columns = np.concatenate((self._built, np.array(motions, dtype=np.int64)))
        if self._cache is not None and np.array_equal(self._cache[0], theta):
            cached, poses, jacobian = self._cache[1:]
            if np.array_equal(cached, columns):
                return poses, jacobian
            if np.isin(columns, cached).all():
                return poses, jacobian[:, np.searchsorted(cached, columns)]
        poses, jacobian = self._bound[index].linearise(self._with_motions(theta), columns, self.rows)
        if len(self._slices) == 1:
            self._cache = theta, columns, poses, jacobian
        return poses, jacobian

    @property
    def _sought(self) -> list[tuple[int, NDArray[np.int64]]]:
        """Place among the shared motions, and coefficients, of those whose columns are not built, if sought."""
        sought = set(self.columns.tolist())
        return [(i, numbers) for i, (_, numbers) in enumerate(self._factored) if sought.issuperset(numbers.tolist())]

    @property
    def _built(self) -> NDArray[np.int64]:
        """Return ``(D,)`` the numbers of the sought coefficients whose columns are built."""
        if not self._factored:
            return self.columns
        return np.setdiff1d(self.columns, np.concatenate([numbers for _, numbers in self._factored]))

    def _block_maps(self, white: Whitening) -> list[Whitening]:
        """Return the map of each block of poses; visits that a block's end divides count as two."""
        if len(self._slices) == 1:
            return [white]
        return [white.subset(block) for block in self._slices]

    def _whitened(self, theta: Array, white: Whitening, index: int) -> tuple[Array, list[WhitenedRows]]:
        """Return the residual ``(M, n)`` of a block and the whitened linearisation of its rows."""
        poses, jacobian = self._linearised(theta, index)
        residual = residuals(self._parts[index], poses)
        profiles = [numbers for _, numbers in self._sought]
        columns, motions = np.split(jacobian, [self._built.size], axis=1)
        places = tuple(np.searchsorted(self.columns, numbers) for numbers in profiles)
        factors = tuple(self._factors(numbers, index) for numbers in profiles)
        built = np.searchsorted(self.columns, self._built)
        linearised = LinearisedRows(built, columns, residual, places, motions, factors)
        if not profiles or not white.mixes_rows:
            return residual, [linearised.whitened(white)]
        return residual, [linearised.subset(rows).whitened(part) for rows, part in white.parts]

    def _factors(self, numbers: NDArray[np.int64], index: int) -> Array:
        """Return ``(Q, n)`` the regressors of coefficients of one motion."""
        terms = self._bound[index].terms
        return np.stack([terms[number].parts[0].factor for number in numbers])

    def joint_columns(self, model: Model) -> Array:
        """Return ``(M, J, N)`` columns of the joint variables at the model's own robot."""
        parts = [joint_columns(model, block)[: self.rows] for block in self._parts]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)


def joint_columns(model: Model, data: Measurements) -> Array:
    """Return ``(6, J, N)`` Jacobian of the joint variables at the model's robot, without its free effects."""
    joints = Model(model.arm, model.known, (JointOffset(model.arm.names),))
    return joints.bind(data).linearise(np.zeros(len(model.arm.names)))[1]


def _factored(terms: Sequence[Term]) -> tuple[tuple[int, NDArray[np.int64]], ...]:
    """Return the motions that many shrunk coefficients move by a regressor each, and the numbers of these."""
    numbers: dict[int, list[int]] = {}
    for i, term in enumerate(terms):
        part = term.parts[0]
        is_regressor = len(term.parts) == 1 and part.loads is None and isinstance(part.factor, np.ndarray)
        if term.group is not None and is_regressor and part.motion != SCALE_OF_INSTRUMENT:
            numbers.setdefault(part.motion, []).append(i)
    return tuple((motion, np.array(members)) for motion, members in numbers.items() if len(members) >= _FEWEST_FACTORS)
