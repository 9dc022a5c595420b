"""The view of a result of any command: its headline, and the sections of its page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from robacc.render.text.layout import Document
from robacc.render.views.compare import comparison_headline, comparison_view
from robacc.render.views.correct import correction_headline, correction_view
from robacc.render.views.elements import ReportHeadline, Section, of_robot, shown
from robacc.render.views.estimate import estimate_headline, estimate_view
from robacc.render.views.fit import calibrate_headline, calibration_view, trace_headline, trace_view
from robacc.render.views.gate import LOOKS, check_headline, passed
from robacc.render.views.iso9283 import iso9283_headline, iso9283_view
from robacc.render.views.plan import plan_headline, plan_view
from robacc.render.views.predict import predict_headline, prediction_view

_VIEWS: dict[str, tuple[Callable[[Document], ReportHeadline], Callable[[Document], Iterator[Section]]]] = {
    "trace": (trace_headline, trace_view),
    "calibrate": (calibrate_headline, calibration_view),
    "estimate": (estimate_headline, estimate_view),
    "predict": (predict_headline, prediction_view),
    "iso9283": (iso9283_headline, iso9283_view),
    "check": (check_headline, lambda document: iter(())),
    "compare": (comparison_headline, comparison_view),
    "correct": (correction_headline, correction_view),
    "plan": (plan_headline, plan_view),
}


def sections_of(document: Document) -> list[Section]:
    """Return the sections of the page of a result; an unknown command has none."""
    _, sections = _VIEWS.get(document["command"], _VIEWS["check"])
    return [*shown(sections(document))]


def headline_of(document: Document) -> ReportHeadline:
    """Return the headline of a result of any command, with its robot, data and gate."""
    headline = ReportHeadline(f"Result of robacc {document['command']}{of_robot(document)}", "", ())
    if document["command"] in _VIEWS:
        headline = _VIEWS[document["command"]][0](document)
    badges, facts = [*headline.badges], [*_facts(document)]
    if gate := document.get("gate"):
        look = LOOKS[gate["outcome"]]
        badges.append((f"gate {look.gate}", look.tone))
        facts.append(("Gate", f"{gate['name']}: {passed(gate)} passed"))
    # What a reader asks first: why, and what now.
    facts = sorted([*facts, *headline.facts], key=lambda fact: fact[0] not in ("Why", "Next"))
    return replace(headline, badges=badges, facts=facts)


def _facts(document: Document) -> Iterator[tuple[str, str]]:
    inputs, robot = document["inputs"], document.get("robot")
    if robot is not None:
        joints = ", ".join(joint["name"] for joint in robot["joints"])
        yield "Robot", f"{robot['name']} (joints {joints})" if joints else robot["name"]
    else:
        yield from (("Robot", record["name"]) for record in inputs if record["kind"] == "robot")
    files = [record["name"] for record in inputs if record["kind"] in ("poses", "holdout", "against", "already")]
    # The poses of a plan are not measured yet.
    count = None if document["command"] == "plan" else document.get("n_poses")
    if files or count is not None:
        poses = f"{count:,} poses" if isinstance(count, int) else ""
        yield "Data", " from ".join(part for part in (poses, " and ".join(files)) if part)
