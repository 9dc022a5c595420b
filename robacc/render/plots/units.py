"""Units that numbers are shown in: one for a whole picture, so that its axis stays readable."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from robacc.render.text.numbers import three_digits


class Unit(NamedTuple):
    """A unit to show numbers in."""

    name: str
    factor: float
    """Shown = factor x SI."""

    def text(self, value: float | None) -> str:
        """Three digits and the unit; a dash where there is no number."""
        if value is None or not math.isfinite(value):
            return "–"
        gap = "" if self.name == "°" else " "
        return f"{three_digits(value * self.factor)}{gap}{self.name}".rstrip()


MILLIMETRE = Unit("mm", 1e3)
METRE = Unit("m", 1.0)
DEGREE = Unit("°", 180.0 / math.pi)
MICRORADIAN = Unit("µrad", 1e6)
_LENGTHS = (Unit("µm", 1e6), MILLIMETRE)
_ANGLES = (MICRORADIAN, Unit("mrad", 1e3), DEGREE)
_OTHERS = {"1": "", "N m": "N m", "N": "N", "s": "s", "kg": "kg", "°C": "°C", "": ""}


def length_unit(*sizes: float) -> Unit:
    """Millimetres, micrometres where all sizes (m) are below 0.02 mm."""
    return _LENGTHS[0] if _largest(sizes) < 2e-5 else MILLIMETRE


def joint_unit(unit: str, *sizes: float) -> Unit:
    """For the error of a joint: µrad up to 2 mrad, mrad up to 0.1 rad, then degrees; lengths as such."""
    if unit == "m":
        return length_unit(*sizes)
    largest = _largest(sizes)
    return _ANGLES[0] if largest < 2e-3 else _ANGLES[1] if largest < 0.1 else _ANGLES[2]


def driver_unit(unit: str) -> Unit:
    """For an axis: degrees for angles, metres for lengths, all else as it is."""
    return {"rad": DEGREE, "m": METRE}.get(unit) or Unit(_OTHERS.get(unit, unit), 1.0)


def error_unit(unit: str, *sizes: float) -> Unit:
    """For the length of an error vector: mm or µm, degrees."""
    return DEGREE if unit == "rad" else length_unit(*sizes)


def _largest(sizes: Iterable[float]) -> float:
    return max((abs(size) for size in sizes if math.isfinite(size)), default=0.0)
