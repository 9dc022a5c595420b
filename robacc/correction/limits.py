"""Limits of a correction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits beyond which a target is refused, and the weight for arms with fewer than six axes."""

    position: float | None = None
    """m: largest correction; None for no limit."""
    orientation: float | None = None
    """rad"""
    weight: float = 0.01
    """m per rad: weight of orientation for arms with fewer than six axes."""
    beyond_range: bool = False
    """Correct targets outside the validity range of the model too."""
    ranges: Mapping[str, tuple[float, float]] | None = None
    """Lowest and highest value that the model was fitted on, by joint or column; None if unknown."""
