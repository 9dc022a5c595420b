"""Charts apart from the page: thinning of many poses, units, and agreement with the numbers of the result."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import results
from matplotlib.figure import Figure
from typer.testing import CliRunner

import robacc
from robacc.cli.main import app
from robacc.errors import UsageError
from robacc.render.plots.canvas import DARK, LIGHT, Chart, Panel, as_file, as_part, need, short
from robacc.render.plots.poses import SHARES, error_axis, stages_of
from robacc.render.plots.results import chart_of, charts_of, comparison_charts, operating_curve_charts
from robacc.render.text import Grid, unit_of
from robacc.statistics.distributions import chi2_cdf

KINDS = {
    "estimate": ["distribution", "distribution-orientation", "poses", "ellipsoids-tool", "ellipsoids-base", "time"],
    "predict": ["distribution", "distribution-orientation", "ellipsoids-tool", "budget", "budget-joints", "workspace"],
    "calibrate": ["distribution", "effect", "effect", "poses", "time", "workspace"],
    "trace": ["distribution", *["effect"] * 2, *["candidates"] * 3, "poses", "time", "workspace"],
    "iso9283": ["iso9283", *["iso9283-cloud"] * 5],
}


@pytest.mark.parametrize("command", KINDS)
def test_the_charts_of_each_command(command: str) -> None:
    assert [chart.kind for chart in charts_of(results.document(command))] == KINDS[command]


def many(n: int) -> dict[str, Any]:
    """The sample estimate with its poses repeated to ``n``."""
    document = copy.deepcopy(results.document("estimate"))
    for part in (document["poses"], document["position"], document["orientation"]):
        for key, value in part.items():
            if isinstance(value, list) and len(value) == 60:
                part[key] = (value * (n // 60 + 1))[:n]
    for frame in document["position_by_frame"].values():
        frame["errors_m"] = (frame["errors_m"] * (n // 60 + 1))[:n]
    return document


def test_many_poses_are_thinned_in_the_chart_and_not_in_the_numbers() -> None:
    document = many(20_000)
    for chart in charts_of(document):
        assert as_part(chart, "x").count("<use") < 2500
        if chart.kind == "time":
            assert "of 20,000 poses, including the extremes" in chart.caption
        if chart.kind == "distribution":
            sizes = np.sqrt(np.sum(np.square(document["position"]["errors_m"]), axis=1)) * 1e3
            quantiles = [float(row[1].split()[0]) for row in chart.table.rows]
            assert quantiles == pytest.approx(np.quantile(sizes, (0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1)), rel=6e-3)


def test_units_follow_the_size() -> None:
    assert unit_of("m", 1e-5).name == "µm"
    assert unit_of("m", 1e-5, 1e-3).name == "mm"
    # Charts and tables have one unit for angles, whatever their size.
    assert {unit_of("rad", size).name for size in (1e-4, 1e-2, 0.5)} == {"°"}
    assert unit_of("m", 1e-3).name == "mm"
    assert unit_of("m").text(0.00123456) == "1.23 mm"
    assert unit_of("rad").text(math.pi / 180) == "1.00°"
    assert unit_of("m").text(math.nan) == "–"


def test_names_are_cut_to_one_line() -> None:
    assert short("a" * 40, 10) == "a" * 9 + "…"
    assert short("a\nb\x00c") == "a b c"


def test_radii_of_the_ellipsoids_are_chi_square_quantiles() -> None:
    for share, radius in SHARES:
        assert chi2_cdf(radius**2, 3.0) == pytest.approx(share, abs=1e-6)


def test_errors_of_poses_make_the_figures_of_the_result() -> None:
    for command in ("trace", "calibrate"):
        document = results.document(command)
        by_stage = stages_of(document, "m")
        assert by_stage is not None
        assert by_stage.held_out
        for (_, _, sizes), key in zip(by_stage.sizes(), ("nominal", "before", "after"), strict=True):
            rms = math.sqrt(float(np.mean(np.square(sizes))))
            assert rms == pytest.approx(document[key]["held_out"]["position"]["rms_m"], rel=1e-6)
        fitted = np.array(document["poses"]["errors_m"]["after"])
        rms = math.sqrt(float(np.mean(np.sum(np.square(fitted), axis=1))))
        assert rms == pytest.approx(document["after"]["fitted"]["position"]["rms_m"], rel=1e-6)


def test_covariances_in_both_frames_are_of_the_same_errors() -> None:
    document = results.document("estimate")
    tool, base = (document["position_by_frame"][frame] for frame in ("tool", "base"))
    assert np.allclose(tool["covariance_m2"], document["position"]["covariance_m2"], rtol=1e-9)
    assert np.trace(tool["covariance_m2"]) == pytest.approx(np.trace(base["covariance_m2"]), rel=1e-9)
    poses = document["poses"]
    difference = np.array(poses["attained_m"]) - np.array(poses["commanded_m"])
    assert np.allclose(difference, base["errors_m"], atol=3e-12)
    lengths = [np.sqrt(np.sum(np.square(frame["errors_m"]), axis=1)) for frame in (tool, base)]
    assert np.allclose(*lengths, atol=3e-12)


def test_colours_on_a_page_are_its_variables_and_in_a_file_paints() -> None:
    chart = chart_of(results.document("trace"), "distribution")
    part = as_part(chart, "a")
    assert "var(--c-before)" in part
    assert not any(colour in part for colour in LIGHT.values())
    assert len(set(LIGHT.values())) == len(LIGHT)
    assert LIGHT.keys() == DARK.keys()
    assert LIGHT["before"] in as_file(chart, "svg").decode()


def test_formulas_and_strange_signs_in_names_are_drawn_as_text() -> None:
    document = results.document("trace")
    for finding in document["findings"]:
        finding["joints"] = ["$\\frac{1}{$ {joint} 關節 _x\n"]
        for curve in finding["partial_residuals"]:
            curve["joint"] = curve["driver"] = finding["joints"][0]
    for chart in charts_of(document)[:3]:
        assert b"<svg" in as_file(chart, "svg")
        assert "frac" in chart.title or chart.kind == "distribution"


def test_an_unknown_chart_lists_the_charts_of_the_result() -> None:
    document = results.document("trace")
    with pytest.raises(UsageError, match="no chart 'budget'; it has distribution, effect, candidates, poses"):
        chart_of(document, "budget")
    with pytest.raises(UsageError, match=r"has 2 chart\(s\) 'effect', not 3"):
        chart_of(document, "effect", 3)


def test_a_missing_library_is_named_with_the_command_that_installs_it() -> None:
    with pytest.raises(
        UsageError, match=r"need no_such_library, .*; run pip install '\.\[report\]' in a checkout, or .*git\+URL"
    ):
        need("matplotlib", "no_such_library")


def test_the_colour_blind_can_tell_the_roles_apart() -> None:
    """Simulated dichromacies (Viénot, Brettel, Mollon 1999) leave the two sides of every comparison far apart."""
    protan = np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, -0.0], [0.00401, -0.00401, 1.0]])
    deutan = np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, -0.0], [-0.02234, 0.02234, 1.0]])
    for palette in (LIGHT, DARK):
        paints = [
            np.array([int(palette[role][i : i + 2], 16) / 255 for i in (1, 3, 5)]) for role in ("before", "after")
        ]
        linear = [np.where(p <= 0.04045, p / 12.92, ((p + 0.055) / 1.055) ** 2.4) for p in paints]
        for vision in (np.eye(3), protan, deutan):
            assert np.linalg.norm(vision @ linear[0] - vision @ linear[1]) > 0.25


@pytest.mark.parametrize(
    ("largest", "shown"), [(2.0, ["0.01", "0.1", "1", "10", "100", "1000"]), (5e-4, ["0.01", "0.02"])]
)
def test_a_wide_logarithmic_scale_has_a_number_a_decade(largest: float, shown: list[str]) -> None:
    figure = Figure()
    x = error_axis("error, mm", [np.full(9, largest * 1e3), np.full(9, 1e-2)])
    Chart("", "", "", "", [Panel((x, x), [])], Grid((), [])).draw(figure)
    (axes,) = figure.axes
    figure.draw_without_rendering()
    low, high = axes.get_xlim()
    ticks = zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
    labels = [label.get_text() for place, label in ticks if low <= place <= high]
    assert labels[: len(shown)] == shown
    assert len(labels) <= 8


def test_bars_of_candidates_follow_their_evidence() -> None:
    document = results.document("trace")
    ranking = document["candidates"][0]["ranking"]
    chosen = ranking[0]
    for candidate in ranking:
        if candidate["effect"] == "transmission_error":
            candidate["evidence"] += 1000.0
    first = chart_of(document, "candidates")
    evidence = [float(row[1]) for row in first.table.rows]
    assert evidence == sorted(evidence, reverse=True)
    assert f"{chosen['effect']}[{','.join(chosen['joints'])}], which has a higher prior, was added" in first.caption
    assert "It was added" in chart_of(results.document("trace"), "candidates").caption


def test_the_operating_curve_of_a_largest_error_is_over_the_share_within_the_limit() -> None:
    criterion: dict[str, Any] = {
        "name": "c",
        "key": "position.max",
        "unit": "m",
        "limit": 1e-3,
        "value": 0.8e-3,
        "share": 0.95,
        "at_least": False,
        "rule_text": "rule",
        "n_poses": 100,
        "operating_curve_over": "share_within_limit",
        "operating_curve": [[1.0 - k * 0.01, (1.0 - k * 0.01) ** 100] for k in range(21)],
    }
    (chart,) = operating_curve_charts({"gate": {"criteria": [criterion]}})
    assert chart.table.rows[0] == ["100 %", "100.0 %"]
    assert all(row[0].endswith(" %") for row in chart.table.rows)
    figure = Figure()
    chart.draw(figure)
    (axes,) = figure.axes
    assert axes.get_xlim()[0] > 75.0
    assert axes.get_xlabel() == "share of all poses with position within 1.00 mm, %"


def test_a_comparison_of_signed_figures_keeps_what_is_below_zero() -> None:
    values = [
        {"name": name, "value": value, "lower": value - 2e-4, "upper": value + 2e-4, "confidence": 0.95}
        for name, value in (("a", -1e-3), ("b", 5e-4))
    ]
    document = {
        "command": "compare",
        "baseline": None,
        "ranking": {"by": "iso9283.AD.max"},
        "statistics": [{"key": "iso9283.AD.max", "unit": "m", "values": values}],
    }
    (chart,) = comparison_charts(document)
    figure = Figure()
    chart.draw(figure)
    assert figure.axes[0].get_xlim()[0] < -1.2
    assert "smallest in magnitude is b" in chart.caption


def test_the_arm_stands_at_its_registered_base(tmp_path: Path) -> None:
    """The sample poses in the frame of an instrument that stands 2 m beside the arm."""
    poses = tmp_path / "poses.csv"
    note, head, *rows = (results.PROJECT / "sample_data" / "poses.csv").read_text(encoding="utf-8").splitlines()
    x = head.split(",").index("x")
    cells = [row.split(",") for row in rows]
    moved = [",".join([*row[:x], f"{float(row[x]) + 2.0}", *row[x + 1 :]]) for row in cells]
    poses.write_text("\n".join([note, head, *moved]), encoding="utf-8")
    robot = results.PROJECT / "sample_data" / "robot.yaml"
    estimate = robacc.estimate(poses, robot=robot, align=("base_frame", "tool_frame"))
    arm = np.array(json.loads(estimate.to_json())["robot"]["outline"]["line_m"])
    assert arm[0] == pytest.approx([2.0, 0.0, 0.0], abs=0.01)


def test_plot_without_a_kind_draws_the_main_chart_and_names_the_others(tmp_path: Path) -> None:
    stored, image = tmp_path / "trace.json", tmp_path / "a.svg"
    stored.write_text(json.dumps(results.document("trace")), encoding="utf-8")
    done = CliRunner().invoke(app, ["report", str(stored), "-o", str(image)])
    assert done.exit_code == 0
    assert done.stderr == (
        "note: drew the main chart, distribution; other charts by --chart: effect, candidates, poses, time, workspace\n"
    )
    assert image.read_text(encoding="utf-8").startswith("<?xml")
