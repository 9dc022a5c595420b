"""Data frames in place of pose files, and results in a notebook."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import missing, run

import robacc
from robacc.errors import InputError, UsageError

# Data frames in place of pose files: pandas, Polars, Arrow, and mappings of arrays.

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"

ROBOT = SAMPLES / "robot.yaml"


def columns() -> dict[str, list[Any]]:
    with (SAMPLES / "poses.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    texts = ("pose", "cycle", "target", "visit")
    return {name: [row[name] if name in texts else float(row[name]) for row in rows] for name in rows[0]}


class StreamOnly:
    """Table that speaks Arrow's stream interface only, as a database's relation does."""

    def __init__(self, table: Any) -> None:
        self._table = pytest.importorskip("pyarrow").table(table)

    def __arrow_c_stream__(self, schema: Any = None) -> Any:
        return self._table.__arrow_c_stream__(schema)


def as_mapping(table: dict[str, list[Any]]) -> Any:
    return {name: np.array(values) for name, values in table.items()}


FRAMES = {
    "mapping": as_mapping,
    "arrow": lambda table: pytest.importorskip("pyarrow").table(table),
    "pandas": lambda table: pytest.importorskip("pandas").DataFrame(table),
    "polars": lambda table: pytest.importorskip("polars").DataFrame(table),
    "stream": StreamOnly,
}


@pytest.mark.parametrize("kind", FRAMES)
def test_a_frame_gives_the_figures_of_its_file(kind: str) -> None:
    results = (robacc.estimate(source, robot=ROBOT) for source in (SAMPLES / "poses.csv", FRAMES[kind](columns())))
    from_file, from_frame = (json.loads(result.to_json()) for result in results)
    record = from_frame["inputs"][0]
    assert (record["name"], len(record["sha256"])) == ("DataFrame", 64)
    for key in ("position", "orientation", "grade", "noise"):
        assert from_frame[key] == from_file[key]


def test_names_of_exports_are_read_in_frames_too() -> None:
    table = columns()
    frame = {f"J{i} [deg]": np.degrees(table[f"q{i}"]) for i in range(1, 7)}
    frame |= {f"{axis.upper()} [mm]": 1e3 * np.array(table[axis]) for axis in "xyz"}
    frame["Timestamp"] = np.datetime64("2026-11-22T10:00:00") + np.arange(len(table["x"])) * np.timedelta64(60, "s")
    data = robacc.read_poses(frame, robot=robacc.read_robot(ROBOT))
    expected = robacc.read_poses(SAMPLES / "poses.csv", robot=robacc.read_robot(ROBOT))
    np.testing.assert_allclose(data.q, expected.q, atol=1e-14)
    assert data.time[:2].tolist() == [36000.0, 36060.0]


def test_statements_apply_to_frames() -> None:
    table = columns()
    frame = {f"J{i}": np.degrees(table[f"q{i}"]) for i in range(1, 7)} | {axis: table[axis] for axis in "xyz"}
    with pytest.raises(InputError, match="state no unit"):
        robacc.read_poses(frame | {f"J{i}": table[f"q{i}"] for i in range(1, 7)})
    with_units = robacc.PoseFile(frame, units="m,deg")
    assert robacc.estimate(with_units, robot=ROBOT).document()["inputs"][0]["reading"] == {"units": "m,deg"}


@pytest.mark.parametrize("missing", [None, float("nan"), "---"])
def test_gaps_of_frames_have_a_row_and_a_column(missing: object) -> None:
    table = columns()
    table["y"][3] = missing
    frame = {name: np.array(values, dtype=object if name == "y" else None) for name, values in table.items()}
    with pytest.raises(InputError, match="row 4, y: the value is missing"):
        robacc.read_poses(frame)
    data = robacc.read_poses(frame, skip_gaps=True)
    assert data.n == len(table["y"]) - 1
    assert any("1 row with a missing value left out (row 4)" in text for text in data.warnings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.zeros((60, 2))}, r"x: expected one value per row, found an array of shape \(60, 2\)"),
        ({"x": np.zeros(7)}, "the columns have 7 to 60 rows"),
        ({"x": np.array(["1,5"] * 60)}, "x: the column holds <U3, expected numbers"),
        ({"x": np.array(["1,5"] * 60, dtype=object)}, "row 1, x: found '1,5', expected a number"),
        ({5: np.zeros(60)}, "expected a text as the name of each column, found 5"),
    ],
)
def test_frames_that_are_refused(change: dict[Any, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        robacc.read_poses({**as_mapping(columns()), **change})


def test_the_named_index_of_pandas_is_a_column() -> None:
    pandas = pytest.importorskip("pandas")
    table = columns()
    table["pose"] = [f"P{i}" for i in range(len(table["x"]))]
    data = robacc.read_poses(pandas.DataFrame(table).set_index("pose"))
    assert data.pose[:2].tolist() == ["P0", "P1"]


@pytest.mark.parametrize("poses", [[{"x": 1.0}], np.zeros((3, 4)), 5, None])
def test_what_is_no_table_is_a_wrong_argument(poses: Any) -> None:
    with pytest.raises(UsageError, match="expected a path, a data frame or Measurements as poses, found"):
        robacc.estimate(poses, robot=ROBOT)


# Results in a notebook: headline, arrays, table, chart and report of the same figures.


@pytest.fixture(scope="module")
def result() -> robacc.Estimate:
    return robacc.estimate(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml", align="base_frame,tool_frame")


def test_the_headline_has_the_figures_and_escapes_names(result: robacc.Estimate) -> None:
    text = result._repr_html_()
    assert missing(text, f"{result.position.rms * 1e3:.3f} mm", "grade D") == []
    assert text.count("<table>") == text.count("</table>") == 1


def test_the_text_of_a_result_is_the_first_screen_of_the_command(result: robacc.Estimate) -> None:
    command = ("estimate", SAMPLES / "poses.csv", "--robot", SAMPLES / "robot.yaml")
    screen = run(*command, "--align", "base_frame,tool_frame").stdout
    assert str(result).splitlines()[2:] == screen.replace(f"{SAMPLES}/", "").splitlines()[2:]
    assert str(result).splitlines()[1] == "poses.csv against the model robot.yaml"
    stepped = robacc.estimate(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml", align="none", frame="base")
    assert str(dataclasses.replace(stepped, warnings=("a doubt",))).endswith("\nwarning: a doubt")
    traced = robacc.trace(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml", declared="base_frame,tool_frame")
    assert str(traced).startswith("Trace of 60 measured poses: ")
    assert "next:" in str(traced)


def test_other_results_have_their_headline_and_no_table(result: robacc.Estimate) -> None:
    compared = robacc.compare(result, result)
    lines = str(compared).splitlines()
    assert "mm" in "".join(lines)
    assert max(map(len, lines)) < 200
    assert (compared.to_numpy(), json.loads(compared.to_json())["command"]) == ({}, "compare")


def test_the_text_of_poses_has_ten_lines_at_most() -> None:
    lines = str(robacc.read_poses(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml")).splitlines()
    assert lines[0].endswith("poses.csv, in m and rad")
    assert lines[1].startswith("position           -0.66…0.82, ")
    assert lines[-1] == "pose               60 different"
    full = robacc.simulate(SAMPLES / "robot.yaml", poses=9, seed=1, temperature=(20, 25), payload=(0, 2)).data
    assert len(str(full).splitlines()) <= 10
    assert str(robacc.Measurements(np.zeros((3, 0)))) == "0 measured poses of arrays, in m and rad"


def test_arrays_are_those_of_the_document(result: robacc.Estimate) -> None:
    columns = result.to_numpy()
    assert {array.shape for array in columns.values()} == {(60,)}
    errors = np.stack([columns[f"error_{axis}_m"] for axis in "xyz"])
    np.testing.assert_allclose(errors, result.errors.position, atol=1e-11)
    assert np.sqrt(np.mean(columns["error_m"] ** 2)) == pytest.approx(result.position.rms, rel=1e-9)
    assert result.errors.rotation is not None
    np.testing.assert_allclose(columns["turn_rad"], np.linalg.norm(result.errors.rotation, axis=0), atol=1e-11)


def test_a_data_frame_has_a_row_for_each_pose(result: robacc.Estimate) -> None:
    pandas = pytest.importorskip("pandas")
    frame = result.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame.shape == (60, len(result.to_numpy()))


def test_chart_and_report_of_a_result(result: robacc.Estimate, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    figure = result.plot()
    assert figure.axes
    path = tmp_path / "chart.svg"
    result.plot("time", path=path)
    assert path.read_text(encoding="utf-8").startswith("<?xml")
    with pytest.raises(robacc.UsageError, match="has no chart 'nothing'; it has distribution"):
        result.plot("nothing")
    page = tmp_path / "page.html"
    result.report(page, identity={"serial_number": "12345 <b>", "customer": "Example"})
    text = page.read_text(encoding="utf-8")
    assert "12345 &lt;b&gt;" in text
    assert text.index("Customer") < text.index("Serial number")
    with pytest.raises(robacc.UsageError, match="unknown key 'serial'"):
        result.report(page, identity={"serial": "1"})
