"""Units and bars of the tables of a prediction."""

from __future__ import annotations

import math

from robacc.render.text.numbers import three_digits

FACTORS = {"m": (1e3, "mm"), "rad": (180.0 / math.pi, "°")}
"""By SI unit: what to multiply by, and the unit that is then shown."""


def amount(value: float, unit: str) -> str:
    """In mm or degrees, three digits."""
    return three_digits(value * FACTORS[unit][0])


def with_unit(value: float, unit: str) -> str:
    """The same with its unit."""
    name = FACTORS[unit][1]
    return f"{amount(value, unit)}{'' if name == '°' else ' '}{name}"


def percent(share: float) -> str:
    """A share in percent, one decimal."""
    return f"{100 * share:.1f} %"


def bar(share: float, largest: float, width: int) -> str:
    """A bar of at most ``width`` columns for a share, the ``largest`` of its table filling them; padded to width."""
    return ("█" * (round(width * share / largest) if largest > 0 else 0)).ljust(width)
