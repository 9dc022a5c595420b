"""Gate files with every mistake at its line, and a gate's outcome on a result: keys, baselines, grades, warnings."""

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import problems_of

from robacc.accuracy.error_statistics import error_statistics
from robacc.accuracy.grade import default_scale, grade
from robacc.comparison.stored_results import NoValueError, errors_behind, value_at
from robacc.documents.accuracy import GRADE
from robacc.documents.envelope import GATE_RESULT
from robacc.documents.keys import STATISTICS
from robacc.gates import KEYS, Evaluation, GateOutcome, evaluate_gate, figure_at, is_known, load_gate
from robacc.io.json_text import json_text

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


def test_keys_of_the_contract_are_known() -> None:
    assert {"position.p95", "orientation.max", "grade", "after.held_out.position.rms", "gain", "verdict"} <= KEYS.keys()
    assert [is_known(key) for key in ("iso9283.RP.max", "iso9283.", "iso9283")] == [True, False, False]


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
    for key in ("position.rms", "position.p95", "orientation.max", "position.radius95.zero_mean.radius"):
        name = {"position": "m", "orientation": "rad"}[key.partition(".")[0]]
        match = figure_at(document, key, 0.95)
        node: Any = document
        for part in f"{key}_{name}".split("."):
            node = node[part]
        assert match.value == node
        assert match.dimension == {"m": "length", "rad": "angle"}[name]


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


def test_probability_of_a_gain_at_its_value_is_a_half() -> None:
    gain = evaluate("key: gain, at_least: 1 mm", stage(errors(size=1e-4)))
    assert gain["conformity_probability"] == pytest.approx(0.5)


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


def test_the_largest_error_takes_59_poses() -> None:
    large = evaluate("key: position.max, limit: 10 mm", estimate())
    assert (large["outcome"], large["share"]) == ("pass", 0.95)
    assert large["conformity_probability"] == pytest.approx(1 - 0.95**N)
    few = evaluate("key: position.max, limit: 10 mm", estimate(errors(n=58)))
    assert (few["outcome"], few["poses_to_decide"]) == ("inconclusive", 59)
    assert evaluate("key: position.max, limit: 10 mm, share: 0.98", estimate())["outcome"] == "inconclusive"
    assert evaluate("key: position.max, limit: 0.5 mm", estimate())["outcome"] == "fail"


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
    at_limit = curve[np.argmin(np.abs(curve[:, 0] - 1.5e-3)), 1]
    assert at_limit == pytest.approx(0.05, abs=1e-6)  # the false accepts that rule bound allows at the limit
