"""Bearings that tilt under the bending moment across a joint's axis."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import About, Term, register, weight_needed
from robacc.effects.elastic import DEFLECTIONS, Elastic
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.assembly import FLEXURES


@register
@dataclass(frozen=True)
class LateralCompliance(Elastic):
    """Each joint's axis tilted by c times the bending moment, the same stiffness in both directions."""

    name = "lateral_compliance"
    extrapolates = "Hooke's law: deflection in proportion to the bending moment"
    missing_reasons = ("no masses in the robot file",)
    about = About(
        summary="the joint's bearing and link bend: the axis tilts under the moment across it",
        equation="rotations about x and y in front of joint j + c_j (m_x, m_y), the arm's moment of gravity about them "
        f"at the deflected pose; {DEFLECTIONS}",
        unit="rad/(N m)",
        usual_size="1e-8 to 1e-5 rad/(N m)",
        usual_range=(1e-08, 1e-05),
        needs="mass and com of the links",
        confused_with="joint_compliance of neighbouring joints, base_compliance at the first joint",
        source="Tenhumberg and Baeuml 2021 (elastic calibration of Agile Justin)",
        example="{effect: lateral_compliance, joints: [j2], values: {j2: 1e-6}}",
    )

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there are no masses."""
        return None if arm.chain.bodies else cls.missing_reasons[0]

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term a joint."""
        weight = weight_needed(arm, self.name)
        return tuple(
            Term(
                f"{self.name}.{joint}",
                "rad/(N m)",
                1e-5,
                tuple(self.part(arm.motion(joint, label), weight) for label in FLEXURES),
            )
            for joint in self.joints
        )
