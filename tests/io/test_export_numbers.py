"""Numbers of exports that are no plain decimals: read where they are certain, refused with advice where not."""

from __future__ import annotations

from pathlib import Path

import pytest

from robacc.errors import InputError
from robacc.poses.csv_file import read_poses

HEADER = "J1 [°];J2 [°];X [mm];Y [mm];Z [mm]\n"
ROW = "1,5;-2,5;{x};200,5;300,5\n"


def table(tmp_path: Path, x: str, header: str = HEADER, row: str = ROW) -> Path:
    path = tmp_path / "export.csv"
    path.write_text(header + row.format(x=x) + row.format(x="100,5") + row.format(x="-50,25"), encoding="utf-8")
    return path


@pytest.mark.parametrize("x", ["1.043,999", "1.043"])
def test_a_point_in_a_file_of_decimal_commas_is_refused(tmp_path: Path, x: str) -> None:
    # As a decimal point 1.043 would be 1 mm, as a separator of thousands 1043 mm.
    with pytest.raises(InputError, match=rf"csv:2, X \[mm\]: found '{x}', expected a number(?s:.*)thousands"):
        read_poses(table(tmp_path, x))


def test_a_unicode_minus_is_a_minus(tmp_path: Path) -> None:
    assert read_poses(table(tmp_path, "\u2212100,5")).position[0].tolist() == [-0.1005, 0.1005, -0.05025]


def test_units_in_cells_are_refused_with_advice(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="write the number alone, and the unit in the column's name"):
        read_poses(table(tmp_path, "100,5 mm"))


def test_a_repeated_header_is_named(tmp_path: Path) -> None:
    path = table(tmp_path, "1,5")
    path.write_text(path.read_text(encoding="utf-8") + HEADER, encoding="utf-8")
    with pytest.raises(InputError, match=r"csv:5, J1 \[°\](?s:.*)delete the repeated header row"):
        read_poses(path)


def test_a_column_target_with_another_name_in_each_row_names_the_poses(tmp_path: Path) -> None:
    path = tmp_path / "robodk.csv"
    rows = "".join(f"T{i};{i};2;{100 + 7 * i};200;300\n" for i in range(4))
    path.write_text("Target;J1 (deg);J2 (deg);X (mm);Y (mm);Z (mm)\n" + rows, encoding="utf-8")
    data = read_poses(path, target_names=())
    assert data.target is None
    assert data.pose is not None
    assert data.pose.tolist() == ["T0", "T1", "T2", "T3"]
    assert any("taken for the names of the poses" in text for text in data.warnings)
