"""The page of a plan: what it draws and says, from the document alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import robacc
from robacc.render.page import command_line, render
from robacc.render.plots.results import charts_of
from robacc.render.text import effect_families

ROBOT = Path(__file__).resolve().parents[2] / "sample_data" / "robot.yaml"


def document(**options: object) -> dict[str, object]:
    result = robacc.plan(ROBOT, **{"candidates": 120, "check_every": 6, **options})  # type: ignore[arg-type]
    return json.loads(result.to_json())  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def calibration() -> dict[str, object]:
    return document(poses=14, validation=3, instrument="2,0,1", outside=["x=0.6:1,z=:0.2"], min_height="0.05")


def test_the_charts_show_what_the_document_has(calibration: dict[str, object]) -> None:
    charts = {chart.kind: chart for chart in charts_of(calibration)}
    assert list(charts) == ["planned-poses", "expected-accuracy", "detection-limits"]
    poses = charts["planned-poses"]
    assert len(poses.table.rows) == calibration["n_visits"]
    assert poses.scene is not None
    traces = {trace["name"]: trace for trace in poses.scene["traces"]}
    assert len(traces["validation poses"]["x"]) == 3
    assert traces["instrument"]["x"] == [2.0]
    # Every pose has one mark: once, twice or as a check.
    marked = sum(len(traces[name]["x"]) for name in ("poses", "poses visited twice", "drift check poses"))
    assert marked == 14
    curve = charts["expected-accuracy"].table.rows
    assert [int(row[0]) for row in curve] == [p["n_poses"] for p in calibration["accuracy"]["curve"]]  # type: ignore[index]


def test_limits_are_those_of_the_joints(calibration: dict[str, object]) -> None:
    families = effect_families(calibration)
    for family in families:
        own = [e for e in calibration["detection_limits"] if e["effect"] == family.name]  # type: ignore[attr-defined]
        known = [e["limit"] for e in own if e["limit"] is not None]
        if known:
            assert (family.known[0]["limit"], family.known[-1]["limit"]) == (min(known), max(known))
        assert family.power == pytest.approx(sum(e["power"] for e in own) / len(own))


def test_the_page_says_what_to_do(calibration: dict[str, object]) -> None:
    page = render([calibration], ["plan"])
    for text in (
        "Plan for the calibration of sample arm",
        "Order of the visits",
        "a point of the arm inside the box x=0.6:1,z=:0.2",
        "collisions of the links not checked",
        "Predicted standard errors",
        "not identifiable: tool_frame.roll",
        "Predicted error over the number of poses",
    ):
        assert text in page, text
    assert "<td>check</td>" in page


def test_a_trace_with_payloads() -> None:
    trace = document(purpose="trace", poses=14, payload=[0, 4], candidates=60)
    names = [entry["name"] for entry in charts_of(trace)[0].scene["traces"]]  # type: ignore[union-attr]
    assert "poses with 0 kg" in names
    assert "poses with 4 kg" in names
    page = render([trace], ["plan"])
    assert "effects found at their usual size" in page
    assert "not tested (" in page


def test_the_command_line_makes_the_plan_again(calibration: dict[str, object]) -> None:
    line = command_line(calibration)
    assert line.startswith("robacc plan robot.yaml ")
    assert "--for calibrate" in line
    assert "--outside x=0.6:1,z=:0.2" in line


def test_a_plan_that_says_enough() -> None:
    enough = document(already=ROBOT.parent / "poses.csv", fit="base_frame,joint_offset")
    page = render([enough], ["plan"])
    assert "enough poses" in page
    assert "poses.csv" in page
