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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.accuracy.error_statistics import Gain, paired_gain
from robacc.accuracy.estimation import ErrorMetrics, pose_metrics
from robacc.errors import Problem, given, refuse
from robacc.fitting.parameters import absorb_constants
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.prediction.model_uncertainty import ModelFit, completed, fitted_jacobian, model_fit, model_uncertainty
from robacc.quantities import size
from robacc.robots.description import Robot
from robacc.statistics.distributions import chi2_sf, student_quantile

_FEWEST = 3
"""Smallest number of shared targets."""
_PROMISED = 0.01
"""Probability below which the remaining error is not what was promised."""

Rows = Sequence[list[int]]
"""Rows of each shared target in a file."""


@dataclass(frozen=True, slots=True)
class PairedTargets:
    """Comparison of the same targets before and after a correction."""

    names: tuple[str, ...]
    before: Array
    """``(3, N)`` mean error before, measuring frame, m."""
    after: Array
    gain: Gain
    loaded: Mapping[str, Any]
    """Regression of the measured on the planned displacements, with the keys of the result."""
    promise: Mapping[str, Any] | None
    """Test of the remaining error against the prediction, with the keys of the result; None without a model."""
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
    first: Measurements,
    second: Measurements,
    nominal: Robot | None = None,
    model: Robot | None = None,
    noise: str | float | None = None,
) -> PairedTargets:
    """Compare the targets that two files have in common.

    Args:
        first: Poses measured before the correction.
        second: Poses measured after it.
        nominal: Robot whose poses are wanted where neither file has commanded poses.
        model: Model of the correction; the files have the commanded joints.
        noise: Standard deviation of the measurement noise along each axis, m or text; None for that of ``second``.

    Raises:
        InputError: The files share fewer than three targets, or the model has no record of its fit.
        UsageError: The files lack wanted poses or joints, or neither the noise nor the model leaves a measurement any
            error.
        MissingColumnError: A file lacks a circumstance that an effect of the model needs, such as the approach.
    """
    names, *rows = _shared_targets(first, second)
    stated = [(file.commanded_position, own) for file, own in zip((first, second), rows, strict=True)]
    if stated[0][0] is stated[1][0] is None:
        lacking = "the files have no wanted poses: add cmd_x, cmd_y, cmd_z, or give `nominal` and joints"
        robot = given(nominal if first.q is not None else None, lacking)
        stated[0] = (predict(dataclasses.replace(robot, effects=()), first).translation, rows[0])
    wanted = next(_means(values, own) for values, own in reversed(stated) if values is not None)
    before, after = (_means(file.position, own) for file, own in zip((first, second), rows, strict=True))
    # Without a model, the best guess of the plan is that the whole error goes.
    note = "without a model, the planned displacement is the error before, measurement noise included"
    planned, promise = wanted - before, None
    if model is not None:
        planned, promise = _against_model(model, (first, second), rows, after, noise)
    return PairedTargets(
        names,
        before - wanted,
        after - wanted,
        paired_gain(before - wanted, after - wanted, np.arange(before.shape[1])),
        _loaded(after - before, planned),
        promise,
        (note,) if model is None else (),
    )


def _shared_targets(first: Measurements, second: Measurements) -> tuple[tuple[str, ...], Rows, Rows]:
    """Return the targets of both files, paired by their ``pose``, or by their order without such a column."""
    apart = f"{first.n} and {second.n} rows without a column pose cannot be paired"
    fix = "add a column pose to both files"
    refuse(
        (
            (first.pose is None) != (second.pose is None),
            Problem("one file has a column pose, the other has none", fix="add it to both files"),
        ),
        (first.pose is None and first.n != second.n, Problem(apart, second.source, fix=fix)),
    )
    before, after = (rows_of_targets(data) for data in (first, second))
    common = [key for key in before if key in after]
    message = f"the files share {len(common)} targets, {_FEWEST} are needed"
    fix = "give the files of the same targets before and after the correction"
    refuse((len(common) < _FEWEST, Problem(message, second.source, fix=fix)))
    return tuple(map(" ".join, common)), [before[key] for key in common], [after[key] for key in common]


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


def _means(values: Array, rows: Rows) -> Array:
    """Return the means ``(K, T)`` of the columns of ``(K, N)`` over the rows of each target."""
    return np.stack([values[:, own].mean(axis=1) for own in rows], axis=1)


def _loaded(measured: Array, planned: Array) -> dict[str, Any]:
    """Return the slope of measured on planned displacements, with an interval from the scatter between targets."""
    power, n = float(np.sum(np.square(planned))), planned.shape[1]
    slope = low = high = math.nan
    verdict = "undecided"
    if power > 0.0:
        slope = float(np.sum(measured * planned)) / power
        scores = np.sum(planned * (measured - slope * planned), axis=0)
        slope_std = math.sqrt(float(np.sum(np.square(scores))) * n / max(n - 1, 1)) / power
        half_width = student_quantile(0.975, n - 1.0) * slope_std if n > 1 else math.inf
        low, high = slope - half_width, slope + half_width
        if low > 0.5:
            verdict = "loaded"
        elif high < (0.5 if low <= 0.0 else 0.9):
            verdict = "not_loaded" if low <= 0.0 else "partly_loaded"
    return {"verdict": verdict, "slope": slope, "lower": low, "upper": high, "planned_rms_m": rms_length(planned)}


# What a model promises of the targets that it corrected, and the test of the error that remains.


def _against_model(
    robot: Robot, files: Sequence[Measurements], rows: Sequence[Rows], measured: Array, noise: str | float | None
) -> tuple[Array, dict[str, Any]]:
    """Return the displacements that the model plans, and the test of the means ``measured`` after the correction."""
    fix = "give a file that `write_model` of a trace or a calibration wrote"
    fit = given(model_fit(robot), Problem("the model has no record of its fit", robot.name, column="fit", fix=fix))
    lacks_joints = any(file.q is None for file in files)
    refuse((lacks_joints, "`model` needs the joints q1, q2, … that were commanded, in both files"))
    arm = absorb_constants(robot)
    for file in files:
        # Circumstances drawn in place of missing ones would be held against the measurements.
        Model.of(arm).bind(file)
    before, after = (completed(fit, file, 0) for file in files)
    planned_from = _means(Model.of(arm).bind(before).poses(np.zeros(0)).translation, rows[0])
    poses, jacobian, covariance = fitted_jacobian(Model.of(arm, fit.effects), fit, after)
    alone = dataclasses.replace(fit, covariance=0.0 * fit.covariance)
    firsts = np.array([own[0] for own in rows[1]])
    separate = model_uncertainty(arm, alone, after, measured=True)[0][0][:, :, firsts]
    used = _noise(fit, noise, files[1].stated_noise[0])
    # Of the means of several measurements. Where the covariances contain the noise of other measurements, their
    # principal variances are at least this noise.
    variance = (used["position_m"] ** 2 / np.array([len(own) for own in rows[1]]))[:, None]
    values, vectors = np.linalg.eigh(np.moveaxis(separate, 2, 0))
    values = np.maximum(values, 0.0) + variance if used["treatment"] == "added" else np.maximum(values, variance)
    refuse((not np.all(values > 0.0), "the model has no unexplained error: `noise` must be more than 0"))
    total = np.asarray(np.einsum("nik,nk,njk->ijn", vectors, values, vectors))
    predicted = _means(poses.translation, rows[1])
    return predicted - planned_from, promise_test(
        measured - predicted, jacobian[:3, :, firsts], covariance, total, used
    )


def _noise(fit: ModelFit, option: str | float | None, stated: float | None) -> dict[str, Any]:
    """Return the measurement noise: given, of the poses after the correction, or of the model's fit."""
    # Noise within the unexplained error of the model is only its lower bound.
    is_in_unexplained = not fit.noise_is_separate and bool(fit.unexplained.any())
    position, source = 0.0 if is_in_unexplained else fit.noise[0], "model"
    if option is not None:
        position, source = size(option, "length", "`noise`"), "given"
    elif stated is not None:
        position, source = stated, "file"
    return {
        "position_m": position,
        "source": source,
        "treatment": "added" if fit.noise_is_separate else "contained",
    }


def promise_test(
    residual: Array, jacobian: Array, covariance: Array, separate: Array, noise: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the normalised square of a residual and its probability, with the keys of the result.

    Args:
        residual: ``(3, N)`` measured less predicted positions, m.
        jacobian: ``(3, P, N)`` of the positions to the model's coefficients.
        covariance: ``(P, P)`` of the coefficients.
        separate: ``(3, 3, N)`` covariance of all that targets do not share, m².
        noise: Measurement noise in it.
    """
    precision = np.moveaxis(np.linalg.inv(np.moveaxis(separate, 2, 0)), 0, 2)
    weighted = np.einsum("ijn,jn->in", precision, residual)
    chi_square, shared = float(np.sum(residual * weighted)), 0.0
    if covariance.size:
        # Woodbury's identity with C = L L^T: coefficients without uncertainty need no inverse.
        values, vectors = np.linalg.eigh(covariance)
        columns = np.einsum("ipn,pk->ikn", jacobian, vectors * np.sqrt(np.maximum(values, 0.0)))
        score = np.einsum("ikn,in->k", columns, weighted)
        information = np.einsum("ikn,ijn,jln->kl", columns, precision, columns, optimize=True)
        chi_square -= float(score @ np.linalg.solve(np.eye(score.size) + information, score))
        shared = float(np.mean(np.sum(np.square(columns), axis=(0, 1))))
    expected = math.sqrt(shared + float(np.mean(np.einsum("iin->n", separate))))
    p_value = chi2_sf(chi_square, float(residual.size))
    return {
        "kept": p_value >= _PROMISED,
        "chi_square": chi_square,
        "degrees_of_freedom": residual.size,
        "p_value": p_value,
        "promised_rms_m": expected,
        "noise": noise,
    }


def noise_doubts(noise: Mapping[str, Any]) -> list[str]:
    """Return a warning where noise is stated that the model's unexplained error may contain."""
    if noise["treatment"] == "added" or noise["source"] == "model":
        return []
    stated = "`noise`" if noise["source"] == "given" else "the noise of `after`"
    return [
        f"the model's unexplained error contains the noise of its own measurements, so {stated} of "
        f"{1e3 * noise['position_m']:.3g} mm is not added; the error counts as this noise at least; to separate the "
        "two, fit the model to poses with columns sigma_x, sigma_y, sigma_z or with several rows in a visit"
    ]
