"""Effects of weight: joints, bearings and the pedestal that deflect under the arm's own links or its payload."""

import dataclasses
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import (
    FEWEST,
    MASSES,
    About,
    Effect,
    Need,
    Over,
    Part,
    Term,
    Traits,
    commanded,
    compliance_unit,
    driven_by,
    needed,
    register,
    setting,
    weight_needed,
)
from robacc.effects.drivers import Validity
from robacc.errors import refuse
from robacc.geometry import Array, Poses
from robacc.gravity import UNIT_LOADS, Load, bears_weight, moments, payload, unit_loads, weight_torques
from robacc.measurements import Measurements
from robacc.robots.arm import BASE, FLEXURES, Arm

Deflection = Literal["equilibrium", "rigid"]

DEFLECTIONS = (
    "deflection: rigid takes it at the undeflected pose, the first-order form that controllers and most of the "
    "literature use"
)
"""Catalogue text of the setting."""


_LIGHT = 30.0
"""N m: less weight lies on the second joint of most industrial arms, whose gears turn by the usual 1e-5 rad/(N m). The
servos of an SO-101, whose weight makes 1 N m, turn by 7e-3 rad/(N m) (2.2 degrees under 1.5 kg; users' measurements in
github.com/TheRobotStudio/SO-ARM100, issue 134)."""


def compliance_stretch(arm: Arm, data: Measurements) -> float:
    """Return the factor of usual compliances on an arm: gears of a light arm are as much softer as it is lighter."""
    turning = [arm.number(joint) for joint in arm.names if arm.is_revolute(joint) and arm.chain.bodies]
    torque = float(np.abs(weight_torques(arm, data)[turning]).max(initial=0.0)) if turning else 0.0
    return max(1.0, _LIGHT / torque) if torque > 0.1 else 1.0


@dataclass(frozen=True)
class Elastic(Effect):
    """An effect of c times gravity's torque, in equilibrium: at the pose with all deflections.

    With ``deflection: rigid`` the torque is that at the pose without any deflection, the first-order form. The two
    differ by the square of the deflection over the lever: nanometres on a stiff arm, micrometres on one that sags by
    millimetres.
    """

    _: KW_ONLY
    deflection: Deflection = setting("equilibrium")

    def parts(self, motions: Sequence[int], loads: tuple[Load, ...]) -> tuple[Part, ...]:
        """Return the parts of motions that deflect under ``loads``."""
        return tuple(Part(motion, 1.0, loads, deflected=self.deflection == "equilibrium") for motion in motions)


@dataclass(frozen=True)
class OwnWeight(Elastic):
    """An elastic effect of the arm's own weight, whose masses are those of the file, or are fitted too."""

    masses: Literal["known", "unknown"] = setting("known")

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the effect with the robot's masses, if it has any."""
        return cls(joints, "known" if arm.chain.bodies else "unknown")

    def weight_terms(
        self, arm: Arm, data: Measurements, typical: float, moved: Iterable[tuple[str, str, tuple[int, ...], int]]
    ) -> tuple[Term, ...]:
        """Return compliances times the weight of the file, and one term for each base regressor of other masses.

        Base regressors are unit masses and unit first moments of mass; those of one compliance share a prior.

        Args:
            arm: The arm.
            data: Its poses.
            typical: Usual size of a compliance.
            moved: For each compliance its name, its unit, the motions that deflect, and the first link that loads them.
        """
        terms = []
        weight = () if self.masses == "unknown" else weight_needed(arm, data, self.name)
        # Relative standard deviation of uncertain masses.
        stds = regressor_stds(arm, 0.25) if self.masses not in ("known", "unknown") else {}
        stretch = compliance_stretch(arm, data)
        typical *= stretch
        for name, unit, motions, first in moved:
            if self.masses != "unknown":
                terms.append(Term(name, unit, typical, self.parts(motions, weight), stretch=stretch))
            for label, load in unit_loads(arm, first).items() if self.masses != "known" else ():
                kind = "kg" if label.startswith("m") else "kg m"
                # Of an unknown mass, and of an unknown first moment of mass.
                std = stds.get(label, {"kg": 5.0, "kg m": 1.0}[kind])
                own = Term(f"{name}.{label}", f"{unit} {kind}", typical, self.parts(motions, load), name, std)
                terms.append(own._replace(stretch=stretch))
        return tuple(terms)


@register
@dataclass(frozen=True)
class JointCompliance(OwnWeight):
    """Each joint turned by c times the torque of gravity about its axis, in equilibrium.

    With masses ``unknown`` the torque's base regressors are fitted; their coefficients are compliance x mass and
    compliance x first moment. With masses ``uncertain`` the file's are a start, and the same regressors, shrunk by a
    prior in proportion to each link's own mass, correct them.
    """

    masses: Literal["known", "uncertain", "unknown"] = setting("known")  # type: ignore[assignment]

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
    def form(self) -> Traits:
        """Return what it is with these masses.

        It is drawn over gravity's torque, or over the joint's variable where the masses are unknown. Masses that are
        wrong by more than their uncertainty are rare: where both fit, the file's masses hold.
        """
        over = Over("{joint}" if self.masses == "unknown" else "torque_{joint}", self.masses == "known")
        odds = 1.0 / 150.0 if self.masses == "uncertain" else 1.0
        return self.traits._replace(chart=over, prior_odds=odds)

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield the usual form and, where weight can load the joint, the file's masses as uncertain ones."""
        yield cls.usual(arm, data, joints)
        if arm.chain.bodies and bears_weight(arm, commanded(data, cls.name))[arm.number(joints[0])]:
            yield cls(joints, "uncertain")

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint, or one for each base regressor."""
        moved = (
            (
                f"{self.name}.{joint}",
                compliance_unit(arm, joint),
                (arm.axis_motion(joint),),
                arm.owners[arm.number(joint)],
            )
            for joint in self.joints
        )
        return self.weight_terms(arm, data, 1e-5, moved)

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
    return {label: stds.get(label, 0.1 * smallest) for label in unit_loads(arm, 0)}


_LEAST_TORQUE = 1e-3
"""N m below which gravity has no moment about a joint."""


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

    traits = Traits(
        needs=(MASSES,),
        drivers=("{joint}", "torque_{joint}"),
        chart=Over("torque_{joint}"),
        rejects_implausible=True,
    )
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
            # Knees over the largest torque of gravity on the joint.
            yield from (
                JointHardening(self.joints, knee=float(f"{share * largest:.3g}"))
                for share in np.geomspace(0.02, 4.0, 40)
            )

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason also if the spring's compliance is that of no joint: that of a knee, or at the reference.

        A knee of a negative compliance is a spring that softens: on a TIAGo Pro it stood for the plain compliance.
        """
        slopes = [3.0 * abs(value) / self.reference for value in values] if self.knee is None else values
        springs = [term._replace(name=f"{term.name} as a compliance", unit="rad/(N m)") for term in terms]
        return super().implausible(terms, values) or JointCompliance(self.joints).implausible(springs, slopes)

    def within(self, validity: Validity) -> Effect:
        """Return the effect with its deflection held beyond 1.5 times the largest torques of ``validity``.

        The cube of a torque that is ten times as large would be a thousand times as large. On simulated arms poses that
        exceed the torque a little are predicted twice as well as with a deflection that is held at it.
        """
        torques = {joint: validity.get(f"torque_{joint}") for joint in self.joints}
        largest = {joint: 1.5 * max(map(abs, limits)) for joint, limits in torques.items() if limits}
        return dataclasses.replace(self, largest_torques=largest) if largest else self

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        shares = {
            joint: np.clip(driven_by(arm, data, f"torque_{joint}", self.name), -largest, largest)
            / (self.reference if self.knee is None else self.knee)
            for joint in self.joints
            for largest in [self.largest_torques.get(joint, np.inf)]
        }
        if self.knee is None:
            return tuple(self.joint_term(arm, joint, share**3) for joint, share in shares.items())
        # The only real root of z + z^3 = torque / knee, less that ratio.
        beyond = {
            joint: 2.0 / np.sqrt(3.0) * np.sinh(np.arcsinh(1.5 * np.sqrt(3.0) * share) / 3.0) - share
            for joint, share in shares.items()
        }
        return tuple(
            self.joint_term(arm, joint, self.knee * part, typical=1e-5, unit=compliance_unit(arm, joint))
            for joint, part in beyond.items()
        )

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
    torque = weight_torques(arm, data)[[arm.number(joint) for joint in joints]]
    return float(np.abs(torque).max(initial=0.0))


@register
class LateralCompliance(OwnWeight):
    """Each joint's axis tilted by c times the bending moment, the same stiffness in both directions.

    With masses ``unknown`` the bending moment's base regressors are fitted, as those of ``joint_compliance`` are.
    """

    traits = Traits(extrapolates="Hooke's law: deflection in proportion to the bending moment", is_nonnegative=True)
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
        moved = (
            (
                f"{self.name}.{joint}",
                "rad/(N m)",
                tuple(arm.motion(joint, label) for label in FLEXURES),
                arm.owners[arm.number(joint)],
            )
            for joint in self.joints
        )
        return self.weight_terms(arm, data, 1e-5, moved)


def _upright_joints(arm: Arm, data: Measurements) -> tuple[str, ...]:
    """Return the first joint and the rotary joints whose axis is parallel to gravity at every pose."""
    axes = arm.chain.jacobian(commanded(data, "a joint's axis"), arm.chain.joint_axis)[3:]
    down = np.array(arm.robot.gravity) / max(float(np.sqrt(np.sum(np.square(arm.robot.gravity)))), 1e-12)
    sine = np.sqrt(np.maximum(1 - np.square(np.einsum("i,ijn->jn", down, axes)), 0.0)).max(axis=1)
    return tuple(
        joint
        for i, (joint, value) in enumerate(zip(arm.names, sine, strict=True))
        if i == 0 or (arm.is_revolute(joint) and value < 0.02)  # largest sine of its angle with gravity
    )


@register
@dataclass(frozen=True)
class PayloadCompliance(Elastic):
    """Each joint turned by c times the moment of the payload about its axis, in equilibrium.

    With ``groups``, names of the column payload_group, masses are unknown: the coefficients of each group are the
    compliance times its mass. Rows of a group called ``none`` or ``empty`` carry nothing.

    With the centre of mass ``uncertain``, the payload's first moments in the last link's frame, shrunk by a prior,
    correct it; their coefficients are the compliance times what the centre is off the file's.
    """

    com: Literal["known", "uncertain"] = setting("known")
    groups: tuple[str, ...] = setting(())
    """Names of loads of unknown mass; none where the masses are those of payload_kg."""

    traits = Traits(
        needs=(
            Need("no payload_kg column", lambda arm, data: data.payload is not None or data.payload_group is not None),
            Need("payload_kg is zero throughout", lambda arm, data: data.payload is None or bool(data.payload.any())),
            Need(
                "payload_group has one name only, or a name with fewer than 8 rows",
                lambda arm, data: data.payload is not None or bool(_groups(data)),
            ),
        ),
        drivers=("payload_kg",),
        chart=Over("payload_torque_{joint}"),
        extrapolates="Hooke's law: deflection in proportion to the payload's torque",
        is_nonnegative=True,
    )
    about = About(
        summary="the joint deflects under the payload, which was not the same at every pose",
        equation="theta_j + c_j tau_j, tau_j the torque of the payload's weight about the axis at the deflected pose; "
        f"{DEFLECTIONS}",
        unit="rad/(N m) (m/N for a prismatic joint); com uncertain: also the same times m; groups: the same times kg",
        usual_size="1e-7 to 1e-5 rad/(N m)",
        usual_range=(1e-07, 1e-05),
        needs="payload_kg that varies, or payload_group where masses are unknown; payload: com in the robot file "
        "(default: at the tool), or com: uncertain",
        confused_with="joint_compliance where the payload never changes",
        source="Khalil and Dombre 2002, ch. 9.5; Nubiola and Bonev 2013",
        example="{effect: payload_compliance, joints: [j2, j3], values: {j2: 2e-6, j3: 5e-6}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the effect of the payload's masses, or of groups where these are unknown."""
        return cls(joints, groups=_groups(data))

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield the file's centre of mass and an uncertain one."""
        yield cls(joints, groups=_groups(data))
        yield cls(joints, "uncertain", _groups(data))

    @property
    def form(self) -> Traits:
        """Return that unknown payloads drive nothing."""
        return self.traits._replace(drivers=(), chart=None) if self.groups else self.traits

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term for each joint and load, and one for each first moment if the centre is uncertain."""
        terms = []
        for joint in self.joints:
            motions, name, unit = (arm.axis_motion(joint),), f"{self.name}.{joint}", compliance_unit(arm, joint)
            for label, mass in self._masses(data).items():
                of_load = f"{name}.{label}" if self.groups else name
                unit_of_load, typical = (f"{unit} kg", 5e-5) if self.groups else (unit, 1e-5)
                stretch = compliance_stretch(arm, data)
                typical *= stretch
                parts = self.parts(motions, payload(arm, mass))
                terms.append(Term(of_load, unit_of_load, typical, parts, stretch=stretch))
                # The payload's first moments of mass per metre along each axis of the last link's frame.
                terms += [
                    Term(
                        f"{of_load}.{axis}",
                        f"{unit_of_load} m",
                        typical,
                        self.parts(motions, (Load(arm.flange, 0.0, (x * mass, y * mass, z * mass)),)),
                        of_load,
                        0.2,  # m: prior standard deviation of a coordinate about the file's.
                    )
                    for axis, (_, (x, y, z)) in UNIT_LOADS.items()
                    if axis != "m" and self.com == "uncertain"
                ]
        return tuple(terms)

    def _masses(self, data: Measurements) -> dict[str, Array]:
        """Return the mass ``(N,)`` of the load of each group, 1 kg in its rows; or that of all poses.

        Raises:
            UsageError: A row carries a load of another name.
        """
        if not self.groups:
            return {"": needed(data.payload, "payload_kg", self.name)}
        names = needed(data.payload_group, "payload_group", self.name)
        unknown = sorted(set(np.unique(names).tolist()) - {*self.groups, *_NOTHING})
        fitted, fix = ", ".join(self.groups), "fit it with rows of this load, or write payload_kg"
        message = f"{self.name} was fitted with the loads {fitted}, but a row carries"
        refuse(*((True, f"{message} {name!r}; {fix}") for name in unknown))
        return {group: (names == group).astype(float) for group in self.groups}

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the ratios of unknown loads."""
        sizes = {group: values.get(f"{self.name}.{self.joints[0]}.{group}", 0.0) for group in self.groups}
        largest = max(sizes.values(), key=abs, default=0.0)
        if largest == 0.0:
            return None
        shares = ", ".join(f"{group} {size / largest:.2f}" for group, size in sizes.items())
        return (
            f"{', '.join(self.joints)} deflect under loads of unknown mass; relative to the largest, they are: {shares}"
        )


_NOTHING = ("none", "empty")
"""Names of a group of rows without a load."""


def _groups(data: Measurements) -> tuple[str, ...]:
    """Return the names of loads whose masses are unknown; none where masses are known, or no two names have rows."""
    if data.payload_group is None or data.payload is not None:
        return ()
    names, counts = np.unique(data.payload_group, return_counts=True)
    is_enough = names.size >= 2 and counts.min() >= FEWEST
    return tuple(str(name) for name in names if name not in _NOTHING) if is_enough else ()


@register
@dataclass(frozen=True)
class BaseCompliance(OwnWeight):
    """The base tilted by c times the torque of the arm's weight, the same in both directions.

    With ``below`` it tilts about a point on its axis at an unknown distance below: the base also shifts by the tilt
    times that distance. The shift follows the torque at the nominal pose. With masses ``unknown`` the torque's base
    regressors are fitted, as those of ``joint_compliance`` are.
    """

    below: bool = setting(False)

    traits = Traits(
        per_joint=False,
        extrapolates="Hooke's law: tilt in proportion to the torque of the arm's weight",
        is_nonnegative=True,
    )
    about = About(
        summary="the pedestal or floor deflects: the base tilts under the torque of the arm's weight",
        equation="rotations of the base about x and y + c (m_x, m_y), the torque of the arm's weight about them at the "
        f"deflected pose; with below: true base x, y + c h (m_y, -m_x) too, h the height of the base over the "
        f"point of the tilt; {DEFLECTIONS}",
        unit="rad/(N m); masses unknown: the same times kg or kg m",
        usual_size="1e-9 to 1e-6 rad/(N m)",
        usual_range=(1e-09, 1e-06),
        needs="mass and com of the links; without them the base regressors of the torque are fitted",
        confused_with="lateral_compliance of the first joint, joint_compliance of the second",
        source="a parameter times a regressor, as every effect here",
        example="{effect: base_compliance, values: {value: 5e-7}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield a tilt about the base's origin, and where masses are known a tilt about a point below it."""
        yield cls.usual(arm, data, ())
        if arm.chain.bodies:
            yield cls(below=True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the tilt, and with ``below`` the shift; with unknown masses a tilt for each base regressor."""
        turns = tuple(arm.chain.index(BASE, label) for label in ("turn_x", "turn_y"))
        if not self.below:
            return self.weight_terms(arm, data, 1e-6, [(self.name, "rad/(N m)", turns, 0)])
        loads = weight_needed(arm, data, self.name)
        moment_x, moment_y = moments(arm, commanded(data, self.name), turns, loads)
        # Turns are about the base's own axes, translations along those of the measuring frame.
        axes = Poses.from_xyz_rpy(np.zeros(3), np.array(arm.robot.base.rpy)).rotation.reshape(3, 3)
        moved = axes[:, :1] * moment_y - axes[:, 1:2] * moment_x
        shift = tuple(Part(arm.chain.index(BASE, label), moved[i]) for i, label in enumerate("xyz"))
        return (
            Term(f"{self.name}.tilt", "rad/(N m)", 1e-6, self.parts(turns, loads)),
            Term(f"{self.name}.shift", "m/(N m)", 1e-6, shift),
        )

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the height of the base over the point about which it tilts."""
        tilt, shift = values.get(f"{self.name}.tilt", 0.0), values.get(f"{self.name}.shift", 0.0)
        if not tilt:
            return None
        height = shift / tilt
        return f"the base tilts about a point {abs(height):.2g} m {'below' if height >= 0 else 'above'} its origin"

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if the tilt about a point below has unknown masses."""
        return "below: true needs masses: known" if self.below and self.masses == "unknown" else None
