"""Values of a stored result's document, taken by their path; what is not as every result has it is collected."""

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
"""m or rad: no joint, place or error is as large, and the square of what is much larger cannot be held."""

MOST_POSES = 10**8
"""A number of poses beyond any file's, which would fill the memory before it is found not to be that of the errors."""


@dataclass(frozen=True, slots=True)
class ResultDocument:
    """A result's document; a path's keys are joined by dots, and a step of digits counts in a list."""

    root: Mapping[str, Any]
    file: str
    problems: list[Problem] = field(default_factory=list)

    def report(self, path: str, message: str) -> None:
        """Note what is wrong at a place."""
        self.problems.append(Problem(message, self.file, column=path, fix=None))

    def at(self, path: str) -> Any:
        """What stands there; None where nothing does."""
        found: Any = self.root
        for step in path.split("."):
            if isinstance(found, Mapping):
                found = found.get(step)
            elif isinstance(found, Sequence) and not isinstance(found, str) and step.isdigit():
                found = found[int(step)] if int(step) < len(found) else None
            else:
                return None
        return found

    def number(self, path: str) -> float | None:
        """A finite number, or None where there is none."""
        found = self.at(path)
        if found is None:
            return None
        if isinstance(found, bool) or not isinstance(found, int | float) or not math.isfinite(found):
            self.report(path, f"a number is expected here, found {str(found)[:40]!r}")
            return None
        return float(found)

    def text(self, path: str) -> str | None:
        """A text, or None where there is none."""
        found = self.at(path)
        if found is None or isinstance(found, str):
            return found
        self.report(path, f"a text is expected here, found {str(found)[:40]!r}")
        return None

    def count(self, path: str) -> int:
        """A whole number that is not negative; its lack is a problem."""
        found = self.at(path)
        if isinstance(found, bool) or not isinstance(found, int) or not 0 <= found <= MOST_POSES:
            self.report(path, "a number of poses is expected here")
            return 0
        return found

    def matrix(self, path: str, n: int, width: int | None = None) -> Array | None:
        """``(width, n)`` from a list of ``n`` rows of finite numbers; None where there is nothing."""
        found = self.at(path)
        if found is None:
            return None
        try:
            array = np.array(found, dtype=float)
        except (TypeError, ValueError):
            array = np.zeros(())
        if array.ndim != 2 or array.shape[0] != n or array.shape[1] != (width or array.shape[1]):
            self.report(path, f"{n} rows of {width or 'equally many'} numbers are expected here")
            return None
        if not np.all(np.abs(array) < _LARGEST):
            self.report(path, f"numbers below {_LARGEST:g} are expected here")
            return None
        return array.T

    def texts(self, path: str, n: int) -> NDArray[Any] | None:
        """``(n,)`` texts; None where there are none."""
        found = self.at(path)
        if found is None:
            return None
        if not isinstance(found, list) or len(found) != n or not all(isinstance(one, str) for one in found):
            self.report(path, f"{n} texts are expected here")
            return None
        return np.array(found, dtype=str)

    def flags(self, path: str, n: int) -> NDArray[np.bool_] | None:
        """``(n,)`` true and false; None where there are none."""
        found = self.at(path)
        if found is None:
            return None
        if not isinstance(found, list) or len(found) != n or not all(isinstance(one, bool) for one in found):
            self.report(path, f"{n} of true and false are expected here")
            return None
        return np.array(found, dtype=bool)
