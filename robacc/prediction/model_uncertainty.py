"""Uncertainty of a fitted model at given poses: coefficients, repeatability, and what the model does not explain.

The error of the calibrated arm against its model has the covariance

    V = J C J^T + J_q S J_q^T + R U R^T + X,

with J the Jacobian of the pose to the fitted coefficients and C their covariance, J_q that to the joints and S the
variances of their scatter, U the covariance of the unexplained error in the target's frame and R its orientation. X is
what effects add beyond the ranges that they were fitted on (:mod:`robacc.prediction.extrapolation`,
:mod:`robacc.prediction.fading`).

Effects of the measurement (a scale of the instrument, a drift of its frame) move measured poses, not the arm. On
measured poses their columns cancel errors of the arm's coefficients, so J has none of them where the arm's pose counts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.chain import BLOCK
from robacc.effects.joint_offset import JointOffset
from robacc.fitting.apply_fit import absorb_constants
from robacc.geometry import Array, Poses, compose, transpose
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.prediction.extrapolation import extrapolation, extrapolation_columns
from robacc.prediction.fading import fading_columns
from robacc.prediction.model_fit import ModelFit
from robacc.robots.description import Robot

SOURCES = ("coefficients", "repeatability", "unexplained", "extrapolation")


@dataclass(frozen=True, slots=True)
class ModelUncertainty:
    """Covariances of the model's error at N poses, in the measuring frame."""

    position: Array
    """``(3, 3, N)`` m²."""
    orientation: Array
    """``(3, 3, N)`` rad²."""
    is_oriented: bool
    """The fit had measured orientations; else that covariance lacks the unexplained error."""
    rotation: Array
    """``(3, 3, N)`` predicted orientation of the target."""
    shares: Array
    """``(4, 2)`` mean trace of each of :data:`SOURCES`, of position (m²) and orientation (rad²)."""

    def in_target_frame(self) -> ModelUncertainty:
        """Return the covariances in the axes of the predicted target."""
        position, orientation = (
            compose(transpose(self.rotation), compose(part, self.rotation))
            for part in (self.position, self.orientation)
        )
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
        block = slice(start, min(start + BLOCK, data.n))
        parts, turned = _blocks(robot, fit, data.subset(block), measured)
        rotation[..., block] = turned
        # The factors were found within the ranges of the fit.
        within, beyond = np.sum(parts[:3], axis=0), parts[3]
        position[..., block] = fit.bound_factor[0] ** 2 * within[:3, :3] + beyond[:3, :3]
        orientation[..., block] = fit.bound_factor[1] ** 2 * within[3:, 3:] + beyond[3:, 3:]
        for i, part in enumerate(parts):
            traces[i] += np.einsum("iin->", part[:3, :3]), np.einsum("iin->", part[3:, 3:])
    is_oriented = fit.unexplained.shape[0] == 6
    return ModelUncertainty(position, orientation, is_oriented, rotation, traces / max(data.n, 1))


def _blocks(robot: Robot, fit: ModelFit, data: Measurements, measured: bool) -> tuple[tuple[Array, ...], Array]:
    """Return the covariances ``(6, 6, n)`` of the sources, and the predicted rotations."""
    sources = pose_sources(robot, fit, data, measured)
    beyond = extrapolation(sources.model, data)
    coefficients = _propagated(sources.jacobian, sources.covariance)
    beyond = np.zeros_like(coefficients) if beyond is None else beyond
    faded = fading_columns(sources.model, data, data)
    if faded is not None:
        beyond = beyond + np.einsum("ikn,jkn->ijn", faded, faded, optimize=True)
    return (coefficients, sources.scatter, _turned(fit.unexplained, sources.rotation), beyond), sources.rotation


@dataclass(frozen=True, slots=True)
class PoseSources:
    """Sources of a model's error at n poses, measuring frame."""

    model: Model
    data: Measurements
    jacobian: Array
    """``(6, P, n)`` derivative to the fitted coefficients, times the factor of their standard errors."""
    covariance: Array
    """``(P, P)`` of the coefficients."""
    scatter: Array
    """``(6, 6, n)`` covariance by the scatter of the joints."""
    rotation: Array
    """``(3, 3, n)`` predicted orientation of the target."""

    def columns(self, fit: ModelFit, sample: Measurements) -> Array:
        """Return columns ``(6, K, n)`` of the errors that are the same function of the joints at all poses.

        Their products over two poses are covariances. ``sample`` holds all poses, of which these are some.
        """
        factor = np.repeat(fit.bound_factor, 3)[:, None, None]
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        columns = factor * np.einsum("ipn,pk->ikn", self.jacobian, root, optimize=True)
        beyond = (extrapolation_columns(self.model, self.data, sample), fading_columns(self.model, self.data, sample))
        return np.concatenate((columns, *(part for part in beyond if part is not None)), axis=1)


def independent_covariance(fit: ModelFit, sources: PoseSources, data: Measurements) -> Array:
    """Return the covariance ``(6, 6, n)`` of errors that are independent from pose to pose, measurement noise too."""
    factor = np.repeat(fit.bound_factor, 3)
    result: Array = (sources.scatter + _turned(fit.unexplained, sources.rotation)) * np.outer(factor, factor)[..., None]
    if fit.noise_is_separate:
        for part, noise in ((slice(0, 3), data.sigma_position), (slice(3, 6), data.sigma_rotation)):
            if noise is not None:
                result[part, part] += np.eye(3)[:, :, None] * np.square(noise)
    return result


def pose_sources(robot: Robot, fit: ModelFit, data: Measurements, measured: bool) -> PoseSources:
    """Return the sources of the error of the model ``robot``; see :func:`model_uncertainty`."""
    effects = tuple(effect for effect in fit.effects if measured or not effect.is_of_measurement)
    model = Model.of(robot, effects)
    if not measured:
        model = dataclasses.replace(model, known=tuple(k for k in model.known if not k.effect.is_of_measurement))
    poses, jacobian, covariance = fitted_jacobian(model, fit, data)
    stds = np.array([fit.repeatability.get(name, 0.0) for name in model.arm.names])
    scatter = np.zeros((6, 6, data.n))
    if stds.any():
        joints = Model(model.arm, model.known, (JointOffset(model.arm.names),)).bind(data)
        scatter = _propagated(joints.linearise(np.zeros(stds.size))[1], np.diag(np.square(stds)))
    return PoseSources(model, data, jacobian, covariance, scatter, poses.rotation)


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


def _propagated(jacobian: Array, covariance: Array) -> Array:
    """Return ``J C J^T`` ``(6, 6, n)`` of a Jacobian ``(6, P, n)``."""
    stacked = np.ascontiguousarray(np.moveaxis(jacobian, 2, 0))
    result: Array = np.moveaxis(stacked @ covariance @ np.swapaxes(stacked, 1, 2), 0, 2)
    return result


def _turned(covariance: Array, rotation: Array) -> Array:
    """Return a covariance ``(M, M)`` of the target's frame in the measuring frame ``(6, 6, n)``."""
    result = np.zeros((6, 6, rotation.shape[2]))
    for i in range(0, covariance.shape[0], 3):
        for j in range(0, covariance.shape[0], 3):
            part = np.einsum("ian,ab->ibn", rotation, covariance[i : i + 3, j : j + 3])
            result[i : i + 3, j : j + 3] = np.einsum("ibn,jbn->ijn", part, rotation)
    return result
