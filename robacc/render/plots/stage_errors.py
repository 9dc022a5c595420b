"""The errors of a result's poses, stage by stage, as pictures compare them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.render.plots.chart import Document
from robacc.render.plots.columns import Array, lengths, vectors

STAGE_WORDS = {"nominal": "as delivered", "before": "before", "after": "after"}
STAGE_MEANINGS = {
    "trace": "before: with the declared effects fitted; after: with the findings added",
    "calibrate": "before: with base and tool fitted; after: with all named effects fitted",
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
        """``(N,)`` lengths."""
        return lengths(self.errors)


@dataclass(frozen=True, slots=True)
class ErrorsByStage:
    """The stages of one result, of the same poses."""

    poses: Mapping[str, Any]
    """Its columns, as many rows as the errors have."""
    used: Array
    """``(N,)`` 1 where a pose took part, 0 where it was left out as no part of the rest."""
    stages: tuple[StageErrors, ...]
    held_out: bool
    """Whether before and after are of models that had no part of the pose."""

    @property
    def last(self) -> StageErrors:
        """The stage that the result ends with."""
        return self.stages[-1]


def stages_of(document: Document, unit: str) -> ErrorsByStage | None:
    """Errors in ``m`` or ``rad``; None where the result has none."""
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
    crossed = columns["held_out_after"] is not None
    names = {
        "nominal": "nominal",
        "before": "held_out_before" if crossed else "before",
        "after": "held_out_after" if crossed else "after",
    }
    n = len(columns["nominal"])
    used = np.ones(n) if poses["used"] is None else np.array(poses["used"], dtype=np.float64)
    chosen = ["nominal", "before"] if document.get("findings") == [] else list(names)
    found = tuple(StageErrors(role, STAGE_WORDS[role], vectors(columns[names[role]])) for role in chosen)
    return ErrorsByStage(poses, used, found, crossed or document.get("poses_apart") is not None)
