"""Gates and their criteria: a limit, a decision rule and the reason for the limit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robacc.gates.keys import Kind

Rule = Literal["bound", "simple", "guard_band", "guarded_rejection"]
RULES: dict[Rule, str] = {
    "bound": (
        "ISO 14253-1: pass if the confidence bound meets the limit, fail if the opposite bound is beyond the limit, "
        "otherwise inconclusive"
    ),
    "simple": (
        "JCGM 106, 8.2: pass if the value itself meets the limit; at the limit, the decision is wrong half of the time"
    ),
    "guard_band": (
        "JCGM 106, 8.3.2, guarded acceptance: pass if the risk of a false accept is at most the stated risk, "
        "otherwise fail"
    ),
    "guarded_rejection": (
        "JCGM 106, 8.3.3: fail only if the risk of a false reject is at most the stated risk, otherwise pass"
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
    """In m, rad or as a bare number; limit of the difference if there is a baseline. None if ``accepted`` applies."""
    accepted: tuple[str, ...]
    """The words that pass, or the one grade to meet."""
    at_least: bool
    """The limit is a minimum, not a maximum."""
    rule: Rule
    confidence: float
    """Confidence of each one-sided bound; one minus the stated risk for the guarded rules."""
    share: float
    """Share of all poses that must lie within the limit of a largest error."""
    baseline: str | None
    """A stored result to compare with, by its path from the gate file."""
    paired: bool | None
    """Whether both results list the same poses in the same order; None: only if the results show it."""
    reason: str
    """Reason for the limit, in the words of the gate's author."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Named criteria, all of which a result must meet."""

    name: str
    criteria: tuple[GateCriterion, ...]

    @property
    def baselines(self) -> tuple[str, ...]:
        """Return the paths of the stored results to compare with, without repetitions, from the gate file."""
        return tuple(dict.fromkeys(criterion.baseline for criterion in self.criteria if criterion.baseline is not None))
