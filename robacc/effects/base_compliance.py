"""A pedestal that tilts under the arm's moment."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.chain import BASE
from robacc.effects.base import About, Term, register, weight_needed
from robacc.effects.elastic import DEFLECTIONS, Elastic
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class BaseCompliance(Elastic):
    """The base tilted by c times the arm's moment about it, the same in both directions."""

    name = "base_compliance"
    is_nonnegative = True
    missing_reasons = ("no masses in the robot file",)
    per_joint = False
    about = About(
        summary="the pedestal or floor gives way: the base tilts under the arm's moment about it",
        equation="turns of the base about x and y + c (m_x, m_y), the moment of the arm's weight about them at the "
        f"deflected pose; {DEFLECTIONS}",
        unit="rad/(N m)",
        usual_size="1e-9 to 1e-6 rad/(N m)",
        usual_range=(1e-09, 1e-06),
        needs="mass and com of the links",
        confused_with="lateral_compliance of the first joint, joint_compliance of the second",
        source="a parameter times a regressor, as every effect here",
        example="{effect: base_compliance, values: {value: 5e-7}}",
    )

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there are no masses."""
        return None if arm.chain.bodies else cls.missing_reasons[0]

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term."""
        loads = weight_needed(arm, self.name)
        parts = tuple(self.part(arm.chain.index(BASE, label), loads) for label in ("turn_x", "turn_y"))
        return (Term(self.name, "rad/(N m)", 1e-6, parts),)
