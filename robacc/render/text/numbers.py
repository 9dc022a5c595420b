"""How a number is printed: as many digits as its uncertainty leaves meaning to."""

from __future__ import annotations

import math

_MOST_DECIMALS = 9
_DIGITS_OF_UNCERTAINTY = 2
"""Digits of an interval's half width that are shown (JCGM 100:2008, 7.2.6)."""
_MOST_NATS = 700.0
"""Beyond it the exponential overflows."""
_DIGITS_WITHOUT = 3
"""Digits of a number of unknown uncertainty."""


def decimals(value: float, lower: float | None, upper: float | None) -> int:
    """Decimals of a value whose interval is ``lower … upper``; without one, those of three significant digits."""
    if lower is not None and upper is not None and upper > lower:
        return _places(0.5 * (upper - lower), _DIGITS_OF_UNCERTAINTY)
    return _places(abs(value), _DIGITS_WITHOUT)


def fixed(value: float | None, places: int) -> str:
    """The number with ``places`` decimals, zero without a sign; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def three_digits(value: float) -> str:
    """Three significant digits, without an exponent where that is readable."""
    if 1e-4 <= abs(value) < 1e6:
        return fixed(value, decimals(value, None, None))
    return "0" if abs(value) < 1e-12 else f"{value:.2e}"


def measured(value: float, error: float) -> tuple[str, str]:
    """A value and its standard error: two digits of the error, the value to the same place (JCGM 100:2008, 7.2.6)."""
    if not (error > 0.0 and math.isfinite(error) and math.isfinite(value)):
        return f"{value + 0.0:.6g}", f"{error:g}"
    shown = f"{error:.{_DIGITS_OF_UNCERTAINTY - 1}e}"
    place = int(shown.partition("e")[2]) - (_DIGITS_OF_UNCERTAINTY - 1)
    if 1e-4 <= abs(float(shown)) < 1e6:
        shown = fixed(round(error, -place), max(-place, 0))
    size = max(abs(value), error)
    if 1e-4 <= size < 1e6:
        # A double has no more than fifteen digits, however small the error of noise-free poses.
        places = min(max(-place, 0), 14 - math.floor(math.log10(size)))
        return fixed(round(value, -place), places), shown
    digits = math.floor(math.log10(abs(value))) - place if value else -1
    if digits < 0:
        rounded = round(value * 10.0**-place)
        return ("0" if rounded == 0 else f"{rounded * 10.0**place:.0e}"), shown
    return f"{value:.{min(digits, 14)}e}", shown


def exponent_of_thousand(size: float) -> int:
    """The power of ten, a multiple of three, that brings ``size`` to between 0.1 and 100, or 0 where it need not be."""
    if size <= 0.0 or not math.isfinite(size) or 0.05 <= size < 1e5:
        return 0
    return 3 * math.floor((math.log10(size) + 1.0) / 3.0)


def p_value(probability: float | None) -> str:
    """``p = 0.032``, or ``p < 1e-6`` where the exact figure says no more."""
    if probability is None or math.isnan(probability):
        return "–"
    return "p < 1e-6" if probability < 1e-6 else f"p = {probability:.2g}"


def chance(probability: float) -> str:
    """A probability in whole percent, never as if it were certain."""
    if probability > 0.995:
        return "> 99 %"
    return "< 1 %" if probability < 0.005 else f"{100 * probability:.0f} %"


def _places(size: float, digits: int) -> int:
    if size <= 0.0 or not math.isfinite(size):
        return _DIGITS_WITHOUT
    # Rounded first, so that 0.0996 counts as 0.10.
    exponent = math.floor(math.log10(float(f"{size:.{digits - 1}e}")))
    return min(max(digits - 1 - exponent, 0), _MOST_DECIMALS)


def odds(lag: float) -> str:
    """Of a rival that is ``lag`` nats behind in evidence, against what it competes with; ahead where it is negative."""
    ratio = f"{math.exp(min(abs(lag), _MOST_NATS)):.3g}"
    return f"{ratio} to 1" if lag < 0 and ratio != "1" else f"1 to {ratio}"
