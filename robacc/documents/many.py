"""Results of many files as the keys of ``robacc.estimate-many/1``: an entry a file, with its whole result in it."""

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
    """The document's text in pieces, so that no more than a line of a file's result is held at a time.

    Args:
        head: What the document says of all files; their ``results`` come after it.
        entries: What is said of each file, and the path of its JSON result, which becomes its key ``result``.
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


def entry(one: FileOutcome) -> dict[str, Any]:
    """What is said of one file beside its result."""
    document: dict[str, Any] = significant_document(
        {
            "file": one.name,
            "done": not one.failed,
            "exit_status": one.exit_status,
            "problems": [_problem(problem) for problem in one.problems],
            "n_problems": one.n_problems,
            "summary": None if one.headline is None else _summary(one.headline),
            "gate": None if one.gate is None else gate_document(one.gate),
            "written": one.written,
        }
    )
    return document


def totals(outcomes: Sequence[FileOutcome]) -> dict[str, Any]:
    """How many files there were, and how many came to nothing."""
    return {"n_files": len(outcomes), "n_failed": sum(one.failed for one in outcomes)}


def _summary(found: EstimateHeadline) -> dict[str, Any]:
    return {
        "n_poses": found.n_poses,
        "rms_m": found.rms,
        "p95_m": found.p95,
        "max_m": found.max,
        "rms_rad": found.orientation_rms,
        "grade": found.grade,
        "demonstrated": found.demonstrated,
    }


def _problem(problem: Problem) -> dict[str, Any]:
    """Without the file, whose place on this machine is nobody's business."""
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
    """A document's lines but for the last one's end, all behind the first set in."""
    ending = ""
    for line in lines:
        yield ending + (indent if ending else "") + line.rstrip("\n")
        ending = "\n"
