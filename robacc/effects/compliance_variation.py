"""Springs of joints whose compliance differs with the joint's angle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import (
    About,
    Driver,
    Effect,
    Part,
    Term,
    commanded,
    orders_setting,
    register,
    weight_needed,
)
from robacc.effects.driver import torque_driver
from robacc.gravity.torques import gravity_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class ComplianceVariation(Effect):
    """Joint variable plus gravity's torque times c cos(n q_j) + s sin(n q_j).

    It stands beside ``joint_compliance``, the mean over a turn. The torque is that at the commanded pose.
    """

    orders: tuple[float, ...] = (2.0,)

    name = "compliance_variation"
    missing_reasons = ("no masses in the robot file",)
    about = About(
        summary="the joint's spring is softer at some angles: a periodic error that grows with the torque",
        equation="theta_j + tau_j (c cos(n q_j) + s sin(n q_j)), n = 1 or 2, tau_j the torque of gravity about "
        "the axis",
        unit="rad/(N m)",
        usual_size="1e-8 to 1e-6 rad/(N m), a tenth to a third of the joint's compliance",
        usual_range=(1e-8, 1e-6),
        needs="mass and com of the links; poses of different torque at the same angle",
        confused_with="transmission_error where the torque follows the angle, joint_hardening",
        source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12 (1996) 368: stiffness of strain-wave gears "
        "over the angle",
        example="{effect: compliance_variation, joints: [j2], orders: [2], values: {j2.cos2: 2e-7, j2.sin2: 1e-7}}",
    )

    @property
    def uses_masses(self) -> bool:
        """True: the torque is that of the file's masses."""
        return True

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there are no masses."""
        return None if arm.chain.bodies else cls.missing_reasons[0]

    @classmethod
    def possible_joints(cls, arm: Arm) -> tuple[str, ...]:
        """Return joints that turn."""
        return tuple(name for name in arm.names if arm.is_revolute(name))

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield order 1 and order 2 of one joint at a time."""
        for joint in cls.possible_joints(arm):
            yield cls((joint,), (1.0,))
            yield cls((joint,), (2.0,))

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return gravity's torque on the joint."""
        return None if joint is None else torque_driver(arm, data, joint, is_only=False)

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints and their torques."""
        return (*self.joints, *(f"torque_{joint}" for joint in self.joints))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a cosine and a sine for each order of each joint."""
        weight_needed(arm, self.name)
        q = commanded(data, self.name)
        torque = gravity_torques(arm, q)
        terms = []
        for joint in self.joints:
            number = arm.number(joint)
            for order in self.orders:
                for label, wave in (("cos", np.cos), ("sin", np.sin)):
                    part = Part(arm.axis_motion(joint), torque[number] * wave(order * q[number]))
                    terms.append(Term(f"{self.name}.{joint}.{label}{order:g}", "rad/(N m)", 1e-6, (part,)))
        return tuple(terms)

    def settings(self) -> dict[str, Any]:
        """Return the orders."""
        return {"orders": list(self.orders)}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Read ``orders``."""
        return cls(joints, orders_setting(cls.name, settings, (2.0,)))
