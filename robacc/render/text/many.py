"""Several files in one table: one line per file, in the order given."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.outcomes import FileOutcome
from robacc.render.text.annotations import annotation
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.gate_text import OUTCOME_LABELS, sentence, title
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items
from robacc.render.text.numbers import three_digits
from robacc.render.text.parameter_names import as_options
from robacc.render.text.units import IN_DEGREES, IN_MM

_LEVELS = {4: "error", 5: "warning"}
"""Level of an annotation by the exit status of a gate."""


def draw_many(
    outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str] | None, stream: TextIO
) -> None:
    """Write the table of all files to ``stream``; ``robot`` is a file name, ``aligned`` the effects fitted first."""
    write_lines(many_lines(outcomes, robot, aligned, width_of(stream)), stream)


def many_lines(
    outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str] | None, width: int
) -> Iterator[TextLine]:
    """Return the report's lines."""
    alignment = f"registered: {' and '.join(aligned)} fitted in each" if aligned else "not registered"
    alignment = "registered where the frames do not agree" if aligned is None else alignment
    yield heading(f"Pose errors in {len(outcomes)} files, {alignment}")
    yield TextLine(f"against {'their cmd_ columns' if robot is None else f'the model {robot}'}")
    yield BLANK
    yield from _table(outcomes)
    if notes := [*_unmet_criteria(outcomes), *_failures(outcomes)]:
        yield from (BLANK, *items(notes, width))


def _unmet_criteria(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    """Return a line for each criterion that a file does not pass."""
    for outcome in outcomes:
        for evaluation in outcome.gate.evaluations if outcome.gate is not None else ():
            if evaluation.outcome != "pass":
                label = OUTCOME_LABELS[evaluation.outcome]
                yield f"{outcome.name}, {evaluation.criterion.name}: {label}; {sentence(evaluation)}"


def _failures(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    if failed := sum(outcome.failed for outcome in outcomes):
        yield f"{failed} of {len(outcomes)} files could not be estimated"


def _table(outcomes: Sequence[FileOutcome]) -> list[TextLine]:
    has_orientation = any(
        outcome.headline is not None and outcome.headline.orientation_rms is not None for outcome in outcomes
    )
    has_gate = any(outcome.gate is not None for outcome in outcomes)
    header = ["position error, mm", "poses", "rms", "95th pct.", "max", *(["rms, °"] if has_orientation else [])]
    header += ["grade", "confirmed", *(["gate"] if has_gate else [])]
    lines = columns(header, [_cells(outcome, has_orientation, has_gate) for outcome in outcomes])
    start = max(len(header[0]), *(len(outcome.name) for outcome in outcomes)) + 2
    return [
        lines[0],
        *(
            TextLine(f"{outcome.name:<{start}}{reason(outcome)}", "bold") if outcome.failed else line
            for outcome, line in zip(outcomes, lines[1:], strict=True)
        ),
    ]


def _cells(outcome: FileOutcome, has_orientation: bool, has_gate: bool) -> list[str]:
    headline = outcome.headline
    if headline is None:
        return [outcome.name]
    cells = [
        outcome.name,
        str(headline.n_poses),
        *(three_digits(size * IN_MM) for size in (headline.rms, headline.p95, headline.max)),
    ]
    if has_orientation:
        cells.append("–" if headline.orientation_rms is None else three_digits(headline.orientation_rms * IN_DEGREES))
    cells += [headline.grade, "yes" if headline.demonstrated else "no"]
    return [
        *cells,
        *([OUTCOME_LABELS[outcome.gate.outcome]] if outcome.gate is not None else ["–"] if has_gate else []),
    ]


def reason(outcome: FileOutcome) -> str:
    """Return the reason why a file has no result, in one line."""
    first = outcome.problems[0]
    counted = next((f"{name} {number}" for name, number in (("line", first.line), ("row", first.row)) if number), "")
    place = ", ".join(part for part in (counted, first.column) if part)
    others = f" (and {outcome.n_problems - 1} more)" if outcome.n_problems > 1 else ""
    return f"failed: {f'{place}: ' if place else ''}{as_options(first.message)}{others}"


def many_annotations(outcomes: Sequence[FileOutcome]) -> str:
    """Return one annotation of GitHub Actions per file, an error for a failed file or gate."""
    return "".join(f"{line}\n" for outcome in outcomes for line in _annotated(outcome))


def _annotated(outcome: FileOutcome) -> Iterator[str]:
    head = f"robacc estimate {outcome.name}"
    for warning in outcome.warnings:
        yield annotation("warning", head, warning)
    headline = outcome.headline
    if headline is None:
        yield annotation("error", head, reason(outcome))
        return
    sizes = zip(("rms", "95th pct.", "max"), (headline.rms, headline.p95, headline.max), strict=True)
    parts = [f"{headline.n_poses} poses", *(f"{name} {three_digits(size * IN_MM)} mm" for name, size in sizes)]
    parts.append(f"grade {headline.grade}, {'confirmed' if headline.demonstrated else 'not confirmed'}")
    if outcome.gate is not None:
        parts.append(title(outcome.gate))
    yield annotation(_LEVELS.get(outcome.exit_status, "notice"), head, "; ".join(parts))
