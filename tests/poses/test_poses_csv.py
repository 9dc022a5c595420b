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

REAL = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ipa_ur10" / "series_B.csv"


# What is read


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
    assert not data.position.flags.writeable


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
