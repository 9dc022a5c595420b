"""Standard errors of compliances: they include the uncertainty of the masses, and cover the truth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.effects.elastic import JointCompliance
from robacc.errors import InputError
from robacc.fitting.fit_result import Fit
from robacc.fitting.masses import with_mass_uncertainty
from robacc.fitting.parameters import parameters
from robacc.fitting.solver import fit
from robacc.fitting.warnings import fit_warnings, lack_of_fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

JOINTS = ("j2", "j3")
COMPLIANCE = {"j2": 3e-6, "j3": 8e-6}
NOISE = 2e-5


def with_masses(robot: Robot, factors: np.ndarray) -> Robot:
    joints = tuple(
        dataclasses.replace(joint, mass=None if joint.mass is None else joint.mass * factor)
        for joint, factor in zip(robot.joints, factors, strict=True)
    )
    return dataclasses.replace(robot, joints=joints)


def measured(robot: Robot, rng: np.random.Generator, n: int = 40) -> Measurements:
    """Noisy poses of an arm with compliant joints and these masses."""
    entry = {"effect": "joint_compliance", "joints": list(JOINTS), "values": COMPLIANCE}
    q = rng.uniform(-1.5, 1.5, (len(robot.variables), n))
    data = Measurements(position=np.zeros((3, n)), q=q)
    exact = predict(dataclasses.replace(robot, effects=(entry,)), data).translation
    sigma = np.full((3, n), NOISE)
    return dataclasses.replace(data, position=exact + rng.normal(0, NOISE, (3, n)), sigma_position=sigma)


def fitted(robot: Robot, data: Measurements) -> Fit:
    return fit(Model(Arm.of(robot), (), (JointCompliance(JOINTS),)), data)


def test_sensitivity_to_a_mass_is_that_of_a_fit_with_another_mass() -> None:
    robot = dataclasses.replace(arm("puma560").robot, mass_uncertainty=1.0)
    data = measured(robot, np.random.default_rng(0))
    first = fitted(robot, data)
    added = with_mass_uncertainty(first, data).covariance - first.covariance
    expected = np.zeros((2, 2))
    for i, joint in enumerate(robot.joints):
        if joint.mass:
            factors = np.ones(len(robot.joints))
            factors[i] = 1.01
            change = (fitted(with_masses(robot, factors), data).theta - first.theta) / 0.01
            expected += np.outer(change, change)
    np.testing.assert_allclose(added, expected, rtol=0.03, atol=0.03 * np.abs(expected).max())


def test_the_default_is_stated_and_the_file_can_state_another() -> None:
    robot = arm("puma560").robot
    data = measured(robot, np.random.default_rng(1))
    default = fitted(robot, data)
    texts = list(fit_warnings(default, data, lack_of_fit(default, data), default, (1.0, 1.0)))
    assert any("an uncertainty of 10 % of each link's mass" in text for text in texts)
    stds = []
    for share in (None, 0.1, 0.0):
        stated = dataclasses.replace(robot, mass_uncertainty=share)
        stated = parse_robot(robot_to_yaml(stated), "stated.yaml")
        assert stated.mass_uncertainty == share
        stds.append(parameters(with_mass_uncertainty(fitted(stated, data), data))[0].std)
    assert stds[0] == stds[1]
    assert stds[1] > 1.2 * stds[2], "10 % of a mass is as large as the noise of 40 poses"
    with pytest.raises(InputError, match=r"mass_uncertainty.*share from 0 to 1"):
        parse_robot(robot_to_yaml(robot) + "mass_uncertainty: 20\n", "wrong.yaml")
