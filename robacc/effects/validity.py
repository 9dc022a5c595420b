"""Validity ranges: the ranges of an effect's drivers over the poses that it was fitted to.

A driver is a joint's name (its variable, rad or m), ``time_s``, ``temperature_c``, ``payload_kg``, ``speed_JOINT`` (of
its last motion, fraction of full speed) or ``torque_JOINT`` (of the arm's own weight about it, N m or N).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.gravity.torques import weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

Validity = Mapping[str, tuple[float, float]]
"""Driver to lowest and highest value, SI."""

Periods = Mapping[str, float]
"""Driver to the change of it, SI, after which an effect repeats itself."""
NO_PERIODS: Periods = MappingProxyType({})

_CIRCUMSTANCES = {"time_s": ("time", "s"), "temperature_c": ("temperature", "°C"), "payload_kg": ("payload", "kg")}
_SPEED, _TORQUE = "speed_", "torque_"
MARGIN = 0.01
"""Share of a driver's range by which a pose may exceed it and still count as inside."""


def torque_of(joint: str) -> str:
    """Return the name of the driver that is the torque about a joint."""
    return f"{_TORQUE}{joint}"


def driver_values(arm: Arm, data: Measurements, name: str) -> Array | None:
    """Return ``(N,)`` the values of a driver, or None if the poses do not have it."""
    if name in _CIRCUMSTANCES:
        column: Array | None = getattr(data, _CIRCUMSTANCES[name][0])
        return column
    if name in arm.names:
        return None if data.q is None else data.q[arm.number(name)]
    if name.startswith(_SPEED):
        return None if data.speed is None else data.speed[arm.number(name.removeprefix(_SPEED))]
    if data.q is None or not arm.chain.bodies:
        return None
    torque: Array = weight_torques(arm, data)[arm.number(name.removeprefix(_TORQUE))]
    return torque


def driver_unit(arm: Arm, name: str) -> str:
    """Return the SI unit of a driver."""
    if name in _CIRCUMSTANCES:
        return _CIRCUMSTANCES[name][1]
    if name.startswith(_SPEED) and name not in arm.names:
        return "of full speed"
    joint = name if name in arm.names else name.removeprefix(_TORQUE)
    units = ("rad", "m") if name in arm.names else ("N m", "N")
    return units[0] if arm.is_revolute(joint) else units[1]


def ranges(arm: Arm, data: Measurements, names: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Return the range of each driver that the poses have."""
    result = {}
    for name in names:
        values = driver_values(arm, data, name)
        if values is not None and values.size:
            result[name] = (float(np.min(values)), float(np.max(values)))
    return result


def nearest_image(values: Array, low: float, high: float, period: float | None) -> Array:
    """Return the values, each moved by whole periods to the place nearest to the middle of a range."""
    if period is None:
        return values
    return values - period * np.round((values - 0.5 * (low + high)) / period)


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
    result = dict(first)
    for name, (low, high) in second.items():
        low_before, high_before = result.get(name, (low, high))
        result[name] = (min(low, low_before), max(high, high_before))
    return result


def clip_drivers(arm: Arm, data: Measurements, limits: Validity, periods: Periods = NO_PERIODS) -> Measurements:
    """Return the poses with each driver of ``limits`` held at the end of its range; drivers that are absent stay so.

    A joint with a period is moved by whole periods to the range first, and held at the end that is nearest then.
    """
    changes: dict[str, Any] = {}
    for name, (low, high) in limits.items():
        values = driver_values(arm, data, name)
        if values is None or not np.any((values < low) | (values > high)):
            continue
        if name in _CIRCUMSTANCES:
            changes[_CIRCUMSTANCES[name][0]] = np.clip(values, low, high)
        elif name in arm.names:
            q = changes.get("q", np.array(data.q))
            q[arm.number(name)] = np.clip(nearest_image(values, low, high, periods.get(name)), low, high)
            changes["q"] = q
        elif name.startswith(_SPEED):
            speed = changes.get("speed", np.array(data.speed))
            speed[arm.number(name.removeprefix(_SPEED))] = np.clip(values, low, high)
            changes["speed"] = speed
    return dataclasses.replace(data, **changes) if changes else data


def read_validity(arm: Arm, names: Iterable[str], entry: Any, length: float, angle: float) -> Validity:
    """Return the key ``validity`` of an effect's entry in SI; joints are in units of ``length`` m or ``angle`` rad.

    Raises:
        ValueError: a driver is not of the effect, or a range is not two numbers, low and high.
    """
    allowed = tuple(names)
    if not isinstance(entry, Mapping):
        raise ValueError(f"validity must be a mapping of driver to [low, high], found {entry!r}")
    result = {}
    for name, pair in entry.items():
        if name not in allowed:
            expected = f"it has {', '.join(allowed)}" if allowed else "it has none"
            raise ValueError(f"validity.{name} is not a driver of this effect; {expected}")
        if not isinstance(pair, list | tuple) or len(pair) != 2 or not all(map(_is_number, pair)) or pair[0] > pair[1]:
            raise ValueError(f"validity.{name} must be [low, high], two numbers, found {pair!r}")
        unit = driver_unit(arm, name) if name in arm.names else ""
        size = {"rad": angle, "m": length}.get(unit, 1.0)
        result[name] = (float(pair[0]) * size, float(pair[1]) * size)
    return result


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
