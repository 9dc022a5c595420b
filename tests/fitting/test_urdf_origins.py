"""Corrections of a URDF's origins: full rank at any pitch, exact when written, and able to describe any made arm."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from robot_files import example_robots
from scipy.spatial.transform import Rotation
from slow_parameters import some_fast

from robacc.effects.frames import BaseFrame, LinkGeometry
from robacc.effects.specification import entry_of, parse_requests
from robacc.errors import InputError
from robacc.fitting.parameters import absorb_constants, apply_fit, parameters
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.tracing.calibrating import calibrate

ARMS = (
    "ur_description/urdf/ur10_robot.urdf",
    "ur_description/urdf/ur10_joint_limited_robot.urdf",
    "ur_description/urdf/ur3_robot.urdf",
    "ur_description/urdf/ur3_gripper.urdf",
    "ur_description/urdf/ur3_joint_limited_robot.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "ur_description/urdf/ur5_gripper.urdf",
    "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "baxter_description/urdf/baxter.urdf",
    "tiago_description/robots/tiago_no_hand.urdf",
    "hyq_description/robots/hyq_no_sensors.urdf",
    "panda_description/urdf/panda.urdf",
    "kinova_description/robots/kinova.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "z1_description/urdf/z1.urdf",
    "so_arm_description/urdf/so100.urdf",
    "talos_data/robots/talos_left_arm.urdf",
    "pr2_description/urdf/pr2.urdf",
    "romeo_description/urdf/romeo_small.urdf",
    "anymal_b_simple_description/robots/anymal-kinova.urdf",
)
"""Twenty arms; the first eleven have origins at a pitch of 90 degrees."""
POSITION_STD, ORIENTATION_STD = 2e-5, 2e-5
TOOL = Frame((0.05, 0.02, 0.1), (0.1, -0.2, 0.3))


def read_any_chain(path: Path) -> Robot | None:
    """The longest chain, or the first of those equally long; None of a file without a serial chain."""
    try:
        return read_robot(path)
    except InputError as error:
        if "the tree ends at " not in str(error):
            return None
        leaf = str(error).split("the tree ends at ")[1].split(",")[0].split(" ")[0]
    try:
        return read_robot(path, tip_link=leaf)
    except InputError:
        return None


def simulate(path: Path, robot: Robot, n: int, seed: int) -> tuple[Measurements, np.ndarray]:
    """Poses of an arm made with errors of 0.5 mm and 0.5 mrad in every origin, by kinematics from the XML itself."""
    rng = np.random.default_rng(seed)
    elements = {element.get("name"): element for element in ElementTree.parse(path).getroot().findall("joint")}
    low, high = np.array([np.clip(joint.limits or (-3, 3), -3, 3) for joint in robot.variables]).T[..., None]
    q = rng.uniform(low, high, (len(robot.variables), n))
    rotation, position = Rotation.from_rotvec([0.4, -0.3, 1.0]), np.tile([0.7, -0.2, 0.4], (n, 1))
    values = dict(zip((joint.name for joint in robot.variables), q, strict=True))
    for joint in robot.joints:
        element = elements[joint.name]
        origin = element.find("origin")
        numbers = {key: (origin.get(key) if origin is not None else None) or "0 0 0" for key in ("xyz", "rpy")}
        xyz, rpy = (np.array(numbers[key].split(), dtype=float) for key in ("xyz", "rpy"))
        turn = Rotation.from_euler("xyz", rpy)
        if joint.is_variable:
            turn = turn * Rotation.from_rotvec(rng.normal(0, 5e-4, 3))
            xyz = xyz + rng.normal(0, 5e-4, 3)
        position = position + rotation.apply(xyz)
        rotation = rotation * turn
        if joint.type == "fixed":
            continue
        follows = joint.mimic
        moved = values[joint.name] if follows is None else follows.multiplier * values[follows.master] + follows.offset
        axis = np.array(joint.axis)
        if joint.type == "revolute":
            rotation = rotation * Rotation.from_rotvec(moved[:, None] * axis)
        else:
            position = position + rotation.apply(moved[:, None] * axis)
    position = position + rotation.apply(TOOL.xyz)
    rotation = rotation * Rotation.from_euler("xyz", TOOL.rpy)
    noisy = Rotation.from_rotvec(rng.normal(0, ORIENTATION_STD, (n, 3))) * rotation
    data = Measurements(
        position=(position + rng.normal(0, POSITION_STD, (n, 3))).T,
        rotation=noisy.as_matrix().transpose(1, 2, 0).copy(),
        q=q,
        sigma_position=np.full((3, n), POSITION_STD),
        sigma_rotation=np.full(n, ORIENTATION_STD),
    )
    return data, position.T


@pytest.mark.parametrize("name", some_fast(ARMS, 4))
def test_random_errors_of_every_origin_are_fitted_to_the_noise(name: str) -> None:
    robot = read_any_chain(example_robots() / name)
    robot = dataclasses.replace(robot, tool=TOOL)
    data, true = simulate(example_robots() / name, robot, 150, 7)
    requests = parse_requests("base_frame,tool_frame,joint_offset,link_geometry")
    result = calibrate(robot, data, requests, n_folds=2)
    # Mean square per coordinate, over the noise's: one for a model with every error, within five standard deviations.
    fitted = result.fit
    assert fitted.inliers.all()
    for rows, noise_std in ((slice(0, 3), POSITION_STD), (slice(3, 6), ORIENTATION_STD)):
        mean_square = float(np.mean(np.square(fitted.residual[rows]))) / noise_std**2
        dof_share = 1.0 - fitted.identifiability.columns.size / (6 * 150)
        assert abs(mean_square / dof_share - 1.0) < 5.0 * np.sqrt(2.0 / (3 * 150))
    # Estimation adds to the true position at most the noise of as many numbers as there are coefficients.
    error = np.sqrt(np.mean(np.sum(np.square(predict(result.robot, data).translation - true), axis=0)))
    assert error < 1.5 * POSITION_STD * np.sqrt(fitted.identifiability.columns.size / 150)


def ur10() -> Robot:
    path = example_robots() / "ur_description/urdf/ur10_robot.urdf"
    return dataclasses.replace(read_robot(path, tip_link="tool0"), tool=TOOL)


def test_findings_of_one_origin_are_applied_as_they_were_fitted() -> None:
    """Turns about three axes do not commute, so single constants of one origin are written together."""
    robot = ur10()
    arm = Arm.of(robot)
    joint = arm.names[1]
    sizes = {"yaw": 3e-3, "roll": -2e-3, "pitch": 4e-3}
    effects = [LinkGeometry((joint,), (label,)) for label in sizes]
    values = [{f"link_geometry.{joint}.{label}": size} for label, size in sizes.items()]
    data = Measurements(position=np.zeros((3, 9)), q=np.random.default_rng(1).uniform(-2, 2, (6, 9)))
    for listed in (0, 1, 3):
        entries = tuple(entry_of(e, v) for e, v in zip(effects[:listed], values[:listed], strict=True))
        model = Model.of(dataclasses.replace(robot, effects=entries), effects[listed:])
        theta = np.array([value for coefficients in values[listed:] for value in coefficients.values()])
        expected = model.bind(data).poses(theta)
        exact = dataclasses.replace(data, position=expected.translation)
        fitted = dataclasses.replace(fit(model, exact), theta=theta)
        written = apply_fit(fitted) if listed < 3 else absorb_constants(model.arm.robot)
        assert not written.effects
        if listed < 3:
            assert (
                apply_fit(dataclasses.replace(fitted, theta=0.0 * theta)).joints
                == absorb_constants(model.arm.robot).joints
            )
        again = parse_robot(robot_to_yaml(written), "again.yaml")
        found = predict(again, data)
        # Rounding of the angles near the pole of roll, pitch and yaw.
        np.testing.assert_allclose(found.translation, expected.translation, rtol=0, atol=3e-15)
        np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=3e-15)


def test_a_frame_at_the_pole_has_no_standard_error_of_roll_and_yaw() -> None:
    robot = dataclasses.replace(ur10(), base=Frame((0.1, 0.2, 0.3), (0.0, np.pi / 2, 0.0)))
    rng = np.random.default_rng(5)
    q = rng.uniform(-2, 2, (6, 40))
    exact = predict(robot, Measurements(position=np.zeros((3, 40)), q=q))
    data = Measurements(position=exact.translation + rng.normal(0, 1e-5, (3, 40)), q=q)
    fitted = {p.name: p for p in parameters(fit(Model.of(robot, [BaseFrame.default(Arm.of(robot), data)]), data))}
    pitch = fitted["base_frame.pitch"]
    assert abs(pitch.value - np.pi / 2) < 5 * pitch.std + 1e-4
    for label in ("roll", "yaw"):
        assert fitted[f"base_frame.{label}"].std is None
        assert "same axis" in (fitted[f"base_frame.{label}"].why)
