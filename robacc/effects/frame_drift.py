"""Motion of the base against the instrument while the poses are measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE
from robacc.effects.base import TIME, About, Effect, Over, Term, Traits, needed, register, setting
from robacc.effects.base_frame import frame_terms
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


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

    name = "frame_drift"
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
    def over(cls, data: Measurements, degree: int = 1, turning: bool = False) -> FrameDrift:
        """Return the drift about the middle of these poses' time, in units of half the time span."""
        time = needed(data.time, "time_s", cls.name)
        low, high = float(np.min(time)), float(np.max(time))
        return cls(origin=(low + high) / 2, span=(high - low) / 2 or 1.0, degree=degree, turning=turning)

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a straight and steady drift."""
        return cls.over(data)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield a straight and steady drift, one that turns too, and curved ones."""
        for degree, turning in ((1, False), (1, True), (2, False), (3, False), (3, True)):
            yield cls.over(data, degree, turning)

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
