"""Backlash: the joint rests on one flank of its gear or the other."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import (
    About,
    Effect,
    Need,
    Over,
    Term,
    Traits,
    driven_by,
    needed,
    register,
    setting,
    varies,
    weight_needed,
)
from robacc.geometry import Array
from robacc.gravity.torques import weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_LEAST_LEVER = 1e-3
"""Lever of the arm's whole weight, m, below which gravity's torque presses against no flank."""
_FRICTION_SHARES = (0.01, 0.02, 0.04, 0.08, 0.16)
"""Friction that a search tries first, over the largest torque of gravity on the joint."""
_LARGEST_SHARE = 0.3
"""Largest friction that a search tries, over the same."""
_MOST_FRICTIONS = 60
"""Largest number of frictions that a search tries."""


@register
@dataclass(frozen=True)
class Backlash(Effect):
    """Joint variable shifted by half the gap, by the direction of approach or of gravity's torque.

    By gravity with friction, a torque below the friction does not move the joint off the flank of its approach.
    """

    by: Literal["approach", "gravity"] = setting("approach")
    friction: float = setting(0.0, key="friction_nm", least=0.0)
    """Friction that gravity's torque must overcome, N m (N for a prismatic joint); only by gravity."""

    name = "backlash"
    traits = Traits(
        needs=(
            Need(
                "no dir_q columns, `ordered` is not set, and no masses in the robot file",
                lambda arm, data: varies(data.direction) or bool(arm.chain.bodies),
            ),
        ),
        needs_of_usual_form=(
            Need(
                "by the approach: no dir_q columns, and `ordered` is not set", lambda arm, data: varies(data.direction)
            ),
        ),
        drivers=(),
        extrapolates="backlash has two values, one for each direction of approach",
    )
    about = About(
        summary="clearance in the gear: the joint rests on the flank it came from, or that gravity pushes it to",
        equation="theta_j + c sign(approach_j); with by: gravity, c sign(tau_j + friction approach_j), tau_j the "
        "torque of gravity about the axis",
        unit="rad (m for a prismatic joint), half the gap",
        usual_size="1e-5 to 5e-4 rad; negative where the joint stops short",
        usual_range=(1e-05, 0.0005),
        needs="dir_q1 … dir_qN, or `ordered`; by gravity: masses, and a torque that changes sign",
        confused_with="approach_lag where all speeds are similar, joint_compliance where gravity decides",
        source="Ruderman, Hoffmann, Bertram 2009 for the shape; Nordin and Gutman, Automatica 38 (2002) 1633, for the "
        "flank of a loaded gear",
        example="{effect: backlash, joints: [j2], values: {j2: -1e-4}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the effect by the approach if it is known, else by gravity."""
        return cls(joints, "approach" if data.direction is not None else "gravity")

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time: by the approach if it is known, and by gravity if its torque changes sign."""
        torque = np.zeros((len(arm.names), 1))
        if arm.chain.bodies:
            torque = weight_torques(arm, data)
        for joint, moment in zip(arm.names, torque, strict=True):
            if varies(data.direction):
                yield cls((joint,))
            if moment.min() < 0 < moment.max():
                yield cls((joint,), "gravity")
                if varies(data.direction):
                    # Frictions near these shares of the largest torque, each of which changes the flank of some poses.
                    frictions = _distinct_frictions(arm.number(joint), moment, data)
                    shares = [share * float(np.abs(moment).max()) for share in _FRICTION_SHARES if frictions.size]
                    nearest = sorted({int(np.argmin(np.abs(frictions - share))) for share in shares})
                    yield from (cls((joint,), "gravity", float(frictions[i])) for i in nearest)

    def refinements(self, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield, by gravity with friction, every friction that leaves another set of poses on their flank."""
        if self.friction > 0.0 and varies(data.direction):
            number = arm.number(self.joints[0])
            torque = weight_torques(arm, data)[number]
            frictions = _distinct_frictions(number, torque, data)
            yield from (Backlash(self.joints, "gravity", friction) for friction in frictions.tolist())

    @property
    def follows_approach(self) -> bool:
        """True unless gravity alone decides the flank."""
        return self.by == "approach" or self.friction > 0.0

    def chart(self) -> Over:
        """Return the direction of approach, or gravity's torque if that decides the flank."""
        return Over("torque_{joint}" if self.by == "gravity" else "direction_{joint}")

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        return tuple(self.joint_term(arm, joint, self._flank(arm, data, joint)) for joint in self.joints)

    def _flank(self, arm: Arm, data: Measurements, joint: str) -> Array:
        """Return ``(N,)`` the side of the flank on which the joint rests."""
        if self.by == "approach":
            return driven_by(arm, data, f"direction_{joint}", self.name)
        loads = weight_needed(arm, data, f"{self.name} by gravity")
        torque = driven_by(arm, data, f"torque_{joint}", f"{self.name} by gravity")
        if self.friction > 0.0:
            approach = driven_by(arm, data, f"direction_{joint}", self.name)
            return np.where(np.abs(torque) > self.friction, np.sign(torque), approach)
        weight = float(np.linalg.norm(arm.robot.gravity)) * sum(float(np.max(load.mass)) for load in loads)
        # A torque that rounding or a tenth of a millimetre decides does not press the gear against a flank.
        return np.where(np.abs(torque) > _LEAST_LEVER * weight, np.sign(torque), 0.0)

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if there is a friction without gravity."""
        return "friction_nm belongs to by: gravity" if self.friction and self.by != "gravity" else None

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return that the load decides the flank, if it does."""
        if self.by == "approach":
            return None
        unit = "N m" if arm.is_revolute(self.joints[0]) else "N"
        friction = f"; below {self.friction:.3g} {unit} it stays on the flank of its approach" if self.friction else ""
        return (
            f"the gear rests on the flank that gravity presses it to{friction}: it jumps where the torque changes sign"
        )


def _distinct_frictions(number: int, torque: Array, data: Measurements) -> Array:
    """Return frictions (N m) of which no two leave the same poses on the flank of their approach.

    Only poses matter that gravity presses against the other flank. Each friction is the geometric mean of the torques
    of two of them: as a scale, it is as likely in one decade as in another. At most :data:`_MOST_FRICTIONS` are kept,
    evenly spread over their number.
    """
    direction = needed(data.direction, "dir_q1 …", Backlash.name)[number]
    size = np.abs(torque)
    opposed = np.unique(size[(np.sign(torque) * direction < 0) & (size < _LARGEST_SHARE * size.max())])
    if opposed.size == 0:
        return np.zeros(0)
    between = np.sqrt(opposed * np.append(opposed[1:], 1.2 * opposed[-1]))
    if between.size > _MOST_FRICTIONS:
        between = between[np.linspace(0, between.size - 1, _MOST_FRICTIONS).round().astype(int)]
    return np.array([float(f"{friction:.6g}") for friction in between.tolist()])
