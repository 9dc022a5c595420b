"""Robot files: what is read, every mistake at its line, and files made to mislead."""

import contextlib
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings, strategies as st
from robot_files import MINIMAL, URDF_LIKE, edit
from sample_files import ROOT, agreed, rounded

from robacc.errors import MAX_PROBLEMS, InputError
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import build_chain
from robacc.robots.description import MAX_JOINTS, Frame, Joint, Robot
from robacc.robots.urdf import parse_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

CONFIGS = sorted((ROOT / "configs" / "robots").glob("*.yaml"))


OF_JOINT = "    sign: -1\n    gear_ratio: 100\n    tolerance: {theta: 1e-4, beta: 2E-4}\n    mass: 2"
OPTIONAL = (
    MINIMAL.replace("    mass: 2", OF_JOINT)
    + """gravity: [0, 9.8, 0]
base: {xyz: [1, 2, 3], rpy: [0.1, 0.2, 0.3], tolerance: {x: 1e-3, yaw: 1e-4}}
tool: {xyz: [0, 0, .1], tolerance: {z: 0.002}}
payload: {com: [0, 0, 0.2]}
effects:
  - {effect: backlash, joints: [one], value: 1e-4, seen: yes, note: '7', none: ~, n: 010}
"""
)
UNITS = """robacc: 1
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
TARGETS = "targets: {a: {xyz: [0.05, 0, 0.1]}, b: {xyz: [0, 0, 0.1], rpy: [0, 0, 1]}}\n"
READ = {
    **{"arm.yaml": MINIMAL, "all that is optional": OPTIONAL, "folder/my arm.yaml": UNITS, "urdf": URDF_LIKE},
    **{"targets": MINIMAL + TARGETS, "urdf with targets": URDF_LIKE + TARGETS},
}


def test_a_file_says_what_it_says() -> None:
    """Each file in m and rad, in full."""
    robots = [parse_robot(text, name) for name, text in READ.items()]
    texts = [robot_to_yaml(replace(robot, effect_units=(1.0, 1.0)), [f"{robot.name}:"]) for robot in robots]
    shown = rounded("".join(texts))
    assert shown == agreed("robots.txt", shown)
    for robot, text in zip(robots, texts, strict=True):
        assert replace(parse_robot(text, "x"), effect_units=robot.effect_units) == robot
    assert (robots[2].name, robots[2].effect_units) == ("my arm", (1e-3, math.pi / 180))
    assert robots[3].variable_names == ("turn", "slide")
    assert build_chain(robots[3]).n_joints == 2


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


ARM = (
    "robacc: 1\nname: arm\nconvention: standard\nunits: {length: m, angle: rad}\njoints:\n"
    "  - {name: j1, type: revolute, d: 0.5, a: 0.2, alpha: 0}\n"
)
MOST_CALLS = 60_000_000
"""Function calls after which a description counts as expanding; the longest test below takes a quarter of them."""


@contextlib.contextmanager
def bounded_calls() -> Iterator[None]:
    """Fail where the work is more than a bounded number of calls, however fast or loaded the machine is."""
    count = 0

    def counted(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += 1
        if count > MOST_CALLS:
            sys.setprofile(None)
            raise AssertionError(f"more than {MOST_CALLS} calls")

    sys.setprofile(counted)
    try:
        yield
    finally:
        sys.setprofile(None)


def refused(text: str) -> str:
    with bounded_calls(), pytest.raises(InputError) as caught:
        parse_robot(text, "arm.yaml")
    return str(caught.value)


HEAD, JOINT = ARM[: ARM.index("joints:")], "joints: [{type: %s, theta: 0, d: 0, a: 0, alpha: 0, limits: [0, 1e6]}]\n"
UR10 = (ROOT / "configs" / "robots" / "ur10.yaml").read_text(encoding="utf-8")
IN_DEGREES, TOO_LARGE = (
    UR10.replace("angle: rad", "angle: deg"),
    "the limits 0 and 1e+06 are too large for a joint; leave",
)
BILLION = "\n".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9) if i else 'lol'}]" for i in range(10))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "arm.yaml: the file is empty"),
        ("# only a comment\n", "arm.yaml: the file is empty"),
        ("- a\n- b\n", "expected keys with values (robacc, name"),
        (HEAD, "joints: is missing"),
        (f"{HEAD}joints: []\n", "joints: a robot needs at least one joint"),
        (f"{HEAD}joints: {{a: 1}}\n", "joints: expected a list of joints, found keys with values"),
        (
            HEAD.replace("standard", "urdf") + "joints: [{type: fixed}]\n",
            "joints: no joint moves: all are fixed or follow another",
        ),
        *((HEAD + JOINT % kind, f"{TOO_LARGE} limits out for a joint") for kind in ("revolute", "prismatic")),
        (IN_DEGREES, "units.angle: the joints' angles (1.5708 and so on) are multiples of a quarter turn in rad"),
        (IN_DEGREES, "they look like radians: write angle: rad"),
        (
            UR10.replace("length: m,", "length: mm,"),
            "units.length: the longest length of the arm is 0.612 mm; the lengths look like metres",
        ),
        (BILLION, "arm.yaml:1: cannot be read as YAML: anchors (&) and aliases (*) are not supported"),
        ("a: &a [*a]", "anchors (&) and aliases (*) are not supported"),
        ("[" * 100_000, "arm.yaml:1: cannot be read as YAML: nested deeper than 32"),
        ("{a: " * 100_000, "nested deeper than 32"),
        (ARM.replace("arm", "!!python/object/apply:os.system [ls]"), "arm.yaml:2: cannot be read as YAML: tags (!)"),
        (ARM.replace("0.5", "!deg 0.5"), "arm.yaml:6: cannot be read as YAML: tags (!) are not supported, found !deg"),
        (ARM + "<<: {gravity: [0, 0, 0]}\n", "arm.yaml:7, <<: unknown key"),
        (ARM + "name: again\n", "arm.yaml:7, name: is given twice, first in line 2"),
        (ARM + "---\n" + ARM, "expected a single document in the stream, but found another document"),
        (ARM.replace("robacc: 1", "robacc: yes"), "expected format version 1, found 'yes'"),
        (ARM.replace("arm", '"\\e[2J"'), "arm.yaml:2, name: expected a name, found '\\x1b[2J'"),
        (ARM + 'targets: {"\\e[2J": {xyz: [0, 0, 0]}}\n', "targets: expected printable characters in a key"),
        (ARM + 'effects: [{effect: "\\e[2J"}]\n', "effects[0].effect: expected printable characters"),
        (ARM.replace("0.5,", "0.5, gear_ratio: 0,"), "joints[0].gear_ratio: expected a positive number, found '0'"),
        (ARM.replace("0.5,", "0.5, mass: -1,"), "joints[0].mass: a mass cannot be negative, found '-1'"),
        (ARM.replace("0.5,", "0.5, limits: [2, 1],"), "joints[0].limits: the lower limit 2 is above the upper limit 1"),
        (ARM.replace("0.5,", "0.5, limits: [0, 1e308],"), "the limits 0 and 1e+308 are too large for a joint"),
        (ARM + ARM.splitlines()[-1] * 2, "cannot be read as YAML"),
        (
            ARM + "".join(f"  - {{type: revolute, d: 0, a: 0.1, alpha: 0, name: k{i}}}\n" for i in range(MAX_JOINTS)),
            f"joints: found {MAX_JOINTS + 1} joints, expected at most {MAX_JOINTS}",
        ),
    ],
)
def test_a_robot_file(text: str, message: str) -> None:
    assert message in refused(text)


@pytest.mark.parametrize("scalar", ["1:30", "1_000", "0x10", "true", "no", '"0.5"', "1e400", ".inf", ".nan", "½"])
def test_what_yaml_would_read_otherwise_than_it_looks(scalar: str) -> None:
    assert "joints[0].d: " in refused(ARM.replace("d: 0.5", f"d: {scalar}"))


def test_a_joint_of_zero_range_and_names_of_any_script() -> None:
    robot = parse_robot(ARM.replace("name: j1", "name: 第一轴 Gelenk-1").replace("0.5,", "0.5, limits: [0, 0],"), "a")
    assert robot.joints[0].limits == (0.0, 0.0)
    assert robot.joints[0].name == "第一轴 Gelenk-1"


FAR = '<origin xyz="0 90 0"/><mass value="1"/>'


def urdf(body: str = "", head: str = "") -> str:
    return (
        f'<?xml version="1.0"?>{head}<robot name="r"><link name="a"/><link name="b"/>'
        f'<joint name="j" type="prismatic"><parent link="a"/><child link="b"/>{body}</joint></robot>'
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (urdf("&b;", '<!DOCTYPE r [<!ENTITY a "lol"><!ENTITY b "&a;&a;">]>'), "a document type (<!DOCTYPE r>) is not"),
        (urdf("&x;", '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'), "a document type (<!DOCTYPE r>)"),
        (urdf("", '<!DOCTYPE r SYSTEM "http://127.0.0.1:9/x.dtd">'), "a document type (<!DOCTYPE r>) is not allowed"),
        (urdf("&nbsp;"), "not well-formed XML: undefined entity"),
        (urdf("<origin>" * 50_000), "not well-formed XML: mismatched tag"),
        (urdf().replace('"j"', '"j&#27;"'), "not well-formed XML: reference to invalid character number"),
        (urdf().replace('"j"', '"j&#x202e;"'), "<joint name>: expected a name, found 'j\\u202e'"),
        (urdf().replace('"r"', '"&#x202e;"'), "<robot name>: expected a name, found '\\u202e'"),
        (urdf('<origin xyz="0 0 1_0"/>'), "j: <origin xyz>: expected 3 numbers, found '0 0 1_0'"),
        (urdf('<origin xyz="0 0 ١"/>'), "j: <origin xyz>: expected 3 numbers"),
        (urdf('<origin rpy="90 0 0"/>'), "j: roll of 90 rad is more than a turn; a URDF's angles are in rad"),
        (urdf('<origin xyz="300 0 0"/>'), "j: x of 300 m is too long for an arm; a URDF's lengths are in m"),
        (urdf('<limit lower="0" upper="300"/>'), "j: a travel of 300 m is too long for an arm; a URDF's lengths"),
        (urdf('<limit lower="0" upper="1e308"/>'), "j: the limits 0 and 1e+308 are too large for a joint; make them"),
        (
            urdf('<limit lower="-90" upper="90"/>').replace("prismatic", "revolute"),
            "the limits of every joint are more than two turns; a URDF's angles are in rad",
        ),
        (
            urdf().replace('<link name="b"/>', f'<link name="b"><inertial>{FAR}</inertial></link>'),
            "j: the centre of mass of its link is 90 m away, too far for an arm",
        ),
    ],
)  # fmt: skip
def test_a_urdf(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_urdf(text, "arm.urdf")
    assert message in str(caught.value)


def test_a_urdf_whose_leaves_have_children_or_other_attributes() -> None:
    """Neither of which says anything of the chain; both once ended in a traceback."""
    body = '<origin xyz="0 0 1"><note/></origin><limit effort="much" velocity="x"/>' + "<x>" * 5000 + "</x>" * 5000
    assert parse_urdf(urdf(body), "arm.urdf").joints[0].parameters["z"] == 1.0


def test_limits_without_meaning_are_none() -> None:
    assert parse_urdf(urdf('<limit lower="-1e308" upper="1e308"/>'), "arm.urdf").joints[0].limits is None


def test_a_chain_of_too_many_joints() -> None:
    links = "".join(
        f'<link name="l{i}"/><joint name="j{i}" type="continuous"><parent link="l{i - 1}"/><child link="l{i}"/></joint>'
        for i in range(1, MAX_JOINTS + 2)
    )
    text = f'<robot name="r"><link name="l0"/>{links}</robot>'
    with pytest.raises(InputError, match=f"there are {MAX_JOINTS + 1} joints from 'l0' to .* expected at most"):
        parse_urdf(text, "arm.urdf")
    assert len(parse_urdf(text, "arm.urdf", tip_link="l5").joints) == 5


@pytest.mark.parametrize("name", ["arm.yaml", "arm.urdf"])
def test_a_file_of_ten_gigabytes(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with path.open("wb") as stream:
        stream.truncate(10 * 2**30)
    with pytest.raises(InputError, match="is larger than 64 MiB, the limit for text files"):
        read_robot(path)
