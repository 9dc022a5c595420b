"""Effects on a joint's variable by its own motion or another's, and the empirical correction of joints.

Effects with a cause are ratio, coupling, backlash, friction and lag. The correction has none: it is a polynomial of one
or two drivers, or a smooth function of all joints.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
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
    as_plain,
    commanded,
    compliance_unit,
    driven_by,
    register,
    scaled,
    setting,
    varies,
    weight_needed,
)
from robacc.effects.drivers import Validity
from robacc.geometry import Array
from robacc.gravity import weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import BASE, Arm


@register
@dataclass(frozen=True)
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

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints that turn others."""
        return tuple(driver for joint in self.joints for driver in self._drivers(arm, joint))

    def chart(self) -> Over | None:
        """Return the joint that turns this joint, if there is a single one."""
        return Over(self.drivers[0]) if len(self.drivers) == 1 else None

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
                shares = [share * float(np.abs(torque).max()) for share in _FRICTION_SHARES if frictions.size]
                nearest = sorted({int(np.argmin(np.abs(frictions - share))) for share in shares})
                yield from (cls(joints, "gravity", float(frictions[i])) for i in nearest)

    def refinements(self, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield, by gravity with friction, every friction that leaves another set of poses on their flank."""
        if self.friction > 0.0 and varies(data.direction):
            number = arm.number(self.joints[0])
            frictions = _distinct_frictions(number, weight_torques(arm, data)[number], data)
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
    assert data.direction is not None
    direction, size = data.direction[number], np.abs(torque)
    opposed = np.unique(size[(np.sign(torque) * direction < 0) & (size < _LARGEST_SHARE * size.max())])
    if opposed.size == 0:
        return np.zeros(0)
    between = np.sqrt(opposed * np.append(opposed[1:], 1.2 * opposed[-1]))
    if between.size > _MOST_FRICTIONS:
        between = between[np.linspace(0, between.size - 1, _MOST_FRICTIONS).round().astype(int)]
    return np.array([float(f"{friction:.6g}") for friction in between.tolist()])


@register
@dataclass(frozen=True)
class FrictionWindup(Effect):
    """Joint variable shifted against the approach by c times the size of gravity's torque.

    Friction of the loaded gear holds the joint short of its equilibrium. The torque is that at the commanded pose.
    """

    traits = Traits(
        needs=(DIRECTION, MASSES),
        chart=Over("signed_torque_{joint}"),
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

    @property
    def follows_approach(self) -> bool:
        """Return True: friction acts against the approach."""
        return True

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


# Empirical correction of joints.

_CORRECTION = About(
    summary="empirical correction of one joint as a smooth function of a driver, or of joints or the position as one "
    "of the pose",
    equation="theta_j + sum c_k T_k(x), T_k Chebyshev polynomials of the driver scaled to its range; or theta_j + "
    "sum c_jk phi_k(q), phi a basis of a Gaussian process over the joints; or the same of the position",
    unit="rad (m for a prismatic joint)",
    usual_size="1e-5 to 1e-3 rad",
    usual_range=(1e-05, 0.001),
    needs="the driver's column, for example time_s",
    confused_with="every effect of the same joints; a trace adds it where no cause describes an error",
    source="M. C. Kennedy, A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63 (2001) 425; "
    "prior width by marginal likelihood (REML)",
    example="{effect: joint_correction, joints: [j3], drivers: [j2], range: [[-1, 1]], degree: 3, "
    "values: {j3.j2.T2: 1e-4}}",
)
_OF_JOINT = {"own": "{joint}", "torque": "torque_{joint}", "direction": "direction_{joint}"}
"""Drivers that are another for each joint, as settings and as :mod:`robacc.effects.drivers` name them."""
_MOST_TERMS = 480
"""Largest number of coefficients: as many as six profiles of a joint have together."""
_LEFT = 0.01
"""Share of the variance of a pose's error and noise that the centres may leave out: a std changes by 0.5 %."""
_JITTER = 1e-9
"""Added to the kernel of the centres, so that its factor exists where two of them nearly coincide."""


@register
@dataclass(frozen=True)
class JointCorrection(Effect):
    """Joint variable plus a polynomial, in Chebyshev form, of one driver or of two together.

    A driver is a joint's name, ``torque`` (of the arm's own weight about the joint's axis), ``payload_kg``,
    ``temperature_c``, ``time_s``, or ``direction`` (of approach; it only multiplies another driver). The terms share a
    Gaussian prior whose standard deviation is estimated. Outside its validity range, a driver stays at the end of it.
    """

    drivers: tuple[str, ...] = setting((), written=True)
    ranges: tuple[tuple[float, float], ...] = setting((), key="range", written=True)
    degree: int = setting(8, written=True, least=1, most=40)

    traits = Traits(is_empirical=True)
    about = _CORRECTION

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a correction of each joint by its own variable."""
        q = commanded(data, cls.name)[[arm.number(joint) for joint in joints]]
        return cls(joints, ("own",), ((float(q.min()), float(q.max())),), 8)

    def chart(self) -> Over:
        """Return the first of the correction's drivers."""
        return Over(_OF_JOINT.get(self.drivers[0], self.drivers[0]), len(self.drivers) == 1)

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints, torques and circumstances that drive it."""
        return tuple(_OF_JOINT.get(driver, driver) for driver in self.drivers if driver != "direction")

    def validity(self, arm: Arm, data: Measurements) -> Validity:
        """Return the ranges that its polynomials are scaled to, whatever the poses."""
        return {
            _OF_JOINT.get(driver, driver).replace("{joint}", joint): ends
            for driver, ends in zip(self.drivers, self.ranges, strict=True)
            for joint in self.joints
            if driver != "direction"
        }

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a term for each polynomial; the constant belongs to joint_offset."""
        drivers = "_".join(self.drivers)
        return tuple(
            self.joint_term(
                arm, joint, column, f"{drivers}.{label}", group=f"{self.name}.{joint}.{drivers}", weight=1.0 / degree
            )
            for joint in self.joints
            for label, degree, column in self._basis(arm, data, joint)
        )

    def _basis(self, arm: Arm, data: Measurements, joint: str) -> Iterator[tuple[str, int, Array]]:
        """Yield label, degree and values ``(N,)`` of each polynomial."""
        columns = []
        for driver, (low, high) in zip(self.drivers, self.ranges, strict=True):
            value = driven_by(arm, data, _OF_JOINT.get(driver, driver).replace("{joint}", joint), self.name)
            if driver == "direction":
                columns.append([np.ones_like(value), value])
                continue
            scaled = np.clip((2 * value - low - high) / ((high - low) or 1.0), -1.0, 1.0)
            columns.append([np.cos(k * np.arccos(scaled)) for k in range(self.degree + 1)])
        if len(columns) == 1:
            yield from ((f"T{k}", k, column) for k, column in enumerate(columns[0]) if k)
            return
        first, second = columns
        for i, a in enumerate(first):
            for j, b in enumerate(second):
                if 0 < i + j <= self.degree + 1 and (j if self.drivers[1] == "direction" else True):
                    yield f"T{i}T{j}", i + j, a * b

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the correction in SI; ranges of joints are in the file's unit of length or angle."""
        sizes = []
        for driver in self.drivers:
            units = {arm.unit(joint) for joint in (self.joints if driver == "own" else (driver,)) if joint in arm.names}
            sizes.append(1.0 if not units else angle if units == {"rad"} else length)
        return dataclasses.replace(self, ranges=tuple(map(scaled, self.ranges, sizes)))

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the correction, or with ``centres`` the one that is a function of all joints."""
        of_pose = "centres" in settings
        return PoseCorrection.from_settings(joints, settings) if of_pose else super().from_settings(joints, settings)

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if there are not one or two drivers, each with a range."""
        if len(self.drivers) not in (1, 2):
            return f"drivers must be a list of one or two names, found {list(self.drivers)!r}"
        if len(self.ranges) != len(self.drivers):
            return f"range must be a list of [low, high], one for each driver, found {as_plain(self.ranges)!r}"
        return None


@dataclass(frozen=True)
class PoseCorrection(Effect):
    """Joint variables, or the position, plus a Gaussian process over all joints, in the basis of some centres.

    It is the form of `joint_correction` with the settings ``lengths`` and ``centres``.
    The kernel of two poses is exp(-sum (2 sin(d_k / 2))^2 / (2 l_k^2)), d_k the difference of joint k (a slide has d_k
    itself) and l_k its length. With L L' the kernel of the centres, the basis is L^-1 k(centres, q) (subset of
    regressors: Rasmussen and Williams 2006, section 8.3.1), whose coefficients have one common variance. Far from the
    centres the correction fades to zero.
    """

    lengths: tuple[float, ...] = setting((), written=True, above=0.0)
    centres: tuple[tuple[float, ...], ...] = setting((), written=True)
    moves: Literal["joints", "position"] = setting("joints")
    """Whether each joint has a process, or the target's position one along each axis of the measuring frame."""

    name = "joint_correction"
    traits = Traits(extrapolates="it fades to zero away from the poses that it was fitted to", is_empirical=True)
    about = _CORRECTION

    @classmethod
    def over(
        cls,
        arm: Arm,
        data: Measurements,
        joints: Sequence[str],
        lengths: Sequence[float],
        moves: Literal["joints", "position"] = "joints",
        noise: float = 0.0,
    ) -> PoseCorrection:
        """Return the correction with centres among these poses, by pivots of their kernel's Cholesky factor.

        ``noise`` is the variance of the noise over that of the process.
        """
        effect = cls(tuple(joints), tuple(map(float, lengths)), moves=moves)
        most = _MOST_TERMS // len(effect.carriers(arm))
        q = commanded(data, cls.name)[[arm.number(joint) for joint in joints]]
        left, factor, chosen = np.ones(data.n), np.zeros((0, data.n)), list[int]()
        # The first centre is the pose nearest to their mean, whatever the order of the rows.
        score = -np.sum(np.square((q - q.mean(axis=1, keepdims=True)) / np.array(lengths)[:, None]), axis=0)
        while data.n and len(chosen) < most and left.max() > _LEFT * (1.0 + noise):
            pivot = int(np.argmax(score))
            row = effect._kernel(arm, q[:, [pivot]], q)[0] - factor[:, pivot] @ factor
            factor = np.vstack((factor, row / np.sqrt(left[pivot])))
            left = left - np.square(factor[-1])
            chosen.append(pivot)
            score = left
        return dataclasses.replace(effect, centres=tuple(tuple(pose) for pose in q[:, chosen].T.tolist()))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a term for each joint and centre."""
        q = commanded(data, self.name)[[arm.number(joint) for joint in self.joints]]
        centres = np.array(self.centres).reshape(-1, len(self.joints)).T
        kernel = self._kernel(arm, centres, centres) + _JITTER * np.eye(len(self.centres))
        basis = np.linalg.solve(np.linalg.cholesky(kernel), self._kernel(arm, centres, q))
        return tuple(
            Term(f"{self.name}.{label}.c{k}", unit, 1e-4, (Part(motion, row),), group=self.name)
            for label, unit, motion in self.carriers(arm)
            for k, row in enumerate(basis, 1)
        )

    def carriers(self, arm: Arm) -> list[tuple[str, str, int]]:
        """Return label, unit and motion of what the processes move: the joints, or the base along its axes."""
        if self.moves == "position":
            return [(axis, "m", arm.chain.index(BASE, axis)) for axis in "xyz"]
        return [(joint, arm.unit(joint), arm.axis_motion(joint)) for joint in self.joints]

    def _kernel(self, arm: Arm, first: Array, second: Array) -> Array:
        """Return ``(A, B)`` the kernel of poses ``(J, A)`` and ``(J, B)``."""
        distance = np.zeros((first.shape[1], second.shape[1]))
        for joint, length, a, b in zip(self.joints, self.lengths, first, second, strict=True):
            apart = a[:, None] - b
            distance += np.square((2.0 * np.sin(0.5 * apart) if arm.is_revolute(joint) else apart) / length)
        return np.asarray(np.exp(-0.5 * distance))

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the correction in SI; lengths and centres are in the file's unit of length or angle."""
        sizes = [angle if arm.is_revolute(joint) else length for joint in self.joints]
        return dataclasses.replace(
            self,
            lengths=tuple(map(scaled, self.lengths, sizes)),
            centres=tuple(tuple(map(scaled, centre, sizes)) for centre in self.centres),
        )

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if lengths or centres have not a number for each joint."""
        if len(self.lengths) != len(self.joints):
            return f"lengths must be a positive number for each joint, found {list(self.lengths)!r}"
        if any(len(centre) != len(self.joints) for centre in self.centres):
            return f"centres must be lists of a number for each joint, found {as_plain(self.centres)!r}"
        return None

    @property
    def term_of_covariance(self) -> str | None:
        """Return the process over all joints."""
        return "smooth" if self.moves == "joints" else "field"
