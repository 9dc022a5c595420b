"""Units and bars of the tables of a prediction."""

from __future__ import annotations

import math

from robacc.render.text.numbers import three_digits

FACTORS = {"m": (1e3, "mm"), "rad": (180.0 / math.pi, "°")}
"""By SI unit: the factor to the displayed unit, and that unit."""


def amount(value: float, unit: str) -> str:
    """Return a value in mm or degrees, three digits."""
    return three_digits(value * FACTORS[unit][0])


def with_unit(value: float, unit: str) -> str:
    """Return a value in mm or degrees with its unit."""
    name = FACTORS[unit][1]
    return f"{amount(value, unit)}{'' if name == '°' else ' '}{name}"


def percent(share: float) -> str:
    """Return a share in percent, one decimal."""
    return f"{100 * share:.1f} %"


def bar(share: float, largest: float, width: int) -> str:
    """Return a bar padded to ``width`` columns; the ``largest`` share of the table fills them."""
    return ("█" * (round(width * share / largest) if largest > 0 else 0)).ljust(width)
