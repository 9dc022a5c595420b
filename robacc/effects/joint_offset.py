"""Joint zero: the offset added to a joint's variable."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import LEAST_OF_CONSTANT, About, Effect, Over, Term, Traits, register
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class JointOffset(Effect):
    """Offset of each joint's zero."""

    name = "joint_offset"
    traits = Traits(is_constant=True, chart=Over("{joint}"))
    about = About(
        summary="joint zero: the encoder's zero is not the table's",
        equation="theta_j + c (revolute), d_j + c (prismatic)",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-4 to 2e-3 rad",
        usual_range=(0.0001, 0.002),
        needs="nothing",
        confused_with="base_frame.yaw (first joint), tool_frame (last joint), link_geometry across parallel axes",
        source="Wu and Lee 1984, eq. (6), M1 and M2",
        example="{effect: joint_offset, joints: [j2, j3], values: {j2: 5e-4, j3: -2e-4}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        return tuple(
            self.joint_term(arm, joint, 1.0, typical=1e-3, least_part=LEAST_OF_CONSTANT) for joint in self.joints
        )
