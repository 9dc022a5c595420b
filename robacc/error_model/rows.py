"""Rows of measured poses as the covariance sees them: their visits, joint angles and places in time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Part, Term
from robacc.effects.step import sequence_of
from robacc.fitting.places import places
from robacc.fitting.visits import random_rank, visit_numbers
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.bound import BoundModel
from robacc.modelling.observation import residuals
from robacc.robots.arm import Arm

ORDERS = np.arange(1, 41)
"""Orders per turn of a joint's profile; 40 is the highest order that competes as an effect."""
_STILL = 1e-6
"""rad or m; a joint that moves by less has no error that depends on its angle."""


@dataclass(frozen=True)
class Rows:
    """N measured rows."""

    visit: NDArray[np.int64]
    """``(N,)`` number of the arm's arrival."""
    place: NDArray[np.int64]
    """``(N,)`` number of the pose, or of poses that lie close together."""
    angles: Array
    """``(J, N)`` rad; the travel of a slide is half a turn, so that its ends are different places."""
    time: Array
    """``(N,)`` place in time, or in row order, from 0 to 1."""
    moves: NDArray[np.bool_]
    """``(J,)`` whether a joint moves."""
    draw: NDArray[np.int64]
    """``(N,)`` random rank of each row's commanded pose: the first ranks are a fair part of the rows, in any order."""
    stated: Array
    """``(N, M)`` variance of the noise that the file states, m² and rad²; 0 without."""
    scale: Array
    """``(J,)`` factor of the angles: 1 of a joint that turns, rad/m of a slide."""

    @classmethod
    def of(cls, arm: Arm, data: Measurements) -> Rows:
        """Return what the covariance needs of measured poses."""
        assert data.q is not None
        extent = np.ptp(data.q, axis=1)
        moves = extent > _STILL
        turns = np.array([arm.is_revolute(name) for name in arm.names])
        scale = np.where(turns, 1.0, np.pi / np.where(moves, extent, 1.0))
        start = np.where(turns, 0.0, data.q.min(axis=1))
        time = sequence_of(data).astype(float)
        stated = np.zeros((data.n, 3 if data.rotation is None else 6))
        if data.position_variance is not None:
            stated[:, :3] = data.position_variance.T
        if data.rotation is not None and data.sigma_rotation is not None:
            stated[:, 3:] = np.square(data.sigma_rotation)[:, None]
        return cls(
            visit_numbers(data),
            places(data),
            (data.q - start[:, None]) * scale[:, None],
            (time - time.min()) / max(float(np.ptp(time)), 1e-9),
            moves,
            random_rank(data),
            stated,
            scale,
        )

    def subset(self, index: NDArray[np.int64]) -> Rows:
        """Return some of the rows."""
        return Rows(
            self.visit[index],
            self.place[index],
            self.angles[:, index],
            self.time[index],
            self.moves,
            self.draw[index],
            self.stated[index],
            self.scale,
        )

    @cached_property
    def same_visit(self) -> Array:
        """``(N, N)`` 1 for two rows of one visit, else 0."""
        return np.asarray(self.visit[:, None] == self.visit, dtype=np.float64)

    @cached_property
    def same_place(self) -> Array:
        """``(N, N)`` 1 for two rows of one place, else 0."""
        return np.asarray(self.place[:, None] == self.place, dtype=np.float64)

    @cached_property
    def chords(self) -> dict[int, Array]:
        """``(N, N)`` squared chords between the angles of each joint that moves."""
        return {
            j: np.square(2.0 * np.sin(0.5 * (angle[:, None] - angle)))
            for j, angle in enumerate(self.angles)
            if self.moves[j]
        }

    @cached_property
    def waves(self) -> dict[int, Array]:
        """``(2 K, N)`` cosines, then sines, of each order of the angle of each joint that moves."""
        phases = {j: np.multiply.outer(ORDERS, angle) for j, angle in enumerate(self.angles) if self.moves[j]}
        return {j: np.concatenate((np.cos(phase), np.sin(phase))) for j, phase in phases.items()}

    @cached_property
    def lags(self) -> Array:
        """``(N, N)`` distances in time."""
        return np.asarray(np.abs(self.time[:, None] - self.time))


@dataclass(frozen=True)
class Linearised:
    """A model linearised at coefficients ``theta``: ``y`` is about ``columns @ coefficients``."""

    rows: Rows
    y: Array
    """``(N, M)`` residual plus ``columns @ theta``, m and rad."""
    columns: Array
    """``(N, M, P)`` derivatives by the coefficients."""
    joints: Array
    """``(J, M, N)`` derivatives by the joint variables."""
    prior_std: Array
    """``(P,)`` prior standard deviation of each coefficient about zero."""

    @classmethod
    def at(cls, bound: BoundModel, theta: Array, prior_std: Array, rows: Rows, data: Measurements) -> Linearised:
        """Linearise a bound model at coefficients ``theta`` ``(P,)``."""
        arm, count, components = bound.arm, len(bound.terms), rows.stated.shape[1]
        motions = [arm.axis_motion(joint) for joint in arm.names]
        extended = with_terms(bound, [Term(f"motion {motion}", "", 1.0, (Part(motion),)) for motion in motions])
        poses, jacobian = extended.linearise(np.concatenate((theta, np.zeros(len(motions)))), rows=components)
        columns = np.ascontiguousarray(np.moveaxis(jacobian[:, :count], -1, 0))
        joints = np.ascontiguousarray(np.swapaxes(jacobian[:, count:], 0, 1))
        return cls(rows, residuals(data, poses)[:components].T + columns @ theta, columns, joints, prior_std)

    def subset(self, index: NDArray[np.int64]) -> Linearised:
        """Return some of the rows."""
        return Linearised(
            self.rows.subset(index), self.y[index], self.columns[index], self.joints[:, :, index], self.prior_std
        )

    def turned(self, axes: Array) -> Linearised:
        """Return the same with positions along ``axes`` ``(3, 3)``, in rows."""

        def along(values: Array, at: int) -> Array:
            position, other = np.split(values, [3], axis=at)
            return np.concatenate((np.moveaxis(np.tensordot(axes, position, (1, at)), 0, at), other), axis=at)

        return dataclasses.replace(
            self, y=along(self.y, 1), columns=along(self.columns, 1), joints=along(self.joints, 1)
        )

    @cached_property
    def reach(self) -> Array:
        """``(J,)`` root mean square distance (m) by which a joint moves the target per rad or m, at least 1 um."""
        return np.asarray(np.maximum(np.sqrt(np.mean(np.sum(np.square(self.joints[:, :3]), axis=1), axis=1)), 1e-6))


def with_terms(bound: BoundModel, terms: Sequence[Term]) -> BoundModel:
    """Return a bound model with more coefficients."""
    return dataclasses.replace(bound, terms=(*bound.terms, *terms))
