"""Pose files: what is read, in which units, conventions of angles, and motion."""

import contextlib
import csv
import hashlib
import io
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pose_files import PLAIN, Reader, one_row, problem_texts
from sample_files import saved
from scipy.spatial.transform import Rotation

import robacc
from robacc.errors import InputError
from robacc.fitting.visits import visit_numbers
from robacc.io import table
from robacc.measurements import Measurements, motion_between_rows
from robacc.poses.checks import check_scale
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import CONVENTIONS, KnownRobot, is_ruled_out, try_conventions

# Reading pose files: every column, every unit, however the text looks.

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


def test_readings_that_agree_to_the_last_digit_do_not_hide_other_repetitions(read: Reader) -> None:
    rows = "".join(f"{q},{x},0,0\n" for x, q in enumerate((0.0, 1e-4, 0.5, 0.5, 1.0, 1.0001)))
    assert read(f"q1,x,y,z\n{rows}").groups().tolist() == [0, 0, 1, 1, 2, 2]


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
    text = LAYOUTS[name].decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    assert [float(text[line - 1].split(",")[1].strip(' "')) for line in data.rows] == [0.2, 0.3]


def test_line_numbers_behind_comments_and_blank_lines_in_a_long_file(
    read: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "_FIRST_BLOCK", 300)  # so that faults lie in some blocks and not in others
    monkeypatch.setattr(table, "_BLOCK", 300)
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


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(noise=st.binary(max_size=80) | st.text(alphabet='qxyz123,.-\n\r"#;_ mdeg', max_size=120).map(str.encode))
def test_any_bytes_are_read_or_refused(read: Reader, noise: bytes) -> None:
    for data in (noise, PLAIN.encode() + noise):
        with contextlib.suppress(InputError):
            assert np.isfinite(read(data).position).all()


# Degrees and millimetres without a unit in their names are noticed, and good data raise no alarm.

RNG = np.random.default_rng(7)
N = 40


def good() -> dict[str, Any]:
    """Poses of a six-joint arm some metres from the instrument, SI."""
    rng = np.random.default_rng(11)
    names = [f"q{i + 1}" for i in range(6)]
    data: dict[str, Any] = dict(zip(names, rng.uniform(-3, 3, (6, N)), strict=True))
    for axis, offset in zip("xyz", (2.0, -5.0, 1.0), strict=True):
        data[axis] = offset + rng.uniform(-0.8, 0.8, N)
        data[f"cmd_{axis}"] = data[axis] - offset + rng.normal(0, 1e-3, N)
    data |= dict(zip(("roll", "pitch", "yaw"), rng.uniform(-3.1, 3.1, (3, N)), strict=True))
    data |= {f"sigma_{axis}": np.full(N, 2e-5) for axis in "xyz"} | {"sigma_r": np.full(N, 1e-4)}
    return data


def read(folder: Path, data: dict[str, Any], **options: Any) -> Measurements:
    path = folder / "poses.csv"
    np.savetxt(path, np.array(list(data.values())).T, delimiter=",", header=",".join(data), comments="", fmt="%.12g")
    return read_poses(path, **options)


def unit_problems(folder: Path, data: dict[str, Any], **options: Any) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(folder, data, **options)
    return [str(problem).partition("poses.csv:")[2] for problem in caught.value.problems]


def scaled(factor: float, *names: str) -> dict[str, Any]:
    data = good()
    return data | {name: data[name] * factor for name in names}


def renamed(data: dict[str, Any], unit: str, *names: str) -> dict[str, Any]:
    return {f"{key}_{unit}" if key in names else key: value for key, value in data.items()}


ALL_JOINTS = tuple(f"q{i + 1}" for i in range(6))
SIGMAS = ("sigma_x", "sigma_y", "sigma_z")
DEGREES = math.degrees(1)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({}, id="good"),
        pytest.param({"q6": np.linspace(-2 * math.pi, 2 * math.pi, N)}, id="one turn either way"),
        pytest.param({"q6": np.r_[np.zeros(N - 5), np.full(5, 11.0)]}, id="nearly two turns, seldom"),
        pytest.param({"x": np.r_[np.zeros(N - 1), 900.0], "cmd_x": np.zeros(N)}, id="one wild reading"),
        pytest.param({axis: 60.0 + np.zeros(N) for axis in "xyz"}, id="a far instrument"),
        pytest.param({f"cmd_{axis}": np.zeros(N) for axis in "xyz"}, id="one commanded pose"),
        pytest.param({"roll": np.full(N, 2 * math.pi)}, id="a whole turn"),
        pytest.param(
            {axis: RNG.normal(0, 5e-5, N) for axis in "xyz"} | {f"cmd_{axis}": np.zeros(N) for axis in "xyz"},
            id="repeats",
        ),
    ],
)
def test_unusual_but_good_data_raise_no_alarm(tmp_path: Path, change: dict[str, Any]) -> None:
    assert read(tmp_path, good() | change).warnings == ()


LIMITED = {"robot": KnownRobot(limits=[(-3.1, 3.1)] * 6)}
TYPES = ["revolute"] * 2 + ["prismatic"] + ["revolute"] * 3
NAMES = [f"j{i}" for i in range(6)]
RAIL = {"robot": KnownRobot(NAMES, TYPES, [None, None, (0, 1), *[None] * 3])}
SMALL = {f"cmd_{axis}": 0.02 * good()[f"cmd_{axis}"] for axis in "xyz"}
FIRST = np.arange(N) < N // 2


def turned(*names: str) -> dict[str, Any]:
    """Good poses whose orientations are these three columns, in degrees."""
    data = {key: value for key, value in good().items() if key not in ("roll", "pitch", "yaw")}
    return data | dict(zip(names, np.random.default_rng(8).uniform(-90, 90, (3, N)), strict=True))


def wrong_at(row: int, data: dict[str, Any], name: str) -> dict[str, Any]:
    return data | {name: np.where(np.arange(N) == row, np.nan, data[name])}


PROBLEMS: list[tuple[dict[str, Any], dict[str, Any], list[str]]] = [
    (
        scaled(DEGREES, *ALL_JOINTS),
        LIMITED,
        [
            f"1, q1, q2, q3, q4, q5, q6: found joint angles up to "
            f"{max(np.abs(good()[name]).max() for name in ALL_JOINTS) * DEGREES:.4g}, which cannot be rad; if they "
            "are in deg, name the columns q1_deg, q2_deg, q3_deg, q4_deg, q5_deg, q6_deg, or give "
            "`units=deg`; if in rad, q1_rad and so on"
        ],
    ),
    (
        {"q1": [90.0], "q2": [-2.0], "x": [1.0], "y": [1.0], "z": [1.0]},
        {"robot": KnownRobot(limits=[(-3.1, 3.1), (-1, 1)])},
        ["1, q1: found joint angles up to 90, which cannot be rad"],
    ),
    # Small angles are noticed by the limits, and a few values that no joint reaches are enough.
    (good() | {"q2": np.linspace(-11, 11, N)}, LIMITED, ["1, q2: found joint angles up to 11, which cannot be rad"]),
    (
        good() | {"q2": np.r_[np.zeros(N - 1), -3.3]},
        LIMITED,
        [f"{N + 1}, q2: found -3.3, expected a value within the limits of q2, -3.1 to 3.1"],
    ),
    (
        good() | {"q2": np.r_[np.full(N - 1, 0.5), 30.0]},
        {},
        ["1, q2: found joint angles up to 30, which cannot be rad"],
    ),
    (good() | {"q6": np.linspace(-60, 60, N)}, {}, ["1, q6: found joint angles up to 60"]),
    (
        good() | {"q3": np.linspace(0, 900, N)},
        RAIL,
        [
            "1, q3: found joint travels of more than 50, which cannot be m; if they are in mm, name the columns q3_mm, "
            "or give `units=mm`; if in m, q3_m and so on"
        ],
    ),
    *(
        (
            scaled(1e3, *(f"{prefix}{axis}" for axis in "xyz")),
            {},
            [
                f"1, {prefix}x, {prefix}y, {prefix}z: found positions up to ",
                f"cannot be m; if they are in mm, name the columns {prefix}x_mm, {prefix}y_mm, {prefix}z_mm",
            ],
        )
        for prefix in ("", "cmd_")
    ),
    (
        {"q1": [0.5], "x": [812.5], "y": [-20.0], "z": [400.0]},
        {},
        ["found positions up to 812.5, which cannot be m"],
    ),
    (
        good() | SMALL | {axis: 1e3 * SMALL[f"cmd_{axis}"] for axis in "xyz"},
        {},
        [
            "attained positions spread 1e+03 times as far as commanded positions, so one of them is in mm",
            "put the unit in the columns' names, for example x_mm and cmd_x_m",
        ],
    ),
    *(
        (
            turned(*(f"{prefix}{name}" for name in names)),
            {},
            [
                f"1, {prefix}{names[0]}, {prefix}{names[1]}, {prefix}{names[2]}: found angles up to ",
                f"which cannot be rad; if they are in deg, name the columns {prefix}{names[0]}_deg, ",
            ],
        )
        for prefix in ("", "cmd_")
        for names in (("roll", "pitch", "yaw"), ("rx", "ry", "rz"))
    ),
    (
        scaled(2e4, *SIGMAS),
        {},
        [
            "1, sigma_x, sigma_y, sigma_z: found a typical measuring uncertainty of 0.4 m, which no instrument has; "
            "if they are in mm, name the columns sigma_x_mm"
        ],
    ),
    (scaled(1e4, "sigma_r"), {}, ["found a typical measuring uncertainty of 1 rad, which no instrument has"]),
    # Units are judged beside other problems.
    (wrong_at(3, scaled(DEGREES, *ALL_JOINTS), "y"), {}, ["1, q1, q2, q3, q4, q5, q6: found", "\n5, y: found 'nan'"]),
    (wrong_at(3, scaled(1e3, "x", "y", "z"), "x"), {}, ["1, x, y, z: found", "\n5, x: found 'nan'"]),
    # A part in another unit is named with its lines.
    (
        good() | {name: np.where(FIRST, good()[name], np.degrees(good()[name])) for name in ALL_JOINTS},
        LIMITED,
        [f", from line {N // 2 + 2} to {N + 1} only; these lines seem to be in deg and the others in rad"],
    ),
    (
        good() | {name: np.where(FIRST, 1e3 * good()[name], good()[name]) for name in "xyz"},
        {},
        [f", from line 2 to {N // 2 + 1} only; these lines seem to be in mm and the others in m"],
    ),
]


@pytest.mark.parametrize(("data", "options", "parts"), PROBLEMS, ids=lambda value: str(value)[:60])
def test_columns_in_another_unit_are_one_problem(
    tmp_path: Path, data: dict[str, Any], options: dict[str, Any], parts: list[str]
) -> None:
    problems = unit_problems(tmp_path, data, **options)
    assert all(part in "\n".join(problems) for part in parts)
    assert problems[0].startswith(parts[0]) or not parts[0][0].isdecimal()
    assert len(problems) == 1 + parts[-1].startswith("\n")


GOOD: list[tuple[dict[str, Any], dict[str, Any]]] = [
    (scaled(DEGREES, *ALL_JOINTS), {"units_check": False}),
    (renamed(scaled(DEGREES, *ALL_JOINTS), "rad", *ALL_JOINTS), {}),  # the user's word
    (good() | {"q6": np.linspace(-60, 60, N)}, {"robot": KnownRobot(limits=[None] * 5 + [(-63, 63)])}),
    (good() | {"q3": np.linspace(0, 20, N)}, {"robot": KnownRobot(NAMES, TYPES)}),
    (renamed(scaled(1e3, *"xyz"), "mm", *"xyz"), {}),
    (renamed(good() | SMALL | {axis: 1e3 * SMALL[f"cmd_{axis}"] for axis in "xyz"}, "mm", *"xyz"), {}),
    (renamed(turned("rx", "ry", "rz"), "deg", "rx", "ry", "rz"), {}),
]


@pytest.mark.parametrize(("data", "options"), GOOD, ids=lambda value: str(value)[:60])
def test_units_in_names_and_limits_are_believed(tmp_path: Path, data: dict[str, Any], options: dict[str, Any]) -> None:
    assert read(tmp_path, data, **options).n == N


def test_columns_in_degrees_and_doubtful_uncertainties(tmp_path: Path) -> None:
    q = read(tmp_path, renamed(scaled(DEGREES, *ALL_JOINTS), "deg", *ALL_JOINTS), **LIMITED).q
    np.testing.assert_allclose(q, [good()[name] for name in ALL_JOINTS], rtol=1e-10)
    data = read(tmp_path, scaled(1e3, *SIGMAS, "sigma_r"))
    assert [text.partition("poses.csv:")[2] for text in data.warnings] == [
        "1: found a typical measuring uncertainty of 0.02 m; "
        "if it is in mm, name it sigma_x_mm, sigma_y_mm, sigma_z_mm",
        "1: found a typical measuring uncertainty of 0.1 rad; if it is in deg, name it sigma_r_deg",
    ]
    assert read(tmp_path, renamed(scaled(1e3, *SIGMAS), "m", *SIGMAS)).warnings == ()


# Against the robot's size
def arm(scale: float, n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Positions of an arm of 1 m reach, ``scale`` times too large and 4 m off, and the nominal ones."""
    rng = np.random.default_rng(5)
    nominal = rng.uniform(-0.7, 0.7, (3, n))
    return (nominal + rng.normal(0, 1e-3, (3, n))) * scale + 4.0, nominal


def test_positions_are_held_against_the_robots_size() -> None:
    check_scale(*arm(1.0), "poses.csv")
    check_scale(*arm(1e3, 1), "poses.csv")  # one pose has no spread
    position = 3.0 + np.random.default_rng(6).normal(0, 1e-4, (3, 50))
    check_scale(position, np.zeros((3, 50)), None)  # repeats
    check_scale(position, position + 1.0, None)  # a target that only turns
    for scale, message in (
        (
            1e3,
            r"^poses.csv, x, y, z: the positions spread over 1.*times as far as the robot moved \(1\.2.*; if they are "
            "in mm, name the columns x_mm, y_mm, z_mm",
        ),
        (1e-3, r"less than the robot moved \(1.2.* m\); if they are in m, name the columns x, y"),
    ):
        with pytest.raises(InputError, match=message):
            check_scale(*arm(scale), "poses.csv")


# Orientations that exports write as numbered quaternions and as entries of a matrix.

TURNED = 7
JOINTS = [f"A{i}" for i in range(1, 7)]


def written(tmp_path: Path, names: list[str], columns: np.ndarray, joints: list[str] = JOINTS) -> Path:
    """Write joints, positions unless ``names`` has 12 or 16 entries of a matrix, and the given columns, with ;"""
    rng = np.random.default_rng(1)
    q, position = rng.uniform(-90, 90, (6, TURNED)), rng.uniform(-500, 500, (3, TURNED))
    has_position = len(names) >= 12
    header = [*joints, *([] if has_position else ["X", "Y", "Z"]), *names]
    rows = np.vstack((q, *([] if has_position else [position]), columns)).T
    text = "\n".join(";".join(f"{value:.12f}".replace(".", ",") for value in row) for row in rows)
    return saved(tmp_path / "export.csv", ";".join(header) + "\n" + text + "\n")


def read_turned(path: Path) -> Measurements:
    return robacc.read_poses(robacc.PoseFile(path, units="mm,deg"), ignore_limits=True)


TURNS = Rotation.random(TURNED, random_state=4)


@pytest.mark.parametrize("joints", [JOINTS, [f"J{i}" for i in range(1, 7)], [f"q{i}_deg" for i in range(1, 7)]])
def test_numbers_from_zero_beside_joints_are_a_quaternion_with_the_scalar_part_first(
    joints: list[str], tmp_path: Path
) -> None:
    x, y, z, w = TURNS.as_quat().T
    data = read_turned(written(tmp_path, ["Q0", "Q1", "Q2", "Q3"], np.stack((w, x, y, z)), joints))
    np.testing.assert_allclose(np.moveaxis(data.rotation, 2, 0), TURNS.as_matrix(), atol=1e-9)
    # The joints keep their numbers: it is the quaternion that is counted from zero.
    assert data.q.shape == (6, TURNED)
    assert data.q[0, 0] == pytest.approx(np.radians(np.random.default_rng(1).uniform(-90, 90, (6, TURNED))[0, 0]))


def test_numbers_from_one_are_a_question(tmp_path: Path) -> None:
    path = written(tmp_path, ["Q1", "Q2", "Q3", "Q4"], TURNS.as_quat().T)
    with pytest.raises(InputError, match=r"give `angles=wxyz` \(scalar part first\) or `angles=xyzw`") as caught:
        read_turned(path)
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    "names",
    [
        [f"m_{i}{j}" for i in range(4) for j in range(4)],
        [f"T[{i}][{j}]" for i in range(1, 4) for j in range(1, 5)],
        [f"r{i}{j}" for i in range(1, 4) for j in range(1, 4)],
    ],
)
def test_entries_of_a_matrix_are_a_pose(names: list[str], tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    matrix = np.zeros((TURNED, 4, 4))
    matrix[:, :3, :3], matrix[:, :3, 3], matrix[:, 3, 3] = TURNS.as_matrix(), rng.uniform(-900, 900, (TURNED, 3)), 1.0
    rows, columns = {16: (4, 4), 12: (3, 4), 9: (3, 3)}[len(names)]
    data = read_turned(written(tmp_path, names, matrix[:, :rows, :columns].reshape(TURNED, -1).T))
    np.testing.assert_allclose(np.moveaxis(data.rotation, 2, 0), TURNS.as_matrix(), atol=1e-9)
    if columns == 4:
        np.testing.assert_allclose(data.position, 1e-3 * matrix[:, :3, 3].T, atol=1e-12)
    assert any("as a matrix" in text for text in data.warnings)


def test_a_matrix_that_is_no_rotation_is_refused_with_its_line(tmp_path: Path) -> None:
    entries = TURNS.as_matrix().reshape(TURNED, 9).T.copy()
    entries[:, 2] *= 1.1
    with pytest.raises(InputError, match="not those of a rotation matrix") as caught:
        read_turned(written(tmp_path, [f"r{i}{j}" for i in range(1, 4) for j in range(1, 4)], entries))
    assert caught.value.problems[0].line == 4


@pytest.mark.parametrize("names", ["Rx [deg],Ry [deg],Rz [deg]", "rx,ry,rz", "roll_deg,pitch_deg,yaw_deg"])
def test_the_order_of_a_quaternion_says_nothing_of_three_angles(tmp_path: Path, names: str) -> None:
    rows = "".join(f"{i / 10},0,0,{i / 10},0.2,{-i / 10},{i / 10},0,0\n" for i in range(1, 4))
    (tmp_path / "poses.csv").write_text(f"x,y,z,{names},cmd_x,cmd_y,cmd_z\n{rows}", encoding="utf-8")
    try:
        assert robacc.read_poses(tmp_path / "poses.csv", angles="wxyz").n == 3
    except InputError as error:
        (problem,) = error.problems
        assert "these may be angles of several conventions" in problem.message


# Conventions of angles: their rotations, and the trial that tells them apart without knowing any frame.

DISTINCT = ("rotvec", "fixed-xyz", "moving-xyz", "kuka-abc", "zyz")


@pytest.mark.parametrize("truth", DISTINCT)
def test_the_data_show_their_convention_in_unknown_frames(truth: str) -> None:
    rng = np.random.default_rng(2)
    angles = rng.uniform(-1.5, 1.5, (3, 40))
    base, tool = Rotation.random(2, random_state=3).as_matrix()
    known = np.einsum("ij,jkn,kl->iln", base, CONVENTIONS[truth](angles), tool)
    noise = Rotation.from_rotvec(1e-3 * rng.normal(size=(40, 3))).as_matrix()
    trial = try_conventions(angles, np.einsum("ijn,njk->ikn", known, noise), DISTINCT)
    assert min(trial, key=trial.get) == truth
    assert [name for name in trial if not is_ruled_out(name, trial)] == [truth]


def test_turns_of_some_degrees_show_the_convention_of_good_measurements() -> None:
    rng = np.random.default_rng(7)
    angles = rng.uniform(-0.12, 0.12, (3, 60)) + np.array([[-1.57], [-0.35], [-1.57]])
    noise = Rotation.from_rotvec(1e-3 * rng.normal(size=(60, 3))).as_matrix()
    known = np.einsum("ijn,njk->ikn", CONVENTIONS["moving-xyz"](angles), noise)
    trial = try_conventions(angles, known, ("rotvec", "fixed-xyz", "moving-xyz"))
    assert max(trial.values()) < np.radians(3.0)
    assert [name for name in trial if not is_ruled_out(name, trial)] == ["moving-xyz"]


def test_small_turns_show_nothing() -> None:
    angles = np.random.default_rng(4).normal(0, 1e-3, (3, 30))
    assert try_conventions(angles, CONVENTIONS["rotvec"](angles), DISTINCT) is None


def rows(n: int = 20) -> list[str]:
    """Poses whose attained angles about fixed axes differ a little from the commanded quaternion."""
    euler = np.random.default_rng(5).uniform(-60, 60, (n, 3))
    quaternions = Rotation.from_euler("xyz", euler, degrees=True).as_quat()
    return [
        ",".join(map(repr, (*[0.1 * i, 0.2, 0.3], *angles, *[0.1 * i, 0.2, 0.3], q[3], q[0], q[1], q[2])))
        for i, (angles, q) in enumerate(zip(euler.tolist(), quaternions.tolist(), strict=True))
    ]


COMMANDED = "cmd_x,cmd_y,cmd_z,cmd_qw,cmd_qx,cmd_qy,cmd_qz"


def test_documented_names_that_the_data_contradict_are_a_question(read: Reader) -> None:
    text = "\n".join([f"x,y,z,rx_deg,ry_deg,rz_deg,{COMMANDED}", *rows()])
    (problem,) = problem_texts(read, text)
    assert problem.startswith("1, rx_deg, ry_deg, rz_deg: these are documented as a rotation vector, which they do not")
    assert "fixed-xyz by " in problem
    assert problem.endswith("give `angles=fixed-xyz` (trackers, FANUC, Yaskawa)")


def test_ambiguous_names_are_taken_as_the_data_show_or_asked_for(read: Reader) -> None:
    body = rows()
    data = read("\n".join([f"X [m],Y [m],Z [m],Rx [deg],Ry [deg],Rz [deg],{COMMANDED}", *body]))
    np.testing.assert_allclose(data.rotation, data.commanded_rotation, atol=1e-12)
    assert any("taken as fixed-xyz" in warning for warning in data.warnings)
    alone = [",".join([*row.split(",")[:9], "1"]) for row in body]
    (problem,) = problem_texts(
        read, "\n".join(["X [m],Y [m],Z [m],Rx [deg],Ry [deg],Rz [deg],cmd_x,cmd_y,cmd_z,pose", *alone])
    )
    assert (
        "these may be angles of several conventions; give `angles=rotvec` (Universal Robots) or `angles=fixed-xyz`"
        in problem
    )


# Direction and speed of approach: from columns, or from the order of rows.


def test_motion_is_that_of_each_step() -> None:
    q = np.random.default_rng(3).normal(size=(4, 30))
    direction, speed = motion_between_rows(q)
    for k in range(1, 30):
        step = q[:, k] - q[:, k - 1]
        np.testing.assert_array_equal(direction[:, k], np.sign(step))
        np.testing.assert_array_equal(speed[:, k], step / max(abs(step)))


SMRS = "q1,q2,x,y,z,target\n"
ROWS = (("0,0", "ab"), ("0.5,-0.25", "ab"), ("0.5,0.75", "abab"), ("0,0", "ba"))
"""Joints of each arrival, and the targets measured there in turn: the third pose is measured twice."""


def test_every_target_of_a_visit_has_the_motion_of_the_visit(read: Reader) -> None:
    text = SMRS + "".join(
        f"{q},1,2,{i}.{j},{target}\n" for i, (q, ts) in enumerate(ROWS) for j, target in enumerate(ts)
    )
    data = read(text, ordered=True)
    # The second reading of both targets at the third pose is a visit that the arm did not move to.
    assert data.direction.tolist() == [[0, 0, 1, 1, 0, 0, 0, 0, -1, -1], [0, 0, -1, -1, 1, 1, 0, 0, -1, -1]]
    np.testing.assert_allclose(data.speed[1], [0, 0, -0.5, -0.5, 1, 1, 0, 0, -1, -1])
    # The last arrival is at the joints of the first: consecutive rows alone are a visit.
    assert visit_numbers(data).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        ("visit,q1", "7,0 7,0.0002 8,1 8,1 9,1 9,1 3,0 3,0"),
        ("pose,cycle,q1", "a,1,0 a,1,0.0002 b,1,1 b,1,1 b,2,1 b,2,1 a,2,0 a,2,0"),
        ("pose,target,q1", "a,s,0 a,t,0.0002 b,s,1 b,t,1 b,s,1 b,t,1 a,s,0 a,t,0"),
    ],
)
def test_visits_are_named_by_their_column_or_by_pose_and_cycle_or_by_targets(
    read: Reader, columns: str, rows: str
) -> None:
    text = f"{columns},x,y,z\n" + "".join(f"{row},1,2,{i}\n" for i, row in enumerate(rows.split()))
    data = read(text, ordered=True)
    assert data.direction[0].tolist() == [0, 0, 1, 1, 0, 0, -1, -1]
    numbers = visit_numbers(data)
    pairs = numbers.reshape(4, 2)
    assert (pairs[:, 0] == pairs[:, 1]).all()
    assert np.unique(numbers).size == 4


def test_motion_of_a_file_with_one_row_a_visit_is_that_of_its_rows(read: Reader) -> None:
    q = np.random.default_rng(5).normal(size=(2, 40))
    q[:, 10] = q[:, 9]
    rows = [f"{v},{a!r},{b!r},1,2,{v}" for v, (a, b) in enumerate(q.T.tolist())]
    with_visits = read("\n".join(["visit,q1,q2,x,y,z", *rows]), ordered=True)
    direction, speed = motion_between_rows(q)
    np.testing.assert_array_equal(with_visits.direction, direction)
    np.testing.assert_array_equal(with_visits.speed, speed)
