"""Quantities with their unit behind them, as options and files take them: ``0.02mm``, ``20 um``, ``0.01 deg``."""

from __future__ import annotations

import math
import re
from typing import Literal

from robacc.errors import UsageError

SIGNIFICANT_DIGITS = 12
"""Significant digits of every number that is written to a file: 1e-12 of an arm's reach is far below any instrument,
and digits beyond them differ between processors."""

Dimension = Literal["length", "angle"]

UNITS: dict[Dimension, dict[str, float]] = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180},
}
"""m or rad for each unit."""
_EXAMPLE: dict[Dimension, str] = {"length": "0.02mm", "angle": "0.005deg"}
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zµ]*)\s*", re.ASCII | re.IGNORECASE)


def parse_quantity(text: str) -> tuple[float, Dimension | None] | None:
    """A number in m or rad and what it is of; a bare number is of nothing.

    Returns:
        None where the text is no finite number or its unit is not known.
    """
    match = _NUMBER.fullmatch(text)
    if match is None or not math.isfinite(float(match[1])):
        return None
    if not match[2]:
        return float(match[1]), None
    for dimension, sizes in UNITS.items():
        if match[2] in sizes:
            return float(match[1]) * sizes[match[2]], dimension
    return None


def size(value: float | str, kind: Dimension, option: str) -> float:
    """A size in m or rad: of text, the number with its unit; what is a number already is in m or rad.

    Text without a unit is refused but for zero, which is zero in any: whoever types 0.02 means mm as likely as m.

    Raises:
        UsageError: it is not a finite number that is not negative, or its unit is another or missing.
    """
    found = parse_quantity(value) if isinstance(value, str) else (float(value), None)
    if found is None or not math.isfinite(found[0]) or found[1] not in (None, kind):
        raise UsageError(f"{option}: expected a number with a unit ({', '.join(UNITS[kind])}), found {value!r}")
    if found[0] < 0:
        raise UsageError(f"{option}: expected a size that is not negative, found {value!r}")
    if isinstance(value, str) and found[1] is None and found[0] != 0:
        units = ", ".join(UNITS[kind])
        raise UsageError(f"{option}: {value!r} has no unit; write one behind it ({units}), as in {_EXAMPLE[kind]}")
    return found[0]


def significant(value: float) -> float:
    """The number rounded to :data:`SIGNIFICANT_DIGITS`; -0.0 becomes 0.0, NaN and infinities stay."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}") + 0.0


def number_text(value: float) -> str:
    """Shortest text of the number rounded to :data:`SIGNIFICANT_DIGITS`; reading it back gives :func:`significant`."""
    return repr(significant(value))
