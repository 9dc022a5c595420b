"""Gate files: what they say, and every mistake in them at its line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from robacc.errors import InputError
from robacc.gates.criteria import GateCriterion
from robacc.gates.gate_file import load_gate
from robacc.gates.keys import KEYS, is_known

EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "configs" / "gates").glob("*.yaml"))
HEAD = "robacc_gate: 1\nname: g\ncriteria:\n"


def one(text: str) -> GateCriterion:
    """The only criterion of a gate, written on one line in braces."""
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
    found = one("key: position.p95, limit: 0.2 mm, reason: r")
    assert (found.name, found.limit, found.rule, found.confidence, found.at_least) == (
        "position.p95",
        pytest.approx(2e-4),
        "bound",
        0.95,
        False,
    )
    assert one("key: orientation.max, limit: 0.1 deg, reason: r").limit == pytest.approx(math.pi / 1800)
    assert one("key: n_poses, at_least: 30, reason: r").rule == "simple"
    gain = one("key: gain, at_least: -5 um, reason: r, confidence: 0.9")
    assert (gain.limit, gain.at_least, gain.confidence) == (pytest.approx(-5e-6), True, 0.9)
    guard = one("key: position.rms, limit: 1mm, rule: guard_band, false_accept_risk: 0.02, reason: r")
    assert guard.confidence == pytest.approx(0.98)
    regression = one("key: position.rms, baseline: b.json, reason: r")
    assert (regression.rule, regression.limit, regression.at_least) == ("guarded_rejection", 0.0, False)
    assert one("key: gain, baseline: b.json, reason: r").at_least
    assert one("key: verdict, limit: [clean, explained], reason: r").words == ("clean", "explained")
    assert one("key: grade, limit: C, reason: r").words == ("C",)
    assert one("key: grade.demonstrated, limit: true, reason: r").words == ("true",)
    assert one("key: iso9283.drift.AP.max, limit: 0.1 mm, reason: r").kind == "length"
    assert one("key: iso9283.AP.orientation.max, limit: 0.1 deg, reason: r").kind == "angle"


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
        ("key: positon.p95, limit: 1 mm", "key: no result has a key 'positon.p95'; did you mean position.p95"),
        ("key: position.mean, limit: 1 mm", "did you mean position.mean_error"),
        ("key: colour, limit: 1 mm", "no result has a key 'colour'; for example position.p95"),
        ("limit: 1 mm", "criteria[0].key: is missing"),
        ("key: position.rms", "limit: is missing: the most allowed; or at_least, the least"),
        ("key: position.rms, limit: 1 mm, at_least: 2 mm", "limit (the most allowed) and at_least both stand here"),
        ("key: position.rms, limit: 1", "expected a number with its unit (m, mm, um), found '1'; as in 0.2 mm"),
        ("key: position.rms, limit: 1 deg", "expected a number with its unit (m, mm, um), found '1 deg'"),
        ("key: orientation.rms, limit: 1 mm", "expected a number with its unit (rad, mrad, urad, deg), found '1 mm'"),
        ("key: n_poses, at_least: 30 mm", "expected a bare number, found '30 mm'"),
        ("key: iso9283.RP.max, limit: 2 cm", "expected a number with its unit (m, mm, um, rad, mrad, urad, deg)"),
        ("key: position.rms, limit: -1 mm", "position.rms is never negative, so nothing could meet '-1 mm'"),
        ("key: position.rms, limit: [1, 2]", "limit: expected a name, found a list of 2"),
        ("key: verdict, at_least: clean", "expected here: the words that pass, as a list"),
        ("key: verdict, limit: []", "the list of words that pass is empty"),
        ("key: verdict, limit: clean, rule: bound", "a word has no uncertainty, so only rule: simple fits it"),
        ("key: verdict, limit: clean, baseline: b.json", "a comparison is of numbers, and this key's value is a word"),
        ("key: grade, limit: [A, B]", "expected one grade, which better ones meet too, found a list"),
        ("key: grade", "expected here: the grade to be met"),
        ("key: grade, limit: A, confidence: 0.9", "the grade's scale states the confidence that demonstrates it"),
        ("key: grade, limit: A, rule: guarded_rejection", "a grade is judged by rule: bound"),
        ("key: position.rms, limit: 1 mm, rule: bond", "expected bound or simple or guard_band or guarded_rejection"),
        (
            "key: position.rms, limit: 1 mm, rule: guard_band",
            "false_accept_risk: is missing: the risk of a false accept",
        ),
        ("key: position.rms, limit: 1 mm, rule: simple, confidence: 0.9", "confidence: does not go with rule: simple"),
        ("key: position.rms, limit: 1 mm, false_reject_risk: 0.1", "it goes with rule: guarded_rejection"),
        ("key: position.rms, limit: 1 mm, confidence: 95", "found 95, expected a number between 0.5 and 1"),
        (
            "key: position.rms, limit: 1 mm, rule: guard_band, false_accept_risk: 0.7",
            "found 0.7, expected a number between 0 and 0.5",
        ),
        ("key: position.rms, limit: 1 mm, share: 0.9", "share: is the share of all poses within the limit"),
        ("key: position.rms, limit: 1 mm, paired: true", "paired: is about the poses of a baseline, and there is none"),
        ("key: position.rms, baseline: b.json, paired: maybe", "paired: expected true or false, found 'maybe'"),
        ("key: position.rms, limit: 1 mm, limt: 2 mm", "limt: unknown key; did you mean 'limit'?"),
    ],
)
def test_each_mistake_is_named(entry: str, message: str) -> None:
    found = problems(f"{HEAD}  - {{reason: r, {entry}}}\n")
    assert any(message in text for text in found), found
    assert all(text.startswith("g.yaml:4, criteria[0]") for text in found)


def test_a_reason_is_needed_and_may_have_several_lines() -> None:
    assert problems(f"{HEAD}  - {{key: position.rms, limit: 1 mm}}\n") == ["g.yaml:4, criteria[0].reason: is missing"]
    text = f"{HEAD}  - key: position.rms\n    limit: 1 mm\n    reason: >\n      one\n      two\n"
    assert load_gate(text, "g.yaml").criteria[0].reason == "one two"
    listed = problems(f"{HEAD}  - {{key: position.rms, limit: 1 mm, reason: [a]}}\n")
    assert listed == ["g.yaml:4, criteria[0].reason: expected text: why the limit is what it is"]


def test_every_problem_of_the_file_at_once() -> None:
    found = problems(
        "robacc_gate: 2\nnam: g\ncriteria:\n  - {key: position.rms, limit: 1 cm, reason: r}\n"
        "  - {key: x, limit: 1 mm, reason: r}\n"
    )
    assert [text.partition(":")[2].partition(",")[0] for text in found] == ["1", "1", "2", "4", "5"]
    assert "expected 1, found '2'" in found[0]


def test_what_is_no_gate() -> None:
    assert problems("- a\n") == [
        "g.yaml:1: expected keys with values (robacc_gate, name, confidence, criteria), found a list of 1"
    ]
    assert problems("robacc_gate: 1\nname: g\ncriteria: []\n") == [
        "g.yaml:3, criteria: a gate without a criterion would let everything pass"
    ]
    twice = HEAD + "  - {key: position.rms, limit: 1 mm, reason: r}\n" * 2
    assert problems(twice) == ["g.yaml:5, criteria[1].name: the name 'position.rms' stands here twice"]


def test_keys_of_the_contract_are_known() -> None:
    assert {"position.p95", "orientation.max", "grade", "after.held_out.position.rms", "gain", "verdict"} <= KEYS.keys()
    assert is_known("iso9283.RP.max")
    assert not is_known("iso9283.")
    assert not is_known("iso9283")
