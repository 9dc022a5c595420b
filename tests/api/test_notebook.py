"""Results in a notebook: headline, arrays, table, chart and report of the same figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import robacc

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


@pytest.fixture(scope="module")
def result() -> robacc.Estimate:
    return robacc.estimate(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml", align="base_frame,tool_frame")


def test_the_headline_has_the_figures_and_escapes_names(result: robacc.Estimate) -> None:
    text = result._repr_html_()
    assert f"{result.position.rms * 1e3:.3f} mm" in text
    assert "grade D" in text
    assert text.count("<table>") == text.count("</table>") == 1


def test_the_text_of_a_result_is_its_headline(result: robacc.Estimate) -> None:
    lines = str(result).splitlines()
    assert "[grade D" in lines[0]
    assert any(f"{result.position.rms * 1e3:.3f} mm" in line for line in lines)
    assert max(map(len, lines)) < 200


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


def test_a_result_without_poses_has_no_table(result: robacc.Estimate) -> None:
    compared = robacc.compare(result, robacc.estimate(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml"))
    assert compared.to_numpy() == {}
    assert json.loads(compared.to_json())["command"] == "compare"
