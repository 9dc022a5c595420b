"""Springs of joints that become stiffer, or softer, with the torque."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import (
    MASSES,
    About,
    Effect,
    Over,
    Term,
    Traits,
    compliance_unit,
    driven_by,
    register,
    setting,
)
from robacc.effects.drivers import Validity
from robacc.geometry import Array
from robacc.gravity.torques import weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_LEAST_TORQUE = 1e-3
"""N m below which gravity has no moment about a joint."""
_LARGEST_COMPLIANCE = 5e-4
"""rad/(N m), or m/N: ten times the largest usual compliance of a joint."""
_BEYOND = 1.5
"""Torque over the largest on the poses of the fit, up to which the law of the spring is used. On simulated arms poses
that exceed that torque a little are predicted twice as well as with a deflection that is held at it."""
_KNEES = np.geomspace(0.02, 4.0, 40)
"""Knees that a search tries, over the largest torque of gravity on the joint."""


@register
@dataclass(frozen=True)
class JointHardening(Effect):
    """Joint variable plus c times the cube of gravity's torque over a reference torque.

    With a ``knee`` the spring is that of torque = k x (1 + (x / x_knee)^2), whose deflection grows with the cube root
    of large torques. The coefficient is then the compliance 1 / k at small torques.
    """

    reference: float = setting(100.0, key="torque_nm", above=0.0, written=lambda spring: spring.knee is None)
    """Torque at which the coefficient is the deflection, N m (N for a prismatic joint)."""
    knee: float | None = setting(None, key="knee_nm", above=0.0)
    """Torque k x_knee of the spring without its cubic part at x_knee, N m; None for the cube of the torque."""

    largest_torques: Mapping[str, float] = dataclasses.field(default_factory=dict, repr=False, compare=False)
    """Largest torque on a joint, either way, beyond which the deflection is held; none while it is fitted."""

    name = "joint_hardening"
    traits = Traits(needs=(MASSES,), drivers=("{joint}", "torque_{joint}"), chart=Over("torque_{joint}"))
    about = About(
        summary="the joint's spring hardens: strain-wave gears and gears with play are soft at small torque",
        equation="theta_j + c (tau_j / tau_ref)^3, tau_j the torque of gravity about the axis; with knee_nm: "
        "theta_j + c tau_k (z - tau_j / tau_k), z + z^3 = tau_j / tau_k",
        unit="rad (m for a prismatic joint) at the reference torque; with knee_nm rad/(N m)",
        usual_size="1e-5 to 1e-3 rad; opposite in sign to the compliance where the spring hardens; with knee_nm as "
        "joint_compliance",
        usual_range=(1e-5, 1e-3),
        needs="mass and com of the links",
        confused_with="joint_compliance where the torque's range is small, transmission_error of orders 1 and 3, "
        "joint_correction by the torque",
        source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12 (1996) 368: cubic stiffness of strain-wave "
        "gears",
        example="{effect: joint_hardening, joints: [j2], torque_nm: 50, values: {j2: -2e-4}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the effect with the largest torque on these joints as the reference, to two digits."""
        largest = _largest_torque(arm, data, joints)
        return cls(joints, float(f"{largest:.2g}") if largest > _LEAST_TORQUE else cls.reference)

    def refinements(self, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield the spring with each of many knees."""
        largest = _largest_torque(arm, data, self.joints)
        if largest > _LEAST_TORQUE:
            yield from (JointHardening(self.joints, knee=float(f"{share * largest:.3g}")) for share in _KNEES)

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason also if a small torque would deflect a joint as only a much softer one does."""
        if self.knee is None:
            for term, value in zip(terms, values, strict=True):
                compliance = 3.0 * abs(value) / self.reference
                if compliance > _LARGEST_COMPLIANCE:
                    load, per_load = ("N m", "(N m)") if term.unit == "rad" else ("N", "N")
                    return (
                        f"{term.name} = {value:.3g} {term.unit} at {self.reference:.3g} {load} is implausible: the "
                        f"joint would have a compliance of {compliance:.2g} {term.unit}/{per_load}"
                    )
        return super().implausible(terms, values)

    def within(self, validity: Validity) -> Effect:
        """Return the effect with its deflection held beyond :data:`_BEYOND` times the largest torques of ``validity``.

        The cube of a torque that is ten times as large would be a thousand times as large.
        """
        torques = {joint: validity.get(f"torque_{joint}") for joint in self.joints}
        largest = {joint: _BEYOND * max(map(abs, limits)) for joint, limits in torques.items() if limits}
        return dataclasses.replace(self, largest_torques=largest) if largest else self

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        terms = []
        for joint in self.joints:
            largest = self.largest_torques.get(joint, np.inf)
            column = self._regressor(np.clip(driven_by(arm, data, f"torque_{joint}", self.name), -largest, largest))
            unit, typical = (arm.unit(joint), 1e-4) if self.knee is None else (compliance_unit(arm, joint), 1e-5)
            terms.append(self.joint_term(arm, joint, column, typical=typical, unit=unit))
        return tuple(terms)

    def _regressor(self, torque: Array) -> Array:
        if self.knee is None:
            return np.asarray((torque / self.reference) ** 3)
        share = torque / self.knee
        # The only real root of z + z^3 = share.
        root = 2.0 / np.sqrt(3.0) * np.sinh(np.arcsinh(1.5 * np.sqrt(3.0) * share) / 3.0)
        return np.asarray(self.knee * (root - share))

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the torque of the knee, if there is one."""
        if self.knee is None:
            return None
        unit = "N m" if arm.is_revolute(self.joints[0]) else "N"
        # The slope k (1 + 3 z^2) is 2 k at z = 1 / sqrt(3).
        doubled = self.knee * 4.0 / 3.0 / np.sqrt(3.0)
        return f"the spring hardens: it is twice as stiff at {doubled:.3g} {unit} as without load"

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if there are both a reference torque and a knee."""
        return "expected torque_nm or knee_nm, not both" if len(given) > 1 else None


def _largest_torque(arm: Arm, data: Measurements, joints: Sequence[str]) -> float:
    """Return the largest torque of gravity on some joints, N m."""
    torque = weight_torques(arm, data)
    return max((float(np.abs(torque[arm.number(joint)]).max(initial=0.0)) for joint in joints), default=0.0)
