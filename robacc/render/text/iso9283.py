"""An evaluation by ISO 9283 as tables in mm and degrees, and the five poses of a cube.

The report keeps accuracy and repeatability in separate tables: reading RP as AP is the commonest mistake with the
standard.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TextIO

from robacc.iso_9283.cube import Proposal
from robacc.iso_9283.records import Characteristic, CriterionFigure, Iso9283Result, IsoCriterion, Symbol
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import (
    BLANK,
    IN_DEGREES,
    IN_MM,
    TextLine,
    columns,
    decimals,
    fixed,
    heading,
    items,
    three_digits,
)
from robacc.robots.description import Robot

# The tables of an ISO 9283 evaluation by pose and by pair of poses.

_MAX_ROWS = 12
"""Places in a table; the JSON result has all of them."""


def measured(figure: CriterionFigure, factor: float) -> tuple[str, str]:
    """Return the value and its interval with the decimals that the interval supports."""
    if figure.value is None:
        return "–", "–"
    lower, upper = (None if end is None else end * factor for end in _ends(figure))
    places = decimals(figure.value * factor, lower, upper)
    if lower is None or upper is None:
        return fixed(figure.value * factor, places), "–"
    return fixed(figure.value * factor, places), f"{fixed(lower, places)} … {fixed(upper, places)}"


def pose_tables(result: Iso9283Result) -> Iterator[TextLine]:
    """Return the tables by pose, one for each criterion."""
    percent = f"{100 * result.confidence:g} % interval"
    multiple_files = len(result.sources) > 1
    accuracy = result.characteristic("AP")
    yield from _table(
        "Pose accuracy AP by pose, mm",
        accuracy,
        multiple_files,
        ("visits", "AP_p", percent, "x", "y", "z"),
        lambda place: (str(place.n), *measured(place.position, IN_MM), *_parts(place.axes, IN_MM)),
    )
    yield from _angles("Pose accuracy AP of orientation by pose, °", accuracy, multiple_files)
    repeatability = result.characteristic("RP")
    yield from _table(
        "Pose repeatability RP by pose, mm (not accuracy)",
        repeatability,
        multiple_files,
        ("visits", "RP_l", percent, "mean l", "S_l"),
        lambda place: (str(place.n), *measured(place.position, IN_MM), *_distances(place)),
    )
    yield from _angles(
        "Pose repeatability RP of orientation by pose, ± ° (not accuracy)", repeatability, multiple_files
    )
    for symbol, title in (
        ("vAP", "Multi-directional variation vAP by pose, mm"),
        ("E", "Exchangeability E by pose, mm"),
    ):
        yield from _table(
            title,
            next(item for item in result.characteristics if item.symbol == symbol),
            multiple_files and symbol == "vAP",
            ("visits", symbol, percent, "between"),
            lambda place: (str(place.n), *measured(place.position, IN_MM), place.between or ""),
        )


def pair_tables(result: Iso9283Result) -> Iterator[TextLine]:
    """Return the tables of the distances between poses, accuracy and repeatability separately."""
    percent = f"{100 * result.confidence:g} % interval"
    multiple_files = len(result.sources) > 1
    for symbol, title in (
        ("AD", "Distance accuracy AD by pair of poses, mm"),
        ("RD", "Distance repeatability RD by pair of poses, ± mm (not accuracy)"),
    ):
        characteristic = next(
            characteristic for characteristic in result.characteristics if characteristic.symbol == symbol
        )
        yield from _table(
            title,
            characteristic,
            multiple_files,
            ("visits", f"{symbol}_p", percent, "x", "y", "z"),
            lambda place: (str(place.n), *measured(place.position, IN_MM), *_parts(place.axes, IN_MM)),
        )


def _table(
    title: str,
    characteristic: Characteristic,
    multiple_files: bool,
    header: Sequence[str],
    cells: Callable[[IsoCriterion[CriterionFigure]], Sequence[str]],
) -> Iterator[TextLine]:
    """Return one row per place, the largest first if there are too many."""
    if not characteristic.places:
        return
    places = list(characteristic.places)
    if len(places) > _MAX_ROWS:
        places = sorted(places, key=lambda place: -abs(place.position.value or 0.0))[:_MAX_ROWS]
        title += f" (the {_MAX_ROWS} largest of {len(characteristic.places)})"
    files = ["file"] if multiple_files else []
    rows = [
        ("–".join(place.poses), *([place.source or ""] if multiple_files else []), *cells(place)) for place in places
    ]
    yield from (BLANK, heading(title), *columns(("", *files, *header), rows))


def _angles(title: str, characteristic: Characteristic, multiple_files: bool) -> Iterator[TextLine]:
    """Return the table of the three angles, empty without orientations."""
    if all(place.angles is None for place in characteristic.places):
        return

    yield from _table(
        title, characteristic, multiple_files, ("a", "b", "c"), lambda place: _parts(place.angles, IN_DEGREES)
    )


def _parts(figures: Sequence[CriterionFigure] | None, factor: float) -> list[str]:
    """Return values with the decimals that the widest of their intervals supports."""
    if figures is None:
        return []
    places = min(
        decimals((figure.value or 0.0) * factor, *(end if end is None else end * factor for end in _ends(figure)))
        for figure in figures
    )
    return [fixed(None if figure.value is None else figure.value * factor, places) for figure in figures]


def _ends(figure: CriterionFigure) -> tuple[float | None, float | None]:
    return figure.interval.lower, figure.interval.upper


def _distances(place: IsoCriterion[CriterionFigure]) -> list[str]:
    """Return mean and standard deviation of the distances from the barycentre with the decimals of RP."""
    ends = (None if end is None else end * IN_MM for end in _ends(place.position))
    places = decimals((place.position.value or 0.0) * IN_MM, *ends)
    return [
        fixed(None if value is None else value * IN_MM, places) for value in (place.mean_distance, place.sd_distance)
    ]


_NAMES: dict[Symbol, str] = {
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
_GROUPS: tuple[tuple[str, tuple[Symbol, ...]], ...] = (
    ("Accuracy: distance between commanded and attained poses", ("AP", "vAP", "AD", "E")),
    ("Repeatability: scatter of the visits, whatever their distance from the command", ("RP", "RD")),
    ("Drift: change of accuracy and repeatability during the run", ("dAP", "dRP", "shift")),
)
_STATUS = {"met": "met", "not met": "NOT MET", "unknown": "unknown"}


def draw_iso9283(result: Iso9283Result, robot: str | None, stream: TextIO) -> None:
    """Write the report of ``robacc iso9283`` to ``stream``; ``robot`` is the file's name."""
    write_lines(iso9283_lines(result, robot, width_of(stream)), stream)


def iso9283_lines(result: Iso9283Result, robot: str | None, width: int) -> Iterator[TextLine]:
    """Return the report's lines; running text is wrapped to ``width`` columns."""
    yield heading("Pose criteria of ISO 9283:1998")
    yield TextLine(f"{', '.join(result.sources)}: {_counted(result)}")
    yield TextLine(_commanded(result, robot))
    yield TextLine(_registration(result))
    if result.unaligned is not None:
        unaligned = ", ".join(three_digits(float(value) * IN_MM) for value in result.unaligned)
        yield TextLine(f"largest AP before registration: {unaligned} mm")
    for title, symbols in _GROUPS:
        characteristics = [result.characteristic(symbol) for symbol in symbols]
        yield from (BLANK, heading(title), *_summary(characteristics, result.confidence, width))
    yield from pose_tables(result)
    yield from pair_tables(result)
    yield from (BLANK, heading("Conditions of the standard's protocol"), *_protocol(result, width))
    for title, texts in (("Confidence intervals", _methods(result)), ("Limitations", result.notes)):
        yield from (BLANK, heading(title), *items(texts, width))


def _registration(result: Iso9283Result) -> str:
    if not result.alignments:
        return "not registered"
    first = result.alignments[0]
    return f"registered: {' and '.join(first.effects)} fitted, {first.n_parameters} parameters"


def _counted(result: Iso9283Result) -> str:
    files = len(result.sources)
    poses = [sum(pose.number == number for pose in result.poses) for number in range(files)]
    counts = sorted({pose.n for pose in result.poses})
    visits = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    each = f"{visits} visit{'s' * (counts != [1])}{' of each' * (len(result.poses) > 1)}"
    numbers = " and ".join(map(str, dict.fromkeys(poses)))
    return f"{numbers} commanded pose{'s' * (poses != [1] * files)}{', robot by robot' * (files > 1)}, {each}"


def _commanded(result: Iso9283Result, robot: str | None) -> str:
    if result.commanded is None:
        return "no commanded poses"
    return f"commanded poses from {f'the model {robot}' if result.commanded == 'robot' else 'cmd_ columns'}"


def _summary(characteristics: Sequence[Characteristic], confidence: float, width: int) -> Iterator[TextLine]:
    """Return the largest value of each criterion, then the missing criteria with the reasons."""
    rows = []
    for characteristic in characteristics:
        for unit, factor, figure, place in (
            ("mm", IN_MM, characteristic.position, characteristic.position_at),
            ("°", IN_DEGREES, characteristic.angle, characteristic.angle_at),
        ):
            if figure.value is not None:
                symbol = "" if characteristic.symbol == "shift" else characteristic.symbol
                name = _NAMES[characteristic.symbol] if unit == "mm" else "  of orientation"
                value, interval = measured(figure, factor)
                rows.append(
                    (
                        f"{symbol if unit == 'mm' else '':<4}{name}",
                        characteristic.clause,
                        value,
                        unit,
                        interval,
                        place or "",
                    )
                )
    if rows:
        yield from columns(("largest over poses", "clause", "", "", f"{100 * confidence:g} % interval", "at"), rows)
    missing = [
        (characteristic.symbol, characteristic.position.interval.why or "")
        for characteristic in characteristics
        if characteristic.position.value is None
    ]
    yield from items(_grouped(missing), width)
    yield from items(dict.fromkeys(note for characteristic in characteristics for note in characteristic.notes), width)


def _grouped(missing: Sequence[tuple[Symbol, str]]) -> list[str]:
    """Return why criteria are missing, one line per reason."""
    reasons: dict[str, list[str]] = {}
    for symbol, why in missing:
        name = _NAMES[symbol].removesuffix(", ±")
        reasons.setdefault(why, []).append(name if symbol == "shift" else f"{symbol} ({name})")
    return [f"no {', no '.join(names)}: {why}" for why, names in reasons.items()]


def _protocol(result: Iso9283Result, width: int) -> list[TextLine]:
    names = max(len(condition.name) for condition in result.protocol)
    lines = []
    for condition in result.protocol:
        status = _STATUS[condition.status]
        label = f"{condition.name:<{names}}  {condition.clause}  {status:<7}  "
        # The reason is wrapped next to its condition.
        first, *continuation = items([condition.why], max(width - len(label) + 2, 30))
        lines.append(TextLine(label + first.text[2:]))
        lines += [TextLine(" " * len(label) + line.text.strip()) for line in continuation]
    return lines


def _methods(result: Iso9283Result) -> list[str]:
    """Return the method of each criterion's interval."""
    methods: dict[str, list[str]] = {}
    for characteristic in result.characteristics:
        if characteristic.position.value is not None:
            explanation = (
                characteristic.position.interval.why
                or characteristic.position.interval.method.partition("; largest")[0]
            )
            methods.setdefault(explanation, []).append(characteristic.symbol)
    texts = [f"{', '.join(symbols)}: {method}" for method, symbols in methods.items()]
    if any("; largest" in characteristic.position.interval.method for characteristic in result.characteristics):
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


def draw_proposal(proposal: Proposal, robot: Robot, stream: TextIO) -> None:
    """Write the tables of the five poses to ``stream``."""
    write_lines(proposal_lines(proposal, robot, width_of(stream)), stream)


def proposal_lines(proposal: Proposal, robot: Robot, width: int) -> Iterator[TextLine]:
    """Return the cube, the commanded poses in the measuring frame and the joints, in mm and degrees."""
    yield heading(f"Test poses of ISO 9283:1998 for {robot.name}")
    yield from items(_facts(proposal), width)
    units = ["°" if joint.type == "revolute" else "mm" for joint in robot.variables]
    factors = [IN_DEGREES if unit == "°" else IN_MM for unit in units]
    places = proposal.poses.translation * IN_MM
    rows = [(f"P{i + 1}", *(fixed(float(value), 2) for value in places[:, i])) for i in range(5)]
    yield from (BLANK, *columns(("commanded, mm", "x", "y", "z"), rows), BLANK)
    names = [f"{name}, {unit}" for name, unit in zip(robot.variable_names, units, strict=True)]
    joints = [
        (f"P{i + 1}", *(fixed(float(q) * factor, 3) for q, factor in zip(proposal.q[:, i], factors, strict=True)))
        for i in range(5)
    ]
    yield from columns(("joints", *names), joints)
    if proposal.notes:
        yield from (BLANK, heading("Limitations"), *items(proposal.notes, width))


def _facts(proposal: Proposal) -> list[str]:
    x, y, z = (float(value) * IN_MM for value in proposal.centre)
    edge = proposal.edge * IN_MM
    return [
        f"cube with an edge of {edge:g} mm and its centre P1 at x {x:.0f}, y {y:.0f}, z {z:.0f} mm in the base frame",
        f"P2 to P5 at 10 % of the diagonal from the corners, in the plane inclined at 45° towards {proposal.plane}",
        f"{proposal.orientation_text}; every joint keeps at least {100.0 * proposal.margin:.0f} % of its range to "
        "each limit",
    ]
