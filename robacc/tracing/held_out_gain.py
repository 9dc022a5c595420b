"""How much better one model predicts held-out poses than another, over the uncertainty of that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError
from robacc.fitting.cross_validation import folds, held_out, parts
from robacc.fitting.fit_result import Fit
from robacc.fitting.misfit import outlier_limit
from robacc.fitting.places import places
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.tracing.refitting import refit
from robacc.tracing.without_finding import fold_options

_FOLDS = 3
"""Folds of a comparison of two models."""


def gain_score(without: Array, after: Array, place: NDArray[np.int64], weight: Array | None = None) -> float:
    """Return the mean gain of held-out poses over its standard error: squared residuals without less those with.

    Places are independent, not rows; ``place`` ``(N,)`` is the number of each row's. ``weight`` ``(M, N)`` are
    reciprocal standard deviations of the components; where None, positions are judged, each as good as the
    others.
    """
    if weight is None:
        without, after, weight = without[:3], after[:3], np.ones_like(after[:3])
    gain = np.sum((np.square(without) - np.square(after)) * np.square(weight), axis=0)
    sums = np.bincount(np.unique(place, return_inverse=True)[1], weights=gain)
    if sums.size < 2:
        return 0.0
    error = float(np.std(sums, ddof=1)) / np.sqrt(sums.size)
    mean = float(np.mean(sums))
    if error == 0.0:
        return np.inf if mean > 0 else 0.0
    return float(mean / error)


def bounded(residual: Array, final: Fit) -> Array:
    """Return ``(M, N)`` held-out residuals in m and rad, those of outliers of ``final`` at most as long as the limit.

    A model with large errors does not show which rows are wrong, so its fit keeps them. The product of a wrong row's
    error and of an effect's small motion would then outweigh the gain of all other rows. At the limit, a row still
    counts against an effect that makes it an outlier.
    """
    length = np.sqrt(np.mean(np.square(residual * final.weight), axis=0))
    limit = np.sqrt(outlier_limit(*residual.shape))
    shrink = np.where(final.inliers | (length <= limit), 1.0, limit / np.maximum(length, limit))
    return np.asarray(residual * shrink, dtype=np.float64)


def gain_of(better: Fit, worse: Fit, data: Measurements) -> float:
    """Return the :func:`gain_score` of one fitted model over another, each fitted again without each fold of ``data``.

    It is 0 if there are too few poses for that. Rows that are outliers of both are not judged.
    """
    assigned = folds(data, _FOLDS, seed=0)
    if assigned is None:
        return 0.0
    after, without = np.empty(better.residual.shape), np.empty(worse.residual.shape)
    try:
        for train, test in parts(assigned):
            learn = data.subset(np.flatnonzero(train & better.inliers & worse.inliers))
            for fitted, residual in ((better, after), (worse, without)):
                again = refit(fitted, fitted.model.free, learn, fold_options(fitted))
                residual[:, test] = held_out(again, data.subset(np.flatnonzero(test)))
    except InputError:
        return 0.0
    plausible = better.inliers | worse.inliers
    without, after = bounded(without, better), bounded(after, better)
    return gain_score(without[:, plausible], after[:, plausible], places(data)[plausible])
