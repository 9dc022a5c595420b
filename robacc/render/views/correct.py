"""A correction and an export: corrections, the errors to expect, and what remains."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TextIO

from robacc.render.text.layout import IN_DEGREES, IN_MM, Document, three_digits
from robacc.render.views.elements import (
    Block,
    Cell,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Text,
    Tile,
    amount,
    number,
)

_CAUSES = {
    "unreached": "not reached by the nominal robot",
    "limit": "joint limit",
    "approach": "unknown direction of approach",
    "singular": "near a singular pose",
    "configuration": "another configuration",
    "too_large": "correction too large",
    "out_of_range": "outside the range of the model",
}
_ROWS = 40
"""Targets that are not corrected and that the page lists."""


def correction_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``correct``."""
    before, after = (document["expected"][stage]["position"] or {} for stage in ("before", "after"))
    now, then = (amount(part.get("expected_rms_m")) for part in (before, after))
    count = f"{document['n_corrected']} of {document['n_targets']} targets"
    return ReportHeadline(
        f"Correction by {document['model']}",
        f"{count} have a corrected command. The position error to expect falls from {now} to {then} rms.",
        [
            Tile("expected error before, rms", now),
            Tile("expected error after, rms", then),
            Tile("95 % bound after, largest", amount(after.get("largest_bound95_m"))),
        ],
        [(f"{count} corrected", "open" if document["n_refused"] else "good")],
    )


def correction_view(document: Document, names: tuple[str, str]) -> Iterator[Section]:
    """Return the text of a correction; ``names`` are those of targets and model."""
    count = f"{document['n_corrected']} of {document['n_targets']} targets"
    yield Section(f"Correction of {names[0]} by {names[1]}: {count} corrected", [])
    yield from correction_sections(document)
    if document["notes"]:
        yield Section("Assumptions and limitations", [Listing(document["notes"])])


def correction_page(document: Document) -> Iterator[Section]:
    """Return the sections of a page, which lists the targets that are not corrected."""
    yield from correction_sections(document)
    targets = document["targets"]
    rows = [
        (str(line), reason)
        for line, reason in zip(targets["line"], targets["reason"], strict=True)
        if reason is not None
    ]
    if rows:
        more = [Text(f"The first {_ROWS} of {len(rows)}.")] if len(rows) > _ROWS else []
        yield Section("Targets not corrected", [Grid(("line", "reason"), rows[:_ROWS], is_text=True), *more])


def correction_sections(document: Document) -> Iterator[Section]:
    """Return the corrections and the errors to expect, and how many targets are not corrected for which cause."""
    correction, expected = document["correction"], document["expected"]
    if document["n_corrected"]:
        figures = [("correction", correction, "rms", "max")]
        figures += [
            (f"expected error {stage}", expected[stage], "expected_rms", "largest_bound95")
            for stage in ("before", "after")
        ]
        count = 5 if correction["orientation"] is not None else 3
        header = ("", "rms, mm", "largest, mm", "rms, °", "largest, °")
        blocks: list[Block] = [Grid(header[:count], [_row(*each)[:count] for each in figures])]
        for stage in ("before", "after"):
            if grades := expected[stage]["grades"]:
                counts = ", ".join(f"{name} {number}" for name, number in grades.items() if number)
                blocks.append(Text(f"grades {stage}: {counts}"))
        blocks.append(Text("largest expected error: the largest bound of 95 % of the errors", is_note=True))
        yield Section("Over the corrected targets", blocks)
    if document["refused"]:
        rows = [(_CAUSES[cause], str(count)) for cause, count in document["refused"].items()]
        yield Section("Not corrected", [Grid(("cause", "targets"), rows)])


def _row(label: str, part: Mapping[str, Any], typical: str, largest: str) -> Sequence[Cell]:
    cells: list[Cell] = [label]
    for name, unit, factor, least in (("position", "m", IN_MM, 1e-3), ("orientation", "rad", IN_DEGREES, 1e-4)):
        for key in (typical, largest):
            size = (part[name] or {}).get(f"{key}_{unit}")
            # Below a micrometre the solver's tolerance decides, not the arm.
            is_small = size is not None and size * factor < least
            cells.append(Number(f"< {least:g}", size) if is_small else number(size, factor))
    return cells


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
