"""Errors of input and of calls: each says what happened, where, and what to do.

The library raises these and never prints or exits; :mod:`robacc.cli` maps them to one red line and an exit status. A
message names a parameter of the call in backquotes, as its signature spells it; the command line shows it as an option.
"""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

Value = TypeVar("Value")
Key = TypeVar("Key", bound=Hashable)
Counted = Literal["line", "row", "photo", "pose"]
"""Unit that places in a file are counted in."""

MAX_PROBLEMS = 20
"""Problems that one error carries at most."""
LISTED = 10
"""Names, or numbers of rows, that a message lists at most; the others are counted."""


@dataclass(frozen=True, slots=True)
class Problem:
    """A defect at one place of one file."""

    message: str
    """The value in the file and the expected value, in one sentence without a full stop."""
    file: str | None = None
    line: int | None = None
    """1-based line of the file, as an editor counts them."""
    column: str | None = None
    """Name of the CSV column, or dotted key of the YAML document (``joints[2].alpha``)."""
    fix: str | None = None
    """Advice on how to correct it."""
    row: int | None = None
    """1-based row of a table that has no lines, in place of ``line``."""

    @property
    def place(self) -> str:
        """``file:line, column`` or ``file, row 7, column``, as far as it is known."""
        position = ":".join(str(part) for part in (self.file, self.line) if part is not None)
        row = None if self.row is None else f"row {self.row}"
        return ", ".join(part for part in (position, row, self.column) if part)

    def __str__(self) -> str:
        """Return ``place: message; fix``."""
        text = f"{self.place}: {self.message}" if self.place else self.message
        return f"{text}; {self.fix}" if self.fix else text


class Note(str):
    """How an input was read, which the command line shows dim; other warnings say that a figure may be wrong."""


class RobaccError(Exception):
    """Base of every error that robacc raises on purpose."""

    exit_status = 1
    """Status that the command line exits with."""


class UsageError(RobaccError):
    """A call asks for something that does not exist, or its arguments contradict each other (exit 2)."""

    exit_status = 2


def refuse(*cases: tuple[object, str | Problem | Sequence[Problem]], error: type[Exception] = UsageError) -> None:
    """Raise the error of the first case that holds: ``error`` with its text, or InputError with its problems."""
    for holds, reason in cases:
        if holds:
            raise error(reason) if isinstance(reason, str) else InputError(reason)


def applying(*cases: tuple[object, Value]) -> tuple[Value, ...]:
    """Return the texts, or other values, of the cases that apply; the case ``(True, …)`` always does."""
    return tuple(value for applies, value in cases if applies)


def by_key(pairs: Iterable[tuple[Key, Value]]) -> dict[Key, list[Value]]:
    """Return the values of each key, keys and values in the order in which they come."""
    groups: dict[Key, list[Value]] = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


def listing(names: Sequence[object], most: int = 6) -> str:
    """Return the names separated by commas, the others beyond ``most`` counted."""
    return ", ".join(map(str, names[:most])) + (f" and {len(names) - most} more" if len(names) > most else "")


def given(value: Value | None, reason: str | Problem, error: type[Exception] = UsageError) -> Value:
    """Return a value; None raises the error of :func:`refuse` with this reason."""
    if value is None:
        raise error(reason) if isinstance(reason, str) else InputError(reason)
    return value


class MissingColumnError(UsageError):
    """The poses lack a column that an effect depends on."""


class InputError(RobaccError):
    """A file, or the data in it, cannot be used (exit 3). Carries every problem, not only the first."""

    exit_status = 3

    def __init__(self, problems: Sequence[Problem] | Problem | str, *, total: int | None = None) -> None:
        """Store at most :data:`MAX_PROBLEMS` problems; ``total`` counts those before the list was cut."""
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
    """The arm has no elastic equilibrium under its weight, because a compliance is too large."""


def install_advice(extra: str) -> str:
    """Return how to install an extra; robacc comes from a checkout or a Git URL, not from an index."""
    return (
        f"pip install '.[{extra}]' in a checkout, or pip install 'robacc[{extra}] @ git+URL' with the repository's URL"
    )
