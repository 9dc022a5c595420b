"""Backlash: the joint rests on one flank of its gear or the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robacc.effects.base import About, Driver, Effect, Part, Term, commanded, needed, register, varies, weight_needed
from robacc.effects.driver import torque_driver
from robacc.gravity.torques import gravity_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_LEAST_LEVER = 1e-3
"""Lever of the arm's whole weight, m, below which gravity's torque presses against no flank."""


@register
@dataclass(frozen=True)
class Backlash(Effect):
    """Joint variable shifted by half the gap, by the direction of approach or of gravity's torque."""

    by: Literal["approach", "gravity"] = "approach"

    name = "backlash"
    extrapolates = "backlash has two values, one for each direction of approach"
    missing_reasons = ("no dir_q columns, `ordered` is not set, and no masses in the robot file",)
    about = About(
        summary="play in the gear: the joint rests on the flank it came from, or that gravity pushes it to",
        equation="theta_j + c sign(approach_j), or with by: gravity the sign of the gravity torque",
        unit="rad (m for a prismatic joint), half the gap",
        usual_size="1e-5 to 5e-4 rad; negative where the joint stops short",
        usual_range=(1e-05, 0.0005),
        needs="dir_q1 … dir_qN, or `ordered`; by gravity: masses, and a torque that changes sign",
        confused_with="approach_lag where all speeds are similar, joint_compliance where gravity decides",
        source="a parameter times a regressor, as every effect here; Ruderman, Hoffmann, Bertram 2009 for the shape",
        example="{effect: backlash, joints: [j2], values: {j2: -1e-4}}",
    )

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there is neither a direction of approach nor a mass."""
        if varies(data.direction) or arm.chain.bodies:
            return None
        return cls.missing_reasons[0]

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return the effect by the approach if it is known, else by gravity."""
        chosen = tuple(joints) if joints is not None else arm.names
        return cls(joints=chosen, by="approach" if data.direction is not None else "gravity")

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time: by the approach if it is known, and by gravity if its torque changes sign."""
        changes = np.zeros(len(arm.names), dtype=bool)
        if arm.chain.bodies:
            torque = gravity_torques(arm, commanded(data, cls.name))
            changes = (torque.min(axis=1) < 0) & (torque.max(axis=1) > 0)
        for joint in arm.names:
            if varies(data.direction):
                yield cls((joint,))
            if changes[arm.number(joint)]:
                yield cls((joint,), "gravity")

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return none: a direction has no range."""
        return ()

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the direction of approach, or gravity's torque if that decides the flank."""
        if joint is None:
            return None
        if self.by == "gravity":
            return torque_driver(arm, data, joint)
        direction = needed(data.direction, "dir_q1 …", self.name)[arm.number(joint)]
        return Driver("direction", "1", direction, True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term a joint."""
        if self.by == "approach":
            sign = needed(data.direction, "dir_q1 … (or `ordered`)", self.name)
        else:
            loads = weight_needed(arm, f"{self.name} by gravity")
            torque = gravity_torques(arm, commanded(data, self.name))
            weight = float(np.linalg.norm(arm.robot.gravity)) * sum(float(np.max(load.mass)) for load in loads)
            # A torque that rounding or a tenth of a millimetre decides does not press the gear against a flank.
            sign = np.where(np.abs(torque) > _LEAST_LEVER * weight, np.sign(torque), 0.0)
        return tuple(
            Term(
                f"{self.name}.{joint}",
                "rad" if arm.is_revolute(joint) else "m",
                1e-4,
                (Part(arm.axis_motion(joint), sign[arm.number(joint)]),),
            )
            for joint in self.joints
        )

    def settings(self) -> dict[str, Any]:
        """Return the cause that decides the flank, if it is not the approach."""
        return {} if self.by == "approach" else {"by": self.by}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Read ``by: approach`` or ``by: gravity``."""
        unknown = dict(settings)
        by = unknown.pop("by", "approach")
        if unknown or by not in ("approach", "gravity"):
            raise ValueError(f"{cls.name} knows the setting by: approach or gravity, found {dict(settings)!r}")
        return cls(joints=joints, by=by)
