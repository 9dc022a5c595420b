"""A spring or cylinder across a joint that balances a part of the arm's weight."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import About, Effect, Over, Term, Traits, driven_by, register, setting
from robacc.effects.search_forms import low_orders
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_CENTRES = np.arange(-180.0, 180.0, 15.0)
"""Centres that a search tries first, degrees: at a centre the spring is longest, or half a turn from it."""
_RATIOS = (0.3, 0.5, 0.7, 0.85, 0.95)
_NEARBY = ((10.0, 0.1), (2.0, 0.02))
"""Largest changes of centre (degrees) and ratio that a search tries near the best, in four steps each way."""
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

    name = "counterbalance"
    traits = Traits(only="revolute", is_searched=True, chart=Over("{joint}"), is_bounded=True)
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

    @property
    def prior_odds(self) -> float:
        """Prior odds of one place of a spring, of which one in 150 joints has any."""
        return 1.0 / (150.0 * len(_CENTRES) * len(_RATIOS))

    @classmethod
    def beside(cls, other: Effect, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield springs of many places where a periodic error of order 1 or 2 is a finding."""
        if low_orders(other):
            yield from (cls(other.joints, float(centre), ratio) for centre in _CENTRES for ratio in _RATIOS)

    def refinements(self, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield springs of nearby places."""
        for turn, more in _NEARBY:
            for i, k in itertools.product(range(-4, 5), repeat=2):
                ratio = round(min(max(self.ratio + more * k / 4, _RATIO_RANGE[0]), _RATIO_RANGE[1]), 4)
                centre = round((self.centre + turn * i / 4 + 180.0) % 360.0 - 180.0, 4)
                yield Counterbalance(self.joints, centre, ratio)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return two terms per joint."""
        terms = []
        for joint in self.joints:
            angle = driven_by(arm, data, joint, self.name) - math.radians(self.centre)
            stretched = np.sin(angle)
            free = stretched / np.sqrt(1.0 + self.ratio * np.cos(angle))
            terms += [self.joint_term(arm, joint, stretched, "spring", 1e-3)]
            terms += [self.joint_term(arm, joint, free, "length", 1e-3)]
        return tuple(terms)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return what balances the joint, and what to check."""
        return (
            f"a spring or cylinder across {', '.join(self.joints)} carries a part of the weight: it is longest at "
            f"{self.centre:.0f} degrees; check its pressure or preload if it was serviced"
        )
