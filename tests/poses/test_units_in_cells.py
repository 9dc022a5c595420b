"""Units behind the numbers: read where each column has one, refused where they contradict each other or the name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robacc
from robacc.errors import InputError
from robacc.io.dialect import split_cell

HEADER = "Point,J1,J2,X,Y,Z"
ROWS = ("P1,10.5°,-20°,381.289 mm,-7.5 mm,1043.999 mm", "P2,30°,40.25°,1 mm,2 mm,3 mm")


def _file(folder: Path, header: str, *rows: str) -> Path:
    path = folder / "cells.csv"
    path.write_text("\n".join((header, *rows)) + "\n", encoding="utf-8")
    return path


def test_units_in_the_cells_are_those_of_the_columns(tmp_path: Path) -> None:
    data = robacc.read_poses(_file(tmp_path, HEADER, *ROWS))
    np.testing.assert_allclose(data.position[:, 0], [0.381289, -0.0075, 1.043999], rtol=1e-15)
    np.testing.assert_allclose(np.degrees(data.q[:, 1]), [30, 40.25], rtol=1e-15)
    assert any("X -> x_mm" in text for text in data.warnings)
    assert any("units in the cells: deg, mm" in text for text in data.warnings)


@pytest.mark.parametrize("header", ["pose,q1,q2,x,y,z", "Point;J1;J2;X;Y;Z"])
def test_documented_names_and_decimal_commas_have_units_too(tmp_path: Path, header: str) -> None:
    rows = [row.replace(",", ";").replace(".", ",") for row in ROWS] if ";" in header else list(ROWS)
    data = robacc.read_poses(_file(tmp_path, header, *rows))
    np.testing.assert_allclose(data.position[:, 0], [0.381289, -0.0075, 1.043999], rtol=1e-15)
    np.testing.assert_allclose(np.degrees(data.q[:, 0]), [10.5, -20], rtol=1e-15)


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        (HEADER, "P3,1°,2°,0.001 m,2 mm,3 mm", "found '0.001 m', but the first cell is in mm"),
        (HEADER, "P3,1°,2°,1.5,2 mm,3 mm", "found '1.5' without the unit mm"),
        (HEADER, "P3,1°,2°,1.5 mm 2,2 mm,3 mm", "expected a number"),
        ("Point,J1,J2,X [m],Y [m],Z [m]", ROWS[0], "the cells are in mm, but the name is of m"),
        ("Point,J1,J2,X,Y,payload_kg", ROWS[0], "the cells are in mm, but the name is of kg"),
        ("pose,q1,q2,x_m,y_m,z_m", ROWS[0], "the cells are in mm, but the name is of m"),
        ("pose,q1,q2,x,y,z", "P3,1°,2°,1.5 mm,2 mm,3 mm,", "fields"),
    ],
)
def test_contradictions_are_errors(tmp_path: Path, header: str, row: str, message: str) -> None:
    rows = (ROWS[0], row) if row != ROWS[0] else ROWS
    with pytest.raises(InputError, match=message.replace("'", ".")):
        robacc.read_poses(_file(tmp_path, header, *rows))


def test_a_unit_that_is_no_length_is_an_error(tmp_path: Path) -> None:
    rows = [row.replace("mm", "kg") for row in ROWS]
    with pytest.raises(InputError, match="found unit kg for x, expected a unit of length"):
        robacc.read_poses(_file(tmp_path, HEADER, *rows))
    with pytest.raises(InputError, match="the cells are in kg, expected a length"):
        robacc.read_poses(_file(tmp_path, "pose,q1,q2,x,y,z", *rows))


def test_a_unit_of_another_quantity_is_the_only_problem_of_its_column(tmp_path: Path) -> None:
    """Values that cannot be in SI units either are no second problem."""
    for wrong, right in (("J1 [kg]", "J1 [deg]"), ("X [deg]", "X [mm]")):
        header = "Point,J1 [deg],J2 [deg],X [mm],Y [mm],Z [mm]".replace(right, wrong)
        with pytest.raises(InputError) as error:
            robacc.read_poses(_file(tmp_path, header, "P1,20,30,500,100,200", "P2,30,40,400,200,210"))
        assert [str(problem).count("expected a unit of") for problem in error.value.problems] == [1]


def test_a_column_map_takes_the_units_of_the_cells(tmp_path: Path) -> None:
    path = _file(tmp_path, HEADER, *ROWS)
    columns = {"Point": "pose", "J1": "q1", "J2": "q2", "X": "x", "Y": "y", "Z": "z"}
    data = robacc.read_poses(path, columns=columns)
    np.testing.assert_allclose(data.position[2], [1.043999, 0.003], rtol=1e-15)
    with pytest.raises(InputError, match="the cells are in mm, but the name is of m"):
        robacc.read_poses(path, columns=columns | {"X": "x_m"})


def test_gaps_are_left_out_before_the_unit_is_asked(tmp_path: Path) -> None:
    rows = ("P0,1°,2°,---,,n/a", *ROWS)
    data = robacc.read_poses(_file(tmp_path, HEADER, *rows), skip_gaps=True)
    assert data.n == 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("381.289 mm", ("381.289", "mm")),
        ("-33,5°", ("-33,5", "deg")),
        ("1e-3 m", ("1e-3", "m")),
        ("1'381.5 mm", ("1'381.5", "mm")),
        ("12", ("12", None)),
        ("12 apples", ("12 apples", None)),
        ("33°30'", ("33°30'", None)),
        ("P1 m", ("P1 m", None)),
        ("", ("", None)),
    ],
)
def test_a_cell_is_a_number_and_a_known_unit(text: str, expected: tuple[str, str | None]) -> None:
    assert split_cell(text) == expected
