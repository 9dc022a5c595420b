"""Units of tables: mm and degrees, whatever the unit of the result or of the robot file."""

from __future__ import annotations

import math

IN_MM = 1e3
IN_DEGREES = 180.0 / math.pi
_LEADING = {"m": (IN_MM, "mm"), "rad": (IN_DEGREES, "°")}


def table_unit(unit: str) -> tuple[float, str]:
    """Return the factor and the name of the unit that tables show for an SI unit.

    ``rad/(N m)`` becomes ``°/(N m)``: only the unit before the first slash or space is that of an effect's size.
    """
    if unit == "1":
        return 1.0, ""
    for separator in ("/", " "):
        head, sign, others = unit.partition(separator)
        if head in _LEADING:
            factor, name = _LEADING[head]
            return factor, f"{name}{sign}{others}"
    return 1.0, unit


def with_table_unit(number: str, name: str) -> str:
    """Return a number with its unit; degrees follow without a space."""
    return f"{number}{'' if name.startswith('°') else ' '}{name}".rstrip()
