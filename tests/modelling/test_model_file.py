"""A fitted model keeps the units, comments, order and unchanged numbers of the robot file, and reads as the fit."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from robot_files import URDF_LIKE

from robacc.effects.specification import with_effect_units
from robacc.modelling.robot_file import model_text, read_robot
from robacc.robots.description import Campaign, Frame, Robot
from robacc.robots.yaml_robot import parse_robot, robot_document

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = [ROOT / "configs" / "robots" / f"{name}.yaml" for name in ("panda", "scara")]
ROBOTS += [ROOT / "robacc" / "data" / "robots" / f"{name}.yaml" for name in ("r2000ic_165f", "xarm5_lite")]

ARM = """# cell 7
robacc: 1
name: cell 7
identity: {customer: Example, serial_number: 1234}   # as on the order
convention: standard
units: {length: mm, angle: deg}
tool: {xyz: [40, 0, 180]}  # nest 1
joints:
  # the base turns
  - {name: j1, type: revolute, d: 486.5, a: 150, alpha: -90, limits: [-180, 180], mass: 95, com: [-60, 40, -20]}
  - name: j2
    type: prismatic
    theta: 30.0      # drawing 12-3
    d: 0
    a: 700
    alpha: 0
    limits: [0, 500]
    coupling: {j1: 2.5}
effects:
  # measured in March
  - {effect: backlash, joints: [j1], values: {j1: 0.01}}
  - {effect: joint_correction, joints: [j1], drivers: [j2], range: [[0, 250]], degree: 3,
     values: {j1.j2.T2: 0.01}, validity: {j2: [0, 250]}}
"""


def numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [number for item in value.values() for number in numbers(item)]
    if isinstance(value, list | tuple):
        return [number for item in value for number in numbers(item)]
    return [value] if isinstance(value, float) else []


def assert_same(first: Robot, second: Robot) -> None:
    documents = [robot_document(with_effect_units(robot)) for robot in (first, second)]
    values = [np.array(numbers(document)) for document in documents]
    # Twelve digits of 150 degrees or millimetres.
    np.testing.assert_allclose(*values, rtol=1e-11, atol=1e-11)
    assert [str(document.keys()) for document in documents[:1]] == [str(document.keys()) for document in documents[1:]]


def fitted(robot: Robot) -> Robot:
    """Return a robot with other numbers in every place that a fit changes."""
    random = np.random.default_rng(1)
    joints = tuple(
        dataclasses.replace(
            joint, parameters={name: value + 1e-3 * random.normal() for name, value in joint.parameters.items()}
        )
        for joint in robot.joints
    )
    frame = Frame((0.001, 0.0, -0.5), (0.0, 0.25, 0.0))
    entry = {"effect": "backlash", "joints": [robot.variable_names[-1]], "values": {robot.variable_names[-1]: 1e-4}}
    return dataclasses.replace(
        with_effect_units(robot),
        joints=joints,
        base=frame,
        effects=(*with_effect_units(robot).effects, entry),
        fitted_to=("0" * 64,),
        fit={"names": ["a", "b"], "values": [1e-3, 2.5]},
        campaign=Campaign(("0" * 64,), base=frame),
    )


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_models_of_every_robot_file_read_as_the_fit(path: Path) -> None:
    robot = fitted(read_robot(path))
    text = model_text(robot, ("made by a test",))
    assert_same(parse_robot(text, "model.yaml"), robot)
    lines = text.splitlines()
    assert lines.pop(0) == "# made by a test"
    if "#" in path.read_text(encoding="utf-8"):
        assert lines.pop(0) == "# the comments below are those of the robot file before the fit"
    comments = [line for line in path.read_text(encoding="utf-8").splitlines() if line.lstrip().startswith("#")]
    assert [line for line in lines if line.lstrip().startswith("#")] == comments


def test_a_model_differs_from_its_file_by_what_was_fitted_alone() -> None:
    robot = parse_robot(ARM, "arm.yaml")
    joint = robot.joints[1]
    changed = dataclasses.replace(joint, parameters={**joint.parameters, "d": 0.0125, "theta": math.radians(30.5)})
    si = with_effect_units(robot)
    entry = {"effect": "joint_compliance", "joints": ["j1"], "values": {"j1": math.radians(5e-5)}}
    model = dataclasses.replace(
        si, joints=(robot.joints[0], changed), tool=Frame((0.0402, 0.0, 0.18)), effects=(*si.effects, entry)
    )
    expected = (
        ARM.replace("30.0 ", "30.5 ").replace("d: 0\n", "d: 12.5\n").replace("[40, 0", "[40.2, 0")
        + "  - effect: joint_compliance\n    joints: [j1]\n    values: {j1: 5.0e-05}\n"
    )
    remark = "# the comments below are those of the robot file before the fit\n"
    assert model_text(model) == remark + expected
    assert model_text(robot) == remark + ARM
    # A model that is fitted again has the remark once.
    assert model_text(parse_robot(remark + ARM, "arm.yaml")) == remark + ARM
    assert_same(parse_robot(expected, "arm.yaml"), model)


def test_effects_that_a_fit_absorbs_leave_the_file() -> None:
    robot = parse_robot(ARM, "arm.yaml")
    without = dataclasses.replace(with_effect_units(robot), effects=())
    text = model_text(without)
    assert "# drawing 12-3" in text
    assert parse_robot(text, "arm.yaml").effects == ()


def test_a_part_of_an_older_fit_does_not_stay() -> None:
    robot = parse_robot(ARM + "fit: {old: 1, names: [x]}   # of May\n", "arm.yaml")
    text = model_text(dataclasses.replace(with_effect_units(robot), fit={"names": ["y", "z"], "new": 2.0}))
    assert "old" not in text
    assert parse_robot(text, "arm.yaml").fit == {"names": ["y", "z"], "new": 2.0}
    assert "# nest 1" in text


def test_joints_of_a_urdf_kept_as_a_robot_file() -> None:
    robot = fitted(parse_robot(URDF_LIKE, "arm.yaml"))
    text = model_text(robot)
    assert "units: {length: mm, angle: deg}" in text
    assert_same(parse_robot(text, "arm.yaml"), robot)


def test_a_robot_without_a_file_is_written_in_metres_and_radians() -> None:
    robot = dataclasses.replace(parse_robot(ARM, "arm.yaml"), file_text=None)
    text = model_text(robot)
    assert "units: {length: m, angle: rad}" in text
    assert_same(parse_robot(text, "arm.yaml"), robot)


def test_a_form_that_cannot_be_kept_is_written_anew_in_the_same_units() -> None:
    # The fit left the coupling out, which the file's joint states.
    robot = parse_robot(ARM, "arm.yaml")
    joints = (robot.joints[0], dataclasses.replace(robot.joints[1], coupling={}))
    model = dataclasses.replace(robot, joints=joints)
    text = model_text(model, ("made by a test",))
    assert text.startswith("# made by a test\nrobacc: 1\n")
    assert "units: {length: mm, angle: deg}" in text
    assert "identity: {customer: Example, serial_number: '1234'}" in text
    assert_same(parse_robot(text, "arm.yaml"), model)
