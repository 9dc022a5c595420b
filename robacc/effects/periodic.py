"""Periodic errors of joints, and their empirical correction: effects that a search forms from the poses.

Of periodic errors their orders, which poses support and gears explain, and the effects that have them. The correction
is without a physical cause: a polynomial of one or two drivers, or a smooth function of all joints.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robacc.effects.base import (
    FEWEST,
    MASSES,
    About,
    Beyond,
    Effect,
    Over,
    Part,
    Term,
    Traits,
    as_plain,
    commanded,
    driven_by,
    register,
    scaled,
    setting,
)
from robacc.effects.drivers import Driver, Validity
from robacc.geometry import Array
from robacc.measurements import ONE_COMMAND, Measurements
from robacc.robots.arm import BASE, FLEXURES, Arm

# Physical origins of a periodic error's order: motor turns, the wave generator of a strain-wave gear, the joint.

TYPICAL_RATIOS = (50, 51, 57, 80, 81, 100, 101, 105, 120, 121, 141, 153, 160, 161, 171)
"""Usual ratios of strain-wave gears (50 to 161) and of RV reducers (57 to 171), from makers' catalogues."""
_OF_THE_MOTOR = {
    1: "once per motor turn: motor encoder, or eccentricity of the input",
    2: "twice per motor turn: the wave generator of a strain-wave gear, or the motor's shaft",
    4: "four times per motor turn: the second harmonic of a strain-wave gear's wave generator",
}
_OF_THE_JOINT = {
    1: "once per joint turn: eccentricity of the output gear or of the encoder's disc",
    2: "twice per joint turn: ovality, or two reading heads",
}


def order_tolerance(angle_range: float) -> float:
    """Return the difference of two orders that poses over ``angle_range`` rad do not distinguish reliably.

    It is a tenth of the spacing at which two harmonics are orthogonal over the range.
    """
    return max(0.05, 0.1 * 2 * math.pi / max(angle_range, 1e-6))


def origin_of(order: float, gear_ratio: float | None, tolerance: float) -> str | None:
    """Return the possible physical origins of an order per joint turn; None if it fits none.

    Where the ratio is unknown, typical ratios are compared, only with the motor's first two orders.
    """
    origins = [(float(multiple), tolerance, text) for multiple, text in _OF_THE_JOINT.items()]
    if gear_ratio:
        origins += [
            (multiple * gear_ratio, tolerance * multiple, f"{text} (gear_ratio {gear_ratio:g})")
            for multiple, text in _OF_THE_MOTOR.items()
        ]
    else:
        # Typical ratios are one apart. Over a quarter turn, orders have an uncertainty of about 0.3.
        origins += [
            (multiple * typical, min(tolerance, 0.4), f"{_OF_THE_MOTOR[multiple]} ({text})")
            for multiple in (1, 2)
            for typical in TYPICAL_RATIOS
            for text in (f"a typical gear of ratio {typical}; the robot file has no gear_ratio",)
        ]
    return ", or ".join(text for expected, most, text in origins if abs(order - expected) <= most) or None


ORDER_STEP = 0.25
"""Periods per turn between orders that are tried; the best is then improved off this grid."""
HIGHEST_ORDER = 40.0
"""Largest usual order. Higher ones are as probable together as all usual ones."""
HIGHEST_OF_ALL = 2.0 * max(TYPICAL_RATIOS)
"""Largest order of a joint that turns: the wave generator of a strain-wave gear errs twice per motor turn."""
HIGHEST_OF_SLIDE = 1000.0
"""rad/m: largest order of a slide: a period of 6 mm."""


def common_period(orders: Sequence[float]) -> float:
    """Return the range of a joint (rad) over which poses separate the orders from each other and from a constant.

    It is one period of their smallest difference, the constant being order zero; beyond such a range the sum repeats
    what the poses showed.
    """
    spacing = np.diff(np.sort([0.0, *orders]))
    return 2.0 * math.pi / float(spacing[spacing > 0].min())


def are_separable(first: float, second: float, angle_range: float) -> bool:
    """Return whether poses over a range of a joint (rad) separate two orders: a quarter period of their beat or more.

    Over less, two waves of opposite phase and any size fit as well as small ones.
    """
    return abs(first - second) * angle_range >= 0.5 * math.pi


def exact_period(orders: Sequence[float], gear_ratio: float | None) -> float | None:
    """Return the turn of a joint (rad) after which a sum of these orders repeats itself; None if there is none.

    A single order repeats after its own period. Several whole orders repeat after a turn at most; fitted within less
    than a turn, they also imitate orders between them. The orders of a gear are whole if its ratio is; an unknown ratio
    counts as whole, as that of strain-wave gears.
    """
    if len(orders) == 1:
        return 2.0 * math.pi / orders[0]
    are_whole = all(float(number).is_integer() for number in (*orders, gear_ratio or 1.0))
    return 2.0 * math.pi / math.gcd(*map(int, orders)) if are_whole else None


def supported_orders(angle: Array, largest: float = HIGHEST_ORDER) -> Array:
    """Return the orders between half a period over the range of angles and the limit that the spacing of poses sets.

    Randomly spaced angles have no Nyquist order; the limit is that of the closest tenth of the gaps. Few angles support
    none.
    """
    gaps = np.diff(np.sort(angle))
    # Angles of one command that were read back differ a little: on a grid of angles they would support any order.
    gaps = gaps[gaps > ONE_COMMAND]
    if gaps.size < FEWEST - 1:
        return np.empty(0)
    first = math.ceil(max(ORDER_STEP, float(np.pi / np.ptp(angle))) / ORDER_STEP) * ORDER_STEP
    return np.arange(first, min(largest, float(np.pi / np.quantile(gaps, 0.1))) + 1e-9, ORDER_STEP)


def orders_setting(default: tuple[float, ...]) -> Any:
    """Return the field of an effect that is its orders."""
    return setting(default, written=True, above=0.0, most=1000.0, different=True)


@dataclass(frozen=True)
class Periodic(Effect):
    """An error with a cosine and a sine of n q_j for each order n."""

    orders: tuple[float, ...] = orders_setting((1.0, 2.0))

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return that it is held if the joint moved less than a period of all orders: a whole one repeats itself.

        A profile that repeats itself after a turn is not held, since its prior says what is likely beyond the range. It
        fades over a quarter of a period of its finest order: so far the poses say something of a profile.
        """
        period = exact_period(self.orders, arm.joint(driver).gear_ratio)
        if self.form.covariance_term is not None and period:
            return Beyond(False, period, 0.5 * math.pi / max(self.orders))
        return Beyond(limits[1] - limits[0] < common_period(self.orders), period)


@register
@dataclass(frozen=True)
class TransmissionError(Periodic):
    """Joint variable plus cosine and sine of n q_j for each order n, whole or not.

    The order of a slide is 2 pi over the period of its screw, pinion or scale (rad/m).

    With ``shrunk`` the orders are a joint's profile: the terms of an octave of orders share a Gaussian prior whose
    standard deviation is estimated, so that a profile is shrunk where the poses determine little of it.
    """

    shrunk: bool = setting(False)

    traits = Traits(chart=Over("{joint}"), is_bounded=True, shared_by=())
    about = About(
        summary="a periodic error of the joint: eccentricity (once, twice per turn), gear teeth, a strain-wave gear; "
        "the pitch of a slide's screw or rack",
        equation="theta_j + c cos(n q_j) + s sin(n q_j), n = 1, 2, the gear's orders, or orders found in the data; "
        "d_j of a prismatic joint, n = 2 pi over the period in m",
        unit="rad (m for a prismatic joint)",
        usual_size="1e-5 to 1e-3 rad, 1e-5 to 1e-3 m",
        usual_range=(1e-05, 0.001),
        needs="q1 … qN; for order n poses closer than 1/(2n) turn somewhere",
        confused_with="joint_compliance (order 1, axis horizontal), gear_ratio over a narrow range",
        source="Tuttle 1992 (strain-wave gears); Landgraf et al. 2021 for a UR10",
        example="{effect: transmission_error, joints: [j2], orders: [1, 12.5], "
        "values: {j2.cos1: 2e-4, j2.sin12.5: 5e-5}}",
    )

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield orders 1, 2, both, and once and twice per turn of the motor where poses are close enough to show them.

        A trace searches for other orders.
        """
        joint = arm.joint(joints[0])
        if joint.type == "revolute":
            most = supported_orders(driven_by(arm, data, joints[0], cls.name), math.inf).max(initial=0.0)
            of_gear = [(n * joint.gear_ratio,) for n in (1.0, 2.0) if joint.gear_ratio and n * joint.gear_ratio <= most]
            yield from (cls(joints, orders) for orders in ((1.0,), (2.0,), (1.0, 2.0), *of_gear))

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return orders 1 and 2 of ``joints``, or of all that turn: a slide has no orders per turn."""
        return cls(tuple(filter(arm.is_revolute, arm.names) if joints is None else joints))

    @property
    def form(self) -> Traits:
        """Return that a profile describes errors without a cause."""
        return self.traits._replace(covariance_term="profile" if self.shrunk else None)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return two terms per joint and order."""
        # The orders of a profile together are as large as a single order usually is.
        typical = 1e-4 / (math.sqrt(len(self.orders)) if self.shrunk else 1.0)
        octaves = [f".{math.floor(math.log2(order))}" for order in self.orders for _ in ("cos", "sin")]
        return tuple(
            self.joint_term(
                arm, joint, wave, label, typical, group=f"{self.name}.{joint}{octave}" if self.shrunk else None
            )
            for joint in self.joints
            for (label, wave), octave in zip(
                _waves(self.orders, driven_by(arm, data, joint, self.name)), octaves, strict=True
            )
        )

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the periods of a slide's error and where to look; None for joints that turn, which have harmonics."""
        if any(map(arm.is_revolute, self.joints)):
            return None
        periods = ", ".join(f"{1e3 * 2.0 * math.pi / order:.4g}" for order in self.orders)
        return f"period {periods} mm: compare with the lead of the screw, the pinion's circumference, the scale's pitch"


def _waves(orders: tuple[float, ...], angle: Array) -> Iterator[tuple[str, Array]]:
    """Yield label and values ``(N,)`` of the cosine and the sine of each order of an angle."""
    labels = (f"{kind}{order:.6g}" for order in orders for kind in ("cos", "sin"))
    return zip(labels, _cosines_and_sines(orders, angle.tobytes()), strict=True)


@functools.lru_cache(maxsize=32)
def _cosines_and_sines(orders: tuple[float, ...], angle: bytes) -> Array:
    """Return cosine and sine ``(2 Q, N)`` of each order; fits bind the same poses again and again."""
    phase = np.multiply.outer(orders, np.frombuffer(angle))
    waves = np.stack((np.cos(phase), np.sin(phase)), axis=1).reshape(2 * len(orders), -1)
    waves.flags.writeable = False
    return waves


def orders_of(effect: Effect) -> tuple[float, ...]:
    """Return the orders of a periodic error; none of any other effect."""
    return effect.orders if isinstance(effect, TransmissionError) else ()


def searched_order(effect: Effect) -> float | None:
    """Return the order of an effect that a search found: a single order that is not 1 or 2."""
    orders = orders_of(effect)
    return orders[0] if len(orders) == 1 and not effect.is_profile() and orders[0] not in (1.0, 2.0) else None


@register
@dataclass(frozen=True)
class ComplianceVariation(Effect):
    """Joint variable plus gravity's torque times c cos(n q_j) + s sin(n q_j).

    It adds to ``joint_compliance``, the mean over a turn. The torque is that at the commanded pose.
    """

    orders: tuple[float, ...] = orders_setting((2.0,))

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
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield order 1 and order 2."""
        yield from (cls(joints, (order,)) for order in (1.0, 2.0))

    @classmethod
    def beside(cls, other: Effect, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield the order of a periodic error that a search has identified: gears err more under load."""
        order = searched_order(other)
        if order is not None and set(other.joints) <= set(cls.possible_joints(arm)) and cls.missing(arm, data) is None:
            yield cls(other.joints, (order,))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a cosine and a sine for each order of each joint."""
        torques = {joint: driven_by(arm, data, f"torque_{joint}", self.name) for joint in self.joints}
        return tuple(
            self.joint_term(arm, joint, torque * wave, label, 1e-6, unit="rad/(N m)")
            for joint, torque in torques.items()
            for label, wave in _waves(self.orders, driven_by(arm, data, joint, self.name))
        )


_CENTRES = np.arange(-180.0, 180.0, 15.0)
"""Centres that a search tries first, degrees: at a centre the spring is longest, or half a turn from it."""
_RATIOS = (0.3, 0.5, 0.7, 0.85, 0.95)
_RATIO_RANGE = (0.05, 0.99)


@register
@dataclass(frozen=True)
class Counterbalance(Effect):
    """Joint variable turned by the torque of a spring between a point of the link before it and a point of its own.

    With the points at radii a and b of the axis, the spring's length is sqrt(a^2 + b^2) sqrt(1 + r cos(q - q_0)),
    r = 2 a b / (a^2 + b^2). The first coefficient is compliance times k a b; the second, of the other sign, is that
    times the free length over sqrt(a^2 + b^2).
    """

    centre: float = setting(0.0, key="centre_deg", written=True)
    """Angle q_0 of the joint at which the spring is longest, degrees."""
    ratio: float = setting(0.6, written=True, above=0.0, below=1.0)
    """r, above 0 and below 1."""

    traits = Traits(
        only="revolute",
        is_searched=True,
        chart=Over("{joint}"),
        is_bounded=True,
        rejects_implausible=True,
        prior_odds=1.0 / (150.0 * len(_CENTRES) * len(_RATIOS)),  # one in 150 joints has a spring at any place
    )
    about = About(
        summary="a spring or cylinder across the joint carries a part of the weight, and its torque turns the joint",
        equation="theta_j + s sin(q_j - q_0) + l sin(q_j - q_0) / sqrt(1 + r cos(q_j - q_0))",
        unit="rad",
        usual_size="1e-4 to 1e-2 rad; s and l of opposite signs",
        usual_range=(1e-4, 1e-2),
        needs="q1 … qN; a joint that moves by a third of a turn",
        confused_with="transmission_error of orders 1 and 2, joint_compliance",
        source="Klimchik, Wu, Dumas, Caro, Furet, Pashkevich, ICRA 2013, 3707: gravity compensator of a heavy robot",
        example="{effect: counterbalance, joints: [j2], centre_deg: 90, ratio: 0.6, "
        "values: {j2.spring: 2e-3, j2.length: -1e-3}}",
    )

    @classmethod
    def beside(cls, other: Effect, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield springs of many places where a periodic error of orders about 1 and 2 only is a finding."""
        # Up to this order a periodic error is a slow function of the joint's angle.
        if not other.is_profile() and 0.0 < max(orders_of(other), default=0.0) <= 2.5:
            yield from (cls(other.joints, float(centre), ratio) for centre in _CENTRES for ratio in _RATIOS)

    def refinements(self, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield springs of nearby places."""
        # Largest changes of centre (degrees) and ratio, in four steps each way.
        for turn, more in ((10.0, 0.1), (2.0, 0.02)):
            for i, k in itertools.product(range(-4, 5), repeat=2):
                ratio = round(min(max(self.ratio + more * k / 4, _RATIO_RANGE[0]), _RATIO_RANGE[1]), 4)
                yield Counterbalance(self.joints, round((self.centre + turn * i / 4 + 180.0) % 360.0 - 180.0, 4), ratio)

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason also if the spring's free length is negative: a joint that only sags has such a fit."""
        is_negative = any(spring * length > 0.0 for spring, length in zip(values[::2], values[1::2], strict=True))
        negative = f"{self} is implausible: the free length of its spring is negative"
        return negative if is_negative else super().implausible(terms, values)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return two terms per joint."""
        angles = {joint: driven_by(arm, data, joint, self.name) - math.radians(self.centre) for joint in self.joints}
        return tuple(
            self.joint_term(arm, joint, np.sin(angle) / length, label, 1e-3)
            for joint, angle in angles.items()
            for label, length in (("spring", 1.0), ("length", np.sqrt(1.0 + self.ratio * np.cos(angle))))
        )

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return what balances the joint, and what to check."""
        return (
            f"a spring or cylinder across {', '.join(self.joints)} carries a part of the weight: it is longest at "
            f"{self.centre:.0f} degrees; check its pressure or preload if it was serviced. If there is none, the joint "
            "sags under gravity: write the links' masses into the robot file, and trace again"
        )


def _tilt_labels(arm: Arm) -> tuple[str, ...]:
    """Return the two motions that tilt a joint's axis: alpha and beta of its row, the flexures of a URDF's joint."""
    return FLEXURES if arm.robot.convention == "urdf" else ("alpha", "beta")


@register
@dataclass(frozen=True)
class AxisWobble(Periodic):
    """Tilt of a joint's axis: alpha_j and the rotation about y, each plus cosine and sine of n q_j."""

    tilts: tuple[str, ...] = setting((), choices=("alpha", "beta", *FLEXURES))
    """Directions that tilt; empty for both."""

    traits = Traits(only="revolute", chart=Over("{joint}", is_only=False), is_bounded=True, shared_by=())
    about = About(
        summary="the joint's axis tilts as it turns: runout or ovality of its bearing",
        equation="alpha_j and beta_j + c cos(n q_j) + s sin(n q_j), n = 1, 2",
        unit="rad",
        usual_size="1e-5 to 1e-3 rad",
        usual_range=(1e-05, 0.001),
        needs="q1 … qN over most of a turn",
        confused_with="transmission_error of neighbouring joints, link_geometry over a narrow range",
        source="a parameter times a regressor, as every effect here",
        example="{effect: axis_wobble, joints: [j1], orders: [1, 2], "
        "values: {j1.alpha_cos1: 1e-4, j1.beta_sin2: -5e-5}}",
    )

    @classmethod
    def forms_on(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Iterator[Effect]:
        """Yield orders 1, 2 and both; in each direction and in both."""
        tilts = [(label,) for label in _tilt_labels(arm)]
        yield from (cls(joints, *form) for form in itertools.product(((1.0,), (2.0,), (1.0, 2.0)), (*tilts, ())))

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the variable of the joint that turns about the tilting axis."""
        return super().driver(arm, data, self.joints[0])

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return four terms per joint and order."""
        return tuple(
            Term(f"{self.name}.{joint}.{tilt}_{label}", "rad", 1e-4, (Part(arm.motion(joint, tilt), wave),))
            for joint in self.joints
            for order in self.orders
            for tilt in _tilt_labels(arm)
            if not self.tilts or tilt in self.tilts
            for label, wave in _waves((order,), driven_by(arm, data, joint, self.name))
        )


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

    @property
    def form(self) -> Traits:
        """Return what drives it: joints, torques and circumstances; it is drawn over the first."""
        names = tuple(_OF_JOINT.get(driver, driver) for driver in self.drivers if driver != "direction")
        over = Over(_OF_JOINT.get(self.drivers[0], self.drivers[0]), len(self.drivers) == 1)
        return self.traits._replace(drivers=names, chart=over)

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
        of_driver = [self.joints if driver == "own" else (driver,) for driver in self.drivers]
        units = [{arm.unit(joint) for joint in joints if joint in arm.names} for joints in of_driver]
        sizes = [1.0 if not unit else angle if unit == {"rad"} else length for unit in units]
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
        text = f"range must be a list of [low, high], one for each driver, found {as_plain(self.ranges)!r}"
        return text if len(self.ranges) != len(self.drivers) else None


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
    ) -> "PoseCorrection":
        """Return the correction with centres among these poses, by pivots of their kernel's Cholesky factor.

        ``noise`` is the variance of the noise over that of the process.
        """
        effect = cls(tuple(joints), tuple(map(float, lengths)), moves=moves)
        # Coefficients: as many as six profiles of a joint have together.
        most = 480 // len(effect.carriers(arm))
        q = commanded(data, cls.name)[[arm.number(joint) for joint in joints]]
        left, factor, chosen = np.ones(data.n), np.zeros((0, data.n)), list[int]()
        # The first centre is the pose nearest to their mean, whatever the order of the rows.
        score = -np.sum(np.square((q - q.mean(axis=1, keepdims=True)) / np.array(lengths)[:, None]), axis=0)
        # The centres may leave out a hundredth of the variance of a pose's error and noise: a std changes by 0.5 %.
        while data.n and len(chosen) < most and left.max() > 0.01 * (1.0 + noise):
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
        # Added so that the factor exists where two of the centres nearly coincide.
        kernel = self._kernel(arm, centres, centres) + 1e-9 * np.eye(len(self.centres))
        basis = np.linalg.solve(np.linalg.cholesky(kernel), self._kernel(arm, centres, q))
        return tuple(
            Term(f"{self.name}.{label}.c{k}", unit, 1e-4, (Part(motion, row),), group=self.name)
            for label, unit, motion in self.carriers(arm)
            for k, row in enumerate(basis, 1)
        )

    def carriers(self, arm: Arm) -> list[tuple[str, str, int]]:
        """Return label, unit and motion of what the processes move: the joints, or the base along its axes."""
        return (
            [(axis, "m", arm.chain.index(BASE, axis)) for axis in "xyz"]
            if self.moves == "position"
            else [(joint, arm.unit(joint), arm.axis_motion(joint)) for joint in self.joints]
        )

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
        text = f"centres must be lists of a number for each joint, found {as_plain(self.centres)!r}"
        return text if any(len(centre) != len(self.joints) for centre in self.centres) else None

    @property
    def form(self) -> Traits:
        """Return which process it is."""
        return self.traits._replace(covariance_term="smooth" if self.moves == "joints" else "field")
