"""Scatter of the joints that remains where findings of a search are withdrawn.

A finding may have explained scatter by chance. Without it, the scatter is estimated anew, and the findings that remain
are tested again beside it. Where no finding remains and the scatter is contradicted
(:mod:`robacc.fitting.scatter_check`), the baseline is fitted without it.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.fitting.fit_repeatability import settle_scatter
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.repeatability import MANY_COEFFICIENTS
from robacc.fitting.scatter_check import contradicts_scatter
from robacc.measurements import Measurements
from robacc.tracing.linearised_candidates import linearise
from robacc.tracing.loop import SearchResult
from robacc.tracing.refitting import frames_of, refit


def with_remaining_scatter(before: SearchResult, after: SearchResult, data: Measurements) -> SearchResult:
    """Return a search with the joints' scatter estimated beside its findings, if some were withdrawn.

    Args:
        before: The search with all its findings.
        after: The same without those that were withdrawn.
        data: Poses of the search.
    """
    if after.effects == before.effects or after.final.theta.size > MANY_COEFFICIENTS:
        return after

    def refitted(fitted: Fit, options: Options) -> Fit:
        return refit(fitted, fitted.model.free, data, options)

    options, components = settle_scatter(
        after.final, data, after.options, lambda options: refitted(after.final, options)
    )
    if components is None:
        return after
    declared = refitted(after.declared, options)
    effects = after.effects
    if not effects:
        plain = dataclasses.replace(after.options, scatter=None, misfit=None)
        unweighted = refitted(after.declared, plain)
        if contradicts_scatter(unweighted, declared, components, data):
            # What remains is an error that no candidate explains, not scatter: weights by it would only hide it.
            return _without_scatter(after, unweighted, plain, data)
    final = refitted(after.final, options) if effects else declared
    model_effects, rows = declared.model.free, np.ones(data.n, dtype=bool)
    candidates = linearise(final, data, (*model_effects, *frames_of(effects)))
    selection = candidates.selection(rows, [effect for effect in effects if not effect.is_frame])
    selection.prune()
    keys = {choice.candidate.effect.search_key() for choice in selection.chosen}
    kept = tuple(effect for effect in effects if effect.is_frame or effect.search_key() in keys)
    result = dataclasses.replace(
        after,
        declared=declared,
        final=final,
        candidates=linearise(declared, data, model_effects),
        final_candidates=candidates,
        selection=selection,
        options=options,
        components=components,
    )
    if kept == effects:
        return result
    # With a finding less, more scatter remains.
    free = (*model_effects, *(e for e in kept if e.is_frame), *(e for e in kept if not e.is_frame))
    lacking = refit(final, free, data, options) if kept else declared
    return with_remaining_scatter(result, dataclasses.replace(result, effects=kept, final=lacking), data)


def _without_scatter(after: SearchResult, declared: Fit, options: Options, data: Measurements) -> SearchResult:
    """Return a search without findings whose baseline ``declared`` is fitted with equal weights."""
    candidates = linearise(declared, data, declared.model.free)
    return dataclasses.replace(
        after,
        declared=declared,
        final=declared,
        candidates=candidates,
        final_candidates=candidates,
        selection=candidates.selection(np.ones(data.n, dtype=bool)),
        options=options,
        components=None,
    )
