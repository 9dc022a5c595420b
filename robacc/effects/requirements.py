"""Columns and masses that an effect needs."""

from __future__ import annotations

import numpy as np

from robacc.errors import MissingColumnError, UsageError
from robacc.geometry import Array
from robacc.gravity.loads import Load, own_weight
from robacc.gravity.torques import weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


def needed(column: Array | None, name: str, effect: str) -> Array:
    """Return a column that an effect needs.

    Raises:
        MissingColumnError: the data do not have it.
    """
    if column is None:
        raise MissingColumnError(f"{effect} needs the column {name}, which the poses do not have")
    return column


def commanded(data: Measurements, effect: str) -> Array:
    """Return the commanded joint variables ``(J, N)``."""
    return needed(data.q, "q1 … qN", effect)


def weight_needed(arm: Arm, data: Measurements, effect: str) -> tuple[Load, ...]:
    """Return the arm's own weight at the poses, which an effect needs.

    Raises:
        UsageError: the robot file has no masses.
    """
    _require_masses(arm, effect)
    return own_weight(arm, data)


def torques_needed(arm: Arm, data: Measurements, effect: str) -> Array:
    """Return ``(J, N)`` gravity's torque (N m) or force (N) on each joint by the arm's own weight."""
    commanded(data, effect)
    _require_masses(arm, effect)
    return weight_torques(arm, data)


def _require_masses(arm: Arm, effect: str) -> None:
    if not arm.chain.bodies:
        raise UsageError(f"{effect} needs mass and com of the links, which the robot file does not have")


def varies(column: Array | None) -> bool:
    """Return whether a column exists and takes more than one value."""
    return column is not None and column.size > 1 and bool(np.ptp(column) > 0)
