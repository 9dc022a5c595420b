"""What an effect depends on, as one number a pose: the axis that its residual is looked at along."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.backlash import Backlash
from robacc.effects.base import Effect, commanded, needed
from robacc.effects.joint_compliance import JointCompliance
from robacc.effects.joint_correction import JointCorrection
from robacc.effects.joint_coupling import JointCoupling
from robacc.effects.thermal_expansion import ThermalExpansion
from robacc.geometry import Array
from robacc.gravity.loads import payload
from robacc.gravity.torques import gravity_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@dataclass(frozen=True, slots=True)
class Driver:
    """One circumstance that varies from pose to pose."""

    name: str
    """A joint's name, or ``torque``, ``payload_torque``, ``direction``, ``speed``, ``time_s``, ``temperature_c``,
    ``payload_kg``, ``distance``.
    """
    unit: str
    values: Array
    """``(N,)``"""
    alone: bool
    """Whether the effect is a function of this driver and of nothing else."""
    swept: Callable[[Array], Measurements] | None = None
    """Poses that differ in the driver alone, from its values; None where poses cannot be made for it."""


def driver_of(effect: Effect, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
    """What ``effect`` on ``joint`` depends on; None where no single circumstance is its driver."""
    find = _DRIVERS.get(effect.name)
    return None if find is None else find(effect, arm, data, joint or "")


def _own(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    return _joint(arm, data, joint, True)


def _joint(arm: Arm, data: Measurements, joint: str, alone: bool) -> Driver:
    q = commanded(data, "a driver")
    number = arm.number(joint)

    def swept(values: Array) -> Measurements:
        poses = _still(q, values.size)
        poses[number] = values
        return _poses(poses)

    return Driver(joint, "rad" if arm.is_revolute(joint) else "m", q[number], alone, swept)


def _wobble(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    return _joint(arm, data, effect.joints[0], False)


def _coupling(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver | None:
    if not isinstance(effect, JointCoupling) or len(effect.drivers) != 1:
        return None
    return _joint(arm, data, effect.drivers[0], True)


def _backlash(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    if isinstance(effect, Backlash) and effect.by == "gravity":
        return _torque(arm, data, joint, True)
    direction = needed(data.direction, "dir_q1 …", effect.name)[arm.number(joint)]
    return Driver("direction", "1", direction, True)


def _lag(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    return Driver("speed", "1", needed(data.speed, "speed_q1 …", effect.name)[arm.number(joint)], True)


def _compliance(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    if not arm.chain.bodies:
        return _joint(arm, data, joint, False)
    return _torque(arm, data, joint, isinstance(effect, JointCompliance) and effect.masses == "known")


def _torque(arm: Arm, data: Measurements, joint: str, alone: bool) -> Driver:
    torque = gravity_torques(arm, commanded(data, "a torque"))[arm.number(joint)]
    return Driver("torque", "N m" if arm.is_revolute(joint) else "N", torque, alone)


def _payload(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    loads = payload(arm, needed(data.payload, "payload_kg", effect.name))
    torque = gravity_torques(arm, commanded(data, "a torque"), loads)[arm.number(joint)]
    return Driver("payload_torque", "N m" if arm.is_revolute(joint) else "N", torque, True)


def _correction(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver | None:
    if not isinstance(effect, JointCorrection):
        return None
    name, alone = effect.drivers[0], len(effect.drivers) == 1
    if name == "torque":
        return _torque(arm, data, joint, alone)
    return _circumstance(name, data, alone) if name in _COLUMNS else _joint(arm, data, _named(name, joint), alone)


def _named(driver: str, joint: str) -> str:
    return joint if driver == "own" else driver


def _thermal(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    by_time = isinstance(effect, ThermalExpansion) and effect.time_constant is not None
    return _circumstance("time_s" if by_time else "temperature_c", data, False)


def _drift(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    return _circumstance("time_s", data, False)


def _distance(effect: Effect, arm: Arm, data: Measurements, joint: str) -> Driver:
    return Driver("distance", "m", np.sqrt(np.sum(np.square(data.position), axis=0)), True)


_COLUMNS = {"payload_kg": ("payload", "kg"), "temperature_c": ("temperature", "°C"), "time_s": ("time", "s")}


def _circumstance(name: str, data: Measurements, alone: bool) -> Driver:
    field, unit = _COLUMNS[name]

    def swept(values: Array) -> Measurements:
        still = _still(commanded(data, "a driver"), values.size)
        return dataclasses.replace(_poses(still), **{field: values})  # type: ignore[arg-type]

    return Driver(name, unit, needed(getattr(data, field), name, "a driver"), alone, swept)


def _still(q: Array, n: int) -> Array:
    """``(J, n)`` the middle of the joint variables ``(J, N)``, n times."""
    return np.repeat(np.median(q, axis=1, keepdims=True), n, axis=1)


def _poses(q: Array) -> Measurements:
    rows: NDArray[np.int64] = np.arange(1, q.shape[1] + 1)
    return Measurements(position=np.zeros((3, rows.size)), q=q, rows=rows)


_DRIVERS: dict[str, Callable[[Effect, Arm, Measurements, str], Driver | None]] = {
    "joint_offset": _own,
    "gear_ratio": _own,
    "transmission_error": _own,
    "axis_wobble": _wobble,
    "joint_coupling": _coupling,
    "backlash": _backlash,
    "approach_lag": _lag,
    "joint_compliance": _compliance,
    "payload_compliance": _payload,
    "thermal_expansion": _thermal,
    "frame_drift": _drift,
    "instrument_scale": _distance,
    "joint_correction": _correction,
}
"""By the effect's name; an effect that is not here has no single driver."""
