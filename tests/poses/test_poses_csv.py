"""Reading pose files: every column, every unit, however the text looks."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pose_files import PLAIN, Reader, one_row, problem_texts
from scipy.spatial.transform import Rotation

from robacc.errors import InputError
from robacc.io import table
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot

REAL = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ipa_ur10" / "series_B.csv"


# What is read


def test_arrays_are_components_first(read: Reader) -> None:
    data = read(PLAIN)
    np.testing.assert_array_equal(data.q, [[0.1, -0.1], [0.2, 0.3]])
    np.testing.assert_array_equal(data.position, [[1, 1.5], [2, 2.5], [3, 3.5]])
    np.testing.assert_array_equal(data.rows, [2, 3])
    assert data.rotation is None
    assert data.direction is None
    assert data.warnings == ()
    assert not data.position.flags.writeable
    assert data.sha256 == hashlib.sha256(PLAIN.encode()).hexdigest()
    assert Path(str(data.source)).name == "poses.csv"


@pytest.mark.parametrize("unit", ["", "_m", "_mm", "_um"])
@pytest.mark.parametrize("name", ["x", "cmd_y", "sigma_z"])
def test_lengths_in_every_unit(read: Reader, name: str, unit: str) -> None:
    scale = {"": 1, "_m": 1, "_mm": 1e3, "_um": 1e6}[unit]
    names = [name.replace(name[-1], axis) if "_" not in name else f"{name[:-1]}{axis}" for axis in "xyz"]
    columns: dict[str, object] = {"q1": 0.1, "x": 1, "y": 1, "z": 1} | dict.fromkeys(names, 1)
    columns = {f"{key}{unit}" if key in names else key: value for key, value in columns.items()}
    columns |= {f"{key}{unit}": 0.004 * scale for key in names}
    data = read(",".join(columns) + "\n" + ",".join(map(str, columns.values())) + "\n")
    values = {"x": data.position, "cmd_y": data.commanded_position, "sigma_z": data.sigma_position}[name]
    np.testing.assert_allclose(values[:, 0], 0.004, rtol=1e-15)


@pytest.mark.parametrize(("unit", "scale"), [("", 1), ("_rad", 1), ("_mrad", 1e3), ("_deg", 180 / math.pi)])
def test_angles_in_every_unit(read: Reader, unit: str, scale: float) -> None:
    text = f"q1{unit},x,y,z,sigma_r{unit},rx{unit},ry{unit},rz{unit}\n{0.3 * scale},1,2,3,{0.01 * scale}"
    data = read(f"{text},{0.1 * scale},{0.2 * scale},{-0.3 * scale}\n")
    assert data.q[0, 0] == pytest.approx(0.3, rel=1e-15)
    assert data.sigma_rotation[0] == pytest.approx(0.01, rel=1e-15)
    np.testing.assert_allclose(data.rotation[..., 0], Rotation.from_rotvec([0.1, 0.2, -0.3]).as_matrix(), atol=1e-15)


def test_units_give_the_nearest_number(read: Reader) -> None:
    data = read("x_mm,y_mm,z_mm,q1_deg\n1234.5,0.1,-7.3,90\n")
    assert data.position[:, 0].tolist() == [1.2345, 0.0001, -0.0073]
    assert data.q[0, 0] == math.pi / 2


@pytest.mark.parametrize("prefix", ["", "cmd_"])
@pytest.mark.parametrize("names", ["qw,qx,qy,qz", "rx,ry,rz", "roll,pitch,yaw"])
def test_every_representation_of_orientation(read: Reader, prefix: str, names: str) -> None:
    rotation = Rotation.from_euler("xyz", [0.3, -0.8, 1.7])
    x, y, z, w = rotation.as_quat()
    numbers = {"qw,qx,qy,qz": (w, x, y, z), "rx,ry,rz": rotation.as_rotvec(), "roll,pitch,yaw": (0.3, -0.8, 1.7)}[names]
    keys = [f"{prefix}{name}" for name in names.split(",")]
    values = dict(zip(keys, numbers, strict=True))
    data = read(one_row(cmd_x=1, cmd_y=2, cmd_z=3, **values))
    values = data.commanded_rotation if prefix else data.rotation
    assert (data.rotation is None) == bool(prefix)
    np.testing.assert_allclose(values[..., 0], rotation.as_matrix(), atol=1e-15)


def test_columns_in_any_order(read: Reader) -> None:
    data = read("z,qz,q2,y,qw,q1,x,qy,qx\n3,0,0.2,2,1,0.1,1,0,0\n")
    np.testing.assert_array_equal(data.q[:, 0], [0.1, 0.2])
    np.testing.assert_array_equal(data.position[:, 0], [1, 2, 3])
    np.testing.assert_array_equal(data.rotation[..., 0], np.eye(3))


def test_circumstances_and_texts(read: Reader) -> None:
    data = read(one_row(pose="P1", cycle=7, target="smr 1", time_s=12.5, temperature_c=-3, payload_kg=0))
    assert (data.pose[0], data.cycle[0], data.target[0]) == ("P1", "7", "smr 1")
    assert (data.time[0], data.temperature[0], data.payload[0]) == (12.5, -3.0, 0.0)


def test_joints_by_their_own_names(read: Reader) -> None:
    text = "lift_mm,dir_elbow,elbow,x,y,z,speed_lift,speed_elbow,dir_q1\n250,-1,0.2,1,2,3,1,-0.5,1\n"
    data = read(text, robot=KnownRobot(joint_names=["lift", "elbow"], joint_types=["prismatic", "revolute"]))
    assert data.q[:, 0].tolist() == [0.25, 0.2]
    assert data.direction[:, 0].tolist() == [1, -1]
    assert data.speed[:, 0].tolist() == [1, -0.5]


def test_a_joint_name_that_ends_like_a_unit(read: Reader) -> None:
    data = read("arm_m,x,y,z\n0.5,1,2,3\n", robot=KnownRobot(joint_names=["arm_m"]))
    assert data.q[0, 0] == 0.5


def test_joints_counted_from_zero_are_taken_by_name(read: Reader) -> None:
    names = ["q0", "q1", "q2"]
    by_name = read("q2,q1,q0,x,y,z\n0.3,0.2,0.1,1,2,3\n", robot=KnownRobot(joint_names=names))
    by_number = read("q1,q2,q3,x,y,z\n0.1,0.2,0.3,1,2,3\n", robot=KnownRobot(joint_names=names))
    assert by_name.q[:, 0].tolist() == by_number.q[:, 0].tolist() == [0.1, 0.2, 0.3]


def test_commanded_poses_need_no_joints(read: Reader) -> None:
    data = read("x,y,z,cmd_x,cmd_y,cmd_z\n1,2,3,1,2,3\n", robot=KnownRobot(joint_names=["a", "b"]))
    assert data.q is None
    assert data.commanded_position is not None


def test_repeated_poses_need_neither(read: Reader) -> None:
    data = read("pose,x,y,z\nP1,1,2,3\nP1,1,2,3\n")
    assert data.groups().tolist() == [0, 0]


def test_a_header_alone_is_no_pose(read: Reader) -> None:
    data = read("q1,x,y,z,qw,qx,qy,qz,pose\n", ordered=True)
    assert data.n == 0
    assert data.rotation.shape == (3, 3, 0)
    assert data.pose.size == 0


def test_real_poses() -> None:
    if not REAL.is_file():
        pytest.skip("the shared data are not beside this checkout")
    data = read_poses(REAL)
    with REAL.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert data.n == len(rows)
    # Its joints are as read, and 293 of its poses were visited twice. Two rows have the measured pose of the row
    # before, to nine digits, with the elbow on the other side.
    repeated, copied = data.warnings
    assert "1495 rows are read as 1202 commanded poses and their repetitions" in repeated
    assert "2 rows repeat the measured values of an earlier row to the last digit (line 534 repeats line 533)" in copied
    np.testing.assert_array_equal(data.q[4], [float(row["q5"]) for row in rows])
    np.testing.assert_array_equal(data.position[1], [float(row["y"]) for row in rows])
    np.testing.assert_array_equal(data.temperature, [float(row["temperature_c"]) for row in rows])


# How the text may look

LAYOUTS = {
    "byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "CRLF": PLAIN.replace("\n", "\r\n").encode(),
    "CR": PLAIN.replace("\n", "\r").encode(),
    "no last line end": PLAIN.rstrip("\n").encode(),
    "blank last lines": PLAIN.encode() + b"\n  \n\r\n",
    "comments": PLAIN.replace("\n", "\n# a, comment \xe4\n").encode(),
    "comment first": b"# made by hand\n\n  # twice\n" + PLAIN.encode(),
    "blank lines inside": PLAIN.replace("\n", "\n\n").encode(),
    "spaces": PLAIN.replace(",", " ,  ").encode(),
    "quotes": b'"q1","q2","x","y","z"\n"0.1",0.2,1,2,3\n-0.1,"0.3",1.5,2.5,"3.5"\n',
    "all at once": b"\xef\xbb\xbf#\r\n" + PLAIN.replace("\n", "\r\n\r\n# c\r\n").encode() + b"\r\n",
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_layout_of_the_text_changes_nothing(read: Reader, name: str) -> None:
    data, plain = read(LAYOUTS[name]), read(PLAIN)
    np.testing.assert_array_equal(data.q, plain.q)
    np.testing.assert_array_equal(data.position, plain.position)
    assert data.warnings == ()
    assert data.rows is not None
    text = LAYOUTS[name].decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    assert [float(text[line - 1].split(",")[1].strip(' "')) for line in data.rows] == [0.2, 0.3]


def test_line_numbers_behind_comments_and_blank_lines_in_a_long_file(
    read: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "_BLOCK", 300)  # so that faults lie in some blocks and not in others
    text = ["# first", "q1,x,y,z,pose"]
    expected = []
    for i in range(400):
        if i % 37 == 5:
            text += ["# between", ""]
        text.append(f"{i / 1000},1,2,3,P{i}")
        expected.append(len(text))
    data = read("\r\n".join(text))
    assert data.rows.tolist() == expected
    assert data.q[0].tolist() == [i / 1000 for i in range(400)]
    assert data.pose.tolist() == [f"P{i}" for i in range(400)]
    text[expected[250] - 1] = "0.25,1,oops,3,P250"
    assert problem_texts(read, "\n".join(text)) == [f"{expected[250]}, y: found 'oops', expected a number"]


def test_a_number_sign_inside_a_text_is_no_comment(read: Reader) -> None:
    data = read('x,y,z,pose,note\n1,2,3,P#1,a\n1,2,3,"P,#2",b\n')
    assert data.pose.tolist() == ["P#1", "P,#2"]


def test_quotes_are_no_part_of_a_text(read: Reader) -> None:
    data = read('x,y,z,pose\n1,2,3,"P 1"\n1,2,3,"6"" pipe"\n')
    assert data.pose.tolist() == ["P 1", '6" pipe']


def test_standard_input(monkeypatch: pytest.MonkeyPatch, read: Reader) -> None:
    class Stdin:
        buffer = io.BytesIO(PLAIN.encode())

    monkeypatch.setattr(sys, "stdin", Stdin())
    data = read_poses("-")
    np.testing.assert_array_equal(data.position, read(PLAIN).position)
    assert data.source == "<stdin>"
    assert data.sha256 == hashlib.sha256(PLAIN.encode()).hexdigest()


TOKENS = ["1e-3", "1E+2", ".5", "5.", "+5", "-0", " 7 ", "\t8", "0x10", "1_0", "1d5", "nan", "-inf", "infinity"]
TOKENS += ["", " ", "1 2", "1.5abc", "\u0663", "--1", "1e400", "1e-400", "1e", "0.12345678901234567890", "4.9e-324"]


@pytest.mark.parametrize("careful", [False, True])
@pytest.mark.parametrize("token", TOKENS)
def test_the_same_words_are_numbers_as_for_numpy(
    token: str, careful: bool, monkeypatch: pytest.MonkeyPatch, read: Reader
) -> None:
    """NumPy and the field-by-field parser give the same values."""
    try:
        expected = float(np.loadtxt([f"1,{token},3"], delimiter=",", comments=None)[1])
    except ValueError:
        expected = math.nan
    if careful:
        monkeypatch.setattr(table.TextTable, "_parse_fast", lambda *_: None)
    text = f"x,y,z,pose\n1,{token},3,P\n"
    if math.isfinite(expected):
        assert read(text, units_check=False).position[1, 0] == expected
    else:
        (values,) = problem_texts(read, text, units_check=False)
        assert values.startswith("2, y: ")


@pytest.mark.parametrize(
    "heading", ["q ¹", "q²", "actual q ₃", "joint ①", "branch_q1", "rot 1,rot 2,rot 3,rot 4,rot i"]
)
def test_names_that_resemble_keys_are_no_joints(read: Reader, heading: str) -> None:
    with contextlib.suppress(InputError):
        assert np.isfinite(read(f"{heading},x,y,z\n{'1,' * len(heading.split(','))}2,3,4\n").position).all()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=150)
@given(noise=st.binary(max_size=80) | st.text(alphabet='qxyz123,.-\n\r"#;_ mdeg', max_size=120).map(str.encode))
def test_any_bytes_are_read_or_refused(read: Reader, noise: bytes) -> None:
    for data in (noise, PLAIN.encode() + noise):
        with contextlib.suppress(InputError):
            assert np.isfinite(read(data).position).all()
