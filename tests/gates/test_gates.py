"""Gates: their files, figures, decision rules, and what is said of them."""

import copy
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from commands import missing
from refusals import problems_of
from scipy import stats
from slow_parameters import some_fast

import robacc
from robacc.accuracy.error_statistics import error_statistics, length_intervals, satterthwaite
from robacc.accuracy.grade import default_scale, grade
from robacc.comparison.stored_results import NoValueError, errors_behind, value_at
from robacc.documents.accuracy import GRADE
from robacc.documents.envelope import GATE_RESULT, significant_document
from robacc.documents.keys import STATISTICS
from robacc.gates import (
    LEVELS,
    BoundCurve,
    Evaluation,
    Gate,
    GateCriterion,
    GateOutcome,
    Rule,
    decide,
    decide_largest,
    difference_curve,
    evaluate_gate,
    evaluated,
    figure_at,
    load_gate,
)
from robacc.geometry import Array
from robacc.io.json_text import json_text
from robacc.render.views.compare import (
    github_annotations,
    junit as suites,
    markdown,
    title,
    words_of,
)
from robacc.statistics.intervals import ASSURANCE, Interval
from robacc.workers import FileOutcome

EXAMPLES = Path(__file__).resolve().parents[2] / "configs" / "gates"
HEAD = "robacc_gate: 1\nname: g\ncriteria:\n"


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        (
            "key: position.p95, limit: 0.2 mm",
            {"name": "position.p95", "limit": 2e-4, "rule": "bound", "confidence": 0.95, "at_least": False},
        ),
        ("key: orientation.max, limit: 0.1 deg", {"limit": math.pi / 1800}),
        ("key: n_poses, at_least: 30", {"rule": "simple"}),
        ("key: gain, at_least: -5 um, confidence: 0.9", {"limit": -5e-6, "at_least": True, "confidence": 0.9}),
        ("key: position.rms, limit: 1mm, rule: guard_band, false_accept_risk: 0.02", {"confidence": 0.98}),
        ("key: position.rms, baseline: b.json", {"rule": "guarded_rejection", "limit": 0.0, "at_least": False}),
        ("key: gain, baseline: b.json", {"at_least": True}),
        ("key: verdict, limit: [clean, explained]", {"accepted": ("clean", "explained")}),
        ("key: grade, limit: C", {"accepted": ("C",)}),
        ("key: grade.demonstrated, limit: true", {"accepted": ("true",)}),
        ("key: iso9283.drift.AP.max, limit: 0.1 mm", {"kind": "length"}),
        ("key: iso9283.AP.orientation.max, limit: 0.1 deg", {"kind": "angle"}),
    ],
)
def test_limits_become_si_and_rules_have_their_defaults(entry: str, expected: dict[str, object]) -> None:
    (criterion,) = load_gate(f"{HEAD}  - {{reason: r, {entry}}}\n", "g.yaml").criteria
    for name, value in expected.items():
        assert getattr(criterion, name) == (pytest.approx(value) if isinstance(value, float) else value), name


@pytest.mark.parametrize(
    "name",
    sorted({"assembly", "machine_tending", "machining", "regression", *(one.stem for one in EXAMPLES.glob("*.yaml"))}),
)
def test_examples_are_gates_whose_every_criterion_has_a_reason(name: str) -> None:
    gate = load_gate((EXAMPLES / f"{name}.yaml").read_text(encoding="utf-8"), f"{name}.yaml")
    assert gate.name.replace(" ", "_") == name
    assert all(len(criterion.reason) > 20 and "\n" not in criterion.reason for criterion in gate.criteria)


def test_what_a_gate_has_beside_its_criteria() -> None:
    gate = load_gate(
        "robacc_gate: 1\nname: g\nconfidence: 0.99\ncriteria:\n"
        "  - {key: position.rms, baseline: a.json, reason: r}\n"
        "  - {key: position.p95, limit: 1 mm, confidence: 0.9, reason: r}\n"
        "  - {key: position.max, baseline: a.json, reason: r}\n"
        "  - {key: orientation.max, baseline: b.json, reason: r}\n"
        "  - {key: orientation.rms, limit: 1 deg, reason: r}\n",
        "g.yaml",
    )
    assert [criterion.confidence for criterion in gate.criteria] == [0.99, 0.9, 0.99, 0.99, 0.99]
    assert gate.baselines == ("a.json", "b.json")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("key: positon.p95, limit: 1 mm", "key: no result has the key 'positon.p95'; did you mean position.p95?"),
        ("key: position.mean, limit: 1 mm", "did you mean position.mean_error?"),
        ("key: colour, limit: 1 mm", "no result has the key 'colour'; for example position.p95"),
        ("limit: 1 mm", "criteria[0].key: is missing"),
        ("key: position.rms", "limit: is missing; give a maximum (limit) or a minimum (at_least)"),
        (
            "key: position.rms, limit: 1 mm, at_least: 2 mm",
            "limit (a maximum) and at_least (a minimum) exclude each other",
        ),
        ("key: position.rms, limit: 1", "expected a number with its unit (m, mm, um), found '1'; as in 0.2 mm"),
        ("key: position.rms, limit: 1 deg", "expected a number with its unit (m, mm, um), found '1 deg'"),
        ("key: orientation.rms, limit: 1 mm", "expected a number with its unit (rad, mrad, urad, deg), found '1 mm'"),
        ("key: n_poses, at_least: 30 mm", "expected a number without a unit, found '30 mm'"),
        ("key: iso9283.RP.max, limit: 2 cm", "expected a number with its unit (m, mm, um, rad, mrad, urad, deg)"),
        ("key: position.rms, limit: -1 mm", "position.rms is never negative, so no result can meet '-1 mm'"),
        ("key: position.rms, limit: [1, 2]", "limit: expected a name, found a list of 2"),
        ("key: verdict, at_least: clean", "limit: expected a list of the words that pass"),
        ("key: verdict, limit: []", "the list of words that pass is empty"),
        ("key: verdict, limit: clean, rule: bound", "a word has no uncertainty; use rule: simple"),
        ("key: verdict, limit: clean, baseline: b.json", "only numbers can be compared with a baseline"),
        ("key: grade, limit: [A, B]", "expected one grade (better grades meet it too), found a list"),
        ("key: grade", "limit: expected the grade to meet"),
        ("key: grade, limit: A, confidence: 0.9", "the scale of the grade sets the confidence; remove this key"),
        ("key: grade, limit: A, rule: guarded_rejection", "a grade takes rule: bound"),
        ("key: position.rms, limit: 1 mm, rule: bond", "expected bound or simple or guard_band or guarded_rejection"),
        (
            "key: position.rms, limit: 1 mm, rule: guard_band",
            "false_accept_risk: is missing; give the accepted risk of a false accept",
        ),
        ("key: position.rms, limit: 1 mm, rule: simple, confidence: 0.9", "confidence: does not apply to rule: simple"),
        ("key: position.rms, limit: 1 mm, false_reject_risk: 0.1", "it belongs to rule: guarded_rejection"),
        ("key: position.rms, limit: 1 mm, confidence: 95", "found 95, expected a number between 0.5 and 1"),
        (
            "key: position.rms, limit: 1 mm, rule: guard_band, false_accept_risk: 0.7",
            "found 0.7, expected a number between 0 and 0.5",
        ),
        ("key: position.rms, limit: 1 mm, share: 0.9", "share: applies only to a largest error"),
        ("key: position.rms, limit: 1 mm, paired: true", "paired: applies only with a baseline"),
        ("key: position.rms, baseline: b.json, paired: maybe", "paired: expected true or false, found 'maybe'"),
        ("key: position.rms, limit: 1 mm, limt: 2 mm", "limt: unknown key; did you mean 'limit'?"),
    ],
)
def test_each_mistake_is_named(entry: str, message: str) -> None:
    messages = problems_of(load_gate, f"{HEAD}  - {{reason: r, {entry}}}\n", "g.yaml")
    assert any(message in text for text in messages), messages
    assert all(text.startswith("g.yaml:4, criteria[0]") for text in messages)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (f"{HEAD}  - {{key: position.rms, limit: 1 mm}}\n", "4, criteria[0].reason: is missing"),
        (
            f"{HEAD}  - {{key: position.rms, limit: 1 mm, reason: [a]}}\n",
            "4, criteria[0].reason: expected text: the reason for the limit",
        ),
        ("- a\n", "1: expected keys with values (robacc_gate, name, confidence, criteria), found a list of 1"),
        (
            "robacc_gate: 1\nname: g\ncriteria: []\n",
            "3, criteria: the list is empty; a gate needs at least one criterion",
        ),
        (
            HEAD + "  - {key: position.rms, limit: 1 mm, reason: r}\n" * 2,
            "5, criteria[1].name: two criteria have the name 'position.rms'",
        ),
    ],
)
def test_what_is_no_gate(text: str, problem: str) -> None:
    assert problems_of(load_gate, text, "g.yaml") == [f"g.yaml:{problem}"]


def test_every_problem_of_the_file_at_once() -> None:
    text = (
        "robacc_gate: 2\nnam: g\ncriteria:\n  - {key: position.rms, limit: 1 cm, reason: r}\n"
        "  - {key: x, limit: 1 mm, reason: r}\n"
    )
    messages = problems_of(load_gate, text, "g.yaml")
    assert [text.partition(":")[2].partition(",")[0] for text in messages] == ["1", "1", "2", "4", "5"]
    assert "expected 1, found '2'" in messages[0]


N = 80


def errors(seed: int = 0, size: float = 1e-3, n: int = N) -> Any:
    return size * np.array([[1.0], [0.6], [0.3]]) * np.random.default_rng(seed).normal(size=(3, n))


def estimate(position: Any = None, orientation: Any = None, **more: Any) -> dict[str, Any]:
    """The document of an estimate, as far as gates read it."""
    position = errors() if position is None else position
    orientation = errors(1, 2e-3, position.shape[1]) if orientation is None else orientation
    of_position, of_orientation = error_statistics(position, "m"), error_statistics(orientation, "rad")
    n = position.shape[1]
    return {
        "command": "estimate",
        "inputs": [{"name": "p.csv", "sha256": "abc", "kind": "poses"}],
        "seed": 0,
        "n_poses": n,
        "position": STATISTICS["m"].write(of_position, errors_m=position.T),
        "orientation": STATISTICS["rad"].write(of_orientation, errors_rad=orientation.T),
        "grade": GRADE.write(grade(of_position, of_orientation, default_scale())),
        "poses": {"group": np.arange(n), "used": None, "commanded_m": np.arange(3.0 * n).reshape(n, 3)},
        **more,
    }


def evaluate(entry: str, document: Mapping[str, Any], **baselines: Mapping[str, Any]) -> Evaluation:
    (evaluation,) = outcome(f"  - {{reason: r, {entry}}}\n", document, **baselines).evaluations
    return evaluation


def outcome(entries: str, document: Mapping[str, Any], **baselines: Mapping[str, Any]) -> GateOutcome:
    return evaluate_gate(load_gate(f"robacc_gate: 1\nname: g\ncriteria:\n{entries}", "g.yaml"), document, baselines)


def test_a_short_key_finds_the_value_with_its_unit() -> None:
    document = estimate()
    radius = document["position"]["radius95"]["zero_mean"]["radius_m"]
    for key, value, dimension in (
        ("position.rms", document["position"]["rms_m"], "length"),
        ("orientation.max", document["orientation"]["max_rad"], "angle"),
        ("position.radius95.zero_mean.radius", radius, "length"),
    ):
        found = figure_at(document, key, 0.95)
        assert (found.value, found.dimension) == (value, dimension)


def test_repetitions_of_a_pose_count_once() -> None:
    document = estimate(np.tile(errors(n=20), 5))
    ungrouped = figure_at(document, "position.rms", 0.95).curve.bound(0.95)
    document["poses"]["group"] = np.tile(np.arange(20), 5)
    grouped = figure_at(document, "position.rms", 0.95)
    assert grouped.n == 20
    assert grouped.curve.bound(0.95) > 1.02 * ungrouped


def stage(after: Any, used: Any = None, **more: Any) -> dict[str, Any]:
    rows = {"nominal": 3 * after.T, "before": 2 * after.T, "after": after.T}
    rows |= {"held_out_nominal": 3 * after.T, "held_out_before": 2.1 * after.T, "held_out_after": 1.1 * after.T}
    n = after.shape[1]

    def figures(factor: float, columns: Any = slice(None)) -> dict[str, Any]:
        return {
            "position": STATISTICS["m"].write(error_statistics(factor * after[:, columns], "m"), errors_m=None),
            "orientation": None,
        }

    def metrics(fitted: float, held_out: float) -> dict[str, Any]:
        inliers = slice(None) if used is None else np.asarray(used)
        return {
            "fitted": figures(fitted),
            "held_out": figures(held_out),
            "fitted_inliers": figures(fitted, inliers),
            "held_out_inliers": figures(held_out, inliers),
        }

    return {
        "command": "trace",
        "inputs": [{"name": "p.csv", "sha256": "abc", "kind": "poses"}],
        "seed": 0,
        "n_poses": n,
        "verdict": "explained",
        "unexplained": {"structured": False, "rms_m": 1e-4},
        "noise": {"position_m": 2e-5, "orientation_rad": None, "source": "file"},
        "after": metrics(1.0, 1.1),
        "nominal": metrics(3.0, 3.0),
        "gain_m": {"value": 1e-3, "low": 0.8e-3, "high": 1.2e-3, "confidence": 0.95},
        "poses": {"group": np.arange(n), "used": used, "commanded_m": np.zeros((n, 3)), "errors_m": rows},
        "poses_apart": None,
        **more,
    }


def test_errors_are_the_rows_that_a_stages_metrics_are_of() -> None:
    after = errors(n=30)
    document = stage(after, np.arange(30) != 7)
    for place, factor in (("after.held_out", 1.1), ("after.fitted", 1.0), ("nominal.held_out", 3.0)):
        rows = errors_behind(document, f"{place}.position")
        np.testing.assert_allclose(rows.vectors, factor * after)
        stage_figure = figure_at(document, f"{place}.position.rms", 0.95)
        assert stage_figure.value == pytest.approx(np.sqrt(np.mean(np.sum(rows.vectors**2, axis=0))))
    assert errors_behind(document, "after.fitted.orientation") is None
    apart = {"line": range(5), "group": np.arange(5), "errors_m": {"after": np.ones((5, 3))}, "commanded_m": None}
    document["poses_apart"] = apart
    assert errors_behind(document, "after.held_out.position").vectors.shape == (3, 5)
    apart["line"] = range(4)
    with pytest.raises(NoValueError, match=r"^the result's lists do not belong together: poses_apart\.errors_m\.after"):
        figure_at(document, "after.held_out.position.rms", 0.95)


def test_a_welcome_verdict_needs_poses_held_out_and_says_where_noise_is_not_known() -> None:
    document = stage(errors(size=1e-4))
    document["after"]["held_out"] = None
    undecided = evaluate("key: verdict, limit: explained", document)
    why = "the result has no held-out poses to confirm the verdict"
    assert (undecided["outcome"], undecided["why"]) == ("inconclusive", why)
    assert evaluate("key: verdict, limit: clean", document)["outcome"] == "fail"
    guessed = stage(errors(size=1e-4), noise={"position_m": 2e-5, "orientation_rad": None, "source": "residual"})
    passed = evaluate("key: verdict, limit: explained", guessed)
    assert (passed["outcome"], len(passed["warnings"])) == ("pass", 1)
    assert "add a limit on after.held_out.position.p95" in passed["warnings"][0]


@pytest.mark.parametrize(
    ("entry", "outcome"),
    [
        ("key: after.held_out.position.rms, limit: 1 mm", "pass"),
        ("key: after.held_out.position.rms, limit: 0.01 mm", "fail"),
        ("key: verdict, limit: [clean, explained]", "pass"),
        ("key: verdict, limit: explained", "pass"),
        ("key: verdict, limit: clean", "fail"),
        ("key: unexplained.structured, limit: false", "pass"),
        ("key: gain, at_least: 0.5 mm", "pass"),
        ("key: gain, at_least: 0.9 mm", "inconclusive"),
        ("key: gain, at_least: 1.3 mm", "fail"),
        ("key: n_poses, at_least: 80", "pass"),
        ("key: n_poses, at_least: 81", "fail"),
        ("key: nominal.fitted.position.rms, limit: 1 mm", "pass"),
    ],
)
def test_outcomes_of_quantities_words_and_gains(entry: str, outcome: str) -> None:
    found = evaluate(entry, stage(errors(size=1e-4)))
    assert found["outcome"] == outcome
    # The instrument is too coarse for the smallest limit.
    assert bool(found["warnings"]) == ("0.01 mm" in entry)


@pytest.mark.parametrize(
    ("key", "limit", "why"),
    [
        ("verdict", "clean", "a result of robacc estimate has no verdict"),
        ("after.held_out.position.rms", "1 mm", "a result of robacc estimate has no after"),
        ("iso9283.RP.max", "1 mm", "a result of robacc estimate has no iso9283"),
        ("gain", "1 mm", "a result of robacc estimate has no gain"),
        ("unaligned.position.rms", "1 mm", "the result has no unaligned"),
        ("position.max_radius95", "1 mm", "a result of robacc estimate has no position.max_radius95"),
    ],
)
def test_what_the_result_lacks_is_never_a_pass(key: str, limit: str, why: str) -> None:
    document = estimate(unaligned=None)
    result = outcome(f"  - {{key: {key}, limit: {limit}, rule: simple, reason: r}}\n", document)
    assert (result.evaluations[0]["outcome"], result.evaluations[0]["why"]) == ("not_evaluated", why)
    assert (result.outcome, result.exit_status) == ("not_evaluated", 5)


def test_a_missing_number_says_the_results_own_reason() -> None:
    document = {"command": "iso9283", "iso9283": {"RP": {"max_m": None, "why": "one cycle"}}, "verdict": "a"}
    for key, why in (
        ("iso9283.RP.max", r"^the result has no iso9283\.RP\.max: one cycle$"),
        ("verdict.a", r"^the result has no keys within verdict$"),
    ):
        with pytest.raises(NoValueError, match=why):
            value_at(document, key)
    for value in ("x", {}):
        with pytest.raises(NoValueError, match=r"^the result's position\.rms is not a number$"):
            figure_at({"position": {"rms_m": value}}, "position.rms", 0.95)
    assert evaluate("key: verdict, limit: clean", {"verdict": 3})["why"] == "the result's verdict is not a word"


def test_an_iso_criterion_has_its_interval_beside_it() -> None:
    interval = {"lower": 1e-5, "upper": 4e-5, "upper_bound": 3.5e-5, "confidence": 0.95, "method": "m"}
    document = {
        "command": "iso9283",
        "n_poses": 150,
        "iso9283": {
            "RP": {"max_m": 2e-5, "intervals": {"max_m": interval}},
            "AP": {"max_m": 2e-5, "intervals": {"max_m": {"confidence": 0.95, "why": "no such interval"}}},
        },
    }
    wrong = "the limit has the dimension angle, but iso9283.RP.max of the result has the dimension length"
    for entry, outcome, why in (
        ("RP.max, limit: 0.036 mm", "pass", None),
        ("RP.max, limit: 0.034 mm", "inconclusive", None),
        ("RP.max, limit: 1 deg", "not_evaluated", wrong),
        ("AP.max, limit: 0.036 mm", "inconclusive", "no such interval"),
        ("AP.max, limit: 0.036 mm, rule: simple", "pass", None),
    ):
        found = evaluate(f"key: iso9283.{entry}", document)
        # No share of poses is read into the largest of a few commanded poses.
        assert (found["outcome"], found["why"], found["share"]) == (outcome, why, None)


def test_the_share_of_a_largest_error_is_that_of_the_file() -> None:
    large = evaluate("key: position.max, limit: 10 mm", estimate())
    assert (large["outcome"], large["share"]) == ("pass", 0.95)
    assert large["conformity_probability"] == pytest.approx(1 - 0.95**N)
    assert evaluate("key: position.max, limit: 10 mm, share: 0.98", estimate())["outcome"] == "inconclusive"


def test_what_makes_a_figure_too_optimistic_is_warned_of() -> None:
    document = stage(errors(size=1e-5))
    ok = evaluate("key: after.held_out.position.rms, limit: 0.161 mm", document)
    assert (ok["instrument_uncertainty_over_limit"], ok["warnings"]) == (pytest.approx(4e-5 / 0.161e-3), ())
    coarse = evaluate("name: c, key: after.held_out.position.rms, limit: 0.1 mm", document)
    assert (coarse["outcome"], coarse["warnings"]) == (
        "pass",
        ("c: the instrument's expanded uncertainty (k = 2) is 40 % of the limit, more than the recommended 25 %",),
    )
    fitted = evaluate("name: c, key: after.fitted.position.rms, limit: 1 mm", document)
    assert fitted["warnings"] == (
        "c: after.fitted.position.rms is computed on the calibration poses and is too optimistic; use "
        "after.held_out.position.rms",
    )
    document["noise"]["source"] = "residual"
    assert (
        evaluate("key: after.held_out.position.rms, limit: 0.1 mm", document)["instrument_uncertainty_over_limit"]
        is None
    )


def test_a_check_has_the_warnings_of_its_gate(tmp_path: Path) -> None:
    position = np.zeros((3, 12))
    data = robacc.Measurements(
        position + 1e-4, commanded_position=position, sigma_position=np.full((3, 12), 1e-3), pose=np.arange(12)
    )
    (tmp_path / "gate.yaml").write_text(f"{HEAD}  - {{name: c, key: position.rms, limit: 1 mm, reason: r}}\n")
    checked = robacc.check(robacc.estimate(data), tmp_path / "gate.yaml")
    expected = "the instrument's expanded uncertainty (k = 2) is 200 % of the limit"
    assert any(expected in text for text in checked.warnings)


def test_a_baseline_of_the_same_poses_is_compared_pose_by_pose() -> None:
    base, slightly = estimate(errors()), estimate(1.01 * errors())
    same = evaluate("key: position.rms, baseline: b", base, b=base)
    assert (same["outcome"], same["value"], same["conformity_probability"]) == ("pass", 0.0, 1.0)
    worse = evaluate("key: position.rms, baseline: b", slightly, b=base)
    assert worse["value"] == pytest.approx(0.01 * base["position"]["rms_m"])
    assert worse["baseline"]["value"] == base["position"]["rms_m"]
    for more, outcome, method in (
        ("", "fail", ", paired"),  # one percent, but of every pose
        (", paired: false", "pass", "variance estimates recovery"),  # within the noise of two samples
        (", limit: 0.05 mm, rule: bound", "pass", ", paired"),
        (", limit: 0.05 mm, rule: bound, paired: false", "inconclusive", "variance estimates recovery"),
    ):
        found = evaluate(f"key: position.rms, baseline: b{more}", slightly, b=base)
        assert found["outcome"] == outcome
        assert method in found["method"]
        assert found["method"].endswith(", paired") == (method == ", paired")


@pytest.mark.parametrize("statistic", ["rms", "mean_error", "p95"])
def test_bounds_of_a_paired_difference_are_those_of_an_independent_bootstrap(statistic: str) -> None:
    figures: dict[str, Any] = {
        "rms": lambda size: np.sqrt(np.mean(size**2, axis=-1)),
        "mean_error": lambda size: np.mean(size, axis=-1),
        "p95": lambda size: np.quantile(size, 0.95, axis=-1),
    }
    figure, before = figures[statistic], errors(n=200)
    after = 1.2 * before + 0.5 * errors(7, n=200)
    sizes = [np.linalg.norm(each, axis=0) for each in (after, before)]
    rows = np.random.default_rng(1).integers(200, size=(4000, 200))
    drawn = figure(sizes[0][rows]) - figure(sizes[1][rows])
    entry = f"key: position.{statistic}, baseline: b, confidence: 0.95, rule: bound"
    decision = evaluate(entry, estimate(after), b=estimate(before))
    low, high = np.quantile(drawn, [0.05, 0.95])
    # Studentised bounds follow the skew that quantiles of resamples reverse: a tenth of the width for means.
    assert (decision["lower_bound"], decision["upper_bound"]) == pytest.approx(
        (low, high), abs=(0.25 if statistic == "p95" else 0.1) * (high - low)
    )


def test_which_poses_are_the_same() -> None:
    base, other = estimate(errors(0)), estimate(errors(5))
    other["inputs"] = [{"name": "q.csv", "sha256": "def", "kind": "poses"}]
    moved = copy.deepcopy(other)
    moved["poses"]["commanded_m"] = moved["poses"]["commanded_m"] + 1e-3
    entry = "key: position.rms, baseline: b"
    # Other measurements of the same commanded poses; of others; of others that are said to be the same.
    calls = ((entry, other), (entry, moved), (f"{entry}, paired: true", moved))
    methods = [evaluate(*call, b=base)["method"] for call in calls]
    assert [method.endswith("paired") for method in methods] == [True, False, True]
    joints = np.random.default_rng(2).uniform(-2.0, 2.0, (N, 6))
    forward, backward = copy.deepcopy(base), estimate(errors(0)[:, ::-1])
    forward["poses"]["q"], backward["poses"]["q"], backward["inputs"] = joints, joints[::-1], other["inputs"]
    backward["poses"]["commanded_m"] = backward["poses"]["commanded_m"][::-1]
    same = evaluate(entry, backward, b=forward)  # the same poses in another order
    assert (same["method"], same["conformity_probability"]) == ("the same at every pose", 1.0)
    shorter, bare = estimate(errors(0, n=70)), {"command": "estimate", "position": {"rms_m": 1e-3}}
    shorter["inputs"] = moved["inputs"]
    assert [evaluate(f"{entry}, paired: true", one, b=base)["why"] for one in (shorter, bare)] == [
        "paired: true needs the same poses, but the result has 70 and the baseline has 80",
        "paired: true needs the error of every pose, which the result or the baseline does not list",
    ]


def test_what_a_baseline_lacks_is_not_evaluated() -> None:
    ours, theirs = ({"iso9283": {"RP": {key: 1.0}}} for key in ("max_m", "max"))
    for key, document, baseline, why in (
        (
            "position.rms",
            estimate(),
            {"command": "predict"},
            "in the baseline, a result of robacc predict has no position",
        ),
        ("gain", estimate(), {}, "a result of robacc estimate has no gain"),
        ("iso9283.RP.max", ours, theirs, "iso9283.RP.max has different units in the result and in the baseline"),
    ):
        found = evaluate(f"key: {key}, baseline: b", document, b=baseline)
        assert (found["outcome"], found["why"]) == ("not_evaluated", why)


def test_a_difference_of_largest_errors_has_only_the_simple_rule() -> None:
    base = estimate(errors())
    assert (
        evaluate("key: position.max, baseline: b, rule: simple", estimate(0.9 * errors()), b=base)["outcome"] == "pass"
    )
    hard = evaluate("key: position.max, baseline: b", estimate(0.9 * errors()), b=base)
    assert (hard["outcome"], hard["why"]) == (
        "inconclusive",
        "no test exists for the largest of all errors",
    )


@pytest.mark.parametrize(
    ("outcomes", "expected", "status"),
    [
        (("pass", "pass"), "pass", 0),
        (("pass", "fail", "inconclusive", "not_evaluated"), "fail", 4),
        (("pass", "inconclusive"), "inconclusive", 5),
        (("inconclusive", "not_evaluated"), "not_evaluated", 5),
    ],
)
def test_the_worst_outcome_is_the_gates(outcomes: tuple[str, ...], expected: str, status: int) -> None:
    entries = {
        "pass": "key: position.rms, limit: 9 mm",
        "fail": "key: position.rms, limit: 0.1 mm",
        "inconclusive": f"key: position.rms, limit: {1e3 * estimate()['position']['rms_m']:.6g} mm",
        "not_evaluated": "key: verdict, limit: clean",
    }
    text = "".join(f"  - {{name: {i}, reason: r, {entries[name]}}}\n" for i, name in enumerate(outcomes))
    result = outcome(text, estimate())
    assert tuple(evaluation["outcome"] for evaluation in result.evaluations) == outcomes
    assert (result.outcome, result.exit_status) == (expected, status)


def test_the_document_says_everything_and_is_the_same_each_time() -> None:
    entry = "  - {key: position.p95, limit: 1.5 mm, reason: because}\n"
    document = GATE_RESULT.write(outcome(entry, estimate()))
    assert json_text(document) == json_text(GATE_RESULT.write(outcome(entry, estimate())))
    (entry_document,) = document["criteria"]
    assert set(entry_document) >= {
        *("name", "key", "outcome", "why", "unit", "value", "limit", "at_least", "rule", "confidence", "lower_bound"),
        *("upper_bound", "margin", "conformity_probability", "method", "n_poses", "poses_to_decide", "reason"),
    }
    assert (entry_document["unit"], entry_document["limit"], entry_document["n_poses"]) == ("m", 1.5e-3, N)
    assert entry_document["lower_bound"] < entry_document["value"] < entry_document["upper_bound"]
    curve = np.array(entry_document["operating_curve"])
    assert np.all(np.diff(curve[:, 0]) > 0)
    assert np.all(np.diff(curve[:, 1]) <= 0)
    # The false accepts that rule bound allows at the limit.
    assert curve[np.argmin(np.abs(curve[:, 0] - 1.5e-3)), 1] == pytest.approx(0.05, abs=1e-6)


SD = np.array([1.0, 0.6, 0.3])[:, None]
RMS = float(np.sqrt(np.sum(SD**2)))


def criterion(limit: float, rule: Rule = "bound", confidence: float = 0.95, **more: Any) -> GateCriterion:
    given: dict[str, Any] = {"at_least": False, "share": 0.95, "key": "position.rms", **more}
    given |= {"name": "c", "kind": "length", "accepted": (), "baseline": None, "paired": None, "reason": "r"}
    return GateCriterion(limit=limit, rule=rule, confidence=confidence, **given)


def normal(value: float, error: float, confidence: float = 0.95) -> BoundCurve:
    """Return the curve of a figure with a Gaussian error, as the interval of a result gives it."""
    z, bound = stats.norm.ppf(0.5 + confidence / 2), stats.norm.ppf(confidence)
    interval = Interval(value - z * error, value + z * error, value + bound * error, confidence, "normal")
    return BoundCurve.through([interval], value)


def rms_curve(errors: Array, confidence: float = 0.95) -> tuple[float, BoundCurve]:
    n = errors.shape[1]
    covariance = errors @ errors.T / n
    levels = sorted({*LEVELS, confidence, 2 * confidence - 1})
    curve = BoundCurve.through([satterthwaite(covariance, n, level).root() for level in levels])
    return float(np.sqrt(np.trace(covariance))), curve


def test_a_curve_goes_through_its_interval_and_is_the_distribution_between() -> None:
    curve = normal(-1.0, 0.5)
    assert curve.bound(0.95) == pytest.approx(-1.0 + 0.5 * stats.norm.ppf(0.95), abs=1e-12)
    assert curve.bound(0.05) == pytest.approx(-1.0 - 0.5 * stats.norm.ppf(0.95), abs=1e-9)
    for limit in (-3.0, -1.9, -1.0, -0.4, 0.5):
        assert curve.below(limit) == pytest.approx(stats.norm.cdf(limit, -1.0, 0.5), abs=1e-9)
    assert curve.bound(0.99) is None
    assert curve.standard_error(0.95) == pytest.approx(0.5)


def test_a_curve_knows_where_it_ends() -> None:
    lower = BoundCurve.through([Interval(1.0, None, None, 0.95, "order statistics", "30 poses: too few")], 2.0)
    assert lower.below(0.9) is not None
    assert (lower.below(2.5), lower.reaches) == (None, (True, False))
    assert lower.standard_error(0.95) == pytest.approx(math.log(2.0) / stats.norm.ppf(0.975), rel=1e-6)
    empty = BoundCurve.through([Interval.missing(0.95, "one pose")], 1.0)
    assert (empty.z, empty.below(3.0), empty.bound(0.95), empty.why) == ((), None, None, "one pose")
    same = BoundCurve.through([Interval(2.0, 2.0, 2.0, 0.95, "no scatter")], 2.0)
    assert (same.below(2.0), same.below(1.999)) == (1.0, 0.0)


RULED: list[tuple[Rule, float, bool, str]] = [
    # The value is 1.0 with a standard error of 0.1; the bounds at 95 % are 0.836 and 1.164.
    ("bound", 1.17, False, "pass"),
    ("bound", 1.16, False, "inconclusive"),
    ("bound", 0.84, False, "inconclusive"),
    ("bound", 0.83, False, "fail"),
    ("bound", 0.83, True, "pass"),
    ("bound", 1.16, True, "inconclusive"),
    ("bound", 1.17, True, "fail"),
    ("simple", 1.0, False, "pass"),
    ("simple", 0.999, False, "fail"),
    ("simple", 1.001, True, "fail"),
    ("guard_band", 1.17, False, "pass"),
    ("guard_band", 1.16, False, "fail"),
    ("guard_band", 0.83, True, "pass"),
    ("guarded_rejection", 0.84, False, "pass"),
    ("guarded_rejection", 0.83, False, "fail"),
    ("guarded_rejection", 1.16, True, "pass"),
    ("guarded_rejection", 1.17, True, "fail"),
]


@pytest.mark.parametrize(("rule", "limit", "at_least", "outcome"), RULED)
def test_each_rule_on_either_side_of_each_bound(rule: Rule, limit: float, at_least: bool, outcome: str) -> None:
    decision = decide(criterion(limit, rule, at_least=at_least), 1.0, normal(1.0, 0.1), 50)
    assert decision["outcome"] == outcome
    below = stats.norm.cdf(math.log(limit), 0.0, 0.1)  # roughly: the curve is on the logarithm
    assert decision["conformity_probability"] == pytest.approx(1 - below if at_least else below, abs=0.02)
    assert (decision["margin"] >= 0.0) == (outcome == "pass")
    assert (decision["poses_to_decide"] is not None) == (outcome == "inconclusive")


CURVE = normal(1.0, 0.1)
BOUND = CURVE.bound(0.95)
NO_INTERVAL = "the result has no interval for position.rms, which rule: bound needs"
TOO_SURE = "the result's interval does not reach 99 %; compute the result again at 99 % confidence"
GUARDED = "the value meets the limit but lies within the guard band"


@pytest.mark.parametrize(
    ("condition", "value", "curve", "outcome", "why"),
    [
        # A bound decides as the interval does at the limit itself.
        (criterion(BOUND), 1.0, CURVE, "pass", None),
        (criterion(np.nextafter(BOUND, 0.0)), 1.0, CURVE, "inconclusive", None),
        (criterion(1.0), 0.1, None, "not_evaluated", NO_INTERVAL),
        (criterion(1.0, "simple"), 0.1, None, "pass", None),
        (criterion(2.0, confidence=0.99), 1.0, CURVE, "inconclusive", TOO_SURE),
        (criterion(1.05, "guard_band"), 1.0, CURVE, "fail", GUARDED),
        (criterion(0.9, "guard_band"), 1.0, CURVE, "fail", None),
        # Nothing fails with a value within the limit nor passes with one beyond: bounds of a percentile by a fitted
        # Gaussian may leave out the percentile found.
        (criterion(1.05), 1.0, normal(1.2, 0.05), "inconclusive", None),
        (criterion(0.95), 1.0, normal(0.8, 0.05), "inconclusive", None),
    ],
)
def test_rules_at_their_borders(
    condition: GateCriterion, value: float, curve: BoundCurve | None, outcome: str, why: str | None
) -> None:
    decision = decide(condition, value, curve, 50)
    assert (decision["outcome"], decision["why"]) == (outcome, why)


def test_operating_curves_are_those_of_a_gaussian_figure() -> None:
    """A figure far from zero, where its logarithm is as good as linear: P(pass) by hand."""
    for rule, shift in (("bound", 1.645), ("simple", 0.0), ("guard_band", 1.645), ("guarded_rejection", -1.645)):
        decision = decide(criterion(100.0, rule), 100.0, normal(100.0, 0.1), 50)  # type: ignore[arg-type]
        for truth, passes in decision["operating_curve"]:
            assert passes == pytest.approx(stats.norm.cdf((100.0 - truth) / 0.1 - shift), abs=2e-3)
        assert len(decision["operating_curve"]) == 21


def test_difference_of_two_samples_is_the_gaussian_one() -> None:
    curve = difference_curve(3.0, normal(3.0, 0.03), 1.0, normal(1.0, 0.04))
    for level in (0.05, 0.5, 0.9, 0.95):
        assert curve.bound(level) == pytest.approx(2.0 + 0.05 * stats.norm.ppf(level), abs=0.003)
    assert difference_curve(1.0, normal(1.0, 0.1), 1.0, BoundCurve((), (), "none", "one pose")).why == "one pose"


@pytest.mark.parametrize(
    ("value", "n", "rule", "share", "outcome"),
    [
        (0.9, 59, "bound", 0.95, "pass"),  # 1 - 0.95^59 = 0.9515, the published sample size
        (0.9, 58, "bound", 0.95, "inconclusive"),
        (0.9, 299, "bound", 0.99, "pass"),
        (0.9, 298, "bound", 0.99, "inconclusive"),
        (1.1, 1000, "bound", 0.95, "fail"),
        (0.9, 58, "guard_band", 0.95, "fail"),
        (0.9, 2, "guarded_rejection", 0.95, "pass"),
    ],
)
def test_the_largest_error_by_wilks(value: float, n: int, rule: Rule, share: float, outcome: str) -> None:
    found = decide_largest(criterion(1.0, rule, share=share, key="position.max"), value, n)
    assert found["outcome"] == outcome
    if n == 59:
        assert dict(found["operating_curve"])[0.95] == pytest.approx(0.95**59)
    if outcome == "inconclusive" and n == 58:
        assert (found["poses_to_decide"], found["conformity_probability"]) == (59, pytest.approx(1 - 0.95**58))
        assert found["why"] == (
            "58 poses within the limit show that 95 % of all poses are within the limit "
            "with a confidence of only 94.9 %"
        )


def undecided(rng: np.random.Generator, n: int) -> tuple[Array, float, Evaluation]:
    """Errors of n poses and a limit that they cannot decide."""
    while True:
        limit = RMS * math.exp(rng.uniform(-0.25, 0.25) * math.sqrt(30 / n))
        errors = SD * rng.normal(size=(3, n))
        decision = decide(criterion(limit), *rms_curve(errors), n)
        if decision["outcome"] == "inconclusive":
            return errors, limit, decision


@pytest.mark.parametrize(("n", "cases"), some_fast([(30, 40), (30, 150), (120, 150)], 3))
def test_the_promised_poses_decide_in_nine_of_ten_cases(n: int, cases: int) -> None:
    rng = np.random.default_rng(n)
    decided = []
    for _ in range(cases):
        errors, limit, decision = undecided(rng, n)
        all_errors = np.hstack((errors, SD * rng.normal(size=(3, decision["poses_to_decide"] - n))))
        decided.append(
            decide(criterion(limit), *rms_curve(all_errors), all_errors.shape[1])["outcome"] != "inconclusive"
        )
    # Three standard deviations of a share of 0.9 in 150 are 0.073.
    assert np.mean(decided) > ASSURANCE - 0.073


def test_poses_for_a_p95_are_never_fewer_than_order_statistics_need() -> None:
    decision = decide(criterion(1.3, key="position.p95"), 1.0, normal(1.0, 0.19), 12)
    assert decision["outcome"] == "inconclusive"
    assert decision["poses_to_decide_if_value_is_true"] >= 59


@pytest.mark.slow
@pytest.mark.parametrize("statistic", ["rms", "mean_error", "p95"])
def test_conformity_probabilities_are_calibrated(statistic: Any) -> None:
    """Where the truth is the limit, the probability of conformity is uniform: below a in a share a of the cases."""
    rng = np.random.default_rng(7)
    lengths = np.sqrt(np.sum((SD * rng.normal(size=(3, 1_000_000))) ** 2, axis=0))
    truth = {"rms": RMS, "mean_error": np.mean(lengths), "p95": np.quantile(lengths, 0.95)}[statistic]
    for n in (30, 100):
        probabilities, outcomes = [], []
        for seed in range(300):
            errors = SD * rng.normal(size=(3, n))
            intervals = length_intervals(errors, (0.9, 0.95), bootstrap=500, seed=seed)
            curve = BoundCurve.through([by_name[statistic] for by_name in intervals])
            probabilities.append(curve.below(float(truth)))
            outcomes.append(decide(criterion(float(truth)), 1.0, curve, n)["outcome"])
        for level in (0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95):
            share = np.mean(np.array(probabilities, dtype=float) <= level)
            assert share == pytest.approx(level, abs=3.5 * math.sqrt(level * (1 - level) / 300) + 0.01)
        # False accepts and false rejects of rule bound at the limit itself: 5 % each.
        assert np.mean(np.array(outcomes) == "pass") < 0.05 + 0.045
        assert np.mean(np.array(outcomes) == "fail") < 0.05 + 0.045


def evaluation(outcome: str = "pass", name: str = "c", reason: str = "because", **more: Any) -> Evaluation:
    condition = {"limit": 1e-3, "at_least": False, "rule": "bound", "baseline": None, "kind": "length", "accepted": ()}
    condition |= {"key": "position.rms", "confidence": 0.95, "share": 0.95, "paired": None}
    found = {"lower_bound": 0.7e-3, "upper_bound": 0.9e-3, "margin": 1e-4, "conformity_probability": 0.991}
    found |= {"value": 0.8e-3, "n_poses": 50, **{key: more[key] for key in more if key not in condition}}
    criterion = GateCriterion(
        name=name, reason=reason, **condition | {key: more[key] for key in more if key in condition}
    )
    if "baseline_value" in found:
        found["baseline"] = {"file": criterion.baseline, "value": found.pop("baseline_value")}
    return evaluated(criterion, outcome=outcome, **found)


def stored(*arguments: Any, **more: Any) -> dict[str, Any]:
    """A criterion as in the JSON document."""
    found: dict[str, Any] = gate(evaluation(*arguments, **more))["criteria"][0]
    return found


def gate(*evaluations: Evaluation, name: str = "g") -> dict[str, Any]:
    """The outcome of a gate as in the JSON document."""
    return significant_document(GATE_RESULT.write(GateOutcome(Gate(name, ()), evaluations)))


ALL = gate(
    evaluation("pass", "first"),
    evaluation("fail", "second", upper_bound=1.2e-3, margin=-2e-4, conformity_probability=0.0001),
    evaluation("inconclusive", "third", poses_to_decide=900, poses_to_decide_if_value_is_true=400),
    evaluation("not_evaluated", "fourth", value=None, why="there is none", margin=None, conformity_probability=None),
)
AGAINST = {"baseline": "b.json", "baseline_value": 9e-4}
NO_BOUNDS = {"lower_bound": None, "upper_bound": None, "margin": None}


@pytest.mark.parametrize(
    ("criterion", "text"),
    [
        (
            ALL["criteria"][0],
            "^position.rms 0.800 mm (0.700 mm to 0.900 mm, each bound at 95 % confidence), expected at most 1 mm; "
            "margin 0.100 mm; conforms with probability 99.1 %$",
        ),
        (
            ALL["criteria"][2],
            "; 900 poses in total would decide it with a probability of 90 %, 400 if the measured value is the true "
            "one$",
        ),
        (
            stored("inconclusive", key="iso9283.RP.max", poses_to_decide=900),
            "; 900 visits in total would decide it with a probability of 90 %$",
        ),
        (ALL["criteria"][3], "position.rms missing"),
        (
            stored(limit=0.0, value=-1e-4, lower_bound=-2e-4, upper_bound=0.0, **AGAINST),
            "^position.rms 0.800 mm, 0.100 mm less than the 0.900 mm in b.json (-0.200 mm to 0 mm for the difference, "
            "each bound at 95 % confidence), expected no more than in b.json",
        ),
        (stored(value=0.0, **AGAINST), "0.900 mm, same as the 0.900 mm in b.json"),
        (stored("inconclusive"), "the value is too close to the limit for any number of poses to decide$"),
        (stored("inconclusive", why="5 poses: too few", **NO_BOUNDS), "; 5 poses: too few$"),
    ],
)
def test_a_criterion_in_one_sentence(criterion: dict[str, Any], text: str) -> None:
    # ^ and $ are the ends of the sentence.
    assert text in f"^{words_of(criterion)['sentence']}$"


def test_without_bounds_nothing_is_said_of_how_close_the_value_lies() -> None:
    assert "too close" not in words_of(stored("inconclusive", n_poses=None))["sentence"]


@pytest.mark.parametrize(
    ("condition", "text"),
    [
        ({"limit": 1e-3}, "at most 1 mm"),
        ({"limit": 2.5e-4, "at_least": True}, "at least 0.25 mm"),
        ({"limit": 0.0, "baseline": "b"}, "no more than in b"),
        ({"limit": 0.0, "baseline": "b", "at_least": True}, "no less than in b"),
        ({"limit": 5e-5, "baseline": "b"}, "at most 0.05 mm more than in b"),
        ({"limit": -5e-5, "baseline": "b"}, "at least 0.05 mm less than in b"),
        ({"limit": -5e-5, "baseline": "b", "at_least": True}, "at most 0.05 mm less than in b"),
        ({"limit": 5e-5, "baseline": "b", "at_least": True}, "at least 0.05 mm more than in b"),
        ({"kind": "grade", "accepted": ("C",)}, "C or better"),
        ({"kind": "word", "accepted": ("clean", "explained")}, "clean or explained"),
    ],
)
def test_limits_in_words(condition: dict[str, Any], text: str) -> None:
    assert words_of(stored(**condition))["limit"] == text


def test_probabilities_are_no_certainty() -> None:
    chances = (1.0, 0.9995, 0.5, 0.0005, 0.0, None)
    told = ["> 99.9 %", "> 99.9 %", "50.0 %", "< 0.1 %", "< 0.1 %", "–"]
    assert [words_of(stored(conformity_probability=chance))["conforms"] for chance in chances] == told
    assert title(ALL) == "Gate g: FAIL (1 pass, 1 fail, 1 inconclusive, 1 not evaluated)"


def test_markdown_holds_the_gate_the_warnings_and_the_whole_result() -> None:
    text = markdown("estimate", "Error of 60 poses\n\n``` in it\n", ALL, ("a | b",))
    assert text.startswith(f"## robacc estimate\n\n### ❌ {title(ALL)}\n")
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {9}
    assert rows[2].startswith("| ✅ | first | position.rms | 0.800 mm | at most 1 mm |")
    whole = "````text\nError of 60 poses\n\n``` in it\n````"
    assert missing(text, "> **Warning:** a \\| b\n", whole, "<details>") == []
    assert markdown("estimate", "Error\n", None, ()) == "## robacc estimate\n\n```text\nError\n```\n"
    odd = markdown("check", "", gate(evaluation(name="a|b <x> *c* `d` [e]")), ())
    assert "| a\\|b \\<x\\> \\*c\\* \\`d\\` \\[e\\] |" in odd


def test_annotations_are_one_line_each_and_say_what_was_meant() -> None:
    odd = gate(evaluation("fail", "50 %: a, b", "first\r\nsecond :: %0A"), name="g::h")
    lines = github_annotations("estimate", "", odd, ("look\nout",)).splitlines()
    assert [line.partition(" ")[0] for line in lines] == ["::warning", "::error", "::error"]
    # What the runner of GitHub Actions shows (actions/runner, ActionCommand.cs).
    shown = re.fullmatch(r"::error title=([^:,]*)::(.*)", lines[1]).groups()
    for code, sign in (("%3A", ":"), ("%2C", ","), ("%0A", "\n"), ("%0D", "\r"), ("%25", "%")):
        shown = [part.replace(code, sign) for part in shown]
    assert shown[0] == "g::h: 50 %: a, b"
    assert shown[1].endswith("Reason for the limit: first\r\nsecond :: %0A")
    assert lines[0] == "::warning title=robacc estimate::look%0Aout"
    levels = [line.partition(" ")[0] for line in github_annotations("check", "", ALL, ()).splitlines()]
    assert levels == ["::notice", "::error", "::warning", "::warning", "::error"]
    first = github_annotations("estimate", "Error of 60\nof poses.csv\n\nmore\n", None, ())
    assert first == "::notice title=robacc estimate::Error of 60%0Aof poses.csv\n"


# The rules of the two schemas in use. Ant's: https://github.com/windyroad/JUnit-Schema/blob/master/JUnit.xsd;
# Jenkins': https://github.com/jenkinsci/xunit-plugin, junit-10.xsd. For each element: the attributes that must be
# there, those that may, and its children in order, each with the least and the most of them.
NUMBER, TIME = r"\d+", r"\d+(\.\d+)?"
ATTRIBUTES: dict[str, tuple[dict[str, str], dict[str, str]]] = {
    "testsuites": ({}, {}),
    "testsuite": (
        {
            **{"name": r"\S.*", "timestamp": r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", "hostname": r"\S+", "tests": NUMBER},
            **{"failures": NUMBER, "errors": NUMBER, "time": TIME, "package": r"\S*", "id": NUMBER},
        },
        {"skipped": NUMBER},
    ),
    "properties": ({}, {}),
    "testcase": ({"name": r"\S.*", "classname": r"\S.*", "time": TIME}, {}),
    "failure": ({"type": r"\S.*"}, {"message": r".*"}),
    "error": ({"type": r"\S.*"}, {"message": r".*"}),
    "system-out": ({}, {}),
    "system-err": ({}, {}),
}
MANY = 10**9
CHILDREN: dict[str, list[tuple[tuple[str, ...], int, int]]] = {
    "testsuites": [(("testsuite",), 0, MANY)],
    "testsuite": [(("properties",), 1, 1), (("testcase",), 0, MANY), (("system-out",), 1, 1), (("system-err",), 1, 1)],
    "testcase": [(("skipped", "error", "failure"), 0, 1)],
    "properties": [(("property",), 0, MANY)],
}
WITH_TEXT = {"failure", "error", "system-out", "system-err"}


def faults(element: ElementTree.Element) -> list[str]:
    """What the schemas do not allow in an element and those within it."""
    if element.tag not in ATTRIBUTES:
        return [f"element {element.tag}"]
    must, may = ATTRIBUTES[element.tag]
    found = [f"{element.tag} without {name}" for name in must if name not in element.attrib]
    for name, value in element.attrib.items():
        form = must.get(name) or may.get(name)
        if form is None or not re.fullmatch(form, value, re.DOTALL):
            found.append(f"{element.tag} {name}={value!r}")
    if element.tag not in WITH_TEXT and (element.text or "").strip():
        found.append(f"text in {element.tag}")
    rest = [child.tag for child in element]
    for names, least, most in CHILDREN.get(element.tag, []):
        count = 0
        while rest and rest[0] in names and count < most:
            rest.pop(0)
            count += 1
        if count < least:
            found.append(f"{element.tag} without {names[0]}")
    if rest:
        found.append(f"{rest[0]} in {element.tag}")
    return found + [fault for child in element for fault in faults(child)]


def junit(outcome: dict[str, Any], started: float = 0.0, seconds: float = 0.0) -> str:
    return suites("estimate", [FileOutcome(outcome["name"], 0, gate=outcome, seconds=seconds)], started)


@pytest.mark.parametrize(
    "outcome", [ALL, gate(evaluation()), gate(evaluation("fail", "<&>\"'", "]]> \x07 \ud800"), name="ä\x00")]
)
def test_junit_is_valid_by_the_schemas_in_use(outcome: dict[str, Any]) -> None:
    text, outcomes = junit(outcome), [criterion["outcome"] for criterion in outcome["criteria"]]
    root = ElementTree.fromstring(text.encode())
    assert faults(root) == []
    (suite,) = root
    assert suite.get("tests") == str(len(outcome["criteria"]))
    assert len(suite.findall("testcase/failure")) == int(suite.get("failures", "")) == outcomes.count("fail")
    undecision = outcomes.count("inconclusive") + outcomes.count("not_evaluated")
    assert len(suite.findall("testcase/error")) == int(suite.get("errors", "")) == undecision
    assert text == junit(outcome)


def test_junit_carries_the_numbers_the_reason_and_the_time() -> None:
    (suite,) = ElementTree.fromstring(junit(ALL, started=86400.0 * 365, seconds=6.0).encode())
    assert (suite.get("timestamp"), suite.get("time")) == ("1971-01-01T00:00:00", "6.000")
    assert [case.get("time") for case in suite.findall("testcase")] == ["1.500"] * 4
    failure = suite.find("testcase[@name='second']/failure")
    assert failure.get("message").startswith("fail: position.rms 0.800 mm (0.700 mm to 1.20 mm")
    assert failure.text == "Reason for the limit: because"
    assert suite.find("testcase[@name='first']/*") is None
