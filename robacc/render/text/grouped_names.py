"""Many names in few words: coefficients of uncertain masses, and names with a common beginning."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from robacc.fitting.parameters import FittedParameter

_OF_MASS = re.compile(r"(?P<effect>.+)\.(?:h[xyz]|m)\d+")
"""Coefficient of an elastic effect times a mass, or times a first moment of mass, of one link."""


def without_mass_coefficients(parameters: Iterable[FittedParameter]) -> tuple[list[FittedParameter], dict[str, int]]:
    """Return the parameters that are not of uncertain masses, and how many are, by effect and joint."""
    others: list[FittedParameter] = []
    counts: dict[str, int] = {}
    for parameter in parameters:
        match = _OF_MASS.fullmatch(parameter.name)
        if match and " kg" in parameter.unit:
            counts[match["effect"]] = counts.get(match["effect"], 0) + 1
        else:
            others.append(parameter)
    return others, counts


def mass_coefficients(effect: str, count: int) -> str:
    """Return a sentence about the coefficients of uncertain masses of one effect."""
    return (
        f"{effect}: {count} coefficients, because masses are uncertain; the poses determine their sum, not each "
        "(the JSON result has each)"
    )


def grouped(names: Sequence[str]) -> str:
    """Return names with a common beginning together: ``tool_frame.a (roll, pitch)``."""
    members: dict[str, list[str]] = {}
    for name in names:
        start, _, last = name.rpartition(".")
        members.setdefault(start, []).append(last)
    return ", ".join(
        f"{start} ({', '.join(parts)})"
        if start and len(parts) > 1
        else ", ".join(f"{start}.{part}".lstrip(".") for part in parts)
        for start, parts in members.items()
    )
