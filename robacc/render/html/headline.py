"""The first screen of a result: title, outcome, key figures, and a summary in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from robacc.render.html.accuracy_headlines import estimate_headline, iso9283_headline, predict_headline
from robacc.render.html.blocks import Badge, ReportHeadline, Tile, angle, length
from robacc.render.html.fit_headlines import calibrate_headline, trace_headline
from robacc.render.html.plan_sections import plan_headline
from robacc.render.html.robot_title import of_robot, robot_name
from robacc.render.plots.chart import Document

_GATES = {
    "pass": ("gate passed", "good"),
    "fail": ("gate failed", "bad"),
    "inconclusive": ("gate inconclusive", "open"),
    "not_evaluated": ("gate not evaluated", "open"),
}


def headline_of(document: Document) -> ReportHeadline:
    """Return the headline of a result of any command."""
    make = _HEADLINES.get(document["command"], _any)
    headline = make(document)
    badges = [*headline.badges, *_gate_badge(document)]
    return ReportHeadline(
        headline.title, headline.summary, headline.tiles, badges, [*_facts(document), *headline.facts]
    )


def _gate_badge(document: Document) -> Sequence[Badge]:
    gate = document.get("gate")
    return () if not gate else (Badge(*_GATES.get(gate["outcome"], (str(gate["outcome"]), "open"))),)


def _facts(document: Document) -> list[tuple[str, str]]:
    facts = []
    name = robot_name(document)
    if name is not None:
        joints = ", ".join(joint["name"] for joint in document["robot"]["joints"])
        facts.append(("Robot", f"{name} (joints {joints})" if joints else name))
    else:
        facts += [("Robot", record["name"]) for record in document["inputs"] if record["kind"] == "robot"]
    files = [
        record["name"] for record in document["inputs"] if record["kind"] in ("poses", "holdout", "against", "already")
    ]
    # The poses of a plan are not measured yet.
    count = None if document["command"] == "plan" else document.get("n_poses")
    if files or count is not None:
        poses = f"{count:,} poses" if isinstance(count, int) else ""
        facts.append(("Data", " from ".join(part for part in (poses, " and ".join(files)) if part)))
    gate = document.get("gate")
    if gate:
        met = sum(criterion["outcome"] == "pass" for criterion in gate["criteria"])
        facts.append(("Gate", f"{gate['name']}: {met} of {len(gate['criteria'])} criteria passed"))
    return facts


def _check(document: Document) -> ReportHeadline:
    gate, checked = document["gate"], document["result"]
    met = sum(criterion["outcome"] == "pass" for criterion in gate["criteria"])
    summary = (
        f"The result of robacc {checked['command']} passes {met} of {len(gate['criteria'])} criteria of the gate "
        f"{gate['name']}."
    )
    return ReportHeadline(f"Check against {gate['name']}", summary, (), (), ())


def _compare(document: Document) -> ReportHeadline:
    names, ranking = [result["name"] for result in document["results"]], document["ranking"]
    summary = "" if ranking is None else f"By {ranking['by']}: {'; '.join(ranking['text'])}."
    tiles = []
    if ranking is not None and ranking["unit"] in ("m", "rad"):
        show = length if ranking["unit"] == "m" else angle
        tiles = [
            Tile(result["name"], show(result["value"]), f"group {result['letters']}") for result in ranking["order"][:3]
        ]
    facts = [("Results", ", ".join(names)), ("Baseline", str(document["baseline"] or "none"))]
    return ReportHeadline(f"Comparison of {len(names)} results", summary, tiles, (), facts)


def _any(document: Document) -> ReportHeadline:
    command = document["command"]
    return ReportHeadline(f"Result of robacc {command}{of_robot(document)}", "", (), (), ())


def _correct(document: Document) -> ReportHeadline:
    before, after = (document["expected"][stage]["position"] or {} for stage in ("before", "after"))
    rms = [part.get("expected_rms_m") for part in (before, after)]
    count = f"{document['n_corrected']} of {document['n_targets']} targets"
    summary = (
        f"{count} have a corrected command. The position error to expect falls from {length(rms[0])} to "
        f"{length(rms[1])} rms."
    )
    tiles = [
        Tile("expected error before, rms", length(rms[0])),
        Tile("expected error after, rms", length(rms[1])),
        Tile("95 % bound after, largest", length(after.get("largest_bound95_m"))),
    ]
    tone = "good" if not document["n_refused"] else "open"
    return ReportHeadline(f"Correction by {document['model']}", summary, tiles, (Badge(f"{count} corrected", tone),))


_HEADLINES: dict[str, Callable[[Document], ReportHeadline]] = {
    "trace": trace_headline,
    "calibrate": calibrate_headline,
    "estimate": estimate_headline,
    "predict": predict_headline,
    "iso9283": iso9283_headline,
    "check": _check,
    "compare": _compare,
    "correct": _correct,
    "plan": plan_headline,
}
