"""Empirical correction of one joint as a smooth function of its drivers."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import Effect, Over, Term, Traits, as_plain, commanded, driven_by, register, scaled, setting
from robacc.effects.drivers import Validity
from robacc.effects.pose_correction import ABOUT, PoseCorrection
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_OF_JOINT = {"own": "{joint}", "torque": "torque_{joint}", "direction": "direction_{joint}"}
"""Drivers that are another for each joint, as settings and as :mod:`robacc.effects.drivers` name them."""


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
    traits = Traits(is_empirical=True)
    about = ABOUT

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a correction of each joint by its own variable."""
        q = commanded(data, cls.name)[[arm.number(joint) for joint in joints]]
        return cls(joints, ("own",), ((float(q.min()), float(q.max())),), 8)

    def chart(self) -> Over:
        """Return the first of the correction's drivers."""
        return Over(_OF_JOINT.get(self.drivers[0], self.drivers[0]), len(self.drivers) == 1)

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints, torques and circumstances that drive it."""
        return tuple(_OF_JOINT.get(driver, driver) for driver in self.drivers if driver != "direction")

    def validity(self, arm: Arm, data: Measurements) -> Validity:
        """Return the ranges that its polynomials are scaled to, whatever the poses."""
        return {
            _OF_JOINT.get(driver, driver).replace("{joint}", joint): ends
            for driver, ends in zip(self.drivers, self.ranges, strict=True)
            for joint in self.joints
            if driver != "direction"
        }

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a term for each polynomial; the constant belongs to joint_offset."""
        drivers = "_".join(self.drivers)
        return tuple(
            self.joint_term(
                arm, joint, column, f"{drivers}.{label}", group=f"{self.name}.{joint}.{drivers}", weight=1.0 / degree
            )
            for joint in self.joints
            for label, degree, column in self._basis(arm, data, joint)
        )

    def _basis(self, arm: Arm, data: Measurements, joint: str) -> Iterator[tuple[str, int, Array]]:
        """Yield label, degree and values ``(N,)`` of each polynomial."""
        columns = []
        for driver, (low, high) in zip(self.drivers, self.ranges, strict=True):
            value = driven_by(arm, data, _OF_JOINT.get(driver, driver).replace("{joint}", joint), self.name)
            if driver == "direction":
                columns.append([np.ones_like(value), value])
                continue
            scaled = np.clip((2 * value - low - high) / ((high - low) or 1.0), -1.0, 1.0)
            columns.append([np.cos(k * np.arccos(scaled)) for k in range(self.degree + 1)])
        if len(columns) == 1:
            yield from ((f"T{k}", k, column) for k, column in enumerate(columns[0]) if k)
            return
        first, second = columns
        for i, a in enumerate(first):
            for j, b in enumerate(second):
                if 0 < i + j <= self.degree + 1 and (j if self.drivers[1] == "direction" else True):
                    yield f"T{i}T{j}", i + j, a * b

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the correction in SI; ranges of joints are in the file's unit of length or angle."""
        sizes = []
        for driver in self.drivers:
            units = {arm.unit(joint) for joint in (self.joints if driver == "own" else (driver,)) if joint in arm.names}
            sizes.append(1.0 if not units else angle if units == {"rad"} else length)
        return dataclasses.replace(self, ranges=tuple(map(scaled, self.ranges, sizes)))

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
