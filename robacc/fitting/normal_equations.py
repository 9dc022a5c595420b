"""Residuals and normal equations of a model over measured poses, summed over blocks of poses.

Rows are whitened by ``weight`` ``(M, N)``, reciprocal standard deviations, zero for rows left out. Orientation
residuals are r = log(R_measured R_predicted^T), whose exact derivative is -J_l^-1(-r) dphi. As r is an eigenvector of
J_l(r) to eigenvalue 1 and a pose's three orientations have one weight, the gradient is the same without that factor;
the normal matrix changes by the order of r^2, which Gauss-Newton neglects anyway. So rows dphi are used unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BLOCK
from robacc.effects.joint_offset import JointOffset
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.bound import BoundModel
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals


@dataclass(frozen=True, slots=True)
class PredictedPoses:
    """Poses that coefficients predict, and their residuals."""

    theta: Array
    """``(P,)`` coefficients."""
    poses: tuple[Poses, ...]
    """Predicted poses of each block."""
    residual: Array
    """``(M, N)`` measured minus predicted."""

    def joined(self) -> Poses:
        """Return the predicted poses ``(N)``."""
        if len(self.poses) == 1:
            return self.poses[0]
        rotation = np.concatenate([block.rotation for block in self.poses], axis=2)
        return Poses(rotation, np.concatenate([block.translation for block in self.poses], axis=1))


@dataclass(frozen=True)
class NormalEquations:
    """Least squares linearised at ``theta``, for the K sought coefficients: gram step = gradient."""

    theta: Array
    """``(K,)`` the point of linearisation."""
    gram: Array
    """``(K, K)``"""
    gradient: Array
    """``(K,)``"""
    cost: float
    """Sum of whitened squares at ``theta``."""

    @cached_property
    def rhs(self) -> Array:
        """Return ``(K,)`` the right-hand side for the coefficients themselves: gram theta = rhs."""
        rhs: Array = self.gradient + self.gram @ self.theta
        return rhs

    def subset(self, columns: NDArray[np.int64]) -> NormalEquations:
        """Return the equations of some of the coefficients, the others fixed."""
        return NormalEquations(
            self.theta[columns], self.gram[np.ix_(columns, columns)], self.gradient[columns], self.cost
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
        self._bound: list[BoundModel] = [model.bind(block) for block in self._parts]
        self.terms = self._bound[0].terms
        self.owners = self._bound[0].owners
        self.columns: NDArray[np.int64] = np.arange(len(self.terms))
        """Numbers of the sought coefficients: all at first, then the identifiable ones."""
        self._cache: tuple[Array, NDArray[np.int64], Poses, Array] | None = None

    def predict(self, theta: Array, *, ahead: bool = False) -> PredictedPoses:
        """Predict; ``ahead`` if the Jacobian is needed at the same coefficients next.

        Raises:
            EquilibriumError: the arm is softer than its weight allows.
        """
        if ahead and len(self._slices) == 1:
            return self._prediction(theta, [self._linearised(theta, 0)[0]])
        return self._prediction(theta, [bound.poses(theta) for bound in self._bound])

    def linearise(self, theta: Array, white: Whitening) -> tuple[PredictedPoses, NormalEquations]:
        """Predict, and sum the normal equations of the sought coefficients.

        Raises:
            EquilibriumError: the arm is softer than its weight allows.
        """
        size = self.columns.size
        gram = np.zeros((size + 1, size + 1))
        predicted, residual_blocks = [], []
        for index, block in enumerate(self._block_maps(white)):
            poses, residual, rows = self._whitened(theta, block, index)
            predicted.append(poses)
            residual_blocks.append(residual)
            gram += rows @ rows.T
        return PredictedPoses(theta, tuple(predicted), _concatenated(residual_blocks)), self._normal(theta, gram)

    def factorise(self, theta: Array, white: Whitening) -> tuple[Array, NormalEquations]:
        """Return the R factor ``(R, P)`` of the whitened Jacobian of the sought coefficients, and its normal equations.

        Orthogonal factorisation keeps twice the digits that the normal matrix has.
        """
        triangle = np.zeros((0, self.columns.size + 1))
        for index, block in enumerate(self._block_maps(white)):
            rows = self._whitened(theta, block, index)[2].T
            triangle = np.asarray(np.linalg.qr(np.concatenate((triangle, rows)) if index else rows, mode="r"))
        return triangle[:, :-1], self._normal(theta, triangle.T @ triangle)

    def _normal(self, theta: Array, gram: Array) -> NormalEquations:
        """Build them from the Gram matrix of the Jacobian with the residual as its last column."""
        return NormalEquations(theta[self.columns], gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1]))

    def _prediction(self, theta: Array, predicted: list[Poses]) -> PredictedPoses:
        residual_blocks = [residuals(block, poses) for block, poses in zip(self._parts, predicted, strict=True)]
        return PredictedPoses(theta, tuple(predicted), _concatenated(residual_blocks))

    def _linearised(self, theta: Array, index: int) -> tuple[Poses, Array]:
        if self._cache is not None and np.array_equal(self._cache[0], theta):
            columns, poses, jacobian = self._cache[1:]
            is_subset = columns.size > self.columns.size
            return poses, jacobian[:, np.searchsorted(columns, self.columns)] if is_subset else jacobian
        poses, jacobian = self._bound[index].linearise(theta, self.columns)
        jacobian = jacobian[: self.rows]
        if len(self._slices) == 1:
            self._cache = theta, self.columns, poses, jacobian
        return poses, jacobian

    def _block_maps(self, white: Whitening) -> list[Whitening]:
        """Return the map of each block of poses; visits that a block's end divides count as two."""
        if len(self._slices) == 1:
            return [white]
        return [white.subset(np.arange(block.start, block.stop)) for block in self._slices]

    def _whitened(self, theta: Array, white: Whitening, index: int) -> tuple[Poses, Array, Array]:
        """Return poses, residual ``(M, n)``, and whitened ``(K + 1, M n)`` the Jacobian with the residual last."""
        poses, jacobian = self._linearised(theta, index)
        residual = residuals(self._parts[index], poses)
        _, count, n = jacobian.shape
        rows = np.empty((count + 1, self.rows, n))
        rows[:count] = jacobian.transpose(1, 0, 2)
        rows[count] = residual
        return poses, residual, white.apply_inplace(rows).reshape(count + 1, -1)

    def joint_columns(self, model: Model) -> Array:
        """Return ``(M, J, N)`` columns of the joint variables at the model's own robot."""
        parts = [joint_columns(model, block)[: self.rows] for block in self._parts]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)


def joint_columns(model: Model, data: Measurements) -> Array:
    """Return ``(6, J, N)`` Jacobian of the joint variables at the model's robot, without its free effects."""
    joints = Model(model.arm, model.known, (JointOffset(model.arm.names),))
    return joints.bind(data).linearise(np.zeros(len(model.arm.names)))[1]


def _concatenated(parts: list[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
