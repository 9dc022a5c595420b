"""Uncertainty of a fitted model at given poses, its coverage of measured poses, and the accuracy it predicts.

The error of the calibrated arm against its model has the covariance

    V = J C J^T + J_q S J_q^T + R U R^T + X,

a sum of outer products of columns, with J the Jacobian of the pose to the fitted coefficients and C their covariance,
J_q that to the joints and S the variances of their scatter, U the covariance of the unexplained error in the target's
frame and R its orientation. X is what effects add beyond the ranges that they were fitted on
(:mod:`robacc.prediction.extrapolation`).

Effects of the measurement (a scale of the instrument, a drift of its frame) move measured poses, not the arm. On
measured poses their columns cancel errors of the arm's coefficients, so J has none of them where the arm's pose counts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.grade import Scale
from robacc.chain import BLOCK
from robacc.errors import InputError, Problem
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.fitting.parameters import absorb_constants, apply_fit
from robacc.fitting.registration import registration_fit
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals
from robacc.prediction.extrapolation import beyond_columns
from robacc.prediction.model_fit import ModelFit
from robacc.prediction.predicting import (
    RADIUS_PROBABILITY,
    Configurations,
    Prediction,
    Share,
    in_tool_frame,
    outer_sums,
    predicted,
)
from robacc.robots.description import Robot
from robacc.statistics.lengths import length_quantiles, principal_variances

SOURCES = ("coefficients", "repeatability", "unexplained", "extrapolation")


@dataclass(frozen=True, slots=True)
class ModelUncertainty:
    """Covariances of the model's error at N poses, in the measuring frame."""

    position: Array
    """``(3, 3, N)`` m²."""
    orientation: Array
    """``(3, 3, N)`` rad²; without the unexplained error where the fit had no measured orientations."""
    rotation: Array
    """``(3, 3, N)`` predicted orientation of the target."""
    shares: Array
    """``(4, 2)`` mean trace of each of :data:`SOURCES`, of position (m²) and orientation (rad²)."""

    def in_target_frame(self) -> ModelUncertainty:
        """Return the covariances in the axes of the predicted target."""
        position, orientation = (in_tool_frame(part, self.rotation) for part in (self.position, self.orientation))
        return dataclasses.replace(self, position=position, orientation=orientation)


def model_uncertainty(robot: Robot, fit: ModelFit, data: Measurements, *, measured: bool) -> ModelUncertainty:
    """Return the uncertainty of the model ``robot`` at the joints and circumstances of ``data``.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        data: Poses with their circumstances.
        measured: The poses are those that the instrument of the fit measures; else those of the arm itself.

    Raises:
        UsageError: The poses lack what an effect of the model depends on.
    """
    robot = absorb_constants(robot)
    position, orientation, rotation = (np.empty((3, 3, data.n)) for _ in range(3))
    traces = np.zeros((len(SOURCES), 2))
    for start in range(0, data.n, BLOCK):
        block = slice(start, start + BLOCK)
        sources, rotation[..., block] = error_columns(robot, fit, data.subset(block), measured)
        for part, (result, factor) in enumerate(zip((position, orientation), fit.bound_factor, strict=True)):
            *within, beyond = (columns[3 * part : 3 * part + 3] for columns in sources)
            # The factors were found within the ranges of the fit.
            result[..., block] = factor**2 * outer_sums(np.concatenate(within, axis=1)) + outer_sums(beyond)
            traces[:, part] += [np.sum(np.square(columns)) for columns in (*within, beyond)]
    return ModelUncertainty(position, orientation, rotation, traces / max(data.n, 1))


def error_columns(
    robot: Robot, fit: ModelFit, data: Measurements, measured: bool, sample: Measurements | None = None
) -> tuple[tuple[Array, ...], Array]:
    """Return columns ``(6, K, n)`` of each of :data:`SOURCES`, and the predicted rotations ``(3, 3, n)``.

    The sum over the columns of their outer products is the covariance of the error from a source. With ``sample``, all
    poses, of which ``data`` are some, products of the columns of coefficients and extrapolation at two poses are the
    covariance of these too; see :func:`robacc.prediction.extrapolation.beyond_columns`.
    """
    effects = tuple(effect for effect in fit.effects if measured or not effect.traits.is_of_measurement)
    model = Model.of(robot, effects)
    if not measured:
        model = dataclasses.replace(model, known=tuple(k for k in model.known if not k.effect.traits.is_of_measurement))
    poses, jacobian, covariance = fitted_jacobian(model, fit, data)
    coefficients = np.einsum("ipn,pk->ikn", jacobian, _root(covariance), optimize=True)
    stds = np.array([fit.repeatability.get(name, 0.0) for name in model.arm.names])
    scatter = np.zeros((6, 0, data.n))
    if stds.any():
        scatter = joint_columns(model, data) * stds[:, None]
    root = _root(fit.unexplained)
    unexplained = np.zeros((6, len(root), data.n))
    for i in range(0, len(root), 3):
        unexplained[i : i + 3] = np.einsum("ian,ak->ikn", poses.rotation, root[i : i + 3])
    return (coefficients, scatter, unexplained, beyond_columns(model, data, sample)), poses.rotation


def _root(covariance: Array) -> Array:
    """Return ``L`` with ``L L^T`` the covariance, whose units may differ from row to row."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    over = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / over[:, None] / over)
    result: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return result


def fitted_jacobian(model: Model, fit: ModelFit, data: Measurements) -> tuple[Poses, Array, Array]:
    """Return poses, their Jacobian ``(6, P, N)`` to the fitted coefficients, and the covariance ``(P, P)`` of these.

    Coefficients of the fit that the poses do not have, such as those of a target that was not measured, are left out.

    Args:
        model: The fitted robot, with the effects of the fit, or some of them, as free effects.
        fit: Record of the fit.
        data: Poses with their circumstances.
    """
    ranges = {known.effect.key(): known.validity for known in model.known}
    bound = model.bind(data, [ranges.get(effect.key(), {}) for effect in model.free], fades=False)
    numbers = {entry: i for i, entry in enumerate(_occurrences(bound.names))}
    coefficients_of_fit = _occurrences(fit.coefficients)
    known = [i for i, entry in enumerate(coefficients_of_fit) if entry in numbers]
    columns = np.array([numbers[coefficients_of_fit[i]] for i in known], dtype=np.int64)
    poses, jacobian = bound.linearise(np.zeros(len(bound.names)), columns)
    return poses, jacobian, fit.covariance[np.ix_(known, known)]


def _occurrences(names: Sequence[str]) -> list[tuple[str, int]]:
    """Return each name with the number of its earlier occurrences: two steps of the base share the names of theirs."""
    count: dict[str, int] = {}
    entries = []
    for name in names:
        entries.append((name, count.get(name, 0)))
        count[name] = count.get(name, 0) + 1
    return entries


# Uncertainty of a model at measured poses whose base or tool was fitted to other measured poses.
#
# A registration spreads the errors of the model at its poses over all poses, and takes part of them away. With W the
# weights of the registration, A the columns of the frames, and e the errors at its poses, the error at another pose is
#
#     e_i - A_i N^-1 A^T W e,    N = A^T W A.
#
# Errors of the coefficients, and of effects beyond their ranges, are the same functions of the joints at all poses.
# Their columns G change to G_i - A_i N^-1 A^T W G. Scatter of the joints, unexplained error and noise are independent
# from pose to pose.

_RANK = 1e-12
"""Eigenvalue of the scaled normal matrix, over the largest, below which a direction of the frames is not fitted."""


def registered_uncertainty(
    robot: Robot, fit: ModelFit, data: Measurements, registration: Fit, used: Measurements
) -> tuple[Array, Array]:
    """Return covariances ``(3, 3, N)`` of position (m²) and orientation (rad²), measuring frame, noise included.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        data: Poses to judge, with their circumstances.
        registration: Fit of the frames.
        used: Poses of the registration.
    """
    frames = Model.of(absorb_constants(apply_fit(registration)), registration.model.free)
    robot = absorb_constants(robot)
    size = len(registration.names)
    normal, scatter, crossed = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, 1))
    weight = np.where(registration.inliers, registration.weight, 0.0)
    rows = weight.shape[0]
    for block, columns, correlated, independent in _blocks_with_frames(robot, fit, used, data, frames):
        weighed = np.square(weight[:, block])[:, None] * columns[:rows]
        normal += np.einsum("ipn,iqn->pq", weighed, columns[:rows])
        scatter += np.einsum("ipn,ijn,jqn->pq", weighed, independent[:rows, :rows], weighed, optimize=True)
        crossed = crossed + np.einsum("ipn,ikn->pk", weighed, correlated[:rows], optimize=True)
    inverse = scaled_inverse(normal)
    moved, spread = inverse @ crossed, inverse @ scatter @ inverse
    position, orientation = np.empty((3, 3, data.n)), np.empty((3, 3, data.n))
    for block, columns, correlated, independent in _blocks_with_frames(robot, fit, data, data, frames):
        changed = correlated - np.einsum("ipn,pk->ikn", columns, moved, optimize=True)
        for result, part in ((position, slice(0, 3)), (orientation, slice(3, 6))):
            result[..., block] = outer_sums(changed[part]) + independent[part, part]
            result[..., block] += np.einsum("ipn,pq,jqn->ijn", columns[part], spread, columns[part], optimize=True)
    return position, orientation


def _blocks_with_frames(
    robot: Robot, fit: ModelFit, data: Measurements, sample: Measurements, frames: Model
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield blocks of poses: columns of the frames and of correlated errors, and the covariance of the others."""
    factor = np.repeat(fit.bound_factor, 3)[:, None, None]
    for start in range(0, data.n, BLOCK):
        block = slice(start, start + BLOCK)
        part = data.subset(block)
        bound = frames.bind(part)
        (coefficients, *scatter, beyond), _ = error_columns(robot, fit, part, True, sample)
        correlated = np.concatenate((factor * coefficients, beyond), axis=1)
        independent = outer_sums(factor * np.concatenate(scatter, axis=1))
        for rows, variance in zip((slice(0, 3), slice(3, 6)), _noise_variances(fit, part), strict=True):
            independent[rows, rows] += np.eye(3)[:, :, None] * variance
        yield block, bound.linearise(np.zeros(len(bound.names)))[1], correlated, independent


def _noise_variances(fit: ModelFit, data: Measurements) -> list[Array | float]:
    """Return the variances of the measurement noise of position and orientation that bounds of the model lack."""
    stated = (data.sigma_position, data.sigma_rotation)
    return [0.0 if sigma is None or not fit.noise_is_separate else np.square(sigma) for sigma in stated]


def scaled_inverse(normal: Array) -> Array:
    """Return the inverse of a normal matrix without its undetermined directions."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    kept = values > _RANK * values[-1]
    result: Array = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T * scale[:, None] * scale
    return result


# Predicted accuracy of a calibrated arm: what its model file knows of the fit, over poses or the workspace.

MEANING = "errors of the calibrated arm: coefficients of the fit, repeatability, and unexplained error"


def calibrated_accuracy(
    robot: Robot, fit: ModelFit, configurations: Configurations, poses: Measurements | None, scale: Scale, seed: int
) -> Prediction:
    """Predict covariances and grade of a calibrated arm that is commanded through its model.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        configurations: Configurations of equal weight.
        poses: Poses with circumstances at these configurations; None for configurations alone, which get directions
            of approach at random and other circumstances from the middle of the ranges of the fit.
        scale: Scale of the grade.
        seed: Seed of the directions.
    """
    data = completed(robot, fit, configurations.q if poses is None else None, poses, seed)
    uncertainty = model_uncertainty(robot, fit, data, measured=False).in_target_frame()
    totals = np.sum(uncertainty.shares, axis=0)
    shares = uncertainty.shares / np.where(totals > 0.0, totals, 1.0)
    budget = [
        Share(name, None, name, None, None, float(share[0]), float(share[1]))
        for name, share in zip(SOURCES, shares, strict=True)
    ]
    budget.sort(key=lambda share: -share.position)
    return predicted(
        configurations,
        (uncertainty.position, uncertainty.orientation),
        scale,
        parameters=(),
        budget=tuple(budget),
        by_joint=(),
        by_kind=(),
        meaning=MEANING,
        notes=(*configurations.notes, *_notes(robot, fit, data)),
        is_calibrated=True,
    )


def completed(robot: Robot, fit: ModelFit, q: Array | None, poses: Measurements | None, seed: int) -> Measurements:
    """Return poses with every circumstance that an effect may depend on."""
    if poses is None:
        assert q is not None
        targets = list(robot.targets)
        names = np.repeat(targets[:1], q.shape[1]) if targets else None
        poses = Measurements(position=np.zeros((3, q.shape[1])), q=q, target=names)
    assert poses.q is not None
    rng = np.random.default_rng([seed, poses.n])

    def middle(column: Array | None, name: str) -> Array | None:
        if column is not None or name not in fit.ranges:
            return column
        return np.full(poses.n, 0.5 * sum(fit.ranges[name]))

    direction = poses.direction
    if direction is None:
        direction = rng.choice(np.array([-1.0, 1.0]), poses.q.shape)
    return dataclasses.replace(
        poses,
        direction=direction,
        speed=direction if poses.speed is None else poses.speed,
        payload=middle(poses.payload, "payload_kg"),
        temperature=middle(poses.temperature, "temperature_c"),
        time=middle(poses.time, "time_s"),
    )


def _notes(robot: Robot, fit: ModelFit, data: Measurements) -> Sequence[str]:
    notes = [f"the model was fitted to {fit.n_poses} poses"]
    outside = np.zeros(data.n, dtype=bool)
    assert data.q is not None
    for name, row in zip(robot.variable_names, data.q, strict=True):
        low, high = fit.ranges.get(name, (-np.inf, np.inf))
        outside |= (row < low) | (row > high)
    if outside.any():
        notes.append(
            f"{np.count_nonzero(outside)} of {data.n} configurations lie outside the joint ranges of the fit, where "
            "the unexplained error may be larger"
        )
    if fit.unexplained.shape[0] < 6:
        notes.append("the fit had no measured orientations, so that of the prediction lacks the unexplained error")
    return notes


# Coverage of a model's bounds: how many measured poses lie within the 95 % bound of their error.


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
    if aligned:
        error, covariances = _registered(robot, fit, data, aligned)
    else:
        error = _errors(robot, data)
        uncertainty, variances = model_uncertainty(robot, fit, data, measured=True), _noise_variances(fit, data)
        parts = (uncertainty.position, uncertainty.orientation)
        covariances = [part + np.eye(3)[:, :, None] * added for part, added in zip(parts, variances, strict=True)]
    results = []
    stated = (measured.sigma_position, measured.sigma_rotation)
    quantities: tuple[Literal["position", "orientation"], ...] = ("position", "orientation")
    for i in range(min(error.shape[0], fit.unexplained.shape[0]) // 3):
        source: Literal["given", "file", "fit"] = "fit"
        if fit.noise_is_separate and (noise[i] is not None or stated[i] is not None):
            source = "file" if noise[i] is None else "given"
        bound = length_quantiles(RADIUS_PROBABILITY, principal_variances(covariances[i]))
        inside = int(np.count_nonzero(np.linalg.norm(error[3 * i : 3 * i + 3], axis=0) <= bound))
        results.append(Coverage(quantities[i], RADIUS_PROBABILITY, measured.n, inside, tuple(aligned), source))
    return tuple(results)


def _errors(robot: Robot, data: Measurements) -> Array:
    return residuals(data, Model.of(absorb_constants(robot)).bind(data).poses(np.zeros(0)))


def _with_noise(fit: ModelFit, data: Measurements, noise: tuple[float | None, float | None]) -> Measurements:
    """Return the poses with the measurement noise that is given, or that of the fit where neither states it."""
    stated = (data.sigma_position, data.sigma_rotation)
    position, angle = (
        of_fit if given is None and column is None else given
        for given, column, of_fit in zip(noise, stated, fit.noise, strict=True)
    )
    return dataclasses.replace(
        data,
        sigma_position=data.sigma_position if position is None else np.full((3, data.n), position),
        sigma_rotation=data.sigma_rotation if angle is None else np.full(data.n, angle),
    )


def _registered(robot: Robot, fit: ModelFit, data: Measurements, frames: Sequence[str]) -> tuple[Array, list[Array]]:
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
    return error, [position, orientation]
