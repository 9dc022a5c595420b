"""One of several files that ``robacc estimate`` was given: what a process of its own does with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from robacc.cli.options import Format
from robacc.cli.output import Outlets
from robacc.errors import InputError, Problem, RobaccError
from robacc.outcomes import EstimateHeadline, FileOutcome

if TYPE_CHECKING:
    from robacc.accuracy.pose_errors import ErrorFrame
    from robacc.api.estimate import Estimate
    from robacc.gates.evaluate import GateOutcome


class Asked(NamedTuple):
    """What is asked of every file alike, by the names that :func:`robacc.api.estimate.estimate` has for it."""

    robot: str | None
    align: tuple[str, ...]
    frame: ErrorFrame | None
    scale: str | None
    confidence: float
    ordered: bool
    base_link: str | None
    tip_link: str | None
    seed: int


class FileTask(NamedTuple):
    """One file, and where what becomes of it goes."""

    path: str
    name: str
    asked: Asked
    form: Format
    gate: str | None
    result: str | None
    """File for the result in the form that is wanted."""
    document: str | None
    """File for the result's JSON document, from which one of all files is put together."""
    per_pose: str | None


def estimate_one(task: FileTask) -> FileOutcome:
    """The estimate of one file, written where the task says; what is wrong with the file is an outcome too."""
    from robacc.api.estimate import estimate

    try:
        return _written(task, estimate(task.path, **task.asked._asdict()))
    except InputError as error:
        return FileOutcome(task.name, error.exit_status, problems=error.problems, n_problems=error.total)
    except RobaccError as error:
        problem = Problem(str(error), task.path)
        return FileOutcome(task.name, error.exit_status, problems=(problem,), n_problems=1)


def _written(task: FileTask, found: Estimate) -> FileOutcome:
    from robacc.documents.gate_files import read_gate
    from robacc.io.files import write_pieces, write_text
    from robacc.io.json_text import json_pieces

    outcome: GateOutcome | None = None
    document: Mapping[str, Any] = {}
    if task.gate is not None:
        document, outcome = found.gated(read_gate(task.gate))
    elif task.document is not None or task.form is Format.json:
        document = found.document()
    warnings = (*found.warnings, *(() if outcome is None else outcome.warnings))
    if task.per_pose is not None:
        write_text(task.per_pose, found.per_pose_csv())
    if task.document is not None:
        write_pieces(task.document, json_pieces(document))
    if task.result is not None:
        _write_result(task, task.result, found, document, outcome, warnings)
    return FileOutcome(
        task.name,
        0 if outcome is None else outcome.exit_status,
        _headline(found),
        warnings=warnings,
        gate=outcome,
        written=None if task.result is None else PurePath(task.result).name,
    )


def _write_result(
    task: FileTask,
    path: str,
    found: Estimate,
    document: Mapping[str, Any],
    outcome: GateOutcome | None,
    warnings: tuple[str, ...],
) -> None:
    """As the command on this file alone writes it."""
    from robacc.cli.output import with_gate, write_result

    def table(stream: TextIO) -> None:
        from robacc.render.text.estimate import draw_estimate

        draw_estimate(found, task.path, task.asked.robot, stream)

    write_result(
        Outlets(task.form, path),
        "estimate",
        document=lambda: document,
        table=table if outcome is None else with_gate(table, outcome, task.form),
        found=outcome,
        warnings=warnings,
    )


def _headline(found: Estimate) -> EstimateHeadline:
    position, orientation = found.position, found.orientation
    return EstimateHeadline(
        found.n_poses,
        position.rms,
        position.p95,
        position.max,
        None if orientation is None else orientation.rms,
        found.grade.grade,
        found.grade.demonstrated,
    )
