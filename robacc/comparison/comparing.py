"""Results side by side: differences, a ranking and grades; and the same targets before and after a correction."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations
from typing import Any

import numpy as np

from robacc.accuracy.error_statistics import Gain, error_statistics, paired_gain
from robacc.accuracy.estimation import ErrorMetrics, pose_metrics
from robacc.accuracy.grade import Quantity, Scale, default_scale, grade
from robacc.comparison.stored_results import (
    FITS,
    NO_TEST_OF_MAXIMUM,
    QUANTITIES,
    RESAMPLED,
    VECTORIAL,
    ComparedResult,
    Difference,
    ErrorSet,
    difference,
    from_intervals,
    pair_poses,
    unit_of,
)
from robacc.errors import Problem, applying, by_key, given, refuse
from robacc.fitting.parameters import absorb_constants
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.prediction.model_uncertainty import completed, fitted_jacobian, model_fit, model_uncertainty
from robacc.quantities import size
from robacc.robots.description import Robot
from robacc.statistics.intervals import EstimatedValue, Interval, chi2_sf, student_quantile

# Tests of every pair of results, corrected for their number, and groups of results that do not differ.
#
# Sources: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
# (1979) 65-70; H.-P. Piepho, "An algorithm for a letter-based representation of all-pairwise comparisons", Journal of
# Computational and Graphical Statistics 13 (2004) 456-466 (insert and absorb).


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Return p-values corrected for their number, which bounds the probability of any false difference.

    None stands for a pair without a test, stays None and does not count.
    """
    tested = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    raised = np.maximum.accumulate([min(1.0, (len(tested) - rank) * p) for rank, (p, _) in enumerate(tested)])
    corrected = {i: p for (_, i), p in zip(tested, raised.tolist(), strict=True)}
    return [corrected.get(i) for i in range(len(p_values))]


def indistinguishable_groups(count: int, different: Set[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Return the largest groups of ``count`` members without a pair of ``different`` (first index below the second).

    Members with a common group do not differ; members without a common group do. The group of the first member comes
    first.
    """
    groups: list[frozenset[int]] = [frozenset(range(count))]
    for first, second in sorted(different):
        pair = {first, second}
        parts = [group - {member} for group in groups if pair <= group for member in (second, first)]
        split = [*(group for group in groups if not pair <= group), *parts]
        groups = [group for group in dict.fromkeys(split) if not any(group < other for other in split)]
    return sorted(tuple(sorted(group)) for group in groups)


def group_letters(count: int, groups: Sequence[tuple[int, ...]]) -> list[str]:
    """Return the letters of each member: a for the first group, b for the second …; past z, a1, b1 …."""
    names = [chr(ord("a") + i % 26) + (str(i // 26) if i >= 26 else "") for i in range(len(groups))]
    return ["".join(name for name, group in zip(names, groups, strict=True) if i in group) for i in range(count)]


# Status of several results against a required grade: confirmed, met but not confirmed, or not met.


def common_scale(results: Sequence[ComparedResult]) -> Scale:
    """Return the grade scale of the results.

    Raises:
        UsageError: The results have different scales, or a scale that no result stores completely.
    """
    names = sorted({result.scale_name for result in results if result.scale_name is not None})
    scales = {result.scale for result in results if result.scale is not None}
    conflict = " and ".join(names) if len(names) > 1 else f"different scales with the name {''.join(names)}"
    refuse((max(len(names), len(scales)) > 1, f"the results were graded on {conflict}; choose the scale with `scale`"))
    scale = scales.pop() if scales else default_scale()
    refuse(
        ({*names} - {scale.name}, f"no result stores the complete scale {''.join(names)}; give its file with `scale`")
    )
    return scale


def grade_statuses(
    results: Sequence[ComparedResult], scale: Scale, required_grade: str, seed: int = 0
) -> list[dict[str, Any]]:
    """Return the status of every result, in the order of the results, with the keys of the document.

    Args:
        results: The results.
        scale: Grade scale to apply.
        required_grade: A step of the scale.
        seed: Seed of the bootstrap.

    Raises:
        UsageError: The scale has no such step, or a result has no position errors to grade.
    """
    names = [step.grade for step in scale.steps]
    unknown = f"`grade`: the scale {scale.name} has no grade {required_grade!r}; it has {', '.join(names)}"
    refuse((required_grade not in names, unknown))
    return [_status(result, scale, names.index(required_grade), seed) for result in results]


def _status(result: ComparedResult, scale: Scale, rank: int, seed: int) -> dict[str, Any]:
    """Return the status by the errors, or without errors by the figures alone, which confirm nothing."""
    figures: dict[Quantity, EstimatedValue] = {}
    if "position" in result.errors:
        graded = [
            error_statistics(
                errors.vectors,
                unit,
                confidence=scale.confidence,
                groups=errors.groups,
                share=errors.share,
                seed=seed,
            )
            for quantity, unit in QUANTITIES.items()
            if (errors := result.errors.get(quantity)) is not None
        ]
        assessed = grade(graded[0], graded[1] if len(graded) > 1 else None, scale)
        figures = {name: EstimatedValue(own.value, own.interval) for name, own in assessed.quantities.items()}
        confirmed, met, own_grade = assessed.confirmed_rank <= rank, assessed.rank <= rank, assessed.grade
        missing = [f"no upper bound of {name}: {own.why}" for name, own in assessed.quantities.items() if own.why]
        why = "; ".join(missing) or f"the upper {100 * scale.confidence:g} % bound is beyond the limit"
        needed, why_not = (assessed.poses_needed(rank), why) if met and not confirmed else (None, None)
        probability = assessed.probability_within(rank)
    else:
        statistic = "max_radius95" if scale.statistic == "max" and not result.measured else scale.statistic
        figures = {name: result.figures[key] for name in QUANTITIES if (key := f"{name}.{statistic}") in result.figures}
        lacking = f"{result.name} is a result of {result.command}, which has no {statistic} error to grade"
        refuse(("position" not in figures, lacking))
        own_rank = max(scale.rank_of(name, figure.value) for name, figure in figures.items())
        confirmed, met, own_grade, probability, needed = False, own_rank <= rank, scale.name_of(own_rank), None, None
        measured = "the result does not list the error of every pose"
        why_not = measured if result.measured else "predicted from tolerances, not measured"
    ends = {
        f"{quantity}{key}_{unit}": value
        for quantity, unit in QUANTITIES.items()
        for own in [figures.get(quantity)]
        for key, value in (
            ("", own and own.value),
            ("_upper_bound", own and own.interval and own.interval.upper_bound),
        )
    }
    return {
        "name": result.name,
        "verdict": "demonstrated" if confirmed else "met_not_demonstrated" if met else "not_met",
        "demonstrated": confirmed,
        "grade": own_grade,
        "probability": probability,
        **ends,
        "poses_to_demonstrate": needed,
        "why": why_not,
    }


# Warnings of a comparison, where results were made differently, and notes on what its figures do not say.

_CONSEQUENCES = {
    "frame": "lengths are compared; components are not, because their axes differ",
    "alignment": "a registration removes a part of the error that the other result still contains",
    "held out": "errors of calibration poses are smaller than errors of held-out poses",
    "robot file": "errors of the poses that it was fitted to are smaller than errors of other poses",
    "confidence": "the intervals are not comparable",
}


def _warnings(results: Sequence[ComparedResult], pairing: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a line for each aspect in which the results were made differently, and for poses that differ."""
    for aspect in dict.fromkeys(aspect for result in results for aspect in result.provenance):
        made = {result.name: result.provenance[aspect] for result in results if aspect in result.provenance}
        values = [*dict.fromkeys(made.values())]
        if len(values) > 1:
            listed = "; ".join(f"{', '.join(n for n in made if made[n] == value)}: {value}" for value in values)
            consequence = _CONSEQUENCES.get(aspect)
            yield f"made differently, {aspect}: {listed}" + (f" ({consequence})" if consequence else "")
    with_errors = {result.name for result in results if "position" in result.errors}
    for match in pairing:
        names, most = f"{match['first']} and {match['second']}", max(match["n_first"], match["n_second"])
        text = (
            f"{names} share {match['n_shared']} of {most} poses; only these are compared"
            if match["paired"]
            else f"{names} have different poses, so their difference cannot be paired"
        )
        if with_errors >= {match["first"], match["second"]} and match["n_shared"] != most:
            yield f"made differently, poses: {text}"


def _notes(results: Sequence[ComparedResult], tested: bool, grade: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Return the limitations of the comparison; ``tested`` is true if any difference has a p-value."""
    graded = grade or {"demonstrated_by": (), "confidence": 0.0}
    return applying(
        (
            tested,
            "each difference is tested by itself; the ranking's p-values are corrected for the number of pairs (Holm)",
        ),
        (tested, "the tests apply to other poses of the same robots, not to other robots"),
        (
            any(result.command in FITS for result in results),
            "position and orientation of calibrate and trace are those after the fit, on held-out poses",
        ),
        (
            len(graded["demonstrated_by"]) > 1,
            f"each grade by itself is confirmed at {100 * graded['confidence']:g} % confidence, not all together",
        ),
    )


RANKED_BY = "position.rms"


def compare(
    results: Sequence[ComparedResult],
    *,
    baseline: str | None = None,
    by: str | None = None,
    required_grade: str | None = None,
    scale: Scale | None = None,
    confidence: float = 0.95,
    seed: int = 0,
) -> dict[str, Any]:
    """Return the comparison of results with each other, with the keys of the document.

    Args:
        results: At least two results with different names.
        baseline: Name of the result that the others are compared with; None is the first.
        by: Key of the figure that ranks the results; None is the RMS position error, or the first shared figure.
        required_grade: A grade to check every result against.
        scale: Grade scale of ``required_grade``; None is the scale of the results.
        confidence: Confidence of the intervals; differences are significant below 1 - confidence.
        seed: Seed of the bootstrap.

    Raises:
        UsageError: A name, key or grade does not exist, or the results share no figure.
    """
    names = [result.name for result in results]
    # Components are comparable only if the frames agree.
    excluded = frozenset() if len({result.frame for result in results}) == 1 else VECTORIAL
    keys = [
        key
        for key in (results[0].figures if results else ())
        if key.rpartition(".")[2] not in excluded and all(key in result.figures for result in results)
    ]
    # No ranking orders statistics with a sign.
    rankable = [key for key in keys if key.rpartition(".")[2] not in ("mean_x", "mean_y", "mean_z")]
    commands = " and ".join(dict.fromkeys(result.command for result in results))
    refuse(
        (len(names) < 2, "a comparison needs at least two results"),
        (
            not 0.5 <= confidence < 1.0,
            f"`confidence`: expected a probability of at least 0.5 and below 1, found {confidence:g}",
        ),
        (
            baseline is not None and baseline not in names,
            f"`baseline`: no result is named {baseline!r}; choose from {', '.join(names)}",
        ),
        (not keys, f"results of {commands} have no figure in common to compare"),
        (
            by is not None and by not in rankable,
            f"`by`: the results have no common figure {by!r}; choose from {', '.join(rankable)}",
        ),
    )
    reference = names.index(baseline) if baseline is not None else 0

    @cache
    def pairing(group: str, first: int, second: int) -> tuple[ErrorSet, ErrorSet] | None:
        return pair_poses(results[first].errors[group], results[second].errors[group])

    def change(key: str, first: int, second: int) -> Difference:
        """Return the figure of the second result minus the figure of the first."""
        group, _, statistic = key.rpartition(".")
        figures = results[first].figures[key], results[second].figures[key]
        if results[first].digest == results[second].digest:
            return Difference(0.0, Interval.exact(0.0, confidence, "the same result twice"), 1.0, paired=True)
        is_maximum = statistic in ("max", "max_radius95") and not group.startswith("iso9283.")
        if is_maximum or not (results[first].measured and results[second].measured):
            unbuilt = "a prediction describes robots yet to be built, so it has no sampling error to test with"
            missing = Interval.missing(confidence, NO_TEST_OF_MAXIMUM if is_maximum else unbuilt)
            return Difference(figures[1].value - figures[0].value, missing)
        if statistic in RESAMPLED and group in results[first].errors and group in results[second].errors:
            pair = pairing(group, first, second)
            sets = pair or (results[first].errors[group], results[second].errors[group])
            return difference(statistic, *sets, paired=pair is not None, confidence=confidence, seed=seed)
        return from_intervals(*figures, confidence)

    def match(first: int, second: int) -> Mapping[str, Any]:
        both = {"first": results[first], "second": results[second]}
        are_listed = all("position" in result.errors for result in both.values())
        pair = pairing("position", first, second) if are_listed else None
        shared = 0 if pair is None else pair[0].n_groups
        return {
            **{place: result.name for place, result in both.items()},
            **{"paired": shared > 0, "n_shared": shared},
            **{f"n_{p}": r.errors["position"].n_groups if are_listed else r.n_poses for p, r in both.items()},
        }

    rows: list[dict[str, Any]] = [
        {
            "key": key,
            "unit": unit_of(key),
            "values": [
                {"name": result.name, "value": figure.value}
                | {end: getattr(figure.interval, end, None) for end in ("lower", "upper", "confidence")}
                for result in results
                for figure in [result.figures[key]]
            ],
            "differences": [
                {"name": name, **change(key, reference, i).document()} for i, name in enumerate(names) if i != reference
            ],
        }
        for key in keys
    ]
    matches = [match(reference, i) for i in range(len(results)) if i != reference]
    ranked_by = by or (RANKED_BY if RANKED_BY in rankable else rankable[0])
    graded: dict[str, Any] | None = None
    if required_grade is not None:
        scale = scale or common_scale(results)
        statuses = grade_statuses(results, scale, required_grade, seed)
        graded = {
            "wanted": required_grade,
            "scale": scale.name,
            "statistic": scale.statistic,
            "confidence": scale.confidence,
            "demonstrated_by": [status["name"] for status in statuses if status["demonstrated"]],
            "results": statuses,
        }
    tested = any(item["p_value"] is not None for row in rows for item in row["differences"])
    return {
        "results": tuple(results),
        "baseline": names[reference],
        "confidence": confidence,
        "pairing": matches,
        "statistics": rows,
        "ranking": _ranking(results, ranked_by, confidence, partial(change, ranked_by)),
        "grade": graded,
        "notes": _notes(results, tested, graded),
        "warnings": tuple(_warnings(results, matches)),
    }


def _ranking(
    results: Sequence[ComparedResult], key: str, confidence: float, change: Callable[[int, int], Difference]
) -> dict[str, Any]:
    """Return the order of the results by a figure; ``change`` gives its difference between two of them.

    Predictions are not ranked with measured results. Results that share a letter do not differ significantly; without
    any test, there are no groups and no letters.
    """
    ranked = [i for i, result in enumerate(results) if result.measured] or range(len(results))
    order = sorted(ranked, key=lambda i: (abs(results[i].figures[key].value), i))
    pairs = [(i, j, change(order[i], order[j])) for i, j in combinations(range(len(order)), 2)]
    level, names = 1.0 - confidence, [results[i].name for i in order]
    corrected = holm([pair_difference.p_value for _, _, pair_difference in pairs])
    different = {(i, j) for (i, j, _), p in zip(pairs, corrected, strict=True) if p is not None and p < level}
    groups = indistinguishable_groups(len(order), different) if any(p is not None for p in corrected) else []
    ties = [[names[i] for i in group] for group in groups if len(group) > 1]
    untested = [(i, j) for i, j, pair_difference in pairs if groups and pair_difference.p_value is None]
    text = [
        *["ordered by the figure; no difference could be tested"] * (len(names) > 1 and not groups),
        *(f"{names[i]} is better than {names[j]}" for i, j, _ in pairs if j == i + 1 and (i, j) in different),
        *(f"{', '.join(group[:-1])} and {group[-1]} do not differ significantly" for group in ties),
        *(f"{names[i]} and {names[j]} could not be tested" for i, j in untested),
        *(
            f"{result.name} is a prediction, which is not ranked with measured arms"
            for i, result in enumerate(results)
            if i not in ranked
        ),
    ]
    return {
        "by": key,
        "unit": unit_of(key),
        "level": level,
        "order": [
            {"name": results[i].name, "value": results[i].figures[key].value, "letters": letters}
            for i, letters in zip(order, group_letters(len(order), groups), strict=True)
        ],
        "indistinguishable": ties,
        "pairs": [
            {
                "better": names[i],
                "worse": names[j],
                "different": (i, j) in different,
                "p_corrected": p,
                "difference": pair_difference.document(),
            }
            for (i, j, pair_difference), p in zip(pairs, corrected, strict=True)
        ],
        "text": text,
    }


# Targets that were measured before and after a correction: gain, remaining error, and whether a promise was kept.
#
# With e the measured position less the wanted one, the gain is the fall of its RMS. A target's planned displacement
# follows from the model; the measured displacements are regressed on it, and the slope is 1 where the correction was
# loaded and 0 where it was not. The remaining error is as promised where its normalised square
#
#     chi^2 = r^T V^-1 r,    V = J C J^T + D,
#
# r the measured less the predicted position, is usual for a chi-square of 3 N degrees of freedom. C is the covariance
# of the model's coefficients, which all targets share, D that of repeatability, unexplained error and noise.

_FEWEST = 3
"""Smallest number of shared targets."""

Rows = Sequence[list[int]]
"""Rows of each shared target in a file."""


@dataclass(frozen=True, slots=True)
class PairedTargets:
    """Comparison of the same targets before and after a correction."""

    names: tuple[str, ...]
    before: Array
    """``(3, N)`` mean error before, measuring frame, m."""
    after: Array
    gain: Gain
    loaded: Mapping[str, Any]
    """Regression of the measured on the planned displacements, with the keys of the result."""
    promise: Mapping[str, Any] | None
    """Test of the remaining error against the prediction, with the keys of the result; None without a model."""
    notes: tuple[str, ...]
    metrics_before: ErrorMetrics
    """Metrics of the error before, m."""
    metrics_after: ErrorMetrics
    """Metrics of the error after, m."""


def paired_targets(
    first: Measurements,
    second: Measurements,
    nominal: Robot | None = None,
    model: Robot | None = None,
    noise: str | float | None = None,
) -> PairedTargets:
    """Compare the targets that two files have in common.

    Args:
        first: Poses measured before the correction.
        second: Poses measured after it.
        nominal: Robot whose poses are wanted where neither file has commanded poses.
        model: Model of the correction; the files have the commanded joints.
        noise: Standard deviation of the measurement noise along each axis, m or text; None for that of ``second``.

    Raises:
        InputError: The files share fewer than three targets, or the model has no record of its fit.
        UsageError: The files lack wanted poses or joints, or neither the noise nor the model leaves a measurement any
            error.
        MissingColumnError: A file lacks a circumstance that an effect of the model needs, such as the approach.
    """
    apart = f"{first.n} and {second.n} rows without a column pose cannot be paired"
    fix = "add a column pose to both files"
    refuse(
        (
            (first.pose is None) != (second.pose is None),
            Problem("one file has a column pose, the other has none", fix="add it to both files"),
        ),
        (first.pose is None and first.n != second.n, Problem(apart, second.source, fix=fix)),
    )
    rows_of = [rows_of_targets(data) for data in (first, second)]
    common = [key for key in rows_of[0] if key in rows_of[1]]
    message = f"the files share {len(common)} targets, {_FEWEST} are needed"
    fix = "give the files of the same targets before and after the correction"
    refuse((len(common) < _FEWEST, Problem(message, second.source, fix=fix)))
    rows = [[own[key] for key in common] for own in rows_of]
    stated = [(file.commanded_position, own) for file, own in zip((first, second), rows, strict=True)]
    if stated[0][0] is stated[1][0] is None:
        lacking = "the files have no wanted poses: add cmd_x, cmd_y, cmd_z, or give `nominal` and joints"
        robot = given(nominal if first.q is not None else None, lacking)
        stated[0] = (predict(replace(robot, effects=()), first).translation, rows[0])
    wanted = next(_means(values, own) for values, own in reversed(stated) if values is not None)
    before, after = (_means(file.position, own) for file, own in zip((first, second), rows, strict=True))
    # Without a model, the best guess of the plan is that the whole error goes.
    note = "without a model, the planned displacement is the error before, measurement noise included"
    planned, promise = (
        (wanted - before, None) if model is None else _against_model(model, (first, second), rows, after, noise)
    )
    return PairedTargets(
        tuple(map(" ".join, common)),
        before - wanted,
        after - wanted,
        paired_gain(before - wanted, after - wanted, np.arange(before.shape[1])),
        _loaded(after - before, planned),
        promise,
        (note,) if model is None else (),
        pose_metrics(before - wanted).position,
        pose_metrics(after - wanted).position,
    )


def rows_of_targets(data: Measurements) -> dict[tuple[str, ...], list[int]]:
    """Return the rows of each target by its name: its pose, and the measured target if the file has that column.

    Without a column pose, each row is a target, named by its number.
    """
    poses = np.arange(1, data.n + 1) if data.pose is None else data.pose
    columns = (poses,) if data.target is None or data.pose is None else (poses, data.target)
    names = zip(*(map(str, column) for column in columns), strict=True)
    return by_key(zip(names, range(data.n), strict=True))


def _means(values: Array, rows: Rows) -> Array:
    """Return the means ``(K, T)`` of the columns of ``(K, N)`` over the rows of each target."""
    return np.stack([values[:, own].mean(axis=1) for own in rows], axis=1)


def _loaded(measured: Array, planned: Array) -> dict[str, Any]:
    """Return the slope of measured on planned displacements, with an interval from the scatter between targets."""
    # Without a plan, no figure.
    power, n = float(np.sum(np.square(planned))) or math.nan, planned.shape[1]
    slope = float(np.sum(measured * planned)) / power
    scores = np.sum(planned * (measured - slope * planned), axis=0)
    slope_std = math.sqrt(float(np.sum(np.square(scores))) * n / (n - 1)) / power
    half_width = student_quantile(0.975, n - 1.0) * slope_std
    low, high = slope - half_width, slope + half_width
    verdict, *_ = applying(
        (low > 0.5, "loaded"),
        (low <= 0.0 and high < 0.5, "not_loaded"),
        (low > 0.0 and high < 0.9, "partly_loaded"),
        (True, "undecided"),
    )
    return {"verdict": verdict, "slope": slope, "lower": low, "upper": high, "planned_rms_m": rms_length(planned)}


# What a model promises of the targets that it corrected, and the test of the error that remains.


def _against_model(
    robot: Robot, files: Sequence[Measurements], rows: Sequence[Rows], measured: Array, noise: str | float | None
) -> tuple[Array, dict[str, Any]]:
    """Return the displacements that the model plans, and the test of the means ``measured`` after the correction."""
    fix = "give a file that `write_model` of a trace or a calibration wrote"
    fit = given(model_fit(robot), Problem("the model has no record of its fit", robot.name, column="fit", fix=fix))
    lacks_joints = any(file.q is None for file in files)
    refuse((lacks_joints, "`model` needs the joints q1, q2, … that were commanded, in both files"))
    arm = absorb_constants(robot)
    for file in files:
        # Circumstances drawn in place of missing ones would be held against the measurements.
        Model.of(arm).bind(file)
    before, after = (completed(fit, file, 0) for file in files)
    planned_from = _means(Model.of(arm).bind(before).poses(np.zeros(0)).translation, rows[0])
    poses, jacobian, covariance = fitted_jacobian(Model.of(arm, fit.effects), fit, after)
    firsts, alone = np.array([own[0] for own in rows[1]]), replace(fit, covariance=0.0 * fit.covariance)
    separate = model_uncertainty(arm, alone, after, measured=True)[0][0][:, :, firsts]
    stated = files[1].stated_noise[0]
    # Noise within the unexplained error of the model is only its lower bound.
    is_in_unexplained = not fit.noise_is_separate and bool(fit.unexplained.any())
    sources = (
        (None if noise is None else size(noise, "length", "`noise`"), "given"),
        (stated, "file"),
        (0.0 if is_in_unexplained else fit.noise[0], "model"),
    )
    position, source = next((value, name) for value, name in sources if value is not None)
    # Of the means of several measurements. Where the covariances contain the noise of other measurements, their
    # principal variances are at least this noise.
    variance = (position**2 / np.array([len(own) for own in rows[1]]))[:, None]
    values, vectors = np.linalg.eigh(np.moveaxis(separate, 2, 0))
    values = np.maximum(values, 0.0) + variance if fit.noise_is_separate else np.maximum(values, variance)
    refuse((not np.all(values > 0.0), "the model has no unexplained error: `noise` must be more than 0"))
    total = np.asarray(np.einsum("nik,nk,njk->ijn", vectors, values, vectors))
    predicted = _means(poses.translation, rows[1])
    used = {"position_m": position, "source": source, "treatment": "added" if fit.noise_is_separate else "contained"}
    promise = promise_test(measured - predicted, jacobian[:3, :, firsts], covariance, total)
    return predicted - planned_from, {**promise, "noise": used}


def promise_test(residual: Array, jacobian: Array, covariance: Array, separate: Array) -> dict[str, Any]:
    """Return the normalised square of a residual and its probability, with the keys of the result.

    Args:
        residual: ``(3, N)`` measured less predicted positions, m.
        jacobian: ``(3, P, N)`` of the positions to the model's coefficients.
        covariance: ``(P, P)`` of the coefficients.
        separate: ``(3, 3, N)`` covariance of all that targets do not share, m².
    """
    precision = np.moveaxis(np.linalg.inv(np.moveaxis(separate, 2, 0)), 0, 2)
    weighted = np.einsum("ijn,jn->in", precision, residual)
    chi_square, shared = float(np.sum(residual * weighted)), 0.0
    if covariance.size:
        # Woodbury's identity with C = L L^T: coefficients without uncertainty need no inverse.
        values, vectors = np.linalg.eigh(covariance)
        columns = np.einsum("ipn,pk->ikn", jacobian, vectors * np.sqrt(np.maximum(values, 0.0)))
        score = np.einsum("ikn,in->k", columns, weighted)
        information = np.einsum("ikn,ijn,jln->kl", columns, precision, columns, optimize=True)
        chi_square -= float(score @ np.linalg.solve(np.eye(score.size) + information, score))
        shared = float(np.mean(np.sum(np.square(columns), axis=(0, 1))))
    expected = math.sqrt(shared + float(np.mean(np.einsum("iin->n", separate))))
    p_value = chi2_sf(chi_square, float(residual.size))
    return {
        # Probability below which the remaining error is not what was promised.
        "kept": p_value >= 0.01,
        "chi_square": chi_square,
        "degrees_of_freedom": residual.size,
        "p_value": p_value,
        "promised_rms_m": expected,
    }


def noise_doubts(noise: Mapping[str, Any]) -> list[str]:
    """Return a warning where noise is stated that the model's unexplained error may contain."""
    stated = "`noise`" if noise["source"] == "given" else "the noise of `after`"
    doubt = (
        f"the model's unexplained error contains the noise of its own measurements, so {stated} of "
        f"{1e3 * noise['position_m']:.3g} mm is not added; the error counts as this noise at least; to separate the "
        "two, fit the model to poses with columns sigma_x, sigma_y, sigma_z or with several rows in a visit"
    )
    return [] if noise["treatment"] == "added" or noise["source"] == "model" else [doubt]
