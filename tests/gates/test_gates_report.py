"""What a gate says in a terminal, a job's summary, annotations and JUnit XML."""

import io
import re
from typing import Any
from xml.etree import ElementTree

import pytest
from commands import missing

from robacc.documents.envelope import GATE_RESULT, significant_document
from robacc.gates import Evaluation, Gate, GateCriterion, GateOutcome, evaluated
from robacc.outcomes import FileOutcome
from robacc.render.text import draw
from robacc.render.views.compare import (
    gate_view,
    github_annotations,
    junit as suites,
    markdown,
    title,
    words_of,
)


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


def test_a_terminal_shows_each_criterion_within_80_columns() -> None:
    stream = io.StringIO()
    draw(gate_view(ALL), stream)
    lines = stream.getvalue().splitlines()
    rows = ["pass           first", "fail           second", "inconclusive   third", "not evaluated  fourth"]
    assert [line for line in lines if re.match(r"\S", line)] == [title(ALL), *rows]
    assert lines.count("               Reason: because") == 4
    assert max(map(len, lines)) <= 80


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
    root = ElementTree.fromstring(junit(ALL, started=86400.0 * 365, seconds=6.0).encode())
    assert faults(root) == []
    (suite,) = root
    assert (suite.get("timestamp"), suite.get("time")) == ("1971-01-01T00:00:00", "6.000")
    assert [case.get("time") for case in suite.findall("testcase")] == ["1.500"] * 4
    failure = suite.find("testcase[@name='second']/failure")
    assert failure.get("message").startswith("fail: position.rms 0.800 mm (0.700 mm to 1.20 mm")
    assert failure.text == "Reason for the limit: because"
    assert suite.find("testcase[@name='first']/*") is None
