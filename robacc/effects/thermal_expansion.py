"""Thermal expansion of links with temperature, or with time while the arm warms up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robacc.chain import Scalar
from robacc.effects.base import (
    About,
    Beyond,
    Effect,
    Need,
    Over,
    Part,
    Term,
    Traits,
    needed,
    register,
    setting,
    varies,
)
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

REFERENCE_TEMPERATURE = 20.0
"""Degrees Celsius at which lengths have their nominal value (ISO 1)."""


@register
@dataclass(frozen=True)
class ThermalExpansion(Effect):
    """Every length of the arm in proportion to itself times T - T_ref, or 1 - exp(-t / t0) while it warms up."""

    reference: float = setting(
        REFERENCE_TEMPERATURE, key="reference_c", written=lambda expansion: expansion.time_constant is None
    )
    """Degrees Celsius."""
    time_constant: float | None = setting(None, key="time_constant_s", above=0.0)
    """s; None: by temperature."""
    slides: bool = setting(True)
    """True if a slide's travel grows as the links do; False if its scale does not grow."""

    name = "thermal_expansion"
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
        if data.temperature is not None or data.time is None:
            return cls()
        return cls(time_constant=float(np.ptp(data.time)) / 3 or 1.0)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield the expansion by temperature, else warm-ups of several time constants; slides grow or not."""
        constants: list[float | None] = [None] if varies(data.temperature) else []
        if not constants and varies(data.time):
            span = float(np.ptp(data.time))  # type: ignore[arg-type]
            constants.extend(span * share for share in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6))
        for slides in (True, False) if _travels(arm) else (True,):
            yield from (cls(time_constant=constant, slides=slides) for constant in constants)

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the temperature, or the time of a warm-up."""
        return ("temperature_c" if self.time_constant is None else "time_s",)

    def chart(self) -> Over:
        """Return the same."""
        return Over("temperature_c" if self.time_constant is None else "time_s", is_only=False)

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return that a warm-up is held; lengths go on in proportion to temperature (linear expansion)."""
        return Beyond(is_held=self.time_constant is not None)

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
            travelled = arm.chain.scalars(needed(data.q, "q", self.name))
            lengths.update({k: travelled[k] for k in travels})
        return (Term(self.name, unit, typical, tuple(Part(k, length * rise) for k, length in sorted(lengths.items()))),)


def _travels(arm: Arm) -> list[int]:
    """Return motions that prismatic joints drive."""
    driven = dict.fromkeys(drive.motion for drive in arm.chain.drives)
    return [motion for motion in driven if arm.chain.motions[motion].kind == "translation"]
