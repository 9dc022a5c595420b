"""Gate files: their content, and every mistake in them at its line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from robacc.errors import InputError
from robacc.gates.gate_file import KEYS, GateCriterion, is_known, load_gate

EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "configs" / "gates").glob("*.yaml"))
HEAD = "robacc_gate: 1\nname: g\ncriteria:\n"


def read_criterion(text: str) -> GateCriterion:
    """Return the only criterion of a gate, written on one line in braces."""
    (criterion,) = load_gate(f"{HEAD}  - {{{text}}}\n", "g.yaml").criteria
    return criterion


def problems(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_gate(text, "g.yaml")
    return [str(problem) for problem in caught.value.problems]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_gates_whose_every_criterion_has_a_reason(path: Path) -> None:
    gate = load_gate(path.read_text(encoding="utf-8"), path.name)
    assert gate.name.replace(" ", "_") == path.stem
    assert all(len(criterion.reason) > 20 and "\n" not in criterion.reason for criterion in gate.criteria)


def test_there_is_an_example_for_each_use() -> None:
    assert {path.stem for path in EXAMPLES} >= {"assembly", "machine_tending", "machining", "regression"}


def test_limits_become_si_and_rules_have_their_defaults() -> None:
    criterion = read_criterion("key: position.p95, limit: 0.2 mm, reason: r")
    assert (criterion.name, criterion.limit, criterion.rule, criterion.confidence, criterion.at_least) == (
        "position.p95",
        pytest.approx(2e-4),
        "bound",
        0.95,
        False,
    )
    assert read_criterion("key: orientation.max, limit: 0.1 deg, reason: r").limit == pytest.approx(math.pi / 1800)
    assert read_criterion("key: n_poses, at_least: 30, reason: r").rule == "simple"
    gain = read_criterion("key: gain, at_least: -5 um, reason: r, confidence: 0.9")
    assert (gain.limit, gain.at_least, gain.confidence) == (pytest.approx(-5e-6), True, 0.9)
    guard = read_criterion("key: position.rms, limit: 1mm, rule: guard_band, false_accept_risk: 0.02, reason: r")
    assert guard.confidence == pytest.approx(0.98)
    regression = read_criterion("key: position.rms, baseline: b.json, reason: r")
    assert (regression.rule, regression.limit, regression.at_least) == ("guarded_rejection", 0.0, False)
    assert read_criterion("key: gain, baseline: b.json, reason: r").at_least
    assert read_criterion("key: verdict, limit: [clean, explained], reason: r").accepted == ("clean", "explained")
    assert read_criterion("key: grade, limit: C, reason: r").accepted == ("C",)
    assert read_criterion("key: grade.demonstrated, limit: true, reason: r").accepted == ("true",)
    assert read_criterion("key: iso9283.drift.AP.max, limit: 0.1 mm, reason: r").kind == "length"
    assert read_criterion("key: iso9283.AP.orientation.max, limit: 0.1 deg, reason: r").kind == "angle"


def test_a_gates_own_confidence_holds_where_a_criterion_states_none() -> None:
    text = (
        "robacc_gate: 1\nname: g\nconfidence: 0.99\ncriteria:\n"
        "  - {key: position.rms, limit: 1 mm, reason: r}\n"
        "  - {key: position.p95, limit: 1 mm, confidence: 0.9, reason: r}\n"
    )
    assert [criterion.confidence for criterion in load_gate(text, "g.yaml").criteria] == [0.99, 0.9]


def test_baselines_are_listed_once() -> None:
    text = HEAD + "".join(
        f"  - {{key: position.{name}, baseline: {file}, reason: r}}\n"
        for name, file in (("rms", "a.json"), ("p95", "a.json"), ("max", "b.json"))
    )
    assert load_gate(text, "g.yaml").baselines == ("a.json", "b.json")


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
    messages = problems(f"{HEAD}  - {{reason: r, {entry}}}\n")
    assert any(message in text for text in messages), messages
    assert all(text.startswith("g.yaml:4, criteria[0]") for text in messages)


def test_a_reason_is_needed_and_may_have_several_lines() -> None:
    assert problems(f"{HEAD}  - {{key: position.rms, limit: 1 mm}}\n") == ["g.yaml:4, criteria[0].reason: is missing"]
    text = f"{HEAD}  - key: position.rms\n    limit: 1 mm\n    reason: >\n      one\n      two\n"
    assert load_gate(text, "g.yaml").criteria[0].reason == "one two"
    messages = problems(f"{HEAD}  - {{key: position.rms, limit: 1 mm, reason: [a]}}\n")
    assert messages == ["g.yaml:4, criteria[0].reason: expected text: the reason for the limit"]


def test_every_problem_of_the_file_at_once() -> None:
    messages = problems(
        "robacc_gate: 2\nnam: g\ncriteria:\n  - {key: position.rms, limit: 1 cm, reason: r}\n"
        "  - {key: x, limit: 1 mm, reason: r}\n"
    )
    assert [text.partition(":")[2].partition(",")[0] for text in messages] == ["1", "1", "2", "4", "5"]
    assert "expected 1, found '2'" in messages[0]


def test_what_is_no_gate() -> None:
    assert problems("- a\n") == [
        "g.yaml:1: expected keys with values (robacc_gate, name, confidence, criteria), found a list of 1"
    ]
    assert problems("robacc_gate: 1\nname: g\ncriteria: []\n") == [
        "g.yaml:3, criteria: the list is empty; a gate needs at least one criterion"
    ]
    twice = HEAD + "  - {key: position.rms, limit: 1 mm, reason: r}\n" * 2
    assert problems(twice) == ["g.yaml:5, criteria[1].name: two criteria have the name 'position.rms'"]


def test_keys_of_the_contract_are_known() -> None:
    assert {"position.p95", "orientation.max", "grade", "after.held_out.position.rms", "gain", "verdict"} <= KEYS.keys()
    assert is_known("iso9283.RP.max")
    assert not is_known("iso9283.")
    assert not is_known("iso9283")
