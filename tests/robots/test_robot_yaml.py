"""The robot file: what it says, and the way back, bit for bit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings, strategies as st
from robot_files import MINIMAL, URDF_LIKE, edit

from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import build_chain
from robacc.robots.description import Frame, Joint, Mimic, Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

PROJECT = Path(__file__).resolve().parents[2]
CONFIGS = sorted((PROJECT / "configs" / "robots").glob("*.yaml"))


def test_a_file_says_what_it_says() -> None:
    robot = parse_robot(MINIMAL, "arm.yaml")
    first, second = robot.joints
    assert (robot.name, robot.convention, robot.gravity) == ("arm", "standard", (0, 0, -9.81))
    assert (robot.base, robot.tool, robot.payload_com, robot.targets) == (Frame(), Frame(), None, {})
    assert first.parameters == {"theta": 0.1, "d": 0.5, "a": 0.2, "alpha": -1.5, "beta": 0.0}
    assert (first.limits, first.mass, first.com, first.sign, first.gear_ratio) == ((-1, 2), 2.0, (0, 0, 0.1), 1, None)
    assert (second.name, second.type, second.limits, second.mass) == ("j2", "prismatic", None, None)


def test_everything_optional_is_read() -> None:
    text = edit(MINIMAL, "joints:", "gravity: [0, 9.8, 0]\njoints:")
    text = edit(
        text, "joints:", "base: {xyz: [1, 2, 3], rpy: [0.1, 0.2, 0.3], tolerance: {x: 1e-3, yaw: 1e-4}}\njoints:"
    )
    text = edit(text, "joints:", "tool: {xyz: [0, 0, .1], tolerance: {z: 0.002}}\npayload: {com: [0, 0, 0.2]}\njoints:")
    text = edit(
        text, "    mass: 2", "    sign: -1\n    gear_ratio: 100\n    tolerance: {theta: 1e-4, beta: 2E-4}\n    mass: 2"
    )
    text += "effects:\n  - {effect: backlash, joints: [one], value: 1e-4, seen: yes, note: '7', none: ~, n: 010}\n"
    robot = parse_robot(text, "arm.yaml")
    assert robot.gravity == (0, 9.8, 0)
    assert (robot.base, robot.tool) == (Frame((1, 2, 3), (0.1, 0.2, 0.3)), Frame((0, 0, 0.1)))
    assert (robot.base_tolerance, robot.tool_tolerance) == ({"x": 1e-3, "yaw": 1e-4}, {"z": 0.002})
    assert robot.payload_com == (0, 0, 0.2)
    first = robot.joints[0]
    assert (first.sign, first.gear_ratio, first.tolerance) == (-1, 100, {"theta": 1e-4, "beta": 2e-4})
    assert robot.effects == (
        {"effect": "backlash", "joints": ["one"], "value": 1e-4, "seen": True, "note": "7", "none": None, "n": 10},
    )


def test_targets_stand_instead_of_a_tool() -> None:
    text = edit(
        MINIMAL, "joints:", "targets: {a: {xyz: [0.05, 0, 0.1]}, b: {xyz: [0, 0, 0.1], rpy: [0, 0, 1]}}\njoints:"
    )
    robot = parse_robot(text, "arm.yaml")
    assert robot.targets == {"a": Frame((0.05, 0, 0.1)), "b": Frame((0, 0, 0.1), (0, 0, 1))}


def test_units_hold_for_every_number_but_masses_and_gravity() -> None:
    text = """robacc: 1
convention: modified
units: {length: mm, angle: deg}
gravity: [0, 0, -9.81]
base: {xyz: [1000, 0, 0], rpy: [0, 0, 90], tolerance: {x: 1, yaw: 1}}
targets: {a: {xyz: [0, 0, 50], rpy: [180, 0, 0]}}
payload: {com: [0, 0, 100]}
joints:
  - {type: revolute, theta: 45, d: 500, a: 200, alpha: -90, beta: 1, limits: [-180, 180], mass: 3, com: [1, 2, 3],
     tolerance: {theta: 1, d: 1}}
  - {type: prismatic, theta: 90, d: 100, a: 0, alpha: 90, limits: [0, 500]}
"""
    robot = parse_robot(text, "folder/my arm.yaml")
    deg = math.pi / 180
    first, second = robot.joints
    assert robot.name == "my arm"
    assert first.parameters == {"theta": 45 * deg, "d": 0.5, "a": 0.2, "alpha": -90 * deg, "beta": deg}
    assert first.limits == pytest.approx((-math.pi, math.pi), abs=1e-15)
    assert second.limits == (0, 0.5)
    assert (first.mass, first.com) == (3, (0.001, 0.002, 0.003))
    assert first.tolerance == {"theta": deg, "d": 0.001}
    assert (robot.base.xyz, robot.base.rpy) == ((1, 0, 0), (0, 0, 90 * deg))
    assert robot.base_tolerance == {"x": 0.001, "yaw": deg}
    assert robot.targets["a"] == Frame((0, 0, 0.05), (180 * deg, 0, 0))
    assert (robot.payload_com, robot.gravity) == ((0, 0, 0.1), (0, 0, -9.81))
    assert robot.effect_units == (1e-3, deg)


def test_urdf_joints() -> None:
    robot = parse_robot(URDF_LIKE, "arm.yaml")
    deg = math.pi / 180
    stand, turn, slide, copy = robot.joints
    assert (robot.base_link, robot.tip_link) == ("foot", "hand")
    assert (stand.type, stand.link, stand.parameters["z"], stand.mass) == ("fixed", "foot2", 0.1, 1)
    assert (turn.type, turn.axis, turn.limits) == ("revolute", (0, 0, 1), None)
    assert (turn.parameters["pitch"], turn.parameters["offset"]) == (90 * deg, 10 * deg)
    assert turn.tolerance == {"offset": deg, "x": 0.001}
    assert (slide.parameters["offset"], slide.tolerance) == (0.005, {"offset": 0.001})
    # Two mm for each degree of the master, three mm besides.
    assert copy.mimic == Mimic("turn", pytest.approx(0.002 / deg), pytest.approx(0.003))
    assert robot.variable_names == ("turn", "slide")
    assert build_chain(robot).n_joints == 2


def test_numbers_that_yaml_1_1_reads_otherwise() -> None:
    for written, value in [("1e-4", 1e-4), ("010", 10.0), ("+.5", 0.5), ("1.", 1.0), ("-2E+0", -2.0)]:
        assert parse_robot(edit(MINIMAL, "d: 0.5", f"d: {written}"), "x").joints[0].parameters["d"] == value


finite = st.floats(-6, 6)


@st.composite
def robots(draw: st.DrawFn) -> Robot:
    convention = draw(st.sampled_from(["standard", "modified", "urdf"]))
    dh, urdf = ("theta", "d", "a", "alpha", "beta"), ("x", "y", "z", "roll", "pitch", "yaw", "offset")
    names = urdf if convention == "urdf" else dh
    vector = st.tuples(finite, finite, finite)
    joints = []
    for i in range(draw(st.integers(1, 3))):
        mass = draw(st.none() | st.floats(0, 100))
        axis = np.add(draw(vector), (0, 0, 10)) if convention == "urdf" else np.array([0.0, 0, 1])
        joints.append(
            Joint(
                name=draw(st.sampled_from(["j", "achse ü", "1", "yes", "#", "a: b"])) + str(i),
                type=draw(st.sampled_from(["revolute", "prismatic"])),
                parameters={name: draw(finite) for name in names},
                axis=tuple(float(value) for value in axis / np.linalg.norm(axis)),
                limits=draw(st.none() | st.tuples(st.floats(-3, 0), st.floats(0, 3))),
                sign=draw(st.sampled_from([1, -1])),
                gear_ratio=draw(st.none() | st.floats(1e-3, 1e3)),
                mass=mass,
                com=None if mass is None else draw(vector),
                tolerance={name: draw(st.floats(0, 1e-2)) for name in draw(st.sets(st.sampled_from(names)))},
            )
        )
    frames = st.builds(Frame, vector, vector)
    return Robot(
        name=draw(st.sampled_from(["arm", "007", "null", "a # b"])),
        convention=convention,  # type: ignore[arg-type]
        joints=tuple(joints),
        base=draw(frames),
        tool=draw(frames),
        gravity=draw(vector),
        payload_com=draw(st.none() | vector),
        effects=tuple(
            draw(st.lists(st.fixed_dictionaries({"effect": st.just("backlash"), "value": finite}), max_size=2))
        ),
        base_tolerance={"x": draw(st.floats(0, 1))},
        tool_tolerance={"yaw": draw(st.floats(0, 1))},
        base_link=draw(st.none() | st.just("base")),
    )


@given(robots())
@settings(max_examples=60, deadline=None)
def test_written_and_read_again_is_the_same_bit_for_bit(robot: Robot) -> None:
    text = robot_to_yaml(robot, ["fitted\non two lines", ""])
    assert text.startswith("# fitted\n# on two lines\n")
    assert parse_robot(text, "arm.yaml") == robot
    # Any other reader of YAML takes the numbers for numbers too.
    assert all(isinstance(value, float) for joint in yaml.safe_load(text)["joints"] for value in joint.get("com", []))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_projects_arms_are_read_and_written(path: Path) -> None:
    robot = read_robot(path)
    reread = parse_robot(robot_to_yaml(robot), path.name)
    assert replace(reread, effect_units=robot.effect_units) == robot
    q = np.random.default_rng(0).uniform(-2, 2, (len(robot.variables), 10))
    np.testing.assert_array_equal(build_chain(reread).forward(q).matrices(), build_chain(robot).forward(q).matrices())
    assert all(joint.limits and joint.tolerance for joint in robot.joints)


def test_there_are_six_arms_of_every_kind() -> None:
    robots = {path.stem: read_robot(path) for path in CONFIGS}
    assert set(robots) >= {"puma560", "stanford", "ur10", "irb1600", "panda", "scara"}
    assert {robot.convention for robot in robots.values()} == {"standard", "modified"}
    assert [joint.type for joint in robots["scara"].joints] == ["revolute", "revolute", "prismatic", "revolute"]


def test_targets_and_mimics_are_written() -> None:
    robot = replace(parse_robot(URDF_LIKE, "x"), targets={"a": Frame((0, 0, 0.1))}, effect_units=(1.0, 1.0))
    assert parse_robot(robot_to_yaml(robot), "x") == robot


def test_numpy_numbers_and_shared_lists_are_written_plainly() -> None:
    shared = [np.float64(0.5), 1]
    effect = {"effect": "x", "a": shared, "b": shared, "c": np.array([1.0, 2.0]), "d": (np.int64(3),)}
    robot = replace(parse_robot(MINIMAL, "x"), effects=(effect,), gravity=tuple(np.array([0, 0, -9.8])))
    reread = parse_robot(robot_to_yaml(robot), "x")
    assert reread.effects == ({"effect": "x", "a": [0.5, 1], "b": [0.5, 1], "c": [1.0, 2.0], "d": [3]},)


def test_effects_in_other_units_are_not_written_as_if_they_were_si() -> None:
    robot = replace(parse_robot(MINIMAL, "x"), effect_units=(1e-3, 1.0))
    assert "effects" not in robot_to_yaml(robot)
    with pytest.raises(ValueError, match="convert effects to the units of the file"):
        robot_to_yaml(replace(robot, effects=({"effect": "backlash"},)))
