"""Lists of numbers as options take them."""

from __future__ import annotations

import math

from robacc.errors import UsageError


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
