"""Cross-validation of the complete search: it is repeated without each fold, so that every row has a held-out residual.

Folds are independent of each other. With many poses, two processes share them.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.errors import InputError
from robacc.fitting.cross_validation import HoldOut, held_out, parts
from robacc.fitting.deflection_model import choose_deflection, choose_form
from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.parallel import fork_map
from robacc.tracing.choosing import choose
from robacc.tracing.loop import SearchResult
from robacc.tracing.ranking import Chosen
from robacc.tracing.refitting import SEARCH, frames_first, refit
from robacc.tracing.rivals import rivals
from robacc.tracing.selection import Selection, fold_level
from robacc.tracing.without_finding import ReducedFits, fold_options

Result = TypeVar("Result")
Progress = Callable[[str, int, int], None]

_FOLD_POSES = 400
"""Largest number of poses that a fold's selection uses."""
_PARALLEL_POSES = 600
"""Poses from which a second process is worth its start."""


Choice = dict[tuple[object, ...], tuple[Effect, ...]]
"""A fold's effects that match a finding of the search, by the finding's key; empty if the fold lacks it."""


@dataclass(frozen=True)
class FoldChoices:
    """What each fold chose when the search was repeated without its rows."""

    effects_by_finding: tuple[Choice, ...]
    all_effects: tuple[frozenset[Effect], ...]
    """All effects that each fold chose."""

    @property
    def folds(self) -> int:
        """Return the number of folds."""
        return len(self.all_effects)

    def matching(self, effect: Effect, fold: int) -> tuple[Effect, ...]:
        """Return the effects of a fold that match an effect, which need not be a finding of the search."""
        by_finding = self.effects_by_finding[fold]
        if effect.key() in by_finding:
            return by_finding[effect.key()]
        return tuple(sorted((other for other in self.all_effects[fold] if effect.is_same_finding(other)), key=str))

    def count(self, effect: Effect) -> int:
        """Return the number of folds in which an effect recurs."""
        return sum(bool(self.matching(effect, fold)) for fold in range(self.folds))


@dataclass(frozen=True)
class CrossValidation:
    """Held-out residuals ``(M, N)`` of every row, with and without each finding, and the stability of the findings."""

    before: Array
    after: Array
    without: dict[tuple[object, ...], Array]
    """Residuals without each finding, by its key; only findings without which the model can be fitted."""
    choices: FoldChoices | None = None
    """What each fold chose; None if poses of another file are held out."""
    model_effects: tuple[frozenset[Effect], ...] = ()
    """Effects that each fold's model has in addition to the declared effects."""

    @property
    def folds(self) -> int:
        """Return the number of folds, zero if poses of another file are held out."""
        return 0 if self.choices is None else self.choices.folds


@dataclass(frozen=True)
class _Fold:
    """Held-out residuals ``(M, n)`` of the rows of a fold."""

    before: Array
    after: Array
    without: tuple[Array | None, ...]
    """Residuals without each finding, in their order; None if the model cannot be fitted without it."""
    model_effects: frozenset[Effect]
    """Effects of the model in addition to the declared effects."""


def fold_choices(
    search_result: SearchResult, data: Measurements, how: HoldOut, empirical: bool, progress: Progress
) -> FoldChoices | None:
    """Return what the search chooses without the rows of each fold; None if there are too few poses."""
    assigned = how.folds(data)
    if assigned is None:
        return None
    numbers = range(int(assigned.max()) + 1)
    work = functools.partial(_chosen, search_result, assigned, empirical)
    choices = []
    for number, choice in enumerate(_in_parallel(work, numbers, data.n)):
        progress("cross-validation", number + 1, len(numbers) + 1)
        choices.append(choice)
    return FoldChoices(tuple(by_finding for by_finding, _ in choices), tuple(effects for _, effects in choices))


def _chosen(
    search_result: SearchResult, assigned: NDArray[np.int64], empirical: bool, number: int
) -> tuple[Choice, frozenset[Effect]]:
    """Return the effects of a fold that match each finding, and all effects that it chose."""
    selection = chosen_on(search_result, assigned != number, empirical)
    chosen = [(choice, selection.refined(choice)) for choice in selection.chosen]
    matches = _matching_effects(search_result.effects, selection, chosen)
    by_finding = {e.key(): tuple(effects) for e, effects in zip(search_result.effects, matches, strict=True)}
    return by_finding, frozenset(effect for _, effect in chosen)


def chosen_on(search_result: SearchResult, rows: NDArray[np.bool_], empirical: bool = True) -> Selection:
    """Return what a search chooses from the poses ``rows`` ``(N,)``, on the linearisation of the search on all.

    Outliers of the final fit are left out, as they are from the fits of folds. Large errors of the baseline hide them,
    and the linearisation is at the baseline: in a fold they would count as noise, beside which small effects are lost.
    """
    inliers = search_result.final.inliers
    return choose(
        search_result.candidates,
        rows & inliers,
        empirical=empirical,
        max_poses=_FOLD_POSES,
        named_first=search_result.named_first,
        level=fold_level(float(np.mean(rows[inliers]))),
        known=[effect for effect in search_result.effects if not (effect.is_frame or effect.is_profile())],
    )


def cross_validate(
    search_result: SearchResult,
    choices: FoldChoices | None,
    data: Measurements,
    how: HoldOut,
    *,
    is_whole: bool = False,
    earlier: CrossValidation | None = None,
) -> CrossValidation | None:
    """Return residuals of validation poses, or of every row without its fold; None if there are too few poses.

    Args:
        search_result: The findings, and fits of all rows.
        choices: What each fold chose.
        data: Poses of the search.
        how: Poses that are held out.
        is_whole: Whether each fold's model has all effects that it chose, or only those that match a finding.
        earlier: Residuals of the same baseline with other findings; what is known from them is not fitted again.
    """
    if earlier is not None and not search_result.effects:
        return dataclasses.replace(earlier, after=earlier.before, without={})
    if how.validation is not None:
        return _from_validation_poses(search_result, data, how.validation)
    assigned = how.folds(data)
    if choices is None or assigned is None:
        return None
    work = _Work(search_result, choices, data, assigned, is_whole, earlier)
    masks = [test_rows for _, test_rows in parts(assigned)]
    try:
        results = list(_in_parallel(functools.partial(_judged, work), range(len(masks)), data.n))
    except InputError:
        # The rows without a fold are too few for the fitted coefficients.
        return None
    shape = search_result.final.residual.shape
    before, after = np.empty(shape), np.empty(shape)
    without = {effect.key(): np.empty(shape) for effect in search_result.effects}
    for test_rows, fold in zip(masks, results, strict=True):
        before[:, test_rows], after[:, test_rows] = fold.before, fold.after
        for effect, lacking in zip(search_result.effects, fold.without, strict=True):
            if lacking is None:
                without.pop(effect.key(), None)
            elif effect.key() in without:
                without[effect.key()][:, test_rows] = lacking
    return CrossValidation(before, after, without, choices, tuple(fold.model_effects for fold in results))


@dataclass(frozen=True)
class _Work:
    """Input that all folds share."""

    search_result: SearchResult
    choices: FoldChoices
    data: Measurements
    assigned: NDArray[np.int64]
    is_whole: bool
    earlier: CrossValidation | None


def _judged(work: _Work, number: int) -> _Fold:
    """Return the residuals of a fold's rows, with models of the other rows."""
    search_result, earlier = work.search_result, work.earlier
    by_finding = [work.choices.matching(effect, number) for effect in search_result.effects]
    matching = dict.fromkeys(effect for matches in by_finding for effect in matches)
    effects = frames_first(work.choices.all_effects[number] if work.is_whole else matching)
    rows = work.assigned == number
    if earlier is not None and effects and earlier.model_effects[number] == frozenset(effects):
        without = (earlier.without.get(effect.key()) for effect in search_result.effects)
        lacking = tuple(None if residual is None else residual[:, rows] for residual in without)
        return _Fold(earlier.before[:, rows], earlier.after[:, rows], lacking, frozenset(effects))
    train, test = _parts(search_result, work.data, work.assigned, number)
    before = _declared_alone(search_result, train, test) if earlier is None else earlier.before[:, rows]
    if not effects:
        return _Fold(before, before, tuple(before for _ in by_finding), frozenset())
    complete = _completed(search_result, effects, train)
    after = held_out(complete, test)
    reduced = ReducedFits(complete, train, test, fold_options(complete))
    lacking = tuple(
        reduced.residuals(matches, _stood_for(search_result.effects, by_finding, i)) if matches else after
        for i, matches in enumerate(by_finding)
    )
    return _Fold(before, after, lacking, frozenset(effects))


def _stood_for(findings: Sequence[Effect], by_finding: Sequence[Sequence[Effect]], absent: int) -> list[Effect]:
    """Return the other findings for which a fold has nothing but effects that match the finding ``absent``."""
    return [
        finding
        for i, (finding, matches) in enumerate(zip(findings, by_finding, strict=True))
        if i != absent and matches and set(matches) <= set(by_finding[absent])
    ]


def _declared_alone(search_result: SearchResult, train: Measurements, test: Measurements) -> Array:
    """Return the residuals of ``test`` with the declared effects alone, fitted to ``train``."""
    like = search_result.declared
    fitted = refit(like, like.model.free, train, fold_options(like))
    return held_out(choose_form(fitted, like.model, train, fold_options(like))[0], test)


def _in_parallel(work: Callable[[int], Result], numbers: Sequence[int], n: int) -> Iterator[Result]:
    """Yield the result of each fold in turn; two processes share the work if there are many poses."""
    processes = min(2, os.cpu_count() or 1) if n >= _PARALLEL_POSES else 1
    return fork_map(work, numbers, processes)


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


def _matching_effects(
    findings: Sequence[Effect], selection: Selection, chosen: Sequence[tuple[Chosen, Effect]]
) -> list[list[Effect]]:
    """Return, for each finding, the effects of a fold that match it or are not distinguishable from it."""
    by_finding = [[effect for _, effect in chosen if finding.is_same_finding(effect)] for finding in findings]
    if all(by_finding):
        return by_finding
    lacking = {(f.name, f.joints) for f, matches in zip(findings, by_finding, strict=True) if not matches}
    others = [
        {(other.effect, other.joints) for other in rivals(selection, choice, among=lacking)[1]} for choice, _ in chosen
    ]
    return [
        matches or [effect for (_, effect), names in zip(chosen, others, strict=True) if (f.name, f.joints) in names]
        for f, matches in zip(findings, by_finding, strict=True)
    ]


def _from_validation_poses(search_result: SearchResult, data: Measurements, poses: Measurements) -> CrossValidation:
    """Return residuals of validation ``poses`` with the models fitted to ``data``."""
    declared = choose_deflection(search_result.declared, search_result.declared.model, data, SEARCH)[0]
    final = (
        search_result.final
        if search_result.final.group_stds
        else choose_deflection(search_result.final, search_result.final.model, data, SEARCH)[0]
    )
    reduced_fits = ReducedFits(final, data, poses, fold_options(final))
    lacking = {effect.key(): reduced_fits.residuals([effect]) for effect in search_result.effects}
    without = {key: residual for key, residual in lacking.items() if residual is not None}
    return CrossValidation(held_out(declared, poses), held_out(final, poses), without)
