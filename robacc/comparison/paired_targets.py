"""Targets that were measured before and after a correction: gain, remaining error, and whether a promise was kept.

With e the measured position less the wanted one, the gain is the fall of its RMS. A target's planned displacement
follows from the model; the measured displacements are regressed on it, and the slope is 1 where the correction was
loaded and 0 where it was not. The remaining error is as promised where its normalised square

    chi^2 = r^T V^-1 r,    V = J C J^T + D,

r the measured less the predicted position, is usual for a chi-square of 3 N degrees of freedom. C is the covariance of
the model's coefficients, which all targets share, D that of repeatability, unexplained error and measurement noise.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import Gain, paired_gain
from robacc.accuracy.estimation import ErrorMetrics, pose_metrics
from robacc.errors import InputError, Problem, UsageError
from robacc.fitting.parameters import absorb_constants
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.prediction.model_uncertainty import completed, fitted_jacobian, model_fit, model_uncertainty
from robacc.quantities import size
from robacc.robots.description import Robot
from robacc.statistics.distributions import chi2_sf, student_quantile

# Targets that two files of measured poses have in common, and the means of their rows.

_FEWEST = 3
"""Smallest number of shared targets."""


@dataclass(frozen=True, slots=True)
class TargetRows:
    """Measured poses of one file, and the rows of each shared target in it."""

    data: Measurements
    rows: tuple[NDArray[np.int64], ...]

    def means(self, values: Array) -> Array:
        """Return the means ``(K, T)`` of the columns of ``(K, N)`` over the rows of each target."""
        return np.stack([values[:, index].mean(axis=1) for index in self.rows], axis=1)


@dataclass(frozen=True, slots=True)
class SharedTargets:
    """T targets measured before and after."""

    names: tuple[str, ...]
    before: TargetRows
    after: TargetRows

    def wanted(self, nominal: Robot | None) -> Array:
        """Return the wanted positions ``(3, T)``, measuring frame, m: of the file after, else before, else nominal.

        Raises:
            UsageError: Neither file has wanted poses, and there is no nominal robot.
        """
        for file in (self.after, self.before):
            if file.data.commanded_position is not None:
                return file.means(file.data.commanded_position)
        before = self.before.data
        if nominal is None or before.q is None:
            raise UsageError("the files have no wanted poses: add cmd_x, cmd_y, cmd_z, or give `nominal` and joints")
        return self.before.means(predict(dataclasses.replace(nominal, effects=()), before).translation)


def shared_targets(first: Measurements, second: Measurements) -> SharedTargets:
    """Return the targets of both files, paired by their ``pose``, or by their order without such a column.

    Raises:
        InputError: The files share fewer than three targets.
    """
    if (first.pose is None) != (second.pose is None):
        raise InputError(Problem("one file has a column pose, the other has none", fix="add it to both files"))
    if first.pose is None and first.n != second.n:
        message = f"{first.n} and {second.n} rows without a column pose cannot be paired"
        raise InputError(Problem(message, second.source, fix="add a column pose to both files"))
    rows_of = [rows_of_targets(data) for data in (first, second)]
    common = [key for key in rows_of[0] if key in rows_of[1]]
    if len(common) < _FEWEST:
        fix = "give the files of the same targets before and after the correction"
        raise InputError(
            Problem(f"the files share {len(common)} targets, {_FEWEST} are needed", second.source, fix=fix)
        )
    before, after = (
        TargetRows(data, tuple(np.array(rows[key]) for key in common))
        for data, rows in zip((first, second), rows_of, strict=True)
    )
    return SharedTargets(tuple(" ".join(key) for key in common), before, after)


def rows_of_targets(data: Measurements) -> dict[tuple[str, ...], list[int]]:
    """Return the rows of each target by its name: its pose, and the measured target if the file has that column.

    Without a column pose, each row is a target, named by its number.
    """
    poses = np.arange(1, data.n + 1) if data.pose is None else data.pose
    columns = (poses,) if data.target is None or data.pose is None else (poses, data.target)
    rows: dict[tuple[str, ...], list[int]] = {}
    for i, key in enumerate(zip(*(map(str, column) for column in columns), strict=True)):
        rows.setdefault(key, []).append(i)
    return rows


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
    note = "without a model, the planned displacement is the error before, measurement noise included"
    return PairedTargets(
        names,
        error_before,
        error_after,
        paired_gain(error_before, error_after, np.arange(before.shape[1])),
        _loaded(after - before, planned),
        None if promise is None else _promise_test(after - promise.after, promise),
        (note,) if promise is None else (),
    )


def _loaded(measured: Array, planned: Array) -> LoadedTest:
    """Return the slope of measured on planned displacements, with an interval from the scatter between targets."""
    power = float(np.sum(np.square(planned)))
    if power == 0.0:
        return LoadedTest("undecided", math.nan, math.nan, math.nan, 0.0)
    slope, n = float(np.sum(measured * planned)) / power, planned.shape[1]
    scores = np.sum(planned * (measured - slope * planned), axis=0)
    slope_std = math.sqrt(float(np.sum(np.square(scores))) * n / max(n - 1, 1)) / power
    half_width = student_quantile(0.975, n - 1.0) * slope_std if n > 1 else math.inf
    low, high = slope - half_width, slope + half_width
    verdict: Loaded = "loaded" if low > 0.5 else "undecided"
    if low <= 0.5 and high < (0.5 if low <= 0.0 else 0.9):
        verdict = "not loaded" if low <= 0.0 else "partly loaded"
    return LoadedTest(verdict, slope, low, high, rms_length(planned))


def _promise_test(residual: Array, promise: Promise) -> PromiseTest:
    """Return the normalised square of the residual ``(3, N)`` and its probability."""
    precision = np.moveaxis(np.linalg.inv(np.moveaxis(promise.separate, 2, 0)), 0, 2)
    weighted = np.einsum("ijn,jn->in", precision, residual)
    chi_square, shared = float(np.sum(residual * weighted)), 0.0
    if promise.covariance.size:
        # Woodbury's identity with C = L L^T: coefficients without uncertainty need no inverse.
        values, vectors = np.linalg.eigh(promise.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        columns = np.einsum("ipn,pk->ikn", promise.jacobian, root)
        score = np.einsum("ikn,in->k", columns, weighted)
        information = np.einsum("ikn,ijn,jln->kl", columns, precision, columns, optimize=True)
        chi_square -= float(score @ np.linalg.solve(np.eye(score.size) + information, score))
        shared = float(np.mean(np.sum(np.square(columns), axis=(0, 1))))
    expected = math.sqrt(shared + float(np.mean(np.einsum("iin->n", promise.separate))))
    p_value = chi2_sf(chi_square, float(residual.size))
    return PromiseTest(chi_square, residual.size, p_value, expected, promise.noise)


# What a model promises of the targets that it corrected, for the test of the error that remains.


def promise_of(robot: Robot, targets: SharedTargets, noise: str | float | None) -> Promise:
    """Return what the model predicts at the commands of both files.

    Args:
        robot: Robot with the model of the correction.
        targets: The targets, with the commanded joints of both files.
        noise: Standard deviation of the measurement noise along each axis, m or text; None for that of the file after.

    Raises:
        UsageError: The files have no joints, or neither the noise nor the model leaves a measurement any error.
        InputError: The model has no record of its fit.
        MissingColumnError: A file lacks a circumstance that an effect of the model needs, such as the approach.
    """
    fit = model_fit(robot)
    if fit is None:
        fix = "give a file that `write_model` of a trace or a calibration wrote"
        raise InputError(Problem("the model has no record of its fit", robot.name, column="fit", fix=fix))
    before, after = targets.before, targets.after
    if before.data.q is None or after.data.q is None:
        raise UsageError("`model` needs the joints q1, q2, … that were commanded, in both files")
    arm = absorb_constants(robot)
    for file in (before, after):
        # Circumstances drawn in place of missing ones would be held against the measurements.
        Model.of(arm).bind(file.data)
    full_before, full_after = (completed(fit, file.data, 0) for file in (before, after))
    predicted = Model.of(arm).bind(full_before).poses(np.zeros(0)).translation
    poses, jacobian, covariance = fitted_jacobian(Model.of(arm, fit.effects), fit, full_after)
    alone = dataclasses.replace(fit, covariance=0.0 * fit.covariance)
    firsts = np.array([index[0] for index in after.rows])
    separate = model_uncertainty(arm, alone, full_after, measured=True)[0][0][:, :, firsts]
    treatment: NoiseTreatment = "added" if fit.noise_is_separate else "contained"
    is_in_unexplained = not fit.noise_is_separate and bool(fit.unexplained.any())
    used = PromisedNoise(0.0 if is_in_unexplained else fit.noise[0], "model", treatment)
    if noise is not None:
        used = PromisedNoise(size(noise, "length", "`noise`"), "given", treatment)
    elif (stated := after.data.stated_noise[0]) is not None:
        used = PromisedNoise(stated, "file", treatment)
    # Of the means of several measurements. Where the covariances contain the noise of other measurements, their
    # principal variances are at least this noise.
    variance = (used.position**2 / np.array([index.size for index in after.rows]))[:, None]
    values, vectors = np.linalg.eigh(np.moveaxis(separate, 2, 0))
    values = np.maximum(values, 0.0) + variance if treatment == "added" else np.maximum(values, variance)
    if not np.all(values > 0.0):
        raise UsageError("the model has no unexplained error: `noise` must be more than 0")
    total = np.asarray(np.einsum("nik,nk,njk->ijn", vectors, values, vectors))
    means = before.means(predicted), after.means(poses.translation)
    return Promise(*means, jacobian[:3, :, firsts], covariance, total, used)


def noise_doubts(noise: PromisedNoise) -> list[str]:
    """Return a warning where noise is stated that the model's unexplained error may contain."""
    if noise.treatment == "added" or noise.source == "model":
        return []
    stated = "`noise`" if noise.source == "given" else "the noise of `after`"
    return [
        f"the model's unexplained error contains the noise of its own measurements, so {stated} of "
        f"{1e3 * noise.position:.3g} mm is not added; the error counts as this noise at least; to separate the two, "
        "fit the model to poses with columns sigma_x, sigma_y, sigma_z or with several rows in a visit"
    ]
