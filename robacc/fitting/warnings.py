"""Warnings that every fit can give."""

from __future__ import annotations

from robacc.fitting.solver import Fit
from robacc.measurements import Measurements

_NAMED = 10
"""Rows left out that are named; the rest are counted."""


def rows_left_out(found: Fit, data: Measurements) -> tuple[str, ...]:
    """Which rows took no part in the fit, where there are such."""
    if not found.outliers.size:
        return ()
    lines = ", ".join(str(data.line(int(i))) for i in found.outliers[:_NAMED])
    return (f"left out as no part of the rest: {found.outliers.size} row(s), on {data.counted}(s) {lines}",)


def none_held_out(data: Measurements) -> str:
    """That there were too few poses to hold any out."""
    poses = "1 pose is" if data.n == 1 else f"{data.n} poses are"
    return f"{poses} too few to hold any out: every figure is of poses that were fitted"
