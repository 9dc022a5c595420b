"""A comparison as tables to read: mm and degrees, results as columns where they are few, else as rows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TextIO

from robacc.comparison.comparing import Comparison, Row
from robacc.comparison.differences import Difference
from robacc.comparison.subject import split_key
from robacc.report.console import width_of, write_lines
from robacc.report.layout import BLANK, Line, columns, heading, items
from robacc.report.numbers import chance, decimals, fixed, p_value, three_digits

_FACTORS = {"m": 1e3, "rad": 180.0 / math.pi, "1": 1.0}
_UNITS = {"m": "mm", "rad": "°", "1": ""}
_STATISTICS = {
    "rms": "rms",
    "mean_error": "mean",
    "p95": "95th percentile",
    "max": "maximum",
    "max_radius95": "largest 95 % radius",
    "radius95": "95 % radius, Gaussian",
    "longest_sd": "longest axis, sd",
    **{f"mean_{axis}": f"mean {axis}" for axis in "xyz"},
    **{f"sd_{axis}": f"sd {axis}" for axis in "xyz"},
}
_OWNERS = {"before.held_out": "before", "nominal.held_out": "nominal", "after.fitted": "after, poses fitted"}
_BRIEF = ("rms", "mean_error", "p95", "max")
_MOST_COLUMNS = 4
"""Results that stand side by side; more stand in rows."""
_LONGEST = 24
"""Columns that a result's name takes at most."""


def draw_comparison(found: Comparison, stream: TextIO) -> None:
    """Write everything ``robacc compare`` says to ``stream``."""
    write_lines(comparison_lines(found, width_of(stream)), stream)


def comparison_lines(found: Comparison, width: int) -> Iterator[Line]:
    """The report's lines; running text is wrapped to ``width`` columns."""
    yield heading(f"{len(found.subjects)} results compared; differences are to {_short(found.baseline)}")
    yield from _results(found)
    yield from (BLANK, *_ranking(found))
    if found.scale is not None:
        yield from (BLANK, *_grade(found, width))
    for owner in dict.fromkeys(split_key(row.key)[0] for row in found.rows):
        rows = [row for row in found.rows if split_key(row.key)[0] == owner]
        yield BLANK
        yield from _block(found, owner, rows)
    texts = list(dict.fromkeys(_methods(found)))
    if texts:
        yield from (BLANK, heading("Differences"), *items(texts, width))
    if found.notes:
        yield from (BLANK, heading("To bear in mind"), *items(found.notes, width))


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…"


def _results(found: Comparison) -> list[Line]:
    paired = {one.second: one for one in found.pairing}
    rows = []
    for subject in found.subjects:
        match = paired.get(subject.name)
        poses = "" if match is None else "the same poses" if match.paired else "other poses"
        if match is not None and not subject.errors:
            poses = ""
        cells = (subject.command, subject.robot or "–", str(subject.n_poses), subject.grade or "–", poses)
        rows.append((_short(subject.name), *(_short(cell) for cell in cells)))
    return columns(("result", "command", "robot", "poses", "grade", ""), rows)


def _ranking(found: Comparison) -> Iterator[Line]:
    ranking = found.ranking
    owner, statistic = split_key(ranking.key)
    yield heading(f"Ranking by {_label(statistic)} {_title(owner).lower()}, {_UNITS[ranking.unit]}")
    following = {pair.better: pair for pair in ranking.pairs if _next_to(ranking.names, pair.better, pair.worse)}
    rows = []
    for name, value, letters in zip(ranking.names, ranking.values, ranking.letters, strict=True):
        pair = following.get(name)
        cells = ["", ""]
        if pair is not None:
            cells = [_difference(pair.difference, ranking.unit), p_value(pair.p_corrected)]
        rows.append((_short(name), _amount(value, ranking.unit), letters, *cells))
    yield from columns(("", "", "group", "to the next", "corrected"), rows)
    yield from (Line(f"- {sentence}") for sentence in ranking.sentences())


def _next_to(names: tuple[str, ...], better: str, worse: str) -> bool:
    return names.index(worse) == names.index(better) + 1


def _grade(found: Comparison, width: int) -> Iterator[Line]:
    scale = found.scale
    if scale is None:
        return
    yield heading(f"Grade {found.wanted} (scale: {scale.name})")
    rows = []
    for one in found.standings:
        sure = "–" if one.probability is None else chance(one.probability)
        cells = [one.verdict, one.grade, sure, _bounded(one.position, one.position_bound, "m")]
        cells.append("–" if one.orientation is None else _bounded(one.orientation, one.orientation_bound, "rad"))
        rows.append((_short(one.name), *cells))
    yield from columns(("", "", "own", "chance", "position (bound), mm", "orientation (bound), °"), rows)
    reasons = [f"{one.name}: {one.why}" for one in found.standings if one.why]
    reasons += [
        f"{one.name}: if the estimate stays, {one.poses_to_demonstrate} poses in all would likely demonstrate it"
        for one in found.standings
        if one.poses_to_demonstrate is not None
    ]
    yield from items(reasons, width)


def _bounded(value: float, bound: float | None, unit: str) -> str:
    return _amount(value, unit) + ("" if bound is None else f" ({_amount(bound, unit)})")


def _block(found: Comparison, owner: str, rows: list[Row]) -> Iterator[Line]:
    """The figures that are of one set of errors."""
    unit = rows[0].unit
    names = [_short(subject.name) for subject in found.subjects]
    title = f"{_title(owner)}, {_UNITS[unit]}"
    if len(names) == 2:
        yield from _two(found, title, rows, names)
    elif len(names) <= _MOST_COLUMNS:
        table = [(_label(split_key(row.key)[1]), *(_amount(one.value, unit) for one in row.figures)) for row in rows]
        yield from columns((title, *names), table)
        yield BLANK
        yield from _differences(found, [row for row in rows if split_key(row.key)[1] in _BRIEF[:3]] or rows)
    else:
        brief = [row for row in rows if split_key(row.key)[1] in _BRIEF] or rows[:4]
        table = [(name, *(_amount(row.figures[i].value, unit) for row in brief)) for i, name in enumerate(names)]
        yield from columns((title, *(_label(split_key(row.key)[1]) for row in brief)), table)
        yield from _differences(found, brief[:1])


def _two(found: Comparison, title: str, rows: list[Row], names: list[str]) -> list[Line]:
    table = []
    for row in rows:
        one = next(one for one in row.differences if one is not None)
        values = (_amount(figure.value, row.unit) for figure in row.figures)
        cells = (_difference(one, row.unit), _interval(one, row.unit), p_value(one.p_value))
        table.append((_label(split_key(row.key)[1]), *values, *cells))
    return columns((title, *names, "difference", f"{100 * found.confidence:g} % interval", ""), table)


def _differences(found: Comparison, rows: list[Row]) -> Iterator[Line]:
    """One row for each figure and result, beside the baseline."""
    table = []
    for row in rows:
        for subject, one in zip(found.subjects, row.differences, strict=True):
            if one is None:
                continue
            label = f"{_label(split_key(row.key)[1])}, {_short(subject.name)}"
            table.append((label, _difference(one, row.unit), _interval(one, row.unit), p_value(one.p_value)))
    title = f"less that of {_short(found.baseline)}"
    yield from columns((title, "difference", f"{100 * found.confidence:g} % interval", ""), table)


def _methods(found: Comparison) -> Iterator[str]:
    """How differences were had, or why not, with the figures that this is of."""
    methods: dict[str, dict[str, None]] = {}
    for row in found.rows:
        for one in row.differences:
            if one is not None:
                statistic = _label(split_key(row.key)[1])
                methods.setdefault(one.why or one.method, {})[statistic] = None
    for method, statistics in methods.items():
        yield f"{', '.join(statistics)}: {method}"


def _title(owner: str) -> str:
    """``Position error``, ``Orientation error, before``, ``AP``."""
    stage, _, quantity = owner.rpartition(".")
    if quantity not in ("position", "orientation"):
        return owner.removeprefix("iso9283.")
    if stage.startswith("iso9283."):
        return f"{stage.removeprefix('iso9283.')}, {quantity}"
    title = f"{quantity.capitalize()} error"
    return f"{title}, {_OWNERS.get(stage, stage.replace('.', ', ').replace('_', ' '))}" if stage else title


def _label(statistic: str) -> str:
    return _STATISTICS.get(statistic, statistic)


def _amount(value: float, unit: str) -> str:
    return three_digits(value * _FACTORS[unit])


def _difference(one: Difference, unit: str) -> str:
    return _signed(one.value * _FACTORS[unit], _places(one, unit))


def _interval(one: Difference, unit: str) -> str:
    if one.lower is None or one.upper is None:
        return "–"
    factor, places = _FACTORS[unit], _places(one, unit)
    return f"{_signed(one.lower * factor, places)} … {_signed(one.upper * factor, places)}"


def _places(one: Difference, unit: str) -> int:
    factor = _FACTORS[unit]
    limits = (None, None) if one.lower is None or one.upper is None else (one.lower * factor, one.upper * factor)
    return decimals(one.value * factor, *limits)


def _signed(value: float, places: int) -> str:
    text = fixed(value, places)
    return text if text.startswith("-") or float(text) == 0.0 else f"+{text}"
