"""Outcome of each file, where a command processes several files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robacc.errors import Problem


@dataclass(frozen=True, slots=True)
class EstimateHeadline:
    """Metrics of an estimate that the table of several files shows."""

    n_poses: int
    rms: float
    """RMS of the position error's length, m; the next two are of the length too."""
    p95: float
    max: float
    orientation_rms: float | None
    """rad"""
    grade: str
    demonstrated: bool


@dataclass(frozen=True, slots=True)
class FileOutcome:
    """Outcome of a file: its headline, or the problems that prevented it."""

    name: str
    """Unique name: the file's, with as many of its folders as needed."""
    exit_status: int
    """Exit status of the command on this file alone."""
    headline: EstimateHeadline | None = None
    problems: tuple[Problem, ...] = ()
    n_problems: int = 0
    """Number of problems, of which ``problems`` are the first."""
    warnings: tuple[str, ...] = ()
    gate: Mapping[str, Any] | None = None
    written: str | None = None
    """Name of the file in the folder of results."""
    seconds: float = 0.0
    """Elapsed time of the work on this file."""

    @property
    def failed(self) -> bool:
        """True where there is no result."""
        return self.headline is None


def exit_status(outcomes: list[FileOutcome]) -> int:
    """Return the exit status for all files: 1 a defect, 3 a file without a result, else the worst of the gates."""
    statuses = {outcome.exit_status for outcome in outcomes}
    if 1 in statuses:
        return 1
    if any(outcome.failed for outcome in outcomes):
        return 3
    return 4 if 4 in statuses else 5 if 5 in statuses else 0
