"""Results in a notebook: headline, arrays, table, chart and report of the same figures."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from commands import missing, run

import robacc

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


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
