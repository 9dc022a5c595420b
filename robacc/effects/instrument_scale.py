"""The instrument's own scale: its metre is not the metre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.effects.base import SCALE_OF_INSTRUMENT, About, Driver, Effect, Part, Term, register
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class InstrumentScale(Effect):
    """The measured position multiplied by 1 + k."""

    name = "instrument_scale"
    extrapolates = "a scale acts in proportion to the distance"
    per_joint = False
    is_of_measurement = True
    about = About(
        summary="the instrument's own scale: refractive index, a camera's focal length, a wrong unit of 1 in 1000",
        equation="p measured = (1 + k) p",
        unit="1",
        usual_size="1e-6 to 1e-3",
        usual_range=(1e-06, 0.001),
        needs="positions spread over a volume",
        confused_with="link_geometry: all lengths of the arm scaled together, thermal_expansion at one temperature",
        source="a parameter times a regressor, as every effect here on the observation",
        example="{effect: instrument_scale, values: {value: 2e-5}}",
    )

    @property
    def of_campaign(self) -> bool:
        """True: the scale belongs to the instrument on that day."""
        return True

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the distance from the instrument."""
        return Driver("distance", "m", np.sqrt(np.sum(np.square(data.position), axis=0)), True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term."""
        return (Term(self.name, "1", 1e-5, (Part(SCALE_OF_INSTRUMENT),)),)
