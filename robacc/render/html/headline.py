"""The first screen of a result: title, outcome, key figures, and a summary in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from robacc.render.plots.errors import STAGE_LABELS
from robacc.render.text.layout import Document, confirmation
from robacc.render.views.elements import (
    Badge,
    Number,
    ReportHeadline,
    Tile,
    angle,
    length,
    of_robot,
    robot_name,
    tile,
)
from robacc.render.views.fit import next_step
from robacc.render.views.plan import PURPOSES

_QUANTITIES = ("position", "orientation")

# Headlines of the results of ``estimate``, ``predict`` and ``iso9283``.


def estimate_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``estimate``."""
    position, grade = document["position"], document["grade"]
    confirmed = confirmation(grade["demonstrated"], grade["confidence"])
    alignment = document["alignment"]
    registration = "none"
    if alignment is not None:
        registration = f"{' and '.join(alignment['what'])}, {alignment['n_parameters']} parameters"
    why = grade["reason"].split(". ")
    robot = document.get("robot") or {}
    modelled = robot.get("effects") or robot.get("fitted_to")
    reference = "the model's predictions" if modelled else "the commanded positions"
    summary = (
        f"The measured positions differ from {reference} by {length(position['rms_m'])} rms over {document['n_poses']} "
        f"poses; 95 % of the poses are within {length(position['p95_m'])}. This is grade {grade['grade']}, {confirmed}."
    )
    return ReportHeadline(
        f"Accuracy{of_robot(document)}",
        summary,
        _estimate_tiles(document),
        (Badge(f"grade {grade['grade']}, {confirmed}", "good" if grade["demonstrated"] else "open"),),
        [
            ("Why", "; ".join(why[:1] if grade["demonstrated"] else [why[0], *why[1:][-1:]])),
            ("Next", _next(document)),
            ("Registration", registration),
            ("Grade", f"{grade['grade']} on the scale {grade['scale']}"),
            ("Frame", "axes of the commanded target" if document["frame"] == "tool" else "axes of the measuring frame"),
        ],
    )


def _next(document: Document) -> str:
    """Return what to do after an estimate, a trace or a calibration."""
    if document["command"] != "estimate":
        return next_step(document).replace("`robacc correct`", "robacc correct")
    files = {record["kind"]: record["name"] for record in document["inputs"]}
    if "robot" not in files:
        return "state the robot with `robot`: robacc trace then finds the causes of the error"
    return f"robacc trace {files.get('poses', 'POSES')} --robot {files['robot']} finds the causes of the error"


def _estimate_tiles(document: Document) -> list[Tile]:
    shown = [("position", "rms", "rms", "m"), ("position", "95th percentile", "p95", "m")]
    if document["orientation"] is not None:
        shown.append(("orientation", "95th percentile", "p95", "rad"))
    tiles = []
    for name, label, key, unit in shown:
        value, bounds = (part[f"{key}_{unit}"] for part in (document[name], document[name]["intervals"]))
        why = "" if bounds["upper"] is not None else bounds["why"] or "no interval"
        tiles.append(tile(f"{name}, {label}", value, unit, bounds, why))
    return tiles


def predict_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``predict``."""
    position, grade = document["position"], document["grade"]
    first = document["budget"][0] if document["budget"] else None
    source = "The tolerances give" if document["tolerances"]["parameters"] else "The fit of the model gives"
    summary = (
        f"{source} an expected position error of {length(position['rms_m'])} rms over robots and poses, "
        f"95 % of the errors within {length(position['p95_m'])}: grade {grade['grade']}."
    )
    if first is not None:
        summary += (
            f" The largest share of the variance, {100 * first['share_position']:.0f} %, is from {first['parameter']}."
        )
    worst = position["worst"]
    tiles = [
        Tile("position, rms", length(position["rms_m"]), "over robots and poses"),
        Tile("position, 95th percentile", length(position["p95_m"]), "over robots and poses"),
        Tile("worst pose, rms", length(worst["rms_m"]), f"at {worst['label']}"),
    ]
    facts = [
        ("Configurations", document["configurations"]),
        ("Grade", f"{grade['grade']}, expected, on the scale {grade['scale']}"),
    ]
    if document["against"] is not None:
        facts.append(("Compared with measured poses", str(document["against"]["verdict"]).replace("_", " ")))
    if (coverage := document["coverage"]) is not None:
        shares = [f"{name} {100 * coverage[name]['share']:.1f} %" for name in _QUANTITIES if coverage[name] is not None]
        facts.append(("Measured poses within their 95 % bound", ", ".join(shares)))
    badge = Badge(f"grade {grade['grade']}, expected", "plain")
    return ReportHeadline(f"Predicted accuracy{of_robot(document)}", summary, tiles, (badge,), facts)


def iso9283_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``iso9283``."""
    criteria = document["iso9283"]
    names = (("AP", "accuracy, AP"), ("RP", "repeatability, RP"), ("vAP", "multi-directional, vAP"))
    tiles = []
    for key, label in names:
        criterion = criteria[key]
        if criterion["max_m"] is not None:
            bounds, place = criterion["intervals"]["max_m"], f"at {criterion['max_at']}"
            tiles.append(tile(label, criterion["max_m"], "m", bounds, place))
    met = sum(condition["status"] == "met" for condition in document["protocol"])
    summary = (
        f"{document['n_commanded_poses']} commanded poses in {document['n_poses']} visits; each criterion is the "
        f"largest value over the poses. The data meet {met} of {len(document['protocol'])} conditions of the "
        "standard's protocol."
    )
    registration = "none" if not document["alignment"] else " and ".join(document["alignment"][0]["what"])
    facts = [("Files", ", ".join(document["files"])), ("Registration", registration)]
    return ReportHeadline(f"ISO 9283 pose criteria{of_robot(document)}", summary, tiles, (), facts)


# Headlines of the results of ``trace`` and ``calibrate``.

VERDICTS = {
    "clean": ("clean", "good"),
    "explained": ("explained", "good"),
    "partly_explained": ("partly explained", "open"),
    "unexplained": ("unexplained", "bad"),
}
_UNSTRUCTURED = "the remaining error has no structure"
"""The text does not say noise: the size of the noise may be unknown."""


def trace_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``trace``."""
    label, tone = VERDICTS[document["verdict"]]
    declared = document["options"].get("declared") or "none"
    unexplained = document["unexplained"]
    facts = [("Declared effects", declared.replace(",", ", ")), ("Measurement noise", _noise(document))]
    if unexplained["structured"]:
        facts.append(("Remaining error", f"{length(unexplained['rms_m'])}, structured"))
    facts.append(("Next", _next(document)))
    return ReportHeadline(
        f"Trace{of_robot(document)}: {label}", _trace_summary(document), _tiles(document), (Badge(label, tone),), facts
    )


def _trace_summary(document: Document) -> str:
    before, after, pose_set = _sides(document)
    structured = document["unexplained"]["structured"]
    start = f"With the declared effects fitted, the model predicts the measured poses to {length(before['rms_m'])} rms"
    arm = _arm_itself(document)
    names = [
        f"{finding['effect'].replace('_', ' ')}{' on ' * bool(finding['joints'])}{', '.join(finding['joints'])}"
        for finding in document["findings"]
    ]
    if not names:
        end = "the remaining error is structured, but no effect of the catalogue explains it"
        return f"{start} ({pose_set}). No effect was found; {end if structured else _UNSTRUCTURED}. {arm}"
    causes = f"cause is {names[0]}" if len(names) == 1 else f"causes are {', '.join(names[:-1])} and {names[-1]}"
    end = "the remaining error has a structure that no candidate explains" if structured else _UNSTRUCTURED
    return (
        f"{start} ({pose_set}). The identified {causes}. With {'it' if len(names) == 1 else 'them'} added, the model "
        f"predicts the measured poses to {length(after['rms_m'])} rms; {end}. {arm}"
    )


def _arm_itself(document: Document) -> str:
    """Return the error of the arm: a model changes no arm until it is used."""
    key = "fitted" if document["nominal"]["held_out"] is None else "held_out"
    rms = length(document["nominal"][key]["position"]["rms_m"])
    return (
        f"The arm itself keeps its error of {rms} rms, base and tool registered, until its controller uses the model."
    )


def calibrate_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``calibrate``."""
    before, after, pose_set = _sides(document)
    summary = (
        f"With {document['options'].get('fit', '').replace(',', ', ')} fitted, the model predicts the measured poses "
        f"to {length(after['rms_m'])} rms ({pose_set}); with only base and tool fitted, to {length(before['rms_m'])}. "
        f"{_arm_itself(document)}"
    )
    effects = ", ".join(effect["effect"] for effect in document["effects"])
    facts = [("Next", _next(document)), ("Fitted effects", effects), ("Measurement noise", _noise(document))]
    return ReportHeadline(f"Calibration{of_robot(document)}", summary, _tiles(document), (), facts)


def _sides(document: Document) -> tuple[Mapping[str, Any], Mapping[str, Any], str]:
    """Return the position errors before and after, and the pose set."""
    key, pose_set = _pose_set(document)
    return document["before"][key]["position"], document["after"][key]["position"], pose_set


def _pose_set(document: Document) -> tuple[str, str]:
    """Return the key of the pose set that the headline shows, and its name."""
    is_fitted = document["after"]["held_out"] is None
    return ("fitted", "calibration poses") if is_fitted else ("held_out", "held-out poses")


def _tiles(document: Document) -> list[Tile]:
    """Return the error before, with the baseline and after; without findings, the baseline is the last."""
    key, pose_set = _pose_set(document)
    is_clean = document.get("findings") == []
    tiles = []
    for stage, label in [*STAGE_LABELS[document["command"]].items()][: 2 if is_clean else 3]:
        metrics = (document[stage][key] or document[stage]["fitted"])["position"]
        bounds = (metrics.get("intervals") or {}).get("rms_m") or {}
        tiles.append(tile(f"{label}, rms", metrics["rms_m"], "m", bounds, pose_set))
    if (gain := document["gain_m"]) is not None and not is_clean:
        bounds = {"lower": gain["low"], "upper": gain["high"], "confidence": gain["confidence"]}
        tiles.append(tile("rms reduction", gain["value"], "m", bounds))
    return tiles


def _noise(document: Document) -> str:
    noise = document["noise"]
    source = {"file": "the file's sigma columns", "repeats": "repeated poses", "residual": "the remaining error"}
    return f"{length(noise['position_m'])} along each axis, from {source.get(noise['source'], noise['source'])}"


_GATES = {
    "pass": ("gate passed", "good"),
    "fail": ("gate failed", "bad"),
    "inconclusive": ("gate inconclusive", "open"),
    "not_evaluated": ("gate not evaluated", "open"),
}


def headline_of(document: Document) -> ReportHeadline:
    """Return the headline of a result of any command."""
    headline = ReportHeadline(f"Result of robacc {document['command']}{of_robot(document)}", "", (), (), ())
    if (make := _HEADLINES.get(document["command"])) is not None:
        headline = make(document)
    gate = document.get("gate")
    badges = [*headline.badges, *([Badge(*_GATES[gate["outcome"]])] if gate else [])]
    # What a reader asks first: why, and what now.
    facts = sorted([*_facts(document), *headline.facts], key=lambda fact: fact[0] not in ("Why", "Next"))
    return ReportHeadline(headline.title, headline.summary, headline.tiles, badges, facts)


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


def _plan(document: Document) -> ReportHeadline:
    """Return the number of poses and visits, the predicted error, and whether earlier poses are enough."""
    accuracy, sufficiency = document["accuracy"], document["sufficiency"]
    planned = None if accuracy is None else accuracy["planned"]
    n, visits = document["n_poses"], document["n_visits"]
    summary = f"{n} poses in {visits} visits, chosen from {document['candidates']['feasible']} feasible poses."
    tiles = [Tile("different poses", Number(str(n), float(n))), Tile("visits", Number(str(visits), float(visits)))]
    if planned is not None:
        tiles.append(Tile("predicted error after the fit, rms", length(planned["rms_m"])))
        tiles.append(Tile("the same of random poses", length(planned["random_rms_m"])))
    power = document["power"]
    if power is not None:
        for label, key in (("effects found at their usual size", "found"), ("found and separated", "separated")):
            chance = f"random poses {100 * power[f'random_{key}']:.0f} %"
            tiles.append(Tile(label, Number(f"{100 * power[key]:.0f} %", power[key]), chance))
    badges = []
    if sufficiency is not None:
        summary += f" After {sufficiency['n_already']} poses: {sufficiency['why']}."
        badges.append(Badge("enough poses", "good") if sufficiency["enough"] else Badge("more poses needed", "open"))
    return ReportHeadline(
        f"Plan for the {PURPOSES[document['purpose']]}{of_robot(document)}",
        summary,
        tiles,
        badges,
        _plan_facts(document),
    )


def _plan_facts(document: Document) -> list[tuple[str, str]]:
    noise = document["noise"]
    facts = [
        ("Instrument", f"{length(noise['position_m'])} along each axis"),
        ("Repeatability", f"{length(noise['repeatability_m'])} along each axis at the target"),
        ("Source of the noise", str(noise["source"])),
    ]
    if document["fit"]:
        facts.append(("Free effects", ", ".join(document["fit"].split(","))))
    return facts


_HEADLINES: dict[str, Callable[[Document], ReportHeadline]] = {
    "trace": trace_headline,
    "calibrate": calibrate_headline,
    "estimate": estimate_headline,
    "predict": predict_headline,
    "iso9283": iso9283_headline,
    "check": _check,
    "compare": _compare,
    "correct": _correct,
    "plan": _plan,
}
