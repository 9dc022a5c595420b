"""Votes of folds that chose, in a finding's place, an effect that the poses do not distinguish from it.

Near equals share the folds: some choose one, some the other, and none recurs in half of them. The cause of the group is
certain all the same, and only its name is not: a finding's named alternatives count as the finding.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator

from robacc.effects.base import Effect
from robacc.measurements import Measurements
from robacc.tracing.advice import rival_effect
from robacc.tracing.cross_validation import FoldChoices
from robacc.tracing.loop import SearchResult
from robacc.tracing.ranking import Chosen
from robacc.tracing.rivals import MOST_TO_REFIT, lag_refitted, rivals


def with_equal_votes(choices: FoldChoices, search_result: SearchResult, data: Measurements) -> FoldChoices:
    """Return the choices in which findings that fewer than half of the folds chose have the votes of their equals.

    An equal of a name of its own that half of the folds agree on gives no vote: it comes in the finding's place.
    """
    by_finding = [dict(choice) for choice in choices.effects_by_finding]
    for finding, effect in _findings(search_result):
        strangers = [
            () if choices.matching(effect, fold) else tuple(_strangers(search_result, choices.all_effects[fold]))
            for fold in range(choices.folds)
        ]
        count = choices.count(effect)
        if 2 * count >= choices.folds or 2 * (count + sum(map(bool, strangers))) < choices.folds:
            continue
        equals = _equals(search_result, finding, effect, data, {(e.name, e.joints) for fold in strangers for e in fold})
        equals = [equal for equal in equals if not _comes_instead(equal, choices, search_result)]
        for votes, others in zip(by_finding, strangers, strict=True):
            if instead := tuple(e for e in others if any(_is_like(e, equal, search_result) for equal in equals)):
                votes[effect.key()] = instead
    return dataclasses.replace(choices, effects_by_finding=tuple(by_finding))


def _findings(search_result: SearchResult) -> Iterator[tuple[Chosen, Effect]]:
    """Yield the findings that a selection chose, each as it was chosen and as it was fitted."""
    chosen = {finding.candidate.effect.search_key(): finding for finding in search_result.selection.chosen}
    for effect in search_result.effects:
        if effect.search_key() in chosen:
            yield chosen[effect.search_key()], effect


def _strangers(search_result: SearchResult, effects: Collection[Effect]) -> Iterator[Effect]:
    """Yield the effects of a fold that the search lacks in this form."""
    keys = {effect.search_key() for effect in search_result.effects}
    yield from sorted((effect for effect in effects if effect.search_key() not in keys), key=str)


def _equals(
    search_result: SearchResult,
    finding: Chosen,
    effect: Effect,
    data: Measurements,
    among: Collection[tuple[str, tuple[str, ...]]],
) -> list[Effect]:
    """Return the alternatives of a finding on all poses that are of the names and joints ``among``."""
    is_small = search_result.final.theta.size <= MOST_TO_REFIT
    refitted = lag_refitted(search_result, finding, effect, data) if is_small else None
    alternatives = rivals(search_result.selection, finding, refitted, among)[1]
    return [rival_effect(other.effect, other.joints, other.settings) for other in alternatives]


def _comes_instead(equal: Effect, choices: FoldChoices, search_result: SearchResult) -> bool:
    """Return whether half of the folds have an alternative that is no form of a finding."""
    if any(finding.is_same_finding(equal) for finding in search_result.effects):
        return False
    return 2 * sum(any(map(equal.is_same_finding, effects)) for effects in choices.all_effects) >= choices.folds


def _is_like(effect: Effect, equal: Effect, search_result: SearchResult) -> bool:
    """Return whether a fold's effect is an alternative, in the same form if the form alone is not that of a finding."""
    if any(finding.is_same_finding(effect) for finding in search_result.effects):
        return effect.search_key() == equal.search_key()
    return equal.is_same_finding(effect)
