"""The errors of a result's poses by stage: nominal model, baseline, extended model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.render.plots.chart import Document
from robacc.render.plots.columns import Array, lengths, vectors

STAGE_LABELS = {
    "trace": {"nominal": "nominal, registered", "before": "baseline", "after": "extended model"},
    "calibrate": {"nominal": "nominal, registered", "before": "baseline", "after": "calibrated"},
}
STAGE_MEANINGS = {
    "trace": "baseline: declared effects fitted; extended model: findings added",
    "calibrate": "baseline: base and tool fitted; calibrated: all named effects fitted",
}


@dataclass(frozen=True, slots=True)
class StageErrors:
    """The errors of one stage."""

    role: str
    """``nominal``, ``before`` or ``after``: its colour."""
    label: str
    errors: Array
    """``(N, 3)`` m or rad."""

    @property
    def sizes(self) -> Array:
        """Return the lengths ``(N,)`` of the errors."""
        return lengths(self.errors)


@dataclass(frozen=True, slots=True)
class ErrorsByStage:
    """The stages of one result, of the same poses."""

    poses: Mapping[str, Any]
    """Columns of the poses, with as many rows as the errors."""
    used: Array
    """``(N,)``, 1 for inliers and 0 for outliers."""
    stages: tuple[StageErrors, ...]
    held_out: bool
    """True if the models of baseline and extended model were fitted without the pose."""

    @property
    def last(self) -> StageErrors:
        """Return the last stage of the result."""
        return self.stages[-1]


def stages_of(document: Document, unit: str) -> ErrorsByStage | None:
    """Return the errors in ``m`` or ``rad``, None if the result has none."""
    poses = document.get("poses_apart") or document.get("poses")
    if poses is None or document["command"] == "predict":
        return None
    if "errors_m" in poses:
        return _of_fit(document, poses, unit)
    part = document.get("position" if unit == "m" else "orientation")
    if part is None or f"errors_{unit}" not in part:
        return None
    errors = vectors(part[f"errors_{unit}"])
    return ErrorsByStage(poses, np.ones(len(errors)), (StageErrors("after", "measured", errors),), False)


def _of_fit(document: Document, poses: Mapping[str, Any], unit: str) -> ErrorsByStage | None:
    columns = poses[f"errors_{unit}"]
    if columns is None:
        return None
    held_out = columns["held_out_after"] is not None
    names = {
        "nominal": "held_out_nominal" if held_out else "nominal",
        "before": "held_out_before" if held_out else "before",
        "after": "held_out_after" if held_out else "after",
    }
    n = len(columns["nominal"])
    used = np.ones(n) if poses["used"] is None else np.array(poses["used"], dtype=np.float64)
    roles = ["nominal", "before"] if document.get("findings") == [] else list(names)
    labels = STAGE_LABELS[document["command"]]
    stages = tuple(StageErrors(role, labels[role], vectors(columns[names[role]])) for role in roles)
    return ErrorsByStage(poses, used, stages, held_out or document.get("poses_apart") is not None)
