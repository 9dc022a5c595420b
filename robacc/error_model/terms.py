"""Terms of the covariance beside independent noise, and the rows of measured poses as they see them.

A term adds sum over carriers c of F_c K_c F_c', where F_c are the derivatives by a joint variable, or unit vectors
along a component of the measurement, and K_c is a kernel between rows. Its parameters are logarithms of standard
deviations (rad, m) and of lengths. To add a term: one class here, and its entry in :data:`TERMS`.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Part, Term
from robacc.effects.campaign import sequence_of
from robacc.fitting.levels import NEGLIGIBLE, RESOLUTION
from robacc.fitting.visits import first_ranks, places, random_rank, visit_numbers
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import BoundModel, residuals
from robacc.robots.arm import Arm

# Rows of measured poses as the covariance sees them: their visits, joint angles and places in time.

ORDERS = np.arange(1, 41)
"""Orders per turn of a joint's profile; 40 is the highest order that competes as an effect."""
MOST_COMPONENTS = 500
"""Components that the parameters are estimated on: the time grows with their cube."""
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
    shown: NDArray[np.bool_] | None
    """``(N, M)`` the components that were measured; None if all."""

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
            None if data.shown is None else data.shown.T,
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
            None if self.shown is None else self.shown[index],
        )

    @cached_property
    def kept(self) -> NDArray[np.int64] | None:
        """Numbers of the measured components among all, component by component; None if all were measured."""
        return None if self.shown is None else np.flatnonzero(self.shown.T)

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


@dataclass(frozen=True, eq=False)
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
        moved = [Term(f"motion {motion}", "", 1.0, (Part(motion),)) for motion in motions]
        extended = bound.with_terms(moved)
        poses, jacobian = extended.linearise(np.concatenate((theta, np.zeros(len(motions)))), rows=components)
        columns = np.ascontiguousarray(np.moveaxis(jacobian[:, :count], -1, 0))
        joints = np.ascontiguousarray(np.swapaxes(jacobian[:, count:], 0, 1))
        return cls(rows, residuals(data, poses)[:components].T + columns @ theta, columns, joints, prior_std)

    def subset(self, index: NDArray[np.int64]) -> Linearised:
        """Return some of the rows."""
        return Linearised(
            self.rows.subset(index), self.y[index], self.columns[index], self.joints[:, :, index], self.prior_std
        )

    @cached_property
    def part(self) -> tuple[NDArray[np.int64], Linearised]:
        """Rows of random poses, few enough to estimate parameters on."""
        index = first_ranks(self.rows.draw, MOST_COMPONENTS // self.y.shape[1])
        return index, self if index.size == len(self.y) else self.subset(index)

    def turned(self, axes: Array) -> Linearised:
        """Return the same with positions along ``axes`` ``(3, 3)``, in rows."""

        def along(values: Array, at: int) -> Array:
            position, other = np.split(values, [3], axis=at)
            return np.concatenate((np.moveaxis(np.tensordot(axes, position, (1, at)), 0, at), other), axis=at)

        return dataclasses.replace(
            self, y=along(self.y, 1), columns=along(self.columns, 1), joints=along(self.joints, 1)
        )

    @property
    def of_position(self) -> Linearised:
        """Return the same without orientations."""
        shown = None if self.rows.shown is None else self.rows.shown[:, :3]
        rows = dataclasses.replace(self.rows, stated=self.rows.stated[:, :3], shown=shown)
        return Linearised(rows, self.y[:, :3], self.columns[:, :3], self.joints[:, :3], self.prior_std)

    @cached_property
    def reach(self) -> Array:
        """``(J,)`` root mean square distance (m) by which a joint moves the target per rad or m, at least 1 um."""
        return np.asarray(np.maximum(np.sqrt(np.mean(np.sum(np.square(self.joints[:, :3]), axis=1), axis=1)), 1e-6))


ErrorPart = Literal["noise", "scatter", "pose", "wander"]
"""Noise of the instrument, scatter of the joints, error that depends on the pose, wander over time."""
LOG_STDS = (math.log(NEGLIGIBLE * RESOLUTION), math.log(0.1))
"""Bounds of a log standard deviation, rad or m: negligible at an instrument's resolution, and larger than any arm's
error."""

Carried = tuple[int, Sequence[int], Array]
"""Number of a parameter, carriers, and the kernel ``(N, N)`` of each of these carriers or its derivative by it."""


class CovarianceTerm(abc.ABC):
    """One term of the covariance: each standard deviation scales the kernel of some carriers."""

    name: ClassVar[str]
    meaning: ClassVar[str]
    of_joints: ClassVar[bool] = True
    """Whether the carriers are the joints; else the components of the measurement."""
    part: ClassVar[ErrorPart] = "pose"
    """ErrorPart of the remaining error that it describes."""
    is_correlated: ClassVar[bool] = True
    """Whether it correlates rows of different visits."""
    acts_at_rest: ClassVar[bool] = True
    """Whether it acts on joints that do not move."""
    amplitudes: ClassVar[slice] = slice(None)
    """Which of the parameters are standard deviations."""
    shape_bounds: ClassVar[tuple[float, float]] = (0.0, 0.0)
    """Bounds of the other parameters."""

    @abc.abstractmethod
    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return parameters to start from, beside noise of standard deviations ``noise`` (m and rad)."""

    @abc.abstractmethod
    def carried(self, parameters: Array, rows: Rows) -> Iterator[Carried]:
        """Yield the number of each standard deviation, its carriers, and their kernel, its variance included."""

    def slopes(self, parameters: Array, rows: Rows, number: int, kernel: Array) -> Iterator[tuple[int, Array]]:
        """Yield the derivatives of the ``kernel`` of standard deviation ``number`` by the other parameters."""
        return iter(())

    def bounds(self, count: int) -> list[tuple[float, float]]:
        """Return the bounds of ``count`` parameters."""
        stds = range(count)[self.amplitudes]
        return [LOG_STDS if number in stds else self.shape_bounds for number in range(count)]

    def kernels(self, parameters: Array, rows: Rows) -> Array:
        """Return the kernels ``(C, N, N)`` of all carriers; 0 where the term does not act."""
        kernels = np.zeros((len(rows.angles) if self.of_joints else rows.stated.shape[1], *(rows.time.size,) * 2))
        for _, carriers, kernel in self.carried(parameters, rows):
            kernels[carriers] = kernel
        return kernels

    def derivatives(self, parameters: Array, rows: Rows) -> Iterator[Carried]:
        """Yield the derivatives of the kernels by the parameters, where they are not zero."""
        for number, carriers, kernel in self.carried(parameters, rows):
            yield number, carriers, 2.0 * kernel
            for other, slope in self.slopes(parameters, rows, number, kernel):
                yield other, carriers, slope

    def _at_target(self, parameters: Array, linear: Linearised) -> Array:
        """Return ``(J,)`` standard deviations of the target by each joint, m."""
        return np.exp(parameters[self.amplitudes]) * linear.reach * (linear.rows.moves | self.acts_at_rest)

    def size(self, parameters: Array, linear: Linearised) -> float:
        """Return the root mean square of the error at the target, m."""
        if self.of_joints:
            return float(np.linalg.norm(self._at_target(parameters, linear)))
        return float(math.sqrt(3.0) * np.exp(parameters[0]))

    def warning(self, size: float) -> str:
        """Return a sentence on the error of root mean square ``size`` (m) for a fit that lacks its cause."""
        return (
            f"an error of {1e3 * size:.2g} mm rms ({self.meaning}) has no cause in the model; a trace searches for "
            "it, and standard errors allow for it"
        )

    def variances(self, parameters: Array, linear: Linearised, noise: Array) -> int:
        """Return the number of parameters that describe something: each costs half the logarithm of the rows."""
        if not self.of_joints:
            return len(parameters)
        count = int(np.sum(self._at_target(parameters, linear) > NEGLIGIBLE * noise[0]))
        return count + (count > 0) * (len(parameters) - len(linear.reach))


class JointScatter(CovarianceTerm):
    """Repeatability: a joint's own scatter at each visit, shared by the rows of the visit."""

    name = "scatter"
    meaning = "scatter of the joints from visit to visit"
    part: ClassVar[ErrorPart] = "scatter"
    is_correlated = False

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return scatter of a third of the noise at the target."""
        return [np.asarray(np.log(0.3 * noise[0] / linear.reach))]

    def carried(self, parameters: Array, rows: Rows) -> Iterator[Carried]:
        """Yield the variance where two rows are of one visit."""
        for joint, variance in enumerate(np.exp(2.0 * parameters)):
            yield joint, [joint], variance * rows.same_visit


class PlaceError(CovarianceTerm):
    """Error of the target that the visits of a place share, without regard to other places."""

    name = "place"
    meaning = "error that visits of a pose, or of poses close together, share"
    of_joints = False

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return a third of the noise; none if no place is visited twice."""
        visits = np.unique(np.stack((linear.rows.visit, linear.rows.place)), axis=1)[1]
        return [np.asarray(np.log(0.3 * noise))] if np.unique(visits).size < visits.size else []

    def carried(self, parameters: Array, rows: Rows) -> Iterator[Carried]:
        """Yield the variance of each component where two rows are of one place."""
        for kind, variance in enumerate(np.exp(2.0 * parameters)):
            yield kind, range(3 * kind, 3 * kind + 3), variance * rows.same_place


class JointProfile(CovarianceTerm):
    """Error of each joint over its own angle: a Matern process of smoothness 3/2 on the circle, by its orders.

    The variance of order n falls as (1 + (n / n0)^2)^-2 (Rasmussen and Williams 2006, eq. 4.15), so that an error of
    low order, which carries over to angles without poses, is more likely than one of high order.
    """

    name = "profile"
    meaning = "errors of single joints over their own angle"
    acts_at_rest = False
    amplitudes = slice(0, -1)
    shape_bounds = (math.log(0.5), math.log(60.0))

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return half the noise at the target, falling from order n0 = 6 on."""
        return [np.append(np.log(0.5 * noise[0] / linear.reach), math.log(6.0))]

    def carried(self, parameters: Array, rows: Rows) -> Iterator[Carried]:
        """Yield the process over each joint that moves."""
        share, _ = _shares(parameters[-1])
        for j, waves in rows.waves.items():
            yield j, [j], math.exp(2.0 * parameters[j]) * _by_order(waves, share)

    def slopes(self, parameters: Array, rows: Rows, number: int, kernel: Array) -> Iterator[tuple[int, Array]]:
        """Yield the derivative by log n0."""
        share, slope = _shares(parameters[-1])
        variance = math.exp(2.0 * parameters[number])
        yield len(parameters) - 1, variance * _by_order(rows.waves[number], share * slope)


class SmoothProcess(CovarianceTerm):
    """Error that depends on all joints: a process with one length for each joint (Kennedy and O'Hagan 2001)."""

    name = "smooth"
    meaning = "error that depends on the pose, no cause named"
    amplitudes = slice(0, 1)
    shape_bounds = (math.log(0.3), math.log(30.0))

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return half the noise at the target, with lengths of 3 rad: few poses are closer than that in all joints."""
        lengths = np.full(len(linear.reach), math.log(3.0))
        unit = float(np.mean(linear.reach)) if self.of_joints else 1.0
        return [np.append(math.log(0.5 * noise[0] / unit), lengths)]

    def carried(self, parameters: Array, rows: Rows) -> Iterator[Carried]:
        """Yield the same kernel for every joint, or for x, y and z."""
        distance = np.zeros((rows.time.size,) * 2)
        for j, chord in rows.chords.items():
            distance += chord * math.exp(-2.0 * parameters[1 + j])
        carriers = range(len(rows.angles) if self.of_joints else 3)
        yield 0, carriers, math.exp(2.0 * parameters[0]) * np.exp(-0.5 * distance)

    def slopes(self, parameters: Array, rows: Rows, number: int, kernel: Array) -> Iterator[tuple[int, Array]]:
        """Yield the derivatives by the log lengths."""
        for j, chord in rows.chords.items():
            yield 1 + j, math.exp(-2.0 * parameters[1 + j]) * kernel * chord

    def variances(self, parameters: Array, linear: Linearised, noise: Array) -> int:
        """Return one for the variance and one for the length of each joint that moves."""
        return 1 + int(np.sum(linear.rows.moves))


class Field(SmoothProcess):
    """Error of the target along fixed axes that depends on all joints: of the instrument, or of the ground."""

    name = "field"
    meaning = "error along fixed axes that depends on the pose, no cause named"
    of_joints = False
    shape_bounds = (math.log(0.1), math.log(30.0))


class Wander(CovarianceTerm):
    """Random and slow error of instrument and base over time: an Ornstein-Uhlenbeck process of each component."""

    name = "wander"
    meaning = "error that wanders over time"
    part = "wander"
    of_joints = False
    amplitudes = slice(0, -1)
    shape_bounds = (math.log(0.003), math.log(0.5))  # The time, as a share of the campaign.

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return a third of the noise, over a twentieth of the campaign and over one visit."""
        times = (0.05, 1.0 / np.unique(linear.rows.visit).size)
        return [np.append(np.log(0.3 * noise), math.log(time)) for time in times]

    def carried(self, parameters: Array, rows: Rows) -> Iterator[Carried]:
        """Yield the process of each component."""
        kernel = np.exp(-rows.lags * math.exp(-parameters[-1]))
        for kind, variance in enumerate(np.exp(2.0 * parameters[:-1])):
            yield kind, range(3 * kind, 3 * kind + 3), variance * kernel

    def slopes(self, parameters: Array, rows: Rows, number: int, kernel: Array) -> Iterator[tuple[int, Array]]:
        """Yield the derivative by the log time."""
        yield len(parameters) - 1, kernel * (rows.lags * math.exp(-parameters[-1]))

    def warning(self, size: float) -> str:
        """Return that the errors are correlated in time."""
        return (
            f"the remaining errors are correlated in time: {1e3 * size:.2g} mm rms of them wander slowly, as "
            "where the instrument or the base moved or drifts (a trace tests both); standard errors of coefficients "
            "allow for it"
        )


TERMS: Mapping[str, CovarianceTerm] = {
    term.name: term for term in (JointScatter(), PlaceError(), JointProfile(), Wander(), SmoothProcess(), Field())
}
"""Terms by name."""


def _shares(log_order: float) -> tuple[Array, Array]:
    """Return each order's share ``(K,)`` of a profile's variance, and the derivative of its logarithm by log n0."""
    square = np.square(ORDERS * math.exp(-log_order))
    share = np.square(1.0 / (1.0 + square))
    slope = 4.0 * square / (1.0 + square)
    total = np.sum(share)
    return share / total, slope - np.sum(share * slope) / total


def _by_order(waves: Array, weight: Array) -> Array:
    """Return ``(N, N)`` sum over the orders n of ``weight[n] cos(n (a - b))`` from cosines and sines ``(2 K, N)``."""
    return np.asarray((waves.T * np.concatenate((weight, weight))) @ waves)
