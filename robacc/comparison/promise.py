"""What a model promises of the targets that it corrected, for the test of the error that remains."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from robacc.comparison.paired_targets import NoiseTreatment, Promise, PromisedNoise
from robacc.comparison.shared_targets import SharedTargets
from robacc.errors import InputError, Problem, UsageError
from robacc.fitting.apply_fit import absorb_constants
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.prediction.calibrated import completed
from robacc.prediction.model_fit import ModelFit, model_fit
from robacc.prediction.model_uncertainty import fitted_jacobian, model_uncertainty
from robacc.quantities import size
from robacc.robots.description import Robot


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
    full_before, full_after = (completed(arm, fit, None, file.data, 0) for file in (before, after))
    predicted = Model.of(arm).bind(full_before).poses(np.zeros(0)).translation
    poses, jacobian, covariance = fitted_jacobian(Model.of(arm, fit.effects), fit, full_after)
    alone = dataclasses.replace(fit, covariance=0.0 * fit.covariance)
    separate = model_uncertainty(arm, alone, full_after, measured=True).position
    noise_used = _noise_used(after.data, fit, noise)
    firsts = after.first_rows
    return Promise(
        before.means(predicted),
        after.means(poses.translation),
        jacobian[:3, :, firsts],
        covariance,
        _with_noise(separate[:, :, firsts], noise_used, after.counts),
        noise_used,
    )


def _noise_used(data: Measurements, fit: ModelFit, noise: str | float | None) -> PromisedNoise:
    """Return the measurement noise along an axis: as given, from the file, else from the fit."""
    treatment: NoiseTreatment = "added" if fit.noise_is_separate else "contained"
    if noise is not None:
        return PromisedNoise(size(noise, "length", "`noise`"), "given", treatment)
    if (stated := data.stated_noise[0]) is not None:
        return PromisedNoise(stated, "file", treatment)
    is_contained = not fit.noise_is_separate and bool(fit.unexplained.any())
    return PromisedNoise(0.0 if is_contained else fit.noise[0], "model", treatment)


def _with_noise(covariance: Array, noise: PromisedNoise, counts: NDArray[np.int64]) -> Array:
    """Return covariances ``(3, 3, T)`` with the noise of means of ``counts`` measurements.

    Where they contain the noise of other measurements, their principal variances are at least this noise.

    Raises:
        UsageError: Neither the noise nor the model leaves a single measurement any error.
    """
    variance = (noise.position**2 / counts)[:, None]
    values, vectors = np.linalg.eigh(np.moveaxis(covariance, 2, 0))
    values = np.maximum(values, 0.0) + variance if noise.treatment == "added" else np.maximum(values, variance)
    if not np.all(values > 0.0):
        raise UsageError("the model has no unexplained error: `noise` must be more than 0")
    total: Array = np.einsum("nik,nk,njk->ijn", vectors, values, vectors)
    return total


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
