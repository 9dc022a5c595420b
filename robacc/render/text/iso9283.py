"""An evaluation by ISO 9283 as tables in mm and degrees: accuracy and repeatability each under its heading.

The report keeps accuracy and repeatability in separate tables: reading RP as AP is the commonest mistake with the
standard.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.iso_9283.records import Characteristic, Iso9283Result, Symbol
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.iso9283_parts import measured, pair_tables, pose_tables
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items
from robacc.render.text.numbers import three_digits
from robacc.render.text.units import IN_DEGREES, IN_MM

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
