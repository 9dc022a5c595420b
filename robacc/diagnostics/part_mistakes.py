"""Mistakes in a stretch of the rows: a session appended with another order of the joints, other signs or other axes.

Base and targets are registered on a part of the rows that agree with the robot file. Rows that then miss by far, and
lie together in the file, are examined by themselves.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.diagnostics.mistake import Mistake
from robacc.fitting.closed_form import register_frames
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Robot

_PARTS = 4
"""Parts of the file of which one has to agree with the robot file."""
_FEWEST_ROWS = 10
"""Rows of a part, and of a stretch, at least."""
_AGREES = 0.01
"""Median error of a part that agrees, as a share of the standard deviation of the positions."""
_GROSS = 0.03
"""The same of a single row that does not agree."""
_CLEAR = 8.0
"""Factor by which its error exceeds that of rows that agree."""
_MOST_MIXED = 0.1
"""Share of rows within a stretch that may agree, and of rows outside that may not."""


@dataclass(frozen=True, slots=True)
class PartMistake:
    """Stretch of rows that does not agree with the others."""

    rows: NDArray[np.int64]
    """Indices of the rows of the stretch."""
    mistake: Mistake | None
    """Mistake in these rows; None if no tested hypothesis explains it."""
    text: str


def find_part_mistake(
    robot: Robot, data: Measurements, find: Callable[[Robot, Measurements], Mistake | None]
) -> PartMistake | None:
    """Return the stretch of rows that has a mistake; None if there is none, or only base or target moved.

    ``find`` returns the mistake of all rows of some poses, with base and target registered on these.
    """
    spread = max(float(np.sqrt(np.var(data.position, axis=1).sum())), 1e-12)
    best: tuple[float, Array] | None = None
    for rows in np.array_split(np.arange(data.n), _PARTS):
        if rows.size < _FEWEST_ROWS:
            return None
        errors = _errors(robot, data.subset(rows), data)
        median = float(np.median(errors[rows]))
        if median <= _AGREES * spread and (best is None or median < best[0]):
            best = median, errors
    if best is None:
        return None
    wrong = best[1] > max(_GROSS * spread, _CLEAR * best[0])
    stretch = _stretch(wrong)
    if stretch is None:
        return None
    part = data.subset(stretch)
    size = float(np.median(best[1][stretch]))
    alone = float(np.median(_errors(robot, part, part)))
    if alone <= max(_AGREES * spread, size / _CLEAR):
        # Only base or target moved: a step, which a trace finds.
        return None
    mistake = find(robot, part)
    where = f"{data.counted}s {data.line(int(stretch[0]))} to {data.line(int(stretch[-1]))}"
    if mistake is not None:
        # Its usual fix, in the robot file or of a whole column, would spoil the other rows.
        fix = "correct these rows only: the others agree with the robot file"
        text = f"{where}, unlike the other rows: {dataclasses.replace(mistake, fix=fix).text}"
    else:
        text = (
            f"{where} do not agree with the other rows: with base and tool registered on those, their median error "
            f"is {1e3 * size:.3g} mm, and {1e3 * alone:.3g} mm with base and tool of their own; check the order, "
            "signs and units of the joints and the axes of the positions there, or leave the rows out"
        )
    return PartMistake(stretch, mistake, text)


def _errors(robot: Robot, registered: Measurements, data: Measurements) -> Array:
    """Return the errors ``(N,)`` of positions with base and targets registered on some poses, m."""
    poses = predict(register_frames(robot, registered, True, True), data)
    return np.asarray(np.linalg.norm(data.position - poses.translation, axis=0))


def _stretch(wrong: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """Return the rows between which nearly all are wrong and beyond which nearly none is; None if there are no such."""
    # The stretch with most wrong rows above as many right ones: the largest sum of +1 and -1 (Kadane).
    sums = np.concatenate(([0], np.cumsum(np.where(wrong, 1, -1))))
    lowest = np.minimum.accumulate(sums[:-1])
    end = int(np.argmax(sums[1:] - lowest)) + 1
    start = int(np.argmin(sums[:end]))
    inside = np.zeros(wrong.size, dtype=bool)
    inside[start:end] = True
    if end - start < _FEWEST_ROWS or inside.all():
        return None
    if np.mean(~wrong[inside]) > _MOST_MIXED or np.mean(wrong[~inside]) > _MOST_MIXED:
        return None
    return np.arange(start, end)
