"""Gate files: their content, and every mistake in them at its line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from robacc.errors import InputError
from robacc.gates import KEYS, is_known, load_gate

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


def problems(text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_gate(text, "g.yaml")
    return [str(problem) for problem in caught.value.problems]


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
    messages = problems(f"{HEAD}  - {{reason: r, {entry}}}\n")
    assert any(message in text for text in messages), messages
    assert all(text.startswith("g.yaml:4, criteria[0]") for text in messages)


def test_a_reason_may_have_several_lines() -> None:
    text = f"{HEAD}  - key: position.rms\n    limit: 1 mm\n    reason: >\n      one\n      two\n"
    assert load_gate(text, "g.yaml").criteria[0].reason == "one two"


RMS = "  - {key: position.rms, limit: 1 mm, reason: r}\n"


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
        (HEAD + RMS * 2, "5, criteria[1].name: two criteria have the name 'position.rms'"),
    ],
)
def test_what_is_no_gate(text: str, problem: str) -> None:
    assert problems(text) == [f"g.yaml:{problem}"]


def test_every_problem_of_the_file_at_once() -> None:
    messages = problems(
        "robacc_gate: 2\nnam: g\ncriteria:\n  - {key: position.rms, limit: 1 cm, reason: r}\n"
        "  - {key: x, limit: 1 mm, reason: r}\n"
    )
    assert [text.partition(":")[2].partition(",")[0] for text in messages] == ["1", "1", "2", "4", "5"]
    assert "expected 1, found '2'" in messages[0]


def test_keys_of_the_contract_are_known() -> None:
    assert {"position.p95", "orientation.max", "grade", "after.held_out.position.rms", "gain", "verdict"} <= KEYS.keys()
    assert [is_known(key) for key in ("iso9283.RP.max", "iso9283.", "iso9283")] == [True, False, False]
