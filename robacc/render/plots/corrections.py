"""The targets of a correction in space, with the errors of the nominal and of the corrected commands."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from robacc.render.plots.chart import Chart, Document
from robacc.render.plots.columns import vectors
from robacc.render.plots.stage_errors import StageErrors
from robacc.render.plots.workspace_3d import errors_in_space


def correction_charts(document: Document) -> Iterator[Chart]:
    """Return the chart of a correction with its targets in the frame of the targets."""
    if document["command"] != "correct" or not document["targets"]["line"]:
        return
    targets: Mapping[str, Any] = document["targets"]
    stages = (
        StageErrors("before", "error of the nominal command", vectors(targets["error_before_m"])),
        StageErrors("after", "error of the corrected command", vectors(targets["error_after_m"])),
    )
    corrected = np.array(targets["corrected"], dtype=bool)
    count = f"{np.count_nonzero(corrected)} of {corrected.size} targets are corrected"
    yield errors_in_space(
        document,
        targets,
        vectors(targets["wanted_m"]),
        stages,
        "corrections",
        "Corrections in space",
        f"Wanted positions and the error that the model predicts there; {count}, the others keep their error",
    )
