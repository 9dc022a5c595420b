"""An evaluation by ISO 9283, and the five poses of a cube.

Accuracy and repeatability stand in separate tables: reading RP as AP is the commonest mistake with the standard.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from robacc.iso_9283.cube import Proposal
from robacc.render.text.layout import IN_DEGREES, IN_MM, Document, fixed, three_digits
from robacc.render.views.elements import (
    Block,
    Cell,
    Form,
    Grid,
    Listing,
    ReportHeadline,
    Section,
    Text,
    measured_cells,
    number,
    of_robot,
    percent,
    tile,
)
from robacc.robots.description import Robot

_MAX_ROWS = 12
"""Places in a table; the JSON result has all of them."""
_NAMES = {
    "AP": "pose accuracy",
    "vAP": "multi-directional variation",
    "AD": "distance accuracy",
    "E": "exchangeability of robots",
    "RP": "pose repeatability",
    "RD": "distance repeatability, ±",
    "dAP": "drift of pose accuracy",
    "dRP": "drift of pose repeatability",
    "shift": "shift of the barycentre",
}
_GROUPS = (
    ("Accuracy: distance between commanded and attained poses", ("AP", "vAP", "AD", "E")),
    ("Repeatability: scatter of the visits, whatever their distance from the command", ("RP", "RD")),
    ("Drift: change of accuracy and repeatability during the run", ("dAP", "dRP", "shift")),
)
_MORE = "criteria by pose, conditions, methods and limitations: `full`"
_STATUS = {"met": "met", "not_met": "NOT MET", "unknown": "unknown"}

Part = Mapping[str, Any]
"""A criterion, or its value at one place, of the document."""


def iso9283_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``iso9283``."""
    labels = {"AP": "accuracy, AP", "RP": "repeatability, RP", "vAP": "multi-directional, vAP"}
    criteria = {label: document["iso9283"][symbol] for symbol, label in labels.items()}
    tiles = [
        tile(label, part["max_m"], "m", part["intervals"]["max_m"], f"at {part['max_at']}")
        for label, part in criteria.items()
        if part["max_m"] is not None
    ]
    met = sum(condition["status"] == "met" for condition in document["protocol"])
    summary = (
        f"{document['n_commanded_poses']} commanded poses in {document['n_poses']} visits; each criterion is the "
        f"largest value over the poses. The data meet {met} of {len(document['protocol'])} conditions of the "
        "standard's protocol."
    )
    registration = "none" if not document["alignment"] else " and ".join(document["alignment"][0]["what"])
    facts = [("Files", ", ".join(document["files"])), ("Registration", registration)]
    return ReportHeadline(f"ISO 9283 pose criteria{of_robot(document)}", summary, tiles, (), facts)


def iso9283_view(document: Document, robot: str | None = None, form: Form = "page") -> Iterator[Section]:
    """Return all criteria by group, by pose and by pair of poses, the protocol, and the methods of the intervals.

    In short, one table of the criteria; ``robot`` is the file's name.
    """
    criteria = _criteria(document)
    if form != "page":
        yield _opening(document, robot)
    if form == "short":
        shown = [part for part in criteria.values() if part["max_m"] or part["symbol"] not in ("vAP", "E")]
        statuses = Counter(_STATUS[condition["status"]] for condition in document["protocol"]).items()
        counts = ", ".join(f"{n} {status}" for status, n in statuses)
        protocol = Text(f"conditions of the standard's protocol: {counts}")
        yield Section("", [*_summary(shown, document["confidence"]), protocol, Text(_MORE, is_note=True)])
        return
    rows = [
        [condition["condition"], condition["clause"], _STATUS[condition["status"]], condition["why"]]
        for condition in document["protocol"]
    ]
    table = Grid(("condition", "clause", "status", "reason"), rows, is_text=True)
    for title, symbols in _GROUPS:
        yield Section(title, _summary([criteria[symbol] for symbol in symbols], document["confidence"]))
    yield from _places(criteria, percent(document["confidence"]), len(document["files"]) > 1)
    yield Section("Conditions of the standard's protocol", [table])
    yield Section("Confidence intervals", [Listing(_methods(criteria))])
    yield Section("Limitations", [Listing(document["notes"] if form != "page" else ())])


def _opening(document: Document, robot: str | None) -> Section:
    source = "the model " + (robot or "") if document["commanded"] == "robot" else "cmd_ columns"
    facts = [
        f"{', '.join(document['files'])}: {_counted(document)}",
        "no commanded poses" if document["commanded"] is None else f"commanded poses from {source}",
        "not registered",
    ]
    if document["alignment"]:
        first = document["alignment"][0]
        facts[2] = f"registered: {' and '.join(first['what'])} fitted, {first['n_parameters']} parameters"
    if document["unaligned"] is not None:
        unaligned = ", ".join(three_digits(float(value) * IN_MM) for value in document["unaligned"]["AP_max_m"])
        facts.append(f"largest AP before registration: {unaligned} mm")
    return Section("Pose criteria of ISO 9283:1998", [Text(fact, wraps=False) for fact in facts])


def _criteria(document: Document) -> dict[str, Part]:
    """Return the criteria by symbol."""
    entries = document["iso9283"].values()
    parts = (part for entry in entries for part in ([entry] if "symbol" in entry else entry.values()))
    return {part["symbol"]: part for part in parts}


def _counted(document: Document) -> str:
    files = Counter(pose["file"] for pose in document["visits"])
    several = len(document["files"]) > 1
    counts = sorted({pose["n"] for pose in document["visits"]})
    visits = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    each = f"{visits} visit{'s' * (counts != [1])}{' of each' * (len(document['visits']) > 1)}"
    numbers = " and ".join(map(str, dict.fromkeys(files.values())))
    return f"{numbers} commanded pose{'s' * (set(files.values()) != {1})}{', robot by robot' * several}, {each}"


def _summary(criteria: Sequence[Part], confidence: float) -> Iterator[Block]:
    """Yield the largest value of each criterion, then the missing criteria with the reasons."""
    rows: list[Sequence[Cell]] = []
    reasons: dict[str, list[str]] = {}
    for part in criteria:
        symbol, turn = part["symbol"], part["orientation"]
        name = _NAMES[symbol]
        if part["max_m"] is None:
            named = name.removesuffix(", ±")
            reasons.setdefault(part["why"] or "", []).append(named if symbol == "shift" else f"{symbol} ({named})")
        else:
            cells = measured_cells(part["max_m"], IN_MM, part["intervals"]["max_m"])
            label = f"{'' if symbol == 'shift' else symbol:<4}{name}"
            rows.append((label, _clause(part), cells[0], "mm", cells[1], part["max_at"] or ""))
        if turn["max_rad"] is not None:
            cells = measured_cells(turn["max_rad"], IN_DEGREES, turn["intervals"]["max_rad"])
            rows.append(("      of orientation", _clause(part), cells[0], "°", cells[1], turn["max_at"] or ""))
    yield Grid(("largest over poses", "clause", "", "", percent(confidence), "at"), rows)
    missing = [f"no {', no '.join(names)}: {why}" for why, names in reasons.items()]
    notes = dict.fromkeys(note for part in criteria for note in part["notes"])
    yield Listing([*missing, *notes])


def _clause(part: Part) -> str:
    return str(part["clause"]).removeprefix("ISO 9283:1998, ")


def _places(criteria: Mapping[str, Part], interval_head: str, several: bool) -> Iterator[Section]:
    """Yield a table for each criterion by pose or by pair of poses, with the file if there are several."""

    def angles(title: str, part: Part) -> Iterator[Section]:
        if any(place["abc_rad"] is not None for place in part["poses"]):
            yield from _table(title, part, several, ("a", "b", "c"), lambda place: _parts(place, "abc_rad", IN_DEGREES))

    accuracy, repeatability = criteria["AP"], criteria["RP"]
    yield from _table(
        "Pose accuracy AP by pose, mm",
        accuracy,
        several,
        ("visits", "AP_p", interval_head, "x", "y", "z"),
        lambda place: [str(place["n"]), *_value(place), *_parts(place, "xyz_m", IN_MM)],
    )
    yield from angles("Pose accuracy AP of orientation by pose, °", accuracy)
    yield from _table(
        "Pose repeatability RP by pose, mm (not accuracy)",
        repeatability,
        several,
        ("visits", "RP_l", interval_head, "mean l", "S_l"),
        lambda place: [
            str(place["n"]),
            *_value(place),
            *(
                number(place.get(f"{key}_distance_m"), IN_MM, place["intervals"]["position_m"])
                for key in ("mean", "sd")
            ),
        ],
    )
    yield from angles("Pose repeatability RP of orientation by pose, ± ° (not accuracy)", repeatability)
    for symbol, title in (
        ("vAP", "Multi-directional variation vAP by pose, mm"),
        ("E", "Exchangeability E by pose, mm"),
    ):
        yield from _table(
            title,
            criteria[symbol],
            several and symbol == "vAP",
            ("visits", symbol, interval_head, "between"),
            lambda place: [str(place["n"]), *_value(place), place.get("between") or ""],
        )
    for symbol, title in (
        ("AD", "Distance accuracy AD by pair of poses, mm"),
        ("RD", "Distance repeatability RD by pair of poses, ± mm (not accuracy)"),
    ):
        yield from _table(
            title,
            criteria[symbol],
            several,
            ("visits", f"{symbol}_p", interval_head, "x", "y", "z"),
            lambda place: [str(place["n"]), *_value(place), *_parts(place, "xyz_m", IN_MM)],
        )


def _table(
    title: str, part: Part, several: bool, header: Sequence[str], cells: Callable[[Part], Sequence[Cell]]
) -> Iterator[Section]:
    """Yield one row per place, the largest first if there are too many; nothing without a place."""
    places = list(part["poses"])
    if len(places) > _MAX_ROWS:
        title += f" (the {_MAX_ROWS} largest of {len(places)})"
        places = sorted(places, key=lambda place: -abs(place["position_m"] or 0.0))[:_MAX_ROWS]
    if places:
        rows = [[place["pose"], *([place["file"] or ""] if several else []), *cells(place)] for place in places]
        yield Section(title, [Grid(("", *(["file"] if several else []), *header), rows)])


def _value(place: Part) -> Sequence[Cell]:
    return measured_cells(place["position_m"], IN_MM, place["intervals"]["position_m"])


def _parts(place: Part, key: str, factor: float) -> list[Cell]:
    """Return the components of a place, with the digits that their intervals support."""
    pairs = zip(place[key] or (), place["intervals"][key] or (), strict=True)
    return [number(value, factor, bounds) for value, bounds in pairs]


def _methods(criteria: Mapping[str, Part]) -> list[str]:
    """Return the method of each criterion's interval."""
    methods: dict[str, list[str]] = {}
    intervals = [(part["symbol"], part["intervals"]["max_m"]) for part in criteria.values()]
    for symbol, bounds in intervals:
        if criteria[symbol]["max_m"] is not None:
            methods.setdefault(bounds["why"] or bounds["method"].partition("; largest")[0], []).append(symbol)
    texts = [f"{', '.join(symbols)}: {method}" for method, symbols in methods.items()]
    if any("; largest" in bounds["method"] for _, bounds in intervals):
        texts.append(
            "largest over poses: its upper limit is the greatest upper limit, its lower limit is corrected for the "
            "number of poses"
        )
    texts.append(
        "visits are taken as independent Gaussian draws; no interval includes the instrument's systematic error"
    )
    return texts


# The cube of ISO 9283 and its five poses, as comments of their CSV and as a table.


def proposal_comments(proposal: Proposal, robot: str) -> list[str]:
    """Return the comment lines above the columns: cube, plane and tool orientation."""
    return [
        f"Test poses of ISO 9283:1998, 6.8, for {robot}: planned poses, not measured.",
        *_facts(proposal),
        *proposal.notes,
    ]


def proposal_view(proposal: Proposal, robot: Robot) -> Iterator[Section]:
    """Return the cube, the commanded poses in the measuring frame and the joints, in mm and degrees."""
    yield Section(f"Test poses of ISO 9283:1998 for {robot.name}", [Listing(_facts(proposal))])
    units = ["°" if joint.type == "revolute" else "mm" for joint in robot.variables]
    places = proposal.poses.translation.T * IN_MM
    rows = [(f"P{i}", *(fixed(float(value), 2) for value in place)) for i, place in enumerate(places, 1)]
    names = [f"{name}, {unit}" for name, unit in zip(robot.variable_names, units, strict=True)]
    factors = [IN_DEGREES if unit == "°" else IN_MM for unit in units]
    joints = [
        (f"P{i}", *(fixed(float(value) * factor, 3) for value, factor in zip(q, factors, strict=True)))
        for i, q in enumerate(proposal.q.T, 1)
    ]
    yield Section("", [Grid(("commanded, mm", "x", "y", "z"), rows), Grid(("joints", *names), joints)])
    yield Section("Limitations", [Listing(proposal.notes)])


def _facts(proposal: Proposal) -> list[str]:
    x, y, z = (float(value) * IN_MM for value in proposal.centre)
    edge = proposal.edge * IN_MM
    return [
        f"cube with an edge of {edge:g} mm and its centre P1 at x {x:.0f}, y {y:.0f}, z {z:.0f} mm in the base frame",
        f"P2 to P5 at 10 % of the diagonal from the corners, in the plane inclined at 45° towards {proposal.plane}",
        f"{proposal.orientation_text}; every joint keeps at least {100.0 * proposal.margin:.0f} % of its range to "
        "each limit",
    ]
