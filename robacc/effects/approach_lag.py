"""Approach lag: the pose is read before the joint has settled, so it lags by a share of its last speed."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import About, Driver, Effect, Part, Term, needed, register, varies
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class ApproachLag(Effect):
    """Joint variable shifted by the signed speed of its last motion."""

    name = "approach_lag"
    missing_reasons = ("no speed_q columns, and `ordered` is not set",)
    about = About(
        summary="the pose was read before the joint had settled, or the clocks differ: the last motion's speed shows",
        equation="theta_j + c s_j, s_j the last motion's speed as a signed fraction of full speed",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-5 to 1e-3 rad at full speed; negative where the joint lags behind",
        usual_range=(1e-05, 0.001),
        needs="speed_q1 … speed_qN, or `ordered`",
        confused_with="backlash where all speeds are similar",
        source="a parameter times a regressor, as every effect here",
        example="{effect: approach_lag, joints: [j1], values: {j1: -2e-4}}",
    )

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there are no speeds."""
        return None if varies(data.speed) else cls.missing_reasons[0]

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the signed speed of the joint's last motion."""
        if joint is None:
            return None
        return Driver("speed", "1", needed(data.speed, "speed_q1 …", self.name)[arm.number(joint)], True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term a joint."""
        speed = needed(data.speed, "speed_q1 … (or `ordered`)", self.name)
        return tuple(
            Term(
                f"{self.name}.{joint}",
                "rad" if arm.is_revolute(joint) else "m",
                1e-4,
                (Part(arm.axis_motion(joint), speed[arm.number(joint)]),),
            )
            for joint in self.joints
        )
