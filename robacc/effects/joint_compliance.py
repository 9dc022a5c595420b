"""Compliance of joints under the arm's own weight."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

from robacc.effects.base import (
    About,
    Effect,
    Over,
    Term,
    Traits,
    commanded,
    compliance_unit,
    register,
    setting,
    weight_needed,
)
from robacc.effects.elastic import DEFLECTIONS, OwnWeight, base_regressors
from robacc.gravity.loads import unit_loads
from robacc.gravity.torques import bears_weight
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_ODDS_OF_WRONG_MASSES = 1.0 / 150.0
"""Prior odds of uncertain masses against the file's: where both fit, the file's hold."""
_MASS_ERROR = 0.25
"""Relative standard deviation of uncertain masses."""


@register
@dataclass(frozen=True)
class JointCompliance(OwnWeight):
    """Each joint turned by c times the torque of gravity about its axis, in equilibrium.

    With masses ``unknown`` the torque's base regressors are fitted; their coefficients are compliance x mass and
    compliance x first moment. With masses ``uncertain`` the file's are a start, and the same regressors, shrunk by a
    prior in proportion to each link's own mass, correct them.
    """

    masses: Literal["known", "uncertain", "unknown"] = setting("known")  # type: ignore[assignment]

    name = "joint_compliance"
    traits = Traits(
        extrapolates="Hooke's law: deflection in proportion to the torque", is_spring=True, is_nonnegative=True
    )
    about = About(
        summary="the joint's gear deflects under the torque of the arm's own weight",
        equation="theta_j + c_j tau_j, tau_j the torque of gravity about the axis at the deflected pose; "
        f"{DEFLECTIONS}",
        unit="rad/(N m) (m/N for a prismatic joint); masses unknown: the same times kg or kg m",
        usual_size="1e-7 rad/(N m) on large arms to 5e-5 rad/(N m) in the wrists of small ones",
        usual_range=(1e-07, 5e-05),
        needs="mass and com of the links; without them the torque's base regressors are fitted",
        confused_with="transmission_error of order 1 on joints with a horizontal axis, base_compliance, "
        "payload_compliance",
        source="Khalil and Dombre 2002, ch. 8 and 9.5; Klimchik et al. 2014",
        example="{effect: joint_compliance, joints: [j2, j3], values: {j2: 2e-6, j3: 5e-6}}",
    )

    @property
    def prior_odds(self) -> float:
        """Odds of masses that are wrong by more than their uncertainty, which standard errors include in any case."""
        return _ODDS_OF_WRONG_MASSES if self.masses == "uncertain" else 1.0

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time, with the file's masses and, where weight can load it, with uncertain ones."""
        bears = bears_weight(arm, commanded(data, cls.name))
        for joint in arm.names:
            yield cls.usual(arm, data, (joint,))
            if arm.chain.bodies and bears[arm.number(joint)]:
                yield cls((joint,), "uncertain")

    def chart(self) -> Over:
        """Return gravity's torque on the joint, or its variable if the masses are unknown."""
        return Over("{joint}" if self.masses == "unknown" else "torque_{joint}", self.masses == "known")

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint, or one for each base regressor."""
        terms = []
        own_weight = () if self.masses == "unknown" else weight_needed(arm, data, self.name)
        for joint in self.joints:
            motion = arm.axis_motion(joint)
            unit = compliance_unit(arm, joint)
            if self.masses != "unknown":
                terms.append(Term(f"{self.name}.{joint}", unit, 1e-5, (self.part(motion, own_weight),)))
            if self.masses == "known":
                continue
            stds = regressor_stds(arm, _MASS_ERROR) if self.masses == "uncertain" else None
            loads, parts = unit_loads(arm, arm.owners[arm.number(joint)]), partial(self.parts, (motion,))
            terms.extend(base_regressors(f"{self.name}.{joint}", unit, 1e-5, loads, parts, stds))
        return tuple(terms)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return that the weight is not the file's, if the masses are uncertain."""
        if self.masses != "uncertain":
            return None
        return (
            f"the torque that deflects {', '.join(self.joints)} is not that of the masses in the robot file: these "
            "masses are wrong, a link carries a load that the file does not state, or a counterbalance (a spring or "
            "cylinder across the joint) carries a part of the weight; look for a hose, a valve block, or an undeclared "
            "tool or part, and add its mass to its link"
        )


def regressor_stds(arm: Arm, error: float) -> dict[str, float]:
    """Return the prior std of each base regressor: a share ``error`` of the link's mass, and of its first moment."""
    stds = {}
    for body in arm.chain.bodies:
        reach = max(math.hypot(*body.com), 0.05)
        stds[f"m{body.owner + 1}"] = error * body.mass
        stds |= {f"{label}{body.owner + 1}": error * body.mass * reach for label in ("hx", "hy", "hz")}
    smallest = min(stds.values())
    return {
        f"{label}{i + 1}": stds.get(f"{label}{i + 1}", 0.1 * smallest)
        for i in range(len(arm.robot.joints))
        for label in ("m", "hx", "hy", "hz")
    }
