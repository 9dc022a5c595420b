"""A gear ratio that is not the controller's: the joint's angle scaled."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import About, Effect, Over, Term, Traits, driven_by, register
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class GearRatio(Effect):
    """Joint variable scaled by 1 + k."""

    name = "gear_ratio"
    traits = Traits(chart=Over("{joint}"), extrapolates="a ratio acts in proportion to the joint's angle or travel")
    about = About(
        summary="joint angle scaled: the gear ratio, or a linear axis' pitch, is not the controller's",
        equation="theta_j + k q_j (d_j + k q_j for a prismatic joint)",
        unit="1",
        usual_size="1e-5 to 1e-3",
        usual_range=(1e-05, 0.001),
        needs="q1 … qN over a wide range",
        confused_with="transmission_error of order 1 over a narrow range, joint_compliance of the same joint",
        source="a parameter times a regressor, as every effect here; Whitney, Lozinski, Rourke 1986",
        example="{effect: gear_ratio, joints: [j3], values: {j3: 1e-4}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        return tuple(
            self.joint_term(arm, joint, driven_by(arm, data, joint, self.name), unit="1") for joint in self.joints
        )
