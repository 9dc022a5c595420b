"""Numbers of exports that are no plain decimals: read where they are certain, refused with advice where not."""

from __future__ import annotations

from pathlib import Path

import pytest

from robacc.errors import InputError
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot

HEADER = "J1 [°];J2 [°];X [mm];Y [mm];Z [mm]\n"
ROW = "1,5;-2,5;{x};200,5;300,5\n"


def table(tmp_path: Path, x: str, header: str = HEADER, row: str = ROW) -> Path:
    path = tmp_path / "export.csv"
    path.write_text(header + row.format(x=x) + row.format(x="100,5") + row.format(x="-50,25"), encoding="utf-8")
    return path


def test_a_point_in_a_file_of_decimal_commas_is_refused(tmp_path: Path) -> None:
    # As a decimal point 1.043 would be 1 mm, as a separator of thousands 1043 mm.
    with pytest.raises(InputError, match=r"csv:2, X \[mm\]: found '1.043', expected a number(?s:.*)thousands"):
        read_poses(table(tmp_path, "1.043"))


@pytest.mark.parametrize("x", ["1.043,999", "-1.043,5", "1'043,5", "1'043", "1\u00a0043,5", "1\u2019043,5"])
def test_thousands_beside_a_decimal_comma_are_read(tmp_path: Path, x: str) -> None:
    data = read_poses(table(tmp_path, x))
    digits = "".join(sign for sign in x if sign in "-0123456789,").replace(",", ".")
    assert data.position[0, 0] == pytest.approx(float(digits) * 1e-3, abs=1e-12)
    assert any("decimal comma, separators of thousands" in text for text in data.warnings)


@pytest.mark.parametrize(
    ("x", "value", "message"),
    [
        ('"1,903.540"', 1.90354, None),
        ('"-12,903,540.5"', -12903.5405, None),
        ("1'903.540", 1.90354, None),
        ('"1,903"', None, "the comma may separate thousands: write 1903 or 1.903"),
        ('"1,9035"', None, "write decimals with a point, not a comma"),
        ('"1.903,540"', None, "export numbers without a separator of thousands"),
        ("1 903", None, "export numbers without a separator of thousands"),
    ],
)
def test_thousands_beside_a_decimal_point(tmp_path: Path, x: str, value: float | None, message: str | None) -> None:
    path = tmp_path / "export.csv"
    path.write_text(f"J1 [deg],X [mm],Y [mm],Z [mm]\n1.5,{x},2.5,3.5\n2.5,100.5,3.5,4.5\n", encoding="utf-8")
    if message is not None:
        with pytest.raises(InputError, match=rf"csv:2, X \[mm\]: found (?s:.*){message}"):
            read_poses(path)
        return
    assert read_poses(path).position[0, 0] == pytest.approx(value, abs=1e-12)


def test_a_documented_file_in_windows_1252_is_read_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "export.csv"
    path.write_bytes("pose,q1_deg,x_mm,y_mm,z_mm\nPrüfling,1.5,1,2,3\nMüller 21 °C,2.5,3,4,5\n".encode("cp1252"))
    data = read_poses(path)
    assert data.pose.tolist() == ["Prüfling", "Müller 21 °C"]
    assert data.warnings == (f"{path}: Windows-1252",)


def test_german_degrees_have_a_capital(tmp_path: Path) -> None:
    path = tmp_path / "export.csv"
    text = "A1;X;Y;Z\n{};mm;mm;mm\n90,0;1,5;2,5;3,5\n45,0;2,5;3,5;4,5\n"
    path.write_text(text.format("Grad"), encoding="utf-8")
    data = read_poses(path)
    assert data.q[0] == pytest.approx([1.5707963, 0.7853982])
    # In lower case it may be a gradian, 400 to the turn.
    path.write_text(text.format("grad"), encoding="utf-8")
    with pytest.raises(InputError, match=r"joint variables|no unit"):
        read_poses(path)


def test_joints_of_another_name_beside_documented_positions(tmp_path: Path) -> None:
    path = tmp_path / "export.csv"
    path.write_text("pose,J1 (deg),x_mm,y_mm,z_mm\na,90,1,2,3\nb,45,2,3,4\n", encoding="utf-8")
    data = read_poses(path, robot=KnownRobot(joint_names=("shoulder",)))
    assert data.q[0] == pytest.approx([1.5707963, 0.7853982])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Index\tAz(deg)\tEl(deg)\tDist(mm)\n1\t10.5\t80.5\t2000.5\n", "angles and distances of an instrument"),
        ("header:\n  stamp:\n    sec: 1\n", "has no list of records"),
        (
            "pose,q1,x,y,z\na,1,2,3,4\nb,2,3,4,5\n[Planes]\nc,1,2\n",
            r"csv:4: found 1 field, expected 5(?s:.*)another table or a footer",
        ),
        ("pose,K1,x,y,z\na,1,2,3,4\n", r"measured poses only(?s:.*)unknown in this file: K1"),
    ],
)
def test_tables_that_are_no_poses_say_what_to_do(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "export.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_poses(path, robot=KnownRobot(joint_names=("shoulder",)))


def test_a_unicode_minus_is_a_minus(tmp_path: Path) -> None:
    assert read_poses(table(tmp_path, "\u2212100,5")).position[0].tolist() == [-0.1005, 0.1005, -0.05025]


def test_a_unit_in_some_cells_only_is_refused_with_advice(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without the unit mm; export every cell with its unit, or none"):
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
    data = read_poses(path, robot=KnownRobot(target_names=()))
    assert data.target is None
    assert data.pose.tolist() == ["T0", "T1", "T2", "T3"]
    assert any("used as the names of the poses" in text for text in data.warnings)


@pytest.mark.parametrize("name", ["Label", "Element", "Feature name"])
def test_names_of_points_in_other_programs(tmp_path: Path, name: str) -> None:
    path = tmp_path / "export.csv"
    path.write_text(f"{name};J1 [deg];X [mm];Y [mm];Z [mm]\nA;1;2;3;4\nB;2;3;4;5\n", encoding="utf-8")
    data = read_poses(path)
    assert data.pose.tolist() == ["A", "B"]
