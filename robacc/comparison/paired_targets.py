"""Targets that were measured before and after a correction: gain, remaining error, and whether the promise holds.

With e the measured position less the wanted one, the gain is the fall of its RMS. A target's planned displacement
follows from the model; the measured displacements are regressed on it, and the slope is 1 where the correction was
loaded and 0 where it was not. The remaining error is as promised where its normalised square

    chi^2 = r^T V^-1 r,    V = J C J^T + D,

r the measured less the predicted position, is usual for a chi-square of 3 N degrees of freedom. C is the covariance of
the model's coefficients, which all targets share, D that of repeatability, unexplained error and measurement noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.accuracy.metrics import ErrorMetrics, pose_metrics
from robacc.accuracy.stages import Gain, paired_gain
from robacc.geometry import Array, rms_length
from robacc.statistics.distributions import chi2_sf, student_quantile

Loaded = Literal["loaded", "partly loaded", "not loaded", "undecided"]

NoiseSource = Literal["given", "file", "model"]
NoiseTreatment = Literal["added", "contained"]

_PROMISED = 0.01
"""Probability below which the remaining error is not what was promised."""


@dataclass(frozen=True, slots=True)
class PromisedNoise:
    """Measurement noise in the test of the promise."""

    position: float
    """Standard deviation along each axis, m."""
    source: NoiseSource
    """``given``, from the poses after the correction, or from the model's fit."""
    treatment: NoiseTreatment
    """``added`` to the unexplained error of the model, or ``contained`` in it: then it is only its lower bound."""


@dataclass(frozen=True, slots=True)
class Promise:
    """Predicted positions of the model at the commands before and after, and the uncertainty after."""

    before: Array
    """``(3, N)`` predicted position, measuring frame, m."""
    after: Array
    jacobian: Array
    """``(3, P, N)`` of the positions after to the model's coefficients."""
    covariance: Array
    """``(P, P)`` of the coefficients."""
    separate: Array
    """``(3, 3, N)`` covariance of all that targets do not share, m²."""
    noise: PromisedNoise


@dataclass(frozen=True, slots=True)
class LoadedTest:
    """Regression of the measured on the planned displacements."""

    verdict: Loaded
    slope: float
    """1 where the correction was loaded, 0 where it was not."""
    low: float
    high: float
    planned_rms: float
    """RMS of the planned displacements, m."""


@dataclass(frozen=True, slots=True)
class PromiseTest:
    """Test of the remaining error against the prediction."""

    chi_square: float
    degrees_of_freedom: int
    p_value: float
    promised_rms: float
    """Expected RMS of the remaining error, measurement noise included, m."""
    noise: PromisedNoise

    @property
    def kept(self) -> bool:
        """Whether the remaining error is what was promised."""
        return self.p_value >= _PROMISED


@dataclass(frozen=True, slots=True)
class PairedTargets:
    """Comparison of the same targets before and after a correction."""

    names: tuple[str, ...]
    before: Array
    """``(3, N)`` mean error before, measuring frame, m."""
    after: Array
    gain: Gain
    loaded: LoadedTest
    promise: PromiseTest | None
    """None without a model."""
    notes: tuple[str, ...]

    @property
    def metrics_before(self) -> ErrorMetrics:
        """Metrics of the error before, m."""
        return pose_metrics(self.before).position

    @property
    def metrics_after(self) -> ErrorMetrics:
        """Metrics of the error after, m."""
        return pose_metrics(self.after).position


def paired_targets(
    names: tuple[str, ...], before: Array, after: Array, wanted: Array, promise: Promise | None
) -> PairedTargets:
    """Compare measured positions ``(3, N)`` of the same targets before and after, m.

    Args:
        names: Names of the targets.
        before: Mean measured positions before.
        after: Mean measured positions after.
        wanted: Wanted positions.
        promise: Prediction of the model; None without a model.
    """
    error_before, error_after = before - wanted, after - wanted
    # Without a model, the best guess of the plan is that the whole error goes.
    planned = -error_before if promise is None else promise.after - promise.before
    notes = []
    if promise is None:
        notes.append("without a model, the planned displacement is the error before, measurement noise included")
    return PairedTargets(
        names,
        error_before,
        error_after,
        paired_gain(error_before, error_after, np.arange(before.shape[1])),
        _loaded(after - before, planned),
        None if promise is None else _promise_test(after - promise.after, promise),
        tuple(notes),
    )


def _loaded(measured: Array, planned: Array) -> LoadedTest:
    """Return the slope of measured on planned displacements, with an interval from the scatter between targets."""
    power = float(np.sum(np.square(planned)))
    if power == 0.0:
        return LoadedTest("undecided", math.nan, math.nan, math.nan, 0.0)
    slope = float(np.sum(measured * planned)) / power
    scores = np.sum(planned * (measured - slope * planned), axis=0)
    n = planned.shape[1]
    slope_std = math.sqrt(float(np.sum(np.square(scores))) * n / max(n - 1, 1)) / power
    half_width = student_quantile(0.975, n - 1.0) * slope_std if n > 1 else math.inf
    low, high = slope - half_width, slope + half_width
    verdict: Loaded
    if low > 0.5:
        verdict = "loaded"
    elif low <= 0.0:
        verdict = "not loaded" if high < 0.5 else "undecided"
    else:
        verdict = "partly loaded" if high < 0.9 else "undecided"
    return LoadedTest(verdict, slope, low, high, rms_length(planned))


def _promise_test(residual: Array, promise: Promise) -> PromiseTest:
    """Return the normalised square of the residual ``(3, N)`` and its probability."""
    precision = np.moveaxis(np.linalg.inv(np.moveaxis(promise.separate, 2, 0)), 0, 2)
    weighted = np.einsum("ijn,jn->in", precision, residual)
    chi_square = float(np.sum(residual * weighted))
    if promise.covariance.size:
        # Woodbury's identity with C = L L^T: coefficients without uncertainty need no inverse.
        values, vectors = np.linalg.eigh(promise.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        columns = np.einsum("ipn,pk->ikn", promise.jacobian, root)
        score = np.einsum("ikn,in->k", columns, weighted)
        information = np.einsum("ikn,ijn,jln->kl", columns, precision, columns, optimize=True)
        chi_square -= float(score @ np.linalg.solve(np.eye(score.size) + information, score))
        shared = float(np.mean(np.sum(np.square(columns), axis=(0, 1))))
    else:
        shared = 0.0
    dof = residual.size
    expected = math.sqrt(shared + float(np.mean(np.einsum("iin->n", promise.separate))))
    return PromiseTest(chi_square, dof, chi2_sf(chi_square, float(dof)), expected, promise.noise)
