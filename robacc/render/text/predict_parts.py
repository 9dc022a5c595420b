"""Units and bars of the tables of a prediction."""

from __future__ import annotations

from robacc.render.text.numbers import three_digits
from robacc.render.text.units import table_unit, with_table_unit


def amount(value: float, unit: str) -> str:
    """Return a value in mm or degrees, three digits."""
    return three_digits(value * table_unit(unit)[0])


def with_unit(value: float, unit: str) -> str:
    """Return a value in mm or degrees with its unit."""
    return with_table_unit(amount(value, unit), table_unit(unit)[1])


def percent(share: float) -> str:
    """Return a share in percent, one decimal."""
    return f"{100 * share:.1f} %"


def bar(share: float, largest: float, width: int) -> str:
    """Return a bar padded to ``width`` columns; the ``largest`` share of the table fills them."""
    return ("█" * (round(width * share / largest) if largest > 0 else 0)).ljust(width)
