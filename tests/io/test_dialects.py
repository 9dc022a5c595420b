"""Dialects of tables, exports of instruments and motion capture, commanded columns, and mutated exports."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import missing, output, refused, run
from sample_files import ROBOT, SAMPLES, saved

import robacc
from robacc.errors import InputError
from robacc.geometry import Array, log_so3, quaternion_from_rotation, rpy_from_rotation

COUNT = 24
Columns = dict[str, list[list[str]]]
"""Numbers of the sample poses as texts, by pose, so that every dialect writes the same."""


@pytest.fixture(scope="module")
def numbers() -> Columns:
    robot = robacc.read_robot(ROBOT)
    data = robacc.read_poses(SAMPLES / "poses.csv", robot=robot).subset(slice(0, COUNT))
    commanded = (data.position - robacc.estimate(data, robot=robot, frame="base").errors.position) * 1e3
    rpy = np.degrees(rpy_from_rotation(data.rotation))
    written = {
        "deg": (np.degrees(data.q), 5),
        "mm": (data.position * 1e3, 4),
        "rpy": (rpy, 6),
        "ypr": (rpy[::-1], 6),
        "vector": (log_so3(data.rotation), 9),
        "wxyz": (quaternion_from_rotation(data.rotation), 9),
        "cmd": (commanded, 4),
        "deviation": (data.position * 1e3 - commanded, 4),
    }
    result = {
        name: [[f"{value:.{digits}f}" for value in pose] for pose in values.T]
        for name, (values, digits) in written.items()
    }
    # In SI, the numbers are those of the texts.
    result["rad"] = [[repr(float(np.radians(float(text)))) for text in pose] for pose in result["deg"]]
    result["m"] = [[repr(float(text) / 1e3) for text in pose] for pose in result["mm"]]
    return result


def rows(numbers: Columns, parts: Sequence[str]) -> list[list[str]]:
    """Rows of named columns, and of templates of a text in which ``{i}`` counts from 0 and ``{n}`` from 1."""
    return [
        [text for part in parts for text in (numbers[part][i] if part in numbers else [part.format(i=i, n=i + 1)])]
        for i in range(COUNT)
    ]


def table(separator: str, head: Sequence[str], rows: Sequence[Sequence[str]], comma: bool = False) -> str:
    lines = [separator.join(head), *(separator.join(row) for row in rows)]
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


Q = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"
XYZ = "x_mm,y_mm,z_mm"
RPY = "roll_deg,pitch_deg,yaw_deg"
A = [f"A{i}" for i in range(1, 7)]
J = [f"J{i}" for i in range(1, 7)]


@dataclass(frozen=True)
class Export:
    """A file of an instrument or robot, made by hand, and what is said of it."""

    above: str
    head: Sequence[str]
    parts: Sequence[str]
    plain_head: str
    plain_parts: Sequence[str]
    """The same numbers as documented CSV."""
    says: str
    """Part of what is said about its columns."""
    separator: str = ","
    comma: bool = False
    encoding: str = "utf-8"
    options: tuple[str, ...] = ()
    robot: bool = True
    lost: tuple[int, ...] = ()
    """Rows without a measurement."""

    def content(self, numbers: Columns) -> bytes:
        body = rows(numbers, self.parts)
        body = [[*row[:-3], "---", "", "NaN"] if i in self.lost else row for i, row in enumerate(body)]
        return (self.above + table(self.separator, self.head, body, self.comma)).encode(self.encoding)

    def plain(self, numbers: Columns) -> str:
        body = [row for i, row in enumerate(rows(numbers, self.plain_parts)) if i not in self.lost]
        return table(",", self.plain_head.split(","), body)


EXPORTS = {
    "tracker_german": Export(
        "Messprotokoll;Prüfer Müller\nDatum;22/11/2026\n\n",
        ["Punkt", *(f"{a} [°]" for a in A), "X [mm]", "Y [mm]", "Z [mm]", "Rx [°]", "Ry [°]", "Rz [°]", "Bemerkung"],
        ("P{n}", "deg", "mm", "rpy", "gültig"),
        f"pose,{Q},{XYZ},{RPY}",
        ("P{n}", "deg", "mm", "rpy"),
        "A1 [°] … A6 [°] -> q1_deg … q6_deg, X [mm] -> x_mm",
        separator=";",
        comma=True,
        encoding="cp1252",
    ),
    "spreadsheet_utf16": Export(
        "",
        [*(f"Joint {i} (deg)" for i in range(1, 7)), *(f"Pos {axis} (mm)" for axis in "XYZ"), "Air Temperature (°C)"],
        ("deg", "mm", "21.{i}"),
        f"{Q},{XYZ},temperature_c",
        ("deg", "mm", "21.{i}"),
        "Joint 1 (deg) … Joint 6 (deg) -> q1_deg … q6_deg",
        separator="\t",
        encoding="utf-16",
    ),
    "kuka": Export(
        "",
        [*A, *"XYZABC", "E1"],
        ("deg", "mm", "ypr", "0.0"),
        f"{Q},{XYZ},{RPY}",
        ("deg", "mm", "rpy"),
        "A, B, C taken as kuka-abc",
        separator=";",
        options=("--units", "mm,deg"),
    ),
    "fanuc": Export(
        "",
        ["No", *(f"{j}[deg]" for j in J), "X[mm]", "Y[mm]", "Z[mm]", "W[deg]", "P[deg]", "R[deg]"],
        ("{n}", "deg", "mm", "rpy"),
        f"{Q},{XYZ},{RPY}",
        ("deg", "mm", "rpy"),
        "W[deg] -> rx_deg, P[deg] -> ry_deg, R[deg] -> rz_deg",
        separator="\t",
        encoding="utf-8-sig",
    ),
    "robodk": Export(
        "",
        ["Name", *"XYZ", "Rx", "Ry", "Rz", *J],
        ("Target {n}", "mm", "rpy", "deg"),
        f"pose,{XYZ},{RPY},{Q}",
        ("Target {n}", "mm", "rpy", "deg"),
        "J1 … J6 -> q1_deg … q6_deg",
        separator=", ",
        options=("--units", "mm,deg", "--angles", "fixed-xyz"),
    ),
    "numbered_point": Export(
        "",
        ["x1", "y1", "z1", "phix1", "phiy1", "phiz1", *J],
        ("mm", "rpy", "deg"),
        f"{XYZ},{RPY},{Q}",
        ("mm", "rpy", "deg"),
        "phix1, phiy1, phiz1 taken as fixed-xyz",
        options=("--units", "mm,deg"),
    ),
    # Points against nominal points, with deviations that are not read.
    "report_of_nominals": Export(
        "// Units: Millimeters\n// Frame: World\n",
        ["Name", *(f"{kind} {axis}" for kind in ("Nominal", "Measured") for axis in "XYZ"), "dX", "dY", "dZ"],
        ("A::Main::p{n}", "cmd", "mm", "deviation"),
        f"pose,cmd_x_mm,cmd_y_mm,cmd_z_mm,{XYZ}",
        ("A::Main::p{n}", "cmd", "mm"),
        "Nominal X -> cmd_x_mm, Nominal Y -> cmd_y_mm",
        robot=False,
    ),
    "uncertainties": Export(
        "// SpatialAnalyzer, units: mm\n// ",
        ["Point", *J, *"XYZ", "Ux", "Uy", "Uz"],
        ("p{n}", "deg", "mm", "0.02", "0.02", "0.04"),
        f"pose,{Q},{XYZ},sigma_x_mm,sigma_y_mm,sigma_z_mm",
        ("p{n}", "deg", "mm", "0.01", "0.01", "0.02"),
        "Ux -> sigma_x_mm",
        separator="   ",
        options=("--units", "mm,deg", "--coverage", "2"),
    ),
    "ros": Export(
        "",
        [
            *("header.stamp.sec", "header.stamp.nanosec"),
            *(f"/joint_states/j{i}/position" for i in range(1, 7)),
            *(f"pose.position.{axis}" for axis in "xyz"),
            *(f"pose.orientation.{axis}" for axis in "wxyz"),
        ],
        ("1795341600", "{i}00000000", "rad", "m", "wxyz"),
        "q1,q2,q3,q4,q5,q6,x,y,z,qw,qx,qy,qz",
        ("rad", "m", "wxyz"),
        "pose.position.x -> x_m",
    ),
    "universal_robots": Export(
        "",
        [
            "timestamp",
            *(f"{kind}_q_{i}" for kind in ("target", "actual") for i in range(6)),
            *("X[mm]", "Y[mm]", "Z[mm]", "rx", "ry", "rz"),
        ],
        ("12.{i}", "rad", "rad", "mm", "vector"),
        f"time_s,q1,q2,q3,q4,q5,q6,{XYZ},rx,ry,rz",
        ("12.{i}", "rad", "mm", "vector"),
        "target_q_0 … target_q_5 -> q1_rad … q6_rad",
        separator=" ",
        options=("--units", "rad"),
    ),
    "units_line": Export(
        "Channel log of cell 3\n"
        + "\t".join(["Time", *(f"Axis {i}" for i in range(1, 7)), *(f"Measured {axis}" for axis in "XYZ"), ""])
        + "\n",
        ["ms", *["deg"] * 6, *["mm"] * 3, ""],
        ("{i}500", "deg", "mm", ""),
        f"time_s,{Q},{XYZ}",
        ("{i}.5", "deg", "mm"),
        "Axis 1 [deg] … Axis 6 [deg] -> q1_deg … q6_deg",
        separator="\t",
        comma=True,
    ),
    "gaps": Export(
        "",
        ["Pose Number", *(f"{j}_deg" for j in J), "X_mm", "Y_mm", "Z_mm"],
        ("{n}", "deg", "mm"),
        f"pose,{Q},{XYZ}",
        ("{n}", "deg", "mm"),
        "2 rows incomplete or not measured, left out (line 5, 11)",
        options=("--skip-gaps",),
        lost=(3, 9),
    ),
}


MAPS = {"kuka": {"angles": "kuka-abc"}, "universal_robots": {"units": "mm,rad", "angles": "rotvec"}}
"""What is filled in a map of columns, where it is no degree and no angle about fixed axes."""


def graded(path: Path, *options: str, robot: bool) -> tuple[dict[str, Any], str]:
    """The document of ``robacc estimate`` and its messages."""
    arm = ["--robot", str(ROBOT)] if robot else []
    done = run("estimate", path, *arm, "--format", "json", *options)
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout), done.stderr


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_and_its_map_have_the_grade_of_the_documented_csv(
    name: str, numbers: Columns, tmp_path: Path
) -> None:
    export = EXPORTS[name]
    (tmp_path / "export.txt").write_bytes(export.content(numbers))
    (tmp_path / "plain.csv").write_text(export.plain(numbers), encoding="utf-8")
    result, messages = graded(tmp_path / "export.txt", *export.options, robot=export.robot)
    expected, plain_messages = graded(tmp_path / "plain.csv", robot=export.robot)
    assert export.says in " ".join(messages.split())
    assert "columns:" not in plain_messages
    assert result["grade"] == expected["grade"]
    assert result["n_poses"] == expected["n_poses"]
    for key in ("position", "orientation"):
        if expected[key] is None:
            assert result[key] is None
            continue
        # A convention of angles that is not documented takes another path: the last digits differ.
        np.testing.assert_allclose(
            result[key]["errors_m" if key == "position" else "errors_rad"],
            expected[key]["errors_m" if key == "position" else "errors_rad"],
            rtol=0,
            atol=1e-12,
        )
    output("init", tmp_path / "export.txt", "--folder", tmp_path)
    text = (tmp_path / "columns.yaml").read_text(encoding="utf-8")
    stated = {"units": "mm,deg", "coverage": "2", "angles": "fixed-xyz", **MAPS.get(name, {})}
    for key, value in stated.items():
        text = text.replace(f"{key}: unknown", f"{key}: {value}")
    columns = saved(tmp_path / "columns.yaml", text)
    skip = ("--skip-gaps",) if name == "gaps" else ()
    mapped, _ = graded(tmp_path / "export.txt", "--columns", str(columns), *skip, robot=export.robot)
    assert mapped["grade"] == expected["grade"]


def test_a_column_map_settles_every_question(numbers: Columns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``init`` writes the map; what the names leave open is an error until it is filled in."""
    monkeypatch.chdir(tmp_path)
    export = EXPORTS["kuka"]
    Path("export.csv").write_bytes(export.content(numbers))
    Path("plain.csv").write_text(export.plain(numbers), encoding="utf-8")
    assert "fill in angles and units in columns.yaml" in output("init", "export.csv")
    text = Path("columns.yaml").read_text(encoding="utf-8")
    assert '"A1": q1' in text
    assert '"E1":    # not read' in text
    told = refused("estimate", "export.csv", "--columns", "columns.yaml", "--robot", ROBOT, status=3)
    asked = ("columns.yaml:6, angles: expected rotvec or", "columns.yaml:7, units: is not filled in")
    assert missing(told, *asked) == []
    text = text.replace("angles: unknown", "angles: kuka-abc").replace("units: unknown", "units: mm,deg")
    Path("columns.yaml").write_text(text, encoding="utf-8")
    result, messages = graded(Path("export.csv"), "--columns", "columns.yaml", robot=True)
    expected, _ = graded(Path("plain.csv"), robot=True)
    assert result["grade"] == expected["grade"]
    assert "columns:" not in messages
    assert result["inputs"][0]["reading"]["units"] == "mm,deg"
    refused("init", "export.csv")


@pytest.mark.parametrize("bad", [0, 1, 2, 20])
def test_a_row_of_another_width_is_reported_wherever_it_stands(tmp_path: Path, bad: int) -> None:
    """A separator in a remark, near the names or far below, must not make a later row the first of the table."""
    lines = [f"{i};{i},5;{10 * i},25;{400 + i},1;sauber" for i in range(30)]
    lines[bad] = lines[bad].replace("sauber", "SMR; neu")
    path = saved(tmp_path / "export.csv", "\n".join(["Nr.;X [mm];Y [mm];Z [mm];Bemerkung", *lines]) + "\n")
    with pytest.raises(robacc.InputError) as caught:
        robacc.read_poses(path)
    assert [problem.line for problem in caught.value.problems if "found 6 fields" in problem.message] == [bad + 2]


@pytest.mark.parametrize("gap", [0, 1, 2, 20])
def test_a_row_without_any_value_is_a_gap_wherever_it_stands(tmp_path: Path, gap: int) -> None:
    lines = [f"P{i};{i},5;{10 * i},25;{400 + i},1;{i},4;{10 * i},2;{400 + i},3" for i in range(30)]
    lines[gap] = f"P{gap};---;---;---;---;---;---"
    names = "Punkt;Soll X [mm];Soll Y [mm];Soll Z [mm];Ist X [mm];Ist Y [mm];Ist Z [mm]"
    path = saved(tmp_path / "export.csv", "\n".join([names, *lines]) + "\n")
    with pytest.raises(robacc.InputError) as caught:
        robacc.read_poses(path)
    assert {problem.line for problem in caught.value.problems} == {gap + 2}
    assert robacc.read_poses(path, skip_gaps=True).n == 29


@pytest.fixture(scope="module")
def robot() -> robacc.Robot:
    return robacc.read_robot(SAMPLES / "robot.yaml")


REFUSED = {
    "job.JBI": (
        "/JOB\n//NAME CALIB\n//POS\n///PULSE\nC00000=0,0,0,0,0,0\nC00001=12034,-3323,9921,0,-22001,11\nEND\n",
        "is a job of Yaskawa; give the file of measured poses",
    ),
    "calib.ls": (
        "/PROG  CALIB\n/MN\n   1:J P[1] 10% FINE ;\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT : 1,\n"
        "\tJ1= 1.0 deg, J2= 2.0 deg, J3= 3.0 deg,\n\tJ4= 4.0 deg, J5= 5.0 deg, J6= 6.0 deg\n};\n/END\n",
        "is a robot program, which has commands but no measured poses; "
        "give the file of measured poses, and the program with `commanded`",
    ),
    "posreg.va": (
        "[*POSREG*]$POSREG\n    [1,1] =   'P1'   Group: 1\n  X:  100.0   Y:  200.0   Z:  300.0\n",
        "is a listing of FANUC variables; give the file of measured poses",
    ),
    "points.csv": (
        "Point Name,X (mm),Y (mm),Z (mm)\nP1,1023.4512,-233.1207,812.0031\nP2,998.2210,-120.8841,790.5502\n",
        "measured poses only: neither joint variables nor commanded poses; give the commands with `commanded`",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_measurement_says_what_to_give(name: str, robot: robacc.Robot, tmp_path: Path) -> None:
    content, message = REFUSED[name]
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(robacc.InputError) as caught:
        robacc.estimate(tmp_path / name, robot=robot)
    (problem,) = caught.value.problems
    assert message in str(problem)


@pytest.fixture(scope="module")
def data(robot: robacc.Robot) -> robacc.Measurements:
    return robacc.read_poses(SAMPLES / "poses.csv", robot=robot)


def moving_xyz(rotation: Array) -> Array:
    """Return roll, pitch, yaw ``(3, N)`` of Rx Ry Rz, degrees."""
    pitch = np.arcsin(rotation[0, 2])
    roll = np.arctan2(-rotation[1, 2], rotation[2, 2])
    return np.degrees([roll, pitch, np.arctan2(-rotation[0, 1], rotation[0, 0])])


def joined(head: str, rows: Iterable[Iterable[object]], separator: str) -> str:
    return head + "".join(separator.join(map(str, row)) + "\n" for row in rows)


def test_documented_roll_pitch_yaw_that_do_not_fit_are_an_error(
    data: robacc.Measurements, robot: robacc.Robot, tmp_path: Path
) -> None:
    head = ",".join([f"q{i}" for i in range(1, 7)]) + ",x,y,z,roll_deg,pitch_deg,yaw_deg\n"
    columns = np.vstack([data.q, data.position, moving_xyz(data.rotation)]).T
    path = saved(tmp_path / "poses.csv", joined(head, columns, ","))
    with pytest.raises(InputError, match="documented as about fixed axes, which they do not fit"):
        robacc.read_poses(path, robot=robot)
    read = robacc.read_poses(path, robot=robot, angles="moving-xyz")
    np.testing.assert_allclose(read.rotation, data.rotation, atol=1e-12)


COUNT_OF_COMMANDED = 12


@pytest.fixture
def data_of_commanded(data: robacc.Measurements) -> robacc.Measurements:
    return data.subset(slice(0, COUNT_OF_COMMANDED))


def tracker(data_of_commanded: robacc.Measurements, order: list[int], names: bool = True) -> str:
    """A point list of SpatialAnalyzer, as its manual describes the export of points."""
    rows = ["// SpatialAnalyzer, Units: Millimeters"]
    for i in order:
        x, y, z = (f"{value * 1e3:.4f}" for value in data_of_commanded.position[:, i])
        rows.append(f"A Main {f'p{i}' if names else 'x'} {x} {y} {z}" if names else f"{i} {x} {y} {z}")
    return "\n".join(rows) + "\n"


def joints(data_of_commanded: robacc.Measurements, order: list[int], names: bool = True) -> str:
    head = [*(["Name"] if names else []), *(f"J{i} [deg]" for i in range(1, 7))]
    rows = [
        [*([f"P{i}"] if names else []), *(f"{value:.6f}" for value in np.degrees(data_of_commanded.q[:, i]))]
        for i in order
    ]
    return "\n".join(";".join(row) for row in (head, *rows)) + "\n"


def test_points_and_joints_are_joined_by_name(data_of_commanded: robacc.Measurements, tmp_path: Path) -> None:
    order = list(range(COUNT_OF_COMMANDED))
    measured = [*order[::-1], 3]  # another order, and a point that was measured twice
    (tmp_path / "points.txt").write_text(tracker(data_of_commanded, measured), encoding="utf-8")
    (tmp_path / "joints.csv").write_text(joints(data_of_commanded, order), encoding="utf-8")
    arguments = ["estimate", f"{tmp_path}/points.txt", "--commanded", f"{tmp_path}/joints.csv", "--robot", str(ROBOT)]
    done = run(*arguments, "--format", "json")
    assert done.exit_code == 0, done.stderr
    result = json.loads(done.stdout)
    called = robacc.estimate(tmp_path / "points.txt", commanded=tmp_path / "joints.csv", robot=ROBOT, units="mm,deg")
    assert json.loads(called.to_json())["position"] == result["position"]
    assert json.loads(called.to_json())["options"] == result["options"]
    with pytest.raises(robacc.UsageError, match="`units` applies when a file is read; use it in read_poses"):
        robacc.estimate(data_of_commanded, robot=ROBOT, units="mm,deg")
    assert "joined by the names of the poses" in done.stderr
    assert result["inputs"][0]["reading"]["commanded"] == "joints.csv"
    expected = robacc.estimate(data_of_commanded, robot=ROBOT, frame="base").errors.position
    frame = robacc.estimate(data_of_commanded, robot=ROBOT).errors.position
    found = np.array(result["position"]["errors_m"]).T
    assert found.shape == (3, COUNT_OF_COMMANDED + 1)
    # Six digits of a degree are 1e-8 rad, at two metres less than a tenth of a micrometre.
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), np.linalg.norm(expected[:, measured], axis=0), atol=2e-7)
    np.testing.assert_allclose(found, frame[:, measured], atol=2e-7)


def test_files_without_common_names_are_joined_by_order(data_of_commanded: robacc.Measurements, tmp_path: Path) -> None:
    order = list(range(COUNT_OF_COMMANDED))
    text = "X;Y;Z\n" + "".join(
        ";".join(f"{v * 1e3:.4f}" for v in data_of_commanded.position[:, i]) + "\n" for i in order
    )
    (tmp_path / "points.csv").write_text(text, encoding="utf-8")
    (tmp_path / "joints.csv").write_text(joints(data_of_commanded, order), encoding="utf-8")
    robot = robacc.read_robot(ROBOT)
    read = robacc.read_poses(
        tmp_path / "points.csv", robot=robot, units="mm", commanded=tmp_path / "joints.csv", ordered=True
    )
    np.testing.assert_allclose(read.q, data_of_commanded.q, atol=1e-8)
    np.testing.assert_array_equal(read.direction[:, 1:], np.sign(np.diff(read.q)))
    assert any("joined by the order of rows: the files share no names" in warning for warning in read.warnings)
    (tmp_path / "joints.csv").write_text(joints(data_of_commanded, order[:-1]), encoding="utf-8")
    with pytest.raises(robacc.InputError, match=r"12 measured rows and 11 commands in .*, which share no names"):
        robacc.read_poses(tmp_path / "points.csv", robot=robot, units="mm", commanded=tmp_path / "joints.csv")


def test_points_without_a_command_are_left_out_unless_they_are_most(
    data_of_commanded: robacc.Measurements, tmp_path: Path
) -> None:
    (tmp_path / "points.txt").write_text(tracker(data_of_commanded, list(range(COUNT_OF_COMMANDED))), encoding="utf-8")
    (tmp_path / "joints.csv").write_text(
        joints(data_of_commanded, list(range(2, COUNT_OF_COMMANDED))), encoding="utf-8"
    )
    read = robacc.read_poses(tmp_path / "points.txt", commanded=tmp_path / "joints.csv")
    np.testing.assert_allclose(read.q, data_of_commanded.q[:, 2:], atol=1e-8)
    assert any("rows without a command in " in text and text.endswith(": p0, p1") for text in read.warnings)
    (tmp_path / "joints.csv").write_text(
        joints(data_of_commanded, list(range(8, COUNT_OF_COMMANDED))), encoding="utf-8"
    )
    with pytest.raises(robacc.InputError, match=r"8 of the measured poses have no command in .*joints\.csv: p0, p1"):
        robacc.read_poses(tmp_path / "points.txt", commanded=tmp_path / "joints.csv")


def test_commands_given_twice_are_refused(data_of_commanded: robacc.Measurements, tmp_path: Path) -> None:
    (tmp_path / "joints.csv").write_text(joints(data_of_commanded, list(range(COUNT_OF_COMMANDED))), encoding="utf-8")
    with pytest.raises(robacc.InputError, match="the measured poses have commands of their own"):
        robacc.read_poses(SAMPLES / "poses.csv", commanded=tmp_path / "joints.csv")
