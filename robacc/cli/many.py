"""``robacc estimate`` on several files: each by itself, all at once, one table in the end."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, TextIO

from robacc.cli.many_work import Asked, FileTask, estimate_one
from robacc.cli.options import Format
from robacc.cli.output import Outlets
from robacc.errors import InputError, Problem, UsageError
from robacc.outcomes import FileOutcome, exit_status

if TYPE_CHECKING:
    from robacc.parallel import Died

_SUFFIXES = {Format.table: ".txt", Format.json: ".json", Format.markdown: ".md", Format.github: ".txt"}
"""Of a file's result in a folder of results."""
_OF_A_FILE = 3 * 2**20
"""Bytes of poses that take as long as what every file takes beside its poses, some 50 ms."""
_OF_A_PROCESS = 24 * 2**20
"""Bytes of poses that take as long as starting a process, some 400 ms."""


def estimate_each(paths: Sequence[str], asked: Asked, outlets: Outlets, per_pose: str | None, jobs: int | None) -> None:
    """Estimate every file, write the results, and end with the worst exit status.

    Args:
        paths: The files, in the order of the table.
        asked: Of each of them.
        outlets: What is wanted, and where; where the output is a folder, each result becomes a file in it.
        per_pose: Folder for each file's errors, pose by pose.
        jobs: Files at a time; None is as many as there are cores and the files are worth.

    Raises:
        UsageError: the call fits no file.
        InputError: what all files need cannot be read, or a result cannot be written.
        typer.Exit: a file could not be estimated (3), or its gate was not passed (4 or 5).
    """
    import tempfile

    import typer

    _check_call(paths, asked, per_pose)
    folder = _folder(outlets.output)
    with ExitStack() as stack:
        documents = None
        if outlets.report is not None or (outlets.form is Format.json and folder is None):
            documents = stack.enter_context(tempfile.TemporaryDirectory(prefix="robacc-"))
        names = distinct_names(paths)
        tasks = [
            FileTask(
                path,
                name,
                asked,
                outlets.form,
                outlets.gate,
                _target(folder, name, _SUFFIXES[outlets.form]),
                _target(documents, str(number), ".json"),
                _target(None if per_pose is None else _folder(per_pose), name, ".csv"),
            )
            for number, (path, name) in enumerate(zip(paths, names, strict=True))
        ]
        _check_targets(tasks)
        outcomes = _run(tasks, jobs or _jobs(paths), folder)
        _say(outcomes)
        _write(outcomes, tasks, outlets, folder)
    if status := exit_status(outcomes):
        raise typer.Exit(status)


def _check_call(paths: Sequence[str], asked: Asked, per_pose: str | None) -> None:
    """What is wrong for every file is said once, before the first of them."""
    from robacc.accuracy.estimation import check_call
    from robacc.api.inputs import load_grade_scale, load_optional_robot

    if "-" in paths:
        raise UsageError("standard input is one file and has no name for a table: give - alone")
    if len({os.path.realpath(path) for path in paths}) < len(paths):
        twice = next(path for number, path in enumerate(paths) if os.path.realpath(path) in _real(paths[:number]))
        raise UsageError(f"{twice} is given twice")
    if per_pose is not None and _folder(per_pose) is None:
        raise UsageError(f"--per-pose {per_pose}: of several files it is a folder; name one, with / at its end")
    arm, _ = load_optional_robot(asked.robot, asked.base_link, asked.tip_link)
    check_call(arm, asked.align, asked.confidence)
    load_grade_scale(asked.scale)


def _real(paths: Sequence[str]) -> set[str]:
    return {os.path.realpath(path) for path in paths}


def _folder(path: str) -> str | None:
    """The folder that an option names, which a / at its end makes where there is none; None where it is no folder."""
    from robacc.io.files import make_folder

    if path.endswith(("/", os.sep)):
        make_folder(path)
        return path
    return path if os.path.isdir(path) else None


def distinct_names(paths: Sequence[str]) -> list[str]:
    """The files' names, each with as many of its folders as tell it from the others."""
    parts = [PurePath(os.path.normpath(path)).parts for path in paths]
    depth = [1] * len(parts)
    while True:
        names = ["/".join(part[-count:]) for part, count in zip(parts, depth, strict=True)]
        times = Counter(names)
        alike = [number for number, name in enumerate(names) if times[name] > 1 and depth[number] < len(parts[number])]
        if not alike:
            return names
        for number in alike:
            depth[number] += 1


def _target(folder: str | None, name: str, suffix: str) -> str | None:
    if folder is None:
        return None
    stem = name.removesuffix(PurePath(name).suffix)
    return os.path.join(folder, stem.replace("/", "-").lstrip("-.") + suffix)


def _check_targets(tasks: Sequence[FileTask]) -> None:
    """Refuse to write two results into one file, or one over an input."""
    written: dict[str, str] = {}
    inputs = _real([task.path for task in tasks])
    for task in tasks:
        for target in (task.result, task.per_pose):
            if target is None:
                continue
            place = os.path.realpath(target)
            if place in inputs:
                raise UsageError(f"{target} is an input too, and would be overwritten; name another folder")
            if (other := written.setdefault(place, task.path)) != task.path:
                raise UsageError(f"{other} and {task.path} would both be written to {target}; rename one")


def _jobs(paths: Sequence[str]) -> int:
    """A process a core, as far as there is work that is worth starting it."""
    from robacc.parallel import usable_cores

    work = sum(_OF_A_FILE + (os.path.getsize(path) if os.path.isfile(path) else 0) for path in paths)
    return max(1, min(usable_cores(), len(paths), 1 + work // _OF_A_PROCESS))


def _run(tasks: Sequence[FileTask], jobs: int, folder: str | None) -> list[FileOutcome]:
    from robacc.cli.progress import progress_bar
    from robacc.parallel import Died, each

    outcomes: dict[int, FileOutcome] = {}
    try:
        with progress_bar() as progress:
            progress("estimating", 0, len(tasks))
            for number, outcome in each(estimate_one, tasks, jobs):
                outcomes[number] = _of_dead(tasks[number], outcome) if isinstance(outcome, Died) else outcome
                progress("estimating", len(outcomes), len(tasks))
    except KeyboardInterrupt:
        if folder is None or not outcomes:
            raise
        raise KeyboardInterrupt(f"{len(outcomes)} of {len(tasks)} results are in {folder}") from None
    return [outcomes[number] for number in range(len(tasks))]


def _of_dead(task: FileTask, died: Died) -> FileOutcome:
    """What to say of a file whose process ended before it was done."""
    if 0 < died.exit_code < 128:
        message, status = "robacc crashed on it, which is a defect; what it said stands above", 1
    else:
        message, status = "its process was ended from outside, perhaps for want of memory; try --jobs 1", 3
    return FileOutcome(task.name, status, problems=(Problem(message, task.path),), n_problems=1)


def _say(outcomes: Sequence[FileOutcome]) -> None:
    """Warnings and errors of every file, in the files' order."""
    from robacc.render.text.console import say_error, say_warnings

    say_warnings(_warnings(outcomes))
    for one in outcomes:
        if one.failed:
            say_error(InputError(one.problems, total=one.n_problems))


def _write(outcomes: Sequence[FileOutcome], tasks: Sequence[FileTask], outlets: Outlets, folder: str | None) -> None:
    """The overview of all files, and what else is wanted of all of them together."""
    from robacc.cli.output import page_text, write
    from robacc.io.files import write_text
    from robacc.render.text.many import draw_many, many_annotations
    from robacc.render.text.markdown import markdown

    asked = tasks[0].asked

    def table(stream: TextIO) -> None:
        draw_many(outcomes, asked.robot, asked.align, stream)

    if outlets.junit is not None:
        from robacc.render.text.junit import junit_of_files

        write_text(outlets.junit, junit_of_files("estimate", outcomes))
    if outlets.report is not None and not all(one.failed for one in outcomes):
        write_text(outlets.report, _page(outcomes, tasks))
    output = outlets.output if folder is None else "-"
    if outlets.form is Format.json:
        write(output, _document(outcomes, tasks, folder))
    elif outlets.form is Format.markdown:
        write(output, (markdown("estimate", page_text(table), None, _warnings(outcomes)),))
    elif outlets.form is Format.github:
        write(output, (many_annotations(outcomes),))
    elif output == "-":
        table(sys.stdout)
    else:
        write(output, (page_text(table),))


def _warnings(outcomes: Sequence[FileOutcome]) -> tuple[str, ...]:
    """Of every file, with its name."""
    return tuple(text if one.name in text else f"{one.name}: {text}" for one in outcomes for text in one.warnings)


def _document(outcomes: Sequence[FileOutcome], tasks: Sequence[FileTask], folder: str | None) -> Iterator[str]:
    """The JSON document of all files; with a folder the whole results are there, else in it."""
    from robacc.documents.envelope import InputFile, envelope
    from robacc.documents.many import entry, many_pieces, totals
    from robacc.io.files import sha256_of

    asked = tasks[0].asked
    shared = ((asked.robot, "robot"), (asked.scale, "scale"), (tasks[0].gate, "gate"))
    head = envelope(
        "estimate-many",
        totals(outcomes),
        options={
            "align": list(asked.align),
            "frame": asked.frame,
            "confidence": asked.confidence,
            "ordered": asked.ordered,
            "base_link": asked.base_link,
            "tip_link": asked.tip_link,
        },
        inputs=[InputFile.at(path, sha256_of(path), kind) for path, kind in shared if path is not None],
        seed=asked.seed,
    )
    whole = (
        None if one.failed or folder is not None else task.document for one, task in zip(outcomes, tasks, strict=True)
    )
    return many_pieces(head, zip(map(entry, outcomes), whole, strict=True))


def _page(outcomes: Sequence[FileOutcome], tasks: Sequence[FileTask]) -> str:
    """The page of all results side by side."""
    from robacc.render.html.page import render

    done = [task for one, task in zip(outcomes, tasks, strict=True) if not one.failed and task.document is not None]
    return render(
        [json.loads(Path(str(task.document)).read_text(encoding="utf-8")) for task in done],
        [task.name for task in done],
    )
