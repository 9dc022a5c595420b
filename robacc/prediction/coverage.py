"""Coverage of a model's bounds: how many measured poses lie within the 95 % bound of their error."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.fitting.apply_fit import absorb_constants, apply_fit
from robacc.fitting.registration import registration_fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals
from robacc.prediction.calibrated import completed
from robacc.prediction.lengths import length_quantiles, principal_variances
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import ModelUncertainty, model_uncertainty
from robacc.prediction.predicting import RADIUS_PROBABILITY
from robacc.prediction.registered_uncertainty import registered_uncertainty
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True)
class Coverage:
    """Measured poses within the bounds of a model's error."""

    quantity: Literal["position", "orientation"]
    probability: float
    """Probability of the bound."""
    n_poses: int
    n_inside: int
    registered: tuple[str, ...]
    """Frames that were fitted to the other half of the poses."""
    noise_source: Literal["given", "file", "fit"]
    """Source of the measurement noise in the bounds: given, columns of the poses, or the fit of the model."""

    @property
    def share(self) -> float:
        """Share of the poses within their bounds."""
        return self.n_inside / self.n_poses


def coverage(
    robot: Robot,
    fit: ModelFit,
    measured: Measurements,
    seed: int,
    aligned: Sequence[str] = (),
    noise: tuple[float | None, float | None] = (None, None),
) -> tuple[Coverage, ...]:
    """Return the coverage of position, and of orientation where poses and fit have it.

    Frames in ``aligned`` are facts of one campaign. They are fitted to every second measured pose for the errors of the
    others, and the other way round, so that no error is one of the fit. The bounds contain the measurement noise:
    ``noise`` (m, rad), else that of the poses, else that of the fit.

    Raises:
        InputError: There are too few commanded poses to fit frames to a half of them.
        MissingColumnError: The poses lack a circumstance that an effect of the model needs, such as the approach.
    """
    # Circumstances drawn in place of missing ones would be held against the measurements.
    Model.of(absorb_constants(robot)).bind(measured)
    data = _with_noise(fit, completed(robot, fit, None, measured, seed), noise)
    oriented = measured.rotation is not None and fit.unexplained.shape[0] == 6
    if aligned:
        error, covariances = _registered(robot, fit, data, aligned)
    else:
        error = _errors(robot, data)
        uncertainty = model_uncertainty(robot, fit, data, measured=True)
        covariances = _noise_added(fit, data, uncertainty)
    quantities: tuple[Literal["position", "orientation"], ...] = ("position", "orientation")
    columns = (measured.sigma_position, measured.sigma_rotation)
    sources = [_noise_source(fit, given, column) for given, column in zip(noise, columns, strict=True)]
    results = []
    for i, (quantity, covariance) in enumerate(zip(quantities, covariances, strict=True)):
        if quantity == "orientation" and not oriented:
            continue
        bound = length_quantiles(RADIUS_PROBABILITY, principal_variances(covariance))
        inside = int(np.count_nonzero(np.linalg.norm(error[3 * i : 3 * i + 3], axis=0) <= bound))
        results.append(Coverage(quantity, RADIUS_PROBABILITY, measured.n, inside, tuple(aligned), sources[i]))
    return tuple(results)


def _errors(robot: Robot, data: Measurements) -> Array:
    return residuals(data, Model.of(absorb_constants(robot)).bind(data).poses(np.zeros(0)))


def _noise_source(fit: ModelFit, given: float | None, column: Array | None) -> Literal["given", "file", "fit"]:
    if not fit.noise_is_separate:
        return "fit"
    return "given" if given is not None else "file" if column is not None else "fit"


def _with_noise(fit: ModelFit, data: Measurements, noise: tuple[float | None, float | None]) -> Measurements:
    """Return the poses with the measurement noise that is given, or that of the fit where neither states it."""
    position, angle = noise
    if position is None and data.sigma_position is None:
        position = fit.noise[0]
    if angle is None and data.sigma_rotation is None:
        angle = fit.noise[1]
    return dataclasses.replace(
        data,
        sigma_position=data.sigma_position if position is None else np.full((3, data.n), position),
        sigma_rotation=data.sigma_rotation if angle is None else np.full(data.n, angle),
    )


def _noise_added(fit: ModelFit, data: Measurements, uncertainty: ModelUncertainty) -> tuple[Array, Array]:
    """Return the covariances of position and orientation, with measurement noise that is not part of them."""
    covariances = []
    known = ((uncertainty.position, data.sigma_position), (uncertainty.orientation, data.sigma_rotation))
    for covariance, noise in known:
        if noise is not None and fit.noise_is_separate:
            covariance = covariance + np.eye(3)[:, :, None] * np.square(noise)
        covariances.append(covariance)
    return covariances[0], covariances[1]


def _registered(
    robot: Robot, fit: ModelFit, data: Measurements, frames: Sequence[str]
) -> tuple[Array, tuple[Array, Array]]:
    """Return errors ``(M, N)`` and their covariances, with frames fitted to the poses of the other half."""
    half: NDArray[np.int64] = data.groups() % 2
    if np.all(half == half[0]):
        fix = "measure at more than one commanded pose, or leave out `align`"
        message = f"{' and '.join(frames)} cannot be fitted to one half of the poses: all are the same commanded pose"
        raise InputError(Problem(message, data.source, fix=fix))
    error = np.empty((3 if data.rotation is None else 6, data.n))
    position, orientation = np.empty((3, 3, data.n)), np.empty((3, 3, data.n))
    for part in (0, 1):
        rows = np.flatnonzero(half == part)
        judged, used = data.subset(rows), data.subset(np.flatnonzero(half != part))
        registration = registration_fit(robot, used, frames)
        error[:, rows] = _errors(apply_fit(registration), judged)
        position[..., rows], orientation[..., rows] = registered_uncertainty(robot, fit, judged, registration, used)
    return error, (position, orientation)
