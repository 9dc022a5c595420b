"""Units behind the numbers of a table: ``381.289 mm``, ``33.5°``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

UNIT_NAMES: Mapping[str, str] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometre"), "um"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("mrad",), "mrad"),
    **dict.fromkeys(("deg", "°", "degree", "degrees"), "deg"),
    **dict.fromkeys(("s", "sec", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec"), "ms"),
    **dict.fromkeys(("us", "µs"), "us"),
    **dict.fromkeys(("ns", "nsec"), "ns"),
    **dict.fromkeys(("min",), "min"),
    **dict.fromkeys(("h",), "h"),
    **dict.fromkeys(("kg",), "kg"),
    **dict.fromkeys(("g",), "g"),
    **dict.fromkeys(("°c", "c", "degc", "deg c", "celsius"), "degC"),
}
"""Unit by its name in small letters."""
_NUMBER_AND_UNIT = re.compile(r"([+\-\u2212]?[\d.,][\d.,' \u2019]*(?:[eE][+-]?\d+)?)\s*([^\d\s.,'+-].*)")
_EXAMINED = 50
"""First rows in which the unit of a column is looked for."""


def split_cell(text: str) -> tuple[str, str | None]:
    """Return a cell's number and the unit behind it; the text as it is and None where there is no known unit."""
    if not text or text[-1].isdecimal():
        return text, None
    match = _NUMBER_AND_UNIT.fullmatch(text)
    unit = UNIT_NAMES.get(match[2].strip().lower()) if match else None
    return (text, None) if match is None or unit is None else (match[1].strip(), unit)


def units_of_columns(rows: Iterable[Sequence[str]]) -> dict[int, str]:
    """Return the unit in the first cell of each column that has one there; empty cells do not count."""
    first: dict[int, str | None] = {}
    for number, row in enumerate(rows):
        if number == _EXAMINED:
            break
        for i, text in enumerate(row):
            if i not in first and any(sign.isdecimal() for sign in text):
                first[i] = split_cell(text)[1]
    return {i: unit for i, unit in first.items() if unit is not None}
