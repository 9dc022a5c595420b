"""Outliers that share a circumstance are told from accidents of the instrument."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

import numpy as np
import pytest
from arms import arm

from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit
from robacc.fitting.solver import fit, outlier_pattern
from robacc.fitting.warnings import fit_warnings, lack_of_fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict

NAMES = ("j1", "j2", "j3", "j4", "j5", "j6")


def sample(n: int, seed: int) -> Measurements:
    rng = np.random.default_rng(seed)
    return Measurements(
        position=rng.normal(size=(3, n)), q=rng.uniform(-1.5, 1.5, size=(6, n)), time=np.arange(n) * 9.0
    )


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        (lambda data: data.q[1] > 1.3, r"j2 above 1\.3\d* \(rad or m\)"),
        (lambda data: data.time >= 9.0 * 143, "(time|row number) above "),
    ],
    ids=["large angles of a joint", "one time"],
)
def test_rows_that_share_a_circumstance_are_named(chosen: Callable[[Measurements], np.ndarray], expected: str) -> None:
    data = sample(150, 1)
    pattern = str(outlier_pattern(data, chosen(data), NAMES))
    assert re.match(rf"(\d+) of \1 outliers have {expected}", pattern), pattern
    assert re.search("but only .*: the outliers have a common cause$", pattern)


def displaced(size: float, rows: np.ndarray) -> tuple[Measurements, Fit]:
    """Return poses of a UR10 whose rows ``rows`` are displaced, and the fit of its geometry."""
    robot = dataclasses.replace(arm("ur10").robot, effects=())
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, size=(6, 120))
    data = Measurements(position=np.zeros((3, 120)), q=q)
    position = predict(robot, data).translation + rng.normal(scale=1e-5, size=(3, 120))
    position[2, rows] += size
    data = dataclasses.replace(data, position=position)
    model = Model.of(robot, build(parse_requests("base_frame,joint_offset"), Model.of(robot).arm, data))
    return data, fit(model, data)


def outlier_warnings(fitted: Fit, data: Measurements) -> list[str]:
    texts = fit_warnings(fitted, data, lack_of_fit(fitted, data), fitted, (1.0, 1.0))
    return [text for text in texts if "outliers" in text]


def test_rows_that_a_lacking_effect_displaces_stay_in_the_fit() -> None:
    q = np.random.default_rng(3).uniform(-1.5, 1.5, size=(6, 120))
    extreme = np.flatnonzero(q[1] > 1.2)
    data, fitted = displaced(1.5e-4, extreme)
    assert fitted.inliers.all()
    accidents = np.array([3, 40, 77])
    data, fitted = displaced(1.5e-4, accidents)
    assert set(fitted.outliers) == set(accidents)
    assert len(outlier_warnings(fitted, data)) == 1


def test_gross_rows_are_left_out_and_their_circumstance_is_named() -> None:
    q = np.random.default_rng(3).uniform(-1.5, 1.5, size=(6, 120))
    extreme = np.argsort(q[1])[-4:]
    data, fitted = displaced(0.03, extreme)
    assert set(fitted.outliers) == set(extreme)
    assert fitted.model.arm.names[1] in outlier_warnings(fitted, data)[1]
