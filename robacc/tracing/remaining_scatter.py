"""Scatter of the joints in the fits of a search, and what remains of it where findings are withdrawn.

Scatter is estimated with the findings. The baseline lacks them, so its errors are not scatter alone. Where they
contradict it (:mod:`robacc.fitting.scatter_check`), the baseline is fitted with equal weights, as a calibration is.

A finding may have explained scatter by chance. Where it is withdrawn, the scatter is estimated again, and the remaining
findings are tested again with it.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.fitting.fit_repeatability import settle_scatter, with_scatter
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.repeatability import MANY_COEFFICIENTS, Components
from robacc.fitting.scatter_check import contradicts_scatter
from robacc.measurements import Measurements
from robacc.tracing.candidate_pool import CandidatePools
from robacc.tracing.linearised_candidates import linearise
from robacc.tracing.loop import SearchResult
from robacc.tracing.refitting import frames_of, refit


def with_scatter_in_fits(result: SearchResult, data: Measurements) -> SearchResult:
    """Return a search with fits weighted by the joints' scatter; a baseline that contradicts it has equal weights.

    Profiles of joints are chosen without scatter, which would take their place, and fitted with the remaining scatter.
    """
    components = result.components
    if components is None:
        return result
    options = result.options if result.options.scatter is not None else with_scatter(result.options, components)
    final = result.final if result.final.scatter is not None else _refitted(result.final, data, options)
    declared = _baseline(result.declared, data, options, components)
    if result.effects:
        return dataclasses.replace(result, declared=declared, final=final, options=options)
    if declared.scatter is None:
        return _without_scatter(result, declared, data)
    return result


def _baseline(like: Fit, data: Measurements, options: Options, components: Components) -> Fit:
    """Return the baseline weighted by the joints' scatter, or with equal weights if its errors contradict it."""
    plain = _refitted(like, data, _unweighted(options))
    weighted = _refitted(like, data, options)
    return plain if contradicts_scatter(plain, weighted, components, data) else weighted


def _unweighted(options: Options) -> Options:
    """Return the options of a fit with equal weights."""
    return dataclasses.replace(options, scatter=None, misfit=None)


def _refitted(fitted: Fit, data: Measurements, options: Options) -> Fit:
    return refit(fitted, fitted.model.free, data, options)


def with_remaining_scatter(before: SearchResult, after: SearchResult, data: Measurements) -> SearchResult:
    """Return a search with the joints' scatter estimated together with its findings, if some were withdrawn.

    Args:
        before: The search with all its findings.
        after: The same without those that were withdrawn.
        data: Poses of the search.
    """
    if after.effects == before.effects or after.final.theta.size > MANY_COEFFICIENTS:
        return after
    options, components, final = settle_scatter(
        after.final, data, after.options, lambda options: _refitted(after.final, data, options)
    )
    if components is None:
        return after
    declared = _baseline(after.declared, data, options, components)
    effects = after.effects
    if not effects and declared.scatter is None:
        return _without_scatter(dataclasses.replace(after, components=components), declared, data)
    if not effects:
        final = declared
    model_effects, rows = declared.model.free, np.ones(data.n, dtype=bool)
    pools = CandidatePools(data)
    candidates = linearise(final, pools.of(final.model.arm, (*model_effects, *frames_of(effects))))
    selection = candidates.selection(rows, [effect for effect in effects if not effect.is_frame])
    selection.prune()
    keys = {choice.candidate.effect.search_key() for choice in selection.chosen}
    kept = tuple(effect for effect in effects if effect.is_frame or effect.search_key() in keys)
    result = dataclasses.replace(
        after,
        declared=declared,
        final=final,
        candidates=linearise(declared, pools.of(declared.model.arm, model_effects)),
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


def _without_scatter(after: SearchResult, declared: Fit, data: Measurements) -> SearchResult:
    """Return a search without findings whose baseline ``declared`` is fitted with equal weights.

    What remains is an error that no candidate explains, not scatter: weights by it would only hide it.
    """
    candidates = linearise(declared, CandidatePools(data).of(declared.model.arm, declared.model.free))
    return dataclasses.replace(
        after,
        declared=declared,
        final=declared,
        candidates=candidates,
        final_candidates=candidates,
        selection=candidates.selection(np.ones(data.n, dtype=bool)),
        options=_unweighted(after.options),
    )
