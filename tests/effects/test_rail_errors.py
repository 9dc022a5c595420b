"""An arm on a rail that is bent and twisted: kinematics are those of the independent arm, carried by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
from independent_arm import DECLARED, TOOL, Run, link_frames, measured, robot, run

from robacc.effects.request import build, parse_requests
from robacc.fitting.solver import Options, fit
from robacc.geometry import rotation_about
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Joint
from robacc.tracing.search import search

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
    declared = build(parse_requests(DECLARED), arm, data)
    (effect,) = search(Model(arm, free=declared), data).effects
    assert str(effect) == "rail_errors[rail]"
    errors = []
    for effects in ((), (effect,)):
        result = fit(Model(arm, free=(*declared, *effects)), data, Options())
        predicted = result.model.bind(fresh).poses(result.theta).translation
        errors.append(float(np.sqrt(np.mean(np.sum(np.square(fresh.position - predicted), axis=0)))))
    assert errors[0] > 5e-5
    assert errors[1] < 2e-5


def test_a_straight_rail_is_left_alone() -> None:
    arm, data = arm_on_a_rail(), poses(90, 53, NOISE, 0.0)
    declared = build(parse_requests(DECLARED), arm, data)
    assert search(Model(arm, free=declared), data).effects == ()
