"""Payloads whose centre of mass the robot file does not state, on an arm with torques of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from independent_arm import DECLARED, GRAVITY, TOOL, Matrix, measured, robot, run, target, torques

from robacc.effects.elastic import PayloadCompliance
from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.search import search

ARM = Arm.of(robot())
NOISE = 1e-5
COMPLIANCE = 6e-7
FAR = np.array([0.3, -0.2, 0.45])
"""Centre of mass in the last link's frame, m; the file has none, which means the tool's place."""


def payload_torque(q: Matrix, mass: float, com: Matrix) -> float:
    """Torque of the payload about joint 2: what the energy's slope gains by it."""
    weight = mass * GRAVITY
    return float((torques(q, lambda frames: weight * float((frames[-1] @ np.append(com, 1.0))[2])) - torques(q))[1])


def loaded(n: int, seed: int, noise: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joint 2 gives way to payloads of 0, 20 and 60 kg."""
    poses = run(n, seed)
    mass = np.random.default_rng(seed).choice([0.0, 20.0, 60.0], n)
    moved = poses.q.copy()
    moved[1] += [COMPLIANCE * payload_torque(q, m, com) for q, m in zip(poses.q.T, mass, strict=True)]
    position = np.array([target(q) for q in moved.T]).T
    return dataclasses.replace(measured(poses, position, noise, seed), payload=mass)


def error_at_other_poses(effect: PayloadCompliance, com: Matrix) -> float:
    """RMS error (m) of a fit at poses that it has not seen and that have no noise."""
    data, fresh = loaded(80, 61, NOISE, com), loaded(60, 62, 0.0, com)
    result = fit(Model(ARM, free=(*build(parse_requests(DECLARED), ARM, data), effect)), data, Options())
    predicted = result.model.bind(fresh).poses(result.theta).translation
    return float(np.sqrt(np.mean(np.sum(np.square(fresh.position - predicted), axis=0))))


def test_another_centre_is_found_and_predicts_other_poses() -> None:
    data = loaded(80, 61, NOISE, FAR)
    effects = search(Model(ARM, free=build(parse_requests(DECLARED), ARM, data)), data).effects
    assert [(effect.name, effect.joints, effect.settings()) for effect in effects] == [
        ("payload_compliance", ("j2",), {"com": "uncertain"})
    ]
    assert error_at_other_poses(PayloadCompliance(("j2",), "uncertain"), FAR) < 1.2e-5
    assert error_at_other_poses(PayloadCompliance(("j2",)), FAR) > 2.4e-5


@pytest.mark.slow
def test_a_centre_at_the_tool_costs_no_accuracy() -> None:
    data = loaded(80, 61, NOISE, TOOL)
    (effect,) = search(Model(ARM, free=build(parse_requests(DECLARED), ARM, data)), data).effects
    assert isinstance(effect, PayloadCompliance)
    assert effect.joints == ("j2",)
    assert error_at_other_poses(effect, TOOL) < 1.2e-5


def test_first_moments_times_the_centre_are_the_payload() -> None:
    """Both forms predict the same poses where the coefficients are those of the centre."""
    data = loaded(20, 63, 0.0, FAR)
    moved = Arm.of(dataclasses.replace(robot(), payload_com=tuple(FAR.tolist())))
    known = Model(moved, free=(PayloadCompliance(("j2",)),)).bind(data).poses(np.array([COMPLIANCE]))
    uncertain = Model(ARM, free=(PayloadCompliance(("j2",), "uncertain"),)).bind(data)
    poses = uncertain.poses(COMPLIANCE * np.array([1.0, *(FAR - TOOL)]))
    np.testing.assert_allclose(poses.translation, known.translation, atol=1e-12)
    assert pytest.approx(6e-7) == COMPLIANCE
