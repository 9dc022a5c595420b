"""``robacc estimate`` on several files: each in a process of its own, one result for each, and one table of all."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from robacc.cli import clock
from robacc.cli.options import Format, Outlets
from robacc.errors import InputError, Problem, RobaccError, UsageError
from robacc.outcomes import EstimateHeadline, FileOutcome, exit_status

if TYPE_CHECKING:
    from robacc.api.estimate import Estimate
    from robacc.gates.evaluate import GateOutcome
    from robacc.parallel import Died


# Estimate of one of several files, in a process of its own.


class FileTask(NamedTuple):
    """A file of poses, its options, and the files to write."""

    path: str
    name: str
    options: Mapping[str, Any]
    """Arguments of :func:`robacc.estimate` besides the poses."""
    form: Format
    gate: str | None
    result: str | None
    """File for the result in the requested form."""
    document: str | None
    """File for the JSON document of the result, which becomes part of the document of all files."""
    per_pose: str | None
    full: bool = False
    """Whether a table has covariances, tests, worst poses and limitations."""


def estimate_file(task: FileTask) -> FileOutcome:
    """Estimate a file and write its results; an error in the file becomes part of the outcome."""
    from robacc.api.estimate import estimate

    started = time.perf_counter()
    try:
        outcome = _write_files(task, estimate(task.path, **task.options))
    except RobaccError as error:
        read = error if isinstance(error, InputError) else InputError(Problem(str(error), task.path))
        outcome = FileOutcome(task.name, error.exit_status, problems=read.problems, n_problems=read.total)
    return replace(outcome, seconds=time.perf_counter() - started)


def _write_files(task: FileTask, result: Estimate) -> FileOutcome:
    """Write the files of a result, as the command does for a single file."""
    from robacc.cli.output import table_of, with_gate, write_result
    from robacc.documents.gate import read_gate
    from robacc.io.files import write_pieces, write_text
    from robacc.io.json_text import json_pieces

    outcome: GateOutcome | None = None
    document: Mapping[str, Any] = {}
    if task.gate is not None:
        document, outcome = result.gated(read_gate(task.gate))
    elif task.document is not None or task.form == "json":
        document = result.document()
    warnings = (*result.warnings, *(() if outcome is None else outcome.warnings))
    if task.per_pose is not None:
        write_text(task.per_pose, result.per_pose_csv())
    if task.document is not None:
        write_pieces(task.document, json_pieces(document))
    gate = document.get("gate")
    if task.result is not None:
        table = table_of(result, task.path, task.options["robot"], task.full)
        write_result(
            Outlets(format=task.form, output=task.result),
            "estimate",
            document=lambda: document,
            table=with_gate(table, gate, task.form) if gate else table,
            gate=gate,
            warnings=warnings,
        )
    position, orientation, grade = result.position, result.orientation, result.grade
    return FileOutcome(
        task.name,
        0 if outcome is None else outcome.exit_status,
        EstimateHeadline(
            result.n_poses,
            position.rms,
            position.p95,
            position.max,
            None if orientation is None else orientation.rms,
            grade.grade,
            grade.demonstrated,
        ),
        warnings=warnings,
        gate=gate,
        written=None if task.result is None else PurePath(task.result).name,
    )


_SUFFIXES = {"table": ".txt", "json": ".json", "markdown": ".md", "github": ".txt"}
"""Suffix of the result of a file, by form."""
_FILE_COST = 3 * 2**20
"""Fixed cost of a file, about 50 ms, in bytes of poses that take the same time."""
_PROCESS_COST = 24 * 2**20
"""Cost of starting a process, about 400 ms, in bytes of poses that take the same time."""


def estimate_each(
    paths: Sequence[str],
    options: Mapping[str, Any],
    outlets: Outlets,
    per_pose: str | None,
    jobs: int | None,
    *,
    full: bool = False,
) -> None:
    """Estimate every file, write the results, and exit with the worst status.

    Args:
        paths: The files, in the order of the table.
        options: Options for every file.
        outlets: Forms and files; if the output is a folder, each result becomes a file in it.
        per_pose: Folder for the errors at each pose, one file for each file of poses.
        jobs: Number of files at a time; None chooses it from the cores and the sizes of the files.
        full: Write complete tables to the folder; the table of all files stays as it is.

    Raises:
        UsageError: the options fit no file.
        InputError: an input of all files cannot be read, or a result cannot be written.
        typer.Exit: a file could not be estimated (3), or its gate did not pass (4 or 5).
    """
    import tempfile

    import typer

    _check_call(paths, options, per_pose)
    folder = _folder(outlets.output)
    with ExitStack() as stack:
        documents = None
        if outlets.report is not None or (outlets.form == "json" and folder is None):
            documents = stack.enter_context(tempfile.TemporaryDirectory(prefix="robacc-"))
        names = distinct_names(paths)
        tasks = [
            FileTask(
                path,
                name,
                options,
                outlets.form,
                outlets.gate,
                _target(folder, name, _SUFFIXES[outlets.form]),
                _target(documents, str(number), ".json"),
                _target(None if per_pose is None else _folder(per_pose), name, ".csv"),
                full,
            )
            for number, (path, name) in enumerate(zip(paths, names, strict=True))
        ]
        _check_targets(tasks)
        outcomes = _run(tasks, jobs or _jobs(paths), folder)
        try:
            _write(outcomes, tasks, outlets, folder)
        finally:
            _report_problems(outcomes)
    if status := exit_status(outcomes):
        raise typer.Exit(status)


def _check_call(paths: Sequence[str], options: Mapping[str, Any], per_pose: str | None) -> None:
    """Raise an error that concerns every file once, before the first file is read."""
    from robacc.accuracy.estimation import check_confidence
    from robacc.api.inputs import load_grade_scale, load_optional_robot
    from robacc.fitting.registration import check_frames

    if "-" in paths:
        raise UsageError("- (standard input) has no name for the table of several files; give it alone")
    places = [os.path.realpath(path) for path in paths]
    for i, path in enumerate(paths):
        if places[i] in places[:i]:
            raise UsageError(f"{path} is given twice; give each file once")
    if per_pose is not None and _folder(per_pose) is None:
        raise UsageError(f"--per-pose {per_pose}: several files need a folder, whose name ends with /")
    load_optional_robot(options["robot"], options["base_link"], options["tip_link"])
    if options["align"]:
        check_frames(options["align"])
    check_confidence(options["confidence"])
    load_grade_scale(options["scale"])


def _folder(path: str) -> str | None:
    """Return the folder that an option names, or None for a file; a folder with / at its end is made."""
    from robacc.io.files import make_folder

    if path.endswith(("/", os.sep)):
        make_folder(path)
        return path
    return path if os.path.isdir(path) else None


def distinct_names(paths: Sequence[str]) -> list[str]:
    """Return the names of the files, with as many folders as make them distinct."""
    parts = [PurePath(os.path.normpath(path)).parts for path in paths]
    depth = [1] * len(parts)
    while True:
        names = ["/".join(part[-count:]) for part, count in zip(parts, depth, strict=True)]
        counts = Counter(names)
        ambiguous = [i for i, name in enumerate(names) if counts[name] > 1 and depth[i] < len(parts[i])]
        if not ambiguous:
            return names
        for i in ambiguous:
            depth[i] += 1


def _target(folder: str | None, name: str, suffix: str) -> str | None:
    if folder is None:
        return None
    stem = name.removesuffix(PurePath(name).suffix)
    return os.path.join(folder, stem.replace("/", "-").lstrip("-.") + suffix)


def _check_targets(tasks: Sequence[FileTask]) -> None:
    """Raise UsageError if a result would overwrite an input or another result."""
    written: dict[str, str] = {}
    inputs = {os.path.realpath(task.path) for task in tasks}
    for task in tasks:
        for target in (task.result, task.per_pose):
            if target is None:
                continue
            place = os.path.realpath(target)
            if place in inputs:
                raise UsageError(f"{target} is also an input and would be overwritten; name another folder")
            if (other := written.setdefault(place, task.path)) != task.path:
                message = f"the results of {other} and {task.path} would both be written to {target}"
                raise UsageError(f"{message}; rename one of the files")


def _jobs(paths: Sequence[str]) -> int:
    """Return the number of processes: one for each core, but no more than the work is worth."""
    from robacc.parallel import usable_cores

    work = sum(_FILE_COST + (os.path.getsize(path) if os.path.isfile(path) else 0) for path in paths)
    return max(1, min(usable_cores(), len(paths), 1 + work // _PROCESS_COST))


def _run(tasks: Sequence[FileTask], jobs: int, folder: str | None) -> list[FileOutcome]:
    from robacc.cli.output import progress_bar
    from robacc.parallel import Died, each

    outcomes: dict[int, FileOutcome] = {}
    try:
        with progress_bar() as progress:
            progress("estimating", 0, len(tasks))
            for number, outcome in each(estimate_file, tasks, jobs):
                outcomes[number] = _crashed(tasks[number], outcome) if isinstance(outcome, Died) else outcome
                progress("estimating", len(outcomes), len(tasks))
    except KeyboardInterrupt:
        if folder is None or not outcomes:
            raise
        raise KeyboardInterrupt(f"{len(outcomes)} of {len(tasks)} results are in {folder}") from None
    return [outcomes[number] for number in range(len(tasks))]


def _crashed(task: FileTask, died: Died) -> FileOutcome:
    """Return the outcome of a file whose process ended before its work was done."""
    if 0 < died.exit_code < 128:
        message, status = "robacc crashed on this file, which is a defect of robacc; the traceback is above", 1
    else:
        message, status = "the process was killed, perhaps for lack of memory; try --jobs 1", 3
    return FileOutcome(task.name, status, problems=(Problem(message, task.path),), n_problems=1)


def _report_problems(outcomes: Sequence[FileOutcome]) -> None:
    """Write the warnings and errors of every file, in the order of the files."""
    from robacc.render.text import say, say_error, say_warnings

    say_warnings(_warnings(outcomes))
    for outcome in outcomes:
        if outcome.failed:
            say_error(InputError(outcome.problems, total=outcome.n_problems))
    points, commands = (
        next((one.problems[0].file for one in outcomes if one.failed and text in one.problems[0].message), None)
        for text in ("measured poses only", "x, y, z are missing")
    )
    if points and commands:
        say(f"  tip: for points and commands in two files: robacc estimate {points} --commanded {commands}")


def _write(outcomes: Sequence[FileOutcome], tasks: Sequence[FileTask], outlets: Outlets, folder: str | None) -> None:
    """Write the table of all files and the requested files."""
    from robacc.cli.output import emit, page_text, write
    from robacc.io.files import write_text
    from robacc.render.text import as_options
    from robacc.render.views.accuracy import many_annotations, many_view
    from robacc.render.views.elements import draw
    from robacc.render.views.gate import markdown

    options = tasks[0].options

    def table(stream: TextIO) -> None:
        draw(many_view(outcomes, options["robot"], options["align"]), stream)

    if outlets.junit is not None:
        from robacc.render.views.gate import junit

        write_text(outlets.junit, junit("estimate", outcomes, clock.started()))
    if outlets.report is not None and not all(outcome.failed for outcome in outcomes):
        from robacc.render.page import render

        done = [
            (json.loads(Path(task.document).read_text(encoding="utf-8")), task.name)
            for outcome, task in zip(outcomes, tasks, strict=True)
            if not outcome.failed and task.document is not None
        ]
        write_text(outlets.report, render([document for document, _ in done], [name for _, name in done]))
    output = outlets.output if folder is None else "-"
    if outlets.form == "json":
        write(output, _document(outcomes, tasks, folder))
    elif outlets.form == "markdown":
        write(output, (markdown("estimate", page_text(table), None, tuple(map(as_options, _warnings(outcomes)))),))
    elif outlets.form == "github":
        write(output, (many_annotations(outcomes),))
    else:
        emit("table", output, table=table, document=dict)


def _warnings(outcomes: Sequence[FileOutcome]) -> tuple[str, ...]:
    """Return the warnings of every file, with its name; one that several files share stands once, with their number."""
    texts = [
        (text.replace(outcome.name, ""), text if outcome.name in text else type(text)(f"{outcome.name}: {text}"))
        for outcome in outcomes
        for text in outcome.warnings
    ]
    count = Counter(key for key, _ in texts)
    return tuple(
        type(text)(f"{text} (the same in {count[key]} files)") if count[key] > 1 else text
        for key, text in dict(texts).items()
    )


def _document(outcomes: Sequence[FileOutcome], tasks: Sequence[FileTask], folder: str | None) -> Iterator[str]:
    """Yield the JSON document of all files; it has the full results unless they are in ``folder``."""
    from robacc.api.result import RECORDED_APART
    from robacc.documents.accuracy import many_pieces
    from robacc.documents.envelope import InputFile, envelope
    from robacc.io.files import sha256_of
    from robacc.modelling.robot_file import robot_path

    options = tasks[0].options
    robot = None if options["robot"] is None else robot_path(options["robot"])
    shared = ((robot, "robot"), (options["scale"], "scale"), (tasks[0].gate, "gate"))
    head = envelope(
        "estimate-many",
        {"n_files": len(outcomes), "n_failed": sum(outcome.failed for outcome in outcomes)},
        options={name: value for name, value in options.items() if name not in RECORDED_APART},
        inputs=[InputFile.at(path, sha256_of(path), kind) for path, kind in shared if path is not None],
        seed=options["seed"],
    )
    documents = (
        None if outcome.failed or folder is not None else task.document
        for outcome, task in zip(outcomes, tasks, strict=True)
    )
    return many_pieces(head, zip(outcomes, documents, strict=True))
