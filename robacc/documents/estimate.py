"""Keys of ``robacc.estimate/1`` and ``robacc.estimate-many/1`` in m and rad, and the errors of every pose as CSV."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robacc.accuracy.estimation import EstimateResult, WorstPose
from robacc.accuracy.pose_errors import ErrorFrame, FrameStatistics
from robacc.documents.envelope import csv_cell, csv_text, significant_document
from robacc.documents.parts import (
    figures_document,
    grade_document,
    parameters_document,
    pose_document,
    robot_document,
    rounded,
    statistics_document,
)
from robacc.errors import Problem
from robacc.geometry import Array
from robacc.io.json_text import json_text
from robacc.measurements import Measurements
from robacc.outcomes import EstimateHeadline, FileOutcome
from robacc.quantities import number_text
from robacc.robots.description import Robot


def payload(result: EstimateResult) -> dict[str, Any]:
    """Return the keys of the estimate; arrays stay arrays, which :mod:`robacc.io.json_text` writes."""
    orientation = None
    if result.orientation is not None and result.errors.rotation is not None:
        orientation = {**statistics_document(result.orientation), "errors_rad": result.errors.rotation.T}
    return {
        "n_poses": result.n_poses,
        "frame": result.errors.frame,
        "commanded": result.commanded,
        "alignment": _alignment(result),
        "unaligned": _unaligned(result),
        "position": {**statistics_document(result.position), "errors_m": result.errors.position.T},
        "orientation": orientation,
        "grade": grade_document(result.grade),
        "worst_poses": {
            "by_position": [_worst(pose) for pose in result.worst_position],
            "by_orientation": [_worst(pose) for pose in result.worst_orientation],
        },
        "targets": [
            {"target": target.name, "n_poses": target.n_poses, **figures_document(target.position, "m")}
            for target in result.targets
        ],
        "notes": result.notes,
        "warnings": result.warnings,
    }


def pose_payload(
    data: Measurements,
    robot: Robot | None,
    registered: Robot | None,
    by_frame: Mapping[ErrorFrame, FrameStatistics],
) -> dict[str, Any]:
    """Return the keys of the data: measurement noise, robot, every pose, and position errors in both frames."""
    return {
        "noise": _noise(data),
        "robot": robot_document(robot, data.q, registered),
        "poses": pose_document(data, data.position - by_frame["base"].errors),
        "position_by_frame": {
            frame: {
                "mean_m": statistics.mean,
                "covariance_m2": statistics.covariance,
                "centred_covariance_m2": statistics.centred,
                "errors_m": rounded(statistics.errors),
            }
            for frame, statistics in by_frame.items()
        },
    }


def _noise(data: Measurements) -> dict[str, Any] | None:
    """Return the measurement noise that the file states, RMS over poses for each axis; None if it states none."""
    if data.sigma_position is None and data.sigma_rotation is None:
        return None
    position, rotation = data.stated_noise
    return {"position_m": position, "orientation_rad": rotation, "source": "file"}


def per_pose_csv(result: EstimateResult, data: Measurements) -> str:
    """Return a CSV row for each pose: its line, its ids, the error vector and its length, in m and rad."""
    columns: dict[str, Iterable[str]] = {"line": (str(data.line(i)) for i in range(data.n))}
    for name in ("pose", "cycle", "visit", "target"):
        ids = getattr(data, name)
        if ids is not None:
            columns[name] = (csv_cell(str(value)) for value in ids)
    columns |= _error_columns(("dx_m", "dy_m", "dz_m", "error_m"), result.errors.position)
    if result.errors.rotation is not None:
        columns |= _error_columns(("rx_rad", "ry_rad", "rz_rad", "error_rad"), result.errors.rotation)
    return csv_text(columns)


def _error_columns(names: tuple[str, ...], errors: Array) -> dict[str, Iterable[str]]:
    size = np.sqrt(np.einsum("in,in->n", errors, errors))
    return {name: map(number_text, values.tolist()) for name, values in zip(names, (*errors, size), strict=True)}


def _alignment(result: EstimateResult) -> dict[str, Any] | None:
    if result.alignment is None:
        return None
    return {
        "what": result.alignment.effects,
        "n_parameters": result.alignment.n_parameters,
        "parameters": parameters_document(result.alignment.parameters),
    }


def _unaligned(result: EstimateResult) -> dict[str, Any] | None:
    if result.unaligned is None:
        return None
    orientation = result.unaligned.orientation
    return {
        "position": figures_document(result.unaligned.position, "m"),
        "orientation": None if orientation is None else figures_document(orientation, "rad"),
    }


def _worst(pose: WorstPose) -> dict[str, Any]:
    return {
        "line": pose.line,
        "place": pose.place,
        "pose": pose.pose,
        "target": pose.target,
        "error_m": pose.position,
        "error_rad": pose.orientation,
    }


# Keys of ``robacc.estimate-many/1``: an entry for each file, with its complete result.


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
            "gate": outcome.gate,
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
