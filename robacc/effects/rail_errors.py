"""Rails that are not straight: a slide's carriage shifts and turns along its travel."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE
from robacc.effects.base import About, Effect, Need, Over, Part, Term, Traits, commanded, register, setting
from robacc.effects.base_frame import FRAME_LABELS
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_DEGREE = 8
"""Highest degree of the Chebyshev polynomials along the travel."""
_ROW_LABELS = {"a": "x", "d": "z", "alpha": "roll", "beta": "pitch", "theta": "yaw"}
"""Motions of a DH table's row, and the labels of the carriage's motions that they stand for."""


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

    name = "rail_errors"
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
        for joint in arm.names:
            if arm.is_revolute(joint):
                return
            yield cls.usual(arm, data, (joint,))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the coefficients of each curve, in a group for each joint."""
        q = commanded(data, self.name)
        terms = []
        for joint in self.joints:
            u = 2 * (q[arm.number(joint)] - self.low) / (self.high - self.low) - 1
            curves = np.polynomial.chebyshev.chebvander(u, _DEGREE).T
            for label, motion in _carriage(arm, joint).items():
                is_shift = label in "xyz"
                for degree in range(2 if is_shift else 1, _DEGREE + 1):
                    name = f"{self.name}.{joint}.{label}{degree}"
                    part = Part(motion, curves[degree])
                    group = f"{self.name}.{joint}"
                    terms.append(Term(name, "m" if is_shift else "rad", 1e-4, (part,), group, 1 / degree**2))
        return tuple(terms)

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if the travel has no length."""
        return None if self.low < self.high else f"from must be below to, found {self.low!r} and {self.high!r}"


def _carriage(arm: Arm, joint: str) -> dict[str, int]:
    """Return the numbers of the motions of a slide's carriage by label: shifts x, y, z; turns roll, pitch, yaw."""
    owner = arm.owners[arm.number(joint)]
    if arm.robot.convention == "urdf":
        motions = {label: arm.chain.find(owner, motion) for label, motion in FRAME_LABELS.items()}
    elif owner == 0:
        motions = {label: arm.chain.find(BASE, motion) for label, motion in FRAME_LABELS.items()}
    else:
        motions = {label: arm.chain.find(owner, motion) for motion, label in _ROW_LABELS.items()}
    return {label: motion for label, motion in motions.items() if motion is not None}
