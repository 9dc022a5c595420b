"""Differences between results: their size against hand computation, pairing, corrections, ranking, warnings."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from robacc.comparison.compared_result import ComparedFigure, ComparedPoses, ComparedResult, ErrorSet
from robacc.comparison.comparing import compare
from robacc.comparison.differences import SMOOTH, ErrorSample, difference
from robacc.comparison.from_intervals import from_intervals
from robacc.comparison.pairing import pair
from robacc.comparison.ranking import groups, holm, letters
from robacc.comparison.reading import subject
from robacc.errors import InputError, UsageError

RNG = np.random.default_rng


def sample(vectors: np.ndarray, groups: np.ndarray | None = None) -> ErrorSample:
    return ErrorSample(vectors, np.arange(vectors.shape[1]) if groups is None else groups)


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


@pytest.mark.parametrize("statistic", [*SMOOTH, "p95"])
@pytest.mark.parametrize("paired", [True, False])
def test_a_difference_is_that_of_the_statistics(statistic: str, paired: bool) -> None:
    a, b = errors(seed=1), errors(seed=2, scale=1.3e-4)
    found = difference(statistic, sample(a), sample(b), paired=paired)
    assert found.value == pytest.approx(by_hand(statistic, b) - by_hand(statistic, a), rel=1e-12, abs=1e-19)
    assert found.lower is not None
    assert found.upper is not None
    assert found.lower < found.value < found.upper
    assert found.paired is paired


def test_means_of_lengths_by_scipys_t_tests() -> None:
    """Above 1000 poses there is no bootstrap, and the mean's tests are Student's and Welch's own."""
    a, b = errors(1200, 1), errors(1200, 1) + errors(1200, 2, 3e-5) + 2e-6
    one, other = (np.linalg.norm(v, axis=0) for v in (a, b))
    found = difference("mean_error", sample(a), sample(b), paired=True)
    truth = stats.ttest_rel(other, one)
    interval = truth.confidence_interval(0.95)
    assert found.p_value == pytest.approx(truth.pvalue, rel=1e-9)
    assert (found.lower, found.upper) == pytest.approx((interval.low, interval.high), rel=1e-9)
    b = errors(1100, 3, 1.02e-4)
    other = np.linalg.norm(b, axis=0)
    found = difference("mean_error", sample(a), sample(b), paired=False)
    truth = stats.ttest_ind(other, one, equal_var=False)
    assert found.p_value == pytest.approx(truth.pvalue, rel=1e-9)


@pytest.mark.parametrize("statistic", ["rms", "sd_x"])
def test_standard_error_by_the_jackknife(statistic: str) -> None:
    a, b = errors(1500, 1), errors(1500, 2)
    found = difference(statistic, sample(a), sample(b), paired=True)
    n = a.shape[1]
    left_out = np.array(
        [by_hand(statistic, np.delete(b, i, 1)) - by_hand(statistic, np.delete(a, i, 1)) for i in range(n)]
    )
    error = math.sqrt((n - 1) / n * np.sum(np.square(left_out - left_out.mean())))
    assert found.upper is not None
    # The influence is the jackknife's limit; at 1500 poses they agree to some parts in a thousand.
    assert found.upper - found.value == pytest.approx(stats.t.ppf(0.975, n - 1) * error, rel=5e-3)


@pytest.mark.parametrize("statistic", ["rms", "p95", "sd_x"])
def test_pairs_cancel_what_they_share(statistic: str) -> None:
    a = errors(100, 1)
    b = a + errors(100, 2, 5e-6)
    together, apart = (difference(statistic, sample(a), sample(b), paired=paired) for paired in (True, False))
    assert width(together) < 0.4 * width(apart)


def width(found: Any) -> float:
    return float(found.upper - found.lower)


@pytest.mark.parametrize("statistic", [*SMOOTH, "p95"])
def test_equal_errors_do_not_differ(statistic: str) -> None:
    found = difference(statistic, sample(errors()), sample(errors()), paired=True)
    assert (found.value, found.lower, found.upper, found.p_value) == (0.0, 0.0, 0.0, 1.0)


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
        found = difference(statistic, sample(a), sample(b), paired=False)
        assert found.lower is not None
        assert found.upper is not None
        assert found.p_value is not None
        assert (found.p_value < 0.05) == (not found.lower <= 0.0 <= found.upper)


def test_order_turns_the_sign() -> None:
    a, b = errors(1200, 1), errors(1200, 2)
    one = difference("rms", sample(a), sample(b), paired=False)
    other = difference("rms", sample(b), sample(a), paired=False)
    assert (one.value, one.lower, one.p_value) == pytest.approx((-other.value, -(other.upper or 0.0), other.p_value))


def test_too_few_poses_are_said() -> None:
    few = difference("p95", sample(errors(29)), sample(errors(50)), paired=False)
    assert (few.lower, few.p_value) == (None, None)
    assert few.why == "29 poses: too few to tell 95th percentiles apart, which takes 30"
    assert difference("p95", sample(errors(30)), sample(errors(50)), paired=False).p_value is not None
    one = difference("rms", sample(errors(1)), sample(errors(50)), paired=False)
    assert one.why == "one commanded pose shows no scatter between poses"
    assert one.value == pytest.approx(by_hand("rms", errors(50)) - by_hand("rms", errors(1)))
    sd = difference("sd_x", sample(errors(9)), sample(errors(9, 1)), paired=True)
    assert sd.why == "fewer than 10 poses: too few to tell standard deviations apart"


def coverage(statistic: str, n: int, m: int, correlation: float, ratio: float, runs: int) -> float:
    """How often the 95 % interval holds the true difference, of flat Gaussian errors with a mean."""
    rng = RNG(5)
    shape, mean = np.array([1.0, 0.6, 0.3])[:, None], np.array([0.4, 0.0, 0.0])[:, None]
    big = mean + shape * RNG(9).standard_normal((3, 1_000_000))
    truth = (ratio - 1.0) * by_hand(statistic, big)
    held = 0
    for seed in range(runs):
        a, b = rng.standard_normal((3, n)), rng.standard_normal((3, m))
        if correlation:
            b = correlation * a + math.sqrt(1 - correlation**2) * b
        found = difference(
            statistic, sample(mean + shape * a), sample(ratio * (mean + shape * b)), paired=correlation > 0, seed=seed
        )
        held += (found.lower or 0.0) <= truth <= (found.upper or 0.0)
    return held / runs


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
    found = from_intervals(
        ComparedFigure(10.0, "m", 10 - 3 * z, 10 + 3 * z, 0.95),
        ComparedFigure(20.0, "m", 20 - 4 * z, 20 + 4 * z, 0.95),
        0.95,
    )
    assert (found.value, found.lower, found.upper) == pytest.approx((10.0, 10 - 5 * z, 10 + 5 * z))
    assert found.p_value == pytest.approx(2 * stats.norm.sf(2.0))
    lacking = from_intervals(ComparedFigure(1.0, "m"), ComparedFigure(2.0, "m", 1.0, 3.0, 0.95), 0.95)
    assert (lacking.value, lacking.p_value, lacking.why) == (1.0, None, "the results carry no interval of it")
    unlike = from_intervals(ComparedFigure(1.0, "m", 0.5, 1.5, 0.9), ComparedFigure(2.0, "m", 1.0, 3.0, 0.95), 0.95)
    assert unlike.why == "the results' intervals are of different confidences, 0.9 and 0.95"
    same = from_intervals(ComparedFigure(1.0, "m", 1.0, 1.0, 0.95), ComparedFigure(1.0, "m", 1.0, 1.0, 0.95), 0.95)
    assert same.p_value == 1.0
    assert (
        from_intervals(ComparedFigure(1.0, "m", 1.0, 1.0, 0.95), ComparedFigure(2.0, "m", 2.0, 2.0, 0.95), 0.95).p_value
        == 0.0
    )


def test_holm_by_the_papers_rule() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, None, 0.9]) == [1.0, None, 1.0]
    assert holm([]) == []


def test_letters_mean_what_they_say() -> None:
    """Over every set of differences among four: two share a letter exactly where they are not different."""
    pairs = list(itertools.combinations(range(4), 2))
    for chosen in itertools.product((False, True), repeat=len(pairs)):
        different = {pair for pair, picked in zip(pairs, chosen, strict=True) if picked}
        found = groups(4, different)
        named = letters(4, found)
        for i, j in pairs:
            assert (not set(named[i]) & set(named[j])) == ((i, j) in different)
        assert not any(set(one) < set(other) for one in found for other in found)
    assert groups(3, {(0, 2)}) == [(0, 1), (1, 2)]
    assert letters(3, [(0, 1), (1, 2)]) == ["a", "ab", "b"]
    assert letters(28, [(i,) for i in range(28)])[25:] == ["z", "a1", "b1"]


def poses(n: int, **changes: Any) -> ComparedPoses:
    q = RNG(3).uniform(-2, 2, (6, n))
    return dataclasses.replace(ComparedPoses(n, q, q[:3], None, None), **changes)


def matched(first: ComparedPoses, second: ComparedPoses) -> tuple[bool, int]:
    found = pair(ErrorSet(errors(first.n), first), ErrorSet(errors(second.n, 1), second))
    return found.paired, found.first.n_groups


def test_the_same_poses_are_found() -> None:
    base = poses(20)
    q, place = np.asarray(base.q), np.asarray(base.commanded)
    other = RNG(4).uniform(-2, 2, (6, 20))
    assert matched(base, base) == (True, 20)
    assert matched(base, poses(20, q=q + 1e-9)) == (True, 20)
    # An arm of another kind sent to the same places, to within what its joints were rounded to.
    assert matched(base, poses(20, q=other[:5], commanded=place + 3e-5)) == (True, 20)
    assert matched(base, poses(20, q=other, commanded=place + 1.0)) == (False, 20)
    # One arm's poses in another order, and some of them.
    order = RNG(1).permutation(20)
    assert matched(base, ComparedPoses(20, q[:, order], place[:, order], None, None)) == (True, 20)
    assert matched(base, ComparedPoses(12, q[:, :12], place[:, :12], None, None)) == (True, 12)
    assert matched(base, ComparedPoses(5, q[:, :5], place[:, :5], None, None)) == (False, 20)


def test_pairs_belong_together_whatever_the_order() -> None:
    base, order = poses(30), RNG(1).permutation(30)
    shuffled = base.subset(np.ones(30, dtype=bool))
    shuffled = ComparedPoses(30, np.asarray(base.q)[:, order], None, None, None)
    found = pair(ErrorSet(errors(30), base), ErrorSet(errors(30)[:, order], shuffled))
    gained = difference("rms", found.first, found.second, paired=found.paired)
    assert (gained.value, gained.p_value) == (pytest.approx(0.0, abs=1e-18), 1.0)


def test_ids_name_poses_where_joints_are_not_known() -> None:
    names = np.array([f"p{i}" for i in range(10)])
    place = np.asarray(poses(10).commanded)
    first = ComparedPoses(10, None, place, names, None)
    order = np.arange(10)[::-1]
    assert matched(first, ComparedPoses(10, None, place[:, order], names[order], None)) == (True, 10)
    # The same ids of other places are other poses.
    assert matched(first, ComparedPoses(10, None, place[:, order], names, None)) == (False, 10)
    assert matched(ComparedPoses(10, None, None, None, None), ComparedPoses(10, None, None, None, None)) == (False, 10)


def test_ids_that_the_joints_contradict_do_not_join_poses() -> None:
    base = poses(20, pose=np.array([f"P{i % 4}" for i in range(20)]))
    assert matched(base, base) == (True, 20)


def test_targets_must_be_the_same() -> None:
    base = poses(4)
    one, other = (dataclasses.replace(base, target=np.array([name] * 4)) for name in ("t1", "t2"))
    assert pair(ErrorSet(errors(4), one), ErrorSet(errors(4), one)).paired
    assert not pair(
        ErrorSet(errors(4), dataclasses.replace(one, q=None)), ErrorSet(errors(4), dataclasses.replace(other, q=None))
    ).paired


def made(
    name: str, seed: int, n: int = 50, scale: float = 1e-4, command: str = "estimate", **changes: Any
) -> ComparedResult:
    vectors = errors(n, seed, scale)
    figures = {
        f"position.{one}": ComparedFigure(by_hand(one, vectors), "m") for one in ("rms", "mean_error", "p95", "mean_x")
    }
    figures["position.max"] = ComparedFigure(float(np.max(np.linalg.norm(vectors, axis=0))), "m")
    fields: dict[str, Any] = {
        "name": name,
        "command": command,
        "version": "1",
        "n_poses": n,
        "robot": None,
        "figures": figures,
        "errors": {} if command == "predict" else {"position": ErrorSet(vectors, poses(n))},
        "made": {"frame": "tool"},
        "grade": None,
        "scale": None,
        "scale_name": None,
        "frame": "tool",
        "digest": f"{name}{seed}{scale}{n}",
    }
    return ComparedResult(**(fields | changes))


def test_ranking_says_which_differences_are_real() -> None:
    found = compare([made("worst", 1, scale=2e-4), made("good", 2), made("better", 3)])
    assert set(found.ranking.names[:2]) == {"good", "better"}
    assert found.ranking.names[2] == "worst"
    assert found.ranking.letters == ("a", "a", "b")
    first, second, worst = found.ranking.names
    assert found.ranking.sentences() == (
        f"{second} is better than {worst}",
        f"{first} and {second} cannot be told apart",
    )
    plain = [pair.difference.p_value for pair in found.ranking.pairs]
    assert [pair.p_corrected for pair in found.ranking.pairs] == pytest.approx(holm(plain))
    assert found.warnings == ()


def test_differences_are_to_the_baseline() -> None:
    a, b = made("a", 1), made("b", 2)
    one, other = compare([a, b]), compare([a, b], baseline="b")
    assert one.rows[0].differences[0] is None
    assert other.rows[0].differences[1] is None
    first, second = one.rows[0].differences[1], other.rows[0].differences[0]
    assert first is not None
    assert second is not None
    assert first.value == pytest.approx(-second.value)


def test_equal_results_are_one_result_twice() -> None:
    found = compare([made("a", 1, digest="same"), made("b", 1, digest="same")])
    assert found.warnings == ()
    for row in found.rows:
        one = row.differences[1]
        assert one is not None
        assert (one.value, one.lower, one.upper, one.p_value) == (0.0, 0.0, 0.0, 1.0)
    assert found.ranking.sentences() == ("a and b cannot be told apart",)


def test_largest_errors_and_predictions_are_not_tested() -> None:
    found = compare([made("a", 1), made("b", 2)])
    largest = next(row for row in found.rows if row.key == "position.max").differences[1]
    assert largest is not None
    assert (largest.p_value, largest.why) == (None, "no test holds for the largest of all errors")
    found = compare([made("a", 1), made("p", 2, command="predict")])
    one = found.rows[0].differences[1]
    assert one is not None
    assert one.p_value is None
    assert one.why is not None
    assert one.why.startswith("a prediction is of robots to come")
    assert found.ranking.groups == ()
    assert found.ranking.sentences() == ("in order of the figure; no difference could be tested",)
    mixed = compare([made("a", 1), made("b", 2), made("p", 3, command="predict")])
    assert "b and p could not be tested" in mixed.ranking.sentences()


def test_what_was_made_differently_is_warned_of() -> None:
    found = compare([made("a", 1), made("b", 2, made={"frame": "base"}, frame="base")])
    assert found.warnings == (
        "made differently, frame: a: tool; b: base (lengths can be compared, components cannot, and are left out)",
    )
    assert "position.mean_x" not in [row.key for row in found.rows]
    assert "position.mean_x" in [row.key for row in compare([made("a", 1), made("b", 2)]).rows]
    other = dataclasses.replace(
        made("b", 2), errors={"position": ErrorSet(errors(50, 2), ComparedPoses(50, None, None, None, None))}
    )
    assert compare([made("a", 1), other]).warnings == (
        "made differently, poses: a and b are not of the same poses, so nothing cancels",
    )
    part = made("b", 2)
    kept = np.arange(50) < 40
    whole = part.errors["position"]
    part = dataclasses.replace(part, errors={"position": ErrorSet(whole.vectors[:, kept], whole.poses.subset(kept))})
    assert compare([made("a", 1), part]).warnings == (
        "made differently, poses: a and b share 40 of 50 poses; their differences are over those alone",
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"baseline": "z"}, r"no result is named 'z'; they are a, b"),
        ({"by": "position.mean_x"}, r"no shared figure 'position.mean_x' to rank by; there are position.rms, "),
        ({"confidence": 2.0}, r"at least 0.5 and below 1, not 2"),
        ({"wanted": "Z"}, r"no grade 'Z' on the scale CAD/CAM 0.1 mm, 0.1 degree; it has A, B, C, D, E"),
    ],
)
def test_calls_that_do_not_fit(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        compare([made("a", 1), made("b", 2)], **options)


def test_there_must_be_something_to_compare() -> None:
    with pytest.raises(UsageError, match="takes at least two results"):
        compare([made("a", 1)])
    with pytest.raises(UsageError, match="results of estimate and iso9283 share no figure that could be compared"):
        compare([made("a", 1), made("b", 2, command="iso9283", figures={"iso9283.AP.max": ComparedFigure(1.0, "m")})])


def document(**changes: Any) -> dict[str, Any]:
    return {"schema": "robacc.estimate/1", "robacc": "1", "command": "estimate", "n_poses": 2} | changes


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"n_poses": "2"}, "r.json, n_poses: a number of poses is expected here"),
        ({"position": {"rms_m": "x"}}, "r.json, position.rms_m: a number is expected here, found 'x'"),
        ({"position": {"rms_m": True}}, "r.json, position.rms_m: a number is expected here, found 'True'"),
        ({"position": {"rms_m": 1.0, "errors_m": [[1, 2, 3]]}}, "position.errors_m: 2 rows of 3 numbers are expected"),
        ({"position": {"rms_m": 1.0, "errors_m": "x"}}, "position.errors_m: 2 rows of 3 numbers are expected here"),
        (
            {"position": {"rms_m": 1.0, "errors_m": [[1, 2, None], [1, 2, 3]]}},
            "r.json, position.errors_m: numbers below 1e+09 are expected here",
        ),
        ({"position": {"rms_m": 1.0}, "poses": {"pose": [1, 2]}}, "r.json, poses.pose: 2 texts are expected here"),
        ({"position": {"rms_m": 1.0}, "robot": {"name": 3}}, "r.json, robot.name: a text is expected here, found '3'"),
        ({}, "r.json, position: the figures of a result are expected here"),
        (
            {
                "position": {"rms_m": 1.0},
                "grade": {"scale": "s", "statistic": "rms", "otherwise": "F", "confidence": 0.9, "steps": [3]},
            },
            "r.json, grade.steps.0: a grade and its limit of position are expected here",
        ),
    ],
)
def test_what_is_wrong_with_a_result_is_said_with_its_place(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError) as caught:
        subject(document(**changes), "r", "r.json", "00")
    assert problem in str(caught.value)


def test_outliers_of_a_fit_are_flags() -> None:
    fit = document(command="calibrate", n_folds=5, after={"fitted": {"position": {"rms_m": 1.0}}})
    fit["poses"] = {"used": [1, 0]}
    with pytest.raises(InputError, match=r"poses.used: 2 of true and false are expected here"):
        subject(fit, "r", "r.json", "00")


def test_other_results_have_nothing_to_compare() -> None:
    with pytest.raises(UsageError, match=r"r.json is a result of show; compared are those of estimate, calibrate"):
        subject(document(command="show"), "r", "r.json", "00")
