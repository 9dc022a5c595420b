"""What can go wrong with input, said so that the user can mend it.

The library raises these and never prints or exits; :mod:`robacc.cli` maps them to one red line and an exit status.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Counted = Literal["line", "row"]
"""What places in a file are counted in."""

MAX_PROBLEMS = 20


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong with one place of one file."""

    message: str
    """What was found and what was expected, in one sentence without a full stop."""
    file: str | None = None
    line: int | None = None
    """1-based line of the file, as an editor counts them."""
    column: str | None = None
    """Name of the CSV column, or dotted key of the YAML document (``joints[2].alpha``)."""
    fix: str | None = None
    """What to do about it."""
    row: int | None = None
    """1-based row of a table that has no lines, in place of ``line``."""

    @property
    def place(self) -> str:
        """``file:line, column`` or ``file, row 7, column``, as far as it is known."""
        whole = ":".join(str(part) for part in (self.file, self.line) if part is not None)
        row = None if self.row is None else f"row {self.row}"
        return ", ".join(part for part in (whole, row, self.column) if part)

    def __str__(self) -> str:
        """``place: message; fix``."""
        text = f"{self.place}: {self.message}" if self.place else self.message
        return f"{text}; {self.fix}" if self.fix else text


class RobaccError(Exception):
    """Root of every error that robacc raises on purpose."""

    exit_status = 1


class UsageError(RobaccError):
    """The command line or the call asks for something that does not exist or does not fit together (exit 2)."""

    exit_status = 2


class InputError(RobaccError):
    """A file, or the data in it, cannot be used (exit 3). Carries every problem found, not only the first."""

    exit_status = 3

    def __init__(self, problems: Sequence[Problem] | Problem | str, *, total: int | None = None) -> None:
        """Hold ``problems``; ``total`` counts those found when the list was cut at :data:`MAX_PROBLEMS`."""
        if isinstance(problems, str):
            problems = (Problem(problems),)
        elif isinstance(problems, Problem):
            problems = (problems,)
        self.problems: tuple[Problem, ...] = tuple(problems[:MAX_PROBLEMS])
        self.total = max(len(problems), total or 0)
        lines = [str(problem) for problem in self.problems]
        if self.total > len(self.problems):
            lines.append(f"… and {self.total - len(self.problems)} more problems")
        super().__init__("\n".join(lines))


class EquilibriumError(InputError):
    """A compliance is so large that the arm has no elastic equilibrium under its weight."""
