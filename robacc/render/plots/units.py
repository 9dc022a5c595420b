"""Display units; a chart uses one unit, chosen by its largest value."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from robacc.render.text.numbers import three_digits


class Unit(NamedTuple):
    """A display unit."""

    name: str
    factor: float
    """Displayed number = factor times SI value."""

    def text(self, value: float | None) -> str:
        """Return three digits and the unit; a dash for None and NaN."""
        if value is None or not math.isfinite(value):
            return "–"
        gap = "" if self.name == "°" else " "
        return f"{three_digits(value * self.factor)}{gap}{self.name}".rstrip()


MILLIMETRE = Unit("mm", 1e3)
METRE = Unit("m", 1.0)
DEGREE = Unit("°", 180.0 / math.pi)
_LENGTHS = (Unit("µm", 1e6), MILLIMETRE)
_OTHERS = {"1": "", "N m": "N m", "N": "N", "s": "s", "kg": "kg", "°C": "°C", "": ""}


def length_unit(*sizes: float) -> Unit:
    """Return millimetres, or micrometres if all sizes (m) are below 0.02 mm."""
    return _LENGTHS[0] if _largest(sizes) < 2e-5 else MILLIMETRE


def joint_unit(unit: str, *sizes: float) -> Unit:
    """Return the unit of a joint error: degrees, as in the tables; mm or µm for lengths."""
    return length_unit(*sizes) if unit == "m" else DEGREE


def driver_unit(unit: str) -> Unit:
    """Return the unit of a driver's axis: degrees, metres, or the unit itself."""
    return {"rad": DEGREE, "m": METRE}.get(unit) or Unit(_OTHERS.get(unit, unit), 1.0)


def error_unit(unit: str, *sizes: float) -> Unit:
    """Return the unit of an error's length: mm or µm, or degrees."""
    return DEGREE if unit == "rad" else length_unit(*sizes)


def _largest(sizes: Iterable[float]) -> float:
    return max((abs(size) for size in sizes if math.isfinite(size)), default=0.0)
