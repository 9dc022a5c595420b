"""Quantities with units, as parameters and files give them: ``0.02mm``, ``20 um``, ``0.01 deg``."""

import math
import re
from typing import Literal

from robacc.errors import refuse

SIGNIFICANT_DIGITS = 12
"""Significant digits of numbers in files: 1e-12 of an arm's reach is far below the resolution of any instrument, and
further digits differ between processors."""

Dimension = Literal["length", "angle"]

UNITS: dict[Dimension, dict[str, float]] = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180},
}
"""Size of each unit in m or rad."""
_EXAMPLE: dict[Dimension, str] = {"length": "0.02mm", "angle": "0.005deg"}
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zµμ]*)\s*", re.ASCII | re.IGNORECASE)


def parse_quantity(text: str) -> tuple[float, Dimension | None] | None:
    """Parse a number with a unit into m or rad and its dimension; a bare number has no dimension.

    Returns:
        None where the text is no finite number or the unit is unknown.
    """
    match = _NUMBER.fullmatch(text)
    if match is None or not math.isfinite(float(match[1])):
        return None
    if not match[2]:
        return float(match[1]), None
    unit = re.sub("[µμ]", "u", match[2])  # the micro sign, and the Greek letter that stands for it
    for dimension, sizes in UNITS.items():
        if unit in sizes:
            return float(match[1]) * sizes[unit], dimension
    return None


def size(value: float | str, dimension: Dimension, name: str) -> float:
    """Return a size in m or rad, from text with a unit or from a number in m or rad.

    Text without a unit is refused unless it is zero, because 0.02 may mean mm or m. ``name`` is the parameter's name
    for messages.

    Raises:
        UsageError: The value is negative or not finite, or its unit is missing or of another dimension.
    """
    quantity = parse_quantity(value) if isinstance(value, str) else (float(value), None)
    (number, unit), units = quantity or (math.nan, None), ", ".join(UNITS[dimension])
    is_wrong, is_bare = not math.isfinite(number) or unit not in (None, dimension), isinstance(value, str) and not unit
    refuse(
        (is_wrong, f"{name}: expected a number with a unit ({units}), found {value!r}"),
        (number < 0, f"{name}: expected a size that is not negative, found {value!r}"),
        (
            is_bare and number != 0,
            f"{name}: {value!r} has no unit; add a unit ({units}), for example {_EXAMPLE[dimension]}",
        ),
    )
    return number


def optional_size(value: float | str | None, dimension: Dimension, name: str) -> float | None:
    """Return a size in m or rad as :func:`size` does; None for None.

    Raises:
        UsageError: As :func:`size`.
    """
    return None if value is None else size(value, dimension, name)


def significant(value: float) -> float:
    """Return the number rounded to :data:`SIGNIFICANT_DIGITS`; -0.0 becomes 0.0, NaN and infinities stay."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}") + 0.0


def number_text(value: float) -> str:
    """Return the shortest text of the number rounded to :data:`SIGNIFICANT_DIGITS`; it reads as :func:`significant`."""
    return repr(significant(value))
