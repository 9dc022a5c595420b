"""Hostile YAML and XML: what expands, nests, refers elsewhere or is read otherwise than it looks is refused."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from robacc.errors import InputError
from robacc.modelling.robot_file import read_robot
from robacc.robots.description import MAX_JOINTS
from robacc.robots.urdf import parse_urdf
from robacc.robots.yaml_robot import parse_robot

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


BILLION = "\n".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9) if i else 'lol'}]" for i in range(10))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BILLION, "arm.yaml:1: cannot be read as YAML: anchors (&) and aliases (*) are not supported"),
        ("a: &a [*a]", "anchors (&) and aliases (*) are not supported"),
        ("[" * 100_000, "arm.yaml:1: cannot be read as YAML: nested deeper than 32"),
        ("{a: " * 100_000, "nested deeper than 32"),
        (ARM + "#" * (5 * 2**20), "arm.yaml: is larger than 4 MiB, the limit for YAML files"),
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
