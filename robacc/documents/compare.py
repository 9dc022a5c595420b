"""Keys of ``robacc.compare/1`` and ``robacc.compare-paired/1``, in m and rad."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robacc.documents.gate import GATE_KEY
from robacc.documents.keys import (
    Document,
    Key,
    array,
    choice,
    count,
    flag,
    integer,
    number,
    part,
    share,
    size,
    table,
    text,
)
from robacc.documents.parts import FIGURES, NOTES, WARNINGS, rounded

if TYPE_CHECKING:
    from robacc.comparison.comparing import ResultComparison

_NAME = {"name": Key(text, "Name of the result.")}
_DIFFERENCE = {
    "value": Key(number | None, "Difference in the unit of the figure."),
    "lower": Key(number | None, "Lower limit of the interval.", "interval.lower"),
    "upper": Key(number | None, "Upper limit of the interval.", "interval.upper"),
    "confidence": Key(share | None, "Confidence of the interval.", "interval.confidence"),
    "p_value": Key(share | None, "Probability of a difference as large by chance; null if there is no test."),
    "paired": Key(flag, "True if the difference is tested pose by pose."),
    "n_poses": Key(count | None, "Number of commanded poses in the test."),
    "method": Key(text | None, "Method of the test.", "interval.method"),
    "why": Key(text | None, "Reason why there is no test, or null.", "interval.why"),
}
DIFFERENCE = part(_DIFFERENCE, "difference", "Difference of two results in one figure.")
_TO_BASELINE = part(_NAME | _DIFFERENCE)
_VALUE = part(
    {
        **_NAME,
        "value": Key(number, "Value in the unit."),
        "lower": Key(number | None, "Lower limit of the interval.", "interval.lower"),
        "upper": Key(number | None, "Upper limit of the interval.", "interval.upper"),
        "confidence": Key(share | None, "Confidence of the interval.", "interval.confidence"),
    }
)
_ROW = part(
    {
        "key": Key(text, "Key of the figure, as in position.rms."),
        "unit": Key(text, "m, rad or 1."),
        "values": Key(array(_VALUE), "Value of each result."),
        "differences": Key(array(_TO_BASELINE), "Differences to the baseline."),
    }
)
"""One figure of every result."""


def _rows(comparison: ResultComparison) -> list[Document]:
    """Return the figures with the names of the results."""
    names = [result.name for result in comparison.results]
    return [
        _ROW.write(
            row,
            values=[_VALUE.write(figure, name=name) for name, figure in zip(names, row.figures, strict=True)],
            differences=[
                _TO_BASELINE.write(difference, name=name)
                for name, difference in zip(names, row.differences, strict=True)
                if difference is not None
            ],
        )
        for row in comparison.rows
    ]


COMPARE = part(
    {
        "results": Key(
            array(
                part(
                    {
                        "name": Key(text, "Unique name of the result."),
                        "command": Key(text, "Command that made the result."),
                        "robacc": Key(text, "Version of robacc that made the result.", "version"),
                        "sha256": Key(text, "SHA-256 of the result's file.", "digest"),
                        "n_poses": Key(count, "Number of poses."),
                        "robot": Key(text | None, "Name of the robot, or null."),
                        "grade": Key(text | None, "Grade of the result, confirmed, not confirmed or predicted."),
                        "made": Key(table(text), "Origin of the result: text by aspect.", "provenance"),
                    }
                ),
                least=2,
            ),
            "Compared results, in the order given.",
        ),
        "baseline": Key(text, "Name of the result that the others are compared with."),
        "confidence": Key(share, "Confidence of the intervals."),
        "pairing": Key(
            array(
                part(
                    {
                        "first": Key(text, "Name of the first."),
                        "second": Key(text, "Name of the second."),
                        "paired": Key(flag, "True if the results are compared pose by pose."),
                        "n_shared": Key(count, "Number of common commanded poses.", "shared"),
                        "n_first": Key(count, "Number of commanded poses of the first."),
                        "n_second": Key(count, "Number of commanded poses of the second."),
                    }
                )
            ),
            "Match of each result's poses with those of the baseline.",
        ),
        "statistics": Key(array(_ROW), "Figures that all results have.", _rows),
        "ranking": Key(
            part(
                {
                    "by": Key(text, "Key of the figure.", "key"),
                    "unit": Key(text, "Unit of the figure."),
                    "level": Key(share, "Corrected p-value below which two results count as different."),
                    "order": Key(
                        array(
                            part(
                                {
                                    "name": Key(text, "Name of the result."),
                                    "value": Key(number, "Value in the unit."),
                                    "letters": Key(
                                        text, "Group letters; results that share a letter do not differ significantly."
                                    ),
                                }
                            )
                        ),
                        "Results, the smallest value first; predictions only where nothing is measured.",
                        lambda ranking: [
                            {"name": name, "value": value, "letters": letters}
                            for name, value, letters in zip(ranking.names, ranking.values, ranking.letters, strict=True)
                        ],
                    ),
                    "indistinguishable": Key(
                        array(array(text)),
                        "Groups of results that do not differ significantly.",
                        lambda ranking: [list(group) for group in ranking.groups if len(group) > 1],
                    ),
                    "pairs": Key(
                        array(
                            part(
                                {
                                    "better": Key(text, "Name of the better result."),
                                    "worse": Key(text, "Name of the worse result."),
                                    "different": Key(flag, "True if the difference is significant."),
                                    "p_corrected": Key(
                                        share | None, "p-value corrected for the number of pairs (Holm)."
                                    ),
                                    "difference": Key(DIFFERENCE, "Worse minus better."),
                                }
                            )
                        ),
                        "All pairs of results.",
                    ),
                    "text": Key(array(text), "Ranking as text.", lambda ranking: ranking.sentences()),
                }
            ),
            "Results in the order of one figure, the smallest first.",
        ),
        "grade": Key(
            part(
                {
                    "wanted": Key(text, "Required grade.", "required_grade"),
                    "scale": Key(text, "Grade scale.", "scale.name"),
                    "statistic": Key(
                        choice("rms", "mean_error", "p95", "max"),
                        "Statistic that the limits apply to.",
                        "scale.statistic",
                    ),
                    "confidence": Key(share, "Confidence of the upper bounds.", "scale.confidence"),
                    "demonstrated_by": Key(
                        array(text),
                        "Names of the results that the grade is confirmed for.",
                        lambda comparison: [
                            status.name for status in comparison.grade_statuses if status.verdict == "demonstrated"
                        ],
                    ),
                    "results": Key(
                        array(
                            part(
                                {
                                    "name": Key(text, "Name of the result."),
                                    "verdict": Key(
                                        choice("demonstrated", "met_not_demonstrated", "not_met"),
                                        "Verdict on the required grade.",
                                    ),
                                    "demonstrated": Key(
                                        flag,
                                        "True if the grade is confirmed.",
                                        lambda status: status.verdict == "demonstrated",
                                    ),
                                    "grade": Key(text, "The result's own grade."),
                                    "probability": Key(share | None, "Probability that the limits are truly met."),
                                    "position_m": Key(size | None, "Statistic of the scale, m.", "position.value"),
                                    "position_upper_bound_m": Key(
                                        size | None, "Upper bound of the statistic, m.", "position.interval.upper_bound"
                                    ),
                                    "orientation_rad": Key(
                                        size | None, "Statistic of the scale or limit, rad.", "orientation.value"
                                    ),
                                    "orientation_upper_bound_rad": Key(
                                        size | None,
                                        "Upper bound of the statistic, rad.",
                                        "orientation.interval.upper_bound",
                                    ),
                                    "poses_to_demonstrate": Key(
                                        count | None, "Total number of poses that would confirm the grade."
                                    ),
                                    "why": Key(text | None, "Reason why the grade is not confirmed."),
                                }
                            )
                        ),
                        "Status of each result.",
                        "grade_statuses",
                    ),
                }
            )
            | None,
            "Status of the results against the required grade; null without one.",
            lambda comparison: None if comparison.scale is None else comparison,
        ),
        **NOTES,
        **WARNINGS,
        "gate": GATE_KEY,
    },
    about="Comparison of results: shared figures, significant differences, and the results that meet a grade.",
)

COMPARE_PAIRED = part(
    {
        "n_targets": Key(count, "Number of targets that both files have.", lambda result: len(result.names)),
        "before": Key(FIGURES["m"], "Position errors before the correction.", "metrics_before"),
        "after": Key(FIGURES["m"], "Position errors after the correction.", "metrics_after"),
        "gain": Key(
            part(
                {
                    "value_m": Key(number, "Rms before less rms after, m."),
                    "lower_m": Key(number | None, "Lower end of the interval, m.", "low"),
                    "upper_m": Key(number | None, "Upper end of the interval, m.", "high"),
                    "confidence": Key(number, "Confidence of the interval."),
                }
            ),
            "Fall of the rms error.",
        ),
        "loaded": Key(
            part(
                {
                    "verdict": Key(
                        choice("loaded", "partly_loaded", "not_loaded", "undecided"),
                        "Whether the correction was loaded.",
                        lambda it: it.verdict.replace(" ", "_"),
                    ),
                    "slope": Key(number | None, "1 where the correction was loaded, 0 where it was not."),
                    "lower": Key(number | None, "Lower end of the 95 % interval.", "low"),
                    "upper": Key(number | None, "Upper end of the 95 % interval.", "high"),
                    "planned_rms_m": Key(size, "Rms of the planned displacements, m."),
                }
            ),
            "Regression of the measured on the planned displacements.",
        ),
        "promise": Key(
            part(
                {
                    "kept": Key(flag, "Whether the remaining error agrees with the prediction of the model."),
                    "chi_square": Key(size, "Normalised squared error."),
                    "degrees_of_freedom": Key(integer, "Degrees of freedom."),
                    "p_value": Key(share, "Probability of a larger chi-square."),
                    "promised_rms_m": Key(size, "Expected rms of the remaining error, measurement noise included, m."),
                    "noise": Key(
                        part(
                            {
                                "position_m": Key(
                                    size, "Standard deviation of a single measurement along each axis, m."
                                ),
                                "source": Key(
                                    choice("given", "file", "model"),
                                    (
                                        "given: the option noise; file: the sigma_ columns of the poses after the "
                                        "correction; model: the model's fit."
                                    ),
                                ),
                                "treatment": Key(
                                    choice("added", "contained"),
                                    (
                                        "added: to the unexplained error of the model. contained: the unexplained "
                                        "error of the model contains the noise of its own measurements, so this "
                                        "noise is only its lower bound."
                                    ),
                                ),
                            }
                        ),
                        "Measurement noise in this test.",
                        optional=True,
                    ),
                }
            )
            | None,
            "Test of the remaining error against the model's prediction; null without a model.",
        ),
        "targets": Key(
            part(
                {
                    "name": Key(array(text), "Name.", "names"),
                    "error_before_m": Key(
                        array(array(number, 3)),
                        "Measured less wanted position before, m.",
                        lambda result: rounded(result.before),
                    ),
                    "error_after_m": Key(
                        array(array(number, 3)),
                        "Measured less wanted position after, m.",
                        lambda result: rounded(result.after),
                    ),
                }
            ),
            "Columns with an entry for each target.",
            "",
        ),
        "notes": Key(array(text), "Assumptions and limitations."),
    },
    about=(
        "The same targets before and after a correction: gain, remaining error, and whether the correction was loaded."
    ),
)
