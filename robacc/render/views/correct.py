"""A correction and an export: corrections, the errors to expect, and what remains."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.text.layout import IN_DEGREES, IN_MM, Document, fixed, three_digits
from robacc.render.views.elements import Cell, Grid, Listing, Number, Section, Text, number

_CAUSES = {
    "unreached": "not reached by the nominal robot",
    "limit": "joint limit",
    "approach": "unknown direction of approach",
    "singular": "near a singular pose",
    "configuration": "another configuration",
    "too_large": "correction too large",
    "out_of_range": "outside the range of the model",
}
_STAGES = ("before", "after")
_ROWS = 40
"""Targets that are not corrected and that the page lists."""
_PARTS = (("position", "m", IN_MM, 1e-3), ("orientation", "rad", IN_DEGREES, 1e-4))
"""Quantity, unit, factor to mm or degrees, and the size below which the solver's tolerance decides, not the arm."""

Part = Mapping[str, Any]


def correction_view(
    parts: Sequence[Document], n_targets: int, names: tuple[str, str], output: str
) -> Iterator[Section]:
    """Return the text of a correction, of each kind of targets in turn.

    ``names`` are those of targets and model, ``output`` that of the file that was written.
    """
    targets, model = names
    title = f"Correction of {targets} by {model}"
    if all(_is_none(part["correction"]) for part in parts):
        same = f"The model is the nominal arm: no command changes, and {output} has those of {targets}."
        yield Section(f"{title}: nothing to correct", [Text(same)])
        ahead = "fit a model to measured poses: robacc calibrate POSES --robot ROBOT --write-model MODEL"
    else:
        count = f"{sum(part['n_corrected'] for part in parts)} of {n_targets} targets corrected"
        yield Section(f"{title}: {count}", [Text(f"The commands are in {output}.", wraps=False)])
        for part in parts:
            yield from correction_sections(part)
        ahead = (
            f"load {output}, measure the same targets again, and compare with the measurement before: "
            f"robacc compare --paired BEFORE.csv AFTER.csv --model {model}"
        )
    notes = dict.fromkeys(note for part in parts for note in part["notes"])
    yield Section("", [Listing([*notes]), Text(f"next: {ahead}")])


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
        rows = [_row(f"error {stage}", expected[stage], "expected_rms", "largest_bound95") for stage in _STAGES]
        rows.append(_row("change of the command", correction, "rms", "max"))
        columns = 5 if correction["orientation"] is not None else 3
        header = ("", "rms, mm", "at most, mm", "rms, °", "at most, °")
        grades = [
            f"{', '.join(f'{name} {number}' for name, number in counts.items() if number)} {stage}"
            for stage in _STAGES
            if (counts := expected[stage]["grades"])
        ]
        frames = "base and tool frames" if document["frame"] == "measuring" else "base frame"
        texts = [
            f"error before: of the nominal arm in the {frames} of the model; robacc estimate and robacc calibrate fit "
            "the frames to the nominal arm alone, so that their figure is smaller",
        ]
        if grades:
            most = "error at most: at every target, 95 % of the errors are smaller"
            texts = [f"targets by grade: {'; '.join(grades)}", most, *texts]
        kind = "joint" if document["given"] == "joints" else "Cartesian"
        count = f"{document['n_corrected']} corrected {kind} target{'s' * (document['n_corrected'] > 1)}"
        yield Section(
            f"Errors to expect at {count}", [Grid(header[:columns], [row[:columns] for row in rows]), Listing(texts)]
        )
    if document["refused"]:
        refused = [(_CAUSES[cause], str(count)) for cause, count in document["refused"].items()]
        yield Section("", [Grid(("not corrected, by cause", "targets"), refused)])


def _is_none(correction: Part) -> bool:
    """Return whether no command changes."""
    return all(
        correction[name] is None or correction[name][f"max_{unit}"] * factor < least
        for name, unit, factor, least in _PARTS
    )


def _row(label: str, part: Part, typical: str, largest: str) -> Sequence[Cell]:
    cells: list[Cell] = [label]
    for name, unit, factor, least in _PARTS:
        for key in (typical, largest):
            size = (part[name] or {}).get(f"{key}_{unit}")
            is_small = size is not None and size * factor < least
            cells.append(Number(f"< {least:g}", size) if is_small else number(size, factor))
    return cells


_LEAST = 1e-4
"""Smallest error of an export that is shown as a number, mm or degrees: below it, the digits of the file decide."""


def export_view(result: Document) -> Iterator[Section]:
    """Return what the file of an export holds, the error that remains in it, and the tool to set."""
    remaining, tool = result["remaining_error"], result["tool"]
    place = ", ".join(fixed(IN_MM * value, 4) for value in tool["xyz_m"])
    turn = ", ".join(fixed(IN_DEGREES * value, 5) for value in tool["rpy_rad"])
    rows = [
        ("fitted again to", ", ".join(result["refitted"])),
        ("not in the format", ", ".join(result["not_carried"])),
        ("remaining error", f"position {_sizes(remaining['position'], 'm', IN_MM, ' mm')};"),
        ("", f"orientation {_sizes(remaining['orientation'], 'rad', IN_DEGREES, '°')};"),
        ("", f"over {remaining['n_poses']} poses within the joint limits"),
        ("tool to set", f"x, y, z {place} mm"),
        ("", f"roll, pitch, yaw {turn}°"),
    ]
    arm = f" of {result['arm']}" if result["arm"] else ""
    yield Section(f"Export as {result['format']}{arm}", [Grid(("", ""), [row for row in rows if row[1]], is_text=True)])


def _sizes(errors: Mapping[str, float], unit: str, factor: float, name: str) -> str:
    sizes = (errors[f"{key}_{unit}"] * factor for key in ("rms", "max"))
    rms, largest = (three_digits(size) if size >= _LEAST else f"< {_LEAST:g}" for size in sizes)
    return f"{rms}{name} rms, {largest}{name} largest"
