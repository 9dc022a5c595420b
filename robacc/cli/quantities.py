"""Quantities with their unit behind them, as options take them: ``0.02mm``, ``20um``, ``0.01deg``."""

from __future__ import annotations

import math
import re
from typing import Literal

from robacc.errors import UsageError

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zµ]*)\s*", re.ASCII | re.IGNORECASE)
_SIZES = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180},
}


def quantity(text: str, kind: Literal["length", "angle"], option: str) -> float:
    """The value of ``text`` in m or rad; a bare number is that already.

    Raises:
        UsageError: it is not a finite number that is not negative, or its unit is another.
    """
    match = _NUMBER.fullmatch(text)
    sizes = _SIZES[kind]
    if match is None or (match[2] and match[2] not in sizes):
        raise UsageError(f"{option}: expected a number with a unit ({', '.join(sizes)}), found {text!r}")
    value = float(match[1]) * sizes.get(match[2], 1.0)
    if not math.isfinite(value) or value < 0:
        raise UsageError(f"{option}: expected a size that is not negative, found {text!r}")
    return value


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
