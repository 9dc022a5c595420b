"""``estimate``, ``calibrate`` and ``trace`` on several files: one result for each, and one table of all."""

import json
import os
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from robacc.api import HOMES
from robacc.cli import output
from robacc.cli.output import Outlets
from robacc.errors import InputError, Problem, RobaccError, refuse
from robacc.render.text import say, say_error, say_warnings
from robacc.workers import FileOutcome, WorkerKilled, Workers, cores

if TYPE_CHECKING:
    from robacc.api.inputs import Inputs

_SUFFIXES = {"table": ".txt", "json": ".json", "markdown": ".md", "github": ".txt"}
"""Suffix of the result of a file, by form."""


class FileTask(NamedTuple):
    """A file of poses, and the files to write."""

    path: str
    name: str
    outlets: Outlets
    """Form, gate and file of the result; no file if its name is empty."""
    document: str | None
    """File for the JSON document of the result, which becomes part of the document of all files."""
    extra: str | None
    """File for the error of each pose, or for the model of a fit."""


def process_file(command: str, options: Mapping[str, Any], full: bool, task: FileTask) -> FileOutcome:
    """Process a file and write its results, as the command does for a single file; an error becomes its outcome.

    ``options`` are the arguments of the call besides the poses.
    """
    from robacc.io.json_text import json_pieces

    started = time.perf_counter()
    try:
        call = getattr(import_module(f"robacc.{HOMES[command]}"), command)
        result = call(task.path, **options)
        document, gate, warnings = output.with_gate(result, task.outlets.gate)
        view, status = output.write_extra(command, result, task.extra, full, task.path, options["robot"])
        output.write(task.document, lambda: json_pieces(document()))
        if task.outlets.output:
            output.write_result(task.outlets, command, document, view, gate, warnings)
        status, written = (gate or {}).get("exit_status") or status, PurePath(task.outlets.output).name or None
        outcome = FileOutcome(task.name, status, result.summary(), warnings=warnings, gate=gate, written=written)
    except RobaccError as error:
        read = error if isinstance(error, InputError) else InputError(Problem(str(error), task.path))
        outcome = FileOutcome(task.name, error.exit_status, problems=read.problems, n_problems=read.total)
    return outcome._replace(seconds=time.perf_counter() - started)


def process_each(
    command: str, paths: Sequence[str], options: dict[str, Any], outlets: Outlets, extra: str | None, full: bool
) -> None:
    """Process every file, write the results, and exit with the worst status.

    Args:
        command: Name of the command and of its call.
        paths: The files, in the order of the table.
        options: Arguments for every file, and the number of jobs or the cluster that do the work.
        outlets: Forms and files; if the output is a folder, each result becomes a file in it.
        extra: Folder for the errors at each pose, or for the models of fits, one file for each file of poses.
        full: Write complete tables to the folder; the table of all files stays as it is.

    Raises:
        UsageError: the options fit no file.
        InputError: an input of all files cannot be read, or a result cannot be written.
        typer.Exit: a file could not be estimated (3), or its gate did not pass (4 or 5).
    """
    from robacc.api.result import effect_names

    workers, is_estimate = Workers(options.pop("jobs"), options.pop("cluster")), command == "estimate"
    if options.get("align") is not None:
        options["align"] = effect_names(options["align"])
    inputs = _check_call(paths, options, extra, "--per-pose" if is_estimate else "--write-model")
    folder, extra_folder = _folder(outlets.output), extra and _folder(extra)
    no_folder = f"several files need --output DIR/: {command} writes each result into a file of its own"
    refuse((not is_estimate and folder is None and (outlets.report or outlets.form == "json"), no_folder))
    needs_documents = outlets.report is not None or (outlets.form == "json" and folder is None)
    with TemporaryDirectory(prefix="robacc-") as documents:
        tasks = [
            FileTask(
                path,
                name,
                Outlets(outlets.gate, format=outlets.form, output=_target(folder, name, _SUFFIXES[outlets.form]) or ""),
                _target(documents if needs_documents else None, str(number), ".json"),
                _target(extra_folder, name, ".csv" if is_estimate else ".yaml"),
            )
            for number, (path, name) in enumerate(zip(paths, distinct_names(paths), strict=True))
        ]
        _check_targets(tasks)
        outcomes = _run(command, partial(process_file, command, options, full), tasks, workers, folder)
        warnings = _warnings(outcomes)
        try:
            _write(command, outcomes, tasks, inputs, outlets, folder, warnings)
        finally:
            say_warnings(warnings)
            for outcome in outcomes:
                if outcome.failed:
                    say_error(InputError(outcome.problems, total=outcome.n_problems))
            _say_tip(outcomes)
    # A defect, a file without a result, else the worst of the gates.
    statuses = {3 if outcome.exit_status == 2 else outcome.exit_status for outcome in outcomes}
    if status := min(statuses, key=(1, 3, 4, 5, 0).index):
        raise typer.Exit(status)


def _check_call(paths: Sequence[str], options: Mapping[str, Any], extra: str | None, name: str) -> "Inputs":
    """Return the inputs of all files; an error that concerns every file is raised once, before the first is read."""
    from robacc.accuracy.estimation import check_confidence
    from robacc.api.inputs import Inputs
    from robacc.fitting.registration import check_frames
    from robacc.poses.reading import reading_of

    sheet = options.get("contact_sheet") or reading_of(paths[0]).contact_sheet
    places = [os.path.realpath(path) for path in paths]
    refuse(
        (sheet, f"--contact-sheet {sheet}: shows the photos of one folder; give it with each folder alone"),
        ("-" in paths, "- (standard input) has no name for the table of several files; give it alone"),
        *((places[i] in places[:i], f"{path} is given twice; give each file once") for i, path in enumerate(paths)),
        (
            extra is not None and _folder(extra) is None,
            f"{name} {extra}: several files need a folder, whose name ends with /",
        ),
    )
    inputs = Inputs(options)
    inputs.optional_robot()
    if options.get("align"):
        check_frames(options["align"])
    if "confidence" in options:
        check_confidence(options["confidence"])
        inputs.scale()
    return inputs


def _folder(path: str) -> str | None:
    """Return the folder that an option names, or None for a file; a folder with / at its end is made."""
    from robacc.io.files import make_folder

    if path.endswith(("/", os.sep)):
        make_folder(path)
    return path if os.path.isdir(path) else None


def distinct_names(paths: Sequence[str]) -> list[str]:
    """Return the names of the files, with as many folders as make them distinct."""
    parts = [PurePath(os.path.normpath(path)).parts for path in paths]
    counts = Counter(own[-depth:] for own in parts for depth in range(1, len(own) + 1))
    return [
        "/".join(next((own[-depth:] for depth in range(1, len(own)) if counts[own[-depth:]] == 1), own))
        for own in parts
    ]


def _target(folder: str | None, name: str, suffix: str) -> str | None:
    stem = name.removesuffix(PurePath(name).suffix).replace("/", "-").lstrip("-.")
    return folder and os.path.join(folder, stem + suffix)


def _check_targets(tasks: Sequence[FileTask]) -> None:
    """Raise UsageError if a result would overwrite an input or another result."""
    written: dict[str, str] = {}
    inputs = {os.path.realpath(task.path) for task in tasks}
    targets = [(task.path, target) for task in tasks for target in (task.outlets.output, task.extra) if target]
    for path, target in targets:
        other = written.setdefault(os.path.realpath(target), path)
        both = f"the results of {other} and {path} would both be written to {target}"
        refuse(
            (
                os.path.realpath(target) in inputs,
                f"{target} is also an input and would be overwritten; name another folder",
            ),
            (other != path, f"{both}; rename one of the files"),
        )


def _run(
    command: str,
    process: Callable[[FileTask], FileOutcome],
    tasks: Sequence[FileTask],
    workers: Workers,
    folder: str | None,
) -> list[FileOutcome]:
    """Return the outcome of each file; without a number of jobs on each core, but on no more than the work is worth."""
    # In bytes of poses that take the same time: a file has a fixed cost of about 50 ms, starting a process of 400 ms.
    work = sum(3 * 2**20 + (os.path.getsize(task.path) if os.path.isfile(task.path) else 0) for task in tasks)
    workers = workers._replace(jobs=workers.jobs or max(1, min(cores(), 1 + work // (24 * 2**20))))
    outcomes: dict[int, FileOutcome] = {}
    try:
        with output.progress_bar() as progress:
            progress(command, 0, len(tasks))
            for number, outcome in workers.each(process, tasks):
                if isinstance(outcome, BaseException):
                    message, status = str(outcome), 3
                    if not isinstance(outcome, WorkerKilled):
                        traceback.print_exception(outcome)
                        message = "robacc crashed on this file, which is a defect of robacc; the traceback is above"
                        status = 1
                    problem = Problem(message, tasks[number].path)
                    outcome = FileOutcome(tasks[number].name, status, problems=(problem,), n_problems=1)
                outcomes[number] = outcome
                progress(command, len(outcomes), len(tasks))
    except KeyboardInterrupt:
        if folder is None or not outcomes:
            raise
        raise KeyboardInterrupt(f"{len(outcomes)} of {len(tasks)} results are in {folder}") from None
    return [outcomes[number] for number in range(len(tasks))]


def _say_tip(outcomes: Sequence[FileOutcome]) -> None:
    """Write what joins points and commands, if some files have one and some the other."""
    points, commands = (
        next((each.problems[0].file for each in outcomes if each.failed and text in each.problems[0].message), None)
        for text in ("measured poses only", "x, y, z are missing")
    )
    if points and commands:
        say(f"  tip: for points and commands in two files: robacc estimate {points} --commanded {commands}")


def _write(
    command: str,
    outcomes: Sequence[FileOutcome],
    tasks: Sequence[FileTask],
    inputs: "Inputs",
    outlets: Outlets,
    folder: str | None,
    warnings: tuple[str, ...],
) -> None:
    """Write the table of all files and the requested files."""
    from robacc.documents.accuracy import many_pieces
    from robacc.documents.envelope import InputFile
    from robacc.io.files import sha256_of
    from robacc.render.views.compare import many_annotations, many_view

    output.write_junit(outlets.junit, command, outcomes)
    documents = {
        task.name: task.document
        for outcome, task in zip(outcomes, tasks, strict=True)
        if not outcome.failed and task.document is not None
    }
    if outlets.report is not None and documents:
        from robacc.render.page import render

        read = [json.loads(Path(path).read_text(encoding="utf-8")) for path in documents.values()]
        output.write(outlets.report, render(read, [*documents]))
    place = outlets.output if folder is None else "-"
    if outlets.form == "json" and command == "estimate":
        # The full results are part of it, unless they have files of their own.
        counts = {"n_files": len(outcomes), "n_failed": sum(outcome.failed for outcome in outcomes)}
        whole = {} if folder else documents
        inputs.records += [InputFile.at(gate, sha256_of(gate), "gate") for gate in [outlets.gate] if gate is not None]
        head = inputs.made().document("estimate-many", counts)
        output.write(place, many_pieces(head, [(outcome, whole.get(outcome.name)) for outcome in outcomes]))
    elif outlets.form == "github":
        output.write(place, many_annotations(command, outcomes))
    else:
        aligned = inputs.arguments.get("align", ())
        view = partial(many_view, command, outcomes, inputs.arguments["robot"], aligned)
        own = Outlets(format="table" if outlets.form == "json" else outlets.form, output=place)
        output.write_result(own, command, dict, view, None, warnings)


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
