"""What became of each of several files that a command was given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robacc.errors import Problem

if TYPE_CHECKING:
    from robacc.gates.evaluate import GateOutcome


@dataclass(frozen=True, slots=True)
class EstimateHeadline:
    """The figures of an estimate that stand in a table of many."""

    n_poses: int
    rms: float
    """Of the position error's length, m, as the next two."""
    p95: float
    max: float
    orientation_rms: float | None
    """rad"""
    grade: str
    demonstrated: bool


@dataclass(frozen=True, slots=True)
class FileOutcome:
    """One file: its figures, or why there are none."""

    name: str
    """No two alike: the file's, with as many of its folders as it takes."""
    exit_status: int
    """That of the command on this file alone."""
    headline: EstimateHeadline | None = None
    problems: tuple[Problem, ...] = ()
    n_problems: int = 0
    """Those found, of which ``problems`` are the first."""
    warnings: tuple[str, ...] = ()
    gate: GateOutcome | None = None
    written: str | None = None
    """Name of the file in the folder of results."""

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.headline is None


def exit_status(outcomes: list[FileOutcome]) -> int:
    """Of the command on all files: 1 a defect, 3 a file that could not be estimated, else the worst of the gates."""
    statuses = {one.exit_status for one in outcomes}
    if 1 in statuses:
        return 1
    if any(one.failed for one in outcomes):
        return 3
    return 4 if 4 in statuses else 5 if 5 in statuses else 0
