"""What is compared: one result's figures, the errors behind them pose by pose, and how they were made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.grade_scale import Scale
from robacc.geometry import Array


@dataclass(frozen=True, slots=True)
class ComparedFigure:
    """One number of one result."""

    value: float
    unit: str
    """``m``, ``rad`` or ``1``"""
    lower: float | None = None
    upper: float | None = None
    confidence: float | None = None
    """Of the interval from ``lower`` to ``upper``, where the result has one."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPoses:
    """What tells the rows of a result apart: where the arm was sent."""

    n: int
    q: Array | None
    """``(J, n)`` joints as commanded, rad or m."""
    commanded: Array | None
    """``(3, n)`` commanded position, m."""
    pose: NDArray[Any] | None
    """``(n,)`` id, text."""
    target: NDArray[Any] | None

    def subset(self, rows: NDArray[np.bool_]) -> ComparedPoses:
        """Some of the rows."""
        return ComparedPoses(
            int(np.count_nonzero(rows)),
            None if self.q is None else self.q[:, rows],
            None if self.commanded is None else self.commanded[:, rows],
            None if self.pose is None else self.pose[rows],
            None if self.target is None else self.target[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSet:
    """The errors that a group of figures is of."""

    vectors: Array
    """``(3, n)`` m or rad"""
    poses: ComparedPoses


@dataclass(frozen=True, slots=True)
class ComparedResult:
    """One result to compare."""

    name: str
    """Under which it appears; no two alike."""
    command: str
    version: str
    """Of the robacc that made it."""
    n_poses: int
    robot: str | None
    figures: Mapping[str, ComparedFigure]
    """By key: ``position.rms``, ``nominal.held_out.position.p95`` …"""
    errors: Mapping[str, ErrorSet]
    """By what a key begins with: ``position``, ``orientation``, ``nominal.held_out.position`` …"""
    made: Mapping[str, str]
    """How it was made, in words, by aspect."""
    grade: str | None
    """As the result has it, with its standing."""
    scale: Scale | None
    """That the result was graded on, where it says so in full."""
    scale_name: str | None
    frame: str | None
    """``tool`` or ``base``: the axes of vectors."""
    digest: str
    """SHA-256 of the file: equal files are one result twice."""

    @property
    def measured(self) -> bool:
        """Whether its figures are of measured poses, which a prediction's are not."""
        return self.command != "predict"


def split_key(key: str) -> tuple[str, str]:
    """What the errors are found by, and the statistic: ``after.fitted.position`` and ``rms``."""
    owner, _, statistic = key.rpartition(".")
    return owner, statistic
