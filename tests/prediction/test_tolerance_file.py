"""The tolerance file: what it means for each convention and distribution, and every complaint about it."""

from __future__ import annotations

import math

import pytest

from robacc.errors import InputError
from robacc.prediction.predicting import ToleranceParameter, parse_tolerances, uncertain_parameters
from robacc.robots.description import DH_PARAMETERS, ORIGIN_PARAMETERS, Joint, Robot

DH = Robot(
    "dh",
    "standard",
    (
        Joint("j1", "revolute", dict.fromkeys(DH_PARAMETERS, 0.0), tolerance={"theta": 1e-3, "a": 2e-3}),
        Joint("slide", "prismatic", dict.fromkeys(DH_PARAMETERS, 0.0)),
    ),
    base_tolerance={"x": 5e-4},
)
BARE = Robot("bare", "standard", (Joint("j1", "revolute", dict.fromkeys(DH_PARAMETERS, 0.0)),))
URDF = Robot(
    "urdf",
    "urdf",
    (
        Joint("mount", "fixed", dict.fromkeys(ORIGIN_PARAMETERS, 0.0)),
        Joint("lift", "prismatic", dict.fromkeys(ORIGIN_PARAMETERS, 0.0)),
        Joint("turn", "revolute", dict.fromkeys(ORIGIN_PARAMETERS, 0.0)),
    ),
)
UNITS = "units: {length: mm, angle: deg}\n"


def read(text: str, robot: Robot = DH) -> dict[str, ToleranceParameter]:
    toleranced, _ = parse_tolerances(UNITS + text, "t.yaml", robot)
    return {parameter.name: parameter for parameter in uncertain_parameters(toleranced)}


def complaint(text: str, robot: Robot = DH) -> str:
    with pytest.raises(InputError) as caught:
        parse_tolerances(text, "t.yaml", robot)
    return str(caught.value)


def test_the_files_go_before_the_robots_own_parameter_by_parameter() -> None:
    parameters = read("all: {theta: 0.1, d: 0.2}\njoints:\n  slide: {d: 0.5}\nbase: {yaw: 0.3}\ntool: {z: 1}\n")
    assert {name: parameter.sd for name, parameter in parameters.items()} == pytest.approx(
        {
            "base.x": 5e-4,
            "base.yaw": math.radians(0.3),
            "j1.theta": math.radians(0.1),
            "j1.d": 2e-4,
            "j1.a": 2e-3,
            "slide.theta": math.radians(0.1),
            "slide.d": 5e-4,
            "tool.z": 1e-3,
        }
    )
    assert parameters["base.x"].joint is None
    assert (parameters["slide.d"].joint, parameters["slide.d"].kind, parameters["slide.d"].unit) == ("slide", "d", "m")


def test_a_zero_says_that_a_parameter_is_exact() -> None:
    assert "j1.a" not in read("joints: {j1: {a: 0}}")


@pytest.mark.parametrize(
    ("text", "divisor", "meaning"),
    [
        ("", 1.0, "normal: a tolerance t is one standard deviation, variance t²"),
        ("distribution: normal\n", 1.0, "normal: a tolerance t is one standard deviation, variance t²"),
        ("distribution: uniform\n", math.sqrt(3), "uniform: a tolerance t is the half width, variance t²/3"),
        ("distribution: limits\n", 3.0, "limits: a tolerance t is 3 standard deviations, variance (t/3)²"),
        ("distribution: limits\ncoverage: 2\n", 2.0, "limits: a tolerance t is 2 standard deviations, variance (t/2)²"),
    ],
)
def test_how_a_tolerance_becomes_a_standard_deviation(text: str, divisor: float, meaning: str) -> None:
    content = UNITS + text + "all: {d: 0.3}"
    robot, stated = parse_tolerances(content, "t.yaml", BARE)
    assert (robot.joints[0].tolerance["d"], stated) == (pytest.approx(3e-4 / divisor), meaning)


def test_a_urdf_has_tolerances_per_coordinate_of_its_origins() -> None:
    parameters = read(
        "all: {x: 0.1, yaw: 0.2}\njoints: {mount: {z: 1}, lift: {offset: 0.5}, turn: {offset: 0.5}}", URDF
    )
    # "all" is of moving joints: a fixed one often only names a frame.
    assert {name: parameter.sd for name, parameter in parameters.items()} == pytest.approx(
        {
            "mount.z": 1e-3,
            "lift.x": 1e-4,
            "lift.yaw": math.radians(0.2),
            "lift.offset": 5e-4,
            "turn.x": 1e-4,
            "turn.yaw": math.radians(0.2),
            "turn.offset": math.radians(0.5),
        }
    )
    assert {parameter.component for parameter in parameters.values()} == {"offset", "origin_length", "origin_angle"}
    assert parameters["lift.offset"].unit == "m"


def test_no_tolerance_at_all_is_an_error_that_shows_how_to_give_them() -> None:
    with pytest.raises(
        InputError, match="no parameter of bare has a tolerance, so no error can be predicted"
    ) as caught:
        uncertain_parameters(BARE)
    assert "all: {theta: 0.006, d: 0.1, a: 0.1, alpha: 0.006}" in str(caught.value)
    with pytest.raises(InputError, match=r"all: \{x: 0.1, y: 0.1, z: 0.1, offset: 0.01\}"):
        uncertain_parameters(URDF)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "t.yaml:1: expected keys with values (units, distribution, coverage, all, joints, base, tool)"),
        ("all: {d: 1}", "t.yaml:1, units: is missing"),
        ("units: {length: mm}\nall: {d: 1}", "t.yaml:1, units.angle: is missing"),
        ("units: {length: inch, angle: deg}\nall: {d: 1}", "t.yaml:1, units.length: expected m or mm, found 'inch'"),
        (UNITS, "t.yaml: no tolerance is given; add all, joints, base or tool"),
        (UNITS + "all: {d: -1}", "t.yaml:2, all.d: a tolerance cannot be negative, found '-1'"),
        (UNITS + "all: {depth: 1}", "t.yaml:2, all.depth: unknown key"),
        (UNITS + "all: {x: 1}", "t.yaml:2, all.x: unknown key"),
        (UNITS + "joints: {j1: {d: wide}}", "t.yaml:2, joints.j1.d: expected a number, found 'wide'"),
        (UNITS + "joints: {j11: {d: 1}}", "t.yaml:2, joints.j11: the robot has no such joint; did you mean 'j1'?"),
        (UNITS + "joints: {q: {d: 1}}", "the robot has no such joint; the joints are j1, slide"),
        (UNITS + "joints: [1]", "t.yaml:2, joints: expected names of joints with tolerances, found a list of 1"),
        (UNITS + "distribution: flat\nall: {d: 1}", "expected normal or uniform or limits, found 'flat'"),
        (
            UNITS + "coverage: 2\nall: {d: 1}",
            "t.yaml:2, coverage: applies only to limits; write distribution: limits",
        ),
        (
            UNITS + "distribution: limits\ncoverage: 0\nall: {d: 1}",
            "t.yaml:3, coverage: found 0, expected standard deviations, above 0 and at most 10",
        ),
    ],
)
def test_complaints(text: str, message: str) -> None:
    assert message in complaint(text)


def test_all_cannot_give_one_offset_to_turns_and_slides() -> None:
    text = complaint(UNITS + "all: {offset: 1}", URDF)
    assert "t.yaml:2, all.offset: offset is an angle of revolute joints and a length of prismatic joints" in text


def test_all_problems_are_reported_at_once() -> None:
    text = complaint(UNITS + "all: {d: -1}\njoints: {j9: {d: 1}}\nbase: {w: 1}\n")
    assert len(text.splitlines()) == 3
