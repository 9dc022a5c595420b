"""Numbers with the digits that their uncertainty supports, units, and names of effects, as texts."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

Document = Mapping[str, Any]
"""A JSON result."""

# Numbers as text: as many digits as the uncertainty supports.

_MOST_DECIMALS = 9
_DIGITS_OF_UNCERTAINTY = 2
"""Digits of an interval's half width (JCGM 100:2008, 7.2.6)."""
_MAX_EXPONENT = 700.0
"""Beyond it the exponential overflows."""
_DIGITS_WITHOUT = 3
"""Digits of a number of unknown uncertainty."""


def decimals(value: float, lower: float | None, upper: float | None) -> int:
    """Return the decimals of a value with the interval ``lower … upper``; three significant digits without one."""
    if lower is not None and upper is not None and upper > lower:
        return _places(0.5 * (upper - lower), _DIGITS_OF_UNCERTAINTY)
    return _places(abs(value), _DIGITS_WITHOUT)


def fixed(value: float | None, places: int) -> str:
    """Return the number with ``places`` decimals, zero without a sign; a dash for None and NaN."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def three_digits(value: float) -> str:
    """Return three significant digits, with an exponent only for very small and very large values."""
    if 1e-4 <= abs(value) < 1e6:
        return fixed(value, decimals(value, None, None))
    return "0" if abs(value) < 1e-12 else f"{value:.2e}"


def measured(value: float, error: float) -> tuple[str, str]:
    """Return value and standard error: two digits of the error, the value to the same place (JCGM 100:2008, 7.2.6)."""
    if not (error > 0.0 and math.isfinite(error) and math.isfinite(value)):
        return f"{value + 0.0:.6g}", f"{error:g}"
    error_text = f"{error:.{_DIGITS_OF_UNCERTAINTY - 1}e}"
    place = int(error_text.partition("e")[2]) - (_DIGITS_OF_UNCERTAINTY - 1)
    if 1e-4 <= abs(float(error_text)) < 1e6:
        error_text = fixed(round(error, -place), max(-place, 0))
    size = max(abs(value), error)
    if 1e-4 <= size < 1e6:
        # A double has no more than fifteen digits, however small the error of noise-free poses.
        places = min(max(-place, 0), 14 - math.floor(math.log10(size)))
        return fixed(round(value, -place), places), error_text
    digits = math.floor(math.log10(abs(value))) - place if value else -1
    if digits < 0:
        rounded = round(value * 10.0**-place)
        return ("0" if rounded == 0 else f"{rounded * 10.0**place:.0e}"), error_text
    return f"{value:.{min(digits, 14)}e}", error_text


def p_value(probability: float | None) -> str:
    """Return ``p = 0.032``, or ``p < 1e-6`` for smaller probabilities."""
    if probability is None or math.isnan(probability):
        return "–"
    return "p < 1e-6" if probability < 1e-6 else f"p = {probability:.2g}"


def chance(probability: float) -> str:
    """Return a probability in whole percent, at most ``> 99 %`` and at least ``< 1 %``."""
    if probability > 0.995:
        return "> 99 %"
    return "< 1 %" if probability < 0.005 else f"{100 * probability:.0f} %"


def confirmation(confirmed: bool, confidence: float) -> str:
    """Return ``confirmed at 95 % confidence`` or its negation."""
    return f"{'' if confirmed else 'not '}confirmed at {100 * confidence:g} % confidence"


def _places(size: float, digits: int) -> int:
    if size <= 0.0 or not math.isfinite(size):
        return _DIGITS_WITHOUT
    # Rounding first makes 0.0996 count as 0.10.
    exponent = math.floor(math.log10(float(f"{size:.{digits - 1}e}")))
    return min(max(digits - 1 - exponent, 0), _MOST_DECIMALS)


def odds(difference: float) -> str:
    """Return the odds of an alternative whose evidence is lower by ``difference`` (log Bayes factor)."""
    ratio = f"{math.exp(min(abs(difference), _MAX_EXPONENT)):.3g}"
    return f"{ratio} to 1" if difference < 0 and ratio != "1" else f"1 to {ratio}"


# Units: mm and degrees in tables, whatever the unit of the result or of the robot file; charts and headlines use one
# unit each, chosen by its largest value.

IN_MM = 1e3
IN_DEGREES = 180.0 / math.pi


class Unit(NamedTuple):
    """A display unit."""

    factor: float
    """Displayed number = factor times SI value."""
    name: str

    def text(self, value: float | None) -> str:
        """Return three digits and the unit; a dash for None and NaN."""
        if value is None or not math.isfinite(value):
            return "–"
        return with_table_unit(three_digits(value * self.factor), self.name)


MILLIMETRE = Unit(IN_MM, "mm")
DEGREE = Unit(IN_DEGREES, "°")
_OF_SIZE = re.compile("(m|rad)([/ ].*)?")


def table_unit(unit: str) -> Unit:
    """Return the unit that tables show for an SI unit.

    ``rad/(N m)`` becomes ``°/(N m)``: only the unit before the first slash or space is that of an effect's size.
    """
    match = _OF_SIZE.fullmatch(unit)
    if match is None:
        return Unit(1.0, "" if unit == "1" else unit)
    factor, name = MILLIMETRE if match[1] == "m" else DEGREE
    return Unit(factor, name + (match[2] or ""))


def error_unit(unit: str, *sizes: float) -> Unit:
    """Return the unit of an error: degrees, or millimetres; micrometres if all sizes (m) are below 0.02 mm."""
    if unit == "rad":
        return DEGREE
    is_small = max((abs(size) for size in sizes if math.isfinite(size)), default=0.0) < 2e-5
    return Unit(1e6, "µm") if is_small else MILLIMETRE


def with_table_unit(number: str, name: str) -> str:
    """Return a number with its unit; degrees follow without a space."""
    return f"{number}{'' if name.startswith('°') else ' '}{name}".rstrip()


def grouped(names: Sequence[str]) -> str:
    """Return names with a common beginning together: ``tool_frame.a (roll, pitch)``."""
    members: dict[str, list[str]] = {}
    for name in names:
        start, _, last = name.rpartition(".")
        members.setdefault(start, []).append(last)
    return ", ".join(
        f"{start} ({', '.join(parts)})"
        if start and len(parts) > 1
        else ", ".join(f"{start}.{part}".lstrip(".") for part in parts)
        for start, parts in members.items()
    )


# Name of a finding or an alternative for a reader.


def effect_label(effect: str, joints: Sequence[str], settings: Mapping[str, Any]) -> str:
    """Return ``backlash[j3]``, ``step[base]``: the effect, with its joints or with the part that changes.

    Masses that are fitted too are named: the same effect with the file's masses may be another finding.
    """
    part, masses = settings.get("part"), settings.get("masses", "known")
    where = ",".join(joints) if joints and part != "payload" else settings.get("target") or part
    label = f"{effect}[{where}]" if where else effect
    return label if masses == "known" else f"{label} with {masses} masses"
