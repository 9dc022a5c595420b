"""Empirical correction of one joint as a smooth function of its drivers."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import (
    Driver,
    Effect,
    Part,
    Term,
    circumstance_driver,
    commanded,
    is_circumstance,
    joint_driver,
    needed,
    register,
    torque_driver,
    torques_needed,
    varies,
)
from robacc.effects.pose_correction import ABOUT, PoseCorrection
from robacc.effects.settings import refuse_settings
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

    drivers: tuple[str, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    degree: int = 8

    name = "joint_correction"
    is_empirical = True
    about = ABOUT

    @classmethod
    def over(cls, arm: Arm, data: Measurements, joint: str, drivers: tuple[str, ...], degree: int) -> JointCorrection:
        """Return the correction scaled to the range of these poses."""
        values = [_driver(arm, data, joint, driver) for driver in drivers]
        low = tuple(float(np.min(value)) for value in values)
        high = tuple(float(np.max(value)) for value in values)
        return cls((joint,), drivers, low, high, degree)

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return a correction of each joint by its own variable."""
        chosen = tuple(joints) if joints is not None else arm.names
        q = commanded(data, cls.name)
        numbers = [arm.number(joint) for joint in chosen]
        low, high = float(q[numbers].min()), float(q[numbers].max())
        return cls(chosen, ("own",), (low,), (high,), 8)

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
        return self.scaled_ranges()

    def scaled_ranges(self) -> Validity:
        """Return the range of each driver in its polynomials, beyond which it keeps its value at the end."""
        result: dict[str, tuple[float, float]] = {}
        for driver, low, high in zip(self.drivers, self.low, self.high, strict=True):
            if driver in ("own", "torque"):
                result |= {joint if driver == "own" else f"torque_{joint}": (low, high) for joint in self.joints}
            elif driver != "direction":
                result[driver] = (low, high)
        return result

    def _basis(self, arm: Arm, data: Measurements, joint: str) -> Iterator[tuple[str, float, Array]]:
        columns = []
        for driver, low, high in zip(self.drivers, self.low, self.high, strict=True):
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
        low, high = (tuple(v * size for v, size in zip(ends, sizes, strict=True)) for ends in (self.low, self.high))
        return dataclasses.replace(self, low=low, high=high)

    def _unit_of(self, arm: Arm, driver: str, length: float, angle: float) -> float:
        joints = self.joints if driver == "own" else (driver,)
        if not set(joints) <= set(arm.names):
            return 1.0
        return angle if all(arm.is_revolute(joint) for joint in joints) else length

    def settings(self) -> dict[str, Any]:
        """Return the drivers, their ranges and the degree."""
        return {
            "drivers": list(self.drivers),
            "range": [[low, high] for low, high in zip(self.low, self.high, strict=True)],
            "degree": self.degree,
        }

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Read ``drivers: [j3]``, ``range: [[-1.5, 1.5]]``, ``degree: 8``; or ``lengths`` and ``centres``."""
        if "centres" in settings:
            return PoseCorrection.from_settings(joints, settings)
        other_settings = dict(settings)
        drivers, ranges, degree = (
            other_settings.pop("drivers", None),
            other_settings.pop("range", None),
            other_settings.pop("degree", 8),
        )
        refuse_settings(cls.name, other_settings)
        if not isinstance(drivers, list) or len(drivers) not in (1, 2):
            raise ValueError(f"{cls.name}: drivers must be a list of one or two names, found {drivers!r}")
        if not isinstance(ranges, list) or len(ranges) != len(drivers) or not all(map(_is_range, ranges)):
            raise ValueError(f"{cls.name}: range must be a list of [low, high], one for each driver, found {ranges!r}")
        low, high = (tuple(float(pair[i]) for pair in ranges) for i in range(2))
        if not isinstance(degree, int) or isinstance(degree, bool) or not 1 <= degree <= 40:
            raise ValueError(f"{cls.name}: degree must be 1 to 40, found {degree!r}")
        return cls(joints, tuple(map(str, drivers)), low, high, degree)


def _is_range(pair: Any) -> bool:
    return isinstance(pair, list) and len(pair) == 2 and all(isinstance(end, int | float) for end in pair)


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
