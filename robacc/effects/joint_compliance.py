"""Joints that give way under the arm's own weight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robacc.effects.base import About, Effect, Part, Term, register
from robacc.loads import own_weight, unit_loads
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class JointCompliance(Effect):
    """Each joint turned by c times the moment of gravity about its axis, in equilibrium.

    With ``masses_known`` False the masses are unknown or not trusted: the torque's base regressors are fitted, and what
    is identified is compliance x mass and compliance x first moment.
    """

    masses_known: bool = True

    name = "joint_compliance"
    about = About(
        summary="the joint's gear gives way to the torque of the arm's own weight",
        equation="theta_j + c_j tau_j, tau_j the moment of gravity about the axis at the deflected pose",
        unit="rad/(N m) (m/N for a prismatic joint); masses unknown: the same times kg or kg m",
        usual_size="1e-7 to 1e-5 rad/(N m), large arms the stiffer",
        needs="mass and com of the links; without them the torque's base regressors are fitted",
        confused_with="transmission_error of order 1 on joints of horizontal axis, base_compliance, payload_compliance",
        source="Khalil and Dombre 2002, ch. 8 and 9.5; Klimchik et al. 2014",
    )

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Any = None) -> Effect:
        """With the robot's masses where it has them."""
        return cls(tuple(joints) if joints is not None else arm.names, bool(arm.chain.bodies))

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """One joint at a time."""
        yield from (cls.default(arm, data, (joint,)) for joint in arm.names)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """One term a joint, or one for each base regressor."""
        terms = []
        weight = own_weight(arm)
        for joint in self.joints:
            motion = arm.axis_motion(joint)
            unit = "rad/(N m)" if arm.is_revolute(joint) else "m/N"
            if self.masses_known:
                terms.append(Term(f"{self.name}.{joint}", unit, 1e-6, (Part(motion, 1.0, weight),)))
                continue
            for label, loads in unit_loads(arm, arm.owners[arm.number(joint)]).items():
                name = f"{self.name}.{joint}.{label}"
                by = "kg" if label.startswith("m") else "kg m"
                terms.append(Term(name, f"{unit} {by}", 1e-6, (Part(motion, 1.0, loads),)))
        return tuple(terms)

    def settings(self) -> dict[str, Any]:
        """Whether base regressors stand for the masses."""
        return {} if self.masses_known else {"masses": "unknown"}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """``masses: known`` or ``masses: unknown``."""
        rest = dict(settings)
        masses = rest.pop("masses", "known")
        if rest or masses not in ("known", "unknown"):
            raise ValueError(f"{cls.name} knows the setting masses: known or unknown, found {dict(settings)!r}")
        return cls(joints=joints, masses_known=masses == "known")
