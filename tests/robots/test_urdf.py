"""URDFs: what is read, chains of real arms, and what is written."""

import logging
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_files import example_robots
from sample_files import ROOT, agreed, rounded
from slow_parameters import some_fast

import robacc
from robacc import InputError, Robot, UsageError, read_robot
from robacc.geometry import Array
from robacc.robots.arm import build_chain
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, Mimic
from robacc.robots.urdf import parse_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc_plugins.urdf import robot_to_urdf

TREE = """<robot name="tree">
  <link name="world"/>
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0.2 0.3" rpy="1 1 1"/><mass value="2.5"/></inertial></link>
  <link name="lower"><visual><geometry><mesh filename="package://nowhere/absent.stl"/></geometry></visual></link>
  <link name="finger"/><link name="thumb"/><link name="flange"/>
  <joint name="stand" type="fixed"><origin xyz="0 0 1"/><parent link="world"/><child link="base"/></joint>
  <joint name="one" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 0 2"/><limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
  <joint name="two" type="continuous"><origin xyz="0.5 0 0" rpy="0 1.5707963 0.3"/>
    <parent link="upper"/><child link="lower"/><axis xyz="0 1 0"/></joint>
  <joint name="slide" type="prismatic"><parent link="lower"/><child link="finger"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
  <joint name="follow" type="prismatic"><parent link="finger"/><child link="thumb"/>
    <axis xyz="1 0 0"/><mimic joint="slide" multiplier="-2" offset="0.01"/></joint>
  <joint name="end" type="fixed"><parent link="lower"/><child link="flange"/></joint>
</robot>
"""


BRANCHED = """<robot name="torso">
  <link name="base"/><link name="flange"/>
  <link name="torso"><inertial><origin xyz="0 0 0.2"/><mass value="10"/></inertial></link>
  <link name="camera"><inertial><mass value="2"/></inertial></link>
  <link name="left"><inertial><origin xyz="0.5 0 0"/><mass value="4"/></inertial></link>
  <link name="right"><inertial><origin xyz="0.1 0 0"/><mass value="3"/></inertial></link>
  <joint name="waist" type="revolute"><parent link="base"/><child link="torso"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="neck" type="fixed"><origin xyz="0 0 0.6"/><parent link="torso"/><child link="camera"/></joint>
  <joint name="left_arm" type="continuous"><origin xyz="0 0.3 0.4" rpy="0 0 1.5707963267948966"/>
    <parent link="torso"/><child link="left"/><axis xyz="0 1 0"/></joint>
  <joint name="right_arm" type="continuous"><origin xyz="0 -0.3 0.4"/><parent link="torso"/><child link="right"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="end" type="fixed"><parent link="right"/><child link="flange"/></joint>
</robot>
"""

FOLLOWS = '<parent link="base"/><child link="upper"/><mimic joint="follow" multiplier="3" offset="0.5"/>'
NO_LIMITS = TREE.replace('lower="-1" upper="2"', 'lower="-inf" upper="inf"').replace('lower="0" upper', "upper")
FIXED = '<joint name="left_arm" type="fixed">'
FORK = TREE.replace('<parent link="finger"/><child link="thumb"/>', '<parent link="lower"/><child link="thumb"/>')
EQUAL = FORK.replace('<mimic joint="slide" multiplier="-2" offset="0.01"/>', "")
ROOTS = TREE.replace('<joint name="stand"', '<link name="island"/><joint name="stand"')
LOOP = TREE.replace('<parent link="world"/><child link="base"/>', '<parent link="flange"/><child link="base"/>')
CIRCLE = LOOP.replace('<link name="world"/>', "")
READ: dict[str, tuple[str, ...]] = {
    "to the leaf with most joints": (TREE,),
    "between two links": (TREE, "base", "flange"),
    "from one of two roots": (ROOTS, "world"),
    # By way of another that follows: 3 times -2, and 3 times 0.01 and 0.5.
    "a mimic follows the joint that moves": (TREE.replace('<parent link="base"/><child link="upper"/>', FOLLOWS),),
    "infinite limits are none, a missing one is 0": (NO_LIMITS,),
    "no name": (TREE.replace('<robot name="tree">', '<robot xmlns:xacro="http://ros.org/wiki/xacro">'),),
    # Camera at (0, 0, 0.6) and left arm at (0, 0.3 + 0.5, 0.4) hang on the torso; the right arm is the chain.
    "masses beside the chain count with their carrier": (
        BRANCHED.replace('<joint name="left_arm" type="continuous">', FIXED),
        *("base", "flange"),
    ),
    "a joint beside the chain that moves mass is a branch": (BRANCHED, "base", "flange"),
    "a light one counts as fixed": (BRANCHED.replace('<mass value="4"/>', '<mass value="0.09"/>'), "base", "flange"),
    # A camera alone would pass for the weight of the arm.
    "a chain without masses stays without": (
        re.sub(r'(<link name="(torso|right)">).*?</link>', r"\1</link>", BRANCHED),
        *("base", "flange"),
    ),
}


def test_a_chain_is_that_of_its_links() -> None:
    """Each chain as a robot file."""
    robots = {name: parse_urdf(text, "tree.urdf", *links) for name, (text, *links) in READ.items()}
    texts = [robot_to_yaml(robot, [name]) for name, robot in robots.items()]
    shown = re.sub(r"(?s)gravity.*?(?=base_link)", "", rounded("".join(texts)))
    assert shown == agreed("urdfs.txt", shown)
    assert [parse_robot(text, "robot.yaml") for text in texts] == [*robots.values()]


def problems_of(text: str, base: str | None = None, tip: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        parse_urdf(text, "tree.urdf", base, tip)
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'type="prismatic"><parent link="lower"/>',
            'type="floating"><parent link="lower"/>',
            "tree.urdf:12, slide: a floating joint cannot be part of a serial chain",
        ),
        (
            'type="prismatic"><parent link="lower"/>',
            'type="planar"><parent link="lower"/>',
            "slide: a planar joint cannot be part of a serial chain; choose a chain without it",
        ),
        (
            'type="prismatic"><parent link="lower"/>',
            'type="screw"><parent link="lower"/>',
            "slide: unknown joint type 'screw'",
        ),
        (
            '<axis xyz="0 0 2"/>',
            '<axis xyz="0 0 0"/>',
            "tree.urdf:8, one: the joint's axis is zero and has no direction",
        ),
        ('<axis xyz="0 0 2"/>', '<axis xyz="0 0"/>', "tree.urdf:9, one: <axis xyz>: expected 3 numbers, found '0 0'"),
        ('<axis xyz="0 0 2"/>', '<axis xyz="0 0 nan"/>', "one: <axis xyz>: expected 3 numbers, found '0 0 nan'"),
        ('xyz="0.5 0 0"', 'xyz="0.5 0 inf"', "two: <origin xyz>: expected 3 numbers, found '0.5 0 inf'"),
        ('multiplier="-2"', 'multiplier="two"', "follow: <mimic multiplier>: expected a number, found 'two'"),
        ('lower="-1" upper="2"', 'lower="3" upper="2"', "one: the lower limit 3 is above the upper limit 2"),
        ('lower="-1" upper="2"', 'lower="-inf" upper="2"', "one: one limit is infinite, the other is not (-inf, 2)"),
        ('<mass value="2.5"/>', '<mass value="-2.5"/>', "tree.urdf:4, upper: the link's mass is negative (-2.5 kg)"),
        ('mimic joint="slide"', 'mimic joint="spin"', "follow: follows 'spin', which is not a joint of this file"),
        ('mimic joint="slide"', 'mimic joint="stand"', "follow: follows 'stand', which is fixed"),
        (
            'mimic joint="slide"',
            'mimic joint="follow"',
            "follow: follows 'follow', which follows it in turn: none of these joints moves by itself",
        ),
        ('mimic joint="slide"', "mimic", "follow: <mimic> needs the attribute 'joint'"),
        ('<child link="upper"/>', '<child link="uper"/>', "one: its child link 'uper' does not exist"),
        (
            '<child link="thumb"/>',
            '<child link="upper"/>',
            "follow: moves the link 'upper', as 'one' does: not a serial chain",
        ),
        ('<child link="thumb"/>', "", "follow: the joint has no <child>"),
        ('joint name="two"', 'joint name="one"', "one: there is already a joint 'one' in line 8"),
        ('link name="thumb"', 'link name="base"', "base: there is already a link 'base' in line 3"),
        ('joint name="two" type="continuous"', 'joint type="continuous"', "<joint> needs the attribute 'name'"),
        (
            '<joint name="stand"',
            '<xacro:macro/><joint name="stand"',
            "tree.urdf:7: this is xacro, not URDF; run xacro first",
        ),
        ('<origin xyz="0 0 1"/>', '<origin xyz="0 0 ${height}"/>', "this is xacro, not URDF"),
        ("</robot>", "", "tree.urdf:18: not well-formed XML: no element found"),
        (
            "<robot name",
            "<sdf/><robot name",
            "the root element is <sdf>, so this is an SDF model; a URDF's root is <robot>",
        ),
        (
            "<robot name",
            '<!DOCTYPE robot [<!ENTITY a "b">]><robot name',
            "tree.urdf:1: a document type (<!DOCTYPE robot>) is not allowed",
        ),
    ],
)
def test_each_error_names_the_joint_and_says_what_is_wrong(old: str, new: str, message: str) -> None:
    assert TREE.count(old) >= 1
    assert message in problems_of(TREE.replace(old, new, 1))


def test_all_problems_come_at_once() -> None:
    text = (
        TREE.replace('xyz="0 0 2"', 'xyz="x"').replace('xyz="0 0 1"', 'xyz=""').replace('value="2.5"', 'value="heavy"')
    )
    assert len(problems_of(text).splitlines()) == 3


def test_entities_are_refused_before_they_are_expanded() -> None:
    bomb = '<!DOCTYPE robot [<!ENTITY a0 "aaaaaaaaaa">' + "".join(
        f'<!ENTITY a{i + 1} "{f"&a{i};" * 10}">' for i in range(12)
    )
    assert "is not allowed" in problems_of(bomb + ']><robot name="&a12;"/>')
    secret = '<!DOCTYPE robot [<!ENTITY s SYSTEM "file:///etc/hostname">]><robot name="&s;"/>'
    assert "is not allowed" in problems_of(secret)


@pytest.mark.parametrize(
    ("text", "links", "error", "message"),
    [
        (
            EQUAL,
            (),
            InputError,
            "2 chains are equally long; the tree ends at finger, thumb, flange; choose one with `tip_link`",
        ),
        (ROOTS, (), InputError, "2 links could be the base: world, island; choose one with `base_link`"),
        (CIRCLE, (), InputError, "the joints form a loop"),
        (CIRCLE, ("thumb", "flange"), UsageError, "is not behind link"),
        ('<robot name="r"/>', (), InputError, "has no links"),
        (TREE, ("thumb",), InputError, "no joint follows the link 'thumb'"),
        (TREE, (None, "base"), InputError, "no joint between 'world' and 'base' moves; choose a longer chain"),
        (TREE, (None, "flang"), UsageError, "`tip_link`: tree.urdf has no link 'flang'; it has flange"),
        (TREE, ("1",), UsageError, "`base_link`: tree.urdf has no link '1'; it has world, base, "),
        (TREE, ("upper", "base"), UsageError, "link 'base' is not behind link 'upper'"),
    ],
)
def test_what_a_chain_cannot_be_chosen_from(
    text: str, links: tuple[str | None, ...], error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as caught:
        parse_urdf(text, "tree.urdf", *links)
    assert message in str(caught.value)


def test_reading_opens_no_other_file_and_importing_is_cheap(tmp_path: Path) -> None:
    code = """
import sys, pathlib, robacc.robots.urdf, robacc.robots.yaml_robot, robacc.modelling.robot_file
text = pathlib.Path("tree.urdf").read_text()
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
robacc.robots.urdf.parse_urdf(text, "tree.urdf")
assert not [name for name in opened if not name.endswith((".py", ".pyc", ".so"))], opened
assert not {"yourdfpy", "lxml", "trimesh", "scipy"} & set(sys.modules)
"""
    (tmp_path / "tree.urdf").write_text(TREE)
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr


ARMS = (
    "panda_description/urdf/panda.urdf",
    "z1_description/urdf/z1.urdf",
    "kinova_description/robots/kinova.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "ur_description/urdf/ur3_robot.urdf",
    "ur_description/urdf/ur3_gripper.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "ur_description/urdf/ur5_gripper.urdf",
    "ur_description/urdf/ur10_robot.urdf",
    "ur_description/urdf/ur10_joint_limited_robot.urdf",
    "so_arm_description/urdf/so100.urdf",
    "so_arm_description/urdf/so101.urdf",
    "baxter_description/urdf/baxter.urdf",
    "talos_data/robots/talos_left_arm.urdf",
    "tiago_description/robots/tiago_no_hand.urdf",
    "tiago_description/robots/tiago.urdf",
    "tiago_description/robots/tiago_dual.urdf",
    "tiago_pro_description/robots/tiago_pro.urdf",
    "pr2_description/urdf/pr2.urdf",
    "icub_description/robots/icub.urdf",
    "romeo_description/urdf/romeo.urdf",
    "b1_description/urdf/b1-z1.urdf",
    "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "alex_description/urdf/alex_psyonic_hands.urdf",
    "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
)
"""Under the package's folder of robots: arms, arms on mobile bases, hands with mimic joints, long chains."""


def position(reference: Any, name: str, configuration: Mapping[str, float]) -> float:
    """Return a joint's position; a finger may follow one of another chain."""
    rule = reference.joint_map[name].mimic
    if rule is None:
        return configuration[name]
    return rule.multiplier * position(reference, rule.joint, configuration) + rule.offset


@pytest.mark.parametrize("arm", some_fast(ARMS, 4))
def test_every_serial_chain_of_real_robots_is_yourdfpys(arm: str) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)
    path = example_robots() / arm
    reference = yourdfpy.URDF.load(str(path), load_meshes=False)
    rng = np.random.default_rng(0)
    configurations = [{name: rng.uniform(-2, 2) for name in reference.actuated_joint_names} for _ in range(2)]
    parents = {joint.parent for joint in reference.robot.joints}
    leaves = [link.name for link in reference.robot.links if link.name not in parents]
    # Of a robot with many chains some two dozen: its fingers share the arm.
    leaves = leaves[:: 1 + len(leaves) // 24]
    text = path.read_text()
    robots = {}
    for leaf in leaves:
        try:
            robots[leaf] = parse_urdf(text, arm, None, leaf)
        except InputError as error:
            # The only chains that are none: nothing moves in them, or a finger follows a joint that the file lacks.
            problems = {problem.message for problem in error.problems}
            assert all("moves" in problem or "which is not a joint of this file" in problem for problem in problems)
    assert robots, "no chain of this robot could be read"
    longest = max(robots.values(), key=lambda robot: len(robot.joints))
    assert parse_robot(robot_to_yaml(longest), "again.yaml") == longest
    reread = parse_urdf(robot_to_urdf(longest)[0], "again.urdf")
    q = rng.uniform(-2, 2, (len(longest.variables), 5))
    ours, theirs = (build_chain(robot).forward(q).matrices() for robot in (longest, reread))
    np.testing.assert_allclose(theirs, ours, atol=1e-9)
    for configuration in configurations:
        reference.update_cfg(np.array([configuration[name] for name in reference.actuated_joint_names]))
        for leaf, robot in robots.items():
            q = np.array([[position(reference, name, configuration)] for name in robot.variable_names])
            expected = reference.get_transform(leaf, robot.base_link)
            np.testing.assert_allclose(build_chain(robot).forward(q).matrices()[0], expected, atol=1e-10, err_msg=leaf)


def test_there_are_at_least_fifteen_robots() -> None:
    assert sum((example_robots() / arm).is_file() for arm in ARMS) >= 15


def joint(name: str, kind: str, parent: str, child: str) -> str:
    limits = '<limit lower="-2" upper="2" effort="1" velocity="1"/>' if kind in ("revolute", "prismatic") else ""
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0.1 0 0.2"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 1 0"/>{limits}</joint>'
    )


JOINTS = [
    ("wheel", "continuous", "ground", "cart"),
    ("mount_left", "fixed", "cart", "left_base"),
    ("left_1", "revolute", "left_base", "l1"),
    ("left_2", "revolute", "l1", "l2"),
    ("left_flange", "fixed", "l2", "l_plate"),
    ("left_camera", "fixed", "l_plate", "l_camera"),
    ("left_tool", "fixed", "l_plate", "tool0"),
    ("right_1", "revolute", "cart", "r1"),
    ("right_2", "revolute", "r1", "r2"),
    ("right_plate", "fixed", "r2", "r_plate"),
    ("right_hand", "fixed", "r_plate", "hand"),
    ("finger", "prismatic", "hand", "finger_link"),
    ("right_3", "revolute", "r1", "r3"),
]
LINKS = dict.fromkeys(name for row in JOINTS for name in row[2:])
ROBOT = f'<robot name="two">{"".join(f"<link name={chr(34)}{n}{chr(34)}/>" for n in LINKS)}{"".join(joint(*row) for row in JOINTS)}</robot>'  # noqa: E501


def chain(*columns: str, tip: str | None = None, base: str | None = None) -> tuple[str | None, str | None, list[str]]:
    robot = parse_urdf(ROBOT, "two.urdf", base, tip, lambda: columns)
    return robot.base_link, robot.tip_link, list(robot.variable_names)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        # The arm behind the wheel, which the file does not have; the camera is no flange.
        (("left_1", "left_2_deg", "x", "y", "z"), ("left_base", "tool0", ["left_1", "left_2"])),
        (("x_mm", "right_2 [deg]", "right_1 [deg]"), ("cart", "r_plate", ["right_1", "right_2"])),
        (("wheel", "right_1", "right_2"), ("ground", "r_plate", ["wheel", "right_1", "right_2"])),
        (("right_1", "right_3"), ("cart", "r3", ["right_1", "right_3"])),
        (("right_1", "right_2", "finger"), ("cart", "r_plate", ["right_1", "right_2"])),
        # Numbers: the longest chain without its gripper.
        (("q1", "q2", "q3", "x", "y", "z"), ("ground", "r_plate", ["wheel", "right_1", "right_2"])),
        (("J1", "J2", "J3", "J4"), ("ground", "finger_link", ["wheel", "right_1", "right_2", "finger"])),
        (("x", "y", "z"), ("ground", "finger_link", ["wheel", "right_1", "right_2", "finger"])),
    ],
)
def test_columns_choose_the_chain(columns: tuple[str, ...], expected: tuple[str, str, list[str]]) -> None:
    assert chain(*columns) == expected


def test_links_that_are_given_come_first() -> None:
    assert chain("left_1", "left_2", tip="r2")[1:] == ("r2", ["wheel", "right_1", "right_2"])
    assert chain("left_1", "left_2", base="ground") == ("ground", "tool0", ["wheel", "left_1", "left_2"])


def test_a_joint_that_follows_another_at_the_end_is_part_of_the_chain() -> None:
    # Without the fork to the flange, the thumb is all that is behind the slide.
    robot = parse_urdf(TREE, "tree.urdf", joint_columns=lambda: ("one", "two", "slide"))
    assert robot.tip_link == "thumb"


def test_of_chains_of_the_same_joints_the_flange_ends_it_and_two_arms_are_a_question() -> None:
    camera = TREE.replace('<link name="flange"/>', '<link name="flange"/><link name="camera"/><link name="lens"/>')
    for name, parent in (("camera", "lower"), ("lens", "camera")):
        fixed = f'<joint name="to_{name}" type="fixed"><parent link="{parent}"/><child link="{name}"/></joint></robot>'
        camera = camera.replace("</robot>", fixed)
    slide = camera.replace('type="prismatic"', 'type="fixed"')
    assert parse_urdf(slide, "tree.urdf").tip_link == "flange"
    # One finger has a longer chain of fixed joints than the other.
    fingers = camera.replace(
        '<parent link="camera"/><child link="lens"/>', '<parent link="thumb"/><child link="lens"/>'
    )
    fingers = fingers.replace(
        '<parent link="finger"/><child link="thumb"/>', '<parent link="lower"/><child link="thumb"/>'
    )
    fingers = fingers.replace('<mimic joint="slide" multiplier="-2" offset="0.01"/>', "")
    assert "2 chains are equally long" in problems_of(fingers)


def test_joints_of_two_branches_leave_the_longest_chain() -> None:
    assert chain("left_1", "right_1")[1] == "finger_link"


def test_a_panda_ends_at_its_flange(tmp_path: Path) -> None:
    urdf = example_robots() / "panda_description/urdf/panda.urdf"
    assert len(robacc.read_robot(urdf).variables) == 8  # without poses: into the finger
    made = robacc.simulate("panda", poses=20, noise="0.05mm", seed=1)
    made.write(tmp_path / "numbered.csv")
    text = (tmp_path / "numbered.csv").read_text()
    for i in range(7):
        text = text.replace(f"q{i + 1},", f"panda_joint{i + 1},", 1)
    (tmp_path / "named.csv").write_text(text)
    for poses in (tmp_path / "numbered.csv", tmp_path / "named.csv", made.data):
        found = robacc.estimate(poses, robot=urdf)
        assert (found.robot.tip_link, len(found.robot.variables)) == ("panda_link8", 7)
        # The library's Panda and the URDF are one arm, so noise is all that remains.
        np.testing.assert_allclose(found.position.rms, np.sqrt(3) * 5e-5, rtol=0.35)


CONFIGS = sorted((ROOT / "configs" / "robots").glob("*.yaml"))


def random_joint(rng: np.random.Generator, i: int, convention: str) -> Joint:
    kind = ("revolute", "prismatic", "revolute")[i % 3]
    names = (
        ("x", "y", "z", "roll", "pitch", "yaw", "offset")
        if convention == "urdf"
        else ("theta", "d", "a", "alpha", "beta")
    )
    axis = rng.normal(size=3) if convention == "urdf" else np.array([0.0, 0, 1])
    return Joint(
        f"j{i}",
        "fixed" if convention == "urdf" and i == 4 else kind,
        dict(zip(names, rng.normal(size=len(names)), strict=True)),
        axis=tuple(axis / np.linalg.norm(axis)),
        limits=(-1.5, 2.0) if i % 2 else None,
        is_continuous=convention != "urdf" and i == 2,
        sign=-1 if i in (1, 2) else 1,
        mass=float(i + 1),
        com=tuple(rng.normal(size=3)),
        mimic=Mimic("j0", -1.5, 0.2) if convention == "urdf" and i == 2 else None,
    )


def assert_same_arm(robot: Robot, reread: Robot, target: Frame | None = None) -> None:
    chains = build_chain(robot if target is None else replace(robot, tool=target)), build_chain(reread)
    assert robot.variable_names == reread.variable_names
    q = np.random.default_rng(4).uniform(-2, 2, (len(robot.variables), 20))
    ours, theirs = (chain.forward(q).matrices() for chain in chains)
    np.testing.assert_allclose(theirs, ours, atol=1e-9)
    for expected, actual in zip(*(centres(chain, q) for chain in chains), strict=True):
        np.testing.assert_allclose(actual, expected, atol=1e-9)


def centres(chain, q: Array) -> list[Array]:
    """Return the centre of mass of each body over the poses."""
    frames = chain.sweep(chain.scalars(q), q.shape[1], (), tuple(body.after for body in chain.bodies)).frames
    return [
        np.einsum("ijn,j->in", frame.rotation, body.com) + frame.translation
        for frame, body in zip(frames, chain.bodies, strict=True)
    ]


@pytest.mark.parametrize("convention", ["standard", "modified", "urdf"])
@pytest.mark.parametrize("seed", range(4))
def test_written_and_read_again_gives_the_same_poses(convention: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = [Frame(tuple(rng.normal(size=3)), tuple(rng.normal(size=3))) for _ in range(2)]
    joints = tuple(random_joint(rng, i, convention) for i in range(6))
    robot = Robot("arm", convention, joints, base=frames[0], tool=frames[1])  # type: ignore[arg-type]
    text, losses = robot_to_urdf(robot)
    reread = parse_urdf(text, "again.urdf")
    assert (reread.base_link, reread.tip_link) == ("measuring_frame", "tool0")
    assert_same_arm(robot, reread)
    for joint, again in zip(robot.variables, reread.variables, strict=True):
        is_unknown = joint.type == "revolute" and joint.limits is None and not joint.is_continuous
        assert again.limits == ((-2 * np.pi, 2 * np.pi) if is_unknown else joint.limits)
        assert again.is_continuous == joint.is_continuous
    assert [line for line in losses if "unlimited range" not in line and "missing limits" not in line] == []
    # And once more: nothing is added to what is already a URDF.
    assert robot_to_urdf(reread)[0].count("<link") == text.count("<link")
    assert_same_arm(robot, parse_urdf(robot_to_urdf(reread)[0], "third.urdf"))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_projects_arms_go_to_urdf_and_back(path: Path) -> None:
    robot = read_robot(path)
    assert_same_arm(robot, parse_urdf(robot_to_urdf(robot)[0], "again.urdf"))


@pytest.mark.parametrize("pitch", [np.pi / 2, 1.5707963, 1.57079632, -1.5707963267, 1.5708])
def test_poses_survive_a_pitch_near_ninety_degrees(pitch: float) -> None:
    # The pitch comes about in two turns, so its cosine is rounded: roll and yaw are each almost undetermined then, and
    # only what they do together counts.
    values = {"x": 0.3, "y": 0.2, "z": 0.1, "roll": 0.0, "pitch": pitch - 0.6, "yaw": 0.3, "offset": 0.6}
    joints = tuple(Joint(f"j{i}", "revolute", values | {"yaw": 0.3 * i}, axis=(0.0, 1.0, 0.0)) for i in range(3))
    robot = Robot("pole", "urdf", joints)
    assert_same_arm(robot, parse_urdf(robot_to_urdf(robot)[0], "again.urdf"))


def test_targets_become_links() -> None:
    targets = {"left": Frame((0.1, 0, 0)), "right": Frame((-0.1, 0, 0), (0, 0, 1))}
    robot = replace(read_robot(CONFIGS[0]), targets=targets)
    text, losses = robot_to_urdf(robot)
    for name, frame in targets.items():
        assert_same_arm(robot, parse_urdf(text, "again.urdf", None, name), frame)
    assert "targets: each becomes a link" in losses


def test_what_a_urdf_cannot_carry_is_listed() -> None:
    robot = replace(
        read_robot(ROOT / "configs" / "robots" / "puma560.yaml"),
        effects=({"effect": "backlash"}, {"other": 1}),
        base_tolerance={"x": 1e-3},
        tool_tolerance={"x": 1e-3},
        gravity=(0.0, 9.81, 0.0),
    )
    slide = Joint("slide", "prismatic", {"theta": 0.0, "d": 0.0, "a": 0.0, "alpha": 0.0})
    losses = robot_to_urdf(replace(robot, joints=(*robot.joints, slide)))[1]
    assert losses == (
        "effect backlash",
        "effect ?",
        "tolerances of j1, j2, j3, j4, j5, j6",
        "tolerances of the base",
        "tolerances of the tool",
        "gear ratio of j1, j2, j3, j4, j5, j6",
        "gravity other than 9.81 m/s^2 downwards",
        "the payload's centre of mass",
        "an unlimited range (a URDF requires limits) of slide",
    )


def test_revolute_joints_stay_revolute_and_continuous_joints_continuous() -> None:
    # Pinocchio gives a continuous joint two numbers (cosine and sine): an arm of six had nq = 12.
    robot = read_robot(ROOT / "configs" / "robots" / "puma560.yaml")
    joints = [replace(joint, limits=None) for joint in robot.joints]
    joints[5] = replace(joints[5], is_continuous=True)
    text, losses = robot_to_urdf(replace(robot, joints=tuple(joints)))
    assert text.count('type="revolute"') == text.count("<limit") == 5
    assert text.count('type="continuous"') == 1
    assert "missing limits (one turn either way is written) of j1, j2, j3, j4, j5" in losses


def test_names_that_the_robot_uses_are_left_to_it() -> None:
    joint = Joint("measuring_frame_to_base", "revolute", dict.fromkeys(ORIGIN_PARAMETERS, 0.1), link="tool0")
    robot = Robot("r", "urdf", (joint,), base=Frame((1, 0, 0)), tool=Frame((0, 1, 0)), base_link="measuring_frame")
    reread = parse_urdf(robot_to_urdf(robot)[0], "again.urdf")
    assert [item.name for item in reread.joints] == ["measuring_frame_to_base_2", "measuring_frame_to_base", "to_tool0"]
    assert_same_arm(robot, reread)
