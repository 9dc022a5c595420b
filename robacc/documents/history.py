"""Keys of ``robacc history`` and its forms, of ``health`` and of ``fleet``."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from itertools import chain
from typing import Any

from robacc.documents.keys import (
    WARNINGS,
    Document,
    Key,
    array,
    choice,
    count,
    flag,
    number,
    part,
    parts,
    share,
    size,
    table,
    text,
)


def date_text(seconds: float) -> str:
    """Return a time in s since 1970 as ISO 8601, UTC, to the second."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


TEST = part(
    arm=Key(text, "Serial number of the arm, else the robot's name."),
    at=Key(text, "Time of the test, ISO 8601, UTC."),
    name=Key(text, "Name of the result file."),
    command=Key(text, "Command that made the result."),
    n_poses=Key(count, "Number of measured poses."),
    rms_m=Key(number | None, "Rms position error, m; of a fit, of its model on held-out poses."),
    grade=Key(text | None, "Grade; null without one."),
    temperature_c=Key(number | None, "Mean temperature, °C; null where none was recorded."),
)
HISTORY_ADD = part(
    added=Key(count, "Number of results that were added."),
    known=Key(count, "Number of results that the database had already."),
    n_results=Key(count, "Number of results of the database."),
    arms=Key(array(text), "Arms of the database."),
).named(about="Results that were added to a database.")
HISTORY_SHOW = part(results=Key(array(TEST), "Results by arm and date.")).named(about="Results of a database.")
VALUE = {
    "at": Key(text, "Time of the test, ISO 8601, UTC."),
    "value": Key(number, "Value."),
    "std": Key(number | None, "Standard deviation; null without one."),
}
HISTORY_TREND = part(
    key=Key(text, "Figure or coefficient."),
    unit=Key(text, "Unit of the values."),
    trends=Key(
        parts(
            arm=Key(text, "The arm."),
            values=Key(parts(**VALUE), "Values by date."),
            rate_per_year=Key(number | None, "Slope of a straight line; null for fewer than 3 values."),
            low=Key(number | None, "Lower end of the slope's 95 % interval."),
            high=Key(number | None, "Upper end of the slope's 95 % interval."),
        ),
        "Values of each arm.",
    ),
).named(about="One figure or coefficient over time.")
CHANGE = part(
    arm=Key(text, "The arm."),
    key=Key(text, "Coefficient or figure that changed."),
    kind=Key(
        choice("step", "ramp", "temperature", "setup"),
        "step: from one test to the next. ramp: steadily. temperature: with it. setup: base or target set up anew.",
    ),
    at=Key(text, "First test that shows the change; the last test for a temperature, ISO 8601, UTC."),
    earliest=Key(text, "Earliest such test that the data allow, 95 %, ISO 8601, UTC."),
    latest=Key(text, "Latest such test that the data allow, 95 %, ISO 8601, UTC."),
    size=Key(number, "Step, rise of a ramp until the last test, or change per kelvin."),
    low=Key(number, "Lower end of the 95 % interval."),
    high=Key(number, "Upper end of the 95 % interval."),
    unit=Key(text, "Unit of the size."),
    p_value=Key(share, "Probability of such a change in any series of the arm without one, at most."),
    confirmed=Key(flag, "Whether two tests or more show it."),
    alternatives=Key(array(text), "Other kinds and coefficients that explain the values as well."),
)
LIMITS = Key(
    parts(
        key=Key(text, "Coefficient or figure."),
        limit=Key(size, "Step that the next test finds with a probability of 95 %."),
        unit=Key(text, "Unit."),
    ),
    "Detection limits.",
)


def _by_kind(changes: Sequence[Any], limits: Iterable[Any]) -> Document:
    """Return the most certain change by kind and key, as gates name it; without one 0, up to the detection limit."""
    known = {
        (kind, limit["key"]): (limit["unit"], 0.0, 0.0, limit["limit"])
        for kind in ("step", "ramp", "setup")
        for limit in limits
    }
    for change in reversed(changes):
        low, high = sorted((abs(change["low"]), abs(change["high"])))
        low *= change["low"] * change["high"] > 0.0
        known[change["kind"], change["key"]] = (change["unit"], abs(change["size"]), low, high)
    sizes: Document = {}
    for (kind, key), (unit, value, low, high) in known.items():
        path = key.split(".")
        name, node = path.pop(), sizes
        for step in (kind, *path):
            node = node.setdefault(step, {})
        name = name if unit in ("1", "") else f"{name}_{unit}"
        node[name] = value
        ends = {"lower": low, "upper": high, "upper_bound": high}
        node.setdefault("intervals", {})[name] = {**ends, "confidence": 0.95}
    return sizes


_ABOUT_KINDS = "Most certain change by kind and key, for gates; without one 0, up to the detection limit."
HISTORY_CHANGES = part(
    changes=Key(
        array(CHANGE),
        "Changes of all arms.",
        lambda result: [{"arm": arm, **change} for arm, changes in result.changes.items() for change in changes],
    ),
    arms=Key(
        parts(
            arm=Key(text, "The arm."),
            n_tests=Key(count, "Number of its tests."),
            level=Key(share, "Probability of a false alarm in a test, at most: one in a year."),
            detection_limits=LIMITS,
            series=Key(
                parts(
                    key=Key(text, "Coefficient or figure."),
                    unit=Key(text, "Unit."),
                    values=Key(
                        parts(
                            **VALUE,
                            expected=Key(number, "Value with the changes found."),
                            low=Key(number, "Limit below which a test is an alarm."),
                            high=Key(number, "Limit above which a test is an alarm."),
                        ),
                        "Values by date.",
                    ),
                ),
                "Control charts: of one arm, of all series; of several, of those that changed.",
            ),
            notes=Key(array(text), "Assumptions and limitations."),
        ),
        "Each arm.",
    ),
    history=Key(
        table(),
        _ABOUT_KINDS,
        lambda result: _by_kind(
            [*chain(*result.changes.values())], chain(*(arm["detection_limits"] for arm in result.arms))
        ),
    ),
).named(about="What changed, when, by how much, and how.")
HEALTH = part(
    arm=Key(text, "The arm."),
    n_poses=Key(count, "Number of measured poses."),
    rms_m=Key(size, "Rms position error of the model with base and target registered, m.", "rms"),
    level=Key(share, "Probability of a false alarm, at most."),
    changes=Key(
        array(CHANGE),
        "Coefficients that moved since the last full test.",
        lambda result: [{"arm": result.arm, **change} for change in result.changes],
    ),
    detection_limits=LIMITS,
    hidden=Key(array(text), "Coefficients whose change these poses cannot distinguish from one of the set-up."),
    history=Key(table(), _ABOUT_KINDS, lambda result: _by_kind(result.changes, result.detection_limits)),
    **WARNINGS,
).named(about="Quick test of an arm against the model of its last full test.")

FLEET = part(
    n_arms=Key(count, "Number of arms."),
    coefficients=Key(
        parts(
            key=Key(text, "Coefficient."),
            unit=Key(text, "Unit."),
            n_arms=Key(count, "Arms that count: those that know it and are like the others."),
            mean=Key(number, "Mean over the arms."),
            mean_low=Key(number, "Lower end of the 95 % interval of the mean."),
            mean_high=Key(number, "Upper end."),
            std=Key(size, "Standard deviation between arms, without the noise of their fits."),
            std_low=Key(size, "Lower end of the 95 % interval of the standard deviation."),
            std_high=Key(size, "Upper end."),
        ),
        "Coefficients over the arms.",
    ),
    strangers=Key(
        parts(
            arm=Key(text, "The arm."),
            key=Key(text, "Coefficient that is unlike that of the other arms."),
            unit=Key(text, "Unit."),
            value=Key(number, "Value of the arm."),
            expected=Key(number, "Mean of the other arms."),
            p_value=Key(share, "Probability of any such arm in a fleet without one, at most."),
        ),
        "Arms out of family.",
    ),
    covariance=Key(
        part(names=Key(array(text), "Coefficients."), matrix=Key(array(array(number)), "Covariance between arms, SI.")),
        "Covariance of the coefficients over the arms.",
    ),
    notes=Key(array(text), "Assumptions and limitations."),
).named(about="Coefficients over the arms of a fleet.")
