"""A correction and an export: corrections, the errors to expect, and what remains."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.text.layout import IN_DEGREES, IN_MM, Document, table_unit, three_digits, with_table_unit
from robacc.render.views.elements import (
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
_PARTS = (("position", "m", IN_MM, 1e-3), ("orientation", "rad", IN_DEGREES, 1e-4))
"""Quantity, unit, factor to mm or degrees, and the size below which the solver's tolerance decides, not the arm."""

Part = Mapping[str, Any]


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


def correction_text(
    parts: Sequence[Document], n_targets: int, names: tuple[str, str], output: str
) -> Iterator[Section]:
    """Return the text of a correction, of each kind of targets in turn.

    ``names`` are those of targets and model, ``output`` that of the file that was written.
    """
    targets, model = names
    title = f"Correction of {targets} by {model}"
    sizes = [part["correction"] for part in parts]
    if not any(
        size[name] and size[name][f"max_{unit}"] * factor >= least
        for size in sizes
        for name, unit, factor, least in _PARTS
    ):
        same = f"The model is the nominal arm: no command changes, and {output} has those of {targets}."
        yield Section(f"{title}: nothing to correct", [Text(same)])
        ahead = "fit a model to measured poses: robacc calibrate POSES --robot ROBOT --write-model MODEL"
    else:
        count = f"{sum(part['n_corrected'] for part in parts)} of {n_targets} targets corrected"
        yield Section(f"{title}: {count}", [Text(f"The commands are in {output}.", wraps=False)])
        for part in parts:
            yield from _errors_to_expect(part)
        ahead = (
            f"load {output}, measure the same targets again, and compare with the measurement before: "
            f"robacc compare --paired BEFORE.csv AFTER.csv --model {model}"
        )
    notes = dict.fromkeys(note for part in parts for note in part["notes"])
    yield Section("", [Listing([*notes]), Text(f"next: {ahead}")])


def correction_view(document: Document) -> Iterator[Section]:
    """Return the sections of a page, which lists the targets that are not corrected."""
    yield from _errors_to_expect(document)
    targets = zip(document["targets"]["line"], document["targets"]["reason"], strict=True)
    rows = [(str(line), reason) for line, reason in targets if reason is not None]
    more = Text(f"The first {_ROWS} of {len(rows)}." * (len(rows) > _ROWS))
    yield Section("Targets not corrected", [Grid(("line", "reason"), rows[:_ROWS], is_text=True), more])


def _errors_to_expect(document: Document) -> Iterator[Section]:
    """Return the corrections and the errors to expect, and how many targets are not corrected for which cause."""
    correction, expected = document["correction"], document["expected"]
    if document["n_corrected"]:
        rows = [_row(f"error {stage}", part, "expected_rms", "largest_bound95") for stage, part in expected.items()]
        rows.append(_row("change of the command", correction, "rms", "max"))
        columns = 5 if correction["orientation"] is not None else 3
        header = ("", "rms, mm", "at most, mm", "rms, °", "at most, °")
        grades = [
            f"{', '.join(f'{name} {number}' for name, number in counts.items() if number)} {stage}"
            for stage, part in expected.items()
            if (counts := part["grades"])
        ]
        frames = "base and tool frames" if document["frame"] == "measuring" else "base frame"
        texts = [
            f"error before: of the nominal arm in the {frames} of the model; it is smaller in the frames that fit the "
            "nominal arm best, which robacc calibrate and a registered estimate take",
        ]
        if grades:
            texts = [
                f"targets by grade: {'; '.join(grades)}",
                "at most: 95 % limit of the worst target",
                *texts,
            ]
        kind = "joint" if document["given"] == "joints" else "Cartesian"
        count = f"{document['n_corrected']} corrected {kind} target{'s' * (document['n_corrected'] > 1)}"
        yield Section(
            f"Errors to expect at {count}", [Grid(header[:columns], [row[:columns] for row in rows]), Listing(texts)]
        )
    refused = [(_CAUSES[cause], str(count)) for cause, count in document["refused"].items()]
    yield Section("", [Grid(("not corrected, kept as given", "targets"), refused)])


def _row(label: str, part: Part, typical: str, largest: str) -> Sequence[Cell]:
    cells: list[Cell] = [label]
    for name, unit, factor, least in _PARTS:
        for key in (typical, largest):
            size = (part[name] or {}).get(f"{key}_{unit}")
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
