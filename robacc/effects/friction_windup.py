"""Wind-up of a joint by friction in its gear that grows with the load."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import (
    DIRECTION,
    MASSES,
    About,
    Effect,
    Over,
    Term,
    Traits,
    compliance_unit,
    driven_by,
    register,
)
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class FrictionWindup(Effect):
    """Joint variable shifted against the approach by c times the size of gravity's torque.

    Friction of the loaded gear holds the joint short of its equilibrium. The torque is that at the commanded pose.
    """

    name = "friction_windup"
    traits = Traits(
        needs=(DIRECTION, MASSES),
        chart=Over("signed_torque_{joint}"),
        extrapolates="friction acts in proportion to the load",
    )
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
    def follows_approach(self) -> bool:
        """Return True: friction acts against the approach."""
        return True

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        columns = {joint: driven_by(arm, data, f"signed_torque_{joint}", self.name) for joint in self.joints}
        return tuple(
            self.joint_term(arm, joint, column, typical=1e-6, unit=compliance_unit(arm, joint))
            for joint, column in columns.items()
        )
