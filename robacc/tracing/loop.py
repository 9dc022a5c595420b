"""The loop: fit what is declared, linearise, choose, refit everything together, and again until nothing changes."""

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
"""Times at most that everything is fitted together and chosen again."""
_BETTER = 10.0
"""Nats by which an explanation with a correction in it must beat the named one (odds of 20,000 to 1)."""
_SCATTER_ROUNDS = 3
"""Times at most that the scatter of the joints is estimated."""
_MANY = 3
"""Named findings from which a correction is tried in place of them though they leave no structure."""
SEARCH = Options(tolerance=1e-4, settled=1e-2)
"""Fits that a choice is made on; those that are reported converge further."""


def choose(
    scene: LinearisedCandidates,
    rows: NDArray[np.bool_],
    start: Sequence[Effect] = (),
    empirical: bool = True,
    most: int = SELECTION_POSES,
) -> Selection:
    """Named effects first; where they leave structure, or take many to explain it, a correction may do better."""
    named = scene.selection(rows, start, most)
    named.prune()
    blocks = scene.batches(rows, most) if empirical else []
    named.field.blocks = blocks
    if any(one.candidate.is_correction for one in named.chosen):
        named.run(with_blocks=True)
        return named
    named.run()
    if not blocks:
        return named
    left = named.rank(with_blocks=True)
    structured = bool(left) and left[0].p_value <= FALSE_ALARM
    if not structured and len(named.chosen) < _MANY:
        return named
    mixed = scene.selection(rows, (), most)
    mixed.field.blocks = blocks
    mixed.run(with_blocks=True)
    if structured:
        named.run(with_blocks=True)
    return mixed if mixed.total() > named.total() + (0.0 if structured else _BETTER) else named


@dataclass(frozen=True)
class SearchResult:
    """What the loop found on one set of poses."""

    declared: Fit
    final: Fit
    effects: tuple[Effect, ...]
    steps: tuple[SelectionStep, ...]
    scene: LinearisedCandidates
    selection: Selection
    options: Options
    """With the scatter of the joints, where the data show it."""
    components: Components | None = None
    """Scatter of the joints, where it is significant."""


def search(
    model: Model,
    data: Measurements,
    options: Options = SEARCH,
    only: Sequence[str] | None = None,
    empirical: bool = True,
) -> SearchResult:
    """Fit, choose, refit, until the choice stands; then once more with the scatter of the joints that is left.

    Scatter that rows of a visit share is no effect, but chance makes effects fit it. It is estimated beside the effects
    that were chosen, so that a real effect does not pass for scatter, and each finding is judged anew beside it.
    """
    baseline = fit(model, data, options)
    everything = np.ones(data.n, dtype=bool)
    first = scene = linearise(baseline, data, model.free, only)
    selection = choose(scene, everything, empirical=empirical)
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
        # A frame that was found is registered anew by every fit, so it does not compete again.
        frames = tuple(effect for effect in effects if effect.is_frame)
        others = tuple(effect for effect in effects if not effect.is_frame)
        present = refit(present, (*baseline.model.free, *frames, *others), data, options)
        scene = linearise(present, data, (*model.free, *frames), only)
        selection = choose(scene, everything, others, empirical)
        steps.extend(selection.steps)
    return SearchResult(baseline, present, effects, tuple(steps), first, selection, options, components)


def refit(like: Fit, free: Sequence[Effect], data: Measurements, options: Options) -> Fit:
    """Fit a model with the effects ``free`` from where a similar fit ended, base and tool registered as they are there.

    What the other fit does not have starts at zero. The first step is always taken, so the poses of ``data`` decide.
    """
    model = dataclasses.replace(like.model, free=tuple(free))
    ended = {
        (like.model.free[owner].key(), name): value
        for owner, name, value in zip(like.owners, like.names, like.theta.tolist(), strict=True)
    }
    # A term's name does not depend on the poses, so one is enough to list them.
    one = data.subset(np.arange(1))
    start = [ended.get((effect.key(), term.name), 0.0) for effect in free for term in effect.terms(model.arm, one)]
    # Rows that are no part of the rest were found out once; where they are the same rows they start left out.
    inliers = like.inliers if options.robust and like.inliers.size == data.n else None
    begin = dataclasses.replace(
        options,
        start=np.array(start),
        inliers=inliers,
        group_stds=like.group_stds,
        prior_stds=like.prior_stds,
    )
    return fit(model, data, begin)


def frames_first(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Frames first, so that they keep their parameters where poses cannot tell two apart."""
    return tuple(sorted(effects, key=lambda effect: not effect.is_frame))
