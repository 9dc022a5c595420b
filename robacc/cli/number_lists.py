"""Lists of numbers as the text of an option."""

from __future__ import annotations

import math


def numbers_of(text: str, separator: str, option: str) -> tuple[float, ...]:
    """Return the finite numbers of a list.

    Raises:
        UsageError: a part of the list is not a finite number.
    """
    from robacc.errors import UsageError

    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{option}: expected numbers separated by {separator!r}, found {text!r}")
    return values
