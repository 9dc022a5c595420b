"""Cross-validation of the complete search: it is repeated without each fold, so that every row has a held-out residual.

Folds are independent of each other. With many poses, two processes share them.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.errors import InputError
from robacc.fitting.cross_validation import folds, held_out, parts
from robacc.fitting.deflection_model import choose_deflection, choose_form
from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.parallel import fork_map
from robacc.tracing.loop import SearchResult, choose
from robacc.tracing.ranking import Chosen
from robacc.tracing.refitting import SEARCH, frames_first, refit
from robacc.tracing.rivals import rivals
from robacc.tracing.selection import Selection
from robacc.tracing.without_finding import ReducedFits, fold_options

Progress = Callable[[str, int, int], None]

_FOLD_POSES = 400
"""Largest number of poses that a fold's selection uses."""
_PARALLEL_POSES = 600
"""Poses from which a second process is worth its start."""


@dataclass(frozen=True)
class CrossValidation:
    """Held-out residuals ``(M, N)`` of every row, with and without each finding, and the stability of the findings."""

    before: Array
    after: Array
    without: dict[tuple[object, ...], Array]
    """Residuals without each finding, by its key; only findings without which the model can be fitted."""
    chosen: dict[tuple[object, ...], int]
    """Number of folds in which each finding recurs, by its key."""
    folds: int
    effects_by_finding: tuple[dict[tuple[object, ...], tuple[Effect, ...]], ...] = ()
    """For each fold, the fold's effects that match a finding, by the finding's key."""
    all_effects: tuple[frozenset[Effect], ...] = ()
    """For each fold, all effects that it chose."""


@dataclass(frozen=True)
class _Fold:
    """Held-out residuals ``(M, n)`` of the rows of a fold."""

    before: Array
    after: Array
    without: tuple[Array | None, ...]
    """Residuals without each finding of the search, in its order; None if the model cannot be fitted without it."""
    effects_by_finding: tuple[tuple[Effect, ...], ...]
    """The fold's effects that match each finding; empty if it did not find it."""
    all_effects: frozenset[Effect]
    """All effects that the fold chose."""


@dataclass(frozen=True)
class _Work:
    """Input that all folds share."""

    search_result: SearchResult
    data: Measurements
    assigned: NDArray[np.int64]
    empirical: bool


def cross_validate(
    search_result: SearchResult,
    data: Measurements,
    holdout: Measurements | None,
    n_folds: int,
    seed: int,
    empirical: bool,
    progress: Progress,
) -> CrossValidation | None:
    """Return held-out residuals by cross-validation, or of ``holdout``; None if there are too few poses."""
    if holdout is not None:
        return _from_holdout(search_result, data, holdout)
    assigned = folds(data, n_folds, seed)
    if assigned is None:
        return None
    masks = [test_rows for _, test_rows in parts(assigned)]
    try:
        work = functools.partial(_fold, _Work(search_result, data, assigned, empirical))
        done = _in_parallel(work, range(len(masks)), data.n)
        results = [_reported(fold, number, len(masks), progress) for number, fold in enumerate(done)]
    except InputError:
        # The rows without a fold are too few for the fitted coefficients.
        return None
    return _joined(search_result.effects, masks, results, search_result.final.residual.shape)


def _joined(
    effects: Sequence[Effect], masks: Sequence[NDArray[np.bool_]], results: Sequence[_Fold], shape: tuple[int, ...]
) -> CrossValidation:
    """Return the rows of all folds together."""
    before, after = np.empty(shape), np.empty(shape)
    without = {effect.key(): np.empty(shape) for effect in effects}
    for test_rows, fold in zip(masks, results, strict=True):
        before[:, test_rows], after[:, test_rows] = fold.before, fold.after
        for effect, lacking in zip(effects, fold.without, strict=True):
            if lacking is None:
                without.pop(effect.key(), None)
            elif effect.key() in without:
                without[effect.key()][:, test_rows] = lacking
    by_finding = tuple(
        {e.key(): matches_in_fold for e, matches_in_fold in zip(effects, fold.effects_by_finding, strict=True)}
        for fold in results
    )
    chosen = {effect.key(): sum(bool(fold[effect.key()]) for fold in by_finding) for effect in effects}
    return CrossValidation(
        before, after, without, chosen, len(masks), by_finding, tuple(fold.all_effects for fold in results)
    )


def reduced(
    validation: CrossValidation | None,
    before_withdrawal: SearchResult,
    remaining: SearchResult,
    data: Measurements,
    holdout: Measurements | None,
    n_folds: int,
    seed: int,
) -> CrossValidation | None:
    """Return ``validation`` for the findings that remain of ``before_withdrawal``.

    Each fold keeps only its effects that match a remaining finding, so that held-out residuals describe the reported
    model. Without remaining findings they are those of the baseline.
    """
    if validation is None or (remaining.effects and remaining.effects == before_withdrawal.effects):
        return validation
    if not remaining.effects:
        return dataclasses.replace(validation, after=validation.before, without={})
    if holdout is not None:
        return _from_holdout(remaining, data, holdout)
    assigned = folds(data, n_folds, seed)
    assert assigned is not None  # or there would be no validation
    masks = [test_rows for _, test_rows in parts(assigned)]

    def refit_fold(number: int) -> _Fold:
        test_rows, by_key = masks[number], validation.effects_by_finding[number]
        by_finding = [
            by_key[effect.key()] if effect.key() in by_key else _same(effect, validation.all_effects[number])
            for effect in remaining.effects
        ]
        effects = frames_first(dict.fromkeys(effect for matches_in_fold in by_finding for effect in matches_in_fold))
        before = validation.before[:, test_rows]
        if frozenset(effects) == validation.all_effects[number]:
            without = (validation.without.get(effect.key()) for effect in remaining.effects)
            lacking = tuple(None if residual is None else residual[:, test_rows] for residual in without)
            return _Fold(
                before, validation.after[:, test_rows], lacking, tuple(by_finding), validation.all_effects[number]
            )
        if not effects:
            return _Fold(before, before, tuple(before for _ in by_finding), tuple(by_finding), frozenset())
        train, test = _parts(remaining, data, assigned, number)
        complete = _completed(remaining, effects, train)
        return _judged(complete, effects, before, by_finding, train, test)

    results = list(_in_parallel(refit_fold, range(len(masks)), data.n))
    return _joined(remaining.effects, masks, results, validation.before.shape)


def _same(effect: Effect, chosen: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return the effects of a fold that are the same finding as ``effect``."""
    return tuple(sorted((other for other in chosen if effect.is_same_finding(other)), key=str))


def _reported(fold: _Fold, number: int, count: int, progress: Progress) -> _Fold:
    progress("cross-fitting", number + 1, count + 1)
    return fold


def _in_parallel(work: Callable[[int], _Fold], numbers: Sequence[int], n: int) -> Iterator[_Fold]:
    """Yield the result of each fold in turn; two processes share the work if there are many poses."""
    processes = min(2, os.cpu_count() or 1) if n >= _PARALLEL_POSES else 1
    return fork_map(work, numbers, processes)


def _fold(work: _Work, number: int) -> _Fold:
    search_result, data = work.search_result, work.data
    train, test = _parts(search_result, data, work.assigned, number)
    selection = choose(
        search_result.candidates, work.assigned != number, empirical=work.empirical, max_poses=_FOLD_POSES
    )
    chosen = [(choice, selection.refined(choice)) for choice in selection.chosen]
    effects = frames_first(effect for _, effect in chosen)
    like = search_result.declared
    declared = refit(like, like.model.free, train, fold_options(like))
    declared, _ = choose_form(declared, like.model, train, fold_options(like))
    complete = _completed(search_result, effects, train) if effects else declared
    by_finding = _matching_effects(search_result.effects, selection, chosen)
    return _judged(complete, effects, held_out(declared, test), by_finding, train, test)


def _parts(
    search_result: SearchResult, data: Measurements, assigned: NDArray[np.int64], number: int
) -> tuple[Measurements, Measurements]:
    """Return the training rows of a fold, without outliers, and its test rows."""
    learn = (assigned != number) & search_result.final.inliers
    return data.subset(np.flatnonzero(learn)), data.subset(np.flatnonzero(assigned == number))


def _completed(search_result: SearchResult, effects: Sequence[Effect], train: Measurements) -> Fit:
    """Return the fit of the declared effects and ``effects`` to a fold's training rows."""
    model = search_result.declared.model.with_free(*effects)
    complete = refit(search_result.final, model.free, train, fold_options(search_result.final))
    return (
        complete if complete.group_stds else choose_form(complete, model, train, fold_options(search_result.final))[0]
    )


def _judged(
    complete: Fit,
    effects: Sequence[Effect],
    before: Array,
    by_finding: Sequence[Sequence[Effect]],
    train: Measurements,
    test: Measurements,
) -> _Fold:
    after = held_out(complete, test)
    lacking = ReducedFits(complete, train, test, fold_options(complete))
    without = tuple(lacking.residuals(matches_in_fold) if matches_in_fold else after for matches_in_fold in by_finding)
    return _Fold(
        before, after, without, tuple(tuple(matches_in_fold) for matches_in_fold in by_finding), frozenset(effects)
    )


def _matching_effects(
    findings: Sequence[Effect], selection: Selection, chosen: Sequence[tuple[Chosen, Effect]]
) -> list[list[Effect]]:
    """Return, for each finding, the effects of a fold that match it or are not distinguishable from it."""
    by_finding = [[effect for _, effect in chosen if finding.is_same_finding(effect)] for finding in findings]
    if all(by_finding):
        return by_finding
    others = [{(other.effect, other.joints) for other in rivals(selection, choice)[1]} for choice, _ in chosen]
    return [
        matches or [effect for (_, effect), names in zip(chosen, others, strict=True) if (f.name, f.joints) in names]
        for f, matches in zip(findings, by_finding, strict=True)
    ]


def _from_holdout(search_result: SearchResult, data: Measurements, holdout: Measurements) -> CrossValidation:
    """Return residuals of ``holdout`` with the models fitted to all other poses."""
    declared = choose_deflection(search_result.declared, search_result.declared.model, data, SEARCH)[0]
    final = (
        search_result.final
        if search_result.final.group_stds
        else choose_deflection(search_result.final, search_result.final.model, data, SEARCH)[0]
    )
    reduced_fits = ReducedFits(final, data, holdout, fold_options(final))
    lacking = {effect.key(): reduced_fits.residuals([effect]) for effect in search_result.effects}
    without = {key: residual for key, residual in lacking.items() if residual is not None}
    return CrossValidation(held_out(declared, holdout), held_out(final, holdout), without, {}, 0)
