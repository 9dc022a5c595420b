"""Springs of joints whose compliance differs with the joint's angle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import MASSES, About, Effect, Over, Term, Traits, driven_by, register
from robacc.effects.orders import orders_setting
from robacc.effects.search_forms import searched_order
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class ComplianceVariation(Effect):
    """Joint variable plus gravity's torque times c cos(n q_j) + s sin(n q_j).

    It adds to ``joint_compliance``, the mean over a turn. The torque is that at the commanded pose.
    """

    orders: tuple[float, ...] = orders_setting((2.0,))

    name = "compliance_variation"
    traits = Traits(
        only="revolute",
        needs=(MASSES,),
        drivers=("{joint}", "torque_{joint}"),
        chart=Over("torque_{joint}", is_only=False),
    )
    about = About(
        summary="the joint's spring is softer at some angles: a periodic error that grows with the torque",
        equation="theta_j + tau_j (c cos(n q_j) + s sin(n q_j)), tau_j the torque of gravity about the axis; "
        "a trace tries n = 1, 2, and the orders of periodic errors that it has identified",
        unit="rad/(N m)",
        usual_size="1e-8 to 1e-6 rad/(N m), a tenth to a third of the joint's compliance",
        usual_range=(1e-8, 1e-6),
        needs="mass and com of the links; poses of different torque at the same angle",
        confused_with="transmission_error where the torque follows the angle, joint_hardening",
        source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12 (1996) 368: stiffness of strain-wave gears "
        "over the angle",
        example="{effect: compliance_variation, joints: [j2], orders: [2], values: {j2.cos2: 2e-7, j2.sin2: 1e-7}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield order 1 and order 2 of one joint at a time."""
        for joint in cls.possible_joints(arm):
            yield cls((joint,), (1.0,))
            yield cls((joint,), (2.0,))

    @classmethod
    def beside(cls, other: Effect, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield the order of a periodic error that a search has identified: gears err more under load."""
        order = searched_order(other)
        if order is not None and set(other.joints) <= set(cls.possible_joints(arm)) and cls.missing(arm, data) is None:
            yield cls(other.joints, (order,))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a cosine and a sine for each order of each joint."""
        terms = []
        for joint in self.joints:
            torque, q = driven_by(arm, data, f"torque_{joint}", self.name), driven_by(arm, data, joint, self.name)
            for order in self.orders:
                for label, wave in (("cos", np.cos), ("sin", np.sin)):
                    column = torque * wave(order * q)
                    terms.append(self.joint_term(arm, joint, column, f"{label}{order:g}", 1e-6, unit="rad/(N m)"))
        return tuple(terms)
