"""What else could be meant by a finding: rivals that explain the same residual nearly as well."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.tracing.competition import Chosen, Ranked
from robacc.tracing.selection import Selection

RIVAL = 5.0
"""A rival within this many nats of the finding's own evidence (odds of 150 to 1) is named as an alternative."""
_ALIKE = 0.5
"""Likeness below which a rival explains something else."""
_MOST = 4
"""Alternatives named at most."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A rival that explains the same residual nearly as well."""

    effect: str
    joints: tuple[str, ...]
    likeness: float
    """Cosine between what the two take out of the residual: 1 where these poses cannot tell them apart at all."""
    evidence_lag: float
    """Nats by which its evidence is behind the finding's; negative where it is ahead."""
    settings: dict[str, object]


def rivals(selection: Selection, one: Chosen) -> tuple[Ranked, tuple[Alternative, ...]]:
    """A finding's own score, and its rivals near in evidence: one of each effect and joint, the strongest first."""
    own, ranking = selection.contest(one)
    seen = {(one.candidate.effect.name, one.candidate.effect.joints)}
    found: list[Alternative] = []
    for rival in ranking:
        effect = rival.candidate.effect
        name = (effect.name, effect.joints)
        lag = own.total - rival.total
        if name in seen or lag > RIVAL or len(found) == _MOST:
            continue
        likeness = selection.likeness(one, rival.candidate)
        if likeness < _ALIKE:
            continue
        seen.add(name)
        found.append(Alternative(effect.name, effect.joints, likeness, lag, effect.settings()))
    return own, tuple(found)
