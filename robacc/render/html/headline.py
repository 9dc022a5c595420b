"""The first screen of a result: what it is of, its outcome, the numbers that matter, and its story in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Badge, ReportHeadline, Tile, angle, interval, length
from robacc.render.plots.chart import Document
from robacc.render.plots.units import DEGREE, length_unit

VERDICTS = {
    "clean": ("clean", "good"),
    "explained": ("explained", "good"),
    "partly_explained": ("partly explained", "open"),
    "unexplained": ("unexplained", "bad"),
}
_UNSTRUCTURED = "what is left has no structure"
"""Not that it is noise: how large that is may not be known."""
_GATES = {
    "pass": ("gate passed", "good"),
    "fail": ("gate failed", "bad"),
    "inconclusive": ("gate inconclusive", "open"),
    "not_evaluated": ("gate not evaluated", "open"),
}


def headline_of(document: Document) -> ReportHeadline:
    """Of any result."""
    make = _HEADLINES.get(document["command"], _any)
    found = make(document)
    badges = [*found.badges, *_gate_badge(document)]
    return ReportHeadline(found.title, found.story, found.tiles, badges, [*_facts(document), *found.facts])


def robot_name(document: Document) -> str | None:
    """What the robot file calls the robot; None without one."""
    robot = document.get("robot")
    return None if robot is None else str(robot["name"])


def _of_robot(document: Document) -> str:
    name = robot_name(document)
    return "" if name is None else f" of {name}"


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
    files = [record["name"] for record in document["inputs"] if record["kind"] in ("poses", "holdout", "against")]
    count = document.get("n_poses")
    if files or count is not None:
        poses = f"{count:,} poses" if isinstance(count, int) else ""
        facts.append(("Data", " from ".join(part for part in (poses, " and ".join(files)) if part)))
    gate = document.get("gate")
    if gate:
        met = sum(one["outcome"] == "pass" for one in gate["criteria"])
        facts.append(("Gate", f"{gate['name']}: {met} of {len(gate['criteria'])} criteria passed"))
    return facts


# -- trace and calibrate


def _trace(document: Document) -> ReportHeadline:
    words, tone = VERDICTS[document["verdict"]]
    declared = document["options"].get("declared") or "nothing"
    left = document["unexplained"]
    facts = [("Declared, fitted on both sides", declared.replace(",", ", ")), ("Noise", _noise(document))]
    if left["structured"]:
        facts.append(("Left", f"{length(left['rms_m'])} with structure in it"))
    return ReportHeadline(
        f"Trace{_of_robot(document)}: {words}", _trace_story(document), _tiles(document), (Badge(words, tone),), facts
    )


def _trace_story(document: Document) -> str:
    before, after, of = _sides(document)
    start = f"With what is declared the robot misses by {length(before['rms_m'])} (rms, {of})"
    names = [_effect(one) for one in document["findings"]]
    if not names:
        rest = f"{_UNSTRUCTURED}, and nothing was added"
        if document["unexplained"]["structured"]:
            rest = "there is structure in it, but no effect of the catalogue explains it"
        return f"{start}; {rest}."
    one = len(names) == 1
    told = f"the cause is {names[0]}" if one else f"the causes are {', '.join(names[:-1])} and {names[-1]}"
    end = "something is left that nothing explains" if document["unexplained"]["structured"] else _UNSTRUCTURED
    return f"{start}; {told}; with {'it' if one else 'them'} added it misses by {length(after['rms_m'])}, and {end}."


def _effect(finding: Mapping[str, Any]) -> str:
    where = f" on {', '.join(finding['joints'])}" if finding["joints"] else ""
    return f"{finding['effect'].replace('_', ' ')}{where}"


def _calibrate(document: Document) -> ReportHeadline:
    before, after, of = _sides(document)
    story = (
        f"With {document['options'].get('fit', '').replace(',', ', ')} fitted the robot misses by "
        f"{length(after['rms_m'])} (rms, {of}), and by {length(before['rms_m'])} without what is beyond base and tool."
    )
    facts = [("Fitted", ", ".join(one["effect"] for one in document["effects"])), ("Noise", _noise(document))]
    return ReportHeadline(f"Calibration{_of_robot(document)}", story, _tiles(document), (), facts)


def _sides(document: Document) -> tuple[Mapping[str, Any], Mapping[str, Any], str]:
    """Position figures before and after, and of which poses."""
    which = "fitted" if document["after"]["held_out"] is None else "held_out"
    words = "poses held out" if which == "held_out" else "poses fitted"
    return document["before"][which]["position"], document["after"][which]["position"], words


def _tiles(document: Document) -> list[Tile]:
    before, after, of = _sides(document)
    tiles = [_side(name, side, of) for name, side in (("before, rms", before), ("after, rms", after))]
    gain = document["gain_m"]
    if gain is not None:
        low, high = gain["low"], gain["high"]
        unit = length_unit(gain["value"])
        told = interval(gain["value"], low, high, gain["confidence"], unit)
        tiles.append(Tile("gain in rms", length(gain["value"], low, high), told))
    return tiles


def _side(name: str, side: Mapping[str, Any], of: str) -> Tile:
    """One side's figure with its interval over poses."""
    value, bounds = side["rms_m"], (side.get("intervals") or {}).get("rms_m") or {}
    low, high = bounds.get("lower"), bounds.get("upper")
    told = interval(value, low, high, bounds.get("confidence", 0.95), length_unit(value))
    return Tile(name, length(value, low, high), f"{told}; {of}" if told else of)


def _noise(document: Document) -> str:
    noise = document["noise"]
    source = {"file": "the file's sigma columns", "repeats": "repeated poses", "residual": "the final residual"}
    return f"{length(noise['position_m'])} along each axis, from {source.get(noise['source'], noise['source'])}"


# -- estimate


def _estimate(document: Document) -> ReportHeadline:
    position, grade = document["position"], document["grade"]
    proven = "demonstrated" if grade["demonstrated"] else "not demonstrated"
    alignment = document["alignment"]
    aligned = "nothing aligned"
    if alignment is not None:
        aligned = f"{' and '.join(alignment['what'])}, {alignment['n_parameters']} parameters"
    robot = document.get("robot") or {}
    modelled = robot.get("effects") or robot.get("fitted_to")
    misses = "The model misses where the arm came" if modelled else "The arm misses where it was sent"
    story = (
        f"{misses} by {length(position['rms_m'])} (rms over {document['n_poses']} poses), 95 % "
        f"of the poses within {length(position['p95_m'])}. That is grade {grade['grade']}, {proven}."
    )
    return ReportHeadline(
        f"Accuracy{_of_robot(document)}",
        story,
        _estimate_tiles(document),
        (Badge(f"grade {grade['grade']}, {proven}", "good" if grade["demonstrated"] else "open"),),
        [
            ("Aligned", aligned),
            ("Grade", f"{grade['grade']} on the scale {grade['scale']}"),
            ("Frame", "axes of the commanded target" if document["frame"] == "tool" else "axes of the measuring frame"),
        ],
    )


def _estimate_tiles(document: Document) -> list[Tile]:
    position, turned = document["position"], document["orientation"]
    tiles = [
        _statistic("position, rms", position, "rms_m", "m"),
        _statistic("position, 95th percentile", position, "p95_m", "m"),
    ]
    if turned is not None:
        tiles.append(_statistic("orientation, 95th percentile", turned, "p95_rad", "rad"))
    return tiles


def _statistic(label: str, part: Mapping[str, Any], key: str, unit: str) -> Tile:
    value, bounds = part[key], part["intervals"][key]
    low, high = bounds["lower"], bounds["upper"]
    number = length(value, low, high) if unit == "m" else angle(value, low, high)
    told = interval(value, low, high, bounds["confidence"], length_unit(value) if unit == "m" else DEGREE)
    return Tile(label, number, told or bounds.get("why") or "no interval")


# -- predict


def _predict(document: Document) -> ReportHeadline:
    position, grade = document["position"], document["grade"]
    first = document["budget"][0] if document["budget"] else None
    story = (
        f"From its tolerances the arm is expected to miss by {length(position['rms_m'])} (rms over robots and poses), "
        f"95 % within {length(position['p95_m'])}: grade {grade['grade']}."
    )
    if first is not None:
        story += f" The largest share, {100 * first['share_position']:.0f} %, is from {first['parameter']}."
    worst = position["worst"]
    tiles = [
        Tile("position, rms", length(position["rms_m"]), "over robots and poses"),
        Tile("position, 95th percentile", length(position["p95_m"]), "over robots and poses"),
        Tile("worst pose, rms", length(worst["rms_m"]), f"at {worst['label']}"),
    ]
    facts = [
        ("Where", document["configurations"]),
        ("Grade", f"{grade['grade']}, expected, on the scale {grade['scale']}"),
    ]
    if document["against"] is not None:
        facts.append(("Against measured poses", str(document["against"]["verdict"]).replace("_", " ")))
    badge = Badge(f"grade {grade['grade']}, expected", "plain")
    return ReportHeadline(f"Predicted accuracy{_of_robot(document)}", story, tiles, (badge,), facts)


# -- iso9283, check, compare


def _iso9283(document: Document) -> ReportHeadline:
    found = document["iso9283"]
    names = (("AP", "accuracy, AP"), ("RP", "repeatability, RP"), ("vAP", "multi-directional, vAP"))
    tiles = []
    for key, label in names:
        one = found[key]
        bounds = one["intervals"]["max_m"]
        value, low, high = one["max_m"], bounds["lower"], bounds["upper"]
        if value is None:
            continue
        told = interval(value, low, high, bounds["confidence"], length_unit(value))
        tiles.append(Tile(label, length(value, low, high), f"at {one['max_at']}{f'; {told}' if told else ''}"))
    met = sum(one["status"] == "met" for one in document["protocol"])
    story = (
        f"{document['n_commanded_poses']} commanded poses in {document['n_poses']} visits; of each criterion the "
        f"largest over the poses counts. The data meet {met} of {len(document['protocol'])} conditions of the "
        "standard's protocol."
    )
    aligned = "nothing aligned" if not document["alignment"] else " and ".join(document["alignment"][0]["what"])
    facts = [("Files", ", ".join(document["files"])), ("Aligned", aligned)]
    return ReportHeadline(f"ISO 9283 pose criteria{_of_robot(document)}", story, tiles, (), facts)


def _check(document: Document) -> ReportHeadline:
    gate, of = document["gate"], document["result"]
    met = sum(one["outcome"] == "pass" for one in gate["criteria"])
    story = (
        f"The result of robacc {of['command']} held against the gate {gate['name']}: {met} of "
        f"{len(gate['criteria'])} criteria passed."
    )
    return ReportHeadline(f"Check against {gate['name']}", story, (), (), ())


def _compare(document: Document) -> ReportHeadline:
    names, ranking = [one["name"] for one in document["results"]], document["ranking"]
    story = "" if ranking is None else f"By {ranking['by']}: {'; '.join(ranking['text'])}."
    tiles = []
    if ranking is not None and ranking["unit"] in ("m", "rad"):
        show = length if ranking["unit"] == "m" else angle
        tiles = [Tile(one["name"], show(one["value"]), f"group {one['letters']}") for one in ranking["order"][:3]]
    facts = [("Results", ", ".join(names)), ("Baseline", str(document["baseline"] or "none"))]
    return ReportHeadline(f"Comparison of {len(names)} results", story, tiles, (), facts)


# -- anything else


def _any(document: Document) -> ReportHeadline:
    command = document["command"]
    return ReportHeadline(f"Result of robacc {command}{_of_robot(document)}", "", (), (), ())


_HEADLINES: dict[str, Callable[[Document], ReportHeadline]] = {
    "trace": _trace,
    "calibrate": _calibrate,
    "estimate": _estimate,
    "predict": _predict,
    "iso9283": _iso9283,
    "check": _check,
    "compare": _compare,
}
