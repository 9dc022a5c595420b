"""Charts, numbers in texts, and the page of a plan."""

import copy
import io
import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import results
from matplotlib.figure import Figure
from sample_files import ROBOT

import robacc
from robacc.errors import UsageError
from robacc.modelling.robot_file import find_arm, read_robot
from robacc.render.page import command_line, render
from robacc.render.plots.canvas import DARK, LIGHT, Chart, Panel, as_file, as_part, need, short, thinned
from robacc.render.plots.poses import SHARES, error_axis
from robacc.render.plots.results import chart_of, charts_of, comparison_charts, operating_curve_charts
from robacc.render.text import (
    Grid,
    decimals,
    draw,
    effect_families,
    effect_label,
    fixed,
    grouped,
    measured,
    odds,
    p_value,
    three_digits,
    unit_of,
)
from robacc.simulation.simulate import Plan, simulate
from robacc.statistics.intervals import chi2_cdf

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
    document = many(6_000)
    for chart in charts_of(document):
        assert as_part(chart, "x").count("<use") < 2500
        if chart.kind == "time":
            assert "of 6,000 poses, including the extremes" in chart.caption
        if chart.kind == "distribution":
            sizes = np.sqrt(np.sum(np.square(document["position"]["errors_m"]), axis=1)) * 1e3
            quantiles = [float(row[1].split()[0]) for row in chart.table.rows]
            assert quantiles == pytest.approx(np.quantile(sizes, (0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 1)), rel=6e-3)


def test_thinning_keeps_the_extremes_and_is_always_the_same() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.normal(size=100_000), rng.normal(size=100_000)
    rows = thinned(500, first, second)
    assert rows.size == 500
    assert np.all(np.diff(rows) > 0)
    for column in (first, second):
        assert {int(np.argmin(column)), int(np.argmax(column))} <= set(rows.tolist())
    assert np.array_equal(rows, thinned(500, first.copy(), second.copy()))
    # The rest is spread over all rows, not taken from their beginning.
    assert np.all(np.histogram(rows, bins=10, range=(0, 100_000))[0] > 20)
    assert np.array_equal(thinned(500, first[:500]), np.arange(500))
    assert thinned(60, np.where(np.arange(1000) == 7, np.nan, first[:1000])).size == 60


def test_units_follow_the_size() -> None:
    assert unit_of("m", 1e-5).name == "µm"
    assert unit_of("m", 1e-5, 1e-3).name == "mm"
    # Charts and tables have one unit for angles, whatever their size.
    assert {unit_of("rad", size).name for size in (1e-4, 1e-2, 0.5)} == {"°"}
    assert unit_of("m", 1e-3).name == "mm"
    assert unit_of("m").text(0.00123456) == "1.23 mm"
    assert unit_of("rad").text(math.pi / 180) == "1.00°"
    assert unit_of("m").text(math.nan) == "–"
    assert [unit_of("1").text(number) for number in (60.0, -12345.0, 1.5)] == ["60", "-12345", "1.50"]


def test_names_are_cut_to_one_line() -> None:
    assert short("a" * 40, 10) == "a" * 9 + "…"
    assert short("a\nb\x00c") == "a b c"


def test_radii_of_the_ellipsoids_are_chi_square_quantiles() -> None:
    for share, radius in SHARES:
        assert chi2_cdf(radius**2, 3.0) == pytest.approx(share, abs=1e-6)


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


@pytest.mark.parametrize(
    ("value", "lower", "upper", "expected"),
    [
        (0.7172, 0.650, 0.801, 3),  # half width 0.0755: two digits of it are thousandths
        (0.7172, 0.60, 0.85, 2),  # 0.125 -> 0.13
        (100.0, 90.01, 109.93, 0),  # 9.96 rounds to 10, whose second digit is the unit
        (1234.0, 900.0, 1500.0, 0),
        (0.01234, None, None, 4),  # three digits of the value
        (12.34, None, None, 1),
        (0.0, None, None, 3),
        (0.5, 0.5, 0.5, 3),
        (1e-20, None, None, 9),
    ],
)
def test_decimals(value: float, lower: float | None, upper: float | None, expected: int) -> None:
    assert decimals(value, lower, upper) == expected


@pytest.mark.parametrize(
    ("form", "values", "texts"),
    [
        (three_digits, (0.0, 1e-25, 1e-5, 0.00123), ("0", "0", "1.00e-05", "0.00123")),
        (three_digits, (1.2345, 123.4, 98765.4, 1e7), ("1.23", "123", "98765", "1.00e+07")),
        (partial(fixed, places=3), (-0.0004, -0.0006), ("0.000", "-0.001")),
        (partial(fixed, places=2), (None, math.nan), ("–", "–")),
        (p_value, (None, 1e-9, 0.0321, 1.0), ("–", "p < 1e-6", "p = 0.032", "p = 1")),
        # Odds are those of the alternative.
        (odds, (0.0, math.log(5), -math.log(20), 800.0), ("1 to 1", "1 to 5", "20 to 1", "1 to 1.01e+304")),
        # Names with a common beginning stand together.
        (
            grouped,
            (["tool_frame.a.roll", "tool_frame.a.yaw", "joint_offset.j1"], ["alone"], ["a", "b"]),
            ("tool_frame.a (roll, yaw), joint_offset.j1", "alone", "a, b"),
        ),
    ],
)
def test_a_value_as_text(form: Callable[[Any], str], values: tuple[Any, ...], texts: tuple[str, ...]) -> None:
    assert tuple(map(form, values)) == texts


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (2.1, 2.7e-6, ("2.1000000", "2.7e-06")),
        (0.40034312, 4.04e-6, ("0.4003431", "4.0e-06")),
        (-5.16489e-7, 3.7e-6, ("-5e-07", "3.7e-06")),
        (-4e-8, 3.7e-6, ("0", "3.7e-06")),
        (9.6e-8, 3.7e-6, ("1e-07", "3.7e-06")),
        (8.7361e-7, 3.01e-9, ("8.736e-07", "3.0e-09")),
        (-0.00015784, 3.3e-6, ("-0.0001578", "3.3e-06")),
        (-0.0003778, 0.000996, ("-0.0004", "0.0010")),  # 9.96 rounds to 10
        (-0.00001, 0.0123, ("0.000", "0.012")),
        (5678.0, 123.0, ("5680", "120")),
        (0.0, 1e-5, ("0", "1.0e-05")),
        (1.5, 1e-18, ("1.50000000000000", "1.0e-18")),
        (0.25, 0.0, ("0.25", "0")),
        (-0.0, 0.0, ("0", "0")),
    ],
)
def test_a_value_ends_where_its_standard_error_does(value: float, error: float, shown: tuple[str, str]) -> None:
    assert measured(value, error) == shown


@pytest.mark.parametrize("value", [3.7, 1.234567e-3, -2.2e-7, 9.87654e5, 6.1e9])
@pytest.mark.parametrize("error", [1.04e-10, 9.96e-8, 3.3e-5, 0.0707, 25.0])
def test_rounding_a_value_costs_less_than_a_twentieth_of_its_error(value: float, error: float) -> None:
    """Half a unit of the second digit of an error that begins with 1 is 0.05 of it."""
    shown, its_error = measured(value, error)
    assert abs(float(shown) - value) <= max(0.051 * error, 1e-14 * abs(value))
    assert float(its_error) == pytest.approx(error, rel=0.051)


def test_the_label_of_an_effect_tells_its_forms_apart() -> None:
    assert effect_label("joint_compliance", ["j2"], {}) == "joint_compliance[j2]"
    assert effect_label("joint_compliance", ["j2"], {"masses": "uncertain"}) == (
        "joint_compliance[j2] with uncertain masses"
    )
    assert effect_label("step", [], {"part": "base", "from_line": 65}) == "step[base] at line 65"


def test_a_calibration_without_orientations_and_masses_stays_short() -> None:
    entry = find_arm("irb120_3_58")
    robot = read_robot(entry["path"])
    data = simulate(robot, Plan(50, seed=2, noise_position=5e-5, orientation=False)).data
    fit = ("base_frame", "tool_frame", "joint_offset", "link_geometry", "joint_compliance[j2]")
    result = robacc.calibrate(data, robot=robot, fit=fit)
    stream = io.StringIO()
    draw(result.view(full=True), stream)
    lines = stream.getvalue().splitlines()
    assert sum("not identifiable" in line for line in lines) == 2
    assert not any(".hx2" in line for line in lines)
    assert sum(line.startswith("joint_compliance.j2: ") for line in lines) == 1
    gram, prior = result.fit.gram, np.diag(result.fit.precision)
    free = np.trace(np.linalg.solve(gram + prior, gram))
    assert lines[0].endswith(f": {len(gram)} coefficients fitted, of which priors leave {free:.0f} free")
    # The JSON result keeps each of them.
    text = result.to_json()
    assert json.loads(text)["n_determined"] == pytest.approx(free, rel=1e-6)
    assert text.count('"joint_compliance.j2.h') > 10
    assert all(dropped.name in text for dropped in result.identifiability.dropped)


def document(**options: object) -> dict[str, object]:
    return json.loads(robacc.plan(ROBOT, **{"candidates": 120, "check_every": 6, **options}).to_json())


@pytest.fixture(scope="module")
def calibration() -> dict[str, object]:
    return document(poses=14, validation=3, instrument="2,0,1", outside=["x=0.6:1,z=:0.2"], min_height="0.05")


def test_the_charts_show_what_the_document_has(calibration: dict[str, object]) -> None:
    charts = {chart.kind: chart for chart in charts_of(calibration)}
    assert list(charts) == ["planned-poses", "expected-accuracy", "detection-limits"]
    poses = charts["planned-poses"]
    assert len(poses.table.rows) == calibration["n_visits"]
    traces = {trace["name"]: trace for trace in poses.scene["traces"]}
    assert len(traces["validation poses"]["x"]) == 3
    assert traces["instrument"]["x"] == [2.0]
    # Every pose has one mark: once, twice or as a check.
    marked = sum(len(traces[name]["x"]) for name in ("poses", "poses visited twice", "drift check poses"))
    assert marked == 14
    curve = charts["expected-accuracy"].table.rows
    assert [int(row[0]) for row in curve] == [p["n_poses"] for p in calibration["accuracy"]["curve"]]  # type: ignore[index]


def test_limits_are_those_of_the_joints(calibration: dict[str, object]) -> None:
    for family in effect_families(calibration):
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
    enough = document(already=ROBOT.parent / "poses.csv", fit="base_frame,joint_offset", candidates=40)
    page = render([enough], ["plan"])
    assert "enough poses" in page
    assert "poses.csv" in page
