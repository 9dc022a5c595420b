"""An arm on a rail that is bent and twisted: kinematics are those of the independent arm, carried by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
from independent_arm import TOOL, Run, link_frames, measured, robot, run
from searched import error_at, fitted, found, searched

from robacc.geometry import rotation_about
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Joint

NOISE = 1e-5
LENGTH = 3.0


def arm_on_a_rail() -> Arm:
    """The arm on a slide along the measuring frame's z, as a table has it: a prismatic row first."""
    described = robot()
    parameters = dict.fromkeys(("theta", "d", "a", "alpha"), 0.0)
    slide = Joint("rail", "prismatic", parameters, limits=(0.0, LENGTH), axis=(0.0, 0.0, 1.0))
    return Arm.of(dataclasses.replace(described, joints=(slide, *described.joints)))


def carried(travel: float, q: np.ndarray, size: float) -> np.ndarray:
    """Target of the arm on a carriage that follows a bent and twisted rail."""
    u = travel / LENGTH
    shift = size * np.array([2e-4 * np.sin(np.pi * u), 1e-4 * np.cos(3 * u), 0.0])
    turn = rotation_about(0, size * 1e-4 * np.sin(4 * u)) @ rotation_about(2, size * 1.5e-4 * u**2)
    return np.array([0.0, 0.0, travel]) + shift + turn @ (link_frames(q)[-1] @ np.append(TOOL, 1.0))[:3]


def poses(n: int, seed: int, noise: float, size: float) -> Measurements:
    arm_poses = run(n, seed)
    travel = np.random.default_rng(seed).uniform(0, LENGTH, n)
    position = np.array([carried(t, q, size) for t, q in zip(travel, arm_poses.q.T, strict=True)]).T
    joints = Run(np.vstack([travel, arm_poses.q]), arm_poses.direction, arm_poses.time)
    return measured(joints, position, noise, seed)


def test_a_rails_curves_are_found_and_predict_other_poses() -> None:
    arm, data, fresh = arm_on_a_rail(), poses(140, 51, NOISE, 1.0), poses(60, 52, 0.0, 1.0)
    effects, _, error = searched(data, fresh, arm)
    assert [str(effect) for effect in effects] == ["rail_errors[rail]"]
    assert error < 2e-5
    assert error_at(fitted(data, (), arm), fresh) > 5e-5


def test_a_straight_rail_is_left_alone() -> None:
    assert found(poses(90, 53, NOISE, 0.0), arm_on_a_rail()) == ()
