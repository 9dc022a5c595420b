"""A correction and an export as tables in mm and degrees, at most 80 columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

from robacc.accuracy.pose_errors import ErrorMetrics
from robacc.correction.correction import Correction, ExpectedErrors, grade_counts
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, IN_DEGREES, IN_MM, TextLine, columns, heading, items, three_digits

_CAUSES = {
    "unreached": "not reached by the nominal robot",
    "limit": "joint limit",
    "approach": "unknown direction of approach",
    "singular": "near a singular pose",
    "configuration": "another configuration",
    "too_large": "correction too large",
    "out_of_range": "outside the range of the model",
}


def draw_correction(result: Correction, names: tuple[str, str], stream: TextIO) -> None:
    """Write the report of ``robacc correct`` to ``stream``; ``names`` are those of targets and model."""
    write_lines(correction_lines(result, names, width_of(stream)), stream)


def correction_lines(result: Correction, names: tuple[str, str], width: int) -> Iterator[TextLine]:
    """Return the report's lines; text is wrapped to ``width`` columns, tables take at most 80."""
    count = f"{result.n_corrected} of {result.n_targets} targets"
    yield heading(f"Correction of {names[0]} by {names[1]}: {count} corrected")
    chosen = result.targets.is_corrected
    oriented = result.targets.wanted.oriented
    if chosen.any():
        yield from (BLANK, heading("Over the corrected targets"))
        yield from _figures(result, oriented)
    for stage, errors in (("before", result.before), ("after", result.after)):
        if errors.grades is not None:
            graded = [grade for grade, corrected in zip(errors.grades, chosen, strict=True) if corrected]
            counts = ", ".join(f"{name} {number}" for name, number in grade_counts(result.scale, graded) if number)
            yield TextLine(f"grades {stage}: {counts}")
    if result.causes:
        yield from (BLANK, heading("Not corrected"))
        yield from columns(("cause", "targets"), [(_CAUSES[cause.value], str(n)) for cause, n in result.causes.items()])
    if result.notes:
        yield from (BLANK, heading("Assumptions and limitations"), *items(result.notes, width))


def _figures(result: Correction, oriented: bool) -> list[TextLine]:
    stages = (("before", result.before), ("after", result.after))
    made = result.correction_metrics
    rows = [_row("correction", made.position, made.orientation)]
    rows += [_expected_row(result, errors, stage) for stage, errors in stages]
    rows += [row for stage, errors in stages for row in _bound_rows(result, errors, stage)]
    header = ("", "rms, mm", "largest, mm", "rms, °", "largest, °")
    return columns(header if oriented else header[:3], [row if oriented else row[:3] for row in rows])


def _expected_row(result: Correction, errors: ExpectedErrors, stage: str) -> tuple[str, ...]:
    """Return the RMS errors to expect; a model that was fitted to positions alone says nothing of orientation."""
    orientation = result.metrics(errors.orientation_rms) if errors.orientation_is_known else None
    return _row(f"expected error {stage}", result.metrics(errors.position_rms), orientation)


def _bound_rows(result: Correction, errors: ExpectedErrors, stage: str) -> list[tuple[str, ...]]:
    if errors.position_bound is None:
        return []
    orientation = None if errors.orientation_bound is None else result.metrics(errors.orientation_bound)
    return [_row(f"95 % bound {stage}", result.metrics(errors.position_bound), orientation)]


def _row(label: str, position: ErrorMetrics, orientation: ErrorMetrics | None) -> tuple[str, ...]:
    cells = [label]
    for metrics, factor, least in ((position, IN_MM, 1e-3), (orientation, IN_DEGREES, 1e-4)):
        if metrics is None:
            cells += ["–", "–"]
            continue
        for size in (metrics.rms * factor, metrics.max * factor):
            # Below a micrometre the solver's tolerance decides, not the arm.
            cells.append(three_digits(size) if size >= least else f"< {least:g}")
    return tuple(cells)


# Table of ``robacc export``, at most 80 columns.

_WIDTH = 80
_LEAST = 1e-4
"""Smallest error that is shown as a number, mm or degrees: below it, the digits of the file decide."""
_LABEL = 19
"""Columns that the labels take."""


def write_export(stream: TextIO, result: Mapping[str, Any]) -> None:
    """Write what the file holds, the error that remains in it, and the tool to set."""
    remaining = result["remaining_error"]
    arm = f" of {result['arm']}" if result["arm"] else ""
    lines = [f"Export as {result['format']}{arm}"]
    if result["refitted"]:
        lines += _labelled("fitted again to", ", ".join(result["refitted"]))
    if result["not_carried"]:
        lines += _labelled("not in the format", ", ".join(result["not_carried"]))
    lines += _labelled("remaining error", f"position {_sizes(remaining['position'], 'm', IN_MM, ' mm')};")
    lines += _labelled("", f"orientation {_sizes(remaining['orientation'], 'rad', IN_DEGREES, '°')};")
    lines += _labelled("", f"over {remaining['n_poses']} poses within the joint limits")
    place = ", ".join(_fixed(IN_MM * value, 4) for value in result["tool"]["xyz_m"])
    turn = ", ".join(_fixed(math.degrees(value), 5) for value in result["tool"]["rpy_rad"])
    lines += _labelled("tool to set", f"x, y, z {place} mm")
    lines += _labelled("", f"roll, pitch, yaw {turn}°")
    print("\n".join(lines), file=stream)


def _sizes(errors: Mapping[str, float], unit: str, factor: float, name: str) -> str:
    sizes = (errors[f"{key}_{unit}"] * factor for key in ("rms", "max"))
    rms, largest = (three_digits(size) if size >= _LEAST else f"< {_LEAST:g}" for size in sizes)
    return f"{rms}{name} rms, {largest}{name} largest"


def _labelled(label: str, text: str) -> list[str]:
    """Return a label and its text, wrapped with a hanging indent."""
    return textwrap.wrap(
        text, _WIDTH, initial_indent=f"{label:<{_LABEL}}", subsequent_indent=" " * _LABEL, break_on_hyphens=False
    )


def _fixed(value: float, places: int) -> str:
    return f"{round(value, places) + 0.0:.{places}f}"
