"""Everything that is wrong with one file, gathered before any of it is said."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robacc.errors import MAX_PROBLEMS, Counted, InputError, Problem

_MAX_KEPT = 1000
"""Problems met while reading that are kept: they come in the file's order, so the ones to show are among the first."""


class ProblemLog:
    """Collects the problems of one file: keeps enough to show, counts them all."""

    def __init__(self, file: str, counted: Counted = "line") -> None:
        """Problems added are of ``file``, whose lines, or for want of them rows, are counted."""
        self.file = file
        self.counted = counted
        self.total = 0
        self._kept: list[Problem] = []

    def add(self, message: str, line: int | None = None, column: str | None = None, fix: str | None = None) -> None:
        """Add one problem."""
        self.total += 1
        if self.total <= _MAX_KEPT:
            self._kept.append(self._problem(message, line, column, fix))

    def add_rows(
        self, bad: NDArray[np.bool_], lines: NDArray[np.int64], column: str, describe: Callable[[int], str]
    ) -> None:
        """Add a problem for each True of ``bad`` ``(N,)``; ``describe(i)`` says what row i has."""
        rows = np.flatnonzero(bad)
        self.total += rows.size
        for i in rows[:MAX_PROBLEMS]:
            self._kept.append(self._problem(describe(int(i)), int(lines[i]), column))

    def raise_if_any(self) -> None:
        """Raise InputError with the first problems in the order of their lines, if there is any."""
        if self.total:
            raise InputError(sorted(self._kept, key=lambda one: one.line or one.row or 0), total=self.total)

    def at(self, number: int | None) -> str:
        """The file and the line or row of that number, for a message."""
        return self._problem("", number).place

    def _problem(self, message: str, number: int | None, column: str | None = None, fix: str | None = None) -> Problem:
        if self.counted == "row":
            return Problem(message, self.file, None, column, fix, number)
        return Problem(message, self.file, number, column, fix)


def clip(text: str) -> str:
    """The text quoted for a message, cut where it is long."""
    return repr(text if len(text) <= 40 else text[:39] + "…")
