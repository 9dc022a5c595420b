"""Empirical correction of one joint as a smooth function of its drivers."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import (
    Driver,
    Effect,
    Part,
    Term,
    as_plain,
    circumstance_driver,
    commanded,
    is_circumstance,
    joint_driver,
    needed,
    register,
    scaled,
    setting,
    torque_driver,
    torques_needed,
    varies,
)
from robacc.effects.pose_correction import ABOUT, PoseCorrection
from robacc.effects.validity import Validity
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class JointCorrection(Effect):
    """Joint variable plus a polynomial, in Chebyshev form, of one driver or of two together.

    A driver is a joint's name, ``torque`` (of the arm's own weight about the joint's axis), ``payload_kg``,
    ``temperature_c``, ``time_s``, or ``direction`` (of approach; it only multiplies another driver). The terms share a
    Gaussian prior whose standard deviation is estimated. Outside its validity range, a driver stays at the end of it.
    """

    drivers: tuple[str, ...] = setting((), written=True)
    ranges: tuple[tuple[float, float], ...] = setting((), key="range", written=True)
    degree: int = setting(8, written=True, least=1, most=40)

    name = "joint_correction"
    is_empirical = True
    about = ABOUT

    @classmethod
    def over(cls, arm: Arm, data: Measurements, joint: str, drivers: tuple[str, ...], degree: int) -> JointCorrection:
        """Return the correction scaled to the range of these poses."""
        values = [_driver(arm, data, joint, driver) for driver in drivers]
        ranges = tuple((float(np.min(value)), float(np.max(value))) for value in values)
        return cls((joint,), drivers, ranges, degree)

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return a correction of each joint by its own variable."""
        chosen = tuple(joints) if joints is not None else arm.names
        q = commanded(data, cls.name)
        numbers = [arm.number(joint) for joint in chosen]
        low, high = float(q[numbers].min()), float(q[numbers].max())
        return cls(chosen, ("own",), ((low, high),), 8)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield every joint by every driver."""
        for joint in arm.names:
            yield from (cls.over(arm, data, joint, (driver,), 8) for driver in possible_drivers(arm, data))

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the first of the correction's drivers."""
        if joint is None:
            return None
        name, is_only = self.drivers[0], len(self.drivers) == 1
        if name == "torque":
            return torque_driver(arm, data, joint, is_only=is_only)
        if is_circumstance(name):
            return circumstance_driver(name, data, is_only=is_only)
        return joint_driver(arm, data, joint if name == "own" else name, is_only=is_only)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a term for each polynomial; the constant belongs to joint_offset."""
        terms = []
        for joint in self.joints:
            motion = arm.axis_motion(joint)
            unit = arm.unit(joint)
            driver_names = "_".join(self.drivers)
            group = f"{self.name}.{joint}.{driver_names}"
            for label, size, column in self._basis(arm, data, joint):
                part = Part(motion, column)
                terms.append(
                    Term(f"{self.name}.{joint}.{driver_names}.{label}", unit, 1e-4, (part,), group, 1.0 / size)
                )
        return tuple(terms)

    @property
    def of_campaign(self) -> bool:
        """True if time drives it."""
        return "time_s" in self.drivers

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints, torques and circumstances that drive it."""
        names: list[str] = []
        for driver in self.drivers:
            if driver in ("own", "torque"):
                names += [joint if driver == "own" else f"torque_{joint}" for joint in self.joints]
            elif driver != "direction":
                names.append(driver)
        return tuple(dict.fromkeys(names))

    def validity(self, arm: Arm, data: Measurements) -> Validity:
        """Return the ranges that its polynomials are scaled to, whatever the poses."""
        result: dict[str, tuple[float, float]] = {}
        for driver, ends in zip(self.drivers, self.ranges, strict=True):
            if driver in ("own", "torque"):
                result |= {joint if driver == "own" else f"torque_{joint}": ends for joint in self.joints}
            elif driver != "direction":
                result[driver] = ends
        return result

    def _basis(self, arm: Arm, data: Measurements, joint: str) -> Iterator[tuple[str, float, Array]]:
        columns = []
        for driver, (low, high) in zip(self.drivers, self.ranges, strict=True):
            value = _driver(arm, data, joint, driver)
            if driver == "direction":
                columns.append([np.ones_like(value), value])
                continue
            scaled = np.clip((2 * value - low - high) / ((high - low) or 1.0), -1.0, 1.0)
            columns.append([np.cos(k * np.arccos(scaled)) for k in range(self.degree + 1)])
        if len(columns) == 1:
            yield from ((f"T{k}", float(k), column) for k, column in enumerate(columns[0]) if k)
            return
        first, second = columns
        for i, a in enumerate(first):
            for j, b in enumerate(second):
                if 0 < i + j <= self.degree + 1 and (j if self.drivers[1] == "direction" else True):
                    yield f"T{i}T{j}", float(i + j), a * b

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the correction in SI; ranges of joints are in the file's unit of length or angle."""
        sizes = [self._unit_of(arm, driver, length, angle) for driver in self.drivers]
        return dataclasses.replace(self, ranges=tuple(map(scaled, self.ranges, sizes)))

    def _unit_of(self, arm: Arm, driver: str, length: float, angle: float) -> float:
        joints = self.joints if driver == "own" else (driver,)
        if not set(joints) <= set(arm.names):
            return 1.0
        return angle if all(arm.is_revolute(joint) for joint in joints) else length

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the correction, or with ``centres`` the one that is a function of all joints."""
        of_pose = "centres" in settings
        return PoseCorrection.from_settings(joints, settings) if of_pose else super().from_settings(joints, settings)

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if there are not one or two drivers, each with a range."""
        if len(self.drivers) not in (1, 2):
            return f"drivers must be a list of one or two names, found {list(self.drivers)!r}"
        if len(self.ranges) != len(self.drivers):
            return f"range must be a list of [low, high], one for each driver, found {as_plain(self.ranges)!r}"
        return None


def possible_drivers(arm: Arm, data: Measurements) -> tuple[str, ...]:
    """Return the drivers that these data have."""
    drivers = list(arm.names)
    if arm.chain.bodies:
        drivers.append("torque")
    drivers += [
        name
        for name, column in (("payload_kg", data.payload), ("temperature_c", data.temperature), ("time_s", data.time))
        if varies(column)
    ]
    return tuple(drivers)


def _driver(arm: Arm, data: Measurements, joint: str, driver: str) -> Array:
    """Return ``(N,)`` the values of a driver of a joint."""
    if driver == "torque":
        torque: Array = torques_needed(arm, data, f"{JointCorrection.name} by torque")[arm.number(joint)]
        return torque
    columns = {
        "direction": data.direction[arm.number(joint)] if data.direction is not None else None,
        "payload_kg": data.payload,
        "temperature_c": data.temperature,
        "time_s": data.time,
    }
    if driver in columns:
        return needed(columns[driver], driver, JointCorrection.name)
    value: Array = commanded(data, JointCorrection.name)[arm.number(joint if driver == "own" else driver)]
    return value
