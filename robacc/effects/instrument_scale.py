"""The instrument's own scale: its metre is not the metre, or changes with the air while the poses are measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE
from robacc.effects.base import (
    SCALE_OF_INSTRUMENT,
    About,
    Beyond,
    Effect,
    Over,
    Part,
    Term,
    Traits,
    needed,
    register,
    setting,
    varies,
)
from robacc.effects.base_frame import frame_terms
from robacc.effects.instrument_place import FARTHEST
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

_DEGREES = (1, 3, 5)
"""Degrees of the drifts that a trace tries."""
_ABOUT_NO_POINT = 0.5
"""Share of the shifts' mean square over time that a scale about one point leaves, from which there is no such point. In
simulations drifting air leaves at most 0.12 of it (0.48 where hardly noticeable), errors that wander 0.99 and more."""


@register
@dataclass(frozen=True)
class InstrumentScale(Effect):
    """The measured position multiplied by 1 + k, or by 1 + k(t) about the instrument's place.

    A drift has the scale k1 u + k2 u^2 + ... of u, the time from -1 to 1 over the poses, and with each power a shift:
    minus the scale times the instrument's place, which is unknown where the poses are in another frame than its own.
    """

    drift: int = setting(0, least=0, most=9)
    """Degree of the drift; 0 for a scale that does not change."""
    origin: float = setting(0.0, key="origin_s", written=lambda scale: scale.drift > 0)
    """s, the time at which there is no drift."""
    span: float = setting(1.0, key="span_s", above=0.0, written=lambda scale: scale.drift > 0)
    """s, the unit of time: a coefficient is the drift over it."""

    name = "instrument_scale"
    traits = Traits(
        per_joint=False,
        extrapolates="a scale acts in proportion to the distance",
        is_of_measurement=True,
        shared_by=("origin", "span"),
    )
    about = About(
        summary="the instrument's own scale: refractive index, a camera's focal length, a wrong length "
        "standard; with drift, air whose index changes while the poses are measured",
        equation="p measured = (1 + k) p; with drift: p + k(t) (p - p0), k a polynomial of time, p0 the instrument",
        unit="1",
        usual_size="1e-6 to 1e-3; drift 1e-6 (1 K or 4 hPa) to 1e-4",
        usual_range=(1e-06, 0.001),
        needs="positions spread over a volume; drift: time_s",
        confused_with="link_geometry: all lengths of the arm scaled together, thermal_expansion at one temperature; "
        "with drift, frame_drift",
        source="Ciddor, Applied Optics 35 (1996) 1566: 0.96e-6 per K, 0.27e-6 per hPa",
        example="{effect: instrument_scale, values: {value: 2e-5}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield a constant scale, and drifts if the time varies."""
        yield cls()
        if varies(data.time):
            assert data.time is not None
            low, high = float(data.time.min()), float(data.time.max())
            yield from (cls(drift=degree, origin=(low + high) / 2, span=(high - low) / 2) for degree in _DEGREES)

    @property
    def rejects_implausible(self) -> bool:
        """Return whether the scale drifts: shifts of its own let it follow any drift of the frame."""
        return self.drift > 0

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the time of a drift."""
        return ("time_s",) if self.drift else ()

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return that a drift ends with the poses."""
        return Beyond(is_held=True)

    def chart(self) -> Over:
        """Return the distance from the instrument, or the time of a drift."""
        return Over("time_s", is_only=False) if self.drift else Over("distance")

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term, or four per power of time."""
        if not self.drift:
            return (Term(self.name, "1", 1e-5, (Part(SCALE_OF_INSTRUMENT),)),)
        elapsed = (needed(data.time, "time_s", self.name) - self.origin) / self.span
        terms: list[Term] = []
        for power in range(1, self.drift + 1):
            terms.append(Term(f"{self.name}.k{power}", "1", 1e-5, (Part(SCALE_OF_INSTRUMENT, elapsed**power),)))
            terms += frame_terms(arm, BASE, self.name, elapsed**power, turning=False, suffix=f"{power}")
        return tuple(terms)

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason if the shifts of a drift are not those of a scale about an instrument's place."""
        scale, shifts, centre = self._curves({term.name: value for term, value in zip(terms, values, strict=True)})
        if centre is None:
            return super().implausible(terms, values)
        if math.hypot(*centre) > FARTHEST:
            distance = f"{math.hypot(*centre):.2g} m away"
            return f"{self.name}: its centre is {distance}, which is implausible: an instrument stands nearer"
        moved, left_over = (float(np.sum(np.square(part))) for part in (shifts, shifts + np.outer(scale, centre)))
        if left_over > _ABOUT_NO_POINT * moved:
            return f"{self.name}: its shifts are not those of a scale about one point: the frame of the poses moves"
        return super().implausible(terms, values)

    def _curves(self, values: Mapping[str, float]) -> tuple[Array, Array, Array | None]:
        """Return ``(T,)`` the scale and ``(T, 3)`` the shifts over the time of the poses, and ``(3,)`` their centre, m.

        The centre is the point about which the scale drifts; None without drift.
        """
        powers = range(1, self.drift + 1)
        scale = np.array([values.get(f"{self.name}.k{power}", 0.0) for power in powers])
        shifts = np.array([[values.get(f"{self.name}.{label}{power}", 0.0) for label in "xyz"] for power in powers])
        curves = np.linspace(-1, 1, 101)[:, None] ** np.arange(1, self.drift + 1)
        centre = -(scale @ shifts) / (scale @ scale) if scale.any() else None
        return curves @ scale, curves @ shifts.reshape(-1, 3), centre

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return how far a drifting scale ranges, and about which point."""
        scale, _, centre = self._curves(values)
        if centre is None:
            return None
        place = ", ".join(f"{coordinate:.2g}" for coordinate in centre)
        return (
            f"the instrument's scale changes by {1e6 * float(np.ptp(scale)):.2g} ppm during the measurement, about the "
            f"point {place} m: log temperature and pressure of the air, and measure a fixed target between the poses"
        )
