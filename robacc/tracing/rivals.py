"""What else could be meant by a finding: rivals that explain the same residual nearly as well."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.errors import RobaccError
from robacc.measurements import Measurements
from robacc.tracing.candidate_scorer import Chosen, Ranked
from robacc.tracing.loop import SEARCH, SearchResult, frames_first, refit
from robacc.tracing.selection import Selection

RIVAL = 5.0
"""A rival within this many nats of the finding's own evidence (odds of 150 to 1) is named as an alternative."""
_ALIKE = 0.5
"""Likeness below which a rival explains something else."""
_THE_SAME = 0.95
"""Likeness from which a rival further behind than that is fitted in the finding's place …"""
_LOOKED_AT = 10
"""… if it is among so many of the strongest."""
_MOST = 4
"""Alternatives named at most."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A rival that explains the same residual nearly as well."""

    effect: str
    joints: tuple[str, ...]
    similarity: float
    """Cosine between what the two take out of the residual: 1 where these poses cannot tell them apart at all."""
    evidence_difference: float
    """Nats by which its evidence is behind the finding's; negative where it is ahead."""
    settings: dict[str, object]


Lag = Callable[[Ranked, Ranked], float | None]
"""Of a finding and a rival, how many nats the rival is behind; None where that cannot be had."""


def rivals(selection: Selection, one: Chosen, refitted: Lag | None = None) -> tuple[Ranked, tuple[Alternative, ...]]:
    """A finding's own score, and its rivals near in evidence: one of each effect and joint, the nearest first.

    Rivals are judged where the finding stands at its full size, so a large one's equals seem to fall behind: what is
    curved in them has not been fitted. ``refitted`` is asked about those.
    """
    own, ranking = selection.contest(one)
    seen = {(one.candidate.effect.name, one.candidate.effect.joints)}
    found: list[Alternative] = []
    for place, rival in enumerate(ranking):
        effect = rival.candidate.effect
        name = (effect.name, effect.joints)
        lag = own.total - rival.total
        behind = lag > RIVAL
        if name in seen or len(found) == _MOST or (behind and (refitted is None or place >= _LOOKED_AT)):
            continue
        similarity = selection.similarity(one, rival.candidate)
        if similarity < (_THE_SAME if behind else _ALIKE):
            continue
        if behind and refitted is not None:
            fitted = refitted(own, rival)
            if fitted is None or fitted > RIVAL:
                continue
            lag = fitted
        seen.add(name)
        found.append(Alternative(effect.name, effect.joints, similarity, lag, effect.settings()))
    return own, tuple(sorted(found, key=lambda other: other.evidence_difference))


def lag_refitted(loop: SearchResult, one: Chosen, effect: Effect, data: Measurements) -> Lag:
    """How far a rival of ``effect`` is behind once it is fitted in its place.

    The evidence's likelihood is replaced by that of the two fits; None where the rival cannot be fitted.
    """
    final = loop.final
    train = data.subset(np.flatnonzero(final.inliers))
    options = dataclasses.replace(SEARCH, robust=False, misfit=final.misfit, scatter=final.scatter)
    others = [other for other in loop.effects if other is not effect]
    conditioned = loop.selection.field.condition(loop.selection.chosen, without=one)

    def linear(ranked: Ranked) -> float:
        return -0.5 * conditioned.freedom * math.log1p(-min(ranked.gain / conditioned.energy, 0.999999999))

    def lag(own: Ranked, rival: Ranked) -> float | None:
        free = frames_first((*others, rival.candidate.effect))
        try:
            found = refit(final, (*loop.declared.model.free, *free), train, options)
        except RobaccError:
            return None
        energies = [float(np.sum(np.square(f.whitening.apply(f.residual * f.inliers)))) for f in (final, found)]
        rest = (own.total - linear(own)) - (rival.total - linear(rival))
        freedom = found.residual.size - found.identifiability.columns.size
        return rest + 0.5 * freedom * math.log(energies[1] / energies[0])

    return lag
