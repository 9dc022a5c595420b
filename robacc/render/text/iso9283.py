"""An evaluation after ISO 9283 as tables to read: mm and degrees, accuracy and repeatability each under its heading.

Repeatability is never called accuracy here, nor do the two share a table: taking RP for AP is the commonest misreading
of the standard.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.iso_9283.records import Characteristic, Iso9283Result, Symbol
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.iso9283_parts import IN_DEGREES, IN_MM, measured, pair_tables, pose_tables
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items
from robacc.render.text.numbers import three_digits

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
    ("Accuracy: how near the robot comes to the command", ("AP", "vAP", "AD", "E")),
    ("Repeatability: how alike its visits are, however far from the command", ("RP", "RD")),
    ("Drift: how both change during the run", ("dAP", "dRP", "shift")),
)
_STATUS = {"met": "met", "not met": "NOT MET", "unknown": "unknown"}


def draw_iso9283(result: Iso9283Result, robot: str | None, stream: TextIO) -> None:
    """Write everything ``robacc iso9283`` says to ``stream``; ``robot`` is its file's name."""
    write_lines(iso9283_lines(result, robot, width_of(stream)), stream)


def iso9283_lines(result: Iso9283Result, robot: str | None, width: int) -> Iterator[TextLine]:
    """The report's lines; running text is wrapped to ``width`` columns."""
    yield heading(f"Pose criteria of ISO 9283:1998, {_aligned(result)}")
    yield TextLine(f"{', '.join(result.sources)}: {_counted(result)}")
    yield TextLine(_commanded(result, robot))
    if result.unaligned is not None:
        unaligned = ", ".join(three_digits(float(value) * IN_MM) for value in result.unaligned)
        yield TextLine(f"AP before the alignment, largest: {unaligned} mm")
    for title, symbols in _GROUPS:
        found = [result.characteristic(symbol) for symbol in symbols]
        yield from (BLANK, heading(title), *_summary(found, result.confidence, width))
    yield from pose_tables(result)
    yield from pair_tables(result)
    yield from (BLANK, heading("Conditions of the standard's protocol"), *_protocol(result, width))
    for title, texts in (("Intervals", _methods(result)), ("To bear in mind", result.notes)):
        yield from (BLANK, heading(title), *items(texts, width))


def _aligned(result: Iso9283Result) -> str:
    if not result.alignments:
        return "nothing aligned"
    first = result.alignments[0]
    return f"{' and '.join(first.effects)} aligned with {first.n_parameters} parameters"


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
        return "nothing says where the robot was sent"
    return f"commanded by {robot if result.commanded == 'robot' else 'cmd_ columns'}"


def _summary(found: Sequence[Characteristic], confidence: float, width: int) -> Iterator[TextLine]:
    """The largest of each criterion, position and orientation, then what could not be had and why."""
    rows = []
    for one in found:
        for unit, factor, figure, at in (
            ("mm", IN_MM, one.position, one.position_at),
            ("°", IN_DEGREES, one.angle, one.angle_at),
        ):
            if figure.value is not None:
                symbol = "" if one.symbol == "shift" else one.symbol
                name = _NAMES[one.symbol] if unit == "mm" else "  of orientation"
                value, interval = measured(figure, factor)
                rows.append((f"{symbol if unit == 'mm' else '':<4}{name}", one.clause, value, unit, interval, at or ""))
    if rows:
        yield from columns(("largest", "clause", "", "", f"{100 * confidence:g} % interval", "at"), rows)
    missing = [(one.symbol, one.position.interval.why or "") for one in found if one.position.value is None]
    yield from items(_together(missing), width)
    yield from items(dict.fromkeys(note for one in found for note in one.notes), width)


def _together(missing: Sequence[tuple[Symbol, str]]) -> list[str]:
    """Why each criterion is missing, those of one reason in one."""
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
        # The reason is wrapped beside its condition.
        first, *rest = items([condition.why], max(width - len(label) + 2, 30))
        lines.append(TextLine(label + first.text[2:]))
        lines += [TextLine(" " * len(label) + line.text.strip()) for line in rest]
    return lines


def _methods(result: Iso9283Result) -> list[str]:
    """Which criterion's interval was made how."""
    methods: dict[str, list[str]] = {}
    for one in result.characteristics:
        if one.position.value is not None:
            how = one.position.interval.why or one.position.interval.method.partition("; largest")[0]
            methods.setdefault(how, []).append(one.symbol)
    texts = [f"{', '.join(symbols)}: {method}" for method, symbols in methods.items()]
    if any("; largest" in one.position.interval.method for one in result.characteristics):
        texts.append(
            "the largest over poses: upper limit the greatest of theirs, lower limit corrected for their number"
        )
    texts.append("visits count as independent draws of a Gaussian; the instrument's own systematic error is in none")
    return texts
