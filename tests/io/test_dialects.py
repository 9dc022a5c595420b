"""Exports of instruments and robots, in their own dialects: one command each gives the grade of the documented CSV.

The texts are made by hand after data sheets and manuals; the numbers are those of the sample poses.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import robacc
from robacc.cli.main import app
from robacc.geometry import log_so3, quaternion_from_rotation, rpy_from_rotation

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
ROBOT = SAMPLES / "robot.yaml"
COUNT = 24


Columns = dict[str, list[list[str]]]
"""Numbers of the sample poses as texts, by pose, so that every dialect writes the same."""


@pytest.fixture(scope="module")
def numbers() -> Columns:
    robot = robacc.read_robot(ROBOT)
    data = robacc.read_poses(SAMPLES / "poses.csv", robot=robot).subset(slice(0, COUNT))
    assert data.q is not None
    assert data.rotation is not None
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
        "2 rows with a missing value left out (line 5, 11)",
        options=("--skip-gaps",),
        lost=(3, 9),
    ),
}


def graded(path: Path, *options: str, robot: bool) -> tuple[dict[str, Any], str]:
    """The document of ``robacc estimate`` and its messages."""
    arm = ["--robot", str(ROBOT)] if robot else []
    done = CliRunner().invoke(app, ["estimate", str(path), *arm, "--format", "json", *options], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout), done.stderr


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_has_the_grade_of_the_documented_csv(name: str, numbers: Columns, tmp_path: Path) -> None:
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


def test_a_tum_trajectory_is_known_by_its_numbers(numbers: Columns, tmp_path: Path) -> None:
    xyzw = [[*quaternion[1:], quaternion[0]] for quaternion in numbers["wxyz"]]
    lines = table(" ", ["# timestamp tx ty tz qx qy qz qw"], rows({**numbers, "xyzw": xyzw}, ("{i}.5", "m", "xyzw")))
    path = tmp_path / "tracker.tum"
    path.write_text(lines.partition("\n")[2], encoding="utf-8")
    with pytest.raises(robacc.InputError) as caught:
        robacc.read_poses(path)
    # A trajectory has no commands: that is the only problem.
    (problem,) = caught.value.problems
    assert "neither joint variables nor commanded poses" in str(problem)
    assert "unknown" not in str(problem)
    path.write_text(lines.partition("\n")[2].replace("0.", "0.9", 40), encoding="utf-8")
    with pytest.raises(robacc.InputError, match="found numbers, expected a header row"):
        robacc.read_poses(path)


def test_a_column_map_settles_every_question(numbers: Columns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``init`` writes the map; what the names leave open is an error until it is filled in."""
    monkeypatch.chdir(tmp_path)
    export = EXPORTS["kuka"]
    Path("export.csv").write_bytes(export.content(numbers))
    Path("plain.csv").write_text(export.plain(numbers), encoding="utf-8")
    done = CliRunner().invoke(app, ["init", "export.csv"], catch_exceptions=False)
    assert done.exit_code == 0
    assert "fill in angles and units in columns.yaml" in done.stdout
    text = Path("columns.yaml").read_text(encoding="utf-8")
    assert '"A1": q1' in text
    assert '"E1":    # not read' in text
    refused = CliRunner().invoke(app, ["estimate", "export.csv", "--columns", "columns.yaml", "--robot", str(ROBOT)])
    assert refused.exit_code == 3
    assert "columns.yaml:6, angles: expected rotvec or" in refused.stderr
    assert "columns.yaml:7, units: is not filled in" in refused.stderr
    text = text.replace("angles: unknown", "angles: kuka-abc").replace("units: unknown", "units: mm,deg")
    Path("columns.yaml").write_text(text, encoding="utf-8")
    result, messages = graded(Path("export.csv"), "--columns", "columns.yaml", robot=True)
    expected, _ = graded(Path("plain.csv"), robot=True)
    assert result["grade"] == expected["grade"]
    assert "columns:" not in messages
    assert result["inputs"][0]["reading"]["units"] == "mm,deg"
    assert CliRunner().invoke(app, ["init", "export.csv"]).exit_code == 2


@pytest.mark.parametrize("name", EXPORTS)
def test_the_map_of_every_export_reads_it_alike(
    name: str, numbers: Columns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    export = EXPORTS[name]
    Path("export.txt").write_bytes(export.content(numbers))
    assert CliRunner().invoke(app, ["init", "export.txt"], catch_exceptions=False).exit_code == 0
    text = Path("columns.yaml").read_text(encoding="utf-8")
    convention = "kuka-abc" if name == "kuka" else "fixed-xyz"
    for key, value in (("units", "mm,deg"), ("coverage", "2"), ("angles", convention)):
        text = text.replace(f"{key}: unknown", f"{key}: {value}")
    if name == "universal_robots":
        text = text.replace("units: mm,deg", "units: mm,rad").replace("angles: fixed-xyz", "angles: rotvec")
    Path("columns.yaml").write_text(text, encoding="utf-8")
    skip = ("--skip-gaps",) if name == "gaps" else ()
    result, _ = graded(Path("export.txt"), "--columns", "columns.yaml", *skip, robot=export.robot)
    expected, _ = graded(Path("export.txt"), *export.options, robot=export.robot)
    assert result["grade"] == expected["grade"]


@pytest.mark.parametrize("bad", [0, 1, 2, 20])
def test_a_row_of_another_width_is_reported_wherever_it_stands(tmp_path: Path, bad: int) -> None:
    """A separator in a remark, near the names or far below, must not make a later row the first of the table."""
    lines = [f"{i};{i},5;{10 * i},25;{400 + i},1;sauber" for i in range(30)]
    lines[bad] = lines[bad].replace("sauber", "SMR; neu")
    path = tmp_path / "export.csv"
    path.write_text("\n".join(["Nr.;X [mm];Y [mm];Z [mm];Bemerkung", *lines]) + "\n")
    with pytest.raises(robacc.InputError) as caught:
        robacc.read_poses(path)
    assert [problem.line for problem in caught.value.problems if "found 6 fields" in problem.message] == [bad + 2]


@pytest.mark.parametrize("gap", [0, 1, 2, 20])
def test_a_row_without_any_value_is_a_gap_wherever_it_stands(tmp_path: Path, gap: int) -> None:
    lines = [f"P{i};{i},5;{10 * i},25;{400 + i},1;{i},4;{10 * i},2;{400 + i},3" for i in range(30)]
    lines[gap] = f"P{gap};---;---;---;---;---;---"
    path = tmp_path / "export.csv"
    names = "Punkt;Soll X [mm];Soll Y [mm];Soll Z [mm];Ist X [mm];Ist Y [mm];Ist Z [mm]"
    path.write_text("\n".join([names, *lines]) + "\n")
    with pytest.raises(robacc.InputError) as caught:
        robacc.read_poses(path)
    assert {problem.line for problem in caught.value.problems} == {gap + 2}
    data = robacc.read_poses(path, skip_gaps=True)
    assert data.n == 29
