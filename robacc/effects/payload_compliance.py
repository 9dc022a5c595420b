"""Joints that give way under the payload."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import About, Driver, Term, needed, register
from robacc.effects.driver import torque_driver
from robacc.effects.elastic import DEFLECTIONS, Elastic
from robacc.gravity.loads import payload
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class PayloadCompliance(Elastic):
    """Each joint turned by c times the torque of the payload about its axis, in equilibrium."""

    name = "payload_compliance"
    is_nonnegative = True
    extrapolates = "Hooke's law: deflection in proportion to the payload's torque"
    missing_reasons = (
        "no payload_kg column",
        "payload_kg is zero throughout",
    )
    about = About(
        summary="the joint gives way to the payload, which was not the same at every pose",
        equation="theta_j + c_j tau_j, tau_j the torque of the payload's weight about the axis at the deflected pose; "
        f"{DEFLECTIONS}",
        unit="rad/(N m) (m/N for a prismatic joint)",
        usual_size="1e-7 to 1e-5 rad/(N m)",
        usual_range=(1e-07, 1e-05),
        needs="payload_kg that varies; payload: com in the robot file (default: at the tool)",
        confused_with="joint_compliance where the payload never changes",
        source="Khalil and Dombre 2002, ch. 9.5; Nubiola and Bonev 2013",
        example="{effect: payload_compliance, joints: [j2, j3], values: {j2: 2e-6, j3: 5e-6}}",
    )

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there are no payloads."""
        if data.payload is None:
            return cls.missing_reasons[0]
        return None if data.payload.any() else cls.missing_reasons[1]

    @property
    def uses_masses(self) -> bool:
        """False: the payload's mass is a column of the poses."""
        return False

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the payload."""
        return ("payload_kg",)

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the payload's torque on the joint."""
        if joint is None:
            return None
        return torque_driver(arm, data, joint, loads=payload(arm, needed(data.payload, "payload_kg", self.name)))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term a joint."""
        loads = payload(arm, needed(data.payload, "payload_kg", self.name))
        return tuple(
            Term(
                f"{self.name}.{joint}",
                "rad/(N m)" if arm.is_revolute(joint) else "m/N",
                1e-5,
                (self.part(arm.axis_motion(joint), loads),),
            )
            for joint in self.joints
        )
