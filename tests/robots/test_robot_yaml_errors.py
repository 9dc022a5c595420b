"""The robot file: what is refused, with line and key, and the likely cause."""

from __future__ import annotations

from pathlib import Path

import pytest
from robot_files import MINIMAL, URDF_LIKE, edit

from robacc.errors import MAX_PROBLEMS, InputError
from robacc.robots.yaml_robot import parse_robot

PROJECT = Path(__file__).resolve().parents[2]


def problem(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_robot(text, "arm.yaml")
    return str(caught.value)


BAD = [
    ("robacc: 1", "robacc: 2", "arm.yaml:1, robacc: expected format version 1, found '2'"),
    (
        "robacc: 1\n",
        "",
        "robacc: the format version is missing, so this is not a robot file of robacc; write 'robacc: 1'",
    ),
    (
        "standard",
        "standart",
        "arm.yaml:3, convention: expected standard or modified or urdf, found 'standart'; did you",
    ),
    ("convention: standard\n", "", "convention: is missing"),
    ("units: {length: m, angle: rad}\n", "", "arm.yaml:1, units: is missing"),
    ("angle: rad", "angle: grad", "arm.yaml:4, units.angle: expected rad or deg, found 'grad'; did you mean 'rad'?"),
    (", angle: rad", "", "arm.yaml:4, units.angle: is missing"),
    ("length: m,", "length: inch,", "units.length: expected m or mm, found 'inch'"),
    ("{length: m, angle: rad}", "m", "units: expected keys with values (length, angle), found 'm'"),
    ("name: arm", "name: [1]", "arm.yaml:2, name: expected a name, found a list of 1"),
    ("name: arm", "nmae: arm", "arm.yaml:2, nmae: unknown key; did you mean 'name'?"),
    ("name: arm", "qwertz: 1", "qwertz: unknown key; known keys: robacc, name, convention"),
    ("name: arm", "name: arm\nname: leg", "arm.yaml:3, name: is given twice, first in line 2"),
    ("name: arm", "[1, 2]: arm", "arm.yaml:2: expected a plain name as a key"),
    (
        "name: arm",
        "gravity: [0, 0, -9810]",
        "gravity: [0.0, 0.0, -9810.0] is too large for gravity; it is always in m/s^2",
    ),
    ("name: arm", "gravity: [0, 0]", "gravity: expected a list of 3 numbers, found a list of 2"),
    ("name: arm", "gravity: down", "gravity: expected a list of 3 numbers, found 'down'"),
    ("name: arm", "base: {xyz: [0, 0, up]}", "arm.yaml:2, base.xyz[2]: expected a number, found 'up'"),
    ("name: arm", "base: {xyz: [0, 0, 1200]}", "base.xyz[2]: 1200 is 1200 m, too long for an arm; it looks like mm"),
    ("name: arm", "tool: {rpy: [0, 0, 90]}", "tool.rpy[2]: 90 rad is more than a turn; it looks like degrees"),
    ("name: arm", "tool: {tolerance: {w: 1}}", "tool.tolerance.w: unknown key; known keys: x, y, z, roll, pitch, yaw"),
    ("name: arm", "payload: {mass: 1}", "payload.mass: unknown key; known keys: com"),
    ("name: arm", "payload: {}", "payload.com: is missing"),
    ("name: arm", "targets: {}", "targets: expected names with xyz, found keys with values"),
    ("name: arm", "targets: [1]", "targets: expected names with xyz, found a list of 1"),
    ("name: arm", "targets: {a: {rpy: [0, 0, 0]}}", "targets.a.xyz: is missing"),
    (
        "name: arm",
        "tool: {}\ntargets: {a: {xyz: [0, 0, 0]}}",
        "targets: cannot be combined with tool; list the tool as a target",
    ),
    ("name: arm", "effects: {backlash: 1}", "effects: expected a list of effects, found keys with values"),
    ("name: arm", "effects: [backlash]", "effects[0]: expected keys with values, found 'backlash'"),
    ("name: arm", "effects: [{a: 1, a: 2}]", "effects[0].a: is given twice"),
    (
        "theta: 0.2, d: 0.1",
        "theta: 0.2, d: 162,5",
        "joints[1].5: unknown key; write decimals with a point, as in 162.5",
    ),
    (
        "theta: 0.2, d: 0.1",
        'theta: 0.2, d: "162,5"',
        "joints[1].d: expected a number, found '162,5'; write decimals with a point",
    ),
    ("name: arm", "effects: [{a: .nan}]", "effects[0].a: expected a finite number, found .nan"),
    (
        "type: revolute",
        "type: rotary",
        "arm.yaml:7, joints[0].type: expected revolute or prismatic or continuous, found",
    ),
    ("type: revolute", "type: fixed", "joints[0].type: expected revolute or prismatic or continuous, found 'fixed'"),
    ("    type: revolute\n", "", "arm.yaml:6, joints[0].type: is missing"),
    ("type: revolute", "type: continuous", "arm.yaml:12, joints[0].limits: a continuous joint has no limits"),
    ("    alpha: -1.5\n", "", "arm.yaml:6, joints[0].alpha: is missing"),
    ("alpha: -1.5", "alpha:", "arm.yaml:11, joints[0].alpha: is missing"),
    ("alpha: -1.5", "alhpa: -1.5", "arm.yaml:11, joints[0].alhpa: unknown key; did you mean 'alpha'?"),
    (
        "alpha: -1.5",
        "alpha: -90",
        "joints[0].alpha: -90 rad is more than a turn; it looks like degrees: write angle: deg",
    ),
    (
        "d: 0.5",
        "d: 500",
        "arm.yaml:9, joints[0].d: 500 is 500 m, too long for an arm; it looks like mm: write length: mm",
    ),
    ("d: 0.5", "d: yes", "joints[0].d: expected a number, found 'yes'"),
    ("d: 0.5", "d: true", "joints[0].d: expected a number, found 'true'"),
    ("d: 0.5", "d: '0.5'", "joints[0].d: expected a number, found '0.5'; remove the quotes"),
    ("d: 0.5", "d: .nan", "joints[0].d: expected a finite number, found .nan"),
    ("d: 0.5", "d: -inf", "joints[0].d: expected a finite number, found -inf"),
    ("d: 0.5", "d: 1e999", "joints[0].d: 1e999 is too large for a number"),
    ("d: 0.5", "d: 1:30", "joints[0].d: expected a number, found '1:30'"),
    ("d: 0.5", "d: 0x10", "joints[0].d: expected a number, found '0x10'"),
    ("d: 0.5", "d: [1]", "joints[0].d: expected a number, found a list of 1"),
    ("d: 0.5", "d: {m: 1}", "joints[0].d: expected a number, found keys with values"),
    ("d: 0.5", "d: " + "x" * 50, f"joints[0].d: expected a number, found '{'x' * 39}…'"),
    ("limits: [-1, 2]", "limits: [2, -1]", "joints[0].limits: the lower limit 2 is above the upper limit -1"),
    ("limits: [-1, 2]", "limits: [-1]", "joints[0].limits: expected a list of 2 numbers, found a list of 1"),
    ("limits: [-1, 2]", "limits: [-1, .inf]", "joints[0].limits[1]: expected a finite number, found .inf"),
    (
        "limits: [-1, 2]",
        "limits: [-170, 170]",
        "units.angle: the limits of every joint (the first: (-170.0, 170.0) rad)",
    ),
    ("limits: [-1, 2]", "sign: 2", "joints[0].sign: expected 1 or -1, found '2'"),
    ("limits: [-1, 2]", "gear_ratio: 0", "joints[0].gear_ratio: expected a positive number, found '0'"),
    (
        "limits: [-1, 2]",
        "gear_ratio: -50",
        "joints[0].gear_ratio: expected a positive number, found '-50'; write sign: -1",
    ),
    (
        "limits: [-1, 2]",
        "tolerance: {d: -1e-4}",
        "joints[0].tolerance.d: a standard deviation cannot be negative, found",
    ),
    (
        "limits: [-1, 2]",
        "tolerance: {x: 1e-4}",
        "joints[0].tolerance.x: unknown key; known keys: theta, d, a, alpha, beta",
    ),
    (
        "limits: [-1, 2]",
        "tolerance: 1e-4",
        "joints[0].tolerance: expected keys with values (theta, d, a, alpha, beta), found",
    ),
    ("mass: 2", "mass: -2", "joints[0].mass: a mass cannot be negative, found '-2'"),
    ("    mass: 2\n", "", "joints[0].com: a centre of mass needs a mass; add the link's mass in kg"),
    (
        "{type: prismatic, theta",
        "{name: one, type: prismatic, theta",
        "joints[1].name: 'one' is already the name of the joint in line 6",
    ),
    (
        "{type: prismatic, theta",
        "{mimic: {joint: one}, type: prismatic, theta",
        "arm.yaml:15, joints[1].mimic: unknown key",
    ),
    (
        "{type: prismatic, theta",
        "{limits: [0, 200], type: prismatic, theta",
        "joints[1].limits: a travel of 200 m is too long for an arm; it looks like mm",
    ),
    (
        "- {type: prismatic, theta: 0.2, d: 0.1, a: 0, alpha: 0}",
        "- one",
        "joints[1]: expected keys with values (name, type",
    ),
    ("name: arm", "name: &a arm", "arm.yaml:2: cannot be read as YAML: anchors (&) and aliases (*) are not supported"),
    ("name: arm", "name: *a", "cannot be read as YAML: anchors (&) and aliases (*) are not supported"),
    ("name: arm", "name: " + "[" * 40 + "]" * 40, "arm.yaml:2: cannot be read as YAML: nested deeper than 32"),
    ("name: arm", "name: [" + "1," * 50_001 + "]", "arm.yaml:2: cannot be read as YAML: more than 50000 entries"),
    ("name: arm", "name: [", "cannot be read as YAML: "),
    (
        "name: arm",
        "name:\tarm\n\tx: 1",
        "arm.yaml:2: cannot be read as YAML: while scanning for the next token, found character '\\t'",
    ),
    ("name: arm", "name: a\x07b", "arm.yaml:2: cannot be read as YAML: the character U+0007 is not allowed"),
    ("name: arm", "--- {}", "cannot be read as YAML: expected a single document"),
    ("name: arm", "<<: {a: 1}", "<<: unknown key"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD)
def test_each_mistake_is_named_with_its_place(old: str, new: str, message: str) -> None:
    assert message in problem(edit(MINIMAL, old, new))


BAD_URDF = [
    ("axis: [0, 0, 2]", "axis: [0, 0, 0]", "arm.yaml:9, joints[1].axis: the axis is zero and has no direction"),
    (", axis: [0, 0, 2]", "", "joints[1].axis: is missing"),
    ("type: fixed,", "type: fixed, sign: 1,", "arm.yaml:8, joints[0].sign: a fixed joint does not have this key"),
    ("link: foot2", "link: foot2, d: 1", "joints[0].d: unknown key"),
    (
        "joint: turn",
        "joint: tern",
        "arm.yaml:11, joints[3].mimic.joint: 'copy' follows 'tern', which is not a joint of this robot",
    ),
    ("joint: turn", "joint: stand", "joints[3].mimic.joint: 'copy' follows 'stand', which is fixed"),
    ("joint: turn", "joint: copy", "joints[3].mimic.joint: 'copy' follows 'copy', which follows another joint itself"),
    ("joint: turn, ", "", "joints[3].mimic.joint: is missing"),
    ("multiplier: 2", "ratio: 2", "joints[3].mimic.ratio: unknown key; known keys: joint, multiplier, offset"),
    ("name: slide, ", "name: slide, link: foot2, ", "joints[2].link: an earlier joint already moves 'foot2'"),
    ("offset: 10", "offset: 400", "joints[1].offset: 400 deg is more than a turn"),
    ("offset: 5", "offset: 60000", "joints[2].offset: 60000 is 60 m, too long for an arm"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD_URDF)
def test_each_mistake_of_a_urdf_joint_is_named(old: str, new: str, message: str) -> None:
    assert message in problem(edit(URDF_LIKE, old, new))


def test_files_that_are_no_robots() -> None:
    assert "arm.yaml: the file is empty" in problem("")
    assert "arm.yaml: the file is empty" in problem("# only a comment\n")
    assert "expected keys with values (robacc, name" in problem("- a\n- b\n")
    head = MINIMAL[: MINIMAL.index("joints:")]
    assert "joints: is missing" in problem(head)
    assert "joints: a robot needs at least one joint" in problem(head + "joints: []\n")
    assert "joints: expected a list of joints, found keys with values" in problem(head + "joints: {a: 1}\n")
    urdf = edit(head, "standard", "urdf")
    assert "joints: no joint moves: all are fixed or follow another" in problem(urdf + "joints: [{type: fixed}]\n")


def test_degrees_declared_of_radians_and_millimetres_of_metres() -> None:
    text = (PROJECT / "configs" / "robots" / "ur10.yaml").read_text()
    message = problem(text.replace("angle: rad", "angle: deg"))
    assert "units.angle: the joints' angles (1.5708 and so on) are multiples of a quarter turn in rad" in message
    assert "they look like radians: write angle: rad" in message
    message = problem(text.replace("length: m,", "length: mm,"))
    assert "units.length: the longest length of the arm is 0.612 mm; the lengths look like metres" in message


def test_many_turns_of_one_joint_are_no_mistake() -> None:
    text = edit(
        MINIMAL,
        "  - {type: prismatic",
        "  - {type: revolute, limits: [-110, 110], theta: 0, d: 0, a: 0, alpha: 0}\n  - {type: prismatic",
    )
    assert parse_robot(text, "x").joints[1].limits == (-110, 110)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_enormous_limits_mean_that_there_are_none_and_are_taken(kind: str) -> None:
    head = MINIMAL[: MINIMAL.index("  - name: one")]
    joint = f"  - {{type: {kind}, theta: 0, d: 0, a: 0, alpha: 0, limits: [-1e6, 1e6]}}\n"
    assert parse_robot(head + joint, "x").joints[0].limits is None
    expected = r"the limits 0 and 1e\+06 are too large for a joint; leave limits out for a joint"
    with pytest.raises(InputError, match=expected):
        parse_robot(head + joint.replace("-1e6", "0"), "x")


def test_every_problem_comes_at_once_in_the_order_of_the_file() -> None:
    text = edit(edit(edit(MINIMAL, "mass: 2", "mass: -2"), "name: arm", "nam: arm"), "d: 0.5", "d: half")
    with pytest.raises(InputError) as caught:
        parse_robot(text, "arm.yaml")
    assert [item.line for item in caught.value.problems] == [2, 9, 13]
    many_problems = MINIMAL + "  - {type: revolute, d: x, a: x, alpha: x}\n" * 10
    with pytest.raises(InputError) as caught:
        parse_robot(many_problems, "arm.yaml")
    assert len(caught.value.problems) == MAX_PROBLEMS
    assert caught.value.total == 30
    assert "… and 10 more problems" in str(caught.value)
