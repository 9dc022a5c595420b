"""Findings that held-out poses confirm: those that recur in the folds and lower the error of held-out poses."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from robacc.diagnostics.moved_frames import HeldOutFrames
from robacc.effects.base import Effect
from robacc.errors import RobaccError
from robacc.fitting.cross_validation import HoldOut
from robacc.fitting.fit_result import Fit
from robacc.fitting.places import places
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import residuals
from robacc.tracing.cross_validation import CrossValidation, FoldChoices, cross_validate
from robacc.tracing.findings import mean_inflation
from robacc.tracing.held_out_gain import bounded, gain_score
from robacc.tracing.loop import SearchResult
from robacc.tracing.refitting import frames_first, refit
from robacc.tracing.selection import Selection

_LEAST_GAIN = 1.0
"""Standard errors by which a gain on held-out poses must exceed zero. The search and the folds decide about chance; the
gain guards against effects that are significant and do not predict. Between 1.0 and 1.645 there was no finding in 78
campaigns without an effect (49 of a physics engine, 29 with errors that break an assumption) and none in 11 with large
effects. In 8 campaigns with an effect near its detection limit there was one, and it lowered the error of fresh poses
each time, by 23 to 56 %; so did six of six on subsets of three real arms, by 0.3 to 20 %."""
_LARGEST_OVERSHOOT = 35.0
"""How much farther than held-out poses gain by it a finding may move the poses. Causes that geometry takes up in part
move them up to 25 times as far (43 arms of a physics engine). Above, other effects cancel the finding on these poses,
as a profile does a trend over a short range, and elsewhere they would not: a compliance that moves poses 46 times as
far as they gain, fitted to a joint's range of 30 degrees, raises the error elsewhere by a fifth."""


def reproduced(search_result: SearchResult, choices: FoldChoices | None, data: Measurements) -> SearchResult:
    """Return the search without findings that recur in fewer than half of the folds.

    Such findings are accidental, or would increase the error of other poses. In their place come effects that at least
    half of the folds chose instead. Findings that are superfluous among the others go too.
    """
    effects, selection = search_result.effects, dataclasses.replace(search_result.selection, steps=[])
    if choices is not None:
        recurring = tuple(effect for effect in effects if 2 * choices.count(effect) >= choices.folds)
        if recurring != effects:
            effects = (*recurring, *_chosen_instead(search_result.effects, choices))
            start = [effect for effect in effects if not effect.is_frame]
            selection = search_result.final_candidates.selection(np.ones(data.n, dtype=bool), start)
    return _significant(search_result, effects, selection, data)


def significant_given_structure(
    search_result: SearchResult, final: Fit, inflation: Array, data: Measurements
) -> tuple[SearchResult, tuple[str, ...]]:
    """Return the search without findings that are not significant given the errors that remain, and a warning.

    Errors that poses share, or that are correlated or unequal, let effects fit them by chance.

    Args:
        search_result: The findings.
        final: Their fit.
        inflation: ``(P,)`` variance of each of its coefficients over that for independent errors.
        data: Poses of the search.
    """
    by_key = {
        effect.search_key(): mean_inflation(effect, final, inflation)
        for effect in search_result.effects
        if not effect.is_frame
    }
    selection = dataclasses.replace(search_result.selection, steps=[])
    kept = _significant(
        search_result, search_result.effects, selection, data, lambda effect: by_key[effect.search_key()]
    )
    withdrawn = [str(effect) for effect in search_result.effects if effect not in kept.effects]
    if not withdrawn:
        return search_result, ()
    reason = "it is not significant, given that the remaining errors are not independent from pose to pose"
    return kept, _withdrawn_warnings({reason: withdrawn})


def _significant(
    search_result: SearchResult,
    effects: tuple[Effect, ...],
    selection: Selection,
    data: Measurements,
    inflation: Callable[[Effect], float] = lambda effect: 1.0,
) -> SearchResult:
    """Return the search with those of ``effects`` that are significant given each other, fitted together.

    ``selection`` holds ``effects`` but for frames, which are not tested. ``inflation`` is as in
    :meth:`Selection.prune`.
    """
    selection.chosen = list(selection.chosen)
    selection.prune(inflation)
    keys = {choice.candidate.effect.search_key() for choice in selection.chosen}
    effects = tuple(effect for effect in effects if effect.is_frame or effect.search_key() in keys)
    if effects == search_result.effects:
        return search_result
    steps = (*search_result.steps, *selection.steps)
    return _with_effects(dataclasses.replace(search_result, selection=selection, steps=steps), effects, data)


def _chosen_instead(findings: Sequence[Effect], choices: FoldChoices) -> tuple[Effect, ...]:
    """Return the effects that at least half of the folds chose and that are none of the findings."""
    count: dict[tuple[object, ...], int] = {}
    first: dict[tuple[object, ...], Effect] = {}
    for effects in choices.all_effects:
        for effect in sorted(effects, key=str):
            if not any(finding.is_same_finding(effect) for finding in findings):
                count[effect.search_key()] = count.get(effect.search_key(), 0) + 1
                first.setdefault(effect.search_key(), effect)
    return tuple(first[key] for key, folds in count.items() if 2 * folds >= choices.folds)


def with_held_out_gain(
    search_result: SearchResult,
    validation: CrossValidation | None,
    data: Measurements,
    how: HoldOut,
    frames: HeldOutFrames | None = None,
) -> tuple[SearchResult, CrossValidation | None, tuple[str, ...]]:
    """Withdraw findings without a gain on held-out poses beyond its uncertainty, and those that other findings cancel.

    The weakest goes first and the others are tested again, also for their significance without it; at the end all
    findings together must have a gain. Where the setup of the validation poses was moved, gains are judged with
    ``frames`` registered anew. Return the remaining search, its cross-validation, and warnings that list what was
    withdrawn.
    """
    no_gain: list[str] = []
    cancelled: list[str] = []
    place = places(data if how.validation is None else how.validation)
    while validation is not None and search_result.effects:
        weight = _weight_of_plausible(search_result) if how.validation is None else None
        judged = _judged(search_result.final, how, frames)
        scores = {
            effect: gain_score(judged(validation.without[effect.key()]), judged(validation.after), place, weight)
            for effect in search_result.effects
            if effect.key() in validation.without
        }
        weakest = min(scores, key=lambda effect: scores[effect], default=None)
        effects: tuple[Effect, ...] = ()
        if weakest is not None and scores[weakest] < _LEAST_GAIN:
            effects = tuple(effect for effect in search_result.effects if effect != weakest)
            no_gain.append(str(weakest))
        elif gain_score(judged(validation.before), judged(validation.after), place, weight) < _LEAST_GAIN:
            no_gain.extend(map(str, search_result.effects))
        elif how.validation is None and (most := _most_cancelled(search_result, validation, data)) is not None:
            effects = tuple(effect for effect in search_result.effects if effect != most)
            cancelled.append(str(most))
        else:
            break
        search_result = _with_effects(search_result, effects, data)
        selection = dataclasses.replace(search_result.selection, steps=[])
        search_result = _significant(search_result, effects, selection, data)
        validation = cross_validate(search_result, validation.choices, data, how, earlier=validation)
    reasons = {
        "the error of held-out poses is not lower with the effect than without": no_gain,
        "other effects cancel it on these poses, and need not elsewhere": cancelled,
    }
    return search_result, validation, _withdrawn_warnings(reasons)


def _judged(final: Fit, how: HoldOut, frames: HeldOutFrames | None) -> Callable[[Array], Array]:
    """Return the function that makes held-out residuals comparable: registered anew, or with outliers bounded."""
    if frames is not None:
        return frames.residual
    if how.validation is not None:
        return lambda residual: residual
    return lambda residual: bounded(residual, final)


def _weight_of_plausible(search_result: SearchResult) -> Array:
    """Return ``(M, N)`` the final fit's weights, zero for rows that are outliers with the findings and without.

    One row that is metres off would outweigh the gain of all others.
    """
    final = search_result.final
    return np.asarray(final.weight * (final.inliers | search_result.declared.inliers), dtype=np.float64)


def _most_cancelled(search_result: SearchResult, validation: CrossValidation, data: Measurements) -> Effect | None:
    """Return the finding that others cancel most, if it moves poses much farther than held-out poses gain by it."""
    overshoots = {
        effect: _overshoot(search_result.final, effect, validation, data)
        for effect in search_result.effects
        if effect.key() in validation.without and not effect.is_frame
    }
    worst = max(overshoots, key=lambda effect: overshoots[effect], default=None)
    return worst if worst is not None and overshoots[worst] > _LARGEST_OVERSHOOT else None


def _overshoot(final: Fit, effect: Effect, validation: CrossValidation, data: Measurements) -> float:
    """Return how far an effect moves the poses over what held-out poses gain by it, both weighted by the noise.

    The gain counts up to the error of the baseline: two effects that cancel each other make it large for both. The
    result is 0 if the arm cannot be evaluated without the effect.
    """
    number = next(i for i, free in enumerate(final.model.free) if free.key() == effect.key())
    theta = np.where(np.array(final.owners) == number, 0.0, final.theta)
    try:
        moved = residuals(data, final.model.bind(data).poses(theta)) - final.residual
    except RobaccError:
        return 0.0
    weight = np.square(final.weight * final.inliers)
    without = validation.without[effect.key()]
    gain = float(np.sum((np.square(without) - np.square(validation.after)) * weight))
    gain = min(gain, float(np.sum(np.square(validation.before) * weight)))
    moved_squares = float(np.sum(np.square(moved) * weight))
    return math.sqrt(moved_squares / gain) if gain > 0.0 else 0.0


def _with_effects(search_result: SearchResult, effects: tuple[Effect, ...], data: Measurements) -> SearchResult:
    """Return the search with only ``effects`` of its findings, fitted together."""
    keys = {effect.search_key() for effect in effects}
    chosen = [choice for choice in search_result.selection.chosen if choice.candidate.effect.search_key() in keys]
    selection = dataclasses.replace(search_result.selection, chosen=chosen, steps=[])
    free = (*search_result.declared.model.free, *frames_first(effects))
    final = refit(search_result.final, free, data, search_result.options) if effects else search_result.declared
    return dataclasses.replace(search_result, effects=effects, final=final, selection=selection)


def _withdrawn_warnings(reasons: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return a warning for each reason that lists the findings withdrawn for it."""
    return tuple(
        f"withdrawn, because {reason}: {', '.join(dict.fromkeys(names))}" for reason, names in reasons.items() if names
    )
