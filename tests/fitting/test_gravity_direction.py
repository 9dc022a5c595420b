"""Gravity where the measuring frame is not level, or the arm leans, on an arm with torques of its own."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import DH, Matrix, link_frames, measured, run, targets
from searched import ARM, model

from robacc.fitting.registration import align, gravity_warning, with_gravity_direction
from robacc.geometry import rotation_from_rpy
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.tracing.trace import trace

NOISE = 2e-5
SPRINGS = np.array([0.0, 6e-7, 8e-7, 0.0, 0.0, 0.0])
DOWN = np.array([0.0, 0.0, -9.81])


def torques(q: Matrix, gravity: Matrix) -> Matrix:
    """Torque about each joint: the slope of the work of gravity (3,), stated in the base."""

    def work(at: Matrix) -> float:
        frames = link_frames(at)
        return sum(
            m * float(gravity @ (frame @ np.append(com, 1.0))[:3])
            for frame, (*_, m, com) in zip(frames, DH, strict=True)
        )

    step = 1e-5
    return np.array([(work(q + e) - work(q - e)) / (2 * step) for e in step * np.eye(6)])


def campaign(tilt: Matrix, gravity: Matrix, springs: Matrix = SPRINGS, n: int = 80, seed: int = 1) -> Measurements:
    """Poses of an arm under ``gravity`` in its base, in a measuring frame in which the base is turned by ``tilt``."""
    poses = run(n, seed)
    bent = np.array([q + springs * torques(q, gravity) for q in poses.q.T]).T
    return measured(poses, rotation_from_rpy(tilt) @ targets(bent), NOISE, seed)


def found(data: Measurements) -> tuple[Matrix, str | None]:
    shown = with_gravity_direction(model(data), data).arm.robot.gravity
    return np.array(shown), next(iter(gravity_warning(ARM.robot.gravity, shown)), None)


@pytest.mark.parametrize(
    "tilt",
    [(np.radians(4.0), 0.0, 0.3), (0.0, np.radians(-20.0), 2.0), (np.pi / 2, 0.0, 0.0), (np.pi, 0.0, 1.0)],
    ids=["four degrees", "twenty", "another axis up", "upside down"],
)
def test_deflections_show_where_gravity_acts_in_a_frame_that_is_not_level(tilt: tuple[float, float, float]) -> None:
    """The base stands upright; the frame of the instrument does not."""
    shown, warning = found(campaign(np.array(tilt), DOWN))
    true = rotation_from_rpy(np.array(tilt)) @ DOWN
    assert np.degrees(np.arccos(shown @ true / 9.81**2)) < 0.1
    assert "the measuring frame is not level" in warning


@pytest.mark.parametrize(
    "tilt", [(0.0, 0.0, 1.2), (np.pi / 2, 0.0, 0.0), (0.0, np.radians(30.0), 0.0), (np.pi, 0.0, 0.0)]
)
def test_an_arm_that_leans_in_a_level_frame_keeps_the_gravity_of_its_file(tilt: tuple[float, float, float]) -> None:
    """On a wall, on a slope, under a ceiling; the file does not say how the base stands."""
    shown, warning = found(campaign(np.array(tilt), rotation_from_rpy(np.array(tilt)).T @ DOWN))
    assert warning is None
    assert shown.tolist() == DOWN.tolist()


@pytest.mark.parametrize("seed", range(5))
def test_a_rigid_arm_shows_no_direction(seed: int) -> None:
    tilt = np.array([np.radians(25.0), 0.0, 0.0])
    assert found(campaign(tilt, DOWN, np.zeros(6), 40, seed))[1] is None


def test_trace_names_the_springs_and_a_model_holds_in_other_frames() -> None:
    tilt = np.array([np.radians(15.0), np.radians(-7.0), 0.4])
    data = campaign(tilt, DOWN)
    result = trace(model(data), data)
    assert {(finding.effect, finding.joints) for finding in result.findings} == {
        ("joint_compliance", ("j2",)),
        ("joint_compliance", ("j3",)),
    }
    assert any("not level" in warning for warning in result.warnings)
    other = campaign(np.array([0.0, np.radians(50.0), -1.0]), DOWN, n=30, seed=8)
    registered = align(result.robot, other, ["base_frame"])
    error = other.position - predict(registered.robot, other).translation
    assert np.sqrt(np.mean(np.sum(error**2, axis=0))) < 2.0 * NOISE * np.sqrt(3)
    assert any("not level" in note for note in registered.notes)
