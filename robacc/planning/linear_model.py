"""Linear model of a campaign: whitened columns of the coefficients at planned poses, priors, and the task's region."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect, Term
from robacc.effects.request import build, parse_requests
from robacc.effects.specification import every_column
from robacc.fitting.fit_result import Dropped, identify_terms
from robacc.fitting.normal_equations import joint_columns
from robacc.fitting.priors import BADLY_MADE, broad_stds, tolerance_priors
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitening import whitening
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.design import information_of
from robacc.robots.description import Robot

_FRAME_PRIOR = 1.0
"""m or rad; prior standard deviation of base and tool frames, which may be anywhere."""
_IDENTIFIED_ON = 1500
"""Poses that decide which coefficients any poses identify."""
_SINGULAR = 1e14
"""Condition number above which an information matrix counts as singular."""
_USUAL_SIZES = 10.0
"""Prior standard deviation, over its usual size, of a coefficient without a tolerance, for the choice of poses."""


@dataclass(frozen=True, slots=True)
class ExpectedNoise:
    """Errors that no model predicts, as standard deviations."""

    position: float
    """Instrument, along each axis, m."""
    orientation: float | None
    """Instrument, about each axis, rad; None where orientation is not measured."""
    joints: Array
    """``(J,)`` repeatability of each joint, rad or m."""
    unexplained: float
    """Error of the model that stays the same at one pose and differs from pose to pose, along each axis, m."""
    source: str

    def reduced(self, visits: int, readings: int) -> ExpectedNoise:
        """Return the noise of the mean over ``visits`` of each pose, with ``readings`` at each visit."""
        share = 1.0 / np.sqrt(visits * readings)
        return dataclasses.replace(
            self,
            position=self.position * share,
            orientation=None if self.orientation is None else self.orientation * share,
            joints=self.joints / np.sqrt(visits),
        )


@dataclass(frozen=True, slots=True)
class PlannedCoefficients:
    """Coefficients that the campaign determines, with their priors."""

    terms: tuple[Term, ...]
    """Every coefficient of the free effects."""
    columns: NDArray[np.int64]
    """``(P,)`` numbers of the coefficients that are identifiable on some poses."""
    dropped: tuple[Dropped, ...]
    """Coefficients that no poses identify."""
    prior_std: Array
    """``(P,)`` prior standard deviations for the choice of poses: tolerance, else wide."""
    broad_std: Array
    """``(P,)`` standard deviation of the fit's broad prior of constants; inf for other coefficients."""

    @property
    def names(self) -> list[str]:
        """Names of the identifiable coefficients."""
        return [self.terms[i].name for i in self.columns]


def free_effects(robot: Robot, fit: str) -> tuple[Effect, ...]:
    """Return the effects of a list such as ``base_frame,joint_offset[j2]``.

    Raises:
        UsageError: One of them does not exist or cannot be fitted to the robot.
    """
    arm = Model.of(robot).arm
    return build(parse_requests(fit), arm, every_column(arm))


def with_targets(robot: Robot, poses: Measurements) -> Measurements:
    """Return unmeasured poses with every target at each pose, poses in order, targets innermost."""
    targets = tuple(robot.targets)
    if not targets:
        return poses
    repeated = poses.subset(np.repeat(np.arange(poses.n), len(targets)))
    return dataclasses.replace(repeated, target=np.tile(np.array(targets), poses.n))


def whitened_columns(model: Model, data: Measurements, noise: ExpectedNoise) -> Array:
    """Return ``(M, P, N)`` columns of the model's free coefficients in units of the noise, for the rows of ``data``."""
    rows = 3 if noise.orientation is None else 6
    bound = model.bind(data)
    jacobian = bound.linearise(np.zeros(len(bound.terms)))[1][:rows]
    return whitened(model, data, noise, jacobian)


def whitened(model: Model, data: Measurements, noise: ExpectedNoise, jacobian: Array) -> Array:
    """Return columns ``(M, P, N)`` in units of the noise: instrument, repeatability and unexplained error."""
    weight = np.empty((jacobian.shape[0], data.n))
    weight[:3] = 1.0 / np.hypot(noise.position, noise.unexplained)
    if jacobian.shape[0] == 6 and noise.orientation is not None:
        weight[3:] = 1.0 / noise.orientation
    visits = visit_numbers(data)
    columns = joint_columns(dataclasses.replace(model, free=()), data)[: jacobian.shape[0]]
    white = whitening(weight, columns, noise.joints, visits)
    return np.moveaxis(white.apply(np.moveaxis(jacobian, 1, 0)), 0, 1)


def pose_rows(columns: Array, n_targets: int) -> Array:
    """Return ``(M n_targets, N, P)`` rows of each pose, from columns ``(M, P, N n_targets)`` with targets innermost."""
    components, size, count = columns.shape
    poses = count // n_targets
    split = columns.reshape(components, size, poses, n_targets)
    result: Array = np.ascontiguousarray(np.moveaxis(split, (0, 3, 2, 1), (0, 1, 2, 3))).reshape(-1, poses, size)
    return result


def candidate_rows(model: Model, poses: Measurements, noise: ExpectedNoise) -> Array:
    """Return ``(M, N, P)`` whitened rows of N unmeasured poses; M counts the components of all targets."""
    data = with_targets(model.arm.robot, poses)
    return pose_rows(whitened_columns(model, data, noise), max(len(model.arm.robot.targets), 1))


def region_rows(model: Model, task: Measurements) -> Array:
    """Return ``(3, T, P)`` displacement of the target by each coefficient at the task's poses, m; mean of targets."""
    robot = model.arm.robot
    data = with_targets(robot, task)
    bound = model.bind(data)
    jacobian = bound.linearise(np.zeros(len(bound.terms)))[1][:3]
    n_targets = max(len(robot.targets), 1)
    rows = pose_rows(jacobian, n_targets)
    result: Array = rows.reshape(3, n_targets * rows.shape[1], -1)
    return result


def coefficients(model: Model, rows: Array) -> PlannedCoefficients:
    """Return the coefficients that the candidates' ``rows`` ``(M, N, P)`` identify, and their priors."""
    bound = [effect.terms(model.arm, every_column(model.arm)) for effect in model.free]
    terms = tuple(term for own in bound for term in own)
    owners = [number for number, own in enumerate(bound) for _ in own]
    step = max(1, rows.shape[1] // _IDENTIFIED_ON)
    flat = rows[:, ::step].reshape(-1, rows.shape[2])
    triangle = np.asarray(np.linalg.qr(flat, mode="r"))
    identified = identify_terms(triangle, terms, flat.shape[0])
    columns = identified.columns
    tolerance = {name: std for name, std in tolerance_priors(model.arm.robot).items() if std > 0}
    broad = broad_stds(model.free, terms, owners)
    is_constant = np.isfinite(broad)
    prior = np.array([tolerance.get(terms[i].name, _usual_prior(terms[i], is_constant[i])) for i in range(len(terms))])
    return PlannedCoefficients(terms, columns, identified.dropped, prior[columns], broad[columns])


def fit_covariance(rows: Array, planned: PlannedCoefficients, information: Array | None = None) -> Array | None:
    """Return ``(P, P)`` the covariance of the errors of a fit to poses ``(M, n, P)``; None where they do not suffice.

    It is the mean over arms whose constants deviate by their usual size. Constants have the fit's broad prior
    (:mod:`robacc.fitting.priors`). ``information`` is that of poses measured already.
    """
    normal = information_of(rows) if information is None else information + information_of(rows)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    precision = np.diag(planned.broad_std**-2.0)
    gain = _inverse(normal + precision, scale)
    if gain is None:
        return None
    # The prior is wider than the usual deviations, so the error is less than the posterior covariance says.
    result: Array = gain @ (normal + precision / BADLY_MADE**2) @ gain
    return result


def _inverse(matrix: Array, scale: Array) -> Array | None:
    """Return the inverse of an information matrix, scaled by ``scale``; None if it is singular."""
    scaled = matrix / scale[:, None] / scale
    if np.linalg.cond(scaled) > _SINGULAR:
        return None
    result: Array = np.linalg.inv(scaled) / scale[:, None] / scale
    return result


def joint_repeatability(model: Model, task: Measurements, size: float) -> Array:
    """Return ``(J,)`` equal scatter of all rotary joints that gives the target ``size`` m rms along each axis."""
    data = with_targets(model.arm.robot, task)
    columns = joint_columns(dataclasses.replace(model, free=()), data)[:3]
    revolute = np.array([model.arm.is_revolute(name) for name in model.arm.names])
    if not revolute.any():
        return np.full(revolute.size, size)
    mean = float(np.mean(np.sum(np.square(columns[:, revolute]), axis=(0, 1)))) / 3.0
    angle = size / np.sqrt(mean)
    result: Array = np.where(revolute, angle, size / np.sqrt(3.0))
    return result


def repeatability_at_target(model: Model, task: Measurements, joints: Array) -> float:
    """Return the scatter of the target along each axis, m rms, that joints' scatter ``(J,)`` gives over the task."""
    columns = joint_columns(dataclasses.replace(model, free=()), with_targets(model.arm.robot, task))[:3]
    variance = np.einsum("ijn,j->n", np.square(columns), np.square(joints))
    return float(np.sqrt(np.mean(variance) / 3.0))


def _usual_prior(term: Term, is_constant: bool) -> float:
    return _USUAL_SIZES * term.typical if is_constant or term.typical < 1e-3 else _FRAME_PRIOR
