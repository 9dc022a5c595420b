"""Joints whose zero shifts while their gears and motors warm up, each with its own time constant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import TIME, About, Effect, Over, Term, Traits, needed, register, setting
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_SHARES = (0.05, 0.1, 0.2, 0.4, 0.8)
"""Time constants of the candidates, as shares of the time span of the poses."""


@register
@dataclass(frozen=True)
class JointWarmup(Effect):
    """Joint variable shifted by c (1 - exp(-t / t0)): a body of one heat capacity under a constant loss of heat."""

    time_constant: float = setting(1800.0, key="time_constant_s", written=True, above=0.0)
    """s"""
    origin: float = setting(0.0, key="origin_s", written=True)
    """s, the time from which the joint warms up."""

    name = "joint_warmup"
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
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time, with several time constants."""
        time = needed(data.time, "time_s", cls.name)
        start, span = float(time.min()), float(np.ptp(time))
        for joint in arm.names:
            yield from (cls((joint,), float(f"{span * share:.3g}"), start) for share in _SHARES)

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
