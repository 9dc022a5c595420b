"""Wind-up of a joint by friction in its gear that grows with the load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.effects.base import About, Driver, Effect, Part, Term, needed, register, torques_needed, varies
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class FrictionWindup(Effect):
    """Joint variable shifted against the approach by c times the size of gravity's torque.

    Friction of the loaded gear holds the joint short of its equilibrium. The torque is that at the commanded pose.
    """

    name = "friction_windup"
    extrapolates = "friction acts in proportion to the load"
    missing_reasons = ("no dir_q columns, and `ordered` is not set", "no masses in the robot file")
    about = About(
        summary="friction of the loaded gear holds the joint short of its pose: a lost motion that grows with the load",
        equation="theta_j + c |tau_j| sign(approach_j), tau_j the torque of gravity about the axis",
        unit="rad/(N m) (m/N for a prismatic joint)",
        usual_size="1e-9 to 1e-6 rad/(N m); negative where the joint stops short",
        usual_range=(1e-9, 1e-6),
        needs="dir_q1 … dir_qN, or `ordered`; mass and com of the links",
        confused_with="backlash where the torque hardly changes, joint_compliance",
        source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083: friction that grows with load",
        example="{effect: friction_windup, joints: [j2], values: {j2: -2e-6}}",
    )

    @property
    def uses_masses(self) -> bool:
        """Return True: the torque is that of the file's masses."""
        return True

    @property
    def follows_approach(self) -> bool:
        """Return True: friction acts against the approach."""
        return True

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there is no direction of approach, or no mass."""
        if not varies(data.direction):
            return cls.missing_reasons[0]
        return None if arm.chain.bodies else cls.missing_reasons[1]

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the size of gravity's torque with the sign of the approach."""
        if joint is None:
            return None
        return Driver("signed_torque", "N m", self._regressor(arm, data)[arm.number(joint)], True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        regressor = self._regressor(arm, data)
        return tuple(
            Term(
                f"{self.name}.{joint}",
                "rad/(N m)" if arm.is_revolute(joint) else "m/N",
                1e-6,
                (Part(arm.axis_motion(joint), regressor[arm.number(joint)]),),
            )
            for joint in self.joints
        )

    def _regressor(self, arm: Arm, data: Measurements) -> np.ndarray:
        direction = needed(data.direction, "dir_q1 … (or `ordered`)", self.name)
        result: np.ndarray = np.abs(torques_needed(arm, data, self.name)) * direction
        return result
