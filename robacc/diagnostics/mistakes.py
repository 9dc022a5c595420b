"""A mistake in the data or the robot file as it is reported, and the misfit from which there may be one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robacc.fitting.closed_form import register_frames
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements, even_rows
from robacc.modelling.model import predict
from robacc.robots.description import Robot

GROSS = 0.01
"""Median registered error, as a share of the standard deviation of the positions (or in rad), above which it may come
from a mistake. An arm as it is built stays below. A single row may have twice as much, as may the sum of a position
error and an orientation error."""
PLAUSIBLE = 0.1
"""The same of positions that are right in the main: registered on few rows, or on an arm with a further mistake."""
CLEAR = 8.0
"""Factor by which the correction of a mistake has to reduce the error. Registration of base and target explains at most
a factor of three of a mistake in a few rows."""
MOST_ROWS = 400
"""Rows, evenly spread, on which base and target are registered, which bounds the time."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """Mistake, or several together, in the data or the robot file, or in some rows."""

    name: str
    fix: str
    before: float | None = None
    """Median position error of the registered nominal model, m; None if the name has the figures."""
    after: float | None = None
    """The same with the mistake corrected, m."""
    turned_before: float | None = None
    """Median orientation error of the registered nominal model, rad."""
    turned_after: float | None = None
    alternatives: tuple[str, ...] = ()
    """Other mistakes that explain these poses as well."""
    unseen: tuple[str, ...] = ()
    """Joints whose sign these poses do not show."""
    of_rows: bool = False
    """Whether the errors are those of the rows in the name."""
    refused: bool = True
    """Whether the data cannot be used as they are."""

    @property
    def text(self) -> str:
        """Return the message."""
        text = self.name
        if self.before is not None and self.after is not None:
            kind, unit, before, after = "error", "mm", f"{1e3 * self.before:.3g}", f"{1e3 * self.after:.3g}"
            whose = "their" if self.of_rows else "the"
            if self.turned_before is not None and self.turned_after is not None and self.after > self.before / 2:
                kind, unit = "orientation error", "degrees"
                before, after = f"{math.degrees(self.turned_before):.3g}", f"{math.degrees(self.turned_after):.2g}"
            errors = f"{whose} median {kind} is {before} {unit}, and {after} {unit} after this correction"
            text += f": with base and tool registered, {errors}"
        text += f"; {self.fix}"
        if self.alternatives:
            text += f". Not distinguishable on these poses: {'; or '.join(self.alternatives)}"
        if self.unseen:
            text += f". These poses do not show the sign of {', '.join(self.unseen)}"
        return text


def spread(position: Array) -> float:
    """Return the standard deviation of positions ``(3, N)`` about their centre, m."""
    return max(float(np.sqrt(np.var(position, axis=1).sum())), 1e-12)


def registered_poses(robot: Robot, data: Measurements, registered: Measurements | None = None) -> Poses:
    """Return the poses of the nominal model with base and targets registered, by default on an even share of them."""
    if registered is None:
        registered = data.subset(even_rows(data.n, MOST_ROWS))
    return predict(register_frames(robot, registered, True, True), data)
