"""A comparison as tables in mm and degrees, and targets before and after a correction."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TextIO

from robacc.accuracy.pose_errors import ErrorMetrics
from robacc.comparison.comparing import ComparedRow, ResultComparison, Verdict
from robacc.comparison.differences import Difference
from robacc.comparison.paired_targets import PairedTargets
from robacc.comparison.reading import split_key
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import (
    BLANK,
    IN_MM,
    TextLine,
    chance,
    columns,
    decimals,
    fixed,
    heading,
    items,
    p_value,
    table_unit,
    three_digits,
)
from robacc.statistics.intervals import EstimatedValue

_STATISTICS = {
    "rms": "rms",
    "mean_error": "mean",
    "p95": "95th percentile",
    "max": "maximum",
    "max_radius95": "largest 95 % radius",
    "radius95": "95 % radius, Gaussian",
    "longest_sd": "principal axis 1, std",
    **{f"mean_{axis}": f"mean {axis}" for axis in "xyz"},
    **{f"sd_{axis}": f"sd {axis}" for axis in "xyz"},
}
_STAGES = {
    "before.held_out": "baseline, held-out poses",
    "nominal.held_out": "nominal, registered",
    "after.fitted": "extended model, calibration poses",
    "before.fitted": "baseline, calibration poses",
    "nominal.fitted": "nominal, registered",
}
_VERDICTS: dict[Verdict, str] = {
    "demonstrated": "confirmed",
    "met_not_demonstrated": "met, not confirmed",
    "not_met": "not met",
}
_ROUNDING = 1e-12
"""m or rad; smaller values are rounding errors."""
_ISO9283 = "iso9283."
_LISTED = ("rms", "mean_error", "p95")
"""Statistics whose differences are listed for more than two results; the JSON result has all."""
_MAX_COLUMNS = 4
"""Largest number of results that stand side by side; more stand in rows."""
_MAX_NAME = 24
"""Largest number of columns for a result's name."""


def draw_comparison(comparison: ResultComparison, stream: TextIO) -> None:
    """Write the report of ``robacc compare`` to ``stream``."""
    write_lines(comparison_lines(comparison, width_of(stream)), stream)


def comparison_lines(comparison: ResultComparison, width: int) -> Iterator[TextLine]:
    """Return the report's lines; running text is wrapped to ``width`` columns."""
    yield heading(f"{len(comparison.results)} results compared; baseline: {_short(comparison.baseline)}")
    yield from _results(comparison)
    yield from (BLANK, *_ranking(comparison))
    if comparison.scale is not None:
        yield from (BLANK, *_grade(comparison, width))
    for owner in dict.fromkeys(split_key(row.key)[0] for row in comparison.rows):
        if _stage(owner) is None and not owner.startswith(_ISO9283):
            rows = [row for row in comparison.rows if split_key(row.key)[0] == owner]
            yield from (
                BLANK,
                *_block(comparison, _title(owner), rows, [_label(split_key(row.key)[1]) for row in rows]),
            )
    for title, unit in (("ISO 9283, position", "m"), ("ISO 9283, orientation", "rad")):
        rows = [row for row in comparison.rows if row.key.startswith(_ISO9283) and row.unit == unit]
        if rows:
            yield from (BLANK, *_block(comparison, title, rows, [_characteristic(row.key) for row in rows]))
    for quantity in ("position", "orientation"):
        rows = [row for row in comparison.rows if row.key.endswith(f".{quantity}.rms") and _stage(row.key)]
        if rows:
            title = f"{quantity.capitalize()} rms"
            yield from (BLANK, *_block(comparison, title, rows, [_stage(row.key) or "" for row in rows]))
    texts = list(dict.fromkeys(_methods(comparison)))
    if texts:
        yield from (BLANK, heading("Differences"), *items(texts, width))
    if comparison.notes:
        yield from (BLANK, heading("Limitations"), *items(comparison.notes, width))


def _short(name: str) -> str:
    return name if len(name) <= _MAX_NAME else f"{name[: _MAX_NAME - 1]}…"


def _results(comparison: ResultComparison) -> list[TextLine]:
    paired = {pairing.second: pairing for pairing in comparison.pairing}
    rows = []
    for result in comparison.results:
        match = paired.get(result.name)
        poses = "" if match is None else "same poses" if match.paired else "different poses"
        if match is not None and not result.errors:
            poses = ""
        cells = (result.command, result.robot or "–", str(result.n_poses), result.grade or "–", poses)
        rows.append((_short(result.name), *(_short(cell) for cell in cells)))
    return columns(("result", "command", "robot", "poses", "grade", ""), rows)


def _ranking(comparison: ResultComparison) -> Iterator[TextLine]:
    ranking = comparison.ranking
    owner, statistic = split_key(ranking.key)
    quantity = owner.rpartition(".")[2]
    description = (
        _characteristic(ranking.key) if owner.startswith(_ISO9283) else f"{_label(statistic)} of the {quantity} error"
    )
    stage = _stage(ranking.key)
    if stage is not None:
        description = f"{description} ({stage})"
    yield heading(f"Ranking by {description}, {table_unit(ranking.unit)[1]}")
    following = {pair.better: pair for pair in ranking.pairs if _next_to(ranking.names, pair.better, pair.worse)}
    rows = []
    for name, value, letters in zip(ranking.names, ranking.values, ranking.letters, strict=True):
        pair = following.get(name)
        cells = ["", ""]
        if pair is not None:
            cells = [_difference(pair.difference, ranking.unit), p_value(pair.p_corrected)]
        rows.append((_short(name), _amount(value, ranking.unit), letters, *cells))
    header = ("", "", "group" if ranking.groups else "", "difference to the next", "p, corrected for pairs")
    yield from columns(header, rows)
    yield from (TextLine(f"- {sentence}") for sentence in ranking.sentences())


def _next_to(names: tuple[str, ...], better: str, worse: str) -> bool:
    return names.index(worse) == names.index(better) + 1


def _grade(comparison: ResultComparison, width: int) -> Iterator[TextLine]:
    scale = comparison.scale
    if scale is None:
        return
    yield heading(f"Grade {comparison.required_grade} (scale: {scale.name})")
    rows = []
    for status in comparison.grade_statuses:
        probability = "–" if status.probability is None else chance(status.probability)
        cells = [
            _VERDICTS[status.verdict],
            status.grade,
            probability,
            _bounded(status.position, "m"),
            "–" if status.orientation is None else _bounded(status.orientation, "rad"),
        ]
        rows.append((_short(status.name), *cells))
    header = ("", "", "grade", "probability", "position (bound), mm", "orientation (bound), °")
    yield from columns(header, rows)
    reasons = [f"{status.name}: {status.why}" for status in comparison.grade_statuses if status.why]
    reasons += [
        f"{status.name}: if the estimate does not change, {status.poses_to_demonstrate} poses in total would "
        "probably confirm it"
        for status in comparison.grade_statuses
        if status.poses_to_demonstrate is not None
    ]
    yield from items(reasons, width)


def _bounded(estimate: EstimatedValue, unit: str) -> str:
    bound = None if estimate.interval is None else estimate.interval.upper_bound
    return _amount(estimate.value, unit) + ("" if bound is None else f" ({_amount(bound, unit)})")


def _block(comparison: ResultComparison, title: str, rows: list[ComparedRow], labels: list[str]) -> Iterator[TextLine]:
    """Return the table of related statistics; few results stand in columns, many in rows."""
    unit = rows[0].unit
    names = [_short(result.name) for result in comparison.results]
    title = f"{title}, {table_unit(unit)[1]}"
    if len(names) == 2:
        table = []
        for label, row in zip(labels, rows, strict=True):
            difference = next(difference for difference in row.differences if difference is not None)
            values = (_amount(figure.value, unit) for figure in row.figures)
            table.append(
                (
                    label,
                    *values,
                    _difference(difference, unit),
                    _interval(difference, unit),
                    p_value(difference.p_value),
                )
            )
        yield from columns((title, *names, "difference", _percent(comparison), ""), table)
        return
    if len(names) <= _MAX_COLUMNS:
        table_rows = [
            (label, *(_amount(figure.value, unit) for figure in row.figures))
            for label, row in zip(labels, rows, strict=True)
        ]
        yield from columns((title, *names), table_rows)
        yield BLANK
        selected = [i for i, row in enumerate(rows) if split_key(row.key)[1] in _LISTED] or range(len(rows))
    else:
        selected = [i for i, row in enumerate(rows) if split_key(row.key)[1] in (*_LISTED, "max")] or range(len(rows))[
            :4
        ]
        cells = [(name, *(_amount(rows[k].figures[i].value, unit) for k in selected)) for i, name in enumerate(names)]
        yield from columns((title, *(labels[k] for k in selected)), cells)
        yield BLANK
        selected = selected[:1]
    yield from _differences(comparison, [rows[k] for k in selected], [labels[k] for k in selected])


def _differences(comparison: ResultComparison, rows: list[ComparedRow], labels: list[str]) -> list[TextLine]:
    """Return a line for each statistic and each result but the baseline."""
    table = []
    for label, row in zip(labels, rows, strict=True):
        for result, difference in zip(comparison.results, row.differences, strict=True):
            if difference is not None:
                cells = (
                    _difference(difference, row.unit),
                    _interval(difference, row.unit),
                    p_value(difference.p_value),
                )
                table.append((f"{label}, {_short(result.name)}", *cells))
    return columns((f"difference from {_short(comparison.baseline)}", "difference", _percent(comparison), ""), table)


def _percent(comparison: ResultComparison) -> str:
    return f"{100 * comparison.confidence:g} % interval"


def _methods(comparison: ResultComparison) -> Iterator[str]:
    """Return how each difference was computed, or why it is missing, with the statistics concerned."""
    methods: dict[str, dict[str, None]] = {}
    for row in comparison.rows:
        for difference in row.differences:
            if difference is not None:
                iso9283 = row.key.startswith(_ISO9283)
                statistic = _characteristic(row.key) if iso9283 else _label(split_key(row.key)[1])
                methods.setdefault(difference.interval.why or difference.interval.method, {})[statistic] = None
    for method, statistics in methods.items():
        yield f"{', '.join(statistics)}: {method}"


def _stage(key: str) -> str | None:
    """Return the label of a fit's stage, None for its main statistics."""
    return next((label for stage, label in _STAGES.items() if key.startswith(f"{stage}.")), None)


def _title(owner: str) -> str:
    return f"{owner.capitalize()} error"


def _characteristic(key: str) -> str:
    """Return the name of a criterion, such as ``AP`` or ``drift of AP``."""
    symbol = key.removeprefix(_ISO9283).removesuffix(".max").removesuffix(".orientation")
    kind, _, base = symbol.partition(".")
    return f"{kind} of {base}" if base else kind


def _label(statistic: str) -> str:
    return _STATISTICS.get(statistic, statistic)


def _amount(value: float, unit: str) -> str:
    return "0" if abs(value) < _ROUNDING else three_digits(value * table_unit(unit)[0])


def _difference(difference: Difference, unit: str) -> str:
    if abs(difference.value) < _ROUNDING:
        return "0"
    return _signed(difference.value * table_unit(unit)[0], _places(difference, unit))


def _interval(difference: Difference, unit: str) -> str:
    lower, upper = difference.interval.lower, difference.interval.upper
    if lower is None or upper is None:
        return "–"
    if max(abs(lower), abs(upper)) < _ROUNDING:
        return "0 … 0"
    factor, places = table_unit(unit)[0], _places(difference, unit)
    return f"{_signed(lower * factor, places)} … {_signed(upper * factor, places)}"


def _places(difference: Difference, unit: str) -> int:
    factor = table_unit(unit)[0]
    ends = (difference.interval.lower, difference.interval.upper)
    limits = (None, None) if None in ends else tuple(end if end is None else end * factor for end in ends)
    return decimals(difference.value * factor, *limits)


def _signed(value: float, places: int) -> str:
    text = fixed(value, places)
    return text if text.startswith("-") or float(text) == 0.0 else f"+{text}"


# Targets before and after a correction as a table in mm.

_LOADED = {
    "loaded": "the correction was loaded",
    "partly loaded": "only a part of the correction was loaded",
    "not loaded": "no sign that the correction was loaded",
    "undecided": "the measurements do not decide whether the correction was loaded",
}


def draw_paired_targets(result: PairedTargets, names: tuple[str, str], stream: TextIO) -> None:
    """Write the comparison of the files ``names`` to ``stream``."""
    write_lines(paired_lines(result, names, width_of(stream)), stream)


def paired_lines(result: PairedTargets, names: tuple[str, str], width: int) -> Iterator[TextLine]:
    """Return the report's lines, wrapped to ``width`` columns."""
    yield heading(f"{len(result.names)} targets before ({names[0]}) and after ({names[1]}) a correction")
    rows = [_row("before", result.metrics_before), _row("after", result.metrics_after)]
    yield from (BLANK, *columns(("error, mm", "rms", "mean", "95th pct.", "largest"), rows), BLANK)
    gain = result.gain
    low, high = (three_digits(bound * IN_MM) for bound in (gain.low, gain.high))
    texts = [f"gain {three_digits(gain.value * IN_MM)} mm of the rms error, 95 % interval {low} to {high} mm"]
    loaded = result.loaded
    texts.append(
        f"{_LOADED[loaded.verdict]}: the targets moved by {100 * loaded.slope:.0f} % of the planned displacement of "
        f"{three_digits(loaded.planned_rms * IN_MM)} mm rms, 95 % interval {100 * loaded.low:.0f} to "
        f"{100 * loaded.high:.0f} %"
    )
    if result.promise is not None:
        promise = result.promise
        kept = "agrees with the model" if promise.kept else "does not agree with the model"
        texts.append(
            f"the error after {kept}: {three_digits(result.metrics_after.rms * IN_MM)} mm rms measured, "
            f"{three_digits(promise.promised_rms * IN_MM)} mm rms predicted with measurement noise; chi-square "
            f"{promise.chi_square:.4g} on {promise.degrees_of_freedom} degrees of freedom, {p_value(promise.p_value)}"
        )
    yield from items((*texts, *result.notes), width)


def _row(label: str, errors: ErrorMetrics) -> tuple[str, ...]:
    figures = (errors.rms, errors.mean, errors.p95, errors.max)
    return (label, *(three_digits(figure * IN_MM) for figure in figures))
