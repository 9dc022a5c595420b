"""The arm of the package that fits is named where another arm was stated; the right arm is never doubted."""

from __future__ import annotations

import numpy as np
import pytest

import robacc
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.robot_file import read_robot


def measured(arm: str, n: int = 40) -> Measurements:
    rng = np.random.default_rng(1)
    data = Measurements(np.zeros((3, n)), q=rng.uniform(-2.5, 2.5, (6, n)))
    position = predict(read_robot(arm), data).translation + rng.normal(scale=2e-4, size=(3, n))
    return Measurements(position + np.array([[2.0], [-1.0], [0.5]]), q=data.q)


@pytest.mark.parametrize("stated", ["ur10", "ur5e"])
def test_the_arm_that_was_measured_is_named(stated: str) -> None:
    result = robacc.estimate(measured("ur10e"), robot=stated)
    (warning,) = [text for text in result.warnings if "of the package" in text or "the package's" in text]
    assert "the package's ur10e 0." in warning
    assert "check that `robot` is the arm that was measured" in warning


def test_a_trace_names_it_too() -> None:
    warnings = robacc.calibrate(measured("ur10e"), robot="ur10", fit="base_frame,tool_frame").warnings
    assert any("the package's ur10e" in text for text in warnings)


def test_the_right_arm_is_not_doubted() -> None:
    assert not any("package" in text for text in robacc.estimate(measured("ur10e"), robot="ur10e").warnings)
    other = measured("ur10e")
    noisy = Measurements(other.position + np.random.default_rng(2).normal(scale=0.01, size=(3, 40)), q=other.q)
    assert not any("package" in text for text in robacc.estimate(noisy, robot="ur10e").warnings)
