"""Bearings that tilt under the bending moment across a joint's axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from robacc.effects.base import About, Effect, Term, Traits, commanded, register, weight_needed
from robacc.effects.elastic import DEFLECTIONS, OwnWeight, base_regressors
from robacc.gravity.loads import unit_loads
from robacc.measurements import Measurements
from robacc.robots.arm import FLEXURES, Arm

_UPRIGHT = 0.02
"""Largest sine of the angle between an upright axis and gravity."""


@register
@dataclass(frozen=True)
class LateralCompliance(OwnWeight):
    """Each joint's axis tilted by c times the bending moment, the same stiffness in both directions.

    With masses ``unknown`` the bending moment's base regressors are fitted, as those of ``joint_compliance`` are.
    """

    name = "lateral_compliance"
    traits = Traits(extrapolates="Hooke's law: deflection in proportion to the bending moment")
    about = About(
        summary="the joint's bearing and link bend: the axis tilts under the bending moment across it",
        equation="rotations about x and y in front of joint j + c_j (m_x, m_y), the bending moment of gravity about "
        f"them at the deflected pose; {DEFLECTIONS}",
        unit="rad/(N m); masses unknown: the same times kg or kg m",
        usual_size="1e-8 to 1e-5 rad/(N m)",
        usual_range=(1e-08, 1e-05),
        needs="mass and com of the links; without them the base regressors of the bending moment are fitted",
        confused_with="joint_compliance of neighbouring joints, base_compliance at the first joint",
        source="Tenhumberg and Baeuml 2021 (elastic calibration of Agile Justin)",
        example="{effect: lateral_compliance, joints: [j2], values: {j2: 1e-6}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time; without masses only upright joints, but for the first.

        Any other joint without masses bends less than it turns, and the first bends as the base tilts.
        """
        possible = arm.names if arm.chain.bodies else _upright_joints(arm, data)[1:]
        yield from (cls.usual(arm, data, (joint,)) for joint in possible)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint, or one for each base regressor."""
        terms: list[Term] = []
        weight = () if self.masses == "unknown" else weight_needed(arm, data, self.name)
        for joint in self.joints:
            name, tilt = f"{self.name}.{joint}", tuple(arm.motion(joint, label) for label in FLEXURES)
            if self.masses == "known":
                terms.append(Term(name, "rad/(N m)", 1e-5, self.parts(tilt, weight)))
            else:
                loads = unit_loads(arm, arm.owners[arm.number(joint)])
                terms += base_regressors(name, "rad/(N m)", 1e-5, loads, partial(self.parts, tilt))
        return tuple(terms)


def _upright_joints(arm: Arm, data: Measurements) -> tuple[str, ...]:
    """Return the first joint and the rotary joints whose axis is parallel to gravity at every pose."""
    motions = [arm.axis_motion(joint) for joint in arm.names]
    axes = arm.chain.sweep(arm.chain.scalars(commanded(data, "a joint's axis")), data.n, motions, ()).jacobian[3:]
    down = np.array(arm.robot.gravity) / max(float(np.sqrt(np.sum(np.square(arm.robot.gravity)))), 1e-12)
    sine = np.sqrt(np.maximum(1 - np.square(np.einsum("i,ijn->jn", down, axes)), 0.0)).max(axis=1)
    upright = [
        joint for joint, value in zip(arm.names, sine, strict=True) if arm.is_revolute(joint) and value < _UPRIGHT
    ]
    return (arm.names[0], *(joint for joint in upright if joint != arm.names[0]))
