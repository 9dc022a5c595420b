"""The search: fit the declared effects, linearise, select, fit everything together, until nothing changes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.fitting.fit_repeatability import SIGNIFICANT, components_of, is_same, with_scatter
from robacc.fitting.repeatability import Components
from robacc.fitting.solver import Fit, Options, fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.tracing.linearised_candidates import SELECTION_POSES, LinearisedCandidates, linearise
from robacc.tracing.selection import FALSE_ALARM, Selection, SelectionStep

_ROUNDS = 4
"""Largest number of rounds of a joint fit and a selection."""
_BETTER = 10.0
"""Evidence (log Bayes factor) by which a selection with a correction must beat the named one (odds of 20,000 to 1)."""
_SCATTER_ROUNDS = 3
"""Largest number of estimates of the scatter of the joints."""
_MANY = 3
"""Named findings from which a correction is tried in place of them even if they leave no structure."""
SEARCH = Options(tolerance=1e-4, settled=1e-2)
"""Options of the fits that a selection is made on; reported fits converge further."""


def choose(
    candidates: LinearisedCandidates,
    rows: NDArray[np.bool_],
    start: Sequence[Effect] = (),
    empirical: bool = True,
    max_poses: int = SELECTION_POSES,
) -> Selection:
    """Select named effects first; if they leave structure or are many, select corrections too and return the better."""
    named = candidates.selection(rows, start, max_poses)
    named.prune()
    blocks = candidates.batches(rows, max_poses) if empirical else []
    named.scorer.blocks = blocks
    if any(choice.candidate.is_correction for choice in named.chosen):
        named.run(with_blocks=True)
        return named
    named.run()
    if not blocks:
        return named
    remaining = named.rank(with_blocks=True)
    structured = bool(remaining) and remaining[0].p_value <= FALSE_ALARM
    if not structured and len(named.chosen) < _MANY:
        return named
    mixed = candidates.selection(rows, (), max_poses)
    mixed.scorer.blocks = blocks
    mixed.run(with_blocks=True)
    if structured:
        named.run(with_blocks=True)
    return mixed if mixed.total() > named.total() + (0.0 if structured else _BETTER) else named


@dataclass(frozen=True)
class SearchResult:
    """Result of the search on one set of poses."""

    declared: Fit
    final: Fit
    effects: tuple[Effect, ...]
    steps: tuple[SelectionStep, ...]
    candidates: LinearisedCandidates
    selection: Selection
    options: Options
    """Fit options, with the scatter of the joints if it is significant."""
    components: Components | None = None
    """Scatter of the joints, where it is significant."""


def search(
    model: Model,
    data: Measurements,
    options: Options = SEARCH,
    only: Sequence[str] | None = None,
    empirical: bool = True,
) -> SearchResult:
    """Fit, select and refit until the selection is stable; then repeat with the remaining scatter of the joints.

    Scatter that rows of a visit share is no effect, but by chance effects fit it. It is estimated beside the chosen
    effects, so that a real effect does not pass for scatter, and each finding is tested again beside it.
    """
    baseline = fit(model, data, options)
    all_rows = np.ones(data.n, dtype=bool)
    first = candidates = linearise(baseline, data, model.free, only)
    selection = choose(candidates, all_rows, empirical=empirical)
    steps = list(selection.steps)
    present: Fit = baseline
    effects: tuple[Effect, ...] = ()
    frames: tuple[Effect, ...] = ()
    components: Components | None = None
    rounds = scatter_rounds = 0
    while rounds < _ROUNDS:
        rounds += 1
        chosen = frames + tuple(selection.refined(choice) for choice in selection.chosen)
        if [effect.search_key() for effect in chosen] == [effect.search_key() for effect in effects]:
            if scatter_rounds == _SCATTER_ROUNDS or (new := components_of(present, data)) is None:
                break
            if new.gain <= SIGNIFICANT:
                break
            components = new
            if is_same(options, components):
                break
            scatter_rounds, rounds = scatter_rounds + 1, min(rounds, _ROUNDS - 2)
            options = with_scatter(options, components)
            baseline = refit(baseline, baseline.model.free, data, options)
            first = linearise(baseline, data, model.free, only)
        effects = chosen
        # Every fit registers an identified frame anew, so it is no candidate again.
        frames = tuple(effect for effect in effects if effect.is_frame)
        others = tuple(effect for effect in effects if not effect.is_frame)
        present = refit(present, (*baseline.model.free, *frames, *others), data, options)
        candidates = linearise(present, data, (*model.free, *frames), only)
        selection = choose(candidates, all_rows, others, empirical)
        steps.extend(selection.steps)
    return SearchResult(baseline, present, effects, tuple(steps), first, selection, options, components)


def refit(like: Fit, free: Sequence[Effect], data: Measurements, options: Options) -> Fit:
    """Fit a model with the effects ``free``, starting at a similar fit and with that fit's registered base and tool.

    Coefficients that the similar fit lacks start at zero. The first step is always taken, so the poses of ``data``
    decide.
    """
    model = dataclasses.replace(like.model, free=tuple(free))
    previous = {
        (like.model.free[owner].key(), name): value
        for owner, name, value in zip(like.owners, like.names, like.theta.tolist(), strict=True)
    }
    # A term's name does not depend on the poses, so the first row is enough to list them.
    first_row = data.subset(np.arange(1))
    start = [
        previous.get((effect.key(), term.name), 0.0) for effect in free for term in effect.terms(model.arm, first_row)
    ]
    # Outliers are known from the similar fit; on the same rows they start left out.
    inliers = like.inliers if options.robust and like.inliers.size == data.n else None
    warm_start = dataclasses.replace(
        options,
        start=np.array(start),
        inliers=inliers,
        group_stds=like.group_stds,
        prior_stds=like.prior_stds,
    )
    return fit(model, data, warm_start)


def frames_first(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects with frames first, so that frames keep their parameters if poses cannot distinguish two."""
    return tuple(sorted(effects, key=lambda effect: not effect.is_frame))
