"""The whole search run again without each fold, so that every pose gets an honest error.

Folds are independent of each other; where there are many poses they are shared between two processes.
"""

from __future__ import annotations

import dataclasses
import functools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.errors import EquilibriumError, InputError
from robacc.fitting.cross_validation import folds, held_out, parts
from robacc.fitting.deflection_model import choose_deflection, choose_form, with_deflection
from robacc.fitting.solver import Fit, Options
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.observation import residuals
from robacc.tracing.candidate_scorer import Chosen
from robacc.tracing.loop import SEARCH, SearchResult, choose, frames_first, refit
from robacc.tracing.rivals import rivals
from robacc.tracing.selection import Selection

Progress = Callable[[str, int, int], None]

_FOLD_POSES = 400
"""Poses that the choice within a fold looks at, at most."""
LEAST_GAIN = 1.645
"""Standard errors that a gain on held-out poses must be above zero: positive at 95 % confidence."""
_SHARED_FROM = 600
"""Poses from which a second process is worth its start."""


@dataclass(frozen=True)
class CrossValidation:
    """Held-out residuals ``(M, N)`` of every row, and of each finding's absence, with how often each was chosen."""

    before: Array
    after: Array
    without: dict[tuple[object, ...], Array]
    """By the finding's key; of those without which the rest can be fitted."""
    chosen: dict[tuple[object, ...], int]
    """By the finding's key."""
    folds: int
    found: tuple[dict[tuple[object, ...], tuple[Effect, ...]], ...] = ()
    """For each fold, by the finding's key, what it has of it."""
    taken: tuple[frozenset[Effect], ...] = ()
    """For each fold everything that it chose."""


@dataclass(frozen=True)
class _Fold:
    """Residuals ``(M, n)`` of the rows that one fold held out."""

    before: Array
    after: Array
    without: tuple[Array | None, ...]
    """For each finding of the whole loop, in its order; None where the rest cannot be fitted without it."""
    found: tuple[tuple[Effect, ...], ...]
    """What the fold has of each: nothing where it did not choose it too."""
    taken: frozenset[Effect]
    """Everything that it chose."""


@dataclass(frozen=True)
class _Work:
    """What a fold needs, the same for all."""

    loop: SearchResult
    data: Measurements
    assigned: NDArray[np.int64]
    empirical: bool


def cross_validate(
    loop: SearchResult,
    data: Measurements,
    holdout: Measurements | None,
    n_folds: int,
    seed: int,
    empirical: bool,
    progress: Progress,
) -> CrossValidation | None:
    """Held-out residuals by cross-fitting, or of poses of their own; None where there are too few poses."""
    if holdout is not None:
        return _on(loop, data, holdout)
    assigned = folds(data, n_folds, seed)
    if assigned is None:
        return None
    masks = [rest for _, rest in parts(assigned)]
    try:
        work = functools.partial(_fold, _Work(loop, data, assigned, empirical))
        done = _shared_out(work, range(len(masks)), data.n)
        results = [_reported(one, number, len(masks), progress) for number, one in enumerate(done)]
    except InputError:
        # What is left to learn from without a fold is too little for what is fitted.
        return None
    return _joined(loop.effects, masks, results, loop.final.residual.shape)


def _joined(
    effects: Sequence[Effect], masks: Sequence[NDArray[np.bool_]], results: Sequence[_Fold], shape: tuple[int, ...]
) -> CrossValidation:
    """The folds' rows put together."""
    before, after = np.empty(shape), np.empty(shape)
    without = {effect.key(): np.empty(shape) for effect in effects}
    for rest, one in zip(masks, results, strict=True):
        before[:, rest], after[:, rest] = one.before, one.after
        for effect, lacking in zip(effects, one.without, strict=True):
            if lacking is None:
                without.pop(effect.key(), None)
            elif effect.key() in without:
                without[effect.key()][:, rest] = lacking
    found = tuple({e.key(): ones for e, ones in zip(effects, one.found, strict=True)} for one in results)
    chosen = {effect.key(): sum(bool(one[effect.key()]) for one in found) for effect in effects}
    return CrossValidation(before, after, without, chosen, len(masks), found, tuple(one.taken for one in results))


def reduced(
    held: CrossValidation | None,
    whole: SearchResult,
    left: SearchResult,
    data: Measurements,
    holdout: Measurements | None,
    n_folds: int,
    seed: int,
) -> CrossValidation | None:
    """``held`` of the loop that is left of ``whole`` once findings were taken back.

    A fold then keeps of its own choice what stands for a finding that is left: what is told of poses held out is of the
    model that is told. Where nothing is left, that is what was declared.
    """
    if held is None or (left.effects and left.effects == whole.effects):
        return held
    if not left.effects:
        return dataclasses.replace(held, after=held.before, without={})
    if holdout is not None:
        return _on(left, data, holdout)
    assigned = folds(data, n_folds, seed)
    assert assigned is not None  # or nothing was held out
    masks = [rest for _, rest in parts(assigned)]

    def again(number: int) -> _Fold:
        rest, found = masks[number], [held.found[number][effect.key()] for effect in left.effects]
        effects = frames_first(dict.fromkeys(effect for ones in found for effect in ones))
        before = held.before[:, rest]
        if frozenset(effects) == held.taken[number]:
            without = (held.without.get(effect.key()) for effect in left.effects)
            lacking = tuple(None if one is None else one[:, rest] for one in without)
            return _Fold(before, held.after[:, rest], lacking, tuple(found), held.taken[number])
        if not effects:
            return _Fold(before, before, tuple(before for _ in found), tuple(found), frozenset())
        train, test = _parts(left, data, assigned, number)
        return _judged(_completed(left, effects, train), effects, before, found, test)

    results = list(_shared_out(again, range(len(masks)), data.n))
    return _joined(left.effects, masks, results, held.before.shape)


def gain_score(without: Array, after: Array, data: Measurements, weight: Array | None = None) -> float:
    """Return the mean gain of held-out poses over its standard error: squared residuals without less those with.

    Poses are independent, not rows. ``weight`` ``(M, N)`` are reciprocal standard deviations of the components; where
    None, positions alone are judged, each as good as the others.
    """
    if weight is None:
        without, after, weight = without[:3], after[:3], np.ones_like(after[:3])
    gain = np.sum((np.square(without) - np.square(after)) * np.square(weight), axis=0)
    sums = np.bincount(np.unique(data.groups(), return_inverse=True)[1], weights=gain)
    if sums.size < 2:
        return 0.0
    error = float(np.std(sums, ddof=1)) / np.sqrt(sums.size)
    mean = float(np.mean(sums))
    if error == 0.0:
        return np.inf if mean > 0 else 0.0
    return float(mean / error)


def _reported(one: _Fold, number: int, count: int, progress: Progress) -> _Fold:
    progress("cross-fitting", number + 1, count + 1)
    return one


_shared: Callable[[int], _Fold] | None = None
"""The work of a pool's processes, which they inherit by fork: nothing of it is copied or pickled."""


def _shared_out(work: Callable[[int], _Fold], numbers: Sequence[int], n: int) -> Iterator[_Fold]:
    """The work of each fold in turn, shared by two processes where there are many poses."""
    alone = "fork" not in multiprocessing.get_all_start_methods() or (os.cpu_count() or 1) < 2
    if alone or n < _SHARED_FROM:
        yield from map(work, numbers)
        return
    global _shared
    _shared = work
    try:
        with multiprocessing.get_context("fork").Pool(2, initializer=_as_helper) as pool:
            yield from pool.imap(_shared_fold, numbers)
    finally:
        _shared = None


def _as_helper() -> None:
    """Leave signals to the process that started this one, which ends it; what it inherited would answer them twice."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _shared_fold(number: int) -> _Fold:
    assert _shared is not None
    return _shared(number)


def _fold(work: _Work, number: int) -> _Fold:
    loop, data = work.loop, work.data
    train, test = _parts(loop, data, work.assigned, number)
    selection = choose(loop.scene, work.assigned != number, empirical=work.empirical, most=_FOLD_POSES)
    chosen = [(one, selection.refined(one)) for one in selection.chosen]
    effects = frames_first(effect for _, effect in chosen)
    like = loop.declared
    declared = refit(like, like.model.free, train, _options(like))
    declared, _ = choose_form(declared, like.model, train, _options(like))
    complete = _completed(loop, effects, train) if effects else declared
    return _judged(complete, effects, held_out(declared, test), _again(loop.effects, selection, chosen), test)


def _parts(
    loop: SearchResult, data: Measurements, assigned: NDArray[np.int64], number: int
) -> tuple[Measurements, Measurements]:
    """What a fold learns from, without outliers, and what it is judged on."""
    learn = (assigned != number) & loop.final.inliers
    return data.subset(np.flatnonzero(learn)), data.subset(np.flatnonzero(assigned == number))


def _completed(loop: SearchResult, effects: Sequence[Effect], train: Measurements) -> Fit:
    """What is declared and ``effects``, fitted to a fold's poses."""
    model = loop.declared.model.with_free(*effects)
    complete = refit(loop.final, model.free, train, _options(loop.final))
    return complete if complete.group_stds else choose_form(complete, model, train, _options(loop.final))[0]


def _judged(
    complete: Fit, effects: Sequence[Effect], before: Array, again: Sequence[Sequence[Effect]], test: Measurements
) -> _Fold:
    after = held_out(complete, test)
    without = tuple(_lacking(complete, ones, test) if ones else after for ones in again)
    return _Fold(before, after, without, tuple(tuple(ones) for ones in again), frozenset(effects))


def _again(
    findings: Sequence[Effect], selection: Selection, chosen: Sequence[tuple[Chosen, Effect]]
) -> list[list[Effect]]:
    """For each finding what a fold has of it: itself, or what these poses cannot tell from it."""
    found = [[effect for _, effect in chosen if finding.is_same_finding(effect)] for finding in findings]
    if all(found):
        return found
    others = [{(other.effect, other.joints) for other in rivals(selection, one)[1]} for one, _ in chosen]
    return [
        same or [effect for (_, effect), names in zip(chosen, others, strict=True) if (f.name, f.joints) in names]
        for f, same in zip(findings, found, strict=True)
    ]


def _options(found: Fit) -> Options:
    """A fold weighs rows as the whole did, and its outliers are already left out."""
    return dataclasses.replace(SEARCH, robust=False, misfit=found.misfit, scatter=found.scatter)


def _on(loop: SearchResult, data: Measurements, holdout: Measurements) -> CrossValidation:
    """Poses of their own: the models of all the other poses, as they stand."""
    declared = choose_deflection(loop.declared, loop.declared.model, data, SEARCH)[0]
    final = loop.final if loop.final.group_stds else choose_deflection(loop.final, loop.final.model, data, SEARCH)[0]
    lacking = {effect.key(): _lacking(final, [effect], holdout) for effect in loop.effects}
    without = {key: one for key, one in lacking.items() if one is not None}
    return CrossValidation(held_out(declared, holdout), held_out(final, holdout), without, {}, 0)


def _lacking(complete: Fit, absent: Sequence[Effect], test: Measurements) -> Array | None:
    """Residuals of ``test`` where the effects ``absent`` are not in the model and the rest is fitted without them.

    To first order, which a frame does not allow: it is registered over metres and any angle. None for such, and where
    the rest then asks for compliances that have no equilibrium.
    """
    if any(effect.is_frame for effect in absent):
        return None
    numbers = {i for i, effect in enumerate(with_deflection(complete.model.free, "equilibrium")) if effect in absent}
    try:
        return residuals(test, complete.model.bind(test).poses(complete.without(numbers)))
    except EquilibriumError:
        return None
