"""A joint axis that tilts as it turns: bearing runout."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import About, Beyond, Effect, Over, Part, Term, Traits, commanded, register, setting
from robacc.effects.drivers import Driver
from robacc.effects.orders import common_period, exact_period, orders_setting
from robacc.measurements import Measurements
from robacc.robots.arm import FLEXURES, Arm


def tilt_motions(arm: Arm, joint: str) -> dict[str, int]:
    """Return the two motions that tilt a joint's axis: alpha and beta of its row, the flexures of a URDF's joint."""
    labels = FLEXURES if arm.robot.convention == "urdf" else ("alpha", "beta")
    return {label: arm.motion(joint, label) for label in labels}


@register
@dataclass(frozen=True)
class AxisWobble(Effect):
    """Tilt of a joint's axis: alpha_j and the rotation about y, each plus cosine and sine of n q_j."""

    orders: tuple[float, ...] = orders_setting((1.0, 2.0))
    tilts: tuple[str, ...] = setting((), choices=("alpha", "beta", *FLEXURES))
    """Directions that tilt; empty for both."""

    name = "axis_wobble"
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
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield orders 1, 2 and both; in each direction and in both."""
        for joint in cls.possible_joints(arm):
            for orders in ((1.0,), (2.0,), (1.0, 2.0)):
                yield from (cls((joint,), orders, tilts) for tilts in (*((t,) for t in tilt_motions(arm, joint)), ()))

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return that it is held if the joint moved less than a period of all orders: a whole one repeats itself."""
        is_held = limits[1] - limits[0] < common_period(self.orders)
        return Beyond(is_held, exact_period(self.orders, arm.joint(driver).gear_ratio))

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the variable of the joint that turns about the tilting axis."""
        return super().driver(arm, data, self.joints[0])

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return four terms per joint and order."""
        q = commanded(data, self.name)
        terms = []
        for joint in self.joints:
            angle = q[arm.number(joint)]
            for order in self.orders:
                for label, motion in tilt_motions(arm, joint).items():
                    if self.tilts and label not in self.tilts:
                        continue
                    for kind, wave in (("cos", np.cos), ("sin", np.sin)):
                        name = f"{self.name}.{joint}.{label}_{kind}{order:g}"
                        terms.append(Term(name, "rad", 1e-4, (Part(motion, wave(order * angle)),)))
        return tuple(terms)
