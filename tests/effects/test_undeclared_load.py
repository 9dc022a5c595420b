"""A constant load at a link that the robot file does not state, on an arm with torques of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from independent_arm import DECLARED, GRAVITY, Matrix, measured, robot, run, target, torques

from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.loop import search

ARM = Arm.of(robot())
NOISE = 1e-5
COMPLIANCE = np.array([0.0, 6e-7, 8e-7, 0.0, 0.0, 0.0])


def loaded(n: int, seed: int, noise: float, link: int, mass: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joints 2 and 3 give way to its own weight and to a mass at link ``link``, from 0."""

    def extra(frames: list[Matrix]) -> float:
        return mass * GRAVITY * float((frames[link] @ np.append(com, 1.0))[2])

    poses = run(n, seed)
    torque = np.array([torques(q, extra) for q in poses.q.T]).T
    position = np.array([target(q) for q in (poses.q + COMPLIANCE[:, None] * torque).T]).T
    return measured(poses, position, noise, seed)


def arm_that_states(link: int, mass: float, com: Matrix) -> Arm:
    """The arm of a file that has the load in its link."""
    joints = list(robot().joints)
    joint = joints[link]
    own, total = np.array(joint.com), float(joint.mass or 0.0) + mass
    together = tuple(((joint.mass or 0.0) * own + mass * com) / total)
    joints[link] = dataclasses.replace(joint, mass=total, com=together)
    return Arm.of(dataclasses.replace(robot(), joints=tuple(joints)))


def error_at_other_poses(arm: Arm, effects: tuple, data: Measurements, fresh: Measurements) -> float:
    """RMS error (m) of a fit at poses that it has not seen and that have no noise."""
    result = fit(Model(arm, free=(*build(parse_requests(DECLARED), arm, data), *effects)), data, Options())
    predicted = result.model.bind(fresh).poses(result.theta).translation
    return float(np.sqrt(np.mean(np.sum(np.square(fresh.position - predicted), axis=0))))


@pytest.mark.parametrize(
    ("link", "mass", "com"),
    [
        pytest.param(2, 12.0, (0.05, 0.1, 0.1), id="valve block on the upper arm", marks=pytest.mark.slow),
        pytest.param(5, 15.0, (0.1, 0.05, 0.2), id="tool"),
    ],
)
def test_an_undeclared_load_is_named_and_the_fit_reaches_the_floor(link: int, mass: float, com: tuple) -> None:
    place = np.array(com)
    data, fresh = loaded(80, 1, NOISE, link, mass, place), loaded(60, 2, 0.0, link, mass, place)
    effects = search(Model(ARM, free=build(parse_requests(DECLARED), ARM, data)), data, empirical=False).effects
    assert {(effect.name, effect.joints) for effect in effects} == {
        ("joint_compliance", ("j2",)),
        ("joint_compliance", ("j3",)),
    }
    uncertain = [effect for effect in effects if effect.settings() == {"masses": "uncertain"}]
    assert uncertain
    assert "a link carries a load that it does not state" in str(uncertain[0].statement(ARM, {}))
    springs = build(parse_requests("joint_compliance[j2],joint_compliance[j3]"), ARM, data)
    floor = error_at_other_poses(arm_that_states(link, mass, place), springs, data, fresh)
    # Up to 40 corrections of masses in place of none cost a third of the floor at 80 poses.
    assert error_at_other_poses(ARM, effects, data, fresh) < 1.4 * floor
    assert error_at_other_poses(ARM, springs, data, fresh) > 1.4 * floor
