"""Estimate of one of several files, in a process of its own."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from robacc.cli.options import Format
from robacc.cli.output import Outlets
from robacc.errors import InputError, Problem, RobaccError
from robacc.outcomes import EstimateHeadline, FileOutcome

if TYPE_CHECKING:
    from robacc.accuracy.pose_errors import ErrorFrame
    from robacc.api.estimate import Estimate
    from robacc.api.model_use import CampaignUse
    from robacc.gates.evaluate import GateOutcome


class EstimateOptions(NamedTuple):
    """Options for every file, with the names of the parameters of :func:`robacc.api.estimate.estimate`."""

    robot: str | None
    align: tuple[str, ...] | None
    frame: ErrorFrame | None
    scale: str | None
    confidence: float
    ordered: bool
    ignore_limits: bool
    campaign: CampaignUse
    strict_range: bool
    base_link: str | None
    tip_link: str | None
    seed: int

    def recorded(self) -> dict[str, Any]:
        """Return the options of the JSON document; robot and scale stand among its inputs, the seed has its own key."""
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in self._asdict().items()
            if name not in ("robot", "scale", "seed")
        }


class FileTask(NamedTuple):
    """A file of poses, its options, and the files to write."""

    path: str
    name: str
    options: EstimateOptions
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
    started = time.perf_counter()
    return replace(_outcome_of(task), seconds=time.perf_counter() - started)


def _outcome_of(task: FileTask) -> FileOutcome:
    from robacc.api.estimate import estimate

    try:
        return _write_files(task, estimate(task.path, **task.options._asdict()))
    except InputError as error:
        return FileOutcome(task.name, error.exit_status, problems=error.problems, n_problems=error.total)
    except RobaccError as error:
        problem = Problem(str(error), task.path)
        return FileOutcome(task.name, error.exit_status, problems=(problem,), n_problems=1)


def _write_files(task: FileTask, result: Estimate) -> FileOutcome:
    from robacc.documents.gate_files import read_gate
    from robacc.io.files import write_pieces, write_text
    from robacc.io.json_text import json_pieces

    outcome: GateOutcome | None = None
    document: Mapping[str, Any] = {}
    if task.gate is not None:
        document, outcome = result.gated(read_gate(task.gate))
    elif task.document is not None or task.form is Format.json:
        document = result.document()
    warnings = (*result.warnings, *(() if outcome is None else outcome.warnings))
    if task.per_pose is not None:
        write_text(task.per_pose, result.per_pose_csv())
    if task.document is not None:
        write_pieces(task.document, json_pieces(document))
    if task.result is not None:
        _write_result(task, task.result, result, document, outcome, warnings)
    return FileOutcome(
        task.name,
        0 if outcome is None else outcome.exit_status,
        _headline(result),
        warnings=warnings,
        gate=outcome,
        written=None if task.result is None else PurePath(task.result).name,
    )


def _write_result(
    task: FileTask,
    path: str,
    result: Estimate,
    document: Mapping[str, Any],
    outcome: GateOutcome | None,
    warnings: tuple[str, ...],
) -> None:
    """Write the result as the command does for a single file."""
    from robacc.cli.output import with_gate, write_result

    def table(stream: TextIO) -> None:
        if task.full:
            from robacc.render.text.estimate import draw_estimate as draw
        else:
            from robacc.render.text.estimate_short import draw_short_estimate as draw
        draw(result, task.path, task.options.robot, stream)

    write_result(
        Outlets(task.form, path),
        "estimate",
        document=lambda: document,
        table=table if outcome is None else with_gate(table, outcome, task.form),
        outcome=outcome,
        warnings=warnings,
    )


def _headline(result: Estimate) -> EstimateHeadline:
    position, orientation = result.position, result.orientation
    return EstimateHeadline(
        result.n_poses,
        position.rms,
        position.p95,
        position.max,
        None if orientation is None else orientation.rms,
        result.grade.grade,
        result.grade.demonstrated,
    )
