"""Rivals of a finding: effects that explain the same residual nearly as well."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.errors import RobaccError
from robacc.measurements import Measurements
from robacc.tracing.candidates import Candidate, EffectName
from robacc.tracing.loop import SearchResult
from robacc.tracing.ranking import Chosen, Ranked
from robacc.tracing.refinement import refined
from robacc.tracing.refitting import SEARCH, frames_first, refit
from robacc.tracing.selection import Selection

RIVAL = 5.0
"""Evidence (log Bayes factor) within which a rival is named as an alternative (odds of 150 to 1)."""
MOST_TO_REFIT = 200
"""Coefficients beyond which rivals are not fitted in a finding's place."""
_LEAST_SIMILARITY = 0.5
"""Similarity below which a rival explains another part of the residual."""
_LIKE = 0.8
"""Similarity from which a rival with less evidence is fitted in the finding's place …"""
_REFITTED = 10
"""… if it is among this number of strongest rivals."""
_MOST_FITTED = 3
"""Largest number of rivals that are fitted in a finding's place."""
_LEAST_DIFFERENCE = 1.645
"""Standard errors by which the errors of the poses must differ for the finding to be better at 95 % confidence."""
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
    within_uncertainty: bool = False
    """True if the finding has more evidence by the noise model, but the errors of the poses with the finding and with
    the rival differ by less than their uncertainty."""


@dataclass(frozen=True, slots=True)
class FittedRival:
    """A rival fitted in a finding's place."""

    lag: float
    """Evidence of the finding less that of the rival (log Bayes factor)."""
    difference: float
    """Mean over the poses of the squared whitened error with the rival less that with the finding, in standard errors
    (Q. H. Vuong, Econometrica 57 (1989) 307)."""


Lag = Callable[[Ranked, Ranked], FittedRival | None]
"""Function of a finding and a rival, which fits the rival in its place; None if it cannot be fitted."""


def rivals(
    selection: Selection,
    finding: Chosen,
    refitted: Lag | None = None,
    among: Collection[EffectName] | None = None,
) -> tuple[Ranked, tuple[Alternative, ...]]:
    """Return a finding's score and its rivals near in evidence, nearest first: at most one for each effect and joint.

    Rivals are scored at the fit that contains the finding at full size. The linearisation ignores the curvature of a
    rival, so an equal of a large finding seems to have less evidence: ``refitted`` compares those. A rival is judged as
    the finding is: in the form of largest evidence near the best of those that a search tries first. With ``among``,
    only rivals of these effects and joints are judged.
    """
    # Whether a rival is refitted depends on its place among all.
    ranked, ranking = selection.contest(finding, among if refitted is None else None)
    alternatives: list[Alternative] = []
    n_fitted = 0
    for place, first_form in enumerate(_best_forms(ranking, finding)):
        if among is not None and first_form.candidate.effect_name not in among:
            continue
        behind = ranked.total - first_form.total > RIVAL
        if len(alternatives) == _MOST or (behind and (refitted is None or place >= _REFITTED)):
            continue
        rival = _refined(selection, finding, first_form)
        effect = rival.candidate.effect
        lag = ranked.total - rival.total
        behind = lag > RIVAL
        if behind and refitted is None:
            continue
        within_uncertainty = False
        similarity = _similarity(selection, finding, rival.candidate)
        if similarity < (_LIKE if behind else _LEAST_SIMILARITY):
            continue
        if behind and refitted is not None:
            fitted = refitted(ranked, rival) if n_fitted < _MOST_FITTED else None
            n_fitted += 1
            if fitted is None or (fitted.lag > RIVAL and fitted.difference >= _LEAST_DIFFERENCE):
                continue
            lag, within_uncertainty = fitted.lag, fitted.lag > RIVAL
        alternatives.append(
            Alternative(effect.name, effect.joints, similarity, lag, effect.settings(), within_uncertainty)
        )
    return ranked, tuple(sorted(alternatives, key=lambda other: other.evidence_difference))


def _best_forms(ranking: Sequence[Ranked], finding: Chosen) -> list[Ranked]:
    """Return the best form of each effect on each joint, without the finding's own."""
    best: dict[str, Ranked] = {}
    for rival in ranking:
        best.setdefault(str(rival.candidate.effect), rival)
    best.pop(str(finding.candidate.effect), None)
    return list(best.values())


def _refined(selection: Selection, finding: Chosen, rival: Ranked) -> Ranked:
    """Return a rival with its searched setting improved in the finding's place."""
    scorer = selection.scorer
    conditioned = scorer.condition(selection.chosen, without=finding)
    candidate = refined(scorer, conditioned, scorer.as_chosen(rival.candidate, rival.prior_var))
    if candidate.key == rival.candidate.key:
        return rival
    better = scorer.score(scorer.as_chosen(candidate, rival.prior_var), conditioned)
    return better if better.total > rival.total else rival


def _similarity(selection: Selection, finding: Chosen, rival: Candidate) -> float:
    """Return the cosine between the fits of a finding and of a rival to the residual, given all other findings."""
    scorer = selection.scorer
    columns = scorer.columns(rival)
    conditioned = scorer.condition(selection.chosen, without=finding)
    fits = [conditioned.least_squares(finding.columns), conditioned.least_squares(columns)]
    cross = scorer.system.products(finding.columns)[:, columns]
    cross = cross - conditioned.reduced[:, finding.columns].T @ conditioned.reduced[:, columns]
    lengths = [
        float(weight @ conditioned.block(place) @ weight)
        for weight, place in zip(fits, (finding.columns, columns), strict=True)
    ]
    if min(lengths) <= 0:
        return 0.0
    cosine = float(fits[0] @ cross @ fits[1] / math.sqrt(lengths[0] * lengths[1]))
    return min(max(cosine, -1.0), 1.0)


def lag_refitted(search_result: SearchResult, finding: Chosen, effect: Effect, data: Measurements) -> Lag:
    """Return the function that fits a rival in the place of ``effect`` and compares the two.

    The evidence's likelihood is replaced by that of the two fits; None if the rival cannot be fitted.
    """
    poses = np.unique(data.groups()[search_result.final.inliers], return_inverse=True)[1]
    final = search_result.final
    train = data.subset(np.flatnonzero(final.inliers))
    options = dataclasses.replace(SEARCH, robust=False, misfit=final.misfit, scatter=final.scatter)
    others = [other for other in search_result.effects if other is not effect]
    conditioned = search_result.selection.scorer.condition(search_result.selection.chosen, without=finding)

    def linear(ranked: Ranked) -> float:
        return -0.5 * conditioned.dof * math.log1p(-min(ranked.gain / conditioned.cost, 0.999999999))

    def lag(ranked: Ranked, rival: Ranked) -> FittedRival | None:
        free = frames_first((*others, rival.candidate.effect))
        try:
            fit_with_rival = refit(final, (*search_result.declared.model.free, *free), train, options)
        except RobaccError:
            return None
        errors = [
            np.sum(np.square(f.whitening.apply(f.residual * f.inliers)[:, f.inliers]), axis=0)
            for f in (final, fit_with_rival)
        ]
        costs = [float(np.sum(squares)) for squares in errors]
        by_pose = np.bincount(poses, weights=errors[1] - errors[0])
        standard_error = float(np.std(by_pose, ddof=1)) / math.sqrt(by_pose.size) if by_pose.size > 1 else 0.0
        difference = (ranked.total - linear(ranked)) - (rival.total - linear(rival))
        dof = fit_with_rival.residual.size - fit_with_rival.identifiability.columns.size
        separation = float(np.mean(by_pose)) / standard_error if standard_error > 0 else math.inf
        return FittedRival(difference + 0.5 * dof * math.log(costs[1] / costs[0]), separation)

    return lag
