"""Problems of one file, collected so that one error reports them all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robacc.errors import MAX_PROBLEMS, Counted, InputError, Problem

_MAX_STORED = 1000
"""Problems stored while reading: they come in the file's order, so the first ones are those to report."""


class ProblemLog:
    """Problems of one file: stores enough to report, counts them all."""

    def __init__(self, file: str, counted: Counted = "line") -> None:
        """Collect problems of ``file``; places in it are counted in lines, or in rows where it has no lines."""
        self.file = file
        self.counted = counted
        self.total = 0
        self._problems: list[Problem] = []

    def add(self, message: str, line: int | None = None, column: str | None = None, fix: str | None = None) -> None:
        """Add a problem."""
        self.total += 1
        if self.total <= _MAX_STORED:
            self._problems.append(self._problem(message, line, column, fix))

    def add_rows(
        self,
        bad: NDArray[np.bool_],
        lines: NDArray[np.int64],
        column: str,
        describe: Callable[[int], str],
        fix: str | None = None,
    ) -> None:
        """Add a problem for each True of ``bad`` ``(N,)``; ``describe(i)`` returns the message of row i.

        The first of them has the ``fix``.
        """
        rows = np.flatnonzero(bad)
        self.total += rows.size
        for i in rows[:MAX_PROBLEMS]:
            self._problems.append(self._problem(describe(int(i)), int(lines[i]), column, fix if i == rows[0] else None))

    def raise_if_any(self) -> None:
        """Raise an error where there is a problem.

        Raises:
            InputError: The first problems in the order of their lines.
        """
        if self.total:
            ordered = sorted(self._problems, key=lambda problem: problem.line or problem.row or 0)
            raise InputError(ordered, total=self.total)

    @property
    def problems(self) -> tuple[Problem, ...]:
        """The problems so far, as far as they are stored."""
        return tuple(self._problems)

    def at(self, number: int | None) -> str:
        """Return the file and its line or row ``number``, for a message."""
        return self._problem("", number).place

    def _problem(self, message: str, number: int | None, column: str | None = None, fix: str | None = None) -> Problem:
        if self.counted == "row":
            return Problem(message, self.file, None, column, fix, number)
        return Problem(message, self.file, number, column, fix)


def clip(text: str) -> str:
    """Return the text in quotes for a message, cut to 40 characters."""
    return repr(text if len(text) <= 40 else text[:39] + "…")
