"""URDF: which chain is read, what comes along, and what is refused."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from robacc.errors import InputError, RobaccError, UsageError
from robacc.robots.description import Mimic
from robacc.robots.urdf import parse_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

PROJECT = Path(__file__).resolve().parents[2]

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


def test_default_chain_runs_from_the_root_to_the_leaf_with_most_joints() -> None:
    robot = parse_urdf(TREE, "tree.urdf")
    assert (robot.base_link, robot.tip_link) == ("world", "thumb")
    assert parse_robot(robot_to_yaml(robot), "robot.yaml") == robot
    assert [joint.name for joint in robot.joints] == ["stand", "one", "two", "slide", "follow"]
    assert robot.variable_names == ("one", "two", "slide")
    assert [joint.type for joint in robot.joints] == ["fixed", "revolute", "revolute", "prismatic", "prismatic"]
    assert [joint.limits for joint in robot.variables] == [(-1, 2), None, (0, 0.1)]
    assert robot.joints[1].axis == (0, 0, 1)  # normalised
    assert (robot.joints[1].mass, robot.joints[1].com) == (2.5, (0.1, 0.2, 0.3))
    assert robot.joints[2].parameters["pitch"] == 1.5707963  # as written: not through a matrix
    assert robot.joints[4].mimic == Mimic("slide", -2.0, 0.01)
    assert [joint.link for joint in robot.joints] == ["base", "upper", "lower", "finger", "thumb"]


def test_links_choose_the_chain() -> None:
    robot = parse_urdf(TREE, "tree.urdf", "base", "flange")
    assert [joint.name for joint in robot.joints] == ["one", "two", "end"]


def test_a_mimic_of_a_mimic_follows_the_joint_that_moves() -> None:
    text = TREE.replace(
        '<parent link="base"/><child link="upper"/>',
        '<parent link="base"/><child link="upper"/><mimic joint="follow" multiplier="3" offset="0.5"/>',
    )
    robot = parse_urdf(text, "tree.urdf")
    assert robot.variable_names == ("two", "slide")
    assert robot.joints[1].mimic == Mimic("slide", -6.0, 3 * 0.01 + 0.5)


def test_infinite_limits_are_none_and_a_missing_one_is_zero() -> None:
    text = TREE.replace('lower="-1" upper="2"', 'lower="-inf" upper="inf"').replace(
        'lower="0" upper="0.1"', 'upper="0.1"'
    )
    assert [joint.limits for joint in parse_urdf(text, "t").variables] == [None, None, (0, 0.1)]


def test_a_name_is_made_up_where_the_robot_has_none_and_namespaces_are_ignored() -> None:
    text = TREE.replace('<robot name="tree">', '<robot xmlns:xacro="http://ros.org/wiki/xacro">')
    assert parse_urdf(text, "tree.urdf").name == "robot"


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


def test_what_a_chain_cannot_be_chosen_from() -> None:
    equal = TREE.replace('<parent link="finger"/><child link="thumb"/>', '<parent link="lower"/><child link="thumb"/>')
    equal = equal.replace('<mimic joint="slide" multiplier="-2" offset="0.01"/>', "")
    text = problems_of(equal)
    assert "2 chains are equally long; the tree ends at finger, thumb, flange; choose one with `tip_link`" in text
    roots = TREE.replace('<joint name="stand"', '<link name="island"/><joint name="stand"')
    assert "2 links could be the base: world, island; choose one with `base_link`" in problems_of(roots)
    assert parse_urdf(roots, "t", "world").tip_link == "thumb"
    circle = TREE.replace('<parent link="world"/><child link="base"/>', '<parent link="flange"/><child link="base"/>')
    circle = circle.replace('<link name="world"/>', "")
    assert "the joints form a loop" in problems_of(circle)
    with pytest.raises(UsageError, match="is not behind link"):
        parse_urdf(circle, "t", "thumb", "flange")
    assert "has no links" in problems_of('<robot name="r"/>')
    assert "no joint follows the link 'thumb'" in problems_of(TREE, "thumb")
    assert "no joint between 'world' and 'base' moves; choose a longer chain" in problems_of(TREE, None, "base")


def test_links_that_do_not_exist_or_do_not_follow_are_wrong_usage() -> None:
    with pytest.raises(UsageError, match=r"`tip_link`: t.urdf has no link 'flang'; it has flange"):
        parse_urdf(TREE, "t.urdf", None, "flang")
    with pytest.raises(UsageError, match=r"`base_link`: t.urdf has no link '1'; it has world, base, "):
        parse_urdf(TREE, "t.urdf", "1")
    with pytest.raises(UsageError, match="link 'base' is not behind link 'upper'"):
        parse_urdf(TREE, "t.urdf", "upper", "base")


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
        [sys.executable, "-c", code], cwd=tmp_path, env={"PYTHONPATH": str(PROJECT)}, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr


def test_every_error_is_one_of_ours_for_any_mutilation() -> None:
    # Cut anywhere, or without any one tag, the file is a robot or one of our errors and never a crash.
    tags = list(re.finditer(r"<[^<>]*>", TREE))
    cases = [TREE[:k] for k in range(0, len(TREE), 37)] + [TREE[: m.start()] + TREE[m.end() :] for m in tags]
    outcomes = set()
    for text in cases:
        try:
            parse_urdf(text, "cut.urdf")
            outcomes.add("read")
        except RobaccError:
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}


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


def test_masses_beside_the_chain_count_with_the_link_that_carries_them() -> None:
    """Camera at (0, 0, 0.6) and left arm at (0, 0.3 + 0.5, 0.4) hang on the torso; the right arm is the chain."""
    fixed = BRANCHED.replace('<joint name="left_arm" type="continuous">', '<joint name="left_arm" type="fixed">')
    torso, right, end = parse_urdf(fixed, "torso.urdf", "base", "flange").joints
    assert torso.mass == pytest.approx(16.0)
    assert torso.com == pytest.approx((0.0, 4 * 0.8 / 16, (10 * 0.2 + 2 * 0.6 + 4 * 0.4) / 16))
    assert (right.mass, right.com, end.mass) == (3.0, (0.1, 0.0, 0.0), None)


def test_a_joint_beside_the_chain_that_moves_mass_is_a_branch() -> None:
    """The left arm moves 4 kg by 0.5 m; a lighter link outside the chain counts as fixed."""
    robot = parse_urdf(BRANCHED, "torso.urdf", "base", "flange")
    assert robot.joints[0].mass == pytest.approx(12.0)
    ((joint, parent, position),) = [(b.joint, b.parent, b.position) for b in robot.branches]
    assert (joint.name, parent, position, joint.mass, joint.com) == ("left_arm", "waist", 0.0, 4.0, (0.5, 0.0, 0.0))
    light = parse_urdf(BRANCHED.replace('<mass value="4"/>', '<mass value="0.09"/>'), "torso.urdf", "base", "flange")
    assert light.branches == ()
    assert light.joints[0].mass == pytest.approx(12.09)


def test_a_chain_without_masses_stays_without() -> None:
    """A camera alone would pass for the weight of the arm."""
    text = re.sub(r'(<link name="(torso|right)">).*?</link>', r"\1</link>", BRANCHED)
    assert all(joint.mass is None for joint in parse_urdf(text, "torso.urdf", "base", "flange").joints)
