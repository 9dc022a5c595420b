"""Comparisons of results, and what is said of a grade."""

import dataclasses
import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_files import saved
from scipy import stats

import robacc
from robacc.accuracy.grade import GradeStep, Scale
from robacc.comparison.comparing import common_scale, grade_statuses, group_letters, holm, indistinguishable_groups
from robacc.comparison.stored_results import RESAMPLED, ComparedResult, ErrorSet, difference, from_intervals, pair_poses
from robacc.errors import InputError, UsageError
from robacc.statistics.intervals import EstimatedValue, Interval

RNG = np.random.default_rng


def sample(vectors: np.ndarray, groups: np.ndarray | None = None) -> ErrorSet:
    return ErrorSet(vectors, np.arange(vectors.shape[1]) if groups is None else groups)


def errors(n: int = 60, seed: int = 0, scale: float = 1e-4) -> np.ndarray:
    return scale * RNG(seed).standard_normal((3, n))


def by_hand(statistic: str, vectors: np.ndarray) -> float:
    lengths = np.linalg.norm(vectors, axis=0)
    axis = "xyz".find(statistic[-1])
    return float(
        {
            "rms": math.sqrt(np.mean(lengths**2)),
            "mean_error": np.mean(lengths),
            "p95": np.percentile(lengths, 95),
            "mean": np.mean(vectors[axis]),
            "sd": np.std(vectors[axis]),
        }[statistic if axis < 0 or statistic == "mean_error" else statistic[:-2]]
    )


@pytest.mark.parametrize("statistic", sorted(RESAMPLED))
@pytest.mark.parametrize("paired", [True, False])
def test_a_difference_is_that_of_the_statistics(statistic: str, paired: bool) -> None:
    a, b = errors(seed=1), errors(seed=2, scale=1.3e-4)
    delta = difference(statistic, sample(a), sample(b), paired=paired)
    assert delta.value == pytest.approx(by_hand(statistic, b) - by_hand(statistic, a), rel=1e-12, abs=1e-19)
    assert delta.interval.lower < delta.value < delta.interval.upper
    assert delta.paired is paired


def test_means_of_lengths_by_scipys_t_tests() -> None:
    """Above 1000 poses there is no bootstrap, and the mean's tests are Student's and Welch's own."""
    a = errors(1200, 1)
    b, c = a + errors(1200, 2, 3e-5) + 2e-6, errors(1100, 3, 1.02e-4)
    lengths = [np.linalg.norm(v, axis=0) for v in (a, b, c)]
    paired = difference("mean_error", sample(a), sample(b), paired=True)
    reference = stats.ttest_rel(lengths[1], lengths[0])
    interval = reference.confidence_interval(0.95)
    assert paired.p_value == pytest.approx(reference.pvalue, rel=1e-9)
    assert (paired.interval.lower, paired.interval.upper) == pytest.approx((interval.low, interval.high), rel=1e-9)
    apart = difference("mean_error", sample(a), sample(c), paired=False)
    assert apart.p_value == pytest.approx(stats.ttest_ind(lengths[2], lengths[0], equal_var=False).pvalue, rel=1e-9)


@pytest.mark.parametrize("statistic", ["rms", "sd_x"])
def test_standard_error_by_the_jackknife(statistic: str) -> None:
    a, b, n = errors(1500, 1), errors(1500, 2), 1500
    delta = difference(statistic, sample(a), sample(b), paired=True)
    left_out = np.array(
        [by_hand(statistic, np.delete(b, i, 1)) - by_hand(statistic, np.delete(a, i, 1)) for i in range(n)]
    )
    error = math.sqrt((n - 1) / n * np.sum(np.square(left_out - left_out.mean())))
    # The influence is the jackknife's limit; at 1500 poses they agree to some parts in a thousand.
    assert delta.interval.upper - delta.value == pytest.approx(stats.t.ppf(0.975, n - 1) * error, rel=5e-3)


@pytest.mark.parametrize("statistic", ["rms", "p95", "sd_x"])
def test_pairs_cancel_what_they_share(statistic: str) -> None:
    a = errors(100, 1)
    both = sample(a), sample(a + errors(100, 2, 5e-6))
    paired, unpaired = (width(difference(statistic, *both, paired=paired)) for paired in (True, False))
    assert paired < 0.4 * unpaired


def figure(value: float, lower: float, upper: float, confidence: float) -> EstimatedValue:
    return EstimatedValue(value, Interval(lower, upper, None, confidence, "stored"))


def width(delta: Any) -> float:
    return float(delta.interval.upper - delta.interval.lower)


@pytest.mark.parametrize("statistic", ["rms", "mean_error", "p95", "sd_z"])
def test_repeated_poses_are_no_new_evidence(statistic: str) -> None:
    """Every pose five times over: the same interval as once, not one of five times as many poses."""
    a, b = errors(80, 1), errors(80, 2)
    groups = np.repeat(np.arange(80), 5)
    once = difference(statistic, sample(a), sample(b), paired=True)
    often = difference(statistic, sample(np.repeat(a, 5, 1), groups), sample(np.repeat(b, 5, 1), groups), paired=True)
    assert width(often) == pytest.approx(width(once), rel=0.1 if statistic == "p95" else 1e-9)


@pytest.mark.parametrize("statistic", ["rms", "mean_error", "p95"])
@pytest.mark.parametrize(("n", "shift"), [(40, 1.0), (40, 1.15), (40, 1.3), (300, 1.08)])
def test_p_value_and_interval_say_the_same(statistic: str, n: int, shift: float) -> None:
    for seed in range(4):
        a, b = errors(n, seed), errors(n, seed + 100, shift * 1e-4)
        delta = difference(statistic, sample(a), sample(b), paired=False)
        assert (delta.p_value < 0.05) == (not delta.interval.lower <= 0.0 <= delta.interval.upper)


@pytest.mark.parametrize(
    ("statistic", "n", "m", "paired", "why"),
    [
        ("p95", 29, 50, False, "29 poses: too few to compare 95th percentiles; at least 30 are needed"),
        ("p95", 30, 50, False, None),
        ("rms", 1, 50, False, "one commanded pose shows no scatter between poses"),
        ("sd_x", 9, 9, True, "fewer than 10 poses: too few to compare standard deviations"),
    ],
)
def test_too_few_poses_are_said(statistic: str, n: int, m: int, paired: bool, why: str | None) -> None:
    delta = difference(statistic, sample(errors(n)), sample(errors(m, 1)), paired=paired)
    assert delta.value == pytest.approx(by_hand(statistic, errors(m, 1)) - by_hand(statistic, errors(n)))
    assert (delta.interval.why, delta.p_value is None, delta.interval.lower is None) == (why, bool(why), bool(why))


def coverage(statistic: str, n: int, m: int, correlation: float, ratio: float, runs: int) -> float:
    """How often the 95 % interval holds the true difference, of flat Gaussian errors with a mean."""
    rng = RNG(5)
    shape, mean = np.array([1.0, 0.6, 0.3])[:, None], np.array([0.4, 0.0, 0.0])[:, None]
    big = mean + shape * RNG(9).standard_normal((3, 1_000_000))
    truth = (ratio - 1.0) * by_hand(statistic, big)
    covered = 0
    for seed in range(runs):
        a, b = rng.standard_normal((3, n)), rng.standard_normal((3, m))
        if correlation:
            b = correlation * a + math.sqrt(1 - correlation**2) * b
        delta = difference(
            statistic, sample(mean + shape * a), sample(ratio * (mean + shape * b)), paired=correlation > 0, seed=seed
        )
        covered += (delta.interval.lower or 0.0) <= truth <= (delta.interval.upper or 0.0)
    return covered / runs


def test_coverage_of_the_rms() -> None:
    """The fast one of the next test: 200 runs, within three standard deviations of 95 % (1.5 %)."""
    assert coverage("rms", 30, 30, 0.8, 1.0, 200) == pytest.approx(0.95, abs=0.046)


@pytest.mark.slow
@pytest.mark.parametrize("statistic", ["rms", "mean_error", "mean_x", "sd_y"])
@pytest.mark.parametrize(
    ("n", "m", "correlation", "ratio"),
    [(12, 12, 0.0, 1.0), (12, 12, 0.9, 1.0), (30, 60, 0.0, 1.5), (60, 60, 0.9, 1.0), (60, 60, 0.7, 1.5)],
)
def test_coverage(statistic: str, n: int, m: int, correlation: float, ratio: float) -> None:
    """93 to 97 %, and three standard deviations (1.9 %) of 1200 runs; standard deviations of 12 poses reach 91 %."""
    lowest = 0.91 if statistic == "sd_y" and n == 12 else 0.93
    assert lowest - 0.019 <= coverage(statistic, n, m, correlation, ratio, 1200) <= 0.97 + 0.019


@pytest.mark.slow
@pytest.mark.parametrize(("n", "m", "correlation", "ratio"), [(40, 40, 0.0, 1.0), (100, 100, 0.9, 1.0)])
def test_coverage_of_the_95th_percentile(n: int, m: int, correlation: float, ratio: float) -> None:
    """The bootstrap's standard error of a percentile is on the safe side where errors go together."""
    assert 0.92 - 0.03 <= coverage("p95", n, m, correlation, ratio, 500) <= 0.995


def test_differences_from_intervals() -> None:
    """Gaussian limits give Gaussian limits: the standard errors 3 and 4 put together are 5."""
    z = stats.norm.ppf(0.975)
    delta = from_intervals(figure(10.0, 10 - 3 * z, 10 + 3 * z, 0.95), figure(20.0, 20 - 4 * z, 20 + 4 * z, 0.95), 0.95)
    assert (delta.value, delta.interval.lower, delta.interval.upper) == pytest.approx((10.0, 10 - 5 * z, 10 + 5 * z))
    assert delta.p_value == pytest.approx(2 * stats.norm.sf(2.0))
    sharp, broad = figure(1.0, 1.0, 1.0, 0.95), figure(2.0, 1.0, 3.0, 0.95)
    assert [from_intervals(sharp, figure(x, x, x, 0.95), 0.95).p_value for x in (1.0, 2.0)] == [1.0, 0.0]
    for first, why in (
        (EstimatedValue(1.0, None), "the results have no interval for this figure"),
        (figure(1.0, 0.5, 1.5, 0.9), "the intervals of the results have different confidences, 0.9 and 0.95"),
    ):
        found = from_intervals(first, broad, 0.95)
        assert (found.value, found.p_value, found.interval.why) == (1.0, None, why)


def test_holm_by_the_papers_rule() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, None, 0.9]) == [1.0, None, 1.0]
    assert holm([]) == []


def test_letters_mean_what_they_say() -> None:
    """Over every set of differences among four: two share a letter exactly where they are not different."""
    pairs = list(itertools.combinations(range(4), 2))
    for chosen in itertools.product((False, True), repeat=len(pairs)):
        different = {pair for pair, picked in zip(pairs, chosen, strict=True) if picked}
        groups = indistinguishable_groups(4, different)
        letters = group_letters(4, groups)
        for i, j in pairs:
            assert (not set(letters[i]) & set(letters[j])) == ((i, j) in different)
        assert not any(set(group) < set(other) for group in groups for other in groups)
    assert indistinguishable_groups(3, {(0, 2)}) == [(0, 1), (1, 2)]
    assert group_letters(3, [(0, 1), (1, 2)]) == ["a", "ab", "b"]
    assert group_letters(28, [(i,) for i in range(28)])[25:] == ["z", "a1", "b1"]


def poses(n: int, *columns: Any, **changes: Any) -> ErrorSet:
    """Errors of n poses: of random joints, or of the given columns q, commanded, pose and target."""
    q = RNG(3).uniform(-2, 2, (6, n))
    return dataclasses.replace(ErrorSet(errors(n), np.arange(n), *(columns or (q, q[:3]))), **changes)


def matched(first: ErrorSet, second: ErrorSet) -> tuple[bool, int]:
    pair = pair_poses(first, second)
    return pair is not None, first.n_groups if pair is None else pair[0].n_groups


def test_the_same_poses_are_found() -> None:
    base = poses(20)
    q, place, other, order = base.q, base.commanded, RNG(4).uniform(-2, 2, (6, 20)), RNG(1).permutation(20)
    for second, is_same, n in (
        (base, True, 20),
        (poses(20, q=q + 1e-9), True, 20),
        # An arm of another kind sent to the same places, to within what its joints were rounded to.
        (poses(20, q=other[:5], commanded=place + 3e-5), True, 20),
        (poses(20, q=other, commanded=place + 1.0), False, 20),
        # One arm's poses in another order, and some of them.
        (poses(20, q[:, order], place[:, order]), True, 20),
        (poses(12, q[:, :12], place[:, :12]), True, 12),
        (poses(5, q[:, :5], place[:, :5]), False, 20),
    ):
        assert matched(base, second) == (is_same, n)


def test_ids_name_poses_where_joints_are_not_known() -> None:
    names, place = np.array([f"p{i}" for i in range(10)]), poses(10).commanded
    first = poses(10, None, place, names)
    assert matched(first, poses(10, None, place[:, ::-1], names[::-1])) == (True, 10)
    # The same ids of other places are other poses.
    assert matched(first, poses(10, None, place[:, ::-1], names)) == (False, 10)
    assert matched(poses(10, None, None), poses(10, None, None)) == (False, 10)
    # Ids that the joints contradict do not join poses.
    contradicted = poses(20, pose=np.array([f"P{i % 4}" for i in range(20)]))
    assert matched(contradicted, contradicted) == (True, 20)


def test_targets_must_be_the_same() -> None:
    base = poses(4)
    first, second = (dataclasses.replace(base, target=np.array([name] * 4)) for name in ("t1", "t2"))
    assert pair_poses(first, first) is not None
    assert pair_poses(dataclasses.replace(first, q=None), dataclasses.replace(second, q=None)) is None


def stored(folder: Path, **changes: Any) -> str:
    """Path of a result with these keys."""
    keys = {"schema": "robacc.estimate/1", "robacc": "1", "command": "estimate", "n_poses": 2}
    return str(saved(folder / "r.json", json.dumps(keys | {"options": {}, "inputs": []} | changes)))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"n_poses": "2"}, 'r.json, n_poses: expected a whole number, found "2"'),
        ({"n_poses": -1}, "r.json, n_poses: expected a number of at least 0, found -1"),
        ({"position": {"rms_m": "x"}}, 'r.json, position.rms_m: expected a number, found "x"'),
        ({"position": {"rms_m": True}}, "r.json, position.rms_m: expected a number, found true"),
        ({"position": {"rms_m": 1.0, "errors_m": [[1, 2, 3]]}}, "position.errors_m: expected 2 rows"),
        ({"position": {"rms_m": 1.0, "errors_m": "x"}}, 'position.errors_m: expected a list, found "x"'),
        ({"position": {"errors_m": [[1, 2]]}}, "position.errors_m[0]: expected 3 entries, found 2"),
        ({"position": {"errors_m": [[1, 2, 3], [1, 2, "3"]]}}, 'position.errors_m[1][2]: expected a number, found "3"'),
        (
            {"position": {"rms_m": 1.0, "errors_m": [[1, 2, None], [1, 2, 3]]}},
            "position.errors_m: expected numbers below 1e+09",
        ),
        ({"position": {"rms_m": 1.0}, "poses": {"pose": [1, 2]}}, "r.json, poses.pose[0]: expected text, found 1"),
        (
            {"position": {"rms_m": 1.0, "errors_m": [[1, 2, 3], [1, 2, 3]]}, "poses": {"pose": ["1"]}},
            "poses.pose: expected 2 rows",
        ),
        ({"position": {"rms_m": 1.0}, "robot": {"name": 3}}, "r.json, robot.name: expected text, found 3"),
        ({}, "r.json: is a result of robacc estimate, but has an unexpected value (no figures to compare)"),
        ({"grade": {"steps": [3]}}, "r.json, grade.steps[0]: expected an object, found 3"),
        (
            {"schema": "robacc.calibrate/2", "command": "calibrate", "poses": {"used": [1, 0]}},
            "r.json, poses.used[0]: expected true or false, found 1",
        ),
    ],
)
def test_what_is_wrong_with_a_result_is_said_with_its_place(
    changes: dict[str, Any], problem: str, tmp_path: Path
) -> None:
    path = stored(tmp_path, **changes)
    with pytest.raises(InputError) as caught:
        robacc.compare(path, path)
    assert problem in str(caught.value)


def test_other_results_have_nothing_to_compare(tmp_path: Path) -> None:
    path = stored(tmp_path, schema="robacc.show/1", command="show")
    with pytest.raises(UsageError, match=r"r.json is a result of show; only results of estimate, calibrate"):
        robacc.compare(path, path)


SCALE = Scale("two", "rms", 0.95, (GradeStep("fine", 1.0, 0.1), GradeStep("coarse", 4.0, 0.4)), "none")


def result(**changes: Any) -> ComparedResult:
    fields: dict[str, Any] = {
        **{"name": "r", "command": "predict", "version": "1", "n_poses": 40, "robot": None, "figures": {}},
        **{"errors": {}, "provenance": {}, "grade": None, "scale": None, "scale_name": None, "frame": None},
        "digest": "",
    }
    return ComparedResult(**(fields | changes))


def predicted(position: float, orientation: float | None = None) -> ComparedResult:
    figures = {"position.rms": EstimatedValue(position, None)}
    if orientation is not None:
        figures["orientation.rms"] = EstimatedValue(orientation, None)
    return result(figures=figures)


def measured(vectors: np.ndarray) -> ComparedResult:
    return result(command="estimate", errors={"position": ErrorSet(vectors, np.arange(vectors.shape[1]))})


def status(compared: ComparedResult, grade: str) -> dict[str, Any]:
    (answer,) = grade_statuses([compared], SCALE, grade)
    return answer


@pytest.mark.parametrize(
    ("position", "orientation", "grade", "verdict", "own"),
    [
        (1.0, None, "fine", "met_not_demonstrated", "fine"),
        (np.nextafter(1.0, 2.0), None, "fine", "not_met", "coarse"),
        (1.0, None, "coarse", "met_not_demonstrated", "fine"),
        (4.0, None, "coarse", "met_not_demonstrated", "coarse"),
        (np.nextafter(4.0, 5.0), None, "coarse", "not_met", "none"),
        (1.0, 0.1, "fine", "met_not_demonstrated", "fine"),
        (1.0, np.nextafter(0.1, 1.0), "fine", "not_met", "coarse"),
        (1.0, 0.5, "coarse", "not_met", "none"),
    ],
)
def test_a_figure_equal_to_the_limit_meets_it(
    position: float, orientation: float | None, grade: str, verdict: str, own: str
) -> None:
    answer = status(predicted(position, orientation), grade)
    assert (answer["verdict"], answer["grade"]) == (verdict, own)


def errors_of_grade_status(rms: float, n: int) -> np.ndarray:
    vectors = np.random.default_rng(1).normal(size=(3, n))
    scaled: np.ndarray = vectors * rms / math.sqrt(np.mean(np.sum(vectors**2, axis=0)))
    return scaled


@pytest.mark.parametrize(
    ("rms", "grade", "own"), [(0.5, "fine", "fine"), (0.5, "coarse", "fine"), (2.0, "coarse", "coarse")]
)
def test_the_required_grade_itself_and_better_ones_are_confirmed(rms: float, grade: str, own: str) -> None:
    answer = status(measured(errors_of_grade_status(rms, 400)), grade)
    assert (answer["verdict"], answer["grade"], answer["why"]) == ("demonstrated", own, None)
    assert answer["position_m"] < answer["position_upper_bound_m"]


def test_a_grade_met_by_the_value_alone_is_not_confirmed() -> None:
    answer = status(measured(errors_of_grade_status(0.99, 30)), "fine")
    assert (answer["verdict"], answer["grade"]) == ("met_not_demonstrated", "fine")
    assert answer["why"] == "the upper 95 % bound is beyond the limit"
    assert answer["poses_to_demonstrate"] is not None
    assert status(measured(errors_of_grade_status(0.99, 30)), "coarse")["verdict"] == "demonstrated"
    assert status(measured(errors_of_grade_status(1.01, 30)), "fine")["verdict"] == "not_met"


def test_scales_that_differ_or_are_incomplete_need_a_choice() -> None:
    other = Scale("two", "p95", 0.95, SCALE.steps, "none")
    assert common_scale([result(scale=SCALE, scale_name="two")]) is SCALE
    with pytest.raises(UsageError, match=r"graded on different scales with the name two; choose the scale with"):
        common_scale([result(scale=scale, scale_name="two") for scale in (SCALE, other)])
    with pytest.raises(UsageError, match=r"no result stores the complete scale two; give its file with"):
        common_scale([result(scale_name="two")])
