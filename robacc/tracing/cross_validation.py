"""Held-out residuals of every row: the models with the identified effects are fitted again without each fold.

The choice of effects is not repeated in the folds: what it costs is in the prior odds of the search.
"""

from __future__ import annotations

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
from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.parallel import fork_map
from robacc.tracing.refitting import refit
from robacc.tracing.without_finding import ReducedFits, fold_options

Result = TypeVar("Result")
Progress = Callable[[str, int, int], None]

_PARALLEL_POSES = 600
"""Poses from which a second process is worth its start."""


@dataclass(frozen=True)
class CrossValidation:
    """Held-out residuals ``(M, N)`` of every row, with and without each finding."""

    before: Array
    after: Array
    without: dict[tuple[object, ...], Array]
    """Residuals without each finding, by its key; only findings without which the model can be fitted."""
    folds: int
    """Number of folds; 0 if poses of another file are held out."""


def cross_validate(
    declared: Fit, final: Fit, effects: Sequence[Effect], data: Measurements, how: HoldOut, progress: Progress
) -> CrossValidation | None:
    """Return residuals of validation poses, or of every row without its fold; None if there are too few poses."""
    if how.validation is not None:
        return _on(declared, final, effects, data, how.validation)
    assigned = how.folds(data)
    if assigned is None:
        return None
    work = functools.partial(_judged, declared, final, effects, data, assigned)
    masks = [test for _, test in parts(assigned)]
    try:
        results = []
        for result in _in_parallel(work, range(len(masks)), data.n):
            results.append(result)
            progress("cross-validation", len(results), len(masks) + 1)
    except InputError:
        # The rows without a fold are too few for the fitted coefficients.
        return None
    before, after = np.empty_like(final.residual), np.empty_like(final.residual)
    without = {effect.key(): np.empty_like(final.residual) for effect in effects}
    for test, fold in zip(masks, results, strict=True):
        before[:, test], after[:, test] = fold.before, fold.after
        for key in list(without):
            if key in fold.without:
                without[key][:, test] = fold.without[key]
            else:
                del without[key]
    return CrossValidation(before, after, without, len(masks))


def _judged(
    declared: Fit, final: Fit, effects: Sequence[Effect], data: Measurements, assigned: NDArray[np.int64], number: int
) -> CrossValidation:
    """Return the residuals of a fold's rows, with models of the other rows that are no outliers."""
    train = data.subset(np.flatnonzero((assigned != number) & final.inliers))
    test = data.subset(np.flatnonzero(assigned == number))
    baseline = refit(declared, declared.model.free, train, fold_options(declared))
    if not effects:
        before = held_out(baseline, test)
        return CrossValidation(before, before, {}, 0)
    return _on(baseline, refit(final, final.model.free, train, fold_options(final)), effects, train, test)


def _on(
    declared: Fit, final: Fit, effects: Sequence[Effect], train: Measurements, test: Measurements
) -> CrossValidation:
    """Return the residuals of ``test`` with fits to ``train``."""
    reduced = ReducedFits(final, train, test, fold_options(final))
    lacking = {effect.key(): reduced.residuals([effect]) for effect in effects}
    without = {key: residual for key, residual in lacking.items() if residual is not None}
    return CrossValidation(held_out(declared, test), held_out(final, test), without, 0)


def _in_parallel(work: Callable[[int], Result], numbers: Sequence[int], n: int) -> Iterator[Result]:
    """Yield the result of each fold in turn; two processes share the work if there are many poses."""
    processes = min(2, os.cpu_count() or 1) if n >= _PARALLEL_POSES else 1
    return fork_map(work, numbers, processes)
