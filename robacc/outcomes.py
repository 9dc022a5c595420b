"""Outcome of each file, where a command processes several files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from robacc.errors import Problem


class FileOutcome(NamedTuple):
    """Outcome of a file: its main figures, or the problems that prevented it."""

    name: str
    """Unique name: the file's, with as many of its folders as needed."""
    exit_status: int
    """Exit status of the command on this file alone."""
    summary: Mapping[str, Any] | None = None
    """Main figures of the estimate, by their keys in a document."""
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
        return self.summary is None
