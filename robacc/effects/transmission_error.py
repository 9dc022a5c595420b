"""A periodic error of a joint: eccentric gears and encoder discs, tooth meshing, strain-wave gears."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import About, Effect, Part, Term, commanded, orders_setting, register
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class TransmissionError(Effect):
    """theta_j with cosine and sine of n q_j for each order n, whole or not.

    With ``shrunk`` the orders are a joint's profile: its terms share a Gaussian prior whose width is estimated, so that
    a profile is shrunk where the poses say little.
    """

    orders: tuple[float, ...] = (1.0, 2.0)
    shrunk: bool = False

    name = "transmission_error"
    about = About(
        summary="a periodic error of the joint: eccentricity (once, twice per turn), gear teeth, a strain-wave gear",
        equation="theta_j + c cos(n q_j) + s sin(n q_j), n = 1, 2, the gear's orders, or orders found in the data",
        unit="rad",
        usual_size="1e-5 to 1e-3 rad",
        needs="q1 … qN; for order n poses closer than 1/(2n) turn somewhere",
        confused_with="joint_compliance (order 1, axis horizontal), gear_ratio over a narrow range",
        source="Tuttle 1992 (strain-wave gears); Landgraf et al. 2021 for a UR10",
        example="{effect: transmission_error, joints: [j2], orders: [1, 12.5], "
        "values: {j2.cos1: 2e-4, j2.sin12.5: 5e-5}}",
    )

    @classmethod
    def possible_joints(cls, arm: Arm) -> tuple[str, ...]:
        """Joints that turn."""
        return tuple(name for name in arm.names if arm.is_revolute(name))

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Orders 1 and 2."""
        return cls(tuple(joints) if joints is not None else cls.possible_joints(arm))

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Once per turn, twice, both, and the gear's own turn; orders in the data are searched by the trace."""
        for joint in cls.possible_joints(arm):
            for orders in ((1.0,), (2.0,), (1.0, 2.0)):
                yield cls((joint,), orders)
            ratio = arm.joint(joint).gear_ratio
            if ratio:
                yield cls((joint,), (float(ratio),))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Two terms a joint and order."""
        q = commanded(data, self.name)
        terms = []
        for joint in self.joints:
            motion, angle = arm.axis_motion(joint), q[arm.number(joint)]
            group = f"{self.name}.{joint}" if self.shrunk else None
            for order in self.orders:
                for kind, wave in (("cos", np.cos), ("sin", np.sin)):
                    part = Part(motion, wave(order * angle))
                    terms.append(Term(f"{self.name}.{joint}.{kind}{order:.6g}", "rad", 1e-4, (part,), group))
        return tuple(terms)

    def settings(self) -> dict[str, Any]:
        """The orders."""
        return {"orders": list(self.orders), **({"shrunk": True} if self.shrunk else {})}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """``orders: [12.5]``, ``shrunk: true`` for a profile."""
        rest = dict(settings)
        shrunk = rest.pop("shrunk", False)
        if not isinstance(shrunk, bool):
            raise ValueError(f"{cls.name}: shrunk must be true or false, found {shrunk!r}")
        return cls(joints, orders_setting(cls.name, rest, (1.0, 2.0)), shrunk)
