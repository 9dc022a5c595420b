"""Effects on the arm's frames, zeros, lengths and rails: wrong constants, and what temperature and time change.

What moves a frame at a step is in :mod:`robacc.effects.campaign`.
"""

import dataclasses
import itertools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import (
    LEAST_OF_CONSTANT,
    RADIUS,
    TIME,
    About,
    Effect,
    Need,
    Over,
    Part,
    Term,
    Traits,
    commanded,
    driven_by,
    needed,
    register,
    setting,
    varies,
)
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import BASE, TOOL, TURN_OF_ANGLE, Arm, Scalar
from robacc.robots.description import DH_PARAMETERS

FRAME_LABELS = {"x": "x", "y": "y", "z": "z", **TURN_OF_ANGLE}
"""Term to motion. Roll, pitch and yaw here are turns about the frame's own x, y, z: no gimbal lock anywhere."""


def frame_terms(
    arm: Arm,
    owner: int,
    prefix: str,
    regressor: Array | float = 1.0,
    *,
    turning: bool = True,
    suffix: str = "",
    typical: float = 1e-4,
    least_part: float = 0.0,
) -> tuple[Term, ...]:
    """Return the terms that move a frame along x, y, z and, where it is ``turning``, about its own axes."""
    return tuple(
        Term(
            f"{prefix}.{label}{suffix}",
            "m" if label in "xyz" else "rad",
            typical,
            (Part(arm.chain.index(owner, motion), regressor),),
            least_part=least_part,
        )
        for label, motion in FRAME_LABELS.items()
        if turning or label in "xyz"
    )


@register
class BaseFrame(Effect):
    """Six coordinates of the base."""

    traits = Traits(per_joint=False, is_constant=True, is_frame=True)
    about = About(
        summary="where the robot stands in the measuring frame",
        equation="base x, y, z + dx, dy, dz; then rotated about its own x, y, z by roll, pitch, yaw",
        unit="m, rad",
        usual_size="any: the instrument may stand anywhere",
        usual_range=(0.001, 1),
        needs="nothing",
        confused_with="joint_offset of the first joint (yaw), its d (z)",
        source="Wu and Lee 1985, eq. (3), with the base as one more link",
        example="{effect: base_frame, values: {x: 1e-3, yaw: 2e-4}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return six terms, or those of each fixture that the poses are measured from, and the radii of spheres."""
        fixture = np.full(data.n, "") if data.fixture is None else data.fixture
        placed = {
            f"{self.name}.{name}" if name else self.name: (name, each) for name, each in arm.robot.fixtures.items()
        }
        regressors: dict[str, Array | float] = {
            prefix: (fixture == name).astype(float) for prefix, (name, _) in placed.items()
        }
        still = [prefix for prefix, (_, each) in placed.items() if each.kind in ("point", "sphere", "distance")]
        radii = (
            Term(f"{prefix}.radius", "m", 1e-3, (Part(RADIUS, regressors[prefix]),), least_part=LEAST_OF_CONSTANT)
            for prefix, (_, each) in placed.items()
            if each.kind == "sphere"
        )
        # A turn about a plane's normal, or along a line, shows nothing. The turn nearest to it comes last, and is left
        # out: if it tilted the plane, by the small part that it can, it would turn by radians.
        idle = {
            f"{prefix}.{[*TURN_OF_ANGLE][np.abs(each.base.pose.rotation[2]).argmax()]}"
            for prefix, (_, each) in placed.items()
            if each.kind in ("plane", "line")
        }
        frames = _terms_of_frames(arm, BASE, regressors or {self.name: 1.0}, still)
        return *sorted(frames, key=lambda term: term.name in idle), *radii


@register
class ToolFrame(Effect):
    """Six coordinates of the tool, or of each of several targets."""

    traits = Traits(per_joint=False, is_constant=True, is_frame=True)
    about = About(
        summary="where the measured target sits on the last link",
        equation="tool x, y, z + dx, dy, dz; then rotated about its own x, y, z; for each target its own",
        unit="m, rad",
        usual_size="1e-3 m, 1e-3 rad after mounting by hand",
        usual_range=(0.001, 0.01),
        needs="nothing; the rotations only where orientation was measured",
        confused_with="the last joint's theta, d, a, alpha",
        source="Wu and Lee 1985, eq. (3), with the tool as one more link",
        example="{effect: tool_frame, values: {z: 5e-4, pitch: 1e-3}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return six terms, or six for each target that was measured."""
        names = [*arm.robot.targets]
        regressors: dict[str, Array | float] = {f"{self.name}.{names[0]}" if names else self.name: 1.0}
        if names and data.target is not None:
            regressors = {f"{self.name}.{name}": (data.target == name).astype(float) for name in names}
        return _terms_of_frames(arm, TOOL, regressors)


def _terms_of_frames(
    arm: Arm, owner: int, regressors: Mapping[str, Array | float], still: Collection[str] = ()
) -> tuple[Term, ...]:
    """Return the terms of each frame, by the prefix of their names: six, or three of a frame that is a point."""
    return tuple(
        term
        for prefix, regressor in regressors.items()
        for term in frame_terms(
            arm,
            owner,
            prefix,
            regressor,
            turning=prefix not in still,
            typical=1e-3,
            least_part=LEAST_OF_CONSTANT,
        )
    )


@register
class JointOffset(Effect):
    """Offset of each joint's zero."""

    traits = Traits(is_constant=True, chart=Over("{joint}"))
    about = About(
        summary="joint zero: the encoder's zero is not the table's",
        equation="theta_j + c (revolute), d_j + c (prismatic)",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-4 to 2e-3 rad",
        usual_range=(0.0001, 0.002),
        needs="nothing",
        confused_with="base_frame.yaw (first joint), tool_frame (last joint), link_geometry across parallel axes",
        source="Wu and Lee 1985, eq. (6), M1 and M2",
        example="{effect: joint_offset, joints: [j2, j3], values: {j2: 5e-4, j3: -2e-4}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        return tuple(
            self.joint_term(arm, joint, 1.0, typical=1e-3, least_part=LEAST_OF_CONSTANT) for joint in self.joints
        )


@register
@dataclass(frozen=True)
class LinkGeometry(Effect):
    """Constant lengths and angles of the links, d, a, alpha and Hayati's beta: all of them, or those of ``labels``."""

    labels: tuple[str, ...] = setting((), choices=(*DH_PARAMETERS, *FRAME_LABELS))

    traits = Traits(is_constant=True, shared_by=())
    about = About(
        summary="link lengths, offsets and twists differ from the table",
        equation="d_j, a_j, alpha_j + c, and beta_j (Hayati's rotation about y) + c; a URDF's joint origin "
        "x, y, z + c, then rotated about its own x, y, z by roll, pitch, yaw",
        unit="m, rad",
        usual_size="1e-4 to 1e-3 m, 1e-4 to 1e-3 rad",
        usual_range=(0.0001, 0.001),
        needs="nothing",
        confused_with="joint_offset, base_frame and tool_frame at the ends of the chain",
        source="Wu and Lee 1985, eq. (6), M2, M3, M4; Hayati 1983 for beta",
        example="{effect: link_geometry, joints: [j2], labels: [a, alpha], values: {j2.a: 2e-4, j2.alpha: 3e-4}}",
    )

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield one constant at a time, and a joint's whole row."""
        yield from (cls(joints, (label,)) for label in _constants(arm, joints[0]))
        yield cls(joints)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the constants of each joint's row; the fit finds those that are not identifiable."""
        terms = (
            Term(
                f"{self.name}.{joint}.{label}",
                arm.chain.motions[motion].unit,
                1e-3,
                (Part(motion),),
                least_part=LEAST_OF_CONSTANT,
            )
            for joint in self.joints
            for label, motion in _constants(arm, joint).items()
            if not self.labels or label in self.labels
        )
        # Hayati's rotations last: a rotation is identifiable only if the table's own numbers cannot describe it.
        return tuple(sorted(terms, key=lambda term: term.label == "beta"))


def _constants(arm: Arm, joint: str) -> dict[str, int]:
    """Return the motions of a joint's constants: its table row without the joint's zero, or its URDF origin."""
    if arm.robot.convention == "urdf":
        return {label: arm.motion(joint, motion) for label, motion in FRAME_LABELS.items()}
    labels = (label for label in DH_PARAMETERS if label != arm.joint(joint).offset_parameter)
    return {label: arm.motion(joint, label) for label in labels}


_DEGREE = 8
"""Highest degree of the Chebyshev polynomials along the travel."""


@register
@dataclass(frozen=True)
class RailErrors(Effect):
    """Shifts and turns of the carriage, each a smooth curve over the travel.

    The curves are Chebyshev polynomials whose coefficients share a prior, smaller with the square of the degree, so
    that a curve is as smooth as the poses allow. Of a rail that carries the arm they move the base; of another slide of
    a DH table only those motions that its row has.
    """

    low: float = setting(0.0, key="from", unit="length", written=True)
    """Beginning of the travel, m."""
    high: float = setting(1.0, key="to", unit="length", written=True)
    """End of the travel, m."""

    traits = Traits(
        only="prismatic",
        needs=(Need("no prismatic joint", lambda arm, data: not all(map(arm.is_revolute, arm.names))),),
        chart=Over("{joint}", is_only=False),
    )
    about = About(
        summary="the rail is bent or twisted: its carriage shifts across the travel and turns along it",
        equation="shifts and rotations of the carriage + sum of c_p T_p(u), u the travel from -1 to 1, p = 1 "
        "(rotations) or 2 (shifts) to 8",
        unit="m, rad",
        usual_size="1e-5 to 1e-3 m, 1e-5 to 5e-4 rad",
        usual_range=(1e-5, 1e-3),
        needs="poses along the whole travel, several at each place",
        confused_with="link_geometry where the rail is straight but askew, frame_drift where travel rises with time",
        source="ISO 230-1:2012, 3.4 and 8: straightness, pitch, yaw and roll of linear motion",
        example="{effect: rail_errors, joints: [j3], from: 0, to: 0.5, values: {j3.x2: 5e-5, j3.yaw1: 1e-4}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the curves over the travel of these poses."""
        travel = commanded(data, cls.name)[[arm.number(joint) for joint in joints]]
        low, high = (float(travel.min()), float(travel.max())) if travel.size else (0.0, 1.0)
        return cls(joints, low, high if high > low else low + 1.0)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield the effect for each slide that carries the arm: those before the first rotary joint."""
        slides = itertools.takewhile(lambda joint: not arm.is_revolute(joint), arm.names)
        yield from (cls.usual(arm, data, (joint,)) for joint in slides)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the coefficients of each curve, in a group for each joint."""
        curves = {
            joint: np.polynomial.chebyshev.chebvander(2 * (travel - self.low) / (self.high - self.low) - 1, _DEGREE).T
            for joint in self.joints
            for travel in [driven_by(arm, data, joint, self.name)]
        }
        return tuple(
            Term(
                f"{self.name}.{joint}.{label}{degree}",
                unit,
                1e-4,
                (Part(motion, curves[joint][degree]),),
                f"{self.name}.{joint}",
                1 / degree**2,
            )
            for joint in self.joints
            for label, motion in _carriage(arm, joint).items()
            for unit, first in (("m", 2) if label in "xyz" else ("rad", 1),)
            for degree in range(first, _DEGREE + 1)
        )

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if the travel has no length."""
        return None if self.low < self.high else f"from must be below to, found {self.low!r} and {self.high!r}"


def _carriage(arm: Arm, joint: str) -> dict[str, int]:
    """Return the numbers of the motions of a slide's carriage by label: shifts x, y, z; turns roll, pitch, yaw."""
    owner, is_urdf = arm.owners[arm.number(joint)], arm.robot.convention == "urdf"
    # Motions of a DH table's row that stand for those of the carriage.
    labels = (
        FRAME_LABELS
        if is_urdf or owner == 0
        else {"x": "a", "z": "d", "roll": "alpha", "pitch": "beta", "yaw": "theta"}
    )
    owner = BASE if owner == 0 and not is_urdf else owner
    numbers = {motion.label: k for k, motion in enumerate(arm.chain.motions) if motion.owner == owner}
    return {label: numbers[motion] for label, motion in labels.items() if motion in numbers}


_SHARES = (0.05, 0.1, 0.2, 0.4, 0.8)
"""Time constants of the candidates, as shares of the time span of the poses."""


@register
@dataclass(frozen=True)
class ThermalExpansion(Effect):
    """Every length of the arm in proportion to itself times T - T_ref, or 1 - exp(-t / t0) while it warms up."""

    reference: float = setting(20.0, key="reference_c", written=lambda expansion: expansion.time_constant is None)
    """Degrees Celsius, at which lengths have their nominal value; that of ISO 1."""
    time_constant: float | None = setting(None, key="time_constant_s", above=0.0)
    """s; None: by temperature."""
    slides: bool = setting(True)
    """True if a slide's travel grows as the links do; False if its scale does not grow."""

    traits = Traits(
        per_joint=False,
        needs=(
            Need(
                "neither temperature_c nor time_s varies",
                lambda arm, data: varies(data.temperature) or varies(data.time),
            ),
        ),
        implausible_factor=3.0,
    )
    about = About(
        summary="the links grow with temperature, or as the arm warms up where no temperature was logged",
        equation="d_j, a_j (1 + k (T - T_ref)), all j, a slide's travel with them unless slides: false; or (1 + k (1 - "
        "exp(-t / t0))) with t0 searched",
        unit="1/K (1 by time)",
        usual_size="1.2e-5 (steel) to 2.4e-5 (aluminium) per K",
        usual_range=(1.2e-05, 2.4e-05),
        needs="temperature_c that varies, else time_s",
        confused_with="instrument_scale at one temperature, frame_drift in one region of the workspace",
        source="ISO 1 for the reference temperature; Renders et al. 1991 for the size",
        example="{effect: thermal_expansion, reference_c: 20, values: {value: 1.2e-5}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the expansion by temperature if it was logged, else a warm-up over a third of the time."""
        return (
            cls()
            if data.temperature is not None or data.time is None
            else cls(time_constant=float(np.ptp(data.time)) / 3 or 1.0)
        )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield the expansion by temperature, else warm-ups of several time constants; slides grow or not."""
        constants: list[float | None] = [None]
        if not varies(data.temperature):
            span = float(np.ptp(needed(data.time, "time_s", cls.name)))
            constants = [span * share for share in (*_SHARES, 1.6)]
        for slides in (True, False) if _travels(arm) else (True,):
            yield from (cls(time_constant=constant, slides=slides) for constant in constants)

    @property
    def form(self) -> Traits:
        """Return what drives it: the temperature, with which lengths go on, or the time of a warm-up, which is held."""
        driver, law = ("temperature_c", "linear expansion") if self.time_constant is None else ("time_s", None)
        over = Over(driver, is_only=False)
        return self.traits._replace(drivers=(driver,), chart=over, extrapolates=law)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term that moves every length."""
        if self.time_constant is None:
            rise = needed(data.temperature, "temperature_c", self.name) - self.reference
            unit, typical = "1/K", 1e-5
        else:
            rise = 1 - np.exp(-needed(data.time, "time_s", self.name) / self.time_constant)
            unit, typical = "1", 1e-4
        motions = arm.chain.motions
        lengths: dict[int, Scalar] = {k: motions[k].value for k in arm.lengths if motions[k].value != 0}
        if self.slides and (travels := _travels(arm)):
            travelled = arm.chain.scalars(commanded(data, self.name))
            lengths.update({k: travelled[k] for k in travels})
        return (Term(self.name, unit, typical, tuple(Part(k, length * rise) for k, length in sorted(lengths.items()))),)


def _travels(arm: Arm) -> set[int]:
    """Return motions that prismatic joints drive."""
    return {drive.motion for drive in arm.chain.drives if arm.chain.motions[drive.motion].kind == "translation"}


@register
@dataclass(frozen=True)
class JointWarmup(Effect):
    """Joint variable shifted by c (1 - exp(-t / t0)): a body of one heat capacity under a constant loss of heat."""

    time_constant: float = setting(1800.0, key="time_constant_s", written=True, above=0.0)
    """s"""
    origin: float = setting(0.0, key="origin_s", written=True)
    """s, the time from which the joint warms up."""

    traits = Traits(needs=(TIME,), drivers=("time_s",), chart=Over("time_s", is_only=False))
    about = About(
        summary="the joint's zero shifts while its motor and gear warm up; each joint has a time constant of its own",
        equation="theta_j + c (1 - exp(-(t - t_first) / t0)), t0 searched",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-5 to 1e-3 rad after warm-up, in minutes (wrist) to hours (base)",
        usual_range=(1e-5, 1e-3),
        needs="time_s",
        confused_with="step of the joint where it is fast, frame_drift at the first joint, thermal_expansion",
        source="Gong, Yuan, Ni, Int. J. Machine Tools and Manufacture 40 (2000) 2119: thermal errors of joints; "
        "Newton's law of cooling for the shape",
        example="{effect: joint_warmup, joints: [j2], time_constant_s: 1800, origin_s: 0, values: {j2: 2e-4}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a warm-up over a third of the time."""
        time = needed(data.time, "time_s", cls.name)
        return cls(joints, float(np.ptp(time)) / 3 or cls.time_constant, float(time.min()))

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield several time constants."""
        time = needed(data.time, "time_s", cls.name)
        start, span = float(time.min()), float(np.ptp(time))
        yield from (cls(joints, float(f"{span * share:.3g}"), start) for share in _SHARES)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint."""
        elapsed = np.maximum(needed(data.time, "time_s", self.name) - self.origin, 0.0)
        risen = 1 - np.exp(-elapsed / self.time_constant)
        return tuple(self.joint_term(arm, joint, risen) for joint in self.joints)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the time constant, and the time until the joint is warm."""
        minutes = self.time_constant / 60
        return (
            f"the time constant is {minutes:.3g} min, and 95 % of the shift is over after {3 * minutes:.3g} min; warm "
            "the arm up before you measure or use it"
        )


@register
@dataclass(frozen=True)
class FrameDrift(Effect):
    """Base coordinates with a polynomial of time, about the time in the middle of the poses."""

    origin: float = setting(0.0, key="origin_s", written=True)
    """s, the time at which there is no drift."""
    span: float = setting(1.0, key="span_s", written=True, above=0.0)
    """s, the unit of time: a coefficient is the drift over it."""
    degree: int = setting(1, written=True, least=1, most=9)
    turning: bool = setting(False, written=True)
    """True if the base turns too."""

    traits = Traits(
        per_joint=False,
        needs=(TIME,),
        drivers=("time_s",),
        chart=Over("time_s", is_only=False),
        is_of_measurement=True,
    )
    about = About(
        summary="the base moves against the instrument: a tripod settles, a pedestal warms up, the floor sinks",
        equation="base x, y, z (and its rotations) + c ((t - t_mid) / span)^p, p = 1 … degree",
        unit="m, rad over the time span",
        usual_size="1e-5 to 1e-3 m",
        usual_range=(1e-05, 0.001),
        needs="time_s",
        confused_with="thermal_expansion where temperature rises with time",
        source="a parameter times a regressor, as every effect here",
        example="{effect: frame_drift, origin_s: 1800, span_s: 1800, degree: 2, values: {x: 1e-4, z2: -5e-5}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a straight and steady drift about the middle of the time, in units of half the time span."""
        time = needed(data.time, "time_s", cls.name)
        low, high = float(np.min(time)), float(np.max(time))
        return cls(origin=(low + high) / 2, span=(high - low) / 2 or 1.0)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield a straight and steady drift, one that turns too, and curved ones."""
        for degree, turning in ((1, False), (1, True), (2, False), (3, False), (3, True)):
            yield dataclasses.replace(cls.usual(arm, data, ()), degree=degree, turning=turning)  # type: ignore[call-arg]

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return three or six terms per power of time."""
        elapsed = (needed(data.time, "time_s", self.name) - self.origin) / self.span
        return tuple(
            term
            for power in range(1, self.degree + 1)
            for term in frame_terms(
                arm,
                BASE,
                self.name,
                elapsed**power,
                turning=self.turning,
                suffix=f"{power}" if power > 1 else "",
            )
        )
