"""Drivers: the quantities, one number a pose, that an effect is a function of; their values, units and ranges.

A driver is a joint's name (its variable, rad or m), ``time_s``, ``temperature_c``, ``payload_kg``, ``speed_JOINT`` (of
its last motion, fraction of full speed) or ``torque_JOINT`` (of the arm's own weight about it, N m or N). Charts have
further ones: ``direction_JOINT`` (of approach), ``payload_torque_JOINT``, ``signed_torque_JOINT`` (the size of the
torque, with the sign of the approach), ``distance`` (from the origin of the measuring frame) and ``line``.

The validity ranges of an effect are the ranges of its drivers over the poses that it was fitted to.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from robacc.errors import refuse
from robacc.geometry import Array, NDArray
from robacc.gravity import gravity_torques, payload, weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

Validity = Mapping[str, tuple[float, float]]
"""Driver to lowest and highest value, SI."""

Periods = Mapping[str, float]
"""Driver to the change of it, SI, after which an effect repeats itself."""
NO_PERIODS: Periods = MappingProxyType({})

_FIELDS = {
    "": "q",
    "speed": "speed",
    "direction": "direction",
    "time_s": "time",
    "temperature_c": "temperature",
    "payload_kg": "payload",
}
"""Field of :class:`Measurements` by the kind of a driver; the kind of a joint's variable is empty."""
_UNITS = {
    "": ("rad", "m"),
    "speed": ("of full speed",),
    "direction": ("1",),
    "time_s": ("s",),
    "temperature_c": ("°C",),
    "payload_kg": ("kg",),
    "torque": ("N m", "N"),
    "payload_torque": ("N m", "N"),
    "signed_torque": ("N m",),
    "distance": ("m",),
    "line": ("1",),
}
"""SI unit of each kind; two where that of a slide differs."""
_DIRECTIONS = "dir_q1 … (or `ordered`)"
COLUMNS = {
    "speed": "speed_q1 … (or `ordered`)",
    "direction": _DIRECTIONS,
    "signed_torque": _DIRECTIONS,
    "time_s": "time_s",
    "temperature_c": "temperature_c",
    "payload_kg": "payload_kg",
    "payload_torque": "payload_kg",
}
"""Columns that a kind follows from, as messages name them; by default the joints."""
MARGIN = 0.01
"""Share of a driver's range by which a pose may exceed it and still count as inside."""


def split(arm: Arm, name: str) -> tuple[str, str]:
    """Return the kind of a driver, ``torque`` for example, and its joint; the kind of a joint's variable is empty."""
    of_joint = ("speed", "direction", "torque", "payload_torque", "signed_torque")
    kind = next((kind for kind in of_joint if name.startswith(f"{kind}_")), name)
    return ("", name) if name in arm.names else (kind, name.removeprefix(f"{kind}_"))


def driver_values(arm: Arm, data: Measurements, name: str) -> Array | None:
    """Return ``(N,)`` the values of a driver, or None if the poses or the robot do not have it."""
    kind, joint = split(arm, name)
    if kind in _FIELDS:
        column: Array | None = getattr(data, _FIELDS[kind])
        return column if column is None or column.ndim == 1 else column[arm.number(joint)]
    if kind == "distance":
        return np.asarray(np.sqrt(np.sum(np.square(data.position), axis=0)))
    if kind == "line":
        return None if data.rows is None else data.rows.astype(float)
    number = arm.number(joint)
    if data.q is None:
        return None
    if kind == "payload_torque":
        load = () if data.payload is None else payload(arm, data.payload)
        return np.asarray(gravity_torques(arm, data.q, load)[number]) if load else None
    torque: Array | None = weight_torques(arm, data)[number] if arm.chain.bodies else None
    if torque is None or kind == "torque":
        return torque
    return None if data.direction is None else np.asarray(np.abs(torque) * data.direction[number])


def driver_unit(arm: Arm, name: str) -> str:
    """Return the SI unit of a driver."""
    kind, joint = split(arm, name)
    units = _UNITS[kind]
    return units[0] if len(units) == 1 or arm.is_revolute(joint) else units[1]


class Driver(NamedTuple):
    """A driver as the axis of a chart."""

    name: str
    """A joint's name, or the driver's without its joint."""
    unit: str
    values: Array
    """``(N,)``"""
    is_only: bool
    """True if the effect is a function of this driver alone."""
    swept: Callable[[Array], Measurements] | None = None
    """Make poses that differ in the driver alone, from its values; None where no poses can be made for it."""

    @classmethod
    def at(cls, arm: Arm, data: Measurements, name: str, is_only: bool) -> "Driver | None":
        """Return a driver at these poses; None if they do not have it."""
        values = driver_values(arm, data, name)
        if values is None:
            return None
        kind, joint = split(arm, name)
        unit = "1" if kind == "speed" else driver_unit(arm, name)

        def swept(values: Array) -> Measurements:
            assert data.q is not None
            q = np.repeat(np.median(data.q, axis=1, keepdims=True), values.size, axis=1)
            rows: NDArray[np.int64] = np.arange(1, values.size + 1)
            changes: dict[str, Any] = {_FIELDS[kind]: values} if kind else {"q": q}
            if not kind:
                q[arm.number(joint)] = values
            return Measurements(**{"position": np.zeros((3, rows.size)), "q": q, "rows": rows, **changes})

        can_be_swept = kind in ("", "time_s", "temperature_c", "payload_kg")
        return cls(kind or joint, unit, values, is_only, swept if can_be_swept else None)


def ranges(arm: Arm, data: Measurements, names: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return the range of each driver that the poses have."""
    return {
        name: (float(np.min(values)), float(np.max(values)))
        for name in names
        if (values := driver_values(arm, data, name)) is not None and values.size
    }


def nearest_image(values: Array, low: float, high: float, period: float | None) -> Array:
    """Return the values, each moved by whole periods to the place nearest to the middle of a range."""
    return values if period is None else values - period * np.round((values - 0.5 * (low + high)) / period)


def range_excess(values: Array, low: float, high: float, period: float | None = None) -> Array:
    """Return how far values, or their nearest images by whole periods, lie beyond a range; 0 within it."""
    values = nearest_image(values, low, high, period)
    return np.maximum(np.maximum(low - values, values - high), 0.0)


def is_outside(arm: Arm, data: Measurements, limits: Validity, periods: Periods = NO_PERIODS) -> NDArray[np.bool_]:
    """Return ``(N,)`` the mask of poses that exceed one of the ranges by more than :data:`MARGIN` of it."""
    result = np.zeros(data.n, dtype=bool)
    for name, (low, high) in limits.items():
        values = driver_values(arm, data, name)
        if values is not None:
            result |= range_excess(values, low, high, periods.get(name)) > MARGIN * (high - low)
    return result


def united(first: Validity, second: Validity) -> dict[str, tuple[float, float]]:
    """Return ranges that contain both; a driver without a range in one of them has that of the other."""
    both = {name: [limits[name] for limits in (first, second) if name in limits] for name in (*first, *second)}
    return {name: (min(low for low, _ in pairs), max(high for _, high in pairs)) for name, pairs in both.items()}


def clip_drivers(arm: Arm, data: Measurements, limits: Validity, periods: Periods = NO_PERIODS) -> Measurements:
    """Return the poses with each driver of ``limits`` held at the end of its range; drivers that are absent stay so.

    A joint with a period is moved by whole periods to the range first, and held at the end that is nearest then.
    """
    changes: dict[str, Any] = {}
    for name, (low, high) in limits.items():
        kind, joint = split(arm, name)
        values = driver_values(arm, data, name) if kind in _FIELDS else None
        if values is None or not np.any((values < low) | (values > high)):
            continue
        field = _FIELDS[kind]
        column = changes.setdefault(field, np.array(getattr(data, field)))
        row = ... if column.ndim == 1 else arm.number(joint)
        column[row] = np.clip(nearest_image(values, low, high, periods.get(name)), low, high)
    return dataclasses.replace(data, **changes) if changes else data


def read_validity(arm: Arm, names: Iterable[str], entry: Any, length: float, angle: float) -> Validity:
    """Return the key ``validity`` of an effect's entry in SI; joints are in units of ``length`` m or ``angle`` rad.

    Raises:
        UsageError: a driver is not of the effect, or a range is not two numbers, low and high.
    """
    allowed = tuple(names)
    refuse(
        (not isinstance(entry, Mapping), f"validity must be a mapping of driver to [low, high], found {entry!r}"),
    )
    result = {}
    for name, pair in entry.items():
        is_range = (
            isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_number, pair)) and pair[0] <= pair[1]
        )
        refuse(
            (
                name not in allowed,
                f"validity.{name} is not a driver of this effect; it has {', '.join(allowed) or 'none'}",
            ),
            (not is_range, f"validity.{name} must be [low, high], two numbers, found {pair!r}"),
        )
        unit = driver_unit(arm, name) if name in arm.names else ""
        size = {"rad": angle, "m": length}.get(unit, 1.0)
        result[name] = (float(pair[0]) * size, float(pair[1]) * size)
    return result


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
