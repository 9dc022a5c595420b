"""Keys of ``robacc.correct/1`` in m and rad, the corrected poses, and the targets as CSV."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.documents.envelope import csv_text
from robacc.documents.keys import Document, Key, array, choice, count, flag, integer, number, part, size, table, text
from robacc.documents.parts import rounded, texts
from robacc.geometry import quaternion_from_rotation

if TYPE_CHECKING:
    from robacc.accuracy.estimation import ErrorMetrics
    from robacc.correction.correction import Correction, ExpectedErrors
    from robacc.geometry import Array, Poses
    from robacc.measurements import Measurements
    from robacc.robots.description import Robot


def _orientation_rms(errors: ExpectedErrors) -> Array | None:
    return errors.orientation_rms if errors.orientation_is_known else None


_EXPECTED = part(
    {
        "position": Key(
            part(
                {
                    "rms_m": Key(size, "Rms of the predicted error, m."),
                    "max_m": Key(size, "Largest predicted error, m."),
                    "expected_rms_m": Key(
                        size,
                        "Rms error to expect: predicted error and uncertainty of the model, m.",
                    ),
                    "largest_bound95_m": Key(
                        size | None,
                        "Largest bound of 95 % of the errors of any target, m; null if the model has no uncertainty.",
                    ),
                }
            )
            | None,
            "Position errors; null without a corrected target.",
        ),
        "orientation": Key(
            part(
                {
                    "rms_rad": Key(size, "Rms of the predicted error, rad."),
                    "max_rad": Key(size, "Largest predicted error, rad."),
                    "expected_rms_rad": Key(
                        size | None,
                        (
                            "Rms error to expect: predicted error and uncertainty of the model, rad; null if the "
                            "model was fitted to positions alone."
                        ),
                    ),
                    "largest_bound95_rad": Key(
                        size | None,
                        "Largest bound of 95 % of the errors of any target, rad; null if the model has no uncertainty.",
                    ),
                }
            )
            | None,
            "Orientation errors; null if only positions are wanted.",
        ),
        "grades": Key(
            table(count) | None,
            "Number of targets of each grade by their bounds; null without bounds.",
        ),
    }
)
"""Expected errors of the corrected targets together."""
_BOUNDS = part(
    {
        "rms_m": Key(
            array(number),
            "Rms position error to expect: predicted error and uncertainty of the model, m.",
            "position_rms",
        ),
        "rms_rad": Key(
            array(number) | None,
            "Rms orientation error to expect, rad; null if the model was fitted to positions alone.",
            _orientation_rms,
        ),
        "bound95_m": Key(
            array(number) | None,
            "Bound of 95 % of the position errors, m; null without uncertainty.",
            "position_bound",
        ),
        "bound95_rad": Key(
            array(number) | None,
            "Bound of 95 % of the orientation errors, rad; null without uncertainty.",
            "orientation_bound",
        ),
        "grade": Key(array(text) | None, "Grade by the bounds; null without bounds.", "grades"),
    }
)
"""Expected error of each target."""
_TARGETS = part(
    {
        "line": Key(array(integer), "Line of the file."),
        "pose": Key(
            array(text) | None,
            "Name; null without a column pose.",
        ),
        "target": Key(
            array(text) | None,
            "Measured target; null without a column target.",
        ),
        "corrected": Key(array(flag), "Whether the target is corrected.", "is_corrected"),
        "cause": Key(
            array(text | None),
            "Cause of the refusal; null for a corrected target.",
            lambda targets: [None if refusal is None else refusal.cause.value for refusal in targets.refusals],
        ),
        "reason": Key(
            array(text | None),
            "Reason of the refusal as a sentence; null for a corrected target.",
            lambda targets: [None if refusal is None else refusal.reason for refusal in targets.refusals],
        ),
        "q_nominal": Key(
            array(array(number)),
            "Joints without a correction, rad or m.",
            lambda targets: rounded(targets.wanted.q),
        ),
        "q": Key(array(array(number)), "Joints to command, rad or m.", lambda targets: rounded(targets.q)),
        "wanted_m": Key(array(array(number, 3)), "Wanted position, m."),
        "wanted_quaternion": Key(
            array(array(number, 4)),
            "Wanted orientation, w x y z.",
        ),
        "command_m": Key(
            array(array(number, 3)),
            "Position to command to a controller that takes Cartesian targets, m.",
        ),
        "command_quaternion": Key(
            array(array(number, 4)),
            "Orientation to command, w x y z.",
        ),
        "correction_m": Key(
            array(array(number, 3)),
            "Command less wanted position, measuring frame, m.",
            lambda targets: rounded(targets.correction[:3]),
        ),
        "correction_rad": Key(
            array(array(number, 3)),
            "Rotation vector from the wanted to the command orientation, measuring frame, rad.",
            lambda targets: rounded(targets.correction[3:]),
        ),
        "error_before_m": Key(
            array(array(number, 3)),
            "Predicted position error without a correction, measuring frame, m.",
            lambda targets: rounded(targets.error_before[:3]),
        ),
        "error_before_rad": Key(
            array(array(number, 3)),
            "Predicted orientation error without a correction, rad.",
            lambda targets: rounded(targets.error_before[3:]),
        ),
        "error_after_m": Key(
            array(array(number, 3)),
            "Predicted position error with the correction, measuring frame, m.",
            lambda targets: rounded(targets.error_after[:3]),
        ),
        "error_after_rad": Key(
            array(array(number, 3)),
            "Predicted orientation error with the correction, rad.",
            lambda targets: rounded(targets.error_after[3:]),
        ),
        "before": Key(
            _BOUNDS,
            "Expected errors and bounds without a correction.",
        ),
        "after": Key(
            _BOUNDS,
            "Expected errors and bounds with the correction.",
        ),
    }
)
"""Columns with an entry for each target."""
CORRECT = part(
    {
        "n_targets": Key(count, "Number of targets."),
        "n_corrected": Key(count, "Number of corrected targets."),
        "n_refused": Key(
            count,
            "Number of targets that keep their nominal command.",
            lambda result: result.n_targets - result.n_corrected,
        ),
        "refused": Key(
            table(count),
            "Number of refused targets by cause.",
            lambda result: {cause.value: count for cause, count in result.causes.items()},
        ),
        "frame": Key(
            choice("measuring", "base"),
            "Frame of wanted and command poses: the measuring frame, or the robot's base.",
            "targets.pair.frame",
        ),
        "given": Key(choice("joints", "poses", "poses and joints"), "Form of the targets.", "targets.wanted.given"),
        "model": Key(text, "Name of the model."),
        "joints": Key(
            array(
                part(
                    {
                        "name": Key(text, "Name of the joint."),
                        "type": Key(text, "revolute or prismatic."),
                    }
                )
            ),
            "Joints in chain order.",
        ),
        "limit": Key(
            part(
                {
                    "position_m": Key(number | None, "m; null without a limit.", "limits.position"),
                    "orientation_rad": Key(number | None, "rad; null without a limit.", "limits.orientation"),
                    "source": Key(choice("option", "model", "none"), "Source of the limit.", "limits_source"),
                }
            ),
            "Largest correction.",
            "",
        ),
        "weight_m_per_rad": Key(
            number | None,
            "Weight of orientation against position, m per rad; null for arms with six axes or more.",
        ),
        "correction": Key(
            part(
                {
                    "position": Key(
                        part(
                            {
                                "rms_m": Key(size, "Rms length, m."),
                                "max_m": Key(size, "Largest length, m."),
                            }
                        )
                        | None,
                        "Position; null without a corrected target.",
                    ),
                    "orientation": Key(
                        part(
                            {
                                "rms_rad": Key(size, "Rms length, rad."),
                                "max_rad": Key(size, "Largest length, rad."),
                            }
                        )
                        | None,
                        "Orientation; null if only positions are wanted.",
                    ),
                }
            ),
            "Command less wanted pose, over the corrected targets.",
        ),
        "expected": Key(
            part(
                {
                    "before": Key(
                        _EXPECTED,
                        "At the nominal commands.",
                    ),
                    "after": Key(
                        _EXPECTED,
                        "At the corrected commands.",
                    ),
                }
            ),
            "Expected errors of the corrected targets.",
        ),
        "scale": Key(text, "Name of the grade scale.", "scale.name"),
        "targets": Key(
            _TARGETS,
            "Columns with an entry for each target.",
        ),
        "notes": Key(array(text), "Assumptions and limitations."),
    },
    about="Commands that make the real arm reach its targets, and the expected errors before and after.",
)


def payload(result: Correction, given: Measurements, model: Robot) -> Document:
    """Return the keys of a correction; arrays stay arrays, with targets first."""
    targets, oriented = result.targets, result.targets.wanted.oriented
    metrics = result.correction_metrics
    wanted, command = framed_poses(result)
    return CORRECT.write(
        result,
        model=model.name,
        joints=model.variables,
        weight_m_per_rad=result.limits.weight if len(model.variables) < 6 and oriented else None,
        correction={
            "position": _extent(metrics.position, "m"),
            "orientation": _extent(metrics.orientation, "rad") if oriented else None,
        },
        expected={
            "before": _expected(result, result.before, oriented),
            "after": _expected(result, result.after, oriented),
        },
        targets=_TARGETS.write(
            targets,
            line=[given.line(i) for i in range(given.n)],
            pose=texts(given.pose),
            target=texts(given.target),
            wanted_m=rounded(wanted.translation),
            wanted_quaternion=rounded(quaternion_from_rotation(wanted.rotation)),
            command_m=rounded(command.translation),
            command_quaternion=rounded(quaternion_from_rotation(command.rotation)),
            before=result.before,
            after=result.after,
        ),
    )


def _extent(metrics: ErrorMetrics | None, unit: str) -> Document | None:
    """Return RMS and largest length; None without any."""
    if metrics is None or math.isnan(metrics.max):
        return None
    return {f"rms_{unit}": metrics.rms, f"max_{unit}": metrics.max}


def _expected(result: Correction, errors: ExpectedErrors, oriented: bool) -> Document:
    """Return the expected errors of the corrected targets together."""

    def part(length: Array, rms: Array | None, bound: Array | None, unit: str) -> Document | None:
        extent = _extent(result.metrics(length), unit)
        if extent is None:
            return None
        return {
            **extent,
            f"expected_rms_{unit}": None if rms is None else result.metrics(rms).rms,
            f"largest_bound95_{unit}": None if bound is None else result.metrics(bound).max,
        }

    # The best grade first.
    names = [*(step.grade for step in result.scale.steps), result.scale.otherwise]
    counts = Counter(() if errors.grades is None else np.array(errors.grades)[result.targets.is_corrected].tolist())
    return {
        "position": part(errors.position, errors.position_rms, errors.position_bound, "m"),
        "orientation": part(errors.orientation, _orientation_rms(errors), errors.orientation_bound, "rad")
        if oriented
        else None,
        "grades": None if errors.grades is None else {name: counts[name] for name in names},
    }


def framed_poses(result: Correction) -> tuple[Poses, Poses]:
    """Return wanted and commanded poses in the frame of the Cartesian targets."""
    pair = result.targets.pair
    return pair.from_measuring(result.targets.wanted.poses), pair.from_measuring(result.targets.command)


def corrected_poses(result: Correction, given: Measurements) -> Measurements:
    """Return the targets with their corrected joints, and the wanted poses as commanded poses."""
    wanted, _ = framed_poses(result)
    return dataclasses.replace(
        given,
        position=np.zeros((3, given.n)),
        rotation=None,
        q=result.targets.q,
        commanded_position=wanted.translation,
        commanded_rotation=wanted.rotation if result.targets.wanted.oriented else None,
        sigma_position=None,
        sigma_rotation=None,
        payload=result.targets.data.payload,
        temperature=result.targets.data.temperature,
        time=result.targets.data.time,
    )


def per_target_csv(result: Correction, given: Measurements) -> str:
    """Return a CSV row for each target: its line and ids, the command, the correction and the expected errors."""
    targets, (_, command) = result.targets, framed_poses(result)
    stages = {"before": result.before, "after": result.after}
    columns: dict[str, Iterable[Any] | None] = {
        "line": map(given.line, range(given.n)),
        "pose": given.pose,
        "target": given.target,
        "corrected": ["yes" if refusal is None else "no" for refusal in targets.refusals],
    }
    for names, values in (
        (("command_x_m", "command_y_m", "command_z_m"), command.translation),
        (("command_qw", "command_qx", "command_qy", "command_qz"), quaternion_from_rotation(command.rotation)),
        (("dx_m", "dy_m", "dz_m", "drx_rad", "dry_rad", "drz_rad"), targets.correction),
    ):
        columns |= dict(zip(names, values, strict=True))
    for stage, errors in stages.items():
        columns |= {
            f"{stage}_m": errors.position,
            f"{stage}_rad": errors.orientation,
            f"{stage}_rms_m": errors.position_rms,
            f"{stage}_rms_rad": _orientation_rms(errors),
            f"{stage}_bound95_m": errors.position_bound,
            f"{stage}_bound95_rad": errors.orientation_bound,
        }
    columns |= {f"{stage}_grade": errors.grades for stage, errors in stages.items()}
    columns["reason"] = ["" if refusal is None else refusal.reason for refusal in targets.refusals]
    return csv_text(columns)
