"""Effects on a joint's variable by its own motion or another's: ratio, coupling, backlash, friction, lag."""

import itertools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robacc.effects.base import (
    DIRECTION,
    MASSES,
    SPEED,
    About,
    Effect,
    Need,
    Over,
    Part,
    Term,
    Traits,
    compliance_unit,
    driven_by,
    register,
    setting,
    varies,
    weight_needed,
)
from robacc.geometry import Array
from robacc.gravity import weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
class GearRatio(Effect):
    """Joint variable scaled by 1 + k."""

    traits = Traits(chart=Over("{joint}"), extrapolates="a ratio acts in proportion to the joint's angle or travel")
    about = About(
        summary="joint angle scaled: the gear ratio, or a linear axis' pitch, is not the controller's",
        equation="theta_j + k q_j (d_j + k q_j for a prismatic joint)",
        unit="1",
        usual_size="1e-5 to 1e-3",
        usual_range=(1e-05, 0.001),
        needs="q1 … qN over a wide range",
        confused_with="transmission_error of order 1 over a narrow range, joint_compliance of the same joint",
        source="a parameter times a regressor, as every effect here; Whitney, Lozinski, Rourke 1986",
        example="{effect: gear_ratio, joints: [j3], values: {j3: 1e-4}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        return tuple(
            self.joint_term(arm, joint, driven_by(arm, data, joint, self.name), unit="1") for joint in self.joints
        )


@register
@dataclass(frozen=True)
class JointCoupling(Effect):
    """Joint j turned by k times joint i's variable, for each driver i."""

    drivers: tuple[str, ...] = setting(())

    traits = Traits(extrapolates="a coupling acts in proportion to the driving joint's angle")
    about = About(
        summary="one joint turns another: wrist gears, a parallelogram, a belt over an axis",
        equation="theta_j + k q_i, i not j",
        unit="1 (rad/m, m/rad between unlike joints)",
        usual_size="1e-4 to 1e-2",
        usual_range=(0.0001, 0.01),
        needs="q1 … qN that vary independently",
        confused_with="gear_ratio of the driving joint where both axes are parallel",
        source="a parameter times a regressor, as every effect here; Whitney, Lozinski, Rourke 1986",
        example="{effect: joint_coupling, joints: [j6], drivers: [j5], values: {j6.j5: 1e-3}}",
    )

    @property
    def form(self) -> Traits:
        """Return that it is drawn over the joint that turns this joint, if there is a single one."""
        return self.traits._replace(chart=Over(self.drivers[0]) if len(self.drivers) == 1 else None)

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints that turn others."""
        return tuple(dict.fromkeys(driver for joint in self.joints for driver in self._drivers(arm, joint)))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per pair of joints."""
        return tuple(
            self.joint_term(
                arm,
                joint,
                driven_by(arm, data, driver, self.name),
                driver,
                1e-3,
                unit="1" if arm.unit(joint) == arm.unit(driver) else f"{arm.unit(joint)}/{arm.unit(driver)}",
            )
            for joint in self.joints
            for driver in self._drivers(arm, joint)
            if driver != joint
        )

    def _drivers(self, arm: Arm, joint: str) -> tuple[str, ...]:
        """Return the joints that turn a joint: by default those next to it."""
        i = arm.number(joint)
        return self.drivers or tuple(arm.names[k] for k in (i - 1, i + 1) if 0 <= k < len(arm.names))

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield every ordered pair of joints, neighbours first."""
        pairs = itertools.permutations(range(len(arm.names)), 2)
        for j, i in sorted(pairs, key=lambda pair: abs(pair[0] - pair[1])):
            yield cls((arm.names[j],), (arm.names[i],))

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the effect of the ``drivers``, a name or a list of names."""
        listed = {key: [value] if isinstance(value, str) else value for key, value in settings.items()}
        return super().from_settings(joints, listed)


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

    traits = Traits(
        implausible_factor=60.0,  # Hobby servos have a degree (github.com/TheRobotStudio/SO-ARM100, issue 134).
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
        usual_size="1e-5 to 5e-4 rad, 1e-2 in hobby servos; negative where the joint stops short",
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
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield the form by the approach if it is known, and those by gravity if its torque changes sign."""
        number = arm.number(joints[0])
        torques = weight_torques(arm, data) if arm.chain.bodies else np.zeros((number + 1, 1))
        # Rounding gives a joint whose axis is vertical a torque of either sign.
        torque, none = torques[number], math.sqrt(np.finfo(float).eps) * float(np.abs(torques).max())
        if varies(data.direction):
            yield cls(joints)
        if torque.min() < -none and none < torque.max():
            yield cls(joints, "gravity")
            if varies(data.direction):
                # Frictions near these shares of the largest torque, each of which changes the flank of some poses.
                frictions = _distinct_frictions(number, torque, data)
                # Over the largest torque of gravity on the joint.
                shares = [
                    share * float(np.abs(torque).max()) for share in (0.01, 0.02, 0.04, 0.08, 0.16) if frictions.size
                ]
                nearest = sorted({int(np.argmin(np.abs(frictions - share))) for share in shares})
                yield from (cls(joints, "gravity", float(frictions[i])) for i in nearest)

    def refinements(self, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield, by gravity with friction, every friction that leaves another set of poses on their flank."""
        if self.friction > 0.0 and varies(data.direction):
            number = arm.number(self.joints[0])
            frictions = _distinct_frictions(number, weight_torques(arm, data)[number], data)
            yield from (Backlash(self.joints, "gravity", friction) for friction in frictions.tolist())

    @property
    def form(self) -> Traits:
        """Return what decides the flank: the direction of approach, gravity's torque, or with friction both."""
        over = Over("torque_{joint}" if self.by == "gravity" else "direction_{joint}")
        follows = self.by == "approach" or self.friction > 0.0
        return self.traits._replace(chart=over, follows_approach=follows)

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
        # A torque that rounding or a lever of a tenth of a millimetre decides does not press the gear against a flank.
        return np.where(np.abs(torque) > 1e-3 * weight, np.sign(torque), 0.0)

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if there is a friction without gravity."""
        return "friction_nm belongs to by: gravity" if self.friction and self.by != "gravity" else None

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return that the load decides the flank, if it does."""
        unit = "N m" if arm.is_revolute(self.joints[0]) else "N"
        friction = f"; below {self.friction:.3g} {unit} it stays on the flank of its approach" if self.friction else ""
        text = (
            f"the gear rests on the flank that gravity presses it to{friction}: it jumps where the torque changes sign"
        )
        return text if self.by == "gravity" else None


def _distinct_frictions(number: int, torque: Array, data: Measurements) -> Array:
    """Return frictions (N m) of which no two leave the same poses on the flank of their approach.

    Only poses matter that gravity presses against the other flank. Each friction is the geometric mean of the torques
    of two of them: as a scale, it is as likely in one decade as in another. At most :data:`_MOST_FRICTIONS` are kept,
    evenly spread over their number.
    """
    assert data.direction is not None
    direction, size = data.direction[number], np.abs(torque)
    # Largest friction that a search tries, over the largest torque of gravity on the joint.
    opposed = np.unique(size[(np.sign(torque) * direction < 0) & (size < 0.3 * size.max())])
    between = np.sqrt(opposed * np.append(opposed[1:], 1.2 * opposed[-1:]))
    if between.size > _MOST_FRICTIONS:
        between = between[np.linspace(0, between.size - 1, _MOST_FRICTIONS).round().astype(int)]
    return np.array([float(f"{friction:.6g}") for friction in between.tolist()])


@register
class FrictionWindup(Effect):
    """Joint variable shifted against the approach by c times the size of gravity's torque.

    Friction of the loaded gear holds the joint short of its equilibrium. The torque is that at the commanded pose.
    """

    traits = Traits(
        needs=(DIRECTION, MASSES),
        chart=Over("signed_torque_{joint}"),
        follows_approach=True,
        extrapolates="friction acts in proportion to the load",
    )
    about = About(
        summary="friction of the loaded gear holds the joint short of its pose: a lost motion that grows with the load",
        equation="theta_j + c |tau_j| sign(approach_j), tau_j the torque of gravity about the axis",
        unit="rad/(N m) (m/N for a prismatic joint)",
        usual_size="1e-9 to 1e-6 rad/(N m); negative where the joint stops short",
        usual_range=(1e-9, 1e-6),
        needs="dir_q1 … dir_qN, or `ordered`; mass and com of the links",
        confused_with="backlash where the torque hardly changes, joint_compliance",
        source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083: friction that grows with load",
        example="{effect: friction_windup, joints: [j2], values: {j2: -2e-6}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        return tuple(
            self.joint_term(
                arm,
                joint,
                driven_by(arm, data, f"signed_torque_{joint}", self.name),
                typical=1e-6,
                unit=compliance_unit(arm, joint),
            )
            for joint in self.joints
        )


@register
@dataclass(frozen=True)
class ApproachLag(Effect):
    """Joint variable shifted by the signed speed of its last motion.

    With ``common`` all joints share a coefficient: a delay between the arm's clock and the instrument's.
    """

    common: bool = setting(False)

    traits = Traits(
        needs=(SPEED,),
        drivers=("speed_{joint}",),
        chart=Over("speed_{joint}"),
        extrapolates="a lag acts in proportion to the speed",
    )
    about = About(
        summary="the pose was read before the joint had settled, or the clocks differ: the last motion's speed shows",
        equation="theta_j + c s_j, s_j the last motion's speed as a signed fraction of full speed; with common: true "
        "the same c for all joints",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-5 to 1e-3 rad at full speed; negative where the joint lags behind",
        usual_range=(1e-05, 0.001),
        needs="speed_q1 … speed_qN, or `ordered`",
        confused_with="backlash where all speeds are similar",
        source="a parameter times a regressor, as every effect here",
        example="{effect: approach_lag, joints: [j1], values: {j1: -2e-4}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time, and a delay common to all rotary joints."""
        yield from super().candidates(arm, data)
        rotary = tuple(joint for joint in arm.names if arm.is_revolute(joint))
        if len(rotary) > 1:
            yield cls(rotary, common=True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        speeds = {joint: driven_by(arm, data, f"speed_{joint}", self.name) for joint in self.joints}
        if self.common:
            parts = tuple(Part(arm.axis_motion(joint), speed) for joint, speed in speeds.items())
            return (Term(f"{self.name}.common", "rad", 1e-4, parts),)
        return tuple(self.joint_term(arm, joint, speed) for joint, speed in speeds.items())

    def __str__(self) -> str:
        """Return ``approach_lag[j1]`` or ``approach_lag[common]``."""
        return f"{self.name}[common]" if self.common else super().__str__()
