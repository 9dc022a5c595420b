"""Covariance of all rows: its terms, its likelihood with gradient, restricted maximum likelihood, and gross errors.

The residuals y of N rows of M components are

    y = X b + e,    b ~ N(0, S),    e ~ N(0, V),    V = D + sum of the terms' F_c K_c F_c',

with D the independent noise. A term adds F_c K_c F_c' for each of its carriers c: F_c are the derivatives by a joint
variable, or unit vectors along a component of the measurement, and K_c is a kernel between rows. Its parameters are
logarithms of standard deviations (rad, m) and of lengths. To add a term: one class here, and its entry in
:data:`TERMS`.

The log marginal likelihood is -(log|V| + log|I + Q'Q| + y'P y) / 2, with Q the whitened columns of X times S^(1/2);
with S broad it is the restricted likelihood (Rasmussen and Williams 2006, section 2.7). Its derivative by a parameter t
is tr((a a' - P) dV/dt) / 2 with a = P y (section 5.4.1), where P is the inverse of V + X S X'.

Inside, vectors of all rows are ordered component by component, so that kernels are added to whole blocks.
"""

from __future__ import annotations

import abc
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar, Literal

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.special import bdtrc

from robacc.effects.campaign import sequence_of
from robacc.fitting.levels import ACCEPTED, NEGLIGIBLE, RESOLUTION, ROUNDS
from robacc.fitting.normal_equations import GAIN, most_likely
from robacc.fitting.visits import first_ranks, places, visit_numbers
from robacc.geometry import Array, NDArray
from robacc.measurements import STILL, Measurements
from robacc.modelling.model import BoundModel, residuals
from robacc.robots.arm import Arm

# Rows of measured poses as the covariance sees them: their visits, joint angles and places in time.

ORDERS = np.arange(1, 41)
"""Orders per turn of a joint's profile; 40 is the highest order that competes as an effect."""
MOST_COMPONENTS = 500
"""Components that the parameters are estimated on: the time grows with their cube."""


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
    """``(N,)`` random rank of each row: the first ranks are a fair part of the rows, in any order."""
    stated: Array
    """``(N, M)`` variance of the noise that the file states, m² and rad²; 0 without."""
    between: Array
    """``(N, M, M)`` covariance of that noise between components, m²; 0 on the diagonals. A gross error adds none."""
    scale: Array
    """``(J,)`` factor of the angles: 1 of a joint that turns, rad/m of a slide."""
    shown: NDArray[np.bool_]
    """``(N, M)`` the components that were measured. Of the others, values and derivatives are 0."""

    @classmethod
    def of(cls, arm: Arm, data: Measurements, draw: NDArray[np.int64]) -> Rows:
        """Return what the covariance needs of measured poses, and random ranks ``draw`` ``(N,)`` of them."""
        assert data.q is not None
        extent = np.ptp(data.q, axis=1)
        moves = extent > STILL
        turns = np.array([arm.is_revolute(name) for name in arm.names])
        scale = np.where(turns, 1.0, np.pi / np.where(moves, extent, 1.0))
        start = np.where(turns, 0.0, data.q.min(axis=1))
        time = sequence_of(data).astype(float)
        stated = np.zeros((data.n, 3 if data.rotation is None else 6))
        between = np.zeros((*stated.shape, stated.shape[1]))
        if data.sigma_position is not None and data.correlated_noise is not None:
            between[:, :3, :3] = np.moveaxis(data.correlated_noise, -1, 0)
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
            draw,
            stated,
            between,
            scale,
            np.ones(stated.shape, dtype=bool) if data.shown is None else data.shown.T,
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
            self.between[index],
            self.scale,
            self.shown[index],
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
    known: Array | float = 0.0
    """``(n, n)`` a further covariance, component by component; only beside terms that act through the joints."""

    @classmethod
    def at(cls, bound: BoundModel, theta: Array, prior_std: Array, rows: Rows, data: Measurements) -> Linearised:
        """Linearise a bound model at coefficients ``theta`` ``(P,)``."""
        count, components = len(bound.terms), rows.stated.shape[1]
        whole = np.concatenate((theta, np.zeros(len(bound.arm.names))))
        poses, jacobian = bound.with_joints.linearise(whole, rows=components)
        columns = np.ascontiguousarray(np.moveaxis(jacobian[:, :count], -1, 0))
        joints = np.ascontiguousarray(np.swapaxes(jacobian[:, count:], 0, 1))
        return cls(rows, residuals(data, poses)[:components].T + columns @ theta, columns, joints, prior_std)

    def subset(self, index: NDArray[np.int64]) -> Linearised:
        """Return some of the rows."""
        return Linearised(
            self.rows.subset(index), self.y[index], self.columns[index], self.joints[:, :, index], self.prior_std
        )

    @cached_property
    def flat(self) -> Array:
        """``(n, P + 1)`` columns times the prior's standard deviations, then ``y``, component by component."""
        return np.asfortranarray(_flat(np.concatenate((self.columns * self.prior_std, self.y[..., None]), axis=2)))

    @cached_property
    def without_columns(self) -> Linearised:
        """Return the same with the columns as a part of the covariance."""
        columns = self.flat[:, :-1]
        none = np.zeros((*self.y.shape, 1))
        return dataclasses.replace(self, columns=none, prior_std=np.ones(1), known=columns @ columns.T)

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
        rows = dataclasses.replace(
            self.rows,
            stated=self.rows.stated[:, :3],
            between=self.rows.between[:, :3, :3],
            shown=self.rows.shown[:, :3],
        )
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
    is_along_axes: ClassVar[bool] = False
    """It moves all rows along the axes of the measuring frame, so that it is none of images, planes and distances."""
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

    def at_target(self, parameters: Array, linear: Linearised) -> Array:
        """Return ``(J,)`` standard deviations of the target by each joint, m."""
        return np.exp(parameters[self.amplitudes]) * linear.reach * (linear.rows.moves | self.acts_at_rest)

    def size(self, parameters: Array, linear: Linearised, left: Array) -> float:
        """Return the root mean square at the target of what a fit leaves of the error, m.

        ``left`` ``(3 N, M, N)`` maps components of the measurements to the position that the fit leaves of them. What
        coefficients describe, such as a smooth error over a small region, is no part of the remaining error.
        """
        carried = np.einsum("amn,jmn->jan", left, linear.joints) if self.of_joints else left.swapaxes(0, 1)
        total = np.sum(carried @ self.kernels(parameters, linear.rows) * carried)
        return float(np.sqrt(total / len(linear.y)))

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
        count = int(np.sum(self.at_target(parameters, linear) > NEGLIGIBLE * noise[0]))
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
    is_along_axes = True
    shape_bounds = (math.log(0.1), math.log(30.0))


class Wander(CovarianceTerm):
    """Random and slow error of instrument and base over time: an Ornstein-Uhlenbeck process of each component."""

    name = "wander"
    meaning = "error that wanders over time"
    part = "wander"
    of_joints = False
    is_along_axes = True
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
            "where the instrument or the base moved or drifts (a trace tests steps, and drift where time_s varies); "
            "standard errors of coefficients allow for it"
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


# The likelihood.


@dataclass(frozen=True, eq=False)
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

    def kinds(self, components: int) -> NDArray[np.int64]:
        """Return ``(M,)`` the number of the standard deviation of each component."""
        return np.minimum(np.arange(components) // (1 if len(self.log_std) > 2 else 3), len(self.log_std) - 1)

    def by_kind(self, values: Array) -> Array:
        """Return the sums of ``values`` ``(N, M)`` over the rows and the components of each standard deviation."""
        return np.bincount(self.kinds(values.shape[1]), weights=values.sum(axis=0)).astype(np.float64)

    @property
    def packed(self) -> Array:
        """All parameters but the factors of the rows."""
        return np.concatenate((self.log_std, *self.terms.values()))

    def unpacked(self, packed: Array) -> CovarianceParameters:
        """Return the same terms with other parameters."""
        sizes = [len(self.log_std), *map(len, self.terms.values())]
        log_std, *values = np.split(packed, np.cumsum(sizes)[:-1])
        return CovarianceParameters(log_std, self.factor, dict(zip(self.terms, values, strict=True)))

    def with_term(self, name: str, parameters: Array) -> CovarianceParameters:
        """Return the noise with one more term."""
        return dataclasses.replace(self, terms={**self.terms, name: parameters})

    def without(self, name: str) -> CovarianceParameters:
        """Return the noise without a term."""
        return dataclasses.replace(self, terms={n: p for n, p in self.terms.items() if n != name})

    def variance(self, stated: Array | float, components: int) -> Array:
        """Return ``(N, M)`` variances of the independent noise beside ``stated`` variances."""
        return np.asarray((stated + np.square(self.std[self.kinds(components)])) * np.square(self.factor)[:, None])

    def independent(self, stated: Array) -> Array:
        """Return ``(N, M)`` standard deviations of the independent noise beside ``stated`` variances."""
        return np.sqrt(self.variance(stated, stated.shape[1]))


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
    factor: Array
    """``(B, n / B, n / B)`` lower factors of V's blocks, or ``(n,)`` its standard deviations where it is diagonal."""
    measured: int
    """Number of the components that were measured."""

    @property
    def coefficients(self) -> Array:
        """Return the posterior mean ``(P,)`` in units of the prior's standard deviations."""
        return np.asarray(solve_triangular(self.triangle, self.reduced, lower=True, trans="T"))

    def apply(self, values: Array) -> Array:
        """Whiten ``(N, M, …)`` to ``(n, …)``."""
        return _divided(_flat(values), self.factor)

    def coloured(self, values: Array) -> Array:
        """Return L'v of values ``(n,)``, L the factor of V."""
        if self.factor.ndim == 1:
            return np.asarray(self.factor * values)
        blocks = values.reshape(len(self.factor), -1, 1)
        return np.asarray((self.factor.swapaxes(1, 2) @ blocks).ravel())

    def weighted_residual(self, components: int, kept: NDArray[np.int64] | None = None) -> Array:
        """Return P y ``(N, M)``, with some of the columns if ``kept`` names them."""
        columns = self.columns if kept is None else self.columns[:, kept]
        system = columns.T @ columns + np.eye(columns.shape[1])
        white = self.y - columns @ np.linalg.solve(system, columns.T @ self.y)
        return by_row(_divided(white, self.factor, "T"), components)


@lru_cache(maxsize=2)
def whitened(noise: CovarianceParameters, linear: Linearised) -> Whitened:
    """Whiten a linearised model; the latest are kept, since fit, evidence and scores ask for the same one.

    Raises:
        numpy.linalg.LinAlgError: The covariance is singular.
    """
    factor: Array = np.sqrt(_independent(noise, linear.rows))
    if noise.terms or linear.rows.between.any():
        factor = _each_block(_lower_factor, covariance(noise, linear))
    white = _divided(linear.flat, factor)
    columns, y = white[:, :-1], white[:, -1]
    triangle: Array = np.asarray(np.linalg.cholesky(columns.T @ columns + np.eye(columns.shape[1])), dtype=np.float64)
    reduced = solve_triangular(triangle, columns.T @ y, lower=True)
    log_likelihood = -0.5 * (_log_det(factor) + _log_det(triangle) + float(y @ y - reduced @ reduced))
    return Whitened(columns, y, triangle, reduced, log_likelihood, factor, int(np.count_nonzero(linear.rows.shown)))


def left_by_fit(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return ``(3 N, M, N)``, which maps components of the measurements to the position that a fit leaves of them."""
    white = whitened(noise, linear)
    gains = np.linalg.solve(white.triangle @ white.triangle.T, _divided(white.columns, white.factor, "T").T)
    return np.asarray(
        (np.eye(gains.shape[1]) - linear.flat[:, :-1] @ gains)[: 3 * len(linear.y)].reshape(-1, *linear.y.shape[::-1])
    )


def _each_block(function: Callable[[Array], Array], blocks: Array) -> Array:
    """Return ``function`` of each block ``(B, n, n)``; equal neighbours, as those of x, y and z often are, share it."""
    is_equal = [np.array_equal(before, block) for before, block in itertools.pairwise(blocks)]
    results = [function(blocks[0])]
    for block, is_known in zip(blocks[1:], is_equal, strict=True):
        results.append(results[-1] if is_known else function(block))
    return np.stack(results) if len(results) > 1 else results[0][None]


def _lower_factor(matrix: Array) -> Array:
    """Return the lower factor of a symmetric matrix, of which it takes the place."""
    factor, is_singular = dpotrf(matrix.T, lower=0, overwrite_a=1)
    if is_singular:
        raise np.linalg.LinAlgError
    return np.asarray(factor.T)


@lru_cache(maxsize=4)
def _lower(size: int) -> NDArray[np.bool_]:
    """Return ``(size, size)`` whether an element is on or below the diagonal."""
    return np.tri(size, dtype=bool)


def _independent(noise: CovarianceParameters, rows: Rows) -> Array:
    """Return ``(n,)`` variances of the independent noise, 1 of what was not measured, so that it counts nothing."""
    return _flat(np.where(rows.shown, noise.variance(rows.stated, rows.stated.shape[1]), 1.0))


def covariance(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return V ``(B, n / B, n / B)``, in blocks of the components where no term acts through the joints."""
    count, components = linear.y.shape
    matrix = np.zeros((components, count, count))
    of_joints = np.zeros((len(linear.joints), count, count)) if linear.rows.between.any() else None
    for name, parameters in noise.terms.items():
        kernels = TERMS[name].kernels(parameters, linear.rows)
        if TERMS[name].of_joints:
            of_joints = kernels if of_joints is None else of_joints + kernels
        else:
            matrix += kernels
    if not linear.rows.shown.all():
        matrix *= linear.rows.shown.T[:, :, None] * linear.rows.shown.T[:, None]
    if of_joints is not None:
        carried = (of_joints.swapaxes(0, 1)[:, :, None] * linear.joints).reshape(count, len(linear.joints), -1)
        whole = np.empty((components, count, components, count))
        for component, block in enumerate(matrix):
            np.matmul(linear.joints[:, component].T[:, None], carried, out=whole[component].reshape(count, 1, -1))
            whole[component, :, component] += block
        whole[:, np.arange(count), :, np.arange(count)] += linear.rows.between
        matrix = whole.reshape(1, components * count, components * count)
        matrix += linear.known
    each = np.arange(matrix.shape[1])
    matrix[:, each, each] += _independent(noise, linear.rows).reshape(len(matrix), -1)
    return matrix


def likelihood_derivatives(
    noise: CovarianceParameters, linear: Linearised, least: float = -math.inf
) -> tuple[float, Array, Array]:
    """Return the log likelihood, its gradient ``(K,)`` by :attr:`CovarianceParameters.packed`, and the information.

    The information ``(K, K)`` is the average of the observed and the expected one, a' dV/dt P dV/du a / 2, a = P y
    (average-information REML; Gilmour, Thompson and Cullis 1995): it costs no more than products with vectors. The
    likelihood of a singular covariance is 0. Of a likelihood that is not above ``least``, the gradient is 0.
    """
    (count, components), size, at = linear.y.shape, noise.packed.size, len(noise.log_std)
    if any(TERMS[name].of_joints for name in noise.terms):
        linear = linear.without_columns
    try:
        white = whitened(noise, linear)
    except np.linalg.LinAlgError:
        return -math.inf, np.zeros(size), np.eye(size)
    if white.log_likelihood <= least:
        return white.log_likelihood, np.zeros(size), np.eye(size)
    own = noise.variance(0.0, components) * linear.rows.shown
    # P = V^-1 - U U', of which P y and U are the columns here, whitened.
    spread = solve_triangular(white.triangle, white.columns.T, lower=True, check_finite=False).T
    beyond = np.column_stack((white.y - spread @ white.reduced, spread))
    if not noise.terms and not linear.rows.between.any():
        share = own / noise.variance(linear.rows.stated, components)
        slope = by_row(np.sum(np.square(beyond), axis=1) - 1.0, components) * share
        return white.log_likelihood, noise.by_kind(slope), np.diag(noise.by_kind(2.0 * np.square(share)))
    beyond = _divided(beyond, white.factor, "T")
    weighted = by_row(beyond[:, 0], components)
    by_joint = np.einsum("jan,na->jn", linear.joints, weighted)
    # Of a a' - P, which is symmetric as the kernels are, the lower triangle counts twice.
    blocks = beyond.reshape(len(white.factor), -1, beyond.shape[1])
    slopes = blocks @ blocks.swapaxes(1, 2)
    slopes -= _each_block(lambda factor: dpotri(factor.T, lower=0)[0].T, white.factor)
    slopes *= _lower(slopes.shape[1])
    each = np.arange(slopes.shape[1])
    slopes[:, each, each] *= 0.5 * _flat(linear.rows.shown.astype(np.float64)).reshape(len(slopes), -1)
    gradient, moved = np.zeros(size), np.zeros((count, components, size))
    gradient[:at] = noise.by_kind(by_row(2.0 * slopes[:, each, each].ravel(), components) * own)
    moved[:, np.arange(components), noise.kinds(components)] = 2.0 * own * weighted
    weights = {False: slopes}
    if len(slopes) == 1:
        whole = slopes.reshape(components, count, components, count)
        carried = np.einsum("anbm,jbm->janm", whole, linear.joints)
        weights = {
            False: whole[np.arange(components), :, np.arange(components)],
            True: np.einsum("jan,janm->jnm", linear.joints, carried),
        }
    for name, parameters in noise.terms.items():
        of_joints = TERMS[name].of_joints
        for number, carriers, slope in TERMS[name].derivatives(parameters, linear.rows):
            gradient[at + number] += sum(np.vdot(weights[of_joints][carrier], slope) for carrier in carriers)
            if of_joints:
                by_carrier = slope @ by_joint[carriers].T
                moved[:, :, at + number] += np.einsum("jan,nj->na", linear.joints[carriers], by_carrier)
            else:
                moved[:, carriers, at + number] += slope @ weighted[:, carriers]
        at += len(parameters)
    white_moved = white.apply(moved * linear.rows.shown[:, :, None])
    along = spread.T @ white_moved
    return white.log_likelihood, gradient, 0.5 * (white_moved.T @ white_moved - along.T @ along)


def unaccounted(noise: CovarianceParameters, linear: Linearised, white: Whitened) -> Array:
    """Return ``(N, M)`` what noise and scatter must account for: y less the posterior mean of all else."""
    weighted = white.weighted_residual(linear.y.shape[1])
    left: Array = np.einsum("nab,nb->na", linear.rows.between, weighted)
    left += noise.variance(linear.rows.stated, linear.y.shape[1]) * weighted
    if "scatter" in noise.terms:
        by_visit = np.einsum("jan,na->jn", linear.joints, weighted) @ linear.rows.same_visit
        left += np.einsum("jan,jn->na", linear.joints, np.exp(2.0 * noise.terms["scatter"])[:, None] * by_visit)
    return left


def covariance_of_rows(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return ``(N, M, M)`` the covariance of each row by scatter of the joints and between components of the noise."""
    moved = linear.joints * np.exp(noise.terms.get("scatter", np.array([-np.inf])))[:, None, None]
    return np.asarray(np.einsum("jan,jbn->nab", moved, moved) + linear.rows.between)


def usual_std(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return the root mean squares of noise and scatter together, m and rad: what a further term starts from."""
    shared = np.einsum("naa->na", covariance_of_rows(noise, linear))
    variance = noise.variance(linear.rows.stated, linear.y.shape[1]) + shared
    mean = np.mean(variance / np.square(noise.factor)[:, None], axis=0)
    return np.asarray(np.sqrt(mean.reshape(-1, 3).mean(axis=1)))


def _flat(a: Array) -> Array:
    """Return ``(N, M, …)`` as ``(n, …)``, component by component."""
    return np.moveaxis(a, 1, 0).reshape((a.shape[0] * a.shape[1], *a.shape[2:]))


def by_row(flat: Array, components: int) -> Array:
    """Return ``(n,)`` as ``(N, M)``."""
    return flat.reshape(components, -1).T


def _divided(flat: Array, factor: Array, trans: Literal["N", "T"] = "N") -> Array:
    """Return ``(n, …)`` solved for blocks' lower triangles, or their transposes, or divided by a diagonal ``(n,)``."""
    if factor.ndim == 1:
        return np.asarray((flat.T / factor).T)
    parts = zip(factor, np.split(flat, len(factor)), strict=True)
    return np.concatenate([solve_triangular(a, b, lower=True, trans=trans, check_finite=False) for a, b in parts])


def _log_det(factor: Array) -> float:
    """Return the log determinant of a matrix from its triangular factor, or from the diagonal of that."""
    diagonal = factor if factor.ndim == 1 else np.diagonal(factor, axis1=-2, axis2=-1)
    return 2.0 * float(np.sum(np.log(diagonal)))


# Restricted maximum likelihood of the covariance's parameters, gross errors, and what the parameters cost.

GROSS_SHARE = 0.01
"""Prior share of rows with a gross error."""
GROSS_FACTORS = np.array([1.0, 6.0, 30.0, 1000.0])
"""Factors on a row's noise: none, a disturbed reading, a wrong one, a broken beam."""
_LOG_SHARES = np.log([1.0 - GROSS_SHARE, *[GROSS_SHARE / 3.0] * 3])
_SIZES = (-3.0, 0.0, 0.7)
"""Log factors on a term's start: that of its score statistics, and those of a lower bound of its gain."""


def estimated(
    noise: CovarianceParameters,
    linear: Linearised,
    *,
    on_all: bool = False,
    least: float = -math.inf,
    gains: float = GAIN,
    off_zero: str = "",
) -> CovarianceParameters:
    """Return the parameters of largest restricted likelihood, with the rows' factors as they are.

    Beside terms, a random part of many rows is used, unless ``on_all``. For ``least`` and ``gains`` see
    :func:`most_likely`. Few rows often leave a variance at zero that is not: standard deviations of the term
    ``off_zero`` have the prior that keeps them about one standard error above it (Chung and others 2013).
    """
    start, part = on_subset(noise, linear) if noise.terms and not on_all else (noise, linear)
    bounds = [(math.log(RESOLUTION), LOG_STDS[1])] * len(noise.log_std)
    # The logarithm of a standard deviation is its log prior: that of a gamma density of shape 2 and no rate.
    log_prior = [0.0] * len(noise.log_std)
    for name, parameters in noise.terms.items():
        bounds += TERMS[name].bounds(len(parameters))
        log_prior += [float(name == off_zero)] * len(parameters)

    def likelihood(packed: Array, best: float) -> tuple[float, Array, Array]:
        known = float(packed @ log_prior)
        found, gradient, information = likelihood_derivatives(start.unpacked(packed), part, best - known)
        return found + known, gradient + log_prior, information

    at, found = most_likely(likelihood, noise.packed, np.array(bounds).T, gains, least)
    return dataclasses.replace(start.unpacked(at), factor=noise.factor) if math.isfinite(found) else noise


def on_subset(noise: CovarianceParameters, linear: Linearised) -> tuple[CovarianceParameters, Linearised]:
    """Return noise and model at the rows of random poses that the parameters are estimated on."""
    index, part = linear.part
    return dataclasses.replace(noise, factor=noise.factor[index]), part


def with_gross_errors(
    noise: CovarianceParameters, linear: Linearised, rounds: int = ROUNDS, gains: float = GAIN
) -> CovarianceParameters:
    """Return the noise estimated again, with the factor of each row that is most probable.

    Rows are judged one by one, so that scatter of a visit may look like a gross error of each of its rows: factors
    that lower the evidence are not taken.
    """
    noise, lacking = estimated(noise, linear, gains=gains), np.count_nonzero(~linear.rows.shown, axis=1)
    for _ in range(rounds):
        usual = noise.independent(linear.rows.stated) / noise.factor[:, None]
        # Along the axes of this covariance over the noise, the components of a row are independent.
        shared, vectors = np.linalg.eigh(covariance_of_rows(noise, linear) / usual[:, :, None] / usual[:, None])
        left = unaccounted(noise, linear, whitened(noise, linear)) / usual
        along = np.square(np.einsum("nab,na->nb", vectors, left))
        variance = np.maximum(shared, 1e-9 - 1.0) + np.square(GROSS_FACTORS)[:, None, None]
        log_posterior = _LOG_SHARES[:, None] - 0.5 * np.sum(np.log(variance) + along / variance, axis=2)
        log_posterior += np.multiply.outer(np.log(GROSS_FACTORS), lacking)
        factor = GROSS_FACTORS[np.argmax(log_posterior, axis=0)]
        if np.array_equal(factor, noise.factor):
            break
        found = estimated(dataclasses.replace(noise, factor=factor), linear, gains=gains)
        if log_evidence(found, linear) <= log_evidence(noise, linear):
            break
        noise = found
    return noise


def too_many_gross_errors(noise: CovarianceParameters) -> bool:
    """Return whether so many rows have gross errors that chance, at their share, is rejected at the accepted odds."""
    gross = int(np.count_nonzero(noise.factor > 1.0))
    return gross > 0 and float(bdtrc(gross - 1, noise.factor.size, GROSS_SHARE)) < math.exp(-ACCEPTED)


def log_evidence(noise: CovarianceParameters, linear: Linearised) -> float:
    """Return the log likelihood with what the terms and the gross errors cost; these cost their prior probability."""
    gross = int(np.count_nonzero(noise.factor > 1.0))
    log_prior = float(gross * _LOG_SHARES[1] + (noise.factor.size - gross) * _LOG_SHARES[0])
    return whitened(noise, linear).log_likelihood + log_prior - _price(noise, linear)


def _price(noise: CovarianceParameters, linear: Linearised) -> float:
    """Return half the log of what shows each parameter (Schwarz 1978), and the odds for acceptance for each term.

    Rows show the noise; visits show the terms, which the rows of a visit share (M. Delattre, M. Lavielle, M.-A.
    Poursat, Electronic Journal of Statistics 8, 2014).
    """
    usual, count = usual_std(noise, linear), 2 * (len(noise.log_std) > 2)
    of_terms = sum(TERMS[name].variances(values, linear, usual) for name, values in noise.terms.items())
    shown = count * math.log(len(linear.y)) + of_terms * math.log(np.unique(linear.rows.visit).size)
    return 0.5 * shown + ACCEPTED * len(noise.terms)


def with_terms_that_gain(
    noise: CovarianceParameters, linear: Linearised, names: Iterable[str] = tuple(TERMS)
) -> CovarianceParameters:
    """Return the noise with the terms ``names`` that gain, added one by one, the best first.

    A term mostly gains less beside more terms, so after one is added the others are estimated again in the order of
    their last gains, until the best is known (accelerated greedy; Minoux 1978). Before the end all are.
    """
    gains = dict.fromkeys((name for name in names if name not in noise.terms), math.inf)
    found: dict[str, CovarianceParameters] = {}
    while gains and gains[name := max(gains, key=lambda name: gains[name])] > GAIN:
        if name in found:
            noise = found.pop(name)
            gains = {other: max(gain, 2.0 * GAIN) for other, gain in gains.items() if other != name}
            found.clear()
        else:
            found[name] = other = with_term_if_worth(noise, linear, name)
            gains[name] = 0.0 if other is noise else log_evidence(other, linear) - log_evidence(noise, linear)
    return without_idle_terms(noise, linear)


def with_term_if_worth(noise: CovarianceParameters, linear: Linearised, name: str) -> CovarianceParameters:
    """Return the noise with a further term, estimated; without it if it is not worth estimating.

    Score statistics and two sizes of it tell, for three evaluations of the likelihood a start; an estimate costs some
    ten of likelihood and gradient, so it is made from a gain of 0.5 on. It is as good as a choice needs.
    """
    most, best = 0.5, None
    for gain, start, small in gains_at_sizes(noise, linear, name):
        _, gradient, information = likelihood_derivatives(*small)
        amplitudes = np.arange(-len(start), 0)[TERMS[name].amplitudes]
        slopes, curvatures = np.maximum(gradient[amplitudes], 0.0), np.diag(information)[amplitudes]
        scores = float(np.sum(np.square(slopes) / (2.0 * np.maximum(curvatures, 1e-300))))
        if max(scores, gain) > most:
            most, best = max(scores, gain), start
    return noise if best is None else with_gross_errors(noise.with_term(name, best), linear, 1, NEGLIGIBLE * ACCEPTED)


def without_idle_terms(noise: CovarianceParameters, linear: Linearised) -> CovarianceParameters:
    """Return the noise without the terms that no longer gain, the worst first.

    A term whose absence costs more, on the rows of the estimates, than all terms do is not idle.
    """
    while noise.terms:
        best = noise
        least = whitened(*on_subset(noise, linear)).log_likelihood - _price(noise, linear)
        for name in noise.terms:
            other = estimated(noise.without(name), linear, least=least, gains=NEGLIGIBLE * ACCEPTED)
            if whitened(*on_subset(other, linear)).log_likelihood > least:
                best = max(best, with_gross_errors(other, linear, 1), key=lambda noise: log_evidence(noise, linear))
        if best is noise:
            break
        noise = best
    return noise


def gains_at_sizes(
    noise: CovarianceParameters, linear: Linearised, name: str
) -> Iterator[tuple[float, Array, tuple[CovarianceParameters, Linearised]]]:
    """Yield the gain of likelihood at two sizes of each start of a term, that start, and a small size of it.

    The gain is no more than the term gains at its best.
    """
    if TERMS[name].is_along_axes and not linear.rows.shown.all():
        return
    noise, part = on_subset(noise, linear)
    for start in TERMS[name].starts(part, usual_std(noise, part)):
        grown = np.zeros_like(start)
        grown[TERMS[name].amplitudes] = 1.0
        small, *sizes = (noise.with_term(name, start + by * grown) for by in _SIZES)
        try:
            gain = max(whitened(size, part).log_likelihood for size in sizes)
            gain -= whitened(noise, part).log_likelihood
        except np.linalg.LinAlgError:
            gain = 0.0
        yield gain, start, (small, part)
