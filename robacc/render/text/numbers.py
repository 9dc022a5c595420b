"""Numbers as text: as many digits as the uncertainty supports."""

from __future__ import annotations

import math

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


def exponent_of_thousand(size: float) -> int:
    """Return the power of ten, a multiple of three, that scales ``size`` to 0.1 … 100, or 0 for readable sizes."""
    if size <= 0.0 or not math.isfinite(size) or 0.05 <= size < 1e5:
        return 0
    return 3 * math.floor((math.log10(size) + 1.0) / 3.0)


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
