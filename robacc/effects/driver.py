"""The driver of an effect: the quantity, one number per pose, that the effect is a function of."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.requirements import commanded, needed
from robacc.geometry import Array
from robacc.gravity.loads import Load, own_weight
from robacc.gravity.torques import gravity_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_CIRCUMSTANCES = {"payload_kg": ("payload", "kg"), "temperature_c": ("temperature", "°C"), "time_s": ("time", "s")}
"""Field of :class:`Measurements` and unit of each circumstance, by its column."""


@dataclass(frozen=True, slots=True)
class Driver:
    """One quantity that varies from pose to pose."""

    name: str
    """A joint's name, or ``torque``, ``payload_torque``, ``direction``, ``speed``, ``time_s``, ``temperature_c``,
    ``payload_kg``, ``distance``.
    """
    unit: str
    values: Array
    """``(N,)``"""
    is_only: bool
    """True if the effect is a function of this driver alone."""
    swept: Callable[[Array], Measurements] | None = None
    """Make poses that differ in the driver alone, from its values; None where no poses can be made for it."""


def joint_driver(arm: Arm, data: Measurements, joint: str, *, is_only: bool = True) -> Driver:
    """Return a joint's own variable, in rad or m."""
    q = commanded(data, "a driver")
    number = arm.number(joint)

    def swept(values: Array) -> Measurements:
        poses = _median_joints(q, values.size)
        poses[number] = values
        return _poses_at(poses)

    return Driver(joint, arm.unit(joint), q[number], is_only, swept)


def torque_driver(
    arm: Arm, data: Measurements, joint: str, *, is_only: bool = True, loads: tuple[Load, ...] | None = None
) -> Driver:
    """Return gravity's torque (N m) or force (N) on a joint: of the arm's own weight, or of the payload ``loads``."""
    q = commanded(data, "a torque")
    torque = gravity_torques(arm, q, own_weight(arm, data) if loads is None else loads)[arm.number(joint)]
    name = "torque" if loads is None else "payload_torque"
    return Driver(name, "N m" if arm.is_revolute(joint) else "N", torque, is_only)


def circumstance_driver(name: str, data: Measurements, *, is_only: bool = False) -> Driver:
    """Return ``time_s``, ``temperature_c`` or ``payload_kg``."""
    field, unit = _CIRCUMSTANCES[name]

    def swept(values: Array) -> Measurements:
        poses = _poses_at(_median_joints(commanded(data, "a driver"), values.size))
        return dataclasses.replace(poses, **{field: values})  # type: ignore[arg-type]

    return Driver(name, unit, needed(getattr(data, field), name, "a driver"), is_only, swept)


def is_circumstance(name: str) -> bool:
    """Return whether ``name`` is a circumstance's column, not a joint or a torque."""
    return name in _CIRCUMSTANCES


def _median_joints(q: Array, n: int) -> Array:
    """Return ``(J, n)`` median of the joint variables ``(J, N)``, n times."""
    return np.repeat(np.median(q, axis=1, keepdims=True), n, axis=1)


def _poses_at(q: Array) -> Measurements:
    rows: NDArray[np.int64] = np.arange(1, q.shape[1] + 1)
    return Measurements(position=np.zeros((3, rows.size)), q=q, rows=rows)
