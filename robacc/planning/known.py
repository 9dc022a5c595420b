"""Knowledge before a campaign: the noise, and the information of earlier poses or of a fitted model."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.campaign import TYPICAL_NOISE, TYPICAL_REPEATABILITY, CampaignPlan, CampaignSettings
from robacc.planning.conditions import Conditions
from robacc.planning.design import information_of
from robacc.planning.linear_model import (
    ExpectedNoise,
    PlannedCoefficients,
    joint_repeatability,
    whitened_columns,
    with_targets,
)
from robacc.prediction.model_fit import ModelFit

_TIME_STEP = 20.0
"""s from visit to visit, for the detection limit of a drift; the unit of time cancels."""


def expected_noise(
    model: Model, task: Measurements, settings: CampaignSettings, record: ModelFit | None
) -> ExpectedNoise:
    """Return the noise to expect: as given, else that of the model's fit, else typical.

    Args:
        model: The robot.
        task: Poses over which the scatter at the target is meant.
        settings: Given noise.
        record: Record of the robot's fit; None if it has none.

    Raises:
        UsageError: Instrument and model have no error at all.
    """
    sources = []
    if settings.noise is not None:
        position = settings.noise
        sources.append("given noise")
    elif record is not None and record.noise[0] > 0.0:
        position = record.noise[0]
        sources.append("noise of the model's fit")
    else:
        position = TYPICAL_NOISE
        sources.append("typical noise")
    fitted = {} if record is None else record.repeatability
    if settings.repeatability is None and fitted:
        joints = np.array([fitted.get(name, 0.0) for name in model.arm.names])
        sources.append("repeatability of the model's fit")
    elif settings.repeatability is None and record is not None:
        # A fit writes the scatter of the joints only where it is significant; the noise then includes the rest.
        joints = np.zeros(len(model.arm.names))
    else:
        size = TYPICAL_REPEATABILITY if settings.repeatability is None else settings.repeatability
        joints = joint_repeatability(model, task, size)
        sources.append(f"{'typical' if settings.repeatability is None else 'given'} repeatability")
    unexplained = settings.unexplained or _unexplained(record)
    if unexplained and not settings.unexplained:
        sources.append("unexplained error of the model's fit")
    if position == 0.0 and unexplained == 0.0:
        raise UsageError("`noise` is zero; give the standard deviation of the instrument along each axis")
    return ExpectedNoise(position, settings.noise_orientation, joints, unexplained, ", ".join(sources))


def _unexplained(record: ModelFit | None) -> float:
    """Return the unexplained error along each axis, m, without the noise that the record may contain."""
    if record is None:
        return 0.0
    variance = float(np.trace(record.unexplained[:3, :3])) / 3.0
    contained = 0.0 if record.noise_is_separate else record.noise[0] ** 2
    return float(np.sqrt(max(variance - contained, 0.0)))


def known_information(
    model: Model,
    planned: PlannedCoefficients,
    noise: ExpectedNoise,
    already: Measurements | None,
    record: ModelFit | None,
) -> Array:
    """Return ``(P, P)`` information of the poses measured ``already``, or else of the model's fit.

    ``already`` has the commanded part alone.
    """
    size = planned.columns.size
    if already is not None:
        columns = whitened_columns(model, already, noise)[:, planned.columns]
        return information_of(np.moveaxis(columns, 1, 2))
    result = np.zeros((size, size))
    if record is None:
        return result
    place = {name: i for i, name in enumerate(planned.names)}
    common = [(place[name], i) for i, name in enumerate(record.coefficients) if name in place]
    if common:
        ours, theirs = (np.array(numbers) for numbers in zip(*common, strict=True))
        # The part of a covariance is that of its coefficients, the others unknown.
        covariance = record.covariance[np.ix_(theirs, theirs)]
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        inverse = np.linalg.pinv(covariance / scale[:, None] / scale, rcond=1e-12, hermitian=True)
        result[np.ix_(ours, ours)] = inverse / scale[:, None] / scale
    return result


def planned_visits(
    plan: CampaignPlan, conditions: Conditions, already: Measurements | None = None
) -> tuple[Measurements, Measurements]:
    """Return the planned visits with every target and the time of each, alone and after the poses measured already.

    ``already`` has the commanded part alone.
    """
    visits = plan.visits()
    start: Array = np.linspace(0.0, _TIME_STEP * (visits.n - 1), visits.n)
    temperature = conditions.constant_temperature(visits.n)
    timed = dataclasses.replace(visits, pose=None, cycle=None, time=start, temperature=temperature)
    data = with_targets(plan.robot, timed)
    return data, data if already is None else _after(already, data)


def _after(earlier: Measurements, data: Measurements) -> Measurements:
    """Return the rows of ``earlier``, then those of ``data``, which have all columns."""
    assert earlier.q is not None
    assert data.time is not None
    before: Array = np.linspace(-_TIME_STEP * earlier.n, -_TIME_STEP, earlier.n)
    time: Array = np.concatenate((before, data.time))
    payload = None
    if data.payload is not None:
        zero = np.zeros(earlier.n) if earlier.payload is None else earlier.payload
        payload = np.concatenate((zero, data.payload))
    temperature = None
    if data.temperature is not None:
        temperature = np.full(time.size, data.temperature[0])
    return dataclasses.replace(
        data,
        position=np.concatenate((np.zeros((3, earlier.n)), data.position), axis=1),
        q=_joined(earlier.q, data.q),
        target=None if data.target is None else np.concatenate((_target(earlier, data), data.target)),
        time=time,
        temperature=temperature,
        payload=payload,
        direction=_joined(earlier.direction, data.direction),
        speed=_joined(earlier.speed, data.speed),
        branches=_joined(earlier.branches, data.branches),
    )


def _joined(first: Array | None, second: Array | None) -> Array | None:
    return second if first is None or second is None else np.concatenate((first, second), axis=1)


def _target(earlier: Measurements, data: Measurements) -> NDArray[np.str_]:
    assert data.target is not None
    return np.full(earlier.n, data.target[0]) if earlier.target is None else earlier.target


def commanded_part(data: Measurements, conditions: Conditions) -> Measurements:
    """Return the commanded part of measured poses; direction and speed of an approach that was not logged are zero.

    Raises:
        UsageError: They have no joint columns.
    """
    if data.q is None:
        raise UsageError("the poses measured already have no joint columns")
    has_motion = data.direction is not None and data.speed is not None
    zero = np.zeros_like(data.q)
    temperature = data.temperature
    if temperature is None:
        temperature = conditions.constant_temperature(data.n)
    return dataclasses.replace(
        data,
        position=np.zeros_like(data.position),
        rotation=None,
        direction=data.direction if has_motion else zero,
        speed=data.speed if has_motion else zero,
        temperature=temperature,
    )
