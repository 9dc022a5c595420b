"""Keys of ``robacc.estimate-many/1``: an entry for each file, with its complete result."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robacc.documents.digits import significant_document
from robacc.documents.gate import gate_document
from robacc.errors import Problem
from robacc.io.json_text import json_text
from robacc.outcomes import EstimateHeadline, FileOutcome


def many_pieces(head: Mapping[str, Any], entries: Iterable[tuple[Mapping[str, Any], str | None]]) -> Iterator[str]:
    """Yield the document's text in pieces, so that memory holds no more than a line of a file's result.

    Args:
        head: Keys about all files; their ``results`` follow.
        entries: Keys about each file, and the path of its JSON result, which becomes its key ``result``.
    """
    yield json_text(head).removesuffix("\n}\n") + ',\n  "results": ['
    separator = "\n"
    for entry, path in entries:
        text = json_text(entry).removesuffix("\n}\n")
        yield separator + _indented(text, "    ")
        separator = ",\n"
        if path is not None:
            yield ',\n      "result": '
            with Path(path).open(encoding="utf-8") as lines:
                yield from _nested(lines, "      ")
        yield "\n    }"
    yield "\n  ]\n}\n"


def entry(outcome: FileOutcome) -> dict[str, Any]:
    """Return the keys about one file other than its result."""
    document: dict[str, Any] = significant_document(
        {
            "file": outcome.name,
            "done": not outcome.failed,
            "exit_status": outcome.exit_status,
            "problems": [_problem(problem) for problem in outcome.problems],
            "n_problems": outcome.n_problems,
            "summary": None if outcome.headline is None else _summary(outcome.headline),
            "gate": None if outcome.gate is None else gate_document(outcome.gate),
            "written": outcome.written,
        }
    )
    return document


def totals(outcomes: Sequence[FileOutcome]) -> dict[str, Any]:
    """Return the number of files, and the number of files that failed."""
    return {"n_files": len(outcomes), "n_failed": sum(outcome.failed for outcome in outcomes)}


def _summary(headline: EstimateHeadline) -> dict[str, Any]:
    return {
        "n_poses": headline.n_poses,
        "rms_m": headline.rms,
        "p95_m": headline.p95,
        "max_m": headline.max,
        "rms_rad": headline.orientation_rms,
        "grade": headline.grade,
        "demonstrated": headline.demonstrated,
    }


def _problem(problem: Problem) -> dict[str, Any]:
    """Return a problem without its file, whose path is private to this machine."""
    return {
        "message": problem.message,
        "line": problem.line,
        "row": problem.row,
        "column": problem.column,
        "fix": problem.fix,
    }


def _indented(text: str, indent: str) -> str:
    return indent + text.replace("\n", f"\n{indent}")


def _nested(lines: Iterable[str], indent: str) -> Iterator[str]:
    """Yield a document's lines without the last line end; all lines but the first are indented."""
    ending = ""
    for line in lines:
        yield ending + (indent if ending else "") + line.rstrip("\n")
        ending = "\n"
