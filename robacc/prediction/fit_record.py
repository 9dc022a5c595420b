"""Record of a fit for its model file, from the fit and its held-out residuals."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from robacc.chain import BLOCK
from robacc.error_model.structure import Repeatability
from robacc.fitting.fit_result import Fit
from robacc.fitting.parameters import absorb_constants
from robacc.fitting.visits import random_rows
from robacc.geometry import Array, log_between, rotate_back
from robacc.measurements import Measurements, different
from robacc.modelling.model import Model, predict
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.model_uncertainty import ModelUncertainty, model_uncertainty
from robacc.robots.description import Robot
from robacc.statistics.lengths import length_quantiles, principal_variances

_PROBABILITY = 0.95
_DOUBT = 2.6
"""Standard deviations by which the number of poses outside their bound may differ from 5 % by chance (p = 0.01)."""
_GROSS = 11.34
"""Square of a residual over its covariance that 99 % of Gaussian residuals along three axes do not exceed."""
_ROUNDS = 20
_FACTOR_ROUNDS = 4
"""Updates of a factor: its bounds contain the noise, which it does not multiply."""
_LEAST_SURPLUS = 0.2
"""Least surplus of measured values over coefficients without a group, as a share of all values."""
_MANY = 200
"""Held-out poses from which the factor is always computed: the share that it puts inside is exact to 1.5 %."""
_MOST_ROWS = 20_000
"""Poses that the unexplained error and the factor are taken from: they know a 95 % bound to 0.3 %."""
_FEWEST = 20
"""Smallest number of held-out poses from which a factor of the bounds is taken."""


def fit_record(
    fit: Fit,
    robot: Robot,
    nominal: Robot,
    data: Measurements,
    held_out: tuple[Measurements, Array] | None,
    repeatability: Repeatability | None,
    n_folds: int = 0,
) -> ModelFit:
    """Return the record of a fit.

    Args:
        fit: The final fit.
        robot: The fitted robot.
        nominal: The robot that the fit started from.
        data: Poses of the fit.
        held_out: Poses that were held out and their residuals ``(M, N)``; None without any.
        repeatability: Scatter of the joints, if it is significant.
        n_folds: Number of groups that are held out in turn, if ``held_out`` are the poses ``data``; else 0.
    """
    columns = fit.identifiability.columns
    finite = np.all(np.isfinite(fit.covariance[np.ix_(columns, columns)]), axis=1)
    known = columns[finite]
    stds = {} if repeatability is None else {name: std for name, std in repeatability.joints if std is not None}
    record = ModelFit(
        effects=fit.model.free,
        coefficients=tuple(fit.names[i] for i in known),
        covariance=fit.covariance[np.ix_(known, known)],
        nominal=_changed_numbers(robot, nominal),
        repeatability=stds,
        unexplained=np.zeros((fit.residual.shape[0],) * 2),
        noise=(fit.noise.position, fit.noise.orientation),
        noise_is_separate=False,
        bound_factor=(1.0, 1.0),
        largest_correction=_largest_correction(robot, nominal, data),
        ranges=_ranges(robot, data),
        n_poses=data.n,
    )
    residual, poses, sign = fit.residual[:, fit.inliers], data.subset(fit.inliers), 1.0
    if held_out is not None:
        finite = np.all(np.isfinite(held_out[1]), axis=0)
        if held_out[0] is data:
            finite &= fit.inliers
        residual, poses, sign = held_out[1][:, finite], held_out[0].subset(finite), -1.0
    # Held-out residuals have the errors of fits to fewer poses.
    inflation = _inflation(fit, data, n_folds) if held_out is not None and held_out[0] is data else 1.0
    compared = dataclasses.replace(record, covariance=inflation * record.covariance)
    noise = _noise_variances(poses, fit, repeatability)
    judged = random_rows(poses, _MOST_ROWS)
    residual, poses = residual[:, judged], poses.subset(judged)
    # A residual of the fit's own poses lacks the error of the coefficients, a held-out residual contains it.
    unexplained = _unexplained(residual, model_uncertainty(robot, compared, poses, measured=True), sign, noise)
    record = dataclasses.replace(record, unexplained=unexplained, noise_is_separate=noise[0] > 0.0)
    if record.noise_is_separate:
        angle = math.sqrt(noise[1]) if noise[1] > 0.0 else fit.noise.orientation
        record = dataclasses.replace(record, noise=(math.sqrt(noise[0]), angle))
    if held_out is None or poses.n < _FEWEST:
        return record
    compared = dataclasses.replace(compared, unexplained=unexplained)
    factors = _bound_factors(residual, model_uncertainty(robot, compared, poses, measured=True), noise)
    return dataclasses.replace(record, bound_factor=factors)


def _inflation(fit: Fit, data: Measurements, n_folds: int) -> float:
    """Return the mean variance of predictions of held-out poses over that of predictions by the fit to all poses.

    With p coefficients, n measured values and the share s = 1 - 1/K of them in the fit without a group, random poses
    are predicted with p / (s n - p) of the noise variance, and poses of the fit with p / n (for random regressors,
    L. Breiman and D. Freedman, JASA 78, 1983). Repeats of a pose are in the same group and count once.
    """
    if n_folds < 2:
        return 1.0
    share = 1.0 - 1.0 / n_folds
    rows = fit.residual.shape[0]
    coefficients = np.count_nonzero(fit.inliers) * rows - fit.degrees_of_freedom
    visited = data.groups()[fit.inliers]
    if data.target is not None:
        targets = np.unique(data.target[fit.inliers], return_inverse=True)[1]
        visited = np.unique(np.stack((visited, targets)), axis=1, return_inverse=True)[1].ravel()
    effective = float(coefficients) / (different(visited) * rows)
    return float(1.0 / max(share - effective, _LEAST_SURPLUS))


def nominal_robot(robot: Robot, record: ModelFit | None) -> Robot:
    """Return the robot that a model was fitted from, in the model's frames and without effects.

    Without a record, its joints keep the fitted numbers, but for the constants.
    """
    robot = absorb_constants(robot)
    before = {} if record is None else record.nominal
    joints = tuple(
        dataclasses.replace(joint, parameters={**joint.parameters, **before.get(joint.name, {})})
        for joint in robot.joints
    )
    return dataclasses.replace(robot, joints=joints, effects=())


def _changed_numbers(robot: Robot, nominal: Robot) -> dict[str, dict[str, float]]:
    """Return the numbers of the nominal robot's joints that differ from those of the fitted robot."""
    changed: dict[str, dict[str, float]] = {}
    for fitted, before in zip(absorb_constants(robot).joints, nominal.joints, strict=True):
        for name in sorted({*fitted.parameters, *before.parameters}):
            number = before.parameters.get(name, 0.0)
            if number != fitted.parameters.get(name, 0.0):
                changed.setdefault(before.name, {})[name] = float(number)
    return changed


def _largest_correction(robot: Robot, nominal: Robot, data: Measurements) -> tuple[float, float]:
    """Return the largest difference of the model from the nominal robot in the model's frames, m and rad."""
    robot = absorb_constants(robot)
    rigid = dataclasses.replace(
        nominal, base=robot.base, tool=robot.tool, targets=robot.targets, effects=(), effect_units=(1.0, 1.0)
    )
    full = Model.of(robot)
    arm_only = dataclasses.replace(full, known=tuple(k for k in full.known if not k.effect.traits.is_of_measurement))
    largest = np.zeros(2)
    for start in range(0, data.n, BLOCK):
        part = data.subset(slice(start, start + BLOCK))
        real, wanted = arm_only.bind(part).poses(np.zeros(0)), predict(rigid, part)
        moved = real.translation - wanted.translation, log_between(real.rotation, wanted.rotation)
        largest = np.maximum(largest, [np.max(np.linalg.norm(vectors, axis=0)) for vectors in moved])
    return float(largest[0]), float(largest[1])


def _ranges(robot: Robot, data: Measurements) -> dict[str, tuple[float, float]]:
    """Return the lowest and the highest value of each joint and of each circumstance."""
    assert data.q is not None
    columns: dict[str, Array | None] = dict(zip(robot.variable_names, data.q, strict=True))
    columns |= {"payload_kg": data.payload, "temperature_c": data.temperature, "time_s": data.time}
    return {
        name: (float(np.min(values)), float(np.max(values))) for name, values in columns.items() if values is not None
    }


def _noise_variances(data: Measurements, fit: Fit, repeatability: Repeatability | None) -> tuple[float, float]:
    """Return the variances of the measurement noise that is known apart from the arm's errors, m² and rad².

    They come from the uncertainties in the file, or from visits with several rows that separate noise and scatter.
    Repeats alone hold both, so all of it counts as the arm's.
    """
    if data.sigma_position is not None:
        angle = 0.0 if data.sigma_rotation is None else float(np.mean(np.square(data.sigma_rotation)))
        return float(np.mean(np.square(data.sigma_position))), angle
    if repeatability is not None and repeatability.source != "residual":
        return fit.misfit[0] ** 2, fit.misfit[1] ** 2
    return 0.0, 0.0


def _unexplained(residual: Array, uncertainty: ModelUncertainty, sign: float, noise: tuple[float, float]) -> Array:
    """Return the covariance ``(M, M)`` of the residual beyond the known sources, in the target's frame.

    Where position or orientation shows no more than the known sources, its part is zero.
    """
    rows, n = residual.shape
    remaining = _scatter(
        np.concatenate([rotate_back(uncertainty.rotation, residual[i : i + 3]) for i in range(0, rows, 3)])
    )
    local = uncertainty.in_target_frame()
    parts = (local.position, local.orientation)[: rows // 3]
    for i, (part, variance, shares) in enumerate(zip(parts, noise, uncertainty.shares.T, strict=False)):
        block = slice(3 * i, 3 * i + 3)
        # The first share is that of the coefficients, the second that of the scatter of the joints.
        known = shares[0] + shares[1]
        scale = (sign * -1.0 * shares[0] + shares[1]) / known if known > 0 else 0.0
        explained = variance * np.eye(3) + scale * np.mean(part, axis=2)
        remaining[block, block] -= explained
        chance = 2.0 * math.sqrt(2.0 / (3.0 * n)) * max(float(np.trace(explained)), 0.0)
        if float(np.trace(remaining[block, block])) <= chance:
            remaining[block, :] = remaining[:, block] = 0.0
    return _positive(remaining)


def _scatter(residual: Array) -> Array:
    """Return the second moments ``(M, M)`` of residuals ``(M, N)``; a gross row counts as one at 99 % of a Gaussian.

    A bound of 95 % of the errors must not grow with the size of the worst one. Source: P. J. Huber, Robust Statistics
    (1981), chapter 8; the limit takes 0.5 % from the variance of Gaussian residuals.
    """
    rows, n = residual.shape
    weight = np.ones(n)
    for _ in range(_ROUNDS):
        total = (residual * weight) @ residual.T / n
        square = np.zeros(n)
        for i in range(0, rows, 3):
            part = residual[i : i + 3]
            spread = total[i : i + 3, i : i + 3] + 1e-12 * np.trace(total[i : i + 3, i : i + 3]) * np.eye(3) / 3.0
            if np.trace(spread) > 0.0:
                square = np.maximum(square, np.einsum("in,in->n", part, np.linalg.solve(spread, part)))
        weight = np.minimum(1.0, _GROSS / np.maximum(square, _GROSS))
    result: Array = (residual * weight) @ residual.T / n
    return result


def _positive(matrix: Array) -> Array:
    """Return the nearest positive semidefinite matrix, each block of three scaled to its own size first."""
    scale = np.repeat([math.sqrt(max(float(np.trace(matrix[i : i + 3, i : i + 3])), 0.0)) or 1.0
                       for i in range(0, matrix.shape[0], 3)], 3)  # fmt: skip
    values, vectors = np.linalg.eigh(matrix / scale[:, None] / scale)
    result: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T * scale[:, None] * scale
    return result


def _bound_factors(residual: Array, uncertainty: ModelUncertainty, noise: tuple[float, float]) -> tuple[float, float]:
    """Return the factors that put 95 % of the held-out residuals within their bounds; 1 where they do by chance.

    A factor multiplies the model's standard deviations, not those of the measurement noise.
    """
    factors = [1.0, 1.0]
    parts = (uncertainty.position, uncertainty.orientation)
    for i, (covariance, variance) in enumerate(zip(parts[: residual.shape[0] // 3], noise, strict=False)):
        length = np.linalg.norm(residual[3 * i : 3 * i + 3], axis=0)
        for _ in range(_FACTOR_ROUNDS):
            total = factors[i] ** 2 * covariance + variance * np.eye(3)[:, :, None]
            radius = length_quantiles(_PROBABILITY, principal_variances(total))
            ratio = np.sort(length[radius > 0] / radius[radius > 0])
            n = ratio.size
            chance = math.sqrt(_PROBABILITY * (1.0 - _PROBABILITY) / max(n, 1))
            surplus = abs(np.count_nonzero(ratio > 1.0) / max(n, 1) - (1.0 - _PROBABILITY))
            if n < _FEWEST or (n < _MANY and surplus <= _DOUBT * chance):
                break
            factors[i] *= float(ratio[min(math.ceil((n + 1) * _PROBABILITY), n) - 1])
    return factors[0], factors[1]
