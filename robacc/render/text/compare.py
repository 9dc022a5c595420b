"""A comparison as tables to read: mm and degrees, results as columns where they are few, else as rows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TextIO

from robacc.comparison.compared_result import split_key
from robacc.comparison.comparing import ResultComparison, Row
from robacc.comparison.differences import Difference
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items
from robacc.render.text.numbers import chance, decimals, fixed, p_value, three_digits

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
_STAGES = {
    "before.held_out": "before, held out",
    "nominal.held_out": "nominal",
    "after.fitted": "after, poses fitted",
    "before.fitted": "before, poses fitted",
    "nominal.fitted": "nominal",
}
_NIL = 1e-12
"""m or rad: less is rounding."""
_ISO9283 = "iso9283."
_TESTED = ("rms", "mean_error", "p95")
"""Statistics whose differences are listed where there are more than two results; the JSON has all."""
_MOST_COLUMNS = 4
"""Results that stand side by side; more stand in rows."""
_LONGEST = 24
"""Columns that a result's name takes at most."""


def draw_comparison(found: ResultComparison, stream: TextIO) -> None:
    """Write everything ``robacc compare`` says to ``stream``."""
    write_lines(comparison_lines(found, width_of(stream)), stream)


def comparison_lines(found: ResultComparison, width: int) -> Iterator[TextLine]:
    """The report's lines; running text is wrapped to ``width`` columns."""
    yield heading(f"{len(found.subjects)} results compared; differences are to {_short(found.baseline)}")
    yield from _results(found)
    yield from (BLANK, *_ranking(found))
    if found.scale is not None:
        yield from (BLANK, *_grade(found, width))
    for owner in dict.fromkeys(split_key(row.key)[0] for row in found.rows):
        if _stage(owner) is None and not owner.startswith(_ISO9283):
            rows = [row for row in found.rows if split_key(row.key)[0] == owner]
            yield from (BLANK, *_block(found, _title(owner), rows, [_label(split_key(row.key)[1]) for row in rows]))
    for title, unit in (("ISO 9283, position", "m"), ("ISO 9283, orientation", "rad")):
        rows = [row for row in found.rows if row.key.startswith(_ISO9283) and row.unit == unit]
        if rows:
            yield from (BLANK, *_block(found, title, rows, [_characteristic(row.key) for row in rows]))
    for quantity in ("position", "orientation"):
        rows = [row for row in found.rows if row.key.endswith(f".{quantity}.rms") and _stage(row.key)]
        if rows:
            title = f"{quantity.capitalize()} rms"
            yield from (BLANK, *_block(found, title, rows, [_stage(row.key) or "" for row in rows]))
    texts = list(dict.fromkeys(_methods(found)))
    if texts:
        yield from (BLANK, heading("Differences"), *items(texts, width))
    if found.notes:
        yield from (BLANK, heading("To bear in mind"), *items(found.notes, width))


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…"


def _results(found: ResultComparison) -> list[TextLine]:
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


def _ranking(found: ResultComparison) -> Iterator[TextLine]:
    ranking = found.ranking
    owner, statistic = split_key(ranking.key)
    of = owner.rpartition(".")[2]
    what = _characteristic(ranking.key) if owner.startswith(_ISO9283) else f"{_label(statistic)} of the {of} error"
    stage = _stage(ranking.key)
    if stage is not None:
        what = f"{what} ({stage})"
    yield heading(f"Ranking by {what}, {_UNITS[ranking.unit]}")
    following = {pair.better: pair for pair in ranking.pairs if _next_to(ranking.names, pair.better, pair.worse)}
    rows = []
    for name, value, letters in zip(ranking.names, ranking.values, ranking.letters, strict=True):
        pair = following.get(name)
        cells = ["", ""]
        if pair is not None:
            cells = [_difference(pair.difference, ranking.unit), p_value(pair.p_corrected)]
        rows.append((_short(name), _amount(value, ranking.unit), letters, *cells))
    yield from columns(("", "", "group" if ranking.groups else "", "to the next", "corrected"), rows)
    yield from (TextLine(f"- {sentence}") for sentence in ranking.sentences())


def _next_to(names: tuple[str, ...], better: str, worse: str) -> bool:
    return names.index(worse) == names.index(better) + 1


def _grade(found: ResultComparison, width: int) -> Iterator[TextLine]:
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


def _block(found: ResultComparison, title: str, rows: list[Row], labels: list[str]) -> Iterator[TextLine]:
    """Figures that belong together; results are columns where they are few, else rows."""
    unit = rows[0].unit
    names = [_short(subject.name) for subject in found.subjects]
    title = f"{title}, {_UNITS[unit]}"
    if len(names) == 2:
        table = []
        for label, row in zip(labels, rows, strict=True):
            one = next(one for one in row.differences if one is not None)
            values = (_amount(figure.value, unit) for figure in row.figures)
            table.append((label, *values, _difference(one, unit), _interval(one, unit), p_value(one.p_value)))
        yield from columns((title, *names, "difference", _percent(found), ""), table)
        return
    if len(names) <= _MOST_COLUMNS:
        side = [
            (label, *(_amount(one.value, unit) for one in row.figures)) for label, row in zip(labels, rows, strict=True)
        ]
        yield from columns((title, *names), side)
        yield BLANK
        shown = [i for i, row in enumerate(rows) if split_key(row.key)[1] in _TESTED] or range(len(rows))
    else:
        shown = [i for i, row in enumerate(rows) if split_key(row.key)[1] in (*_TESTED, "max")] or range(len(rows))[:4]
        cells = [(name, *(_amount(rows[k].figures[i].value, unit) for k in shown)) for i, name in enumerate(names)]
        yield from columns((title, *(labels[k] for k in shown)), cells)
        yield BLANK
        shown = shown[:1]
    yield from _differences(found, [rows[k] for k in shown], [labels[k] for k in shown])


def _differences(found: ResultComparison, rows: list[Row], labels: list[str]) -> list[TextLine]:
    """One line for each figure and result beside the baseline."""
    table = []
    for label, row in zip(labels, rows, strict=True):
        for subject, one in zip(found.subjects, row.differences, strict=True):
            if one is not None:
                cells = (_difference(one, row.unit), _interval(one, row.unit), p_value(one.p_value))
                table.append((f"{label}, {_short(subject.name)}", *cells))
    return columns((f"less that of {_short(found.baseline)}", "difference", _percent(found), ""), table)


def _percent(found: ResultComparison) -> str:
    return f"{100 * found.confidence:g} % interval"


def _methods(found: ResultComparison) -> Iterator[str]:
    """How differences were had, or why not, with the figures that this is of."""
    methods: dict[str, dict[str, None]] = {}
    for row in found.rows:
        for one in row.differences:
            if one is not None:
                iso9283 = row.key.startswith(_ISO9283)
                statistic = _characteristic(row.key) if iso9283 else _label(split_key(row.key)[1])
                methods.setdefault(one.why or one.method, {})[statistic] = None
    for method, statistics in methods.items():
        yield f"{', '.join(statistics)}: {method}"


def _stage(key: str) -> str | None:
    """In words, of a figure of a fit that is not its main one."""
    return next((words for stage, words in _STAGES.items() if key.startswith(f"{stage}.")), None)


def _title(owner: str) -> str:
    return f"{owner.capitalize()} error"


def _characteristic(key: str) -> str:
    """``AP``, ``drift of AP`` …, the largest over the commanded poses."""
    symbol = key.removeprefix(_ISO9283).removesuffix(".max").removesuffix(".orientation")
    kind, _, of = symbol.partition(".")
    return f"{kind} of {of}" if of else kind


def _label(statistic: str) -> str:
    return _STATISTICS.get(statistic, statistic)


def _amount(value: float, unit: str) -> str:
    return "0" if abs(value) < _NIL else three_digits(value * _FACTORS[unit])


def _difference(one: Difference, unit: str) -> str:
    if abs(one.value) < _NIL:
        return "0"
    return _signed(one.value * _FACTORS[unit], _places(one, unit))


def _interval(one: Difference, unit: str) -> str:
    if one.lower is None or one.upper is None:
        return "–"
    if max(abs(one.lower), abs(one.upper)) < _NIL:
        return "0 … 0"
    factor, places = _FACTORS[unit], _places(one, unit)
    return f"{_signed(one.lower * factor, places)} … {_signed(one.upper * factor, places)}"


def _places(one: Difference, unit: str) -> int:
    factor = _FACTORS[unit]
    limits = (None, None) if one.lower is None or one.upper is None else (one.lower * factor, one.upper * factor)
    return decimals(one.value * factor, *limits)


def _signed(value: float, places: int) -> str:
    text = fixed(value, places)
    return text if text.startswith("-") or float(text) == 0.0 else f"+{text}"
