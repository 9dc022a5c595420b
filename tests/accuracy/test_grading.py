"""Grades: the scale file with every message, the grade, and when it counts as demonstrated."""

import math
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from refusals import problems_of
from scipy.stats import chi2

from robacc.accuracy.error_statistics import ErrorStatistics, error_statistics
from robacc.accuracy.grade import Grade, GradeStep, Scale, default_scale, grade, load_scale
from robacc.errors import UsageError
from robacc.statistics.intervals import ChiSquareCurve, Interval

CONFIGS = Path(__file__).resolve().parents[2] / "configs" / "grades"
SCALE = Scale(
    "test",
    "rms",
    0.95,
    (GradeStep("A", 1e-4, 1e-3), GradeStep("B", 2e-4, 2e-3), GradeStep("C", 5e-4, 5e-3)),
    "D",
)
GOOD = """\
robacc: 1
name: mine
statistic: rms
confidence: 0.9
units: {length: m, angle: rad}
steps:
  - {grade: A, position: 1e-4, orientation: 2e-3}
  - {grade: B, position: 3e-4}
otherwise: C
"""


def errors_of(value: float, bound: float | None, unit: str = "m", why: str | None = "few") -> ErrorStatistics:
    """Statistics whose RMS and its upper bound are as given, or why there is no bound."""
    result = error_statistics(np.random.default_rng(0).normal(size=(3, 30)), unit)
    interval = Interval(None, None, bound, 0.95, "given", why if bound is None else None)
    return result._replace(rms=value, intervals=result.intervals._replace(rms=interval))


def graded(
    value: float, bound: float | None, angle: float | None = None, angle_bound: float | None = None, why: str = "few"
) -> Grade:
    orientation = None if angle is None else errors_of(angle, angle_bound, "rad", why)
    return grade(errors_of(value, bound, why=why), orientation, SCALE)


@pytest.mark.parametrize(
    ("value", "letter"), [(0.0, "A"), (1e-4, "A"), (1.0001e-4, "B"), (2e-4, "B"), (5e-4, "C"), (5.1e-4, "D")]
)
def test_grade_by_the_estimate(value: float, letter: str) -> None:
    assert graded(value, value).grade == letter


@pytest.mark.parametrize(
    ("value", "bound", "demonstrated", "confirmed"),
    [
        (0.9e-4, 1e-4, True, "A"),
        (0.9e-4, 1.1e-4, False, "B"),
        (0.9e-4, 4e-4, False, "C"),
        (0.9e-4, 6e-4, False, None),
        (1.5e-4, 1.9e-4, True, "B"),
        (1.5e-4, None, False, None),
        (9e-4, 1e-3, False, None),
    ],
)
def test_confirmed_only_where_the_upper_bound_meets_the_limit(
    value: float, bound: float | None, demonstrated: bool, confirmed: str | None
) -> None:
    result = graded(value, bound)
    assert result.demonstrated is demonstrated
    assert result.demonstrated_grade == confirmed


def test_the_worse_of_position_and_orientation_decides() -> None:
    result = graded(0.5e-4, 0.9e-4, 3e-3, 6e-3)
    assert (result.grade, result.limited_by, result.demonstrated) == ("C", ("orientation",), False)
    assert (result.position.grade, result.position.demonstrated_grade, result.position.limit) == ("A", "A", 5e-4)
    assert (result.orientation.grade, result.orientation.demonstrated_grade) == ("C", None)
    assert [*result.next.values()] == ["B", 0.0, pytest.approx(1e-3)]
    both = graded(1.5e-4, 1.6e-4, 1.5e-3, 1.6e-3)
    assert both.limited_by == ("position", "orientation")


def test_the_best_grade_and_beyond_the_last_step() -> None:
    best = graded(0.5e-4, 0.9e-4, 0.5e-3, 0.6e-3)
    assert (best.grade, best.limited_by, best.next, best.demonstrated) == ("A", (), None, True)
    worst = graded(9e-4, 1e-3)
    assert (worst.grade, worst.demonstrated, worst.position.limit) == ("D", False, None)
    assert [*worst.next.values()][:2] == ["C", pytest.approx(4e-4)]


def test_reasons_in_words() -> None:
    assert graded(1.234e-4, 1.5e-4).reason == (
        "position: rms error 0.123 mm, within 0.2 mm. "
        "orientation was not measured, so the grade covers position only. "
        "limited by position: grade A needs 0.0234 mm less in position. "
        "confirmed at 95 % confidence: the upper bound is within the limit (position 0.15 mm)"
    )
    assert graded(0.9e-4, 1.5e-4, 0.5e-3, 0.6e-3).reason == (
        "position: rms error 0.09 mm, within 0.1 mm; orientation: rms error 0.0286°, within 0.0573°. "
        "not confirmed at 95 % confidence: the upper bound is beyond a limit (position 0.15 mm, orientation 0.0344°); "
        "grade B is confirmed"
    )
    # 0.1002 mm is not within 0.1 mm, and the text must not read as if it were.
    assert graded(1.002e-4, 1.5e-4).reason.startswith("position: rms error 0.1002 mm, within 0.2 mm. ")
    assert graded(1e-4, 1.5e-4).reason.startswith("position: rms error 0.1 mm, within 0.1 mm. ")
    assert graded(0.9e-4, 9e-4).reason.endswith("(position 0.9 mm); no grade is confirmed")
    assert graded(0.9e-4, None, why="one pose").reason.endswith(
        "not confirmed at 95 % confidence: position has no upper bound (one pose)"
    )
    assert "beyond the limit of C, 0.5 mm" in graded(9e-4, 1e-3).reason
    assert graded(9e-4, 1e-3).reason.endswith("no step of the scale is met, so no grade can be confirmed")


def test_confidence_must_agree() -> None:
    statistics = error_statistics(np.random.default_rng(0).normal(size=(3, 20)), "m", confidence=0.9)
    with pytest.raises(
        UsageError, match=r"the position statistics have a confidence of 0.9, but the scale test requires"
    ):
        grade(statistics, None, SCALE)


def test_default_scale_is_the_papers_requirement() -> None:
    scale = default_scale()
    assert (scale.statistic, scale.confidence, scale.otherwise) == ("p95", 0.95, "F")
    assert [step.grade for step in scale.steps] == ["A", "B", "C", "D", "E"]
    assert scale.steps[0].position == pytest.approx(1e-4)
    assert scale.steps[0].orientation == pytest.approx(math.radians(0.1))


def test_the_example_beside_the_package_is_the_packages_own() -> None:
    packaged = files("robacc").joinpath("data", "grades", "default.yaml").read_text(encoding="utf-8")
    assert (CONFIGS / "default.yaml").read_text(encoding="utf-8") == packaged


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.name)
def test_every_example_scale_loads(path: Path) -> None:
    assert load_scale(path.read_text(encoding="utf-8"), path.name).steps


def test_a_free_orientation_limits_nothing() -> None:
    scale = load_scale(GOOD, "mine.yaml")._replace(confidence=0.95)
    result = grade(errors_of(2e-4, 2.5e-4), errors_of(0.5, None, "rad", "few"), scale)
    assert (result.grade, result.demonstrated, result.demonstrated_grade) == ("B", True, "B")
    assert result.orientation.limit is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("robacc: 1", "robacc: 2", "s.yaml:1, robacc: expected 1, found '2'"),
        ("name: mine\n", "", "s.yaml:1, name: is missing"),
        ("name: mine", "name:", "s.yaml:2, name: is missing"),
        ("name: mine", "name: [a]", "s.yaml:2, name: expected a name, found a list of 1"),
        (
            "statistic: rms",
            "statistic: p99",
            "s.yaml:3, statistic: expected rms or mean_error or p95 or max, found 'p99'; did you mean 'p95'?",
        ),
        ("0.9", "95", "s.yaml:4, confidence: found 95, expected at least 0.5 and less than 1"),
        ("0.9", "high", "s.yaml:4, confidence: expected a number, found 'high'"),
        (
            "units: {length: m, angle: rad}\n",
            "",
            "s.yaml:1, units: is missing; add it, for example units: {length: mm, angle: deg}",
        ),
        ("length: m,", "length: inch,", "s.yaml:5, units.length: expected m or mm or um, found 'inch'"),
        (", angle: rad", "", "s.yaml:5, units.angle: is missing"),
        ("position: 3e-4", "position: -3e-4", "s.yaml:8, steps[1].position: found -0.0003, expected a number greater"),
        ("position: 3e-4", "position: .inf", "s.yaml:8, steps[1].position: expected a finite number, found .inf"),
        ("position: 3e-4", "postion: 3e-4", "s.yaml:8, steps[1].postion: unknown key; did you mean 'position'?"),
        (
            "position: 3e-4",
            "position: 1e-4",
            "s.yaml:8, steps[1].position: the limit is not wider than that of grade A",
        ),
        ("{grade: B,", "{grade: A,", "s.yaml:8, steps[1].grade: the grade 'A' is listed twice"),
        ("{grade: B,", "{", "s.yaml:8, steps[1].grade: is missing"),
        (
            "3e-4}",
            "3e-4, orientation: 1e-3}",
            "s.yaml:8, steps[1].orientation: the limit is narrower than that of grade A",
        ),
        (", orientation: 2e-3}", "}", None),
        ("otherwise: C", "otherwise: A", "s.yaml:9, otherwise: 'A' is also the grade of a step; choose another name"),
        (
            "otherwise: C",
            "otherwise: C\nname: twice",
            "s.yaml:10, name: is given twice, first in line 2",
        ),
        (
            "otherwise: C",
            "otherwise: C\nxyzzy: 1",
            "s.yaml:10, xyzzy: unknown key; known keys: robacc, name",
        ),
        (
            "  - {grade: B, position: 3e-4}",
            "  - B",
            "s.yaml:8, steps[1]: expected keys with values (grade, position, orientation), found 'B'",
        ),
        ("name: mine", "name: [", "s.yaml:4: cannot be read as YAML: "),
        ("name: mine", "name: \x07", "s.yaml:2: cannot be read as YAML: "),
    ],
)
def test_every_message_of_a_scale(old: str, new: str, message: str | None) -> None:
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    if message is None:
        assert load_scale(text, "s.yaml").steps[0].orientation is None
    else:
        problems = problems_of(load_scale, text, "s.yaml")
        assert any(problem.startswith(message) for problem in problems), problems


HEAD, TAIL = GOOD.split("steps:")[0], "\notherwise" + GOOD.split("otherwise")[1]


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        (
            GOOD.replace(", orientation: 2e-3}", "}").replace("3e-4}", "3e-4, orientation: 1e-3}"),
            ["s.yaml:8, steps[1].orientation: the better grade A has no limit of orientation"],
        ),
        ("- a\n", ["s.yaml:1: expected keys with values (robacc, name, statistic"]),
        ("", ["s.yaml: the file is empty"]),
        ("# nothing\n", ["s.yaml: the file is empty"]),
        # Read as carefully as a robot file; libyaml ends the process here, without a word.
        ("[" * 200_000, ["s.yaml:1: cannot be read as YAML: nested deeper than 32"]),
        (
            GOOD.replace("3e-4", "&a 3e-4"),
            ["s.yaml:8: cannot be read as YAML: anchors (&) and aliases (*) are not supported"],
        ),
        (GOOD.replace("3e-4", "3_00"), ["s.yaml:8, steps[1].position: expected a number, found '3_00'"]),
        (GOOD.replace("mine", '"\\e[2J"'), ["s.yaml:2, name: expected a name, found "]),
        (f"{HEAD}steps: []{TAIL}", ["s.yaml:6, steps: a scale needs at least one step"]),
        (f"{HEAD}steps: A{TAIL}", ["s.yaml:6, steps: expected a list of steps, found 'A'"]),
        (f"{HEAD}{TAIL}", ["s.yaml:1, steps: is missing"]),
        (
            GOOD.replace("statistic: rms", "statistic: p99").replace("position: 3e-4", "position: x"),
            ["s.yaml:3, statistic: expected rms", "s.yaml:8, steps[1].position: expected a number, found 'x'"],
        ),
    ],
    ids=range(12),
)
def test_every_problem_of_a_whole_scale(text: str, messages: list[str]) -> None:
    found = problems_of(load_scale, text, "s.yaml")
    assert [part[: len(message)] for part, message in zip(found, messages, strict=True)] == messages


def test_probability_is_the_confidence_between_the_limits() -> None:
    """Of Gaussian errors of zero mean along one axis: the RMS's chi-square, read by scipy."""
    errors = np.zeros((3, 40))
    errors[0] = 1.9e-4 * np.random.default_rng(3).standard_normal(40)
    statistics = error_statistics(errors, "m")
    result = grade(statistics, None, SCALE)
    dof = 40.0
    within = [chi2.sf(dof * (statistics.rms / step.position) ** 2, dof) for step in SCALE.steps]
    shares = dict(result.probabilities)
    assert [*shares] == ["A", "B", "C", "D"]
    # Satterthwaite's degrees of freedom are estimated, and are 40 to within rounding where there is one direction.
    assert [shares["A"], shares["B"], shares["C"], shares["D"]] == pytest.approx(
        [within[0], within[1] - within[0], within[2] - within[1], 1.0 - within[2]], abs=1e-9
    )
    assert result.probability == shares[result.grade]
    assert result.probability_within(2) == pytest.approx(within[2])


@pytest.mark.parametrize("statistic", ["rms", "mean_error", "p95"])
@pytest.mark.parametrize("n", [15, 40, 200])
@pytest.mark.parametrize("kind", ["gauss", "mean", "repeated", "uniform"])
def test_a_confirmed_grade_has_the_scales_confidence(statistic: str, n: int, kind: str) -> None:
    """The curve at the one-sided bound is the bound's confidence, whatever the method; to 2000 draws' own step."""
    rng = np.random.default_rng(n)
    vectors = {
        "gauss": rng.standard_normal((3, n)),
        "mean": rng.standard_normal((3, n)) + 2.0,
        "repeated": np.repeat(rng.standard_normal((3, n)), 3, axis=1) + 1e-3 * rng.standard_normal((3, 3 * n)),
        "uniform": rng.uniform(-1.0, 1.0, (3, n)) ** 5,
    }[kind]
    groups = np.repeat(np.arange(n), 3) if kind == "repeated" else None
    for confidence in (0.8, 0.95):
        interval = error_statistics(1e-4 * vectors, "m", groups=groups, confidence=confidence).estimate(statistic)[1]
        if interval.upper_bound is None:
            continue
        assert interval.curve.below(interval.upper_bound) == pytest.approx(confidence, abs=2e-3)
        assert interval.curve.below(interval.lower) == pytest.approx(0.5 - 0.5 * confidence, abs=2e-3)
        values = [interval.curve.below(x * interval.upper_bound) for x in np.linspace(0.0, 3.0, 61)]
        assert values == sorted(values)
        assert 0.0 <= values[0] < 0.01
        assert values[-1] <= 1.0


def test_one_pose_gives_a_grade_of_unknown_probability_and_confirms_nothing() -> None:
    result = grade(error_statistics(np.full((3, 1), 1e-5), "m"), None, default_scale())
    assert (result.grade, result.demonstrated, result.demonstrated_grade) == ("A", False, None)
    assert result.position.interval.why == "1 pose: too few for a 95th percentile"
    assert "1 pose: too few for a 95th percentile" in result.reason
    assert (result.probability, result.probabilities, result.poses_to_demonstrate) == (None, (), None)


def test_the_maximum_is_never_confirmed() -> None:
    largest = error_statistics(1e-6 * np.random.default_rng(0).normal(size=(3, 500)), "m")
    result = grade(largest, None, SCALE._replace(statistic="max"))
    assert (result.grade, result.demonstrated) == ("A", False)
    assert "the largest error of all poses has no interval" in result.reason
    assert (result.probability, result.poses_to_demonstrate) == (None, None)


def test_errors_that_do_not_scatter_have_a_grade_for_certain() -> None:
    still = grade(error_statistics(np.full((3, 20), 1e-5), "m"), None, SCALE)
    assert (still.probability, still.demonstrated) == (1.0, True)


def errors_like(n: int, size: float = 1e-4, seed: int = 0) -> np.ndarray:
    return size / math.sqrt(3.0) * np.random.default_rng(seed).standard_normal((3, n))


def test_position_and_orientation_together() -> None:
    position, orientation = error_statistics(errors_like(30), "m"), error_statistics(errors_like(30, 1e-3, 1), "rad")
    combined, by_position, by_orientation = (
        grade(position, orientation, SCALE),
        grade(position, None, SCALE),
        grade(error_statistics(errors_like(500, 1e-6), "m"), orientation, SCALE),
    )
    first, second, joint = (result.probability_within(0) for result in (by_position, by_orientation, combined))
    assert joint == pytest.approx(first * second, rel=1e-6)


@pytest.mark.parametrize("share", [0.7, 0.9])
def test_number_of_poses_for_a_variance_is_the_fewest(share: float) -> None:
    """Chi-square: the bound meets the limit with probability 0.9 at the number given, and with less at one fewer."""
    curve, limit = ChiSquareCurve(1.0, 50.0), 1.0 / share
    poses = curve.poses_for(limit, 0.95, 50)

    def chance(n: int) -> float:
        return float(chi2.cdf(chi2.ppf(0.05, n) * limit, n))

    assert chance(poses) >= 0.9 > chance(poses - 1)
    assert curve.poses_for(1.0, 0.95, 50) is None
    assert curve.poses_for(1.0 + 1e-6, 0.95, 50) is None


@pytest.mark.slow
@pytest.mark.parametrize("statistic", ["rms", "mean_error", "p95"])
@pytest.mark.parametrize("n", [15, 40, 150])
def test_grades_are_as_probable_as_they_say(statistic: str, n: int) -> None:
    """Over a spread of true values: of the grades said to be 80 % sure, some 80 % are right, to within 6 %.

    Each said probability counts; those of one decile are put together (at least 80 of them, 4.5 % of one standard
    deviation at worst; what one set says of its grades goes together, so three are not asked for).
    """
    scale = Scale("fine", statistic, 0.95, tuple(GradeStep(str(i), 1e-4 * 1.25**i, None) for i in range(14)), "beyond")
    rng = np.random.default_rng(6)
    shape = np.array([1.0, 0.8, 0.5])[:, None]
    truth = error_statistics(shape * rng.standard_normal((3, 200_000)), "m").estimate(statistic)[0]
    said, right = [], []
    for seed in range(1500):
        size = 1e-4 * 1.25 ** rng.uniform(1.0, 11.0)
        errors = size / truth * shape * rng.standard_normal((3, n))
        result = grade(error_statistics(errors, "m", bootstrap=400, seed=seed), None, scale)
        true = next(step.grade for step in scale.steps if size <= step.position)
        said += [share for _, share in result.probabilities]
        right += [name == true for name, _ in result.probabilities]
    sure, hit = np.array(said), np.array(right)
    for low in np.arange(0.1, 0.95, 0.1):
        inside = (sure >= low) & (sure < low + 0.1)
        if np.count_nonzero(inside) >= 80:
            assert np.mean(hit[inside]) == pytest.approx(
                np.mean(sure[inside]), abs=0.06 + 2 * 0.5 / math.sqrt(inside.sum())
            )
