"""Tables with one row for each axis, and with several targets in each row."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import robacc
from robacc.errors import InputError

ROBOT = """
robacc: 1
name: two targets
convention: standard
units: {length: mm, angle: deg}
targets: {t1: {xyz: [0, 0, 100]}, t2: {xyz: [0, 50, 100]}}
joints:
  - {name: j1, type: revolute, theta: 0, d: 300, a: 200, alpha: 0}
  - {name: j2, type: revolute, theta: 0, d: 0, a: 200, alpha: 0}
"""
WIDE = "J1 [deg],J2 [deg],X1 [mm],Y1 [mm],Z1 [mm],X2 [mm],Y2 [mm],Z2 [mm]"
WIDE_ROWS = ("0,0,400,0,400,400,50,400", "90,0,0,400,400,-50,400,400")


def _file(folder: Path, *lines: str) -> Path:
    path = folder / "table.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _two_targets(folder: Path, names: str = "t1 t2") -> robacc.Robot:
    text = ROBOT
    for old, new in zip(("t1", "t2"), names.split(), strict=True):
        text = text.replace(f"{old}:", f"{new}:")
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return robacc.read_robot(folder / "robot.yaml")


def _long(*rows: str, header: str = "Point,Axis,Nominal [mm],Actual [mm],Deviation") -> tuple[str, ...]:
    return (header, *rows)


LONG = _long(
    *("P1,X,10,10.5,0.5", "P1,Y,20,20.5,0.5", "P1,Z,30,30.5,0.5"),
    *("P2,Z,33,33.25,0.25", "P2,X,11,11.25,0.25", "P2,Y,22,22.25,0.25"),
)


def test_rows_of_one_axis_each_become_points(tmp_path: Path) -> None:
    data = robacc.read_poses(_file(tmp_path, *LONG))
    np.testing.assert_allclose(1e3 * data.position, [[10.5, 11.25], [20.5, 22.25], [30.5, 33.25]], rtol=1e-14)
    assert data.commanded_position is not None
    np.testing.assert_allclose(1e3 * data.commanded_position, [[10, 11], [20, 22], [30, 33]], rtol=1e-14)
    assert data.pose.tolist() == ["P1", "P2"]
    assert [data.line(i) for i in range(2)] == [2, 6]
    assert any("one row for each axis joined" in text for text in data.warnings)
    assert any("X [mm] -> x_mm" in text for text in data.warnings)


def test_units_in_the_cells_and_repeated_visits(tmp_path: Path) -> None:
    rows = [f"P1;30°;{axis};{10 * k + v},0 mm" for v in (1, 2) for k, axis in enumerate("XYZ")]
    data = robacc.read_poses(_file(tmp_path, "Punkt;A1;Achse;Istwert", *rows))
    np.testing.assert_allclose(1e3 * data.position, [[1, 2], [11, 12], [21, 22]], rtol=1e-14)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (LONG[:3] + LONG[4:], "point 'P1' has no row for Z"),
        ((*LONG, "P1,Y,20,20.5,0.5"), "point 'P1' has no row for X and Z"),
        (tuple(re.sub(",[XYZ],", ",T,", row) for row in LONG), "found 'T', expected rows for X, Y and Z"),
        (_long("P1,X,1,2", "P1,Y,1,2", "P1,Z,1,2", header="Point,Axis,Value 1,Value 2"), "columns x, y, z are missing"),
        (_long("1,P,X,2", "2,P,Y,2", "2,P,Z,2", header="J1 [deg],Point,Axis,Value [mm]"), "have different values"),
    ],
)
def test_rows_that_are_no_points_are_errors(tmp_path: Path, rows: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        robacc.read_poses(_file(tmp_path, *rows))


def test_other_rows_are_named(tmp_path: Path) -> None:
    data = robacc.read_poses(_file(tmp_path, *LONG, "P2,T,0,0.1,0.1"))
    assert data.n == 2
    assert any("rows of 'T' not used" in text for text in data.warnings)


def test_a_point_with_a_gap_is_left_out(tmp_path: Path) -> None:
    data = robacc.read_poses(_file(tmp_path, *LONG[:3], "P1,Z,30,---,", *LONG[4:]), skip_gaps=True)
    assert data.n == 1
    assert any("left out" in text for text in data.warnings)


def test_decimal_commas_with_one_number_in_each_row(tmp_path: Path) -> None:
    table = _file(tmp_path, "Punkt;Achse;Istwert [mm]", "P1;X;1,5", "P1;Y;2,5", "P1;Z;3,5")
    commands = tmp_path / "commands.csv"
    commands.write_text("pose,q1_deg\nP1,30\n", encoding="utf-8")
    data = robacc.read_poses(table, commanded=commands)
    np.testing.assert_allclose(1e3 * data.position[:, 0], [1.5, 2.5, 3.5], rtol=1e-14)


@pytest.mark.parametrize("names", ["t1 t2", "1 2", "SMR1 SMR2"])
def test_targets_in_one_row_are_those_of_the_robot(tmp_path: Path, names: str) -> None:
    robot = _two_targets(tmp_path, names)
    data = robacc.read_poses(_file(tmp_path, WIDE, *WIDE_ROWS), robot=robot)
    assert data.target.tolist() == names.split() * 2
    assert data.visit.tolist() == ["2", "2", "3", "3"]
    result = robacc.estimate(data, robot=robot)
    assert result.position.max < 1e-12
    assert any(f"X2 [mm], Y2 [mm], Z2 [mm] of target {names.split()[1]}" in text for text in data.warnings)


def test_labels_may_be_the_names_of_the_targets(tmp_path: Path) -> None:
    header = WIDE.replace("1 [mm]", "_left [mm]").replace("2 [mm]", "_right [mm]")
    robot = _two_targets(tmp_path, "left right")
    data = robacc.read_poses(_file(tmp_path, header, *WIDE_ROWS), robot=robot)
    assert data.target.tolist() == ["left", "right"] * 2


def test_points_that_are_not_the_robots_targets_are_asked_for(tmp_path: Path) -> None:
    path = _file(tmp_path, WIDE, *WIDE_ROWS)
    with pytest.raises(InputError, match=r"each row holds the points 1, 2.*under targets \(1, 2\)"):
        robacc.read_poses(path)
    with pytest.raises(InputError, match="each row holds the points 1, 2"):
        robacc.read_poses(path, robot=_two_targets(tmp_path, "a3 b4"))


def test_a_point_without_an_axis_is_an_error(tmp_path: Path) -> None:
    lines = [line.rpartition(",")[0] for line in (WIDE, *WIDE_ROWS)]
    with pytest.raises(InputError, match="point 2 has no Z"):
        robacc.read_poses(_file(tmp_path, *lines), robot=_two_targets(tmp_path))


def test_points_in_different_units_are_not_joined(tmp_path: Path) -> None:
    path = _file(tmp_path, WIDE.replace("X2 [mm]", "X2 [m]"), *WIDE_ROWS)
    with pytest.raises(InputError, match="each row holds the points 1, 2"):
        robacc.read_poses(path, robot=_two_targets(tmp_path))
