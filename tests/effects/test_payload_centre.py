"""Payloads whose centre of mass the robot file does not state, on an arm with torques of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from independent_arm import TOOL, Matrix, measured_with_loads, robot
from searched import ARM, error_at, fitted, found

from robacc.effects.elastic import PayloadCompliance
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm

NOISE = 1e-5
COMPLIANCE = 6e-7
FAR = np.array([0.3, -0.2, 0.45])
"""Centre of mass in the last link's frame, m; the file has none, which means the tool's place."""


def loaded(n: int, seed: int, noise: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joint 2 gives way to payloads of 0, 20 and 60 kg."""
    mass = np.random.default_rng(seed).choice([0.0, 20.0, 60.0], n)
    return dataclasses.replace(measured_with_loads(n, seed, noise, COMPLIANCE, mass, com), payload=mass)


def error_at_other_poses(effect: PayloadCompliance, com: Matrix) -> float:
    return error_at(fitted(loaded(80, 61, NOISE, com), (effect,)), loaded(60, 62, 0.0, com))


def test_another_centre_is_found_and_predicts_other_poses() -> None:
    assert found(loaded(80, 61, NOISE, FAR)) == (PayloadCompliance(("j2",), "uncertain"),)
    assert error_at_other_poses(PayloadCompliance(("j2",), "uncertain"), FAR) < 1.2e-5
    assert error_at_other_poses(PayloadCompliance(("j2",)), FAR) > 2.4e-5


@pytest.mark.slow
def test_a_centre_at_the_tool_costs_no_accuracy() -> None:
    (effect,) = found(loaded(80, 61, NOISE, TOOL))
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
