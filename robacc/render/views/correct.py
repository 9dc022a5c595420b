"""A correction and an export: corrections, the errors to expect, and what remains."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.text.layout import IN_DEGREES, IN_MM, Document, table_unit, three_digits, with_table_unit
from robacc.render.views.elements import (
    Block,
    Cell,
    Form,
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


def correction_view(document: Document, names: tuple[str, str] = ("", ""), form: Form = "page") -> Iterator[Section]:
    """Return the corrections and the errors to expect, and how many targets are not corrected for which cause.

    ``names`` are those of targets and model. A page lists the targets that are not corrected.
    """
    if form != "page":
        count = f"{document['n_corrected']} of {document['n_targets']} targets"
        yield Section(f"Correction of {names[0]} by {names[1]}: {count} corrected", [])
    correction, expected = document["correction"], document["expected"]
    if document["n_corrected"]:
        figures = [("correction", correction, "rms", "max")]
        figures += [
            (f"expected error {stage}", part, "expected_rms", "largest_bound95") for stage, part in expected.items()
        ]
        header = ("", "rms, mm", "largest, mm", "rms, °", "largest, °")[: 3 if correction["orientation"] is None else 5]
        blocks: list[Block] = [Grid(header, [_row(*each)[: len(header)] for each in figures])]
        for stage, part in expected.items():
            counts = ", ".join(f"{name} {number}" for name, number in (part["grades"] or {}).items() if number)
            blocks.append(Text(f"grades {stage}: {counts}" * bool(counts)))
        blocks.append(Text("largest expected error: the largest bound of 95 % of the errors", is_note=True))
        yield Section("Over the corrected targets", blocks)
    rows = [(_CAUSES[cause], str(count)) for cause, count in document["refused"].items()]
    yield Section("Not corrected", [Grid(("cause", "targets"), rows)])
    if form != "page":
        yield Section("Assumptions and limitations", [Listing(document["notes"])])
        return
    targets = zip(document["targets"]["line"], document["targets"]["reason"], strict=True)
    rows = [(str(line), reason) for line, reason in targets if reason is not None]
    more = Text(f"The first {_ROWS} of {len(rows)}." * (len(rows) > _ROWS))
    yield Section("Targets not corrected", [Grid(("line", "reason"), rows[:_ROWS], is_text=True), more])


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

_LEAST = 1e-4
"""Smallest error that is shown as a number, mm or degrees: below it, the digits of the file decide."""


def export_view(document: Document) -> Iterator[Section]:
    """Return what the file holds, the error that remains in it, and the tool to set."""
    remaining, tool = document["remaining_error"], document["tool"]
    sizes = [
        "{} rms, {} largest".format(*(_size(remaining[name][f"{key}_{unit}"], unit) for key in ("rms", "max")))
        for name, unit in (("position", "m"), ("orientation", "rad"))
    ]
    # Adding zero after rounding removes the sign of "-0.0000".
    place = ", ".join(f"{round(IN_MM * value, 4) + 0.0:.4f}" for value in tool["xyz_m"])
    turn = ", ".join(f"{round(IN_DEGREES * value, 5) + 0.0:.5f}" for value in tool["rpy_rad"])
    rows = [
        ("fitted again to", ", ".join(document["refitted"])),
        ("not in the format", ", ".join(document["not_carried"])),
        ("remaining error", f"position {sizes[0]};"),
        ("", f"orientation {sizes[1]};"),
        ("", f"over {remaining['n_poses']} poses within the joint limits"),
        ("tool to set", f"x, y, z {place} mm"),
        ("", f"roll, pitch, yaw {turn}°"),
    ]
    title = f"Export as {document['format']}{' of ' * bool(document['arm'])}{document['arm'] or ''}"
    yield Section(title, [Grid(("", ""), [(f"{label:<17}", text) for label, text in rows if text], is_text=True)])


def _size(error: float, unit: str) -> str:
    factor, name = table_unit(unit)
    text = three_digits(error * factor) if error * factor >= _LEAST else f"< {_LEAST:g}"
    return with_table_unit(text, name)
