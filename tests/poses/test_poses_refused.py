"""Pose files that are refused, with every problem at its place, and what is said of those that are not."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest
from pose_files import Reader, one_row, problem_texts

from robacc.errors import MAX_PROBLEMS, InputError
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot

# What is refused

BAD_FILES = {
    b"": "the file is empty; expected a header row",
    b"# only a comment\n\n": "the file is empty; expected a header row",
    b"a;b;c;d\nred;green;blue;grey\n": "1: the columns are separated by semicolons, expected commas; export the file",
    b"a\tb\tc\td\n": "1: the columns are separated by tabs, expected commas",
    b"a b c d\n": "1: the columns are separated by spaces, expected commas",
    b"0.1,1,2,3\n": "1: found numbers, expected a header row; begin the file with the columns' names",
    b"\xff\xfea": "the file is not UTF-8 text (it is UTF-16 or binary); save it as UTF-8",
    "q1,x,y,z\n".encode("utf-16-le"): "the file is not UTF-8 text (it is UTF-16 or binary)",
    b'"q1,x,y,z\n': "1: the header row cannot be read (unexpected end of data); close every quote",
    b",".join(b"c%d" % i for i in range(100_000)): "1: found 100000 columns; expected at most 2000",
    b"q1,x,y,z\n" + b"1" * (1 << 21): "2: the line is longer than 1 MB; expected one line per pose",
}


@pytest.mark.parametrize("content", BAD_FILES, ids=list(BAD_FILES.values()))
def test_what_is_no_table(read: Reader, content: bytes) -> None:
    (problem,) = problem_texts(read, content)
    assert BAD_FILES[content] in problem


@pytest.mark.parametrize("end", [b"\n", b"\r\n"], ids=["LF", "CRLF"])
def test_a_file_of_several_pieces(read: Reader, end: bytes) -> None:
    """Some 9 MB: every row in its order, with its line, and the digest of all bytes."""
    values = np.arange(3 * 150_000).reshape(-1, 3) / 1e6
    rows = [b"0,%.15f,%.15f,%.15f" % tuple(row) for row in values]
    rows[70_000] = b"# a comment"
    content = b"q1,x_m,y_m,z_m" + end + end.join(rows)
    data = read(content)
    row_numbers = np.delete(np.arange(150_000), 70_000)
    np.testing.assert_allclose(data.position, values[row_numbers].T, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(data.rows, row_numbers + 2)
    assert data.sha256 == hashlib.sha256(content).hexdigest()


def test_a_long_line_deep_in_a_file(read: Reader) -> None:
    rows = [b"%d,1,2,3" % (i % 7) for i in range(100_000)]
    rows[50_000] = b"1" * ((1 << 20) + 1) + b",1,2,3"
    assert problem_texts(read, b"\n".join([b"q1,x_m,y_m,z_m", *rows])) == [
        "50002: the line is longer than 1 MB; expected one line per pose"
    ]
    rows[50_000] = b"1.0" + b"0" * ((1 << 20) - 20) + b",1,2,3"
    assert read(b"\n".join([b"q1,x_m,y_m,z_m", *rows])).n == 100_000


def test_a_file_that_cannot_be_opened(tmp_path: Path) -> None:
    for path, reason in (
        (tmp_path / "none.csv", "the file does not exist"),
        (tmp_path, "is a folder, expected a file; name a file, or the folder of a ROS 2 bag"),
    ):
        with pytest.raises(InputError, match=rf"{path.name}: {reason}"):
            read_poses(path)


def test_bytes_that_are_no_text(read: Reader) -> None:
    problem = problem_texts(read, b"x,y,z,pose\n1,2,3,A\n1,2,3,M\x81ller\n")
    assert problem == ["3: byte 8 of the line, 0x81, is not UTF-8; save the file as UTF-8"]


BAD_HEADERS = {
    "q1,x,z": "1: column y is missing; expected x, y, z: the attained position",
    "q1,X_mm,z": "1: column y is missing; expected x, y, z: the attained position",
    "q1,Xa,z": "1: columns x, y are missing; expected x, y, z: the attained position (unknown in this file: Xa)",
    "x,y,z": "1: the file has measured poses only: neither joint variables nor commanded poses; give the commands with "
    "`commanded`: the robot program, or a table of joints or poses; or add columns q1 … qN (joint variables) or cmd_x,",
    "q1,q3,x,y,z": "1: column q2 is missing; expected q1 … q3 without a gap",
    "q1,x,y,z,cmd_x,cmd_z": "1: column cmd_y is missing; expected cmd_x, cmd_y, cmd_z: the commanded position",
    "q1,x,y,z,cmd_qw,cmd_qx,cmd_qy,cmd_qz": "1: columns cmd_x, cmd_y, cmd_z are missing",
    "q1,x,y,z,qw,qx,qz": "1: column qy is missing; expected qw, qx, qy, qz: the attained orientation",
    "q1,x,y,z,ry": "1: columns rx, rz are missing; expected rx, ry, rz: the attained orientation",
    "q1,x,y,z,roll,yaw": "1: column pitch is missing; expected roll, pitch, yaw: the attained orientation",
    "q1,x,y,z,rx,ry,rz,roll,pitch,yaw": "1: the attained orientation is given more than once: rx, ry, rz and roll,",
    "q1,x,y,z,sigma_x,sigma_y": "1: column sigma_z is missing; expected sigma_x, sigma_y, sigma_z: the measuring",
    "q1,x,y,z,y": "1, y: the column is a duplicate; keep one of them",
    "q1,x,y,z,y_mm": "1, y_mm: the column is a duplicate of y; keep one of them",
    "q1,x,y,z,note,note": "1, 'note': the column is a duplicate; keep one of them",
    "q1,x_deg,y,z": "1, x_deg: found unit deg in the name, expected a length (m, mm, um)",
    "q1,x,y,z,roll_mm,pitch,yaw": "1, roll_mm: found unit mm in the name, expected an angle (rad, mrad, deg)",
    "q1,x,y,z,qw_m,qx,qy,qz": "1, qw_m: found unit m in the name, expected no unit",
    "q1,x,y,z,dir_q3": "1, dir_q3: the column belongs to joint 3, but the last joint column is q1",
}


@pytest.mark.parametrize("header", BAD_HEADERS)
def test_columns_that_do_not_fit_together(read: Reader, header: str) -> None:
    (problem,) = problem_texts(read, header + "\n")
    assert BAD_HEADERS[header] in problem


def test_joint_columns_that_do_not_fit_the_robot(read: Reader) -> None:
    names, types = ["base", "lift"], ["revolute", "prismatic"]
    robot = KnownRobot(names, types)
    (problem,) = problem_texts(read, "q1,x,y,z\n", robot=robot)
    assert problem == (
        "1: the robot has 2 joints, the file has columns for 1: column q2 is missing; "
        "expected q1 … q2 without a gap, or the joints' names base, lift"
    )
    limits = [(-1.0, 1.0), (0.0, 1.0)]
    # The file's q1 may be another joint: its values are not held against limits.
    (problem,) = problem_texts(read, "q1,x,y,z\n2,1,2,3\n", robot=KnownRobot(names, types, limits))
    assert "column q2 is missing" in problem
    (problem,) = problem_texts(read, "q1,q2,q3,x,y,z\n", robot=robot)
    assert problem == "1, q3: the column belongs to joint 3, but the robot has 2 joints"
    (problem,) = problem_texts(read, "pose,x,y,z\n", robot=robot)
    assert (
        "the file has measured poses only: neither joint variables nor commanded poses; give the commands with "
        "`commanded`: the robot program, or a table of joints or poses; or add columns q1 … q2 (joint variables)"
        in problem
    )
    found_units = problem_texts(read, "base_mm,lift_deg,x,y,z\n", robot=robot)
    assert found_units == [
        "1, base_mm: found unit mm in the name, expected an angle (rad, mrad, deg)",
        "1, lift_deg: found unit deg in the name, expected a length (m, mm, um)",
    ]
    assert read("q1_mm,x,y,z\n100,1,2,3\n").q == pytest.approx(0.1)  # no robot, so it may be prismatic


SKIP = "give `skip_gaps` to leave out rows with a missing value"
BAD_VALUES: dict[str, tuple[dict[str, object], str]] = {
    "missing": ({"y": ""}, f"2, y: the value is missing, expected a number; {SKIP}"),
    "word": ({"q1": "abc"}, "2, q1: found 'abc', expected a number"),
    "long word": ({"q1": "a" * 99}, f"2, q1: found '{'a' * 39}…', expected a number"),
    "nan": ({"z": "nan"}, f"2, z: found 'nan', expected a finite number; {SKIP}"),
    "inf": ({"z": "-inf"}, f"2, z: found '-inf', expected a finite number; {SKIP}"),
    "comma": ({"z": '"1,5"'}, "2, z: found '1,5', expected a number; write decimals with a point, not a comma"),
    "no text": ({"pose": " "}, "2, pose: the value is missing, expected text"),
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
    assert problem_texts(read, one_row(**columns)) == [expected]


def test_values_at_the_edge_are_taken(read: Reader) -> None:
    row = one_row(qw=1.0009, qx=0, qy=0, qz=0, dir_q1=-1, speed_q1=1.0000005, payload_kg=0, temperature_c=-273.15)
    assert read(row, robot=KnownRobot(limits=[(-0.1, 0.1 - 1e-10)])).n == 1


def test_a_commanded_quaternion_is_checked_too(read: Reader) -> None:
    columns = {f"cmd_{name}": 1 for name in ("x", "y", "z", "qw", "qx", "qy", "qz")}
    (problem,) = problem_texts(read, one_row(**columns))
    assert problem.startswith("2, cmd_qw, cmd_qx, cmd_qy, cmd_qz: found a quaternion of length 2, expected 1")


def test_joint_limits(read: Reader) -> None:
    text = "q1_deg,q2,x,y,z\n10,0.1,1,2,3\n95.5,0.6,1,2,3\n"
    problem = problem_texts(read, text, robot=KnownRobot(limits=[(-math.pi / 2, math.pi / 2), (0, 0.5)]))
    fix = "; `ignore_limits` uses these rows all the same"
    assert problem == [
        f"3, q1_deg: found 95.5 deg, expected a value within the joint's limits -90 to 90 deg{fix}",
        f"3, q2: found 0.6, expected a value within the joint's limits 0 to 0.5{fix}",
    ]
    assert read(text, robot=KnownRobot(limits=[None, (0, 1)])).n == 2


def test_joints_stated_in_rad_beyond_limits_that_degrees_keep_have_advice(read: Reader) -> None:
    text = "q1_rad,x,y,z\n60,1,2,3\n-85.5,1,2,3\n1,2,2,3\n"
    problem = problem_texts(read, text, robot=KnownRobot(limits=[(-math.pi / 2, math.pi / 2)]))
    assert "found 60 rad" in problem[0]
    assert "if the joints are in degrees, name the columns as in q1_deg, or give `units` with deg; else" in problem[0]


@pytest.mark.parametrize(("unit", "over", "is_used"), [("deg", 0.0499, True), ("deg", 0.0501, False)])
def test_a_small_excess_of_a_limit_is_a_warning(read: Reader, unit: str, over: float, is_used: bool) -> None:
    text = f"q1_{unit},x,y,z\n{90 + over},0,0,1\n0,0,0,1\n-90,0,1,1\n"
    robot = KnownRobot(["j1"], ["revolute"], [(-math.pi / 2, math.pi / 2)])
    if is_used:
        assert (
            read(text, robot=robot)
            .warnings[0]
            .endswith(
                ":2: q1_deg exceeds the joint's limits -90 to 90 deg by at most 0.0499 deg in 1 row, which is used"
            )
        )
    else:
        assert "`ignore_limits` uses these rows all the same" in problem_texts(read, text, robot=robot)[0]
        (warning,) = read(text, robot=robot, ignore_limits=True).warnings
        assert "by at most 0.0501 deg in 1 row" in warning


def test_rounding_exceeds_no_limit(read: Reader) -> None:
    """A limit of pi as a data sheet writes it, and the angle that a controller writes in degrees."""
    robot = KnownRobot(["j1"], ["revolute"], [(-3.14159, 3.14159)])
    assert read("q1_deg,x,y,z\n180,0,0,1\n-180,0,1,1\n", robot=robot).warnings == ()
    assert len(read("q1_deg,x,y,z\n180.001,0,0,1\n-180,0,1,1\n", robot=robot).warnings) == 1


def test_the_tolerance_of_a_prismatic_joint_is_half_a_millimetre(read: Reader) -> None:
    text = "q1,x,y,z\n0.3004,0,0,1\n0.3,0,0,1\n"
    rail = KnownRobot(["rail"], ["prismatic"], [(0, 0.3)])
    assert "by at most 0.0004" in read(text, robot=rail).warnings[0]
    assert len(problem_texts(read, text.replace("0.3004", "0.3006"), robot=rail)) == 1


def test_unknown_targets(read: Reader) -> None:
    text = "q1,x,y,z,target\n0,1,2,3,smr1\n0,1,2,3,smr3x\n"
    assert read(text).n == 2
    assert problem_texts(read, text, robot=KnownRobot(target_names=("smr1", "smr3"))) == [
        "3, target: found 'smr3x', expected a target of the robot file (smr1, smr3); the nearest is smr3"
    ]
    assert read(one_row(), robot=KnownRobot(target_names=("smr1",))).n == 1
    # A robot with one tool: which of several targets it describes, nobody says.
    assert problem_texts(read, text + "0,1,2,3,smr1\n", robot=KnownRobot(target_names=())) == [
        "3, target: found several targets ('smr1', 'smr3x'), but the robot has one tool and no targets; fit "
        "tool_frame, which finds their places (`align` of estimate, `fit` of calibrate; a trace does), list "
        "each target under targets: in the robot file instead of tool, or keep the rows of one target"
    ]
    assert read(text.replace("smr3x", "smr1"), robot=KnownRobot(target_names=())).n == 2
    assert problem_texts(read, one_row(), robot=KnownRobot(target_names=("smr1", "smr3"))) == [
        "1: column target is missing: the robot file has 2 targets (smr1, smr3); "
        "add it with the measured target of each row"
    ]


BAD_ROWS = {
    "1,2,3": "2: found 3 fields, expected 4 as in the header",
    "1,2,3,4,": "2: found 5 fields, expected 4 as in the header",
    "1,0,2,0,3,0,4,0": "2: found 8 fields, expected 4 as in the header; write decimals with a point, not a comma",
    ",, ,": "2: every field of the row is empty; delete the line",
    '1,2,3,"4': "2: the row cannot be read (unexpected end of data); close every quote on its line",
}


@pytest.mark.parametrize("row", BAD_ROWS)
@pytest.mark.parametrize("header", ["q1,x,y,z", "note,x,y,z", "pose,x,y,z"])
def test_rows_that_do_not_fit_the_header(read: Reader, row: str, header: str) -> None:
    problem = [text for text in problem_texts(read, f"{header}\n{row}\n") if text.startswith("2")]
    assert problem == [BAD_ROWS[row]]


def test_rows_that_all_differ_alike_from_the_header_are_one_problem(read: Reader) -> None:
    text = "q1,x,y,z,note, with a comma\n" + "0,1,2,3,a\n" * 50
    assert problem_texts(read, text) == [
        "2: found 5 fields here and in the 49 rows below, expected 6 as in the header; "
        "give each column one name, with the same separator as in the rows"
    ]
    assert len(problem_texts(read, text + "0,1,2,3,a,b\n")) == 20  # a row fits: the others are named


OTHER_FILES = {
    b"%PDF-1.7\n": "is a PDF document, expected a table of poses; export the poses as CSV",
    b"\x1f\x8b\x08\x00": "is compressed by gzip, expected a table of poses; unpack it first",
    b"\xef\xbb\xbf\n<!DOCTYPE HTML><html>": "is an HTML page, expected a table of poses; export the poses as CSV",
}


@pytest.mark.parametrize("start", OTHER_FILES)
def test_files_of_another_kind_are_named(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "poses.csv"
    path.write_bytes(start + b"1,2,3\n")
    with pytest.raises(InputError) as caught:
        read_poses(path)
    assert str(caught.value) == f"{path}: {OTHER_FILES[start]}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"q1": [1, 2]', "cannot be read as JSON or YAML"),
        ("[[1, 2], [3, 4]]", "has no list of records, expected a table of poses"),
        ('{"robot": "ur10e"}', "has no list of records, expected a table of poses"),
        ("[" * 100_000, "cannot be read as JSON or YAML"),
    ],
)
def test_documents_without_records(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "poses.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_poses(path)
    assert len(caught.value.problems) == 1


def test_every_problem_at_once_in_the_order_of_lines(read: Reader) -> None:
    header = "q1,x,y,z,qw,qx,qy,qz,x,dir_q1,pose"
    rows = ["0,1,2,3,1,0,0,0,1,0,A", "0,1,2,3,2,0,0,0,1,5,B", "0,one,2,,1,0,0,0,1,0,C", "9,1", "0,1,2,3,1,0,0,0,1,7,D"]
    problem = problem_texts(read, "\n".join([header, *rows]))
    assert [text.partition(" ")[0] for text in problem] == ["1,", "3,", "3,", "4,", "4,", "5:", "6,"]


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
    data = read("q1,x,y,z,tims,sigm_r,\n0,1,2,3,noon,,\n")
    texts = [text.partition("poses.csv:")[2] for text in data.warnings]
    assert texts == [
        "1: unknown column 'tims' is ignored; the nearest known name is 'time_s'",
        "1: unknown column 'sigm_r' is ignored; the nearest known name is 'sigma_r'",
        "1: columns without a name are ignored: 1",
    ]
    many_columns = read("q1,x,y,z," + ",".join(f"u{i}" for i in range(25)) + "\n")
    assert len(many_columns.warnings) == 21
    assert many_columns.warnings[-1].endswith("… and 5 more unknown columns")
