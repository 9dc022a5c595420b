"""The model as a whole: values known and free, targets, elasticity against textbook statics."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import CONFIGURED, arm, circumstances
from scipy.optimize import brentq

from robacc.effects import REGISTRY
from robacc.errors import UsageError
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import DH_PARAMETERS, Frame, Joint, Robot
from robacc.simulation.simulate import Plan, simulate

GEOMETRY = ("base_frame", "tool_frame", "joint_offset", "link_geometry")


def pendulum(length: float = 1.0, mass: float = 10.0) -> Robot:
    """One joint of horizontal axis (y of the measuring frame, pointing away), a mass at the end of its link."""
    parameters = dict.fromkeys(DH_PARAMETERS, 0.0) | {"a": length}
    joint = Joint("j1", "revolute", parameters, mass=mass, com=(0.0, 0.0, 0.0))
    # Rx(90 deg) turns the axis to -y of the measuring frame: a positive angle lifts the mass.
    return Robot("pendulum", "standard", (joint,), base=Frame(rpy=(np.pi / 2, 0.0, 0.0)))


def at(*angles: float) -> Measurements:
    return Measurements(position=np.zeros((3, len(angles))), q=np.array([angles]))


def test_a_pendulum_sags_to_the_equilibrium_of_statics() -> None:
    # theta = q - c m g l cos(theta), solved here by bisection, independently of the sweeps.
    compliance, weight = 2e-3, 10.0 * 9.81
    entry = {"effect": "joint_compliance", "joints": ["j1"], "values": {"j1": compliance}}
    robot = dataclasses.replace(pendulum(), effects=(entry,))
    commanded = (0.0, 0.4, 1.2, -0.7)
    predicted = predict(robot, at(*commanded)).translation
    for i, q in enumerate(commanded):
        low, high = q - 1.0, q + 1.0
        for _ in range(100):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if middle < q - compliance * weight * np.cos(middle) else (low, middle)
        np.testing.assert_allclose(predicted[:, i], [np.cos(low), 0.0, np.sin(low)], rtol=0, atol=1e-13)


def test_a_pendulum_of_the_rigid_form_sags_by_the_moment_where_it_was_commanded() -> None:
    # theta = q + e + c tau(q + e): the zero error e moves the moment, what the joint gives way to does not.
    compliance, weight, zero = 2e-3, 10.0 * 9.81, 0.1
    rigid = {"joints": ["j1"], "deflection": "rigid"}
    entries = (
        {"effect": "joint_offset", "joints": ["j1"], "values": {"j1": zero}},
        {"effect": "joint_compliance", **rigid, "values": {"j1": compliance}},
    )
    robot = dataclasses.replace(pendulum(), effects=entries)
    commanded = np.array([0.0, 0.4, 1.2, -0.7])
    predicted = predict(robot, at(*commanded)).translation
    turned = commanded + zero - compliance * weight * np.cos(commanded + zero)
    np.testing.assert_allclose(predicted, [np.cos(turned), 0 * turned, np.sin(turned)], rtol=0, atol=1e-15)


def test_an_equilibrium_sees_the_deflections_of_the_rigid_form_and_not_the_other_way_round() -> None:
    compliance, weight, q = 2e-3, 10.0 * 9.81, 0.4
    first = {"effect": "joint_compliance", "joints": ["j1"], "deflection": "rigid", "values": {"j1": compliance}}
    second = {"effect": "payload_compliance", "joints": ["j1"], "values": {"j1": compliance}}
    robot = dataclasses.replace(pendulum(), effects=(second, first), payload_com=(0.0, 0.0, 0.0))
    data = dataclasses.replace(at(q), payload=np.array([10.0]))
    predicted = predict(robot, data).translation[:, 0]
    sag = compliance * weight * np.cos(q)
    angle = brentq(lambda t: t - (q - sag - compliance * weight * np.cos(t)), -1.0, 1.0, xtol=1e-15)
    np.testing.assert_allclose(predicted, [np.cos(angle), 0.0, np.sin(angle)], rtol=0, atol=1e-13)


def test_a_payload_where_the_file_puts_it_sags_the_joint_and_none_does_not() -> None:
    entry = {"effect": "payload_compliance", "joints": ["j1"], "values": {"j1": 1e-5}}
    robot = dataclasses.replace(pendulum(), effects=(entry,), payload_com=(0.5, 0.0, 0.0))
    data = dataclasses.replace(at(0.0, 0.0), payload=np.array([0.0, 4.0]))
    height = predict(robot, data).translation[2]
    assert height[0] == 0.0
    # 4 kg at 1.5 m: first order c m g r, the second is 1e-7 of a 6e-4 rad turn.
    assert height[1] == pytest.approx(-1e-5 * 4 * 9.81 * 1.5, rel=1e-5)


def test_a_base_and_a_bearing_tilt_the_way_gravity_pulls() -> None:
    for effect, entry in (
        ("base_compliance", {"values": {"value": 1e-5}}),
        ("lateral_compliance", {"joints": ["j1"], "values": {"j1": 1e-5}}),
    ):
        # An axis that stands upright feels the weight as a bending moment alone, and so does the pedestal.
        robot = dataclasses.replace(pendulum(), base=Frame(), effects=({"effect": effect, **entry},))
        height = predict(robot, at(0.0)).translation[2, 0]
        assert height == pytest.approx(-1e-5 * 10 * 9.81, rel=1e-5), effect


@pytest.mark.parametrize("name", ["stanford", "scara", "urdf:stanford"])
def test_a_slides_travel_grows_with_the_links_unless_its_scale_does_not(name: str) -> None:
    """At the temperature that makes every length a thousandth longer the whole arm is as if drawn larger."""
    robot_arm = arm(name)
    bare = dataclasses.replace(robot_arm.robot, base=Frame(), tool=Frame(), targets={}, effects=())
    data = dataclasses.replace(circumstances(bare, 7), temperature=np.full(7, 120.0))
    nominal = predict(bare, data).translation
    entry = {"effect": "thermal_expansion", "values": {"value": 1e-5}}
    grown = predict(dataclasses.replace(bare, effects=(entry,)), data).translation
    np.testing.assert_allclose(grown, 1.001 * nominal, rtol=0, atol=1e-12)
    fixed = predict(dataclasses.replace(bare, effects=({**entry, "slides": False},)), data).translation
    assert data.q is not None
    slide = [joint.type for joint in bare.variables].index("prismatic")
    step = 1e-6
    moved = dataclasses.replace(data, q=data.q + step * np.eye(len(data.q))[:, [slide]])
    direction = (predict(bare, moved).translation - nominal) / step
    travel = robot_arm.chain.scalars(data.q)[robot_arm.chain.drives[slide].motion]
    np.testing.assert_allclose(grown - fixed, 1e-3 * travel * direction, rtol=0, atol=1e-8)


def test_a_known_value_and_the_same_one_free_predict_the_same() -> None:
    robot_arm = arm("puma560")
    data = circumstances(robot_arm.robot, 9)
    for name, values in (("gear_ratio", {"j2": 1e-3}), ("joint_compliance", {"j2": 1e-4}), ("backlash", {"j3": 1e-3})):
        entry = {"effect": name, "joints": list(values), "values": values}
        known = predict(dataclasses.replace(robot_arm.robot, effects=(entry,)), data)
        free = Model.of(robot_arm.robot, [REGISTRY[name].default(robot_arm, data, tuple(values))]).bind(data)
        np.testing.assert_array_equal(free.poses(np.array(list(values.values()))).translation, known.translation)


def test_poses_that_do_not_fit_the_robot_are_refused() -> None:
    robot_arm = arm("puma560")
    data = circumstances(robot_arm.robot, 3)
    with pytest.raises(UsageError, match="needs the column q1 … qN"):
        predict(robot_arm.robot, dataclasses.replace(data, q=None))
    with pytest.raises(UsageError, match="the robot has 6 joints, but the poses have 5"):
        predict(robot_arm.robot, dataclasses.replace(data, q=data.q[:5]))


def test_each_target_is_the_tool_of_its_rows() -> None:
    robot_arm = arm("targets:puma560")
    data = circumstances(robot_arm.robot, 12)
    both = predict(robot_arm.robot, data).translation
    for name, frame in robot_arm.robot.targets.items():
        alone = dataclasses.replace(robot_arm.robot, targets={}, tool=frame)
        rows = data.target == name
        # Same motions, constant here and one array there: rounding of a metre.
        np.testing.assert_allclose(both[:, rows], predict(alone, data).translation[:, rows], rtol=0, atol=1e-14)
    with pytest.raises(UsageError, match="the robot has the targets a, b; add a column target to the poses"):
        predict(robot_arm.robot, dataclasses.replace(data, target=None))


def measured(robot: Robot, n: int, *, orientation: bool = True) -> Measurements:
    plan = Plan(n, seed=4, noise_position=2e-5, noise_orientation=2e-5, orientation=orientation, payloads=(0.0, 3.0))
    return simulate(robot, plan).data


@pytest.mark.parametrize("name", CONFIGURED)
def test_number_of_identifiable_geometric_parameters(name: str) -> None:
    # 4 R + 2 P + 6: Everett, Driels, Mooring 1987. Of a point three of the tool's six cannot be seen.
    robot_arm = arm(name)
    revolute = sum(joint.type == "revolute" for joint in robot_arm.robot.variables)
    full = 4 * revolute + 2 * (len(robot_arm.names) - revolute) + 6
    for orientation, expected in ((True, full), (False, full - 3)):
        data = measured(robot_arm.robot, 60, orientation=orientation)
        free = [REGISTRY[effect].default(robot_arm, data) for effect in GEOMETRY]
        identified = fit(Model.of(robot_arm.robot, free), data).identifiability
        assert identified.columns.size == expected
        assert len(identified.dropped) == sum(len(e.terms(robot_arm, data)) for e in free) - expected
        assert all(why.why for why in identified.dropped)
