"""Approach lag: the pose is read before the joint has settled, so it lags by a share of its last speed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from robacc.effects.base import SPEED, About, Effect, Over, Part, Term, Traits, driven_by, register, setting
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class ApproachLag(Effect):
    """Joint variable shifted by the signed speed of its last motion.

    With ``common`` all joints share a coefficient: a delay between the arm's clock and the instrument's.
    """

    common: bool = setting(False)

    name = "approach_lag"
    traits = Traits(
        needs=(SPEED,),
        drivers=("speed_{joint}",),
        chart=Over("speed_{joint}"),
        extrapolates="a lag acts in proportion to the speed",
    )
    about = About(
        summary="the pose was read before the joint had settled, or the clocks differ: the last motion's speed shows",
        equation="theta_j + c s_j, s_j the last motion's speed as a signed fraction of full speed; with common: true "
        "the same c for all joints",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-5 to 1e-3 rad at full speed; negative where the joint lags behind",
        usual_range=(1e-05, 0.001),
        needs="speed_q1 … speed_qN, or `ordered`",
        confused_with="backlash where all speeds are similar",
        source="a parameter times a regressor, as every effect here",
        example="{effect: approach_lag, joints: [j1], values: {j1: -2e-4}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time, and a delay common to all rotary joints."""
        yield from super().candidates(arm, data)
        rotary = tuple(joint for joint in arm.names if arm.is_revolute(joint))
        if len(rotary) > 1:
            yield cls(rotary, common=True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        speeds = {joint: driven_by(arm, data, f"speed_{joint}", self.name) for joint in self.joints}
        if self.common:
            parts = tuple(Part(arm.axis_motion(joint), speed) for joint, speed in speeds.items())
            return (Term(f"{self.name}.common", "rad", 1e-4, parts),)
        return tuple(self.joint_term(arm, joint, speed) for joint, speed in speeds.items())

    def __str__(self) -> str:
        """Return ``approach_lag[j1]`` or ``approach_lag[common]``."""
        return f"{self.name}[common]" if self.common else super().__str__()
