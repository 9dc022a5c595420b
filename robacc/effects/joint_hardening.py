"""Springs of joints that become stiffer, or softer, with the torque."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import About, Driver, Effect, Part, Term, commanded, register, weight_needed
from robacc.effects.driver import torque_driver
from robacc.gravity.torques import gravity_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class JointHardening(Effect):
    """Joint variable plus c times the cube of gravity's torque over a reference torque.

    It stands beside ``joint_compliance``, whose torque is the first power. The torque is that at the commanded pose.
    """

    reference: float = 100.0
    """Torque at which the coefficient is the deflection, N m (N for a prismatic joint)."""

    name = "joint_hardening"
    missing_reasons = ("no masses in the robot file",)
    about = About(
        summary="the joint's spring hardens: strain-wave gears and gears with clearance are soft at small torque",
        equation="theta_j + c (tau_j / tau_ref)^3, tau_j the torque of gravity about the axis",
        unit="rad (m for a prismatic joint) at the reference torque",
        usual_size="1e-5 to 1e-3 rad; opposite in sign to the compliance where the spring hardens",
        usual_range=(1e-5, 1e-3),
        needs="mass and com of the links",
        confused_with="joint_compliance where the torque's range is small, transmission_error of orders 1 and 3",
        source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12 (1996) 368: cubic stiffness of strain-wave "
        "gears",
        example="{effect: joint_hardening, joints: [j2], torque_nm: 50, values: {j2: -2e-4}}",
    )

    @property
    def uses_masses(self) -> bool:
        """True: the torque is that of the file's masses."""
        return True

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there are no masses."""
        return None if arm.chain.bodies else cls.missing_reasons[0]

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return the effect with the largest torque on these joints as the reference, to two digits."""
        chosen = tuple(joints) if joints is not None else arm.names
        torque = gravity_torques(arm, commanded(data, cls.name))
        largest = max((float(np.abs(torque[arm.number(joint)]).max(initial=0.0)) for joint in chosen), default=0.0)
        return cls(chosen, float(f"{largest:.2g}") if largest > _LEAST_TORQUE else cls.reference)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time."""
        yield from (cls.default(arm, data, (joint,)) for joint in arm.names)

    def is_same_finding(self, other: Effect) -> bool:
        """Return whether ``other`` is the same at any reference torque."""
        return isinstance(other, JointHardening) and self.joints == other.joints

    def search_key(self) -> tuple[Any, ...]:
        """Return the key without the reference, which depends on the poses."""
        return (self.name, self.joints)

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return gravity's torque on the joint."""
        return None if joint is None else torque_driver(arm, data, joint)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term a joint."""
        weight_needed(arm, self.name)
        torque = gravity_torques(arm, commanded(data, self.name)) / self.reference
        return tuple(
            Term(
                f"{self.name}.{joint}",
                "rad" if arm.is_revolute(joint) else "m",
                1e-4,
                (Part(arm.axis_motion(joint), torque[arm.number(joint)] ** 3),),
            )
            for joint in self.joints
        )

    def settings(self) -> dict[str, Any]:
        """Return the reference torque."""
        return {"torque_nm": self.reference}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Read ``torque_nm``."""
        other_settings = dict(settings)
        reference = other_settings.pop("torque_nm", cls.reference)
        if other_settings:
            raise ValueError(f"{cls.name} has no setting {', '.join(map(repr, other_settings))}")
        if isinstance(reference, bool) or not isinstance(reference, int | float) or not 0 < reference < np.inf:
            raise ValueError(f"{cls.name}: torque_nm must be a number above 0, found {reference!r}")
        return cls(joints, float(reference))


_LEAST_TORQUE = 1e-3
"""N m below which gravity has no torque about a joint."""
