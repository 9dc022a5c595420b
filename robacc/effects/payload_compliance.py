"""Joints that give way under the payload."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from robacc.effects.base import About, Driver, Effect, Term, needed, register
from robacc.effects.driver import torque_driver
from robacc.effects.elastic import DEFLECTIONS, Elastic, deflection_setting
from robacc.geometry import Array
from robacc.gravity.loads import Load, payload
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class PayloadCompliance(Elastic):
    """Each joint turned by c times the moment of the payload about its axis, in equilibrium.

    With the centre of mass ``uncertain``, the payload's first moments in the last link's frame, shrunk by a prior,
    correct it; their coefficients are the compliance times what the centre is off the file's.
    """

    com: Literal["known", "uncertain"] = "known"

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
        unit="rad/(N m) (m/N for a prismatic joint); com uncertain: also the same times m",
        usual_size="1e-7 to 1e-5 rad/(N m)",
        usual_range=(1e-07, 1e-05),
        needs="payload_kg that varies; payload: com in the robot file (default: at the tool), or com: uncertain",
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

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time, with the file's centre of mass and with an uncertain one."""
        for joint in arm.names:
            yield cls((joint,))
            yield cls((joint,), "uncertain")

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the payload."""
        return ("payload_kg",)

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the payload's torque on the joint."""
        if joint is None:
            return None
        return torque_driver(arm, data, joint, loads=payload(arm, needed(data.payload, "payload_kg", self.name)))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term a joint, and one for each first moment if the centre is uncertain."""
        mass = needed(data.payload, "payload_kg", self.name)
        terms = []
        for joint in self.joints:
            motion, name = arm.axis_motion(joint), f"{self.name}.{joint}"
            unit = "rad/(N m)" if arm.is_revolute(joint) else "m/N"
            terms.append(Term(name, unit, 1e-5, (self.part(motion, payload(arm, mass)),)))
            for label, load in _first_moments(arm, mass).items() if self.com == "uncertain" else ():
                part = self.part(motion, (load,))
                terms.append(Term(f"{name}.{label}", f"{unit} m", 1e-5, (part,), name, _COM_STD))
        return tuple(terms)

    def settings(self) -> dict[str, Any]:
        """Return the form, and an uncertain centre of mass."""
        return super().settings() | ({} if self.com == "known" else {"com": self.com})

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Read ``com: known`` or ``uncertain``; ``deflection: equilibrium`` or ``rigid``."""
        other_settings = dict(settings)
        com = other_settings.pop("com", "known")
        if com not in ("known", "uncertain"):
            raise ValueError(f"{cls.name}: com must be known or uncertain, found {com!r}")
        return cls(joints, com, deflection=deflection_setting(cls.name, other_settings))


_COM_STD = 0.2
"""Prior standard deviation of a coordinate of the centre of mass about the file's, m."""


def _first_moments(arm: Arm, mass: Array) -> dict[str, Load]:
    """Return the payload's first moments of mass per metre along each axis of the last link's frame."""
    loads = {}
    for axis, label in enumerate(("hx", "hy", "hz")):
        x, y, z = (mass if i == axis else 0.0 for i in range(3))
        loads[label] = Load(arm.flange, 0.0, (x, y, z))
    return loads
