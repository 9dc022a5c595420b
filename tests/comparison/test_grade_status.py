"""Status of results against a required grade, at each limit itself and on either side of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from robacc.accuracy.grade import GradeStep, Scale
from robacc.comparison.comparing import common_scale, grade_statuses
from robacc.comparison.stored_results import ComparedResult, ErrorSet
from robacc.errors import UsageError
from robacc.statistics.intervals import EstimatedValue

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


def errors(rms: float, n: int) -> np.ndarray:
    vectors = np.random.default_rng(1).normal(size=(3, n))
    scaled: np.ndarray = vectors * rms / math.sqrt(np.mean(np.sum(vectors**2, axis=0)))
    return scaled


@pytest.mark.parametrize(
    ("rms", "grade", "own"), [(0.5, "fine", "fine"), (0.5, "coarse", "fine"), (2.0, "coarse", "coarse")]
)
def test_the_required_grade_itself_and_better_ones_are_confirmed(rms: float, grade: str, own: str) -> None:
    answer = status(measured(errors(rms, 400)), grade)
    assert (answer["verdict"], answer["grade"], answer["why"]) == ("demonstrated", own, None)
    assert answer["position_m"] < answer["position_upper_bound_m"]


def test_a_grade_met_by_the_value_alone_is_not_confirmed() -> None:
    answer = status(measured(errors(0.99, 30)), "fine")
    assert (answer["verdict"], answer["grade"]) == ("met_not_demonstrated", "fine")
    assert answer["why"] == "the upper 95 % bound is beyond the limit"
    assert answer["poses_to_demonstrate"] is not None
    assert status(measured(errors(0.99, 30)), "coarse")["verdict"] == "demonstrated"
    assert status(measured(errors(1.01, 30)), "fine")["verdict"] == "not_met"


def test_scales_that_differ_or_are_incomplete_need_a_choice() -> None:
    other = Scale("two", "p95", 0.95, SCALE.steps, "none")
    assert common_scale([result(scale=SCALE, scale_name="two")]) is SCALE
    with pytest.raises(UsageError, match=r"graded on different scales with the name two; choose the scale with"):
        common_scale([result(scale=scale, scale_name="two") for scale in (SCALE, other)])
    with pytest.raises(UsageError, match=r"no result stores the complete scale two; give its file with"):
        common_scale([result(scale_name="two")])
