"""Rivals of a finding: effects that explain the same residual nearly as well."""

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
"""Evidence (log Bayes factor) within which a rival is named as an alternative (odds of 150 to 1)."""
_LEAST_SIMILARITY = 0.5
"""Similarity below which a rival explains another part of the residual."""
_NEARLY_IDENTICAL = 0.95
"""Similarity from which a rival with less evidence is fitted in the finding's place …"""
_REFITTED = 10
"""… if it is among this number of strongest rivals."""
_MOST = 4
"""Largest number of alternatives named."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A rival that explains the same residual nearly as well."""

    effect: str
    joints: tuple[str, ...]
    similarity: float
    """Cosine between the fits of the two to the residual: 1 if they are not distinguishable on these poses."""
    evidence_difference: float
    """Evidence of the finding less evidence of the rival (log Bayes factor); negative if the rival's is larger."""
    settings: dict[str, object]


Lag = Callable[[Ranked, Ranked], float | None]
"""Function of a finding and a rival: the finding's evidence less the rival's; None if the rival cannot be fitted."""


def rivals(
    selection: Selection, finding: Chosen, refitted: Lag | None = None
) -> tuple[Ranked, tuple[Alternative, ...]]:
    """Return a finding's score and its rivals near in evidence, nearest first: at most one for each effect and joint.

    Rivals are scored at the fit that contains the finding at full size. The linearisation ignores the curvature of a
    rival, so an equal of a large finding seems to fall behind. ``refitted`` is asked about those.
    """
    ranked, ranking = selection.contest(finding)
    names = {str(finding.candidate.effect)}
    alternatives: list[Alternative] = []
    for place, rival in enumerate(ranking):
        effect = rival.candidate.effect
        name = str(effect)
        lag = ranked.total - rival.total
        behind = lag > RIVAL
        if name in names or len(alternatives) == _MOST or (behind and (refitted is None or place >= _REFITTED)):
            continue
        similarity = selection.similarity(finding, rival.candidate)
        if similarity < (_NEARLY_IDENTICAL if behind else _LEAST_SIMILARITY):
            continue
        if behind and refitted is not None:
            fitted = refitted(ranked, rival)
            if fitted is None or fitted > RIVAL:
                continue
            lag = fitted
        names.add(name)
        alternatives.append(Alternative(effect.name, effect.joints, similarity, lag, effect.settings()))
    return ranked, tuple(sorted(alternatives, key=lambda other: other.evidence_difference))


def lag_refitted(loop: SearchResult, finding: Chosen, effect: Effect, data: Measurements) -> Lag:
    """Return the function that fits a rival in the place of ``effect`` and returns its lag in evidence.

    The evidence's likelihood is replaced by that of the two fits; None if the rival cannot be fitted.
    """
    final = loop.final
    train = data.subset(np.flatnonzero(final.inliers))
    options = dataclasses.replace(SEARCH, robust=False, misfit=final.misfit, scatter=final.scatter)
    others = [other for other in loop.effects if other is not effect]
    conditioned = loop.selection.scorer.condition(loop.selection.chosen, without=finding)

    def linear(ranked: Ranked) -> float:
        return -0.5 * conditioned.dof * math.log1p(-min(ranked.gain / conditioned.cost, 0.999999999))

    def lag(ranked: Ranked, rival: Ranked) -> float | None:
        free = frames_first((*others, rival.candidate.effect))
        try:
            fit_with_rival = refit(final, (*loop.declared.model.free, *free), train, options)
        except RobaccError:
            return None
        costs = [float(np.sum(np.square(f.whitening.apply(f.residual * f.inliers)))) for f in (final, fit_with_rival)]
        difference = (ranked.total - linear(ranked)) - (rival.total - linear(rival))
        dof = fit_with_rival.residual.size - fit_with_rival.identifiability.columns.size
        return difference + 0.5 * dof * math.log(costs[1] / costs[0])

    return lag
