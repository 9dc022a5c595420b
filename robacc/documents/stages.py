"""Stages of a fit as parts of a JSON result: the metrics of each stage with their intervals."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import length_intervals
from robacc.accuracy.metrics import PoseMetrics
from robacc.accuracy.stages import Stage
from robacc.documents.statistics import figures_document, interval_document
from robacc.geometry import Array
from robacc.statistics.intervals import Interval

CONFIDENCE = 0.95


class ErrorRows(NamedTuple):
    """Residuals behind the metrics of a stage."""

    residual: Array
    """``(3 or 6, N)`` m, rad"""
    used: NDArray[np.bool_]
    """``(N,)`` mask of the rows that are not outliers."""
    groups: NDArray[np.int64]
    """``(N,)`` number of each row's commanded pose; intervals are over poses, repetitions staying together."""


def stage_document(stage: Stage, fitted: ErrorRows, held_out: ErrorRows | None, seed: int) -> dict[str, Any]:
    """Return the metrics of one stage on calibration poses, and on held-out poses if there are any.

    Intervals on calibration poses ignore the fit to these poses; the metrics on held-out poses are the valid ones.
    """
    everything = np.ones_like(fitted.used)
    return {
        "fitted": _poses(stage.fitted, fitted._replace(used=everything), seed),
        "fitted_inliers": None if stage.fitted_inliers is None else _poses(stage.fitted_inliers, fitted, seed),
        "held_out": None
        if stage.held_out is None or held_out is None
        else _poses(stage.held_out, held_out._replace(used=np.ones_like(held_out.used)), seed),
        "held_out_inliers": None
        if stage.held_out_inliers is None or held_out is None
        else _poses(stage.held_out_inliers, held_out, seed),
    }


def _poses(figures: PoseMetrics, errors: ErrorRows, seed: int) -> dict[str, Any]:
    metrics: dict[str, Any] = {"position": None, "orientation": None}
    groups = errors.groups[errors.used]
    for name, unit, rows, quantity_metrics in (
        ("position", "m", slice(0, 3), figures.position),
        ("orientation", "rad", slice(3, 6), figures.orientation),
    ):
        if quantity_metrics is None:
            continue
        metrics[name] = {
            **figures_document(quantity_metrics, unit),
            "n_poses": int(groups.size),
            "n_commanded_poses": int(np.unique(groups).size),
            "intervals": _intervals(errors.residual[rows, errors.used], groups, unit, seed),
        }
    return metrics


def _intervals(errors: Array, groups: NDArray[np.int64], unit: str, seed: int) -> dict[str, Any]:
    if errors.shape[1] == 0:
        missing = interval_document(Interval.missing(CONFIDENCE, "no pose"))
        return {f"{name}_{unit}": missing for name in ("rms", "mean_error", "p95")}
    (by_name,) = length_intervals(errors, (CONFIDENCE,), groups=groups, seed=seed)
    return {f"{name}_{unit}": interval_document(interval) for name, interval in by_name.items()}
