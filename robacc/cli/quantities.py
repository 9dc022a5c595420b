"""Numbers as options take them: quantities with their unit behind them, and lists."""

from __future__ import annotations

import math

from robacc.errors import UsageError
from robacc.quantities import UNITS, Dimension, parse_quantity


def quantity(text: str, kind: Dimension, option: str) -> float:
    """The value of ``text`` in m or rad; a bare number is that already.

    Raises:
        UsageError: it is not a finite number that is not negative, or its unit is another.
    """
    found = parse_quantity(text)
    if found is None or found[1] not in (None, kind):
        raise UsageError(f"{option}: expected a number with a unit ({', '.join(UNITS[kind])}), found {text!r}")
    if found[0] < 0:
        raise UsageError(f"{option}: expected a size that is not negative, found {text!r}")
    return found[0]


def numbers(text: str, separator: str, option: str) -> tuple[float, ...]:
    """The finite numbers of a list.

    Raises:
        UsageError: one of them is none.
    """
    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{option}: expected numbers separated by {separator!r}, found {text!r}")
    return values
