"""Catalogue texts of an effect."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class About:
    """Catalogue texts of an effect."""

    summary: str
    equation: str
    unit: str
    usual_size: str
    usual_range: tuple[float, float]
    """Smallest and largest usual size of a coefficient, of the unit's first alternative, in SI."""
    needs: str
    confused_with: str
    source: str
    example: str
    """An entry of a robot file, in YAML, of an arm with joints j1 … j6 in m and rad."""
