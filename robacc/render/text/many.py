"""Many files as one table: a line a file, in the order in which they were named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TextIO

from robacc.outcomes import FileOutcome
from robacc.render.text.annotations import annotation
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.gate_text import WORDS, sentence, title
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items
from robacc.render.text.numbers import three_digits

_IN_MM = 1e3
_IN_DEGREES = 180.0 / math.pi
_LEVELS = {4: "error", 5: "warning"}
"""Of an annotation, by the exit status that a gate leaves."""


def draw_many(outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str], stream: TextIO) -> None:
    """Write the table of all files to ``stream``; ``robot`` is its file's name, ``aligned`` what was fitted first."""
    write_lines(many_lines(outcomes, robot, aligned, width_of(stream)), stream)


def many_lines(
    outcomes: Sequence[FileOutcome], robot: str | None, aligned: Sequence[str], width: int
) -> Iterator[TextLine]:
    """The report's lines."""
    how = f"{' and '.join(aligned)} aligned in each" if aligned else "nothing aligned"
    yield heading(f"Error of the poses in {len(outcomes)} files, {how}")
    yield TextLine(f"commanded by {'their cmd_ columns' if robot is None else robot}")
    yield BLANK
    yield from _table(outcomes)
    if told := [*_short_of(outcomes), *_uncounted(outcomes)]:
        yield from (BLANK, *items(told, width))


def _short_of(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    """Every criterion that a file does not pass."""
    for one in outcomes:
        for judged in one.gate.judged if one.gate is not None else ():
            if judged.outcome != "pass":
                yield f"{one.name}, {judged.criterion.name}: {WORDS[judged.outcome]}; {sentence(judged)}"


def _uncounted(outcomes: Sequence[FileOutcome]) -> Iterator[str]:
    if failed := sum(one.failed for one in outcomes):
        yield f"{failed} of {len(outcomes)} files could not be estimated"


def _table(outcomes: Sequence[FileOutcome]) -> list[TextLine]:
    turned = any(one.headline is not None and one.headline.orientation_rms is not None for one in outcomes)
    judged = any(one.gate is not None for one in outcomes)
    header = ["position error, mm", "poses", "rms", "95 %", "max", *(["rms, °"] if turned else [])]
    header += ["grade", "demonstrated", *(["gate"] if judged else [])]
    lines = columns(header, [_cells(one, turned, judged) for one in outcomes])
    start = max(len(header[0]), *(len(one.name) for one in outcomes)) + 2
    return [
        lines[0],
        *(
            TextLine(f"{one.name:<{start}}{reason(one)}", "bold") if one.failed else line
            for one, line in zip(outcomes, lines[1:], strict=True)
        ),
    ]


def _cells(one: FileOutcome, turned: bool, judged: bool) -> list[str]:
    found = one.headline
    if found is None:
        return [one.name]
    cells = [one.name, str(found.n_poses), *(three_digits(size * _IN_MM) for size in (found.rms, found.p95, found.max))]
    if turned:
        cells.append("–" if found.orientation_rms is None else three_digits(found.orientation_rms * _IN_DEGREES))
    cells += [found.grade, "yes" if found.demonstrated else "no"]
    return [*cells, *([WORDS[one.gate.outcome]] if one.gate is not None else ["–"] if judged else [])]


def reason(one: FileOutcome) -> str:
    """Why a file has no result, in one line."""
    first = one.problems[0]
    counted = next((f"{name} {number}" for name, number in (("line", first.line), ("row", first.row)) if number), "")
    place = ", ".join(part for part in (counted, first.column) if part)
    more = f" (and {one.n_problems - 1} more)" if one.n_problems > 1 else ""
    return f"failed: {f'{place}: ' if place else ''}{first.message}{more}"


def many_annotations(outcomes: Sequence[FileOutcome]) -> str:
    """A line a file for GitHub Actions: an error where it failed or its gate did, with its figures."""
    return "".join(f"{line}\n" for one in outcomes for line in _annotated(one))


def _annotated(one: FileOutcome) -> Iterator[str]:
    head = f"robacc estimate {one.name}"
    for warning in one.warnings:
        yield annotation("warning", head, warning)
    found = one.headline
    if found is None:
        yield annotation("error", head, reason(one))
        return
    sizes = zip(("rms", "95 %", "max"), (found.rms, found.p95, found.max), strict=True)
    parts = [f"{found.n_poses} poses", *(f"{name} {three_digits(size * _IN_MM)} mm" for name, size in sizes)]
    parts.append(f"grade {found.grade}, {'demonstrated' if found.demonstrated else 'not demonstrated'}")
    if one.gate is not None:
        parts.append(title(one.gate))
    yield annotation(_LEVELS.get(one.exit_status, "notice"), head, "; ".join(parts))
