"""A periodic error of a joint: eccentric gears and encoder discs, tooth meshing, strain-wave gears, a slide's screw."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import About, Beyond, Effect, Over, Term, Traits, driven_by, register, setting
from robacc.effects.orders import common_period, exact_period, orders_setting
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class TransmissionError(Effect):
    """Joint variable plus cosine and sine of n q_j for each order n, whole or not.

    The order of a slide is 2 pi over the period of its screw, pinion or scale (rad/m).

    With ``shrunk`` the orders are a joint's profile: its terms share a Gaussian prior whose standard
    deviation is estimated, so that a profile is shrunk if the poses determine little of it.
    """

    orders: tuple[float, ...] = orders_setting((1.0, 2.0))
    shrunk: bool = setting(False)

    name = "transmission_error"
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
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield orders 1, 2, both, and the gear ratio of joints that turn; a trace searches for other orders."""
        for joint in filter(arm.is_revolute, cls.possible_joints(arm)):
            for orders in ((1.0,), (2.0,), (1.0, 2.0)):
                yield cls((joint,), orders)
            ratio = arm.joint(joint).gear_ratio
            if ratio:
                yield cls((joint,), (float(ratio),))

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return orders 1 and 2 of ``joints``, or of all that turn: a slide has no orders per turn."""
        return cls(tuple(filter(arm.is_revolute, arm.names) if joints is None else joints))

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return that it is held if the joint moved less than a period of all orders: a whole one repeats itself.

        A profile that repeats itself after a turn is not held, since its prior says what is likely beyond the range. It
        fades over a quarter of a period of its finest order: so far the poses say something of a profile.
        """
        period = exact_period(self.orders, arm.joint(driver).gear_ratio)
        if self.shrunk and period:
            return Beyond(False, period, 0.5 * math.pi / max(self.orders))
        return Beyond(limits[1] - limits[0] < common_period(self.orders), period)

    @property
    def term_of_covariance(self) -> str | None:
        """Return the profiles of joints."""
        return "profile" if self.shrunk else None

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return two terms per joint and order."""
        # The orders of a profile together are as large as a single order usually is.
        typical = 1e-4 / (math.sqrt(len(self.orders)) if self.shrunk else 1.0)
        terms = []
        for joint in self.joints:
            group = f"{self.name}.{joint}" if self.shrunk else None
            waves = _waves(self.orders, driven_by(arm, data, joint, self.name).tobytes())
            for order, of_order in zip(self.orders, waves, strict=True):
                for kind, wave in zip(("cos", "sin"), of_order, strict=True):
                    terms.append(self.joint_term(arm, joint, wave, f"{kind}{order:.6g}", typical, group=group))
        return tuple(terms)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the periods of a slide's error and where to look; None for joints that turn, which have harmonics."""
        if any(map(arm.is_revolute, self.joints)):
            return None
        periods = ", ".join(f"{1e3 * 2.0 * math.pi / order:.4g}" for order in self.orders)
        return f"period {periods} mm: compare with the lead of the screw, the pinion's circumference, the scale's pitch"


@functools.lru_cache(maxsize=32)
def _waves(orders: tuple[float, ...], angle: bytes) -> Array:
    """Return cosine and sine ``(Q, 2, N)`` of each order; fits bind the same poses again and again."""
    phase = np.multiply.outer(orders, np.frombuffer(angle))
    waves = np.stack((np.cos(phase), np.sin(phase)), axis=1)
    waves.flags.writeable = False
    return waves
