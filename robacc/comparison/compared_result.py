"""A result to compare: its figures, the errors of every pose behind them, and how it was made."""

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
    """Confidence of the interval from ``lower`` to ``upper``, if the result has an interval."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPoses:
    """Commanded poses of a result's rows."""

    n: int
    q: Array | None
    """``(J, n)`` commanded joints, rad or m."""
    commanded: Array | None
    """``(3, n)`` commanded position, m."""
    pose: NDArray[Any] | None
    """``(n,)`` id, text."""
    target: NDArray[Any] | None

    def subset(self, rows: NDArray[np.bool_]) -> ComparedPoses:
        """Return the poses of the rows where ``rows`` is true."""
        return ComparedPoses(
            int(np.count_nonzero(rows)),
            None if self.q is None else self.q[:, rows],
            None if self.commanded is None else self.commanded[:, rows],
            None if self.pose is None else self.pose[rows],
            None if self.target is None else self.target[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSet:
    """Errors behind a group of figures."""

    vectors: Array
    """``(3, n)`` m or rad"""
    poses: ComparedPoses
    independent_poses: float | None = None
    """Number of poses that intervals count; None for all commanded poses."""


@dataclass(frozen=True, slots=True)
class ComparedResult:
    """One result to compare."""

    name: str
    """Unique name in the comparison."""
    command: str
    version: str
    """Version of robacc that made the result."""
    n_poses: int
    robot: str | None
    figures: Mapping[str, ComparedFigure]
    """Figures by key: ``position.rms``, ``nominal.held_out.position.p95`` …"""
    errors: Mapping[str, ErrorSet]
    """Errors by group, the start of a key: ``position``, ``orientation``, ``nominal.held_out.position`` …"""
    provenance: Mapping[str, str]
    """How the result was made, as text by aspect."""
    grade: str | None
    """The result's own grade, with ``confirmed``, ``not confirmed`` or ``predicted``."""
    scale: Scale | None
    """Grade scale of the result, if the result stores the complete scale."""
    scale_name: str | None
    frame: str | None
    """Axes of vectors: ``tool`` or ``base``."""
    digest: str
    """SHA-256 of the file; equal files are the same result."""

    @property
    def measured(self) -> bool:
        """Return whether the figures come from measured poses, as all but those of a prediction do."""
        return self.command != "predict"


def split_key(key: str) -> tuple[str, str]:
    """Return the group of a key's errors and its statistic: ``after.fitted.position`` and ``rms``."""
    group, _, statistic = key.rpartition(".")
    return group, statistic
