"""Linear model of a campaign: whitened columns of the coefficients at planned poses, priors, and the task's region."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect, Term
from robacc.effects.request import build, parse_requests
from robacc.effects.specification import every_column
from robacc.fitting.fit_result import Dropped, identify_terms
from robacc.fitting.normal_equations import joint_columns
from robacc.fitting.priors import broad_stds, tolerance_priors
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitening import whitening
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Robot

_FRAME_PRIOR = 1.0
"""m or rad; prior standard deviation of base and tool frames, which may be anywhere."""
_IDENTIFIED_ON = 1500
"""Poses that decide which coefficients any poses identify."""
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


def _jacobian(model: Model, data: Measurements, more: Iterable[Term] = ()) -> Array:
    """Return ``(6, P, N)`` columns of the model's free coefficients, then of ``more`` terms, for the rows of data."""
    bound = model.bind(data)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *more))
    return extended.linearise(np.zeros(len(extended.terms)))[1]


def _joint_columns(model: Model, data: Measurements) -> Array:
    """Return ``(6, J, N)`` displacement by each joint."""
    return joint_columns(dataclasses.replace(model, free=()), data)


def whitened_rows(model: Model, data: Measurements, noise: ExpectedNoise, more: Iterable[Term] = ()) -> Array:
    """Return ``(N, M, P)`` columns of the free coefficients, then of ``more`` terms, for the rows of ``data``.

    They are in units of the noise: instrument, repeatability and unexplained error.
    """
    size = 3 if noise.orientation is None else 6
    weight = np.full((size, data.n), 1.0 / np.hypot(noise.position, noise.unexplained))
    if noise.orientation is not None:
        weight[3:] = 1.0 / noise.orientation
    white = whitening(weight, _joint_columns(model, data)[:size], noise.joints, visit_numbers(data))
    return white.apply(np.moveaxis(_jacobian(model, data, more)[:size], 1, 0)).T


def candidate_rows(model: Model, poses: Measurements, noise: ExpectedNoise, more: Iterable[Term] = ()) -> Array:
    """Return ``(N, M, P)`` the same of N unmeasured poses; M counts the components of all targets."""
    rows = whitened_rows(model, with_targets(model.arm.robot, poses), noise, more)
    return np.ascontiguousarray(rows).reshape(poses.n, -1, rows.shape[2])


def region_rows(model: Model, task: Measurements) -> Array:
    """Return ``(3, T, P)`` displacement of each target by each coefficient at the task's poses, m."""
    jacobian = _jacobian(model, with_targets(model.arm.robot, task))
    return np.ascontiguousarray(np.moveaxis(jacobian[:3], 1, 2))


def coefficients(model: Model, rows: Array) -> PlannedCoefficients:
    """Return the coefficients that the candidates' ``rows`` ``(N, M, P)`` identify, and their priors."""
    bound = [effect.terms(model.arm, every_column(model.arm)) for effect in model.free]
    terms = tuple(term for own in bound for term in own)
    owners = [number for number, own in enumerate(bound) for _ in own]
    flat = rows[:: max(1, rows.shape[0] // _IDENTIFIED_ON)].reshape(-1, rows.shape[2])
    identified = identify_terms(np.asarray(np.linalg.qr(flat, mode="r")), terms, flat.shape[0])
    columns = identified.columns
    tolerance = {name: std for name, std in tolerance_priors(model.arm.robot).items() if std > 0}
    broad = broad_stds(model.free, terms, owners)
    usual = [
        _USUAL_SIZES * term.typical if is_constant or term.typical < 1e-3 else _FRAME_PRIOR
        for term, is_constant in zip(terms, np.isfinite(broad), strict=True)
    ]
    prior = np.array([tolerance.get(term.name, std) for term, std in zip(terms, usual, strict=True)])
    return PlannedCoefficients(terms, columns, identified.dropped, prior[columns], broad[columns])


def repeatability_at_target(model: Model, task: Measurements, joints: Array) -> float:
    """Return the scatter of the target along each axis, m rms, that joints' scatter ``(J,)`` gives over the task."""
    columns = _joint_columns(model, with_targets(model.arm.robot, task))[:3]
    variance = np.einsum("ijn,j->n", np.square(columns), np.square(joints))
    return float(np.sqrt(np.mean(variance) / 3.0))


def joint_repeatability(model: Model, task: Measurements, size: float) -> Array:
    """Return ``(J,)`` equal scatter of all rotary joints that gives the target ``size`` m rms along each axis."""
    is_rotary = np.array([model.arm.is_revolute(name) for name in model.arm.names])
    if not is_rotary.any():
        return np.full(is_rotary.size, size)
    angle = size / repeatability_at_target(model, task, is_rotary.astype(np.float64))
    result: Array = np.where(is_rotary, angle, size / np.sqrt(3.0))
    return result
