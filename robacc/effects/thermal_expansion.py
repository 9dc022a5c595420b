"""Links that grow with temperature, or with time while the arm warms up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.effects.base import About, Effect, Part, Term, needed, register, varies
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

REFERENCE_TEMPERATURE = 20.0
"""Degrees Celsius at which lengths are what they are (ISO 1)."""


@register
@dataclass(frozen=True)
class ThermalExpansion(Effect):
    """Every length of the arm in proportion to itself times T - T_ref, or 1 - exp(-t / t0) while it warms up."""

    reference: float = REFERENCE_TEMPERATURE
    time_constant: float | None = None
    """s; None: by temperature."""

    name = "thermal_expansion"
    per_joint = False
    about = About(
        summary="the links grow with temperature, or as the arm warms up where no temperature was logged",
        equation="d_j, a_j (1 + k (T - T_ref)), all j; or (1 + k (1 - exp(-t / t0))) with t0 searched",
        unit="1/K (1 by time)",
        usual_size="1.2e-5 (steel) to 2.4e-5 (aluminium) per K",
        needs="temperature_c that varies, else time_s",
        confused_with="instrument_scale at one temperature, frame_drift in one region of the workspace",
        source="ISO 1 for the reference temperature; Renders et al. 1991 for the size",
        example="{effect: thermal_expansion, reference_c: 20, values: {value: 1.2e-5}}",
    )

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Needs a temperature or a time that varies."""
        if varies(data.temperature) or varies(data.time):
            return None
        return "neither temperature_c nor time_s varies"

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """By temperature where it was logged, else a warm-up over a third of the time."""
        if data.temperature is not None or data.time is None:
            return cls()
        return cls(time_constant=float(np.ptp(data.time)) / 3 or 1.0)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """By temperature; where there is none, by warm-ups of several time constants."""
        if varies(data.temperature):
            yield cls()
        elif varies(data.time):
            span = float(np.ptp(data.time))  # type: ignore[arg-type]
            yield from (cls(time_constant=span * share) for share in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """One term that moves every length."""
        if self.time_constant is None:
            rise = needed(data.temperature, "temperature_c", self.name) - self.reference
            unit, typical = "1/K", 1e-5
        else:
            rise = 1 - np.exp(-needed(data.time, "time_s", self.name) / self.time_constant)
            unit, typical = "1", 1e-4
        chain = arm.chain
        parts = tuple(Part(k, chain.motions[k].value * rise) for k in arm.lengths if chain.motions[k].value != 0)
        return (Term(self.name, unit, typical, parts),)

    def settings(self) -> dict[str, Any]:
        """Reference temperature or time constant."""
        if self.time_constant is None:
            return {"reference_c": self.reference}
        return {"time_constant_s": self.time_constant}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """``reference_c: 20`` or ``time_constant_s: 1800``."""
        rest = dict(settings)
        reference = rest.pop("reference_c", REFERENCE_TEMPERATURE)
        time_constant = rest.pop("time_constant_s", None)
        if rest:
            raise ValueError(f"{cls.name} has no setting {', '.join(map(repr, rest))}")
        if time_constant is not None and not float(time_constant) > 0:
            raise ValueError(f"{cls.name}: time_constant_s must be above 0, found {time_constant!r}")
        return cls(reference=float(reference), time_constant=None if time_constant is None else float(time_constant))
