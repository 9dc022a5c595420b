"""Keys of ``robacc.compare/1``, ``robacc.compare-paired/1`` and ``robacc.correct/1`` in m and rad.

With them stand the corrected poses, and the targets of a correction as CSV.
"""

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from robacc.documents.envelope import GATE_KEY
from robacc.documents.keys import (
    FIGURES,
    NOTES,
    WARNINGS,
    Document,
    Key,
    array,
    choice,
    count,
    flag,
    integer,
    number,
    part,
    parts,
    rounded,
    share,
    size,
    table,
    text,
    texts,
)
from robacc.geometry import quaternion_from_rotation

if TYPE_CHECKING:
    from robacc.accuracy.estimation import ErrorMetrics
    from robacc.correction import Correction, ExpectedErrors

_NAME = {"name": Key(text, "Name of the result.")}
_DIFFERENCE = {
    "value": Key(number | None, "Difference in the unit of the figure."),
    "lower": Key(number | None, "Lower limit of the interval."),
    "upper": Key(number | None, "Upper limit of the interval."),
    "confidence": Key(share | None, "Confidence of the interval."),
    "p_value": Key(share | None, "Probability of a difference as large by chance; null if there is no test."),
    "paired": Key(flag, "True if the difference is tested pose by pose."),
    "n_poses": Key(count | None, "Number of commanded poses in the test."),
    "method": Key(text | None, "Method of the test."),
    "why": Key(text | None, "Reason why there is no test, or null."),
}

COMPARE = part(
    results=Key(
        array(
            part(
                name=Key(text, "Unique name of the result."),
                command=Key(text, "Command that made the result."),
                robacc=Key(text, "Version of robacc that made the result.", "version"),
                sha256=Key(text, "SHA-256 of the result's file.", "digest"),
                n_poses=Key(count, "Number of poses."),
                robot=Key(text | None, "Name of the robot, or null."),
                grade=Key(text | None, "Grade of the result, confirmed, not confirmed or predicted."),
                made=Key(table(text), "Origin of the result: text by aspect.", "provenance"),
            ),
            least=2,
        ),
        "Compared results, in the order given.",
    ),
    baseline=Key(text, "Name of the result that the others are compared with."),
    confidence=Key(share, "Confidence of the intervals."),
    pairing=Key(
        parts(
            first=Key(text, "Name of the first."),
            second=Key(text, "Name of the second."),
            paired=Key(flag, "True if the results are compared pose by pose."),
            n_shared=Key(count, "Number of common commanded poses."),
            n_first=Key(count, "Number of commanded poses of the first."),
            n_second=Key(count, "Number of commanded poses of the second."),
        ),
        "Match of each result's poses with those of the baseline.",
    ),
    statistics=Key(
        parts(
            key=Key(text, "Key of the figure, as in position.rms."),
            unit=Key(text, "m, rad or 1."),
            values=Key(
                parts(
                    **_NAME,
                    value=Key(number, "Value in the unit."),
                    lower=Key(number | None, "Lower limit of the interval."),
                    upper=Key(number | None, "Upper limit of the interval."),
                    confidence=Key(share | None, "Confidence of the interval."),
                ),
                "Value of each result.",
            ),
            differences=Key(parts(**(_NAME | _DIFFERENCE)), "Differences to the baseline."),
        ),
        "Figures that all results have.",
    ),
    ranking=Key(
        part(
            by=Key(text, "Key of the figure."),
            unit=Key(text, "Unit of the figure."),
            level=Key(share, "Corrected p-value below which two results count as different."),
            order=Key(
                parts(
                    name=Key(text, "Name of the result."),
                    value=Key(number, "Value in the unit."),
                    letters=Key(text, "Group letters; results that share a letter do not differ significantly."),
                ),
                "Results, the smallest value first; predictions only where nothing is measured.",
            ),
            indistinguishable=Key(array(array(text)), "Groups of results that do not differ significantly."),
            pairs=Key(
                parts(
                    better=Key(text, "Name of the better result."),
                    worse=Key(text, "Name of the worse result."),
                    different=Key(flag, "True if the difference is significant."),
                    p_corrected=Key(share | None, "p-value corrected for the number of pairs (Holm)."),
                    difference=Key(
                        part(**_DIFFERENCE).named("difference", "Difference of two results in one figure."),
                        "Worse minus better.",
                    ),
                ),
                "All pairs of results.",
            ),
            text=Key(array(text), "Ranking as text."),
        ),
        "Results in the order of one figure, the smallest first.",
    ),
    grade=Key(
        part(
            wanted=Key(text, "Required grade."),
            scale=Key(text, "Grade scale."),
            statistic=Key(choice("rms", "mean_error", "p95", "max"), "Statistic that the limits apply to."),
            confidence=Key(share, "Confidence of the upper bounds."),
            demonstrated_by=Key(array(text), "Names of the results that the grade is confirmed for."),
            results=Key(
                parts(
                    name=Key(text, "Name of the result."),
                    verdict=Key(
                        choice("demonstrated", "met_not_demonstrated", "not_met"), "Verdict on the required grade."
                    ),
                    demonstrated=Key(flag, "True if the grade is confirmed."),
                    grade=Key(text, "The result's own grade."),
                    probability=Key(share | None, "Probability that the limits are truly met."),
                    position_m=Key(size | None, "Statistic of the scale, m."),
                    position_upper_bound_m=Key(size | None, "Upper bound of the statistic, m."),
                    orientation_rad=Key(size | None, "Statistic of the scale or limit, rad."),
                    orientation_upper_bound_rad=Key(size | None, "Upper bound of the statistic, rad."),
                    poses_to_demonstrate=Key(count | None, "Total number of poses that would confirm the grade."),
                    why=Key(text | None, "Reason why the grade is not confirmed."),
                ),
                "Status of each result.",
            ),
        )
        | None,
        "Status of the results against the required grade; null without one.",
    ),
    **NOTES,
    **WARNINGS,
    gate=GATE_KEY,
).named(about="Comparison of results: shared figures, significant differences, and the results that meet a grade.")

COMPARE_PAIRED = part(
    n_targets=Key(count, "Number of targets that both files have.", lambda result: len(result.names)),
    before=Key(FIGURES["m"], "Position errors before the correction.", "metrics_before"),
    after=Key(FIGURES["m"], "Position errors after the correction.", "metrics_after"),
    gain=Key(
        part(
            value_m=Key(number, "Rms before less rms after, m."),
            lower_m=Key(number | None, "Lower end of the interval, m.", "low"),
            upper_m=Key(number | None, "Upper end of the interval, m.", "high"),
            confidence=Key(number, "Confidence of the interval."),
        ),
        "Fall of the rms error.",
    ),
    loaded=Key(
        part(
            verdict=Key(
                choice("loaded", "partly_loaded", "not_loaded", "undecided"), "Whether the correction was loaded."
            ),
            slope=Key(number | None, "1 where the correction was loaded, 0 where it was not."),
            lower=Key(number | None, "Lower end of the 95 % interval."),
            upper=Key(number | None, "Upper end of the 95 % interval."),
            planned_rms_m=Key(size, "Rms of the planned displacements, m."),
        ),
        "Regression of the measured on the planned displacements.",
    ),
    promise=Key(
        part(
            kept=Key(flag, "Whether the remaining error agrees with the prediction of the model."),
            chi_square=Key(size, "Normalised squared error."),
            degrees_of_freedom=Key(integer, "Degrees of freedom."),
            p_value=Key(share, "Probability of a larger chi-square."),
            promised_rms_m=Key(size, "Expected rms of the remaining error, measurement noise included, m."),
            noise=Key(
                part(
                    position_m=Key(size, "Standard deviation of a single measurement along each axis, m."),
                    source=Key(
                        choice("given", "file", "model"),
                        "given: the option noise; file: the sigma_ columns of the poses after the "
                        "correction; model: the model's fit.",
                    ),
                    treatment=Key(
                        choice("added", "contained"),
                        "added: to the unexplained error of the model. contained: the unexplained error of the model "
                        "contains the noise of its own measurements, so this noise is only its lower bound.",
                    ),
                ),
                "Measurement noise in this test.",
                optional=True,
            ),
        )
        | None,
        "Test of the remaining error against the model's prediction; null without a model.",
    ),
    targets=Key(
        part(
            name=Key(array(text), "Name.", "names"),
            error_before_m=Key(
                array(array(number, 3)),
                "Measured less wanted position before, m.",
                lambda result: rounded(result.before),
            ),
            error_after_m=Key(
                array(array(number, 3)), "Measured less wanted position after, m.", lambda result: rounded(result.after)
            ),
        ),
        "Columns with an entry for each target.",
        "",
    ),
    notes=Key(array(text), "Assumptions and limitations."),
).named(
    about="The same targets before and after a correction: gain, remaining error, and whether the correction was "
    "loaded."
)

# A correction.


_EXPECTED = part(
    position=Key(
        part(
            rms_m=Key(size, "Rms of the predicted error, m."),
            max_m=Key(size, "Largest predicted error, m."),
            expected_rms_m=Key(size, "Rms error to expect: predicted error and uncertainty of the model, m."),
            largest_bound95_m=Key(
                size | None,
                "Largest bound of 95 % of the errors of any target, m; null if the model has no uncertainty.",
            ),
        )
        | None,
        "Position errors; null without a corrected target.",
    ),
    orientation=Key(
        part(
            rms_rad=Key(size, "Rms of the predicted error, rad."),
            max_rad=Key(size, "Largest predicted error, rad."),
            expected_rms_rad=Key(
                size | None,
                "Rms error to expect: predicted error and uncertainty of the model, rad; null if the "
                "model was fitted to positions alone.",
            ),
            largest_bound95_rad=Key(
                size | None,
                "Largest bound of 95 % of the errors of any target, rad; null if the model has no uncertainty.",
            ),
        )
        | None,
        "Orientation errors; null if only positions are wanted.",
    ),
    grades=Key(table(count) | None, "Number of targets of each grade by their bounds; null without bounds."),
)
"""Expected errors of the corrected targets together."""
_BOUNDS = part(
    rms_m=Key(
        array(number), "Rms position error to expect: predicted error and uncertainty of the model, m.", "position_rms"
    ),
    rms_rad=Key(
        array(number) | None,
        "Rms orientation error to expect, rad; null if the model was fitted to positions alone.",
        "orientation_rms",
    ),
    bound95_m=Key(
        array(number) | None, "Bound of 95 % of the position errors, m; null without uncertainty.", "position_bound"
    ),
    bound95_rad=Key(
        array(number) | None,
        "Bound of 95 % of the orientation errors, rad; null without uncertainty.",
        "orientation_bound",
    ),
    grade=Key(array(text) | None, "Grade by the bounds; null without bounds.", "grades"),
)
"""Expected error of each target."""
CORRECTED = part(
    line=Key(
        array(integer),
        "Line of the file.",
        lambda targets: [targets.given.line(i) for i in range(targets.given.n)],
    ),
    pose=Key(array(text) | None, "Name; null without a column pose.", lambda targets: texts(targets.given.pose)),
    target=Key(
        array(text) | None,
        "Measured target; null without a column target.",
        lambda targets: texts(targets.given.target),
    ),
    corrected=Key(array(flag), "Whether the target is corrected.", "is_corrected"),
    cause=Key(
        array(text | None),
        "Cause of the refusal; null for a corrected target.",
        lambda targets: [None if refusal is None else refusal.cause for refusal in targets.refusals],
    ),
    reason=Key(
        array(text | None),
        "Reason of the refusal as a sentence; null for a corrected target.",
        lambda targets: [None if refusal is None else refusal.reason for refusal in targets.refusals],
    ),
    q_nominal=Key(
        array(array(number)), "Joints without a correction, rad or m.", lambda targets: rounded(targets.wanted.q)
    ),
    q=Key(array(array(number)), "Joints to command, rad or m.", lambda targets: rounded(targets.q)),
    wanted_m=Key(
        array(array(number, 3)), "Wanted position, m.", lambda targets: rounded(targets.framed_poses[0].translation)
    ),
    wanted_quaternion=Key(
        array(array(number, 4)),
        "Wanted orientation, w x y z.",
        lambda targets: rounded(quaternion_from_rotation(targets.framed_poses[0].rotation)),
    ),
    command_m=Key(
        array(array(number, 3)),
        "Position to command to a controller that takes Cartesian targets, m.",
        lambda targets: rounded(targets.framed_poses[1].translation),
    ),
    command_quaternion=Key(
        array(array(number, 4)),
        "Orientation to command, w x y z.",
        lambda targets: rounded(quaternion_from_rotation(targets.framed_poses[1].rotation)),
    ),
    correction_m=Key(
        array(array(number, 3)),
        "Command less wanted position, measuring frame, m.",
        lambda targets: rounded(targets.correction[:3]),
    ),
    correction_rad=Key(
        array(array(number, 3)),
        "Rotation vector from the wanted to the command orientation, measuring frame, rad.",
        lambda targets: rounded(targets.correction[3:]),
    ),
    error_before_m=Key(
        array(array(number, 3)),
        "Predicted position error without a correction, measuring frame, m.",
        lambda targets: rounded(targets.error_before[:3]),
    ),
    error_before_rad=Key(
        array(array(number, 3)),
        "Predicted orientation error without a correction, rad.",
        lambda targets: rounded(targets.error_before[3:]),
    ),
    error_after_m=Key(
        array(array(number, 3)),
        "Predicted position error with the correction, measuring frame, m.",
        lambda targets: rounded(targets.error_after[:3]),
    ),
    error_after_rad=Key(
        array(array(number, 3)),
        "Predicted orientation error with the correction, rad.",
        lambda targets: rounded(targets.error_after[3:]),
    ),
    before=Key(_BOUNDS, "Expected errors and bounds without a correction."),
    after=Key(_BOUNDS, "Expected errors and bounds with the correction."),
)
"""Columns with an entry for each target."""


def _extent(metrics: "ErrorMetrics | None", unit: str) -> Document | None:
    """Return RMS and largest length; None without any."""
    return (
        None if metrics is None or np.isnan(metrics.max) else {f"rms_{unit}": metrics.rms, f"max_{unit}": metrics.max}
    )


def _expected(result: "Correction", errors: "ExpectedErrors") -> Document:
    """Return the expected errors of the corrected targets together."""
    document: Document = {"position": None, "orientation": None, "grades": None}
    for name, unit, length, rms, bound in (
        ("position", "m", errors.position, errors.position_rms, errors.position_bound),
        ("orientation", "rad", errors.orientation, errors.orientation_rms, errors.orientation_bound),
    )[: 2 if result.wanted.oriented else 1]:
        if (extent := _extent(result.metrics(length), unit)) is not None:
            document[name] = {
                **extent,
                f"expected_rms_{unit}": None if rms is None else result.metrics(rms).rms,
                f"largest_bound95_{unit}": None if bound is None else result.metrics(bound).max,
            }
    if errors.grades is not None:
        counts = Counter(np.array(errors.grades)[result.is_corrected].tolist())
        # The best grade first.
        names = [*(step.grade for step in result.scale.steps), result.scale.otherwise]
        document["grades"] = {name: counts[name] for name in names}
    return document


CORRECT = part(
    n_targets=Key(count, "Number of targets."),
    n_corrected=Key(count, "Number of corrected targets."),
    n_refused=Key(
        count,
        "Number of targets that keep their nominal command.",
        lambda result: result.n_targets - result.n_corrected,
    ),
    refused=Key(table(count), "Number of refused targets by cause.", "causes"),
    frame=Key(
        choice("measuring", "base"),
        "Frame of wanted and command poses: the measuring frame, or the robot's base.",
        "setting.frame",
    ),
    given=Key(choice("joints", "poses", "poses and joints"), "Form of the targets.", "wanted.given"),
    model=Key(text, "Name of the model.", "model.name"),
    joints=Key(
        parts(name=Key(text, "Name of the joint."), type=Key(text, "revolute or prismatic.")),
        "Joints in chain order.",
        "model.variables",
    ),
    limit=Key(
        part(
            position_m=Key(number | None, "m; null without a limit.", "limits.position"),
            orientation_rad=Key(number | None, "rad; null without a limit.", "limits.orientation"),
            source=Key(choice("option", "model", "none"), "Source of the limit.", "limits_source"),
        ),
        "Largest correction.",
        "",
    ),
    weight_m_per_rad=Key(
        number | None,
        "Weight of orientation against position, m per rad; null for arms with six axes or more.",
        lambda result: result.limits.weight if len(result.model.variables) < 6 and result.wanted.oriented else None,
    ),
    correction=Key(
        part(
            position=Key(
                part(rms_m=Key(size, "Rms length, m."), max_m=Key(size, "Largest length, m.")) | None,
                "Position; null without a corrected target.",
            ),
            orientation=Key(
                part(rms_rad=Key(size, "Rms length, rad."), max_rad=Key(size, "Largest length, rad.")) | None,
                "Orientation; null if only positions are wanted.",
            ),
        ),
        "Command less wanted pose, over the corrected targets.",
        lambda result: {
            "position": _extent(result.correction_metrics.position, "m"),
            "orientation": _extent(result.correction_metrics.orientation if result.wanted.oriented else None, "rad"),
        },
    ),
    expected=Key(
        part(before=Key(_EXPECTED, "At the nominal commands."), after=Key(_EXPECTED, "At the corrected commands.")),
        "Expected errors of the corrected targets.",
        lambda result: {"before": _expected(result, result.before), "after": _expected(result, result.after)},
    ),
    scale=Key(text, "Name of the grade scale.", "scale.name"),
    targets=Key(CORRECTED, "Columns with an entry for each target.", ""),
    notes=Key(array(text), "Assumptions and limitations."),
).named(about="Commands that make the real arm reach its targets, and the expected errors before and after.")
