"""Keys of ``robacc.estimate/1`` and ``robacc.estimate-many/1`` in m and rad, and the errors of every pose as CSV."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.documents.envelope import csv_text, significant_document
from robacc.documents.gate import GATE_KEY, GATE_RESULT
from robacc.documents.keys import (
    LEFT_OUT,
    Document,
    Key,
    array,
    choice,
    count,
    flag,
    matrix3,
    ordinal,
    part,
    rows3,
    share,
    size,
    table,
    text,
    vector3,
    within,
)
from robacc.documents.parts import (
    ALIGNMENT,
    FIGURES,
    METRICS,
    OUTSIDE_KEY,
    POSES,
    QUANTITIES,
    ROBOT,
    STATISTICS,
    WARNINGS,
    pose_document,
    robot_document,
    rounded,
)
from robacc.io.json_text import json_text

if TYPE_CHECKING:
    from robacc.accuracy.estimation import ErrorFrame, EstimateResult, FrameStatistics
    from robacc.measurements import Measurements
    from robacc.outcomes import FileOutcome
    from robacc.robots.description import Robot

_WORST = part(
    {
        "line": Key(count, "Line of the file."),
        "place": Key(text, "Line as text, or the row where the file has no lines.", optional=True),
        "pose": Key(text | None, "Id of the pose, or null."),
        "target": Key(text | None, "Measured target, or null."),
        "error_m": Key(size, "Length of the position error, m.", "position"),
        "error_rad": Key(size | None, "Length of the orientation error, rad, or null.", "orientation"),
    }
)
"""A pose with a large error."""
_FRAME = part(
    {
        "mean_m": Key(vector3, "Mean error, m."),
        "covariance_m2": Key(matrix3, "Covariance about zero, m²."),
        "centred_covariance_m2": Key(matrix3, "Covariance about the mean, m².", "centred"),
        "errors_m": Key(rows3, "Position error of each row, m.", lambda frame: rounded(frame.errors)),
    }
)
"""Position errors in the axes of a frame."""
_QUANTITY_GRADE = {
    unit: part(
        {
            "grade": Key(text, "Grade of this quantity alone."),
            "demonstrated_grade": Key(text | None, "Best grade that is confirmed for this quantity."),
            f"value_{unit}": Key(size | None, f"Statistic of the scale, {unit}."),
            f"upper_bound_{unit}": Key(
                size | None,
                f"Upper bound of the statistic at the scale's confidence, {unit}; null if there is none.",
                "interval.upper_bound",
            ),
            f"limit_{unit}": Key(size | None, f"Limit of the grade, {unit}; null if it has none."),
            "method": Key(text, "Method of the bound.", "interval.method"),
            "why": Key(text | None, "Reason why there is no bound, or null."),
        }
    )
    for unit, _ in QUANTITIES
}
GRADE = part(
    {
        "grade": Key(text, "Grade by the estimated statistics."),
        "demonstrated": Key(flag, "True if the grade is confirmed: the upper bounds meet its limits too."),
        "demonstrated_grade": Key(text | None, "Best grade that is confirmed; null if there is none."),
        "scale": Key(text, "Name of the scale.", "scale.name"),
        "statistic": Key(
            choice("rms", "mean_error", "p95", "max"), "Statistic that the limits apply to.", "scale.statistic"
        ),
        "confidence": Key(share, "Confidence of the upper bounds.", "scale.confidence"),
        "position": Key(
            _QUANTITY_GRADE["m"],
            "Position alone.",
        ),
        "orientation": Key(
            _QUANTITY_GRADE["rad"] | None,
            "Orientation alone; null if none was measured.",
        ),
        "limited_by": Key(array(text), "Quantities that prevent a better grade."),
        "next": Key(
            part(
                {
                    "grade": Key(text, "Name of the grade."),
                    "position_excess_m": Key(size | None, "Distance of the position beyond its limit, m.", "position"),
                    "orientation_excess_rad": Key(
                        size | None, "Distance of the orientation beyond its limit, rad.", "orientation"
                    ),
                }
            )
            | None,
            "Next better grade and the distances to its limits; null at the best grade.",
        ),
        "probability": Key(
            share | None,
            "Probability that the limits of the grade are truly met, given the data; null if unknown.",
        ),
        "probabilities": Key(
            array(
                part(
                    {
                        "grade": Key(text, "Name of the grade."),
                        "probability": Key(share, "Probability of the grade."),
                    }
                )
            ),
            "Probability that each grade is the true grade.",
            lambda grade: [{"grade": name, "probability": share} for name, share in grade.probabilities],
        ),
        "poses_to_demonstrate": Key(
            count | None,
            "Total number of poses that would confirm the grade; null if it is confirmed or the number is unknown.",
        ),
        "reason": Key(text, "Explanation of the grade."),
        "steps": Key(
            array(
                part(
                    {
                        "grade": Key(text, "Name of the grade."),
                        "position_m": Key(size, "Position limit, m."),
                        "orientation_rad": Key(size | None, "Orientation limit, rad; null for no limit."),
                    }
                )
            ),
            "Steps of the scale, the best grade first.",
            "scale.steps",
        ),
        "otherwise": Key(text, "Grade of errors that meet no step.", "scale.otherwise"),
    }
)
"""Grade of measured errors; limits, values and bounds in m and rad."""


def _orientation(result: EstimateResult) -> Document | None:
    if result.orientation is None or result.errors.rotation is None:
        return None
    return STATISTICS["rad"].write(result.orientation, errors_rad=result.errors.rotation.T)


_ESTIMATE = part(
    {
        "n_poses": Key(count, "Measured poses (rows)."),
        "frame": Key(
            choice("tool", "base"),
            "Axes of the errors: the commanded target's, or the measuring frame's.",
            "errors.frame",
        ),
        "commanded": Key(choice("robot", "file"), "Source of the commanded poses."),
        "alignment": Key(
            ALIGNMENT | None,
            "Frames registered to the poses; null without a registration.",
        ),
        "unaligned": Key(
            part(
                {
                    "position": Key(FIGURES["m"]),
                    "orientation": Key(FIGURES["rad"] | None, "Metrics of orientation; null if none was measured."),
                }
            )
            | None,
            "Metrics without the registration; null if no frame was registered.",
        ),
        "position": Key(
            STATISTICS["m"],
            source=lambda result: STATISTICS["m"].write(result.position, errors_m=result.errors.position.T),
        ),
        "orientation": Key(
            STATISTICS["rad"] | None,
            "Orientation errors; null if no orientation was measured or commanded.",
            _orientation,
        ),
        "grade": Key(
            GRADE,
            "Grade of the errors.",
        ),
        "worst_poses": Key(
            part(
                {
                    "by_position": Key(
                        array(_WORST),
                        "Largest position errors, the largest first.",
                        "worst_position",
                    ),
                    "by_orientation": Key(
                        array(_WORST),
                        "Largest orientation errors, the largest first.",
                        "worst_orientation",
                    ),
                }
            ),
            "Poses with the largest errors.",
            "",
        ),
        "targets": Key(
            array(
                part(
                    {
                        "target": Key(text, "Name of the target.", "name"),
                        "n_poses": Key(count, "Number of rows of the target."),
                        **within("position", METRICS["m"]),
                    }
                )
            ),
            "Metrics of each target, if there are several.",
        ),
        "notes": Key(array(text), "Notes on the figures: assumptions and limitations."),
        **WARNINGS,
    }
)
"""Keys of the estimate itself."""
_DATA = part(
    {
        "noise": Key(
            part(
                {
                    "position_m": Key(size | None, "Standard deviation along an axis, m."),
                    "orientation_rad": Key(size | None, "Standard deviation about an axis, rad."),
                    "source": Key(choice("file"), "Source of the noise: always the file."),
                }
            )
            | None,
            "Measurement noise that the file states, rms over poses; null if it states none.",
        ),
        "robot": Key(ROBOT | None),
        "poses": Key(POSES),
        "position_by_frame": Key(
            part(
                {
                    "base": Key(
                        _FRAME,
                        "Axes of the measuring frame.",
                    ),
                    "tool": Key(
                        _FRAME,
                        "Axes of the commanded target; missing if no orientation was commanded.",
                        optional=True,
                    ),
                }
            ),
            "Position errors in the axes of each frame.",
        ),
    }
)
"""Keys of the data: measurement noise, robot, every pose, and position errors in both frames."""
ESTIMATE = part(
    {**(_ESTIMATE.keys or {}), **(_DATA.keys or {}), "outside_validity": OUTSIDE_KEY, "gate": GATE_KEY},
    about="Cartesian error at each measured pose, its covariances, and an accuracy grade.",
)
_ENTRY = part(
    {
        "file": Key(text, "Name of the file.", "name"),
        "done": Key(flag, "True if there is an estimate.", lambda outcome: not outcome.failed),
        "exit_status": Key(choice(0, 1, 2, 3, 4, 5), "Exit status of the command on this file alone."),
        "problems": Key(
            array(
                part(
                    {
                        "message": Key(text, "Description of the problem."),
                        "line": Key(count | None, "Line of the file."),
                        "row": Key(ordinal | None, "Row of a file without lines."),
                        "column": Key(text | None, "Column of the file."),
                        "fix": Key(text | None, "Advice to fix the problem."),
                    }
                )
            ),
            "Problems of the file.",
        ),
        "n_problems": Key(count, "Total number of problems."),
        "summary": Key(
            part(
                {
                    "n_poses": Key(count, "Measured poses."),
                    "rms_m": Key(size, "Rms position error, m."),
                    "p95_m": Key(size, "95th percentile of the position error, m."),
                    "max_m": Key(size, "Largest length of an error, m."),
                    "rms_rad": Key(size | None, "Rms orientation error, rad, or null.", "orientation_rms"),
                    "grade": Key(text, "Grade."),
                    "demonstrated": Key(flag, "True if the grade is confirmed."),
                }
            )
            | None,
            "Main figures; null if there are none.",
            "headline",
        ),
        "gate": Key(GATE_RESULT | None, "Gate outcome; null without a gate."),
        "written": Key(text | None, "Name of the result's file, or null."),
        "result": Key(table(), "Complete result, as robacc.estimate/1.", lambda _: LEFT_OUT, optional=True),
    }
)
"""One file of several."""
ESTIMATE_MANY = part(
    {
        "n_files": Key(count, "Number of files."),
        "n_failed": Key(count, "Number of files without an estimate."),
        "results": Key(
            array(_ENTRY),
            "Files, in the order given.",
        ),
    },
    about="Estimates of several files.",
)


def payload(result: EstimateResult) -> Document:
    """Return the keys of the estimate; arrays stay arrays, which :mod:`robacc.io.json_text` writes."""
    return _ESTIMATE.write(result)


def pose_payload(
    data: Measurements,
    robot: Robot | None,
    registered: Robot | None,
    by_frame: Mapping[ErrorFrame, FrameStatistics],
) -> Document:
    """Return the keys of the data: measurement noise, robot, every pose, and position errors in both frames."""
    noise = None
    if data.sigma_position is not None or data.sigma_rotation is not None:
        noise = dict(zip(("position_m", "orientation_rad"), data.stated_noise, strict=True), source="file")
    return _DATA.write(
        {
            "noise": noise,
            "robot": robot_document(robot, data.q, registered),
            "poses": pose_document(data, data.position - by_frame["base"].errors),
            "position_by_frame": by_frame,
        }
    )


def per_pose_csv(result: EstimateResult, data: Measurements) -> str:
    """Return a CSV row for each pose: its line, its ids, the error vector and its length, in m and rad."""
    columns: dict[str, Iterable[Any] | None] = {"line": map(data.line, range(data.n))}
    columns |= {name: getattr(data, name) for name in ("pose", "cycle", "visit", "target")}
    for prefix, unit, errors in (("d", "m", result.errors.position), ("r", "rad", result.errors.rotation)):
        if errors is not None:
            columns |= {f"{prefix}{axis}_{unit}": row for axis, row in zip("xyz", errors, strict=True)}
            columns[f"error_{unit}"] = np.sqrt(np.einsum("in,in->n", errors, errors))
    return csv_text(columns)


def many_pieces(head: Mapping[str, Any], outcomes: Iterable[tuple[FileOutcome, str | None]]) -> Iterator[str]:
    """Yield the document's text in pieces, so that memory holds one file's result at a time.

    Args:
        head: Keys about all files; their ``results`` follow.
        outcomes: Outcome of each file, and the path of its JSON result, which becomes its key ``result``.
    """
    yield json_text(head).removesuffix("\n}\n") + ',\n  "results": ['
    separator = "\n    "
    for outcome, path in outcomes:
        text = json_text(significant_document(_ENTRY.write(outcome))).removesuffix("\n}\n")
        yield separator + text.replace("\n", "\n    ")
        separator = ",\n    "
        if path is not None:
            result = Path(path).read_text(encoding="utf-8").removesuffix("\n")
            yield ',\n      "result": ' + result.replace("\n", "\n      ")
        yield "\n    }"
    yield "\n  ]\n}\n"
