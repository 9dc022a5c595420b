"""Circumstances of targets other than the joints: from columns, from the order of the targets, and from options."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.poses.motion import motion_between_visits, visits_in_order


@dataclass(frozen=True, slots=True)
class Circumstances:
    """Columns of the targets without their joints, and the source of direction and speed."""

    columns: Measurements
    """Targets; time, temperature and payload are complete as far as they are known."""
    follows_order: bool
    """Direction and speed of approach follow from the moves between the targets, in their order."""
    visits: NDArray[np.int64]
    """``(N,)`` number of the arrival that each row belongs to: rows of several measured targets share one."""

    def motion(self, q: Array) -> tuple[Array | None, Array | None]:
        """Return direction and speed of approach ``(J, N)`` of commands ``q`` in their order; None where unknown."""
        if not self.follows_order:
            return self.columns.direction, self.columns.speed
        direction, speed = motion_between_visits(q, self.visits)
        columns = self.columns
        return (
            direction if columns.direction is None else columns.direction,
            speed if columns.speed is None else columns.speed,
        )

    def at(self, q: Array, motion: tuple[Array | None, Array | None], index: NDArray[np.int64]) -> Measurements:
        """Return the poses of the targets ``index`` at commands ``q`` ``(J, M)``, with their circumstances."""
        columns = self.columns
        direction, speed = motion
        return Measurements(
            position=np.zeros((3, index.size)),
            q=q,
            target=_part(columns.target, index),
            time=_part(columns.time, index),
            temperature=_part(columns.temperature, index),
            payload=_part(columns.payload, index),
            payload_group=_part(columns.payload_group, index),
            branches=None if columns.branches is None else columns.branches[:, index],
            branch_names=columns.branch_names,
            direction=None if direction is None else direction[:, index],
            speed=None if speed is None else speed[:, index],
            rows=columns.rows if columns.rows is None else columns.rows[index],
        )


def circumstances(
    data: Measurements,
    *,
    ordered: bool = True,
    payload: float | None = None,
    temperature: float | None = None,
    time: float | None = None,
) -> Circumstances:
    """Return the circumstances of targets; a column of the file has precedence over a constant."""

    def filled(column: Array | None, value: float | None) -> Array | None:
        return column if column is not None or value is None else np.full(data.n, float(value))

    columns = dataclasses.replace(
        data,
        payload=filled(data.payload, payload),
        temperature=filled(data.temperature, temperature),
        time=filled(data.time, time),
    )
    visits = visits_in_order(data.groups(), data.visit, data.cycle, data.target)
    return Circumstances(columns, ordered, visits)


def _part(column: NDArray[Any] | None, index: NDArray[np.int64]) -> NDArray[Any] | None:
    return None if column is None else column[..., index]
