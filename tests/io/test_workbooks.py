"""Workbooks: a sheet is read like an export in text; what cannot be decided is asked."""

import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from sample_files import saved

from robacc import InputError, PoseFile, UsageError
from robacc.poses.csv_file import read_poses

pytest.importorskip("python_calamine")

Cell = str | float | None
HEAD: list[Cell] = ["Point", "J1 [deg]", "X [mm]", "Y [mm]", "Z [mm]", "Remark"]
ROWS: list[list[Cell]] = [["a", 10.0, 1000.5, 20.25, -3.0, 'SMR 1.5"'], ["b", -20.0, 900.0, 30.0, 4.0, None]]


def workbook(sheets: Mapping[str, Sequence[Sequence[Cell]]]) -> bytes:
    """The smallest xlsx with these sheets, after ECMA-376."""
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    relation = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    kinds = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        overrides = "".join(
            f'<Override PartName="/xl/worksheets/sheet{i}.xml" ContentType="{kinds}.worksheet+xml"/>'
            for i in range(1, len(sheets) + 1)
        )
        archive.writestr(
            "[Content_Types].xml",
            f'<Types xmlns="{package}/content-types"><Default Extension="rels" ContentType="application/vnd.openxml'
            f'formats-package.relationships+xml"/><Default Extension="xml" ContentType="application/xml"/><Override '
            f'PartName="/xl/workbook.xml" ContentType="{kinds}.sheet.main+xml"/>{overrides}</Types>',
        )
        archive.writestr(
            "_rels/.rels",
            f'<Relationships xmlns="{package}/relationships"><Relationship Id="r1" Type="{relation}/officeDocument" '
            'Target="xl/workbook.xml"/></Relationships>',
        )
        names = "".join(f'<sheet name="{name}" sheetId="{i}" r:id="r{i}"/>' for i, name in enumerate(sheets, 1))
        archive.writestr(
            "xl/workbook.xml", f'<workbook xmlns="{main}" xmlns:r="{relation}"><sheets>{names}</sheets></workbook>'
        )
        links = "".join(
            f'<Relationship Id="r{i}" Type="{relation}/worksheet" Target="worksheets/sheet{i}.xml"/>'
            for i in range(1, len(sheets) + 1)
        )
        archive.writestr(
            "xl/_rels/workbook.xml.rels", f'<Relationships xmlns="{package}/relationships">{links}</Relationships>'
        )
        for i, rows in enumerate(sheets.values(), 1):
            archive.writestr(
                f"xl/worksheets/sheet{i}.xml",
                f'<worksheet xmlns="{main}"><sheetData>{_rows(rows)}</sheetData></worksheet>',
            )
    return stream.getvalue()


def _rows(rows: Sequence[Sequence[Cell]]) -> str:
    text = ""
    for i, row in enumerate(rows, 1):
        cells = ""
        for letter, value in zip("ABCDEFGHIJ", row, strict=False):
            if isinstance(value, str):
                cells += f'<c r="{letter}{i}" t="inlineStr"><is><t>{value}</t></is></c>'
            elif value is not None:
                cells += f'<c r="{letter}{i}"><v>{value!r}</v></c>'
        text += f'<row r="{i}">{cells}</row>'
    return text


def written(folder: Path, sheets: Mapping[str, Sequence[Sequence[Cell]]]) -> Path:
    return saved(folder / "export.xlsx", workbook(sheets))


def test_a_sheet_with_a_title_is_read_like_text(tmp_path: Path) -> None:
    data = read_poses(written(tmp_path, {"Messung": [["Cell 3, tracker 17"], [], HEAD, *ROWS]}))
    np.testing.assert_allclose(np.degrees(data.q), [[10, -20]])
    np.testing.assert_array_equal(data.position * 1e3, [[1000.5, 900], [20.25, 30], [-3, 4]])
    assert data.pose.tolist() == ["a", "b"]
    assert data.counted == "row"
    assert data.rows.tolist() == [4, 5]
    assert any("sheet 'Messung'" in warning for warning in data.warnings)


def test_a_gap_in_a_sheet_is_reported_by_its_row(tmp_path: Path) -> None:
    path = written(tmp_path, {"s": [HEAD, ["a", 10.0, None, 20.25, -3.0], *ROWS]})
    with pytest.raises(InputError, match=r"export\.xlsx, row 2, X \[mm\]: the value is missing, expected a number"):
        read_poses(path)
    data = read_poses(PoseFile(path, skip_gaps=True))
    assert data.n == 2
    assert any("1 row incomplete or not measured, left out (row 2)" in warning for warning in data.warnings)


def test_several_sheets_are_a_question(tmp_path: Path) -> None:
    path = written(tmp_path, {"one": [HEAD, *ROWS], "two": [HEAD, *ROWS[:1]], "empty": [["note"]]})
    with pytest.raises(UsageError, match="has several sheets; choose one with `sheet`: one, two"):
        read_poses(path)
    assert read_poses(PoseFile(path, sheet="two")).n == 1
    with pytest.raises(UsageError, match="has no sheet 'three'; it has one, two, empty"):
        read_poses(PoseFile(path, sheet="three"))


def test_the_only_sheet_with_a_table_is_read(tmp_path: Path) -> None:
    cover = [["Prüfprotokoll"], ["Prüfer", "Müller"], ["Zelle", 4]]
    groups = ["", "Achsen", *[""] * (len(HEAD) - 2), "Bemerkung"]
    sheets = {"Deckblatt": cover, "Messung": [groups, [*HEAD, ""], *[[*row, "ok"] for row in ROWS]]}
    data = read_poses(written(tmp_path, sheets))
    assert data.n == len(ROWS)
    assert any("sheet 'Messung'" in warning for warning in data.warnings)
    # The name of a column may stand in the line of the groups.
    assert any("'Remark', 'Bemerkung'" in warning for warning in data.warnings)


def test_a_damaged_workbook_is_refused(tmp_path: Path) -> None:
    good = workbook({"s": [HEAD, *ROWS]})
    path = tmp_path / "export.xlsx"
    for cut in range(4, len(good), 97):
        path.write_bytes(good[:cut])
        with pytest.raises(InputError, match="cannot be read as a workbook"):
            read_poses(path)
