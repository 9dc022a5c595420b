"""Terms of the covariance beside independent noise: what they mean, their kernels over the rows, and their parameters.

A term adds sum over carriers c of F_c K_c F_c', where F_c are the derivatives by a joint variable, or unit vectors
along a component of the measurement, and K_c is a kernel between rows. Its parameters are logarithms of standard
deviations (rad, m) and of lengths. To add a term: one class here, and its entry in :data:`TERMS`.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np

from robacc.error_model.rows import ORDERS, Linearised, Rows
from robacc.geometry import Array

Part = Literal["noise", "scatter", "pose", "wander"]
"""Noise of the instrument, scatter of the joints, error that depends on the pose, wander over time."""
NEGLIGIBLE = 0.1
"""Share of the noise below which a standard deviation is negligible: it changes a variance by 1 %."""

Kernels = list[Array | None]
"""Kernel ``(N, N)`` of each carrier; None where the term does not act."""


class CovarianceTerm(abc.ABC):
    """One term of the covariance."""

    name: ClassVar[str]
    meaning: ClassVar[str]
    of_joints: ClassVar[bool] = True
    """Whether the carriers are the joints; else the components of the measurement."""
    part: ClassVar[Part] = "pose"
    """Part of the remaining error that it describes."""
    is_correlated: ClassVar[bool] = True
    """Whether it correlates rows of different visits."""

    @abc.abstractmethod
    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return parameters to start from, beside noise of standard deviations ``noise`` (m and rad)."""

    @abc.abstractmethod
    def bounds(self, count: int) -> list[tuple[float, float]]:
        """Return the bounds of ``count`` parameters."""

    def amplitudes(self, count: int) -> slice:
        """Return which of ``count`` parameters are standard deviations."""
        return slice(0, count)

    @abc.abstractmethod
    def kernels(self, parameters: Array, rows: Rows) -> Kernels:
        """Return the kernel of each carrier."""

    @abc.abstractmethod
    def gradient(self, parameters: Array, rows: Rows, weights: list[Array]) -> Array:
        """Return half the sums of the weights ``(N, N)`` of each carrier times the kernel's derivatives."""

    @abc.abstractmethod
    def size(self, parameters: Array, linear: Linearised) -> float:
        """Return the root mean square of the error at the target, m."""

    def warning(self, size: float) -> str:
        """Return a sentence on the error of root mean square ``size`` (m) for a fit that lacks its cause."""
        return (
            f"an error of {1e3 * size:.2g} mm rms ({self.meaning}) has no cause in the model; a trace searches for "
            "it, and standard errors allow for it"
        )

    @abc.abstractmethod
    def variances(self, parameters: Array, linear: Linearised, noise: Array) -> int:
        """Return the number of parameters that describe something: each costs half the logarithm of the rows."""


class JointScatter(CovarianceTerm):
    """Repeatability: a joint's own scatter at each visit, shared by the rows of the visit."""

    name = "scatter"
    meaning = "scatter of the joints from visit to visit"
    part: ClassVar[Part] = "scatter"
    is_correlated = False

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return scatter of a third of the noise at the target."""
        return [np.asarray(np.log(0.3 * noise[0] / linear.reach))]

    def bounds(self, count: int) -> list[tuple[float, float]]:
        """Return 0.1 urad to 0.1 rad."""
        return [_STD] * count

    def kernels(self, parameters: Array, rows: Rows) -> Kernels:
        """Return the variance where two rows are of one visit."""
        return [variance * self._same(rows) for variance in np.exp(2.0 * parameters)]

    def _same(self, rows: Rows) -> Array:
        return rows.same_visit

    def gradient(self, parameters: Array, rows: Rows, weights: list[Array]) -> Array:
        """Return the derivatives by the log standard deviations."""
        same = self._same(rows)
        sums = [float(np.sum(weight * same)) for weight in weights]
        return np.asarray(np.exp(2.0 * parameters) * np.array(sums))

    def size(self, parameters: Array, linear: Linearised) -> float:
        """Return the root of the sum over joints."""
        return float(np.linalg.norm(np.exp(parameters) * linear.reach))

    def variances(self, parameters: Array, linear: Linearised, noise: Array) -> int:
        """Return the number of joints with scatter."""
        return int(np.sum(np.exp(parameters) * linear.reach > NEGLIGIBLE * noise[0]))


class PlaceError(JointScatter):
    """Errors of the joints that the visits of a place share, without regard to other places."""

    name = "place"
    meaning = "errors of the joints that visits of a pose, or of poses close together, share"
    part = "pose"
    is_correlated = True

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return errors of a third of the noise at the target; none if no place is visited twice."""
        visits = np.unique(np.stack((linear.rows.visit, linear.rows.place)), axis=1)[1]
        return super().starts(linear, noise) if np.unique(visits).size < visits.size else []

    def _same(self, rows: Rows) -> Array:
        return rows.same_place


class JointProfile(CovarianceTerm):
    """Error of each joint over its own angle: a Matern process of smoothness 3/2 on the circle, by its orders.

    The variance of order n falls as (1 + (n / n0)^2)^-2 (Rasmussen and Williams 2006, eq. 4.15), so that an error of
    low order, which carries over to angles without poses, is more likely than one of high order.
    """

    name = "profile"
    meaning = "errors of single joints over their own angle"

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return half the noise at the target, falling from order 6 on."""
        return [np.append(np.log(0.5 * noise[0] / linear.reach), math.log(6.0))]

    def bounds(self, count: int) -> list[tuple[float, float]]:
        """Return the bounds of the standard deviations and of the order n0."""
        return [_STD] * (count - 1) + [(math.log(0.5), math.log(60.0))]

    def amplitudes(self, count: int) -> slice:
        """Return all but the order n0."""
        return slice(0, count - 1)

    def kernels(self, parameters: Array, rows: Rows) -> Kernels:
        """Return the process over each joint that moves."""
        share, _ = _shares(parameters[-1])
        return [
            math.exp(2.0 * parameters[j]) * _by_order(rows.waves[j], share) if j in rows.waves else None
            for j in range(len(rows.angles))
        ]

    def gradient(self, parameters: Array, rows: Rows, weights: list[Array]) -> Array:
        """Return the derivatives by the log standard deviations and by log n0."""
        share, slope = _shares(parameters[-1])
        result = np.zeros(len(parameters))
        for j, weight in enumerate(weights):
            if j in rows.waves:
                variance = math.exp(2.0 * parameters[j])
                # The sum over rows of weight times kernel, order by order: it serves both derivatives.
                by_wave = np.sum(rows.waves[j] * (rows.waves[j] @ weight), axis=1)
                by_order = by_wave[: len(share)] + by_wave[len(share) :]
                result[j] = variance * float(share @ by_order)
                result[-1] += 0.5 * variance * float((share * slope) @ by_order)
        return result

    def size(self, parameters: Array, linear: Linearised) -> float:
        """Return the root of the sum over joints that move."""
        return float(np.linalg.norm((np.exp(parameters[:-1]) * linear.reach)[linear.rows.moves]))

    def variances(self, parameters: Array, linear: Linearised, noise: Array) -> int:
        """Return the number of joints with a profile, and one for n0."""
        large = np.exp(parameters[:-1]) * linear.reach > NEGLIGIBLE * noise[0]
        count = int(np.sum(large & linear.rows.moves))
        return count + (count > 0)


class SmoothProcess(CovarianceTerm):
    """Error that depends on all joints: a process with one length for each joint (Kennedy and O'Hagan 2001)."""

    name = "smooth"
    meaning = "error that depends on the pose, no cause named"

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return half the noise at the target, with lengths of 3 rad: few poses are closer than that in all joints."""
        lengths = np.full(len(linear.reach), math.log(3.0))
        return [np.append(math.log(0.5 * noise[0] / float(np.mean(linear.reach))), lengths)]

    def bounds(self, count: int) -> list[tuple[float, float]]:
        """Return the bounds of the standard deviation and of the lengths, rad."""
        return [_STD] + [(math.log(0.3), math.log(30.0))] * (count - 1)

    def amplitudes(self, count: int) -> slice:
        """Return the first."""
        return slice(0, 1)

    def _kernel(self, parameters: Array, rows: Rows) -> Array:
        distance: Array | float = 0.0
        for j, chord in rows.chords.items():
            distance = distance + chord * math.exp(-2.0 * parameters[1 + j])
        kernel: Array = math.exp(2.0 * parameters[0]) * np.exp(-0.5 * np.asarray(distance))
        return kernel

    def kernels(self, parameters: Array, rows: Rows) -> Kernels:
        """Return the same kernel for every joint."""
        return [self._kernel(parameters, rows)] * len(rows.angles)

    def gradient(self, parameters: Array, rows: Rows, weights: list[Array]) -> Array:
        """Return the derivatives by the log standard deviation and the log lengths."""
        weighted = sum(weights) * self._kernel(parameters, rows)
        result = np.zeros(len(parameters))
        result[0] = np.sum(weighted)
        for j, chord in rows.chords.items():
            result[1 + j] = 0.5 * np.sum(weighted * chord) * math.exp(-2.0 * parameters[1 + j])
        return result

    def size(self, parameters: Array, linear: Linearised) -> float:
        """Return the root of the sum over joints."""
        return float(np.exp(parameters[0]) * np.linalg.norm(linear.reach))

    def variances(self, parameters: Array, linear: Linearised, noise: Array) -> int:
        """Return one for the variance and one for the length of each joint that moves."""
        return 1 + int(np.sum(linear.rows.moves))


class Field(SmoothProcess):
    """Error of the target along fixed axes that depends on all joints: of the instrument, or of the ground."""

    name = "field"
    meaning = "error along fixed axes that depends on the pose, no cause named"
    of_joints = False

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return half the noise, with lengths of 3 rad."""
        return [np.append(math.log(0.5 * noise[0]), np.full(len(linear.reach), math.log(3.0)))]

    def kernels(self, parameters: Array, rows: Rows) -> Kernels:
        """Return the same kernel for x, y and z."""
        return [self._kernel(parameters, rows)] * 3 + [None] * (rows.stated.shape[1] - 3)

    def gradient(self, parameters: Array, rows: Rows, weights: list[Array]) -> Array:
        """Return the derivatives of the position's kernels."""
        return super().gradient(parameters, rows, weights[:3])

    def size(self, parameters: Array, linear: Linearised) -> float:
        """Return the length of three components."""
        return float(math.sqrt(3.0) * np.exp(parameters[0]))


class Wander(CovarianceTerm):
    """Random and slow error of instrument and base over time: an Ornstein-Uhlenbeck process of each component."""

    name = "wander"
    meaning = "error that wanders over time"
    part = "wander"
    of_joints = False

    def starts(self, linear: Linearised, noise: Array) -> list[Array]:
        """Return a third of the noise, over a twentieth of the campaign and over one visit."""
        times = (0.05, 1.0 / np.unique(linear.rows.visit).size)
        return [np.append(np.log(0.3 * noise), math.log(time)) for time in times]

    def bounds(self, count: int) -> list[tuple[float, float]]:
        """Return the bounds of the standard deviations and of the time, as a share of the campaign."""
        return [_STD] * (count - 1) + [(math.log(0.003), math.log(0.5))]

    def amplitudes(self, count: int) -> slice:
        """Return all but the time."""
        return slice(0, count - 1)

    def kernels(self, parameters: Array, rows: Rows) -> Kernels:
        """Return the process of each component."""
        kernel = np.exp(-rows.lags * math.exp(-parameters[-1]))
        return [math.exp(2.0 * parameters[a // 3]) * kernel for a in range(rows.stated.shape[1])]

    def gradient(self, parameters: Array, rows: Rows, weights: list[Array]) -> Array:
        """Return the derivatives by the log standard deviations and the log time."""
        rate = math.exp(-parameters[-1])
        kernel = np.exp(-rows.lags * rate)
        result = np.zeros(len(parameters))
        for a, weight in enumerate(weights):
            weighted = math.exp(2.0 * parameters[a // 3]) * weight * kernel
            result[a // 3] += np.sum(weighted)
            result[-1] += 0.5 * rate * np.sum(weighted * rows.lags)
        return result

    def size(self, parameters: Array, linear: Linearised) -> float:
        """Return the length of three components."""
        return float(np.sqrt(3.0) * np.exp(parameters[0]))

    def warning(self, size: float) -> str:
        """Return that the errors are correlated in time."""
        return (
            f"the remaining errors are correlated in time: {1e3 * size:.2g} mm rms of them wander slowly; standard "
            "errors of coefficients allow for it"
        )

    def variances(self, parameters: Array, linear: Linearised, noise: Array) -> int:
        """Return all parameters."""
        return len(parameters)


TERMS: Mapping[str, CovarianceTerm] = {
    term.name: term for term in (JointScatter(), PlaceError(), JointProfile(), Wander(), SmoothProcess(), Field())
}
"""Terms by name."""

_STD = (math.log(1e-8), math.log(0.1))
"""Bounds of a log standard deviation, rad or m: below an instrument's resolution, and larger than any arm's error."""


def _shares(log_order: float) -> tuple[Array, Array]:
    """Return each order's share ``(K,)`` of a profile's variance, and the derivative of its logarithm by log n0."""
    square = np.square(ORDERS * math.exp(-log_order))
    share = np.square(1.0 / (1.0 + square))
    slope = 4.0 * square / (1.0 + square)
    total = np.sum(share)
    return share / total, slope - np.sum(share * slope) / total


def _by_order(waves: Array, weight: Array) -> Array:
    """Return ``(N, N)`` sum over the orders n of ``weight[n] cos(n (a - b))`` from cosines and sines ``(2 K, N)``."""
    kernel: Array = (waves.T * np.concatenate((weight, weight))) @ waves
    return kernel
