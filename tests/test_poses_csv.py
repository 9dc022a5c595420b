"""Reading and writing pose files: every column, every unit, every complaint."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from robacc.errors import MAX_PROBLEMS, InputError
from robacc.io import lines, table
from robacc.io.poses_csv import format_poses, read_poses
from robacc.measurements import Measurements, motion_between_rows

REAL = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "ipa_ur10" / "series_B.csv"
PLAIN = "q1,q2,x,y,z\n0.1,0.2,1,2,3\n-0.1,0.3,1.5,2.5,3.5\n"

Reader = Callable[..., Measurements]


@pytest.fixture
def read(tmp_path: Path) -> Reader:
    """Reads text or bytes as a file called poses.csv."""

    def reader(text: str | bytes, **options: Any) -> Measurements:
        path = tmp_path / "poses.csv"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return read_poses(path, **options)

    return reader


def complaints(reader: Reader, text: str | bytes, **options: Any) -> list[str]:
    """The problems of a file that must have some, without the folder's name."""
    with pytest.raises(InputError) as caught:
        reader(text, **options)
    return [str(problem).partition("poses.csv")[2].lstrip(":") for problem in caught.value.problems]


def one_row(**columns: object) -> str:
    """A file of one pose at joint 0.1, position 1, 2, 3 with these columns changed or added."""
    row = {"q1": 0.1, "x": 1, "y": 2, "z": 3} | columns
    return ",".join(row) + "\n" + ",".join(str(value) for value in row.values()) + "\n"


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
    found = {"x": data.position, "cmd_y": data.commanded_position, "sigma_z": data.sigma_position}[name]
    assert found is not None
    np.testing.assert_allclose(found[:, 0], 0.004, rtol=1e-15)


@pytest.mark.parametrize(("unit", "scale"), [("", 1), ("_rad", 1), ("_mrad", 1e3), ("_deg", 180 / math.pi)])
def test_angles_in_every_unit(read: Reader, unit: str, scale: float) -> None:
    text = f"q1{unit},x,y,z,sigma_r{unit},rx{unit},ry{unit},rz{unit}\n{0.3 * scale},1,2,3,{0.01 * scale}"
    data = read(f"{text},{0.1 * scale},{0.2 * scale},{-0.3 * scale}\n")
    assert data.q is not None
    assert data.sigma_rotation is not None
    assert data.rotation is not None
    assert data.q[0, 0] == pytest.approx(0.3, rel=1e-15)
    assert data.sigma_rotation[0] == pytest.approx(0.01, rel=1e-15)
    np.testing.assert_allclose(data.rotation[..., 0], Rotation.from_rotvec([0.1, 0.2, -0.3]).as_matrix(), atol=1e-15)


def test_units_give_the_nearest_number(read: Reader) -> None:
    data = read("x_mm,y_mm,z_mm,q1_deg\n1234.5,0.1,-7.3,90\n")
    assert data.position[:, 0].tolist() == [1.2345, 0.0001, -0.0073]
    assert data.q is not None
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
    found = data.commanded_rotation if prefix else data.rotation
    assert found is not None
    assert (data.rotation is None) == bool(prefix)
    np.testing.assert_allclose(found[..., 0], rotation.as_matrix(), atol=1e-15)


def test_columns_in_any_order(read: Reader) -> None:
    data = read("z,qz,q2,y,qw,q1,x,qy,qx\n3,0,0.2,2,1,0.1,1,0,0\n")
    assert data.q is not None
    np.testing.assert_array_equal(data.q[:, 0], [0.1, 0.2])
    np.testing.assert_array_equal(data.position[:, 0], [1, 2, 3])
    assert data.rotation is not None
    np.testing.assert_array_equal(data.rotation[..., 0], np.eye(3))


def test_circumstances_and_texts(read: Reader) -> None:
    data = read(one_row(pose="P1", cycle=7, target="smr 1", time_s=12.5, temperature_c=-3, payload_kg=0))
    assert data.pose is not None
    assert data.cycle is not None
    assert data.target is not None
    assert (data.pose[0], data.cycle[0], data.target[0]) == ("P1", "7", "smr 1")
    assert data.time is not None
    assert data.temperature is not None
    assert data.payload is not None
    assert (data.time[0], data.temperature[0], data.payload[0]) == (12.5, -3.0, 0.0)


def test_joints_by_their_own_names(read: Reader) -> None:
    text = "lift_mm,dir_elbow,elbow,x,y,z,speed_lift,speed_elbow,dir_q1\n250,-1,0.2,1,2,3,1,-0.5,1\n"
    data = read(text, joint_names=["lift", "elbow"], joint_types=["prismatic", "revolute"])
    assert data.q is not None
    assert data.direction is not None
    assert data.speed is not None
    assert data.q[:, 0].tolist() == [0.25, 0.2]
    assert data.direction[:, 0].tolist() == [1, -1]
    assert data.speed[:, 0].tolist() == [1, -0.5]


def test_a_joint_name_that_ends_like_a_unit(read: Reader) -> None:
    data = read("arm_m,x,y,z\n0.5,1,2,3\n", joint_names=["arm_m"])
    assert data.q is not None
    assert data.q[0, 0] == 0.5


def test_joints_counted_from_zero_are_taken_by_name(read: Reader) -> None:
    names = ["q0", "q1", "q2"]
    by_name = read("q2,q1,q0,x,y,z\n0.3,0.2,0.1,1,2,3\n", joint_names=names)
    by_number = read("q1,q2,q3,x,y,z\n0.1,0.2,0.3,1,2,3\n", joint_names=names)
    assert by_name.q is not None
    assert by_number.q is not None
    assert by_name.q[:, 0].tolist() == by_number.q[:, 0].tolist() == [0.1, 0.2, 0.3]


def test_commanded_poses_need_no_joints(read: Reader) -> None:
    data = read("x,y,z,cmd_x,cmd_y,cmd_z\n1,2,3,1,2,3\n", joint_names=["a", "b"])
    assert data.q is None
    assert data.commanded_position is not None


def test_repeated_poses_need_neither(read: Reader) -> None:
    data = read("pose,x,y,z\nP1,1,2,3\nP1,1,2,3\n")
    assert data.groups().tolist() == [0, 0]


def test_a_header_alone_is_no_pose(read: Reader) -> None:
    data = read("q1,x,y,z,qw,qx,qy,qz,pose\n", ordered=True)
    assert data.n == 0
    assert data.rotation is not None
    assert data.rotation.shape == (3, 3, 0)
    assert data.pose is not None
    assert data.pose.size == 0


def test_real_poses() -> None:
    if not REAL.is_file():
        pytest.skip("the shared data are not beside this checkout")
    data = read_poses(REAL)
    with REAL.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert data.n == len(rows)
    assert data.warnings == ()
    assert data.q is not None
    assert data.temperature is not None
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
    assert data.q is not None
    assert plain.q is not None
    np.testing.assert_array_equal(data.q, plain.q)
    np.testing.assert_array_equal(data.position, plain.position)
    assert data.warnings == ()
    assert data.rows is not None
    text = LAYOUTS[name].decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    assert [float(text[line - 1].split(",")[1].strip(' "')) for line in data.rows] == [0.2, 0.3]


def test_line_numbers_behind_comments_and_blank_lines_in_a_long_file(
    read: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lines, "_BLOCK", 300)  # so that faults lie in some blocks and not in others
    text = ["# first", "q1,x,y,z,pose"]
    expected = []
    for i in range(400):
        if i % 37 == 5:
            text += ["# between", ""]
        text.append(f"{i / 1000},1,2,3,P{i}")
        expected.append(len(text))
    data = read("\r\n".join(text))
    assert data.rows is not None
    assert data.q is not None
    assert data.pose is not None
    assert data.rows.tolist() == expected
    assert data.q[0].tolist() == [i / 1000 for i in range(400)]
    assert data.pose.tolist() == [f"P{i}" for i in range(400)]
    text[expected[250] - 1] = "0.25,1,oops,3,P250"
    assert complaints(read, "\n".join(text)) == [f"{expected[250]}, y: found 'oops', expected a number"]


def test_a_number_sign_inside_a_text_is_no_comment(read: Reader) -> None:
    data = read('x,y,z,pose,note\n1,2,3,P#1,a\n1,2,3,"P,#2",b\n')
    assert data.pose is not None
    assert data.pose.tolist() == ["P#1", "P,#2"]


def test_quotes_are_no_part_of_a_text(read: Reader) -> None:
    data = read('x,y,z,pose\n1,2,3,"P 1"\n1,2,3,"6"" pipe"\n')
    assert data.pose is not None
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
    """Whether NumPy or the one that finds faults reads a block must make no difference."""
    try:
        expected = float(np.loadtxt([f"1,{token},3"], delimiter=",", comments=None)[1])
    except ValueError:
        expected = math.nan
    if careful:
        monkeypatch.setattr(table.TableReader, "_parse_fast", lambda *_: None)
    text = f"x,y,z,pose\n1,{token},3,P\n"
    if math.isfinite(expected):
        assert read(text, units_check=False).position[1, 0] == expected
    else:
        (found,) = complaints(read, text, units_check=False)
        assert found.startswith("2, y: ")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=150)
@given(noise=st.binary(max_size=80) | st.text(alphabet='qxyz123,.-\n\r"#;_ mdeg', max_size=120).map(str.encode))
def test_any_bytes_are_read_or_refused(read: Reader, noise: bytes) -> None:
    for data in (noise, PLAIN.encode() + noise):
        with contextlib.suppress(InputError):
            assert np.isfinite(read(data).position).all()


# What is refused

BAD_FILES = {
    b"": "the file is empty; expected a header row",
    b"# only a comment\n\n": "the file is empty; expected a header row",
    b"q1;x;y;z\n1;2;3;4\n": "1: the columns are separated by semicolons, expected commas; export as comma-separated",
    b"q1\tx\ty\tz\n": "1: the columns are separated by tabs, expected commas",
    b"q1 x y z\n": "1: the columns are separated by spaces, expected commas",
    b"0.1,1,2,3\n": "1: found numbers where the header row was expected; begin the file with the columns' names",
    "q1,x,y,z\n".encode("utf-16"): "the file is not UTF-8 text (UTF-16, or no text); save it as UTF-8",
    "q1,x,y,z\n".encode("utf-16-le"): "the file is not UTF-8 text (UTF-16, or no text)",
    b'"q1,x,y,z\n': "1: the header row cannot be read (unexpected end of data); close every quote",
    b",".join(b"c%d" % i for i in range(100_000)): "1: found 100000 columns; expected at most 2000",
    b"q1,x,y,z\n" + b"1" * (1 << 21): "2: the line is longer than 1 MB; expected one line a pose",
}


@pytest.mark.parametrize("content", BAD_FILES, ids=list(BAD_FILES.values()))
def test_what_is_no_table(read: Reader, content: bytes) -> None:
    (found,) = complaints(read, content)
    assert BAD_FILES[content] in found


@pytest.mark.parametrize("end", [b"\n", b"\r\n"], ids=["LF", "CRLF"])
def test_a_file_of_several_pieces(read: Reader, end: bytes) -> None:
    """Some 9 MB: every row in its order, with its line, and the digest of all bytes."""
    values = np.arange(3 * 150_000).reshape(-1, 3) / 1e6
    rows = [b"0,%.15f,%.15f,%.15f" % tuple(row) for row in values]
    rows[70_000] = b"# a comment"
    content = b"q1,x_m,y_m,z_m" + end + end.join(rows)
    data = read(content)
    kept = np.delete(np.arange(150_000), 70_000)
    np.testing.assert_allclose(data.position, values[kept].T, rtol=0, atol=1e-15)
    assert data.rows is not None
    np.testing.assert_array_equal(data.rows, kept + 2)
    assert data.sha256 == hashlib.sha256(content).hexdigest()


def test_a_long_line_deep_in_a_file(read: Reader) -> None:
    rows = [b"%d,1,2,3" % (i % 7) for i in range(100_000)]
    rows[50_000] = b"1" * ((1 << 20) + 1) + b",1,2,3"
    assert complaints(read, b"\n".join([b"q1,x_m,y_m,z_m", *rows])) == [
        "50002: the line is longer than 1 MB; expected one line a pose"
    ]
    rows[50_000] = b"1.0" + b"0" * ((1 << 20) - 20) + b",1,2,3"
    assert read(b"\n".join([b"q1,x_m,y_m,z_m", *rows])).n == 100_000


def test_a_file_that_cannot_be_opened(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "none.csv", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError, match=rf"{path.name}: cannot be read \({reason}"):
            read_poses(path)


def test_bytes_that_are_not_utf8(read: Reader) -> None:
    found = complaints(read, b"x,y,z,pose\n1,2,3,A\n1,2,3,M\xfcller\n")
    assert found == ["3: byte 8 of the line, 0xfc, is not UTF-8; save the file as UTF-8"]


BAD_HEADERS = {
    "q1,x,z": "1: column y is missing; expected x, y, z: the attained position",
    "q1,X,z": "1: columns x, y are missing; expected x, y, z: the attained position (unknown in this file: X)",
    "x,y,z": "1: nothing says where the robot was sent: column q1 is missing; expected q1 … qN (joint variables), or",
    "q1,q3,x,y,z": "1: column q2 is missing; expected q1 … q3 without a gap",
    "q1,x,y,z,cmd_x,cmd_z": "1: column cmd_y is missing; expected cmd_x, cmd_y, cmd_z: the commanded position",
    "q1,x,y,z,cmd_qw,cmd_qx,cmd_qy,cmd_qz": "1: columns cmd_x, cmd_y, cmd_z are missing",
    "q1,x,y,z,qw,qx,qz": "1: column qy is missing; expected qw, qx, qy, qz: the attained orientation",
    "q1,x,y,z,ry": "1: columns rx, rz are missing; expected rx, ry, rz: the attained orientation",
    "q1,x,y,z,roll,yaw": "1: column pitch is missing; expected roll, pitch, yaw: the attained orientation",
    "q1,x,y,z,rx,ry,rz,roll,pitch,yaw": "1: the attained orientation is given more than once: rx, ry, rz and roll,",
    "q1,x,y,z,sigma_x,sigma_y": "1: column sigma_z is missing; expected sigma_x, sigma_y, sigma_z: the measuring",
    "q1,x,y,z,y": "1, y: the column is a duplicate; keep one of the two",
    "q1,x,y,z,y_mm": "1, y_mm: the column is a duplicate: y says the same; keep one of the two",
    "q1,x,y,z,note,note": "1, 'note': the column is a duplicate; keep one of the two",
    "q1,x_deg,y,z": "1, x_deg: found unit deg in the name, expected a length (m, mm, um)",
    "q1,x,y,z,roll_mm,pitch,yaw": "1, roll_mm: found unit mm in the name, expected an angle (rad, mrad, deg)",
    "q1,x,y,z,qw_m,qx,qy,qz": "1, qw_m: found unit m in the name, expected no unit",
    "q1,x,y,z,dir_q3": "1, dir_q3: the column belongs to joint 3, the last joint column is q1",
}


@pytest.mark.parametrize("header", BAD_HEADERS)
def test_columns_that_do_not_fit_together(read: Reader, header: str) -> None:
    (found,) = complaints(read, header + "\n")
    assert BAD_HEADERS[header] in found


def test_joint_columns_that_do_not_fit_the_robot(read: Reader) -> None:
    names, types = ["base", "lift"], ["revolute", "prismatic"]
    robot = {"joint_names": names, "joint_types": types}
    (found,) = complaints(read, "q1,x,y,z\n", **robot)
    assert found == (
        "1: the robot has 2 joints, the file has columns for 1: column q2 is missing; "
        "expected q1 … q2 without a gap, or the joints' names base, lift"
    )
    (found,) = complaints(read, "q1,q2,q3,x,y,z\n", **robot)
    assert found == "1, q3: the column belongs to joint 3, the robot has 2 joints"
    (found,) = complaints(read, "pose,x,y,z\n", **robot)
    assert "nothing says where the robot was sent: column q1 is missing; expected q1 … q2 (joint variables)" in found
    found_units = complaints(read, "base_mm,lift_deg,x,y,z\n", **robot)
    assert found_units == [
        "1, base_mm: found unit mm in the name, expected an angle (rad, mrad, deg)",
        "1, lift_deg: found unit deg in the name, expected a length (m, mm, um)",
    ]
    assert read("q1_mm,x,y,z\n100,1,2,3\n").q == pytest.approx(0.1)  # no robot, so it may be prismatic


BAD_VALUES: dict[str, tuple[dict[str, object], str]] = {
    "missing": ({"y": ""}, "2, y: the value is missing, expected a number"),
    "word": ({"q1": "abc"}, "2, q1: found 'abc', expected a number"),
    "long word": ({"q1": "a" * 99}, f"2, q1: found '{'a' * 39}…', expected a number"),
    "nan": ({"z": "nan"}, "2, z: found 'nan', expected a finite number"),
    "inf": ({"z": "-inf"}, "2, z: found '-inf', expected a finite number"),
    "comma": ({"z": '"1,5"'}, "2, z: found '1,5', expected a number; write decimals with a point, not a comma"),
    "no text": ({"pose": " "}, "2, pose: the value is missing, expected a text"),
    "long text": ({"pose": "p" * 300}, "2, pose: the text has 300 characters, expected at most 256"),
    "quaternion": (
        {"qw": 0.9, "qx": 0, "qy": 0, "qz": 0},
        "2, qw, qx, qy, qz: found a quaternion of length 0.9, expected 1 within 0.001",
    ),
    "direction": ({"dir_q1": 0.5}, "2, dir_q1: found 0.5, expected -1, 0 or 1"),
    "speed": ({"speed_q1": -1.01}, "2, speed_q1: found -1.01, expected a fraction of full speed, -1 to 1"),
    "sigma": (
        {"sigma_x_mm": 0, "sigma_y": 1e-5, "sigma_z": 1e-5},
        "2, sigma_x_mm: found 0 mm, expected a standard deviation above 0",
    ),
    "sigma_r": ({"sigma_r": -1e-5}, "2, sigma_r: found -1e-05, expected a standard deviation above 0"),
    "payload": ({"payload_kg": -1}, "2, payload_kg: found -1, expected 0 kg or more"),
    "cold": ({"temperature_c": -300}, "2, temperature_c: found -300, expected -273.15 degrees Celsius or more"),
}


@pytest.mark.parametrize("name", BAD_VALUES)
def test_values_that_cannot_be(read: Reader, name: str) -> None:
    columns, expected = BAD_VALUES[name]
    assert complaints(read, one_row(**columns)) == [expected]


def test_values_at_the_edge_are_taken(read: Reader) -> None:
    row = one_row(qw=1.0009, qx=0, qy=0, qz=0, dir_q1=-1, speed_q1=1.0000005, payload_kg=0, temperature_c=-273.15)
    assert read(row, limits=[(-0.1, 0.1 - 1e-10)]).n == 1


def test_a_commanded_quaternion_is_checked_too(read: Reader) -> None:
    columns = {f"cmd_{name}": 1 for name in ("x", "y", "z", "qw", "qx", "qy", "qz")}
    (found,) = complaints(read, one_row(**columns))
    assert found.startswith("2, cmd_qw, cmd_qx, cmd_qy, cmd_qz: found a quaternion of length 2, expected 1")


def test_joint_limits(read: Reader) -> None:
    text = "q1_deg,q2,x,y,z\n10,0.1,1,2,3\n95.5,0.6,1,2,3\n"
    found = complaints(read, text, limits=[(-math.pi / 2, math.pi / 2), (0, 0.5)])
    assert found == [
        "3, q1_deg: found 95.5 deg, expected it within the joint's limits -90 to 90 deg",
        "3, q2: found 0.6, expected it within the joint's limits 0 to 0.5",
    ]
    assert read(text, limits=[None, (0, 1)]).n == 2


def test_unknown_targets(read: Reader) -> None:
    text = "q1,x,y,z,target\n0,1,2,3,smr1\n0,1,2,3,smr3x\n"
    assert read(text).n == 2
    assert complaints(read, text, target_names=("smr1", "smr3")) == [
        "3, target: found 'smr3x', expected a target of the robot file (smr1, smr3), of which smr3 is nearest"
    ]
    assert read(one_row(), target_names=("smr1",)).n == 1
    # A robot with one tool: which of several targets it describes, nobody says.
    assert complaints(read, text + "0,1,2,3,smr1\n", target_names=()) == [
        "3, target: found several targets ('smr1', 'smr3x'), but the robot has one tool and no targets to tell them "
        "apart; list each under targets: in the robot file, in place of tool, or keep the rows of one target"
    ]
    assert read(text.replace("smr3x", "smr1"), target_names=()).n == 2
    assert complaints(read, one_row(), target_names=("smr1", "smr3")) == [
        "1: column target is missing: the robot file has 2 targets (smr1, smr3); say in each row which one was measured"
    ]


BAD_ROWS = {
    "1,2,3": "2: found 3 fields, expected 4 as in the header",
    "1,2,3,4,": "2: found 5 fields, expected 4 as in the header",
    "1,0,2,0,3,0,4,0": "2: found 8 fields, expected 4 as in the header; write decimals with a point, not a comma",
    ",, ,": "2: every field of the row is empty; delete the line",
    '1,2,3,"4': "2: the row cannot be read (unexpected end of data); a quoted field ends on the line it began on",
}


@pytest.mark.parametrize("row", BAD_ROWS)
@pytest.mark.parametrize("header", ["q1,x,y,z", "note,x,y,z", "pose,x,y,z"])
def test_rows_that_do_not_fit_the_header(read: Reader, row: str, header: str) -> None:
    found = [text for text in complaints(read, f"{header}\n{row}\n") if text.startswith("2")]
    assert found == [BAD_ROWS[row]]


def test_every_problem_at_once_in_the_order_of_lines(read: Reader) -> None:
    header = "q1,x,y,z,qw,qx,qy,qz,x,dir_q1,pose"
    rows = ["0,1,2,3,1,0,0,0,1,0,A", "0,1,2,3,2,0,0,0,1,5,B", "0,one,2,,1,0,0,0,1,0,C", "9,1", "0,1,2,3,1,0,0,0,1,7,D"]
    found = complaints(read, "\n".join([header, *rows]))
    assert [text.partition(" ")[0] for text in found] == ["1,", "3,", "3,", "4,", "4,", "5:", "6,"]


@pytest.mark.parametrize("cell", ["word", "9e9"])
def test_many_problems_are_counted(read: Reader, cell: str) -> None:
    text = "q1,x,y,z,speed_q1\n" + f"0,1,2,3,{cell}\n" * 3000
    with pytest.raises(InputError) as caught:
        read(text)
    assert len(caught.value.problems) == MAX_PROBLEMS
    assert caught.value.total == 3000
    assert [problem.line for problem in caught.value.problems] == list(range(2, 22))
    assert str(caught.value).endswith("… and 2980 more problems")


# What is said


def test_unknown_columns_are_named_with_their_nearest(read: Reader) -> None:
    data = read("q1,x,y,z,time,sigm_r,\n0,1,2,3,noon,,\n")
    texts = [text.partition("poses.csv:")[2] for text in data.warnings]
    assert texts == [
        "1: unknown column 'time' is ignored; the nearest known one is 'time_s'",
        "1: unknown column 'sigm_r' is ignored; the nearest known one is 'sigma_r'",
        "1: columns without a name are ignored: 1",
    ]
    many = read("q1,x,y,z," + ",".join(f"u{i}" for i in range(25)) + "\n")
    assert len(many.warnings) == 21
    assert many.warnings[-1].endswith("… and 5 more unknown columns")


# Direction and speed


def test_order_of_rows_gives_direction_and_speed(read: Reader) -> None:
    text = "q1,q2,x,y,z\n0,0,1,2,3\n0.5,-0.25,1,2,3\n0.5,-0.25,1,2,3\n0.5,0.75,1,2,3\n"
    data = read(text, ordered=True)
    assert data.direction is not None
    assert data.speed is not None
    assert data.ordered
    assert data.direction.tolist() == [[0, 1, 0, 0], [0, -1, 0, 1]]
    assert data.speed.tolist() == [[0, 1, 0, 0], [0, -0.5, 0, 1]]


def test_given_motion_goes_before_derived(read: Reader) -> None:
    text = "q1,q2,x,y,z,dir_q2,speed_q1\n0,0,1,2,3,1,0.5\n0.5,-0.25,1,2,3,1,0.25\n"
    data = read(text, ordered=True)
    assert data.direction is not None
    assert data.speed is not None
    assert data.direction.tolist() == [[0, 1], [1, 1]]
    assert data.speed.tolist() == [[0.5, 0.25], [0, -0.5]]
    assert data.warnings == ()


def test_motion_of_some_joints_only(read: Reader) -> None:
    data = read("q1,q2,x,y,z,dir_q2\n0,0,1,2,3,-1\n")
    assert data.direction is not None
    assert data.direction.tolist() == [[0], [-1]]
    assert data.speed is None
    assert len(data.warnings) == 1
    assert data.warnings[0].endswith("no column dir_q1: taken as 0, not moving")


def test_order_that_says_nothing_or_contradicts_itself(read: Reader) -> None:
    text = "x,y,z,cmd_x,cmd_y,cmd_z,time_s\n1,2,3,1,2,3,5\n1,2,3,1,2,3,7\n1,2,3,1,2,3,6\n"
    data = read(text, ordered=True)
    assert data.direction is None
    assert [text.partition("poses.csv: ")[2] for text in data.warnings] == [
        "without joint columns the order of rows does not say how the joints moved",
        "rows are said to be in the order measured, but time_s goes back at line 4",
    ]
    assert read(text).warnings == ()


def test_motion_is_that_of_each_step() -> None:
    q = np.random.default_rng(3).normal(size=(4, 30))
    direction, speed = motion_between_rows(q)
    for k in range(1, 30):
        step = q[:, k] - q[:, k - 1]
        np.testing.assert_array_equal(direction[:, k], np.sign(step))
        np.testing.assert_array_equal(speed[:, k], step / max(abs(step)))


# Writing

finite = st.floats(-1e8, 1e8)  # what a file of poses may hold
ids = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=8)


@st.composite
def measurements(draw: st.DrawFn) -> Measurements:
    """Any measurements that a file can hold."""
    n, joints = draw(st.integers(0, 4)), draw(st.integers(1, 3))

    def array(elements: st.SearchStrategy[Any], *shape: int) -> Any:
        count = math.prod(shape)
        return np.array(draw(st.lists(elements, min_size=count, max_size=count)), dtype=float).reshape(shape)

    def maybe(make: Callable[[], Any]) -> Any:
        return make() if draw(st.booleans()) else None

    def rotation() -> Any:
        seed = draw(st.integers(0, 2**32 - 1))
        return np.moveaxis(Rotation.random(n, rng=np.random.default_rng(seed)).as_matrix(), 0, -1).reshape(3, 3, n)

    def text() -> Any:
        return np.array(draw(st.lists(ids, min_size=n, max_size=n)), dtype=str)

    positive = st.floats(1e-12, 1e6)
    return Measurements(
        position=array(finite, 3, n),
        rotation=maybe(rotation),
        q=array(finite, joints, n),
        commanded_position=array(finite, 3, n),
        commanded_rotation=maybe(rotation),
        sigma_position=maybe(lambda: array(positive, 3, n)),
        sigma_rotation=maybe(lambda: array(positive, n)),
        pose=maybe(text),
        cycle=maybe(text),
        target=maybe(text),
        time=maybe(lambda: array(finite, n)),
        temperature=maybe(lambda: array(st.floats(-273.15, 1e9), n)),
        payload=maybe(lambda: array(st.floats(0, 1e9), n)),
        direction=maybe(lambda: array(st.sampled_from([-1, 0, 1]), joints, n)),
        speed=maybe(lambda: array(st.floats(-1, 1), joints, n)),
    )


EXACT = ("position", "q", "commanded_position", "sigma_position", "sigma_rotation", "pose", "cycle", "target")
EXACT += ("time", "temperature", "payload", "direction", "speed")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=100)
@given(data=measurements())
def test_what_is_written_is_read_back(read: Reader, data: Measurements) -> None:
    text = format_poses(data)
    back = read(text, units_check=False)
    for name in EXACT:
        expected, found = getattr(data, name), getattr(back, name)
        assert (expected is None) == (found is None), name
        if expected is not None:
            np.testing.assert_array_equal(found, expected, err_msg=name)
    for expected, found in ((data.rotation, back.rotation), (data.commanded_rotation, back.commanded_rotation)):
        assert (expected is None) == (found is None)
        if expected is not None and found is not None:
            np.testing.assert_allclose(found, expected, atol=2e-15)  # through a quaternion and back
    assert format_poses(data) == text


def test_written_columns() -> None:
    data = Measurements(
        position=np.array([[0.1], [1 / 3], [-2e-7]]),
        rotation=np.eye(3)[..., None],
        q=np.array([[0.5], [1e22]]),
        pose=np.array(["#1"]),
        direction=np.array([[1.0], [-1.0]]),
        speed=np.array([[1.0], [-0.25]]),
    )
    row = "0.5,1e+22,0.1,0.3333333333333333,-2e-07,1.0,0.0,0.0,0.0,1,-1,1.0,-0.25,#1\n"
    numbered = "q1,q2,x,y,z,qw,qx,qy,qz,dir_q1,dir_q2,speed_q1,speed_q2,pose\n"
    assert format_poses(data) == numbered + row
    named = format_poses(data, ["base", "arm"])
    assert named == numbered.replace("q1", "base").replace("q2", "arm") + row
    for taken in ("x", "q3", " arm", "#arm", ""):
        assert format_poses(data, ["base", taken]) == numbered + row
