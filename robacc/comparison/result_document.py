"""Typed access to the JSON document of a stored result, by path; problems are collected."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Problem
from robacc.geometry import Array

_LARGEST = 1e9
"""m or rad: every joint, position and error is smaller; the square of a much larger number overflows."""

MOST_POSES = 10**8
"""Largest number of poses of a file; a larger one would fill the memory before its mismatch is noticed."""


@dataclass(frozen=True, slots=True)
class ResultDocument:
    """JSON document of a result; dots join the keys of a path, and a number is an index into a list."""

    root: Mapping[str, Any]
    file: str
    problems: list[Problem] = field(default_factory=list)

    def report(self, path: str, message: str) -> None:
        """Add a problem at a path."""
        self.problems.append(Problem(message, self.file, column=path, fix=None))

    def at(self, path: str) -> Any:
        """Return the value at a path; None if there is none."""
        node: Any = self.root
        for step in path.split("."):
            if isinstance(node, Mapping):
                node = node.get(step)
            elif isinstance(node, Sequence) and not isinstance(node, str) and step.isdecimal():
                node = node[int(step)] if int(step) < len(node) else None
            else:
                return None
        return node

    def number(self, path: str) -> float | None:
        """Return a finite number, or None if there is none."""
        value = self.at(path)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.report(path, f"expected a number, found {str(value)[:40]!r}")
            return None
        return float(value)

    def text(self, path: str) -> str | None:
        """Return a text, or None if there is none."""
        value = self.at(path)
        if value is None or isinstance(value, str):
            return value
        self.report(path, f"expected text, found {str(value)[:40]!r}")
        return None

    def count(self, path: str) -> int:
        """Return a number of poses; a missing number is a problem."""
        value = self.at(path)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MOST_POSES:
            self.report(path, "expected a number of poses")
            return 0
        return value

    def matrix(self, path: str, n: int, width: int | None = None) -> Array | None:
        """Return ``(width, n)`` from a list of ``n`` rows of finite numbers; None if there is none."""
        rows = self.at(path)
        if rows is None:
            return None
        try:
            array = np.array(rows, dtype=float)
        except (TypeError, ValueError):
            array = np.zeros(())
        if array.ndim != 2 or array.shape[0] != n or array.shape[1] != (width or array.shape[1]):
            self.report(path, f"expected {n} rows of {width if width else 'equally many'} numbers")
            return None
        if not np.all(np.abs(array) < _LARGEST):
            self.report(path, f"expected numbers below {_LARGEST:g}")
            return None
        return array.T

    def texts(self, path: str, n: int) -> NDArray[Any] | None:
        """Return ``(n,)`` texts; None if there are none."""
        values = self.at(path)
        if values is None:
            return None
        if not isinstance(values, list) or len(values) != n or not all(isinstance(value, str) for value in values):
            self.report(path, f"expected {n} texts")
            return None
        return np.array(values, dtype=str)

    def flags(self, path: str, n: int) -> NDArray[np.bool_] | None:
        """Return ``(n,)`` booleans; None if there are none."""
        values = self.at(path)
        if values is None:
            return None
        if not isinstance(values, list) or len(values) != n or not all(isinstance(value, bool) for value in values):
            self.report(path, f"expected {n} booleans")
            return None
        return np.array(values, dtype=bool)
