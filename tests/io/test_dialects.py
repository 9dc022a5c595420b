"""Exports of instruments and robots, in their own dialects: one command each gives the grade of the documented CSV.

The texts are made by hand after data sheets and manuals; the numbers are those of the sample poses.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
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


@dataclass(frozen=True)
class Numbers:
    """Numbers of the sample poses as texts, so that every dialect writes the same."""

    q: list[list[str]]
    """Degrees, by pose."""
    position: list[list[str]]
    """Millimetres, by pose."""
    rpy: list[list[str]]
    """Degrees about fixed x, y, z, by pose."""
    vector: list[list[str]]
    """Rotation vector in rad, by pose."""
    quaternion: list[list[str]]
    commanded: list[list[str]]
    """Millimetres, by pose."""


@pytest.fixture(scope="module")
def numbers() -> Numbers:
    robot = robacc.read_robot(ROBOT)
    data = robacc.read_poses(SAMPLES / "poses.csv", robot=robot).subset(slice(0, COUNT))
    assert data.q is not None
    assert data.rotation is not None
    errors = robacc.estimate(data, robot=robot, frame="base").errors.position

    def texts(values: np.ndarray, digits: int) -> list[list[str]]:
        return [[f"{value:.{digits}f}" for value in column] for column in values.T]

    return Numbers(
        texts(np.degrees(data.q), 5),
        texts(data.position * 1e3, 4),
        texts(np.degrees(rpy_from_rotation(data.rotation)), 6),
        texts(log_so3(data.rotation), 9),
        texts(quaternion_from_rotation(data.rotation), 9),
        texts((data.position - errors) * 1e3, 4),
    )


def table(separator: str, head: Sequence[str], rows: Sequence[Sequence[str]], comma: bool = False) -> str:
    lines = [separator.join(head), *(separator.join(row) for row in rows)]
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


Q = [f"q{i}_deg" for i in range(1, 7)]
XYZ = ["x_mm", "y_mm", "z_mm"]
RPY = ["roll_deg", "pitch_deg", "yaw_deg"]


def joined(*parts: Sequence[Sequence[str]]) -> list[list[str]]:
    return [[text for fields in row for text in fields] for row in zip(*parts, strict=True)]


def labels(*columns: str) -> list[list[str]]:
    return [[column.format(i=i, n=i + 1) for column in columns] for i in range(COUNT)]


@dataclass(frozen=True)
class Export:
    """A file of an instrument or robot."""

    content: bytes
    options: tuple[str, ...]
    plain: str
    """The same numbers as documented CSV."""
    says: str
    """Part of what is said about its columns."""
    robot: bool = True


def tracker_german(v: Numbers) -> Export:
    head = ["Punkt", *(f"A{i} [°]" for i in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]", "Rx [°]", "Ry [°]", "Rz [°]"]
    rows = joined(labels("P{n}"), v.q, v.position, v.rpy)
    body = table(";", [*head, "Bemerkung"], [[*row, "gültig"] for row in rows], comma=True)
    text = "Messprotokoll;Prüfer Müller\nDatum;22/11/2026\n\n" + body
    plain = table(",", ["pose", *Q, *XYZ, *RPY], rows)
    return Export(text.encode("cp1252"), (), plain, "A1 [°] … A6 [°] -> q1_deg … q6_deg, X [mm] -> x_mm")


def spreadsheet_utf16(v: Numbers) -> Export:
    head = [
        *(f"Joint {i} (deg)" for i in range(1, 7)),
        "Pos X (mm)",
        "Pos Y (mm)",
        "Pos Z (mm)",
        "Air Temperature (°C)",
    ]
    rows = joined(v.q, v.position, labels("21.{i}"))
    text = table("\t", head, rows)
    plain = table(",", [*Q, *XYZ, "temperature_c"], rows)
    return Export(text.encode("utf-16"), (), plain, "Joint 1 (deg) … Joint 6 (deg) -> q1_deg … q6_deg")


def kuka(v: Numbers) -> Export:
    head = [*(f"A{i}" for i in range(1, 7)), "X", "Y", "Z", "A", "B", "C", "E1"]
    rows = joined(v.q, v.position, [row[::-1] for row in v.rpy], labels("0.0"))
    plain = table(",", [*Q, *XYZ, *RPY], joined(v.q, v.position, v.rpy))
    return Export(table(";", head, rows).encode(), ("--units", "mm,deg"), plain, "A, B, C taken as kuka-abc")


def fanuc(v: Numbers) -> Export:
    head = ["No", *(f"J{i}[deg]" for i in range(1, 7)), "X[mm]", "Y[mm]", "Z[mm]", "W[deg]", "P[deg]", "R[deg]"]
    text = table("\t", head, joined(labels("{n}"), v.q, v.position, v.rpy))
    plain = table(",", [*Q, *XYZ, *RPY], joined(v.q, v.position, v.rpy))
    return Export(text.encode("utf-8-sig"), (), plain, "W[deg] -> rx_deg, P[deg] -> ry_deg, R[deg] -> rz_deg")


def robodk(v: Numbers) -> Export:
    head = ["Name", "X", "Y", "Z", "Rx", "Ry", "Rz", *(f"J{i}" for i in range(1, 7))]
    rows = joined(labels("Target {n}"), v.position, v.rpy, v.q)
    plain = table(",", ["pose", *XYZ, *RPY, *Q], rows)
    options = ("--units", "mm,deg", "--angles", "fixed-xyz")
    return Export(table(", ", head, rows).encode(), options, plain, "J1 … J6 -> q1_deg … q6_deg")


def numbered_point(v: Numbers) -> Export:
    head = ["x1", "y1", "z1", "phix1", "phiy1", "phiz1", *(f"J{i}" for i in range(1, 7))]
    plain = table(",", [*XYZ, *RPY, *Q], joined(v.position, v.rpy, v.q))
    text = table(",", head, joined(v.position, v.rpy, v.q))
    options = ("--units", "mm,deg")
    return Export(text.encode(), options, plain, "phix1, phiy1, phiz1 taken as fixed-xyz")


def report_of_nominals(v: Numbers) -> Export:
    """Points against nominal points, with deviations that are not read."""
    names = [f"{kind} {axis}" for kind in ("Nominal", "Measured") for axis in "XYZ"]
    deviations = [
        [f"{float(a) - float(b):.4f}" for a, b in zip(p, c, strict=True)]
        for p, c in zip(v.position, v.commanded, strict=True)
    ]
    rows = joined(labels("A::Main::p{n}"), v.commanded, v.position, deviations)
    text = "// Units: Millimeters\n// Frame: World\n" + table(",", ["Name", *names, "dX", "dY", "dZ"], rows)
    plain = table(
        ",",
        ["pose", "cmd_x_mm", "cmd_y_mm", "cmd_z_mm", *XYZ],
        joined(labels("A::Main::p{n}"), v.commanded, v.position),
    )
    return Export(text.encode(), (), plain, "Nominal X -> cmd_x_mm, Nominal Y -> cmd_y_mm", robot=False)


def uncertainties(v: Numbers) -> Export:
    head = "// Point   J1   J2   J3   J4   J5   J6   X   Y   Z   Ux   Uy   Uz"
    expanded = labels("0.02", "0.02", "0.04")
    text = (
        "// SpatialAnalyzer, units: mm\n"
        + head
        + "\n"
        + table("  ", [], joined(labels("p{n}"), v.q, v.position, expanded))
    )
    standard = labels("0.01", "0.01", "0.02")
    columns = ["pose", *Q, *XYZ, "sigma_x_mm", "sigma_y_mm", "sigma_z_mm"]
    plain = table(",", columns, joined(labels("p{n}"), v.q, v.position, standard))
    options = ("--units", "mm,deg", "--coverage", "2")
    return Export(text.encode(), options, plain, "Ux -> sigma_x_mm")


def ros(v: Numbers) -> Export:
    radians = [[repr(float(np.radians(float(text)))) for text in row] for row in v.q]
    metres = [[repr(float(text) / 1e3) for text in row] for row in v.position]
    head = ["header.stamp.sec", "header.stamp.nanosec", *(f"/joint_states/j{i}/position" for i in range(1, 7))]
    head += [f"pose.position.{axis}" for axis in "xyz"] + [f"pose.orientation.{axis}" for axis in "wxyz"]
    rows = joined(labels("1795341600", "{i}00000000"), radians, metres, v.quaternion)
    columns = [*(f"q{i}" for i in range(1, 7)), "x", "y", "z", "qw", "qx", "qy", "qz"]
    plain = table(",", columns, joined(radians, metres, v.quaternion))
    return Export(table(",", head, rows).encode(), (), plain, "pose.position.x -> x_m")


def universal_robots(v: Numbers) -> Export:
    radians = [[repr(float(np.radians(float(text)))) for text in row] for row in v.q]
    head = ["timestamp", *(f"target_q_{i}" for i in range(6)), *(f"actual_q_{i}" for i in range(6))]
    head += ["X[mm]", "Y[mm]", "Z[mm]", "rx", "ry", "rz"]
    rows = joined(labels("12.{i}"), radians, radians, v.position, v.vector)
    columns = ["time_s", *(f"q{i}" for i in range(1, 7)), *XYZ, "rx", "ry", "rz"]
    plain = table(",", columns, joined(labels("12.{i}"), radians, v.position, v.vector))
    return Export(
        table(" ", head, rows).encode(), ("--units", "rad"), plain, "target_q_0 … target_q_5 -> q1_rad … q6_rad"
    )


def units_line(v: Numbers) -> Export:
    head = ["Time", *(f"Axis {i}" for i in range(1, 7)), "Measured X", "Measured Y", "Measured Z", ""]
    units = ["ms", *["deg"] * 6, *["mm"] * 3, ""]
    rows = joined(labels("{i}500"), v.q, v.position, labels(""))
    text = "Channel log of cell 3\n" + "\t".join(head) + "\n" + table("\t", units, rows, comma=True)
    seconds = [[repr(float(row[0]) / 1e3)] for row in labels("{i}500")]
    plain = table(",", ["time_s", *Q, *XYZ], joined(seconds, v.q, v.position))
    return Export(text.encode(), (), plain, "Axis 1 [deg] … Axis 6 [deg] -> q1_deg … q6_deg")


def gaps(v: Numbers) -> Export:
    rows = joined(labels("{n}"), v.q, v.position)
    broken = [[*row[:7], "---", "", "NaN"] if i in (3, 9) else row for i, row in enumerate(rows)]
    head = ["Pose Number", *(f"J{i}_deg" for i in range(1, 7)), "X_mm", "Y_mm", "Z_mm"]
    plain = table(",", ["pose", *Q, *XYZ], [row for i, row in enumerate(rows) if i not in (3, 9)])
    return Export(
        table(",", head, broken).encode(), ("--skip-gaps",), plain, "2 rows with a missing value left out (line 5, 11)"
    )


EXPORTS: dict[str, Callable[[Numbers], Export]] = {
    function.__name__: function
    for function in (
        tracker_german,
        spreadsheet_utf16,
        kuka,
        fanuc,
        robodk,
        numbered_point,
        report_of_nominals,
        uncertainties,
        ros,
        universal_robots,
        units_line,
        gaps,
    )
}


def graded(path: Path, *options: str, robot: bool) -> tuple[dict[str, Any], str]:
    """The document of ``robacc estimate`` and its messages."""
    arm = ["--robot", str(ROBOT)] if robot else []
    done = CliRunner().invoke(app, ["estimate", str(path), *arm, "--format", "json", *options], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout), done.stderr


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_has_the_grade_of_the_documented_csv(name: str, numbers: Numbers, tmp_path: Path) -> None:
    export = EXPORTS[name](numbers)
    (tmp_path / "export.txt").write_bytes(export.content)
    (tmp_path / "plain.csv").write_text(export.plain, encoding="utf-8")
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


def test_a_tum_trajectory_is_known_by_its_numbers(numbers: Numbers, tmp_path: Path) -> None:
    metres = [[repr(float(text) / 1e3) for text in row] for row in numbers.position]
    xyzw = [[*row[1:], row[0]] for row in numbers.quaternion]
    lines = table(" ", ["# timestamp tx ty tz qx qy qz qw"], joined(labels("{i}.5"), metres, xyzw))
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


def test_a_column_map_settles_every_question(numbers: Numbers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``init`` writes the map; what the names leave open is an error until it is filled in."""
    monkeypatch.chdir(tmp_path)
    export = kuka(numbers)
    Path("export.csv").write_bytes(export.content)
    Path("plain.csv").write_text(export.plain, encoding="utf-8")
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
    name: str, numbers: Numbers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    export = EXPORTS[name](numbers)
    Path("export.txt").write_bytes(export.content)
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
    rows = [f"{i};{i},5;{10 * i},25;{400 + i},1;sauber" for i in range(30)]
    rows[bad] = rows[bad].replace("sauber", "SMR; neu")
    path = tmp_path / "export.csv"
    path.write_text("\n".join(["Nr.;X [mm];Y [mm];Z [mm];Bemerkung", *rows]) + "\n")
    with pytest.raises(robacc.InputError) as caught:
        robacc.read_poses(path)
    assert [problem.line for problem in caught.value.problems if "found 6 fields" in problem.message] == [bad + 2]


@pytest.mark.parametrize("gap", [0, 1, 2, 20])
def test_a_row_without_any_value_is_a_gap_wherever_it_stands(tmp_path: Path, gap: int) -> None:
    rows = [f"P{i};{i},5;{10 * i},25;{400 + i},1;{i},4;{10 * i},2;{400 + i},3" for i in range(30)]
    rows[gap] = f"P{gap};---;---;---;---;---;---"
    path = tmp_path / "export.csv"
    names = "Punkt;Soll X [mm];Soll Y [mm];Soll Z [mm];Ist X [mm];Ist Y [mm];Ist Z [mm]"
    path.write_text("\n".join([names, *rows]) + "\n")
    with pytest.raises(robacc.InputError) as caught:
        robacc.read_poses(path)
    assert {problem.line for problem in caught.value.problems} == {gap + 2}
    data = robacc.read_poses(path, skip_gaps=True)
    assert data.n == 29
