"""What a gate asks for: criteria with a limit, a decision rule and the reason for the limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robacc.gates.keys import Kind

Rule = Literal["bound", "simple", "guard_band", "guarded_rejection"]
RULES: dict[Rule, str] = {
    "bound": (
        "ISO 14253-1: passes where the confidence bound meets the limit, fails where the opposite bound is beyond it, "
        "else inconclusive"
    ),
    "simple": "JCGM 106, 8.2: passes where the value itself meets the limit; as often wrong as right at the limit",
    "guard_band": (
        "JCGM 106, 8.3.2, guarded acceptance: passes where the risk of a false accept is within that stated, else fails"
    ),
    "guarded_rejection": (
        "JCGM 106, 8.3.3: fails only where the risk of a false reject is within that stated, else passes"
    ),
}


@dataclass(frozen=True, slots=True)
class GateCriterion:
    """One condition on one figure of a result."""

    name: str
    key: str
    """Short form, as in :data:`robacc.gates.keys.KEYS`."""
    kind: Kind
    limit: float | None
    """In m, rad or as a bare number; of the difference, where there is a baseline. None where words are allowed."""
    words: tuple[str, ...]
    """The words that pass, or the one grade that must be met."""
    at_least: bool
    """The limit is the lowest value allowed, not the largest."""
    rule: Rule
    confidence: float
    """Of each one-sided bound; one minus the stated risk for the guarded rules."""
    share: float
    """Of all poses, that must lie within the limit of a largest error."""
    baseline: str | None
    """A stored result, by its path from the gate file, that the figure is compared with."""
    paired: bool | None
    """Whether its rows are of the same poses in the same order; None: only where the results show it."""
    reason: str
    """For the limit, in the words of whoever set it."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Named criteria, all of which must be met."""

    name: str
    criteria: tuple[GateCriterion, ...]

    @property
    def baselines(self) -> tuple[str, ...]:
        """The stored results that it compares with, each once, by their paths from the gate file."""
        return tuple(dict.fromkeys(one.baseline for one in self.criteria if one.baseline is not None))
