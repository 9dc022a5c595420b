"""An instrument that moved between two rows is named; errors of other kinds are not taken for it."""

from __future__ import annotations

import numpy as np
import pytest

import robacc
from robacc.accuracy.estimation import moved_warning
from robacc.measurements import Measurements

SHIFT = np.array([[2.4e-3], [3.2e-3], [0.0]])


@pytest.mark.parametrize("align", ["base_frame,tool_frame", "none"])
def test_a_step_is_named_with_its_size_and_line(align: str) -> None:
    data = robacc.read_poses("sample_data/poses.csv", robot="sample_data/robot.yaml")
    position = data.position + np.where(np.arange(data.n) >= 35, SHIFT, 0.0)
    moved = Measurements(position, q=data.q)
    still = robacc.estimate(Measurements(data.position, q=data.q), robot="sample_data/robot.yaml", align=align)
    assert not any("moved" in text for text in still.warnings)
    (warning,) = robacc.estimate(moved, robot="sample_data/robot.yaml", align="base_frame,tool_frame").warnings
    assert warning.startswith("the errors change by 4")
    assert "at line 36: the instrument or the robot base moved there" in warning


def test_commanded_poses_show_it_without_a_robot() -> None:
    rng = np.random.default_rng(0)
    commanded = rng.uniform(-1, 1, (3, 40))
    error = rng.normal(scale=3e-4, size=(3, 40)) + np.where(np.arange(40) >= 20, SHIFT, 0.0)
    (warning,) = robacc.estimate(Measurements(commanded + error, commanded_position=commanded)).warnings
    assert "at line 21: the instrument" in warning


def test_chance_gives_no_step() -> None:
    rng = np.random.default_rng(3)
    for n in (5, 20, 30, 200):
        for _ in range(50):
            error = rng.normal(size=(3, n)) * rng.lognormal(size=n)
            assert moved_warning(Measurements(np.zeros((3, n))), error) == ()


def test_two_positions_in_another_frame_have_no_figure() -> None:
    commanded = np.array([[0.0, 0.5], [0.0, 0.2], [1.0, 0.7]])
    far = Measurements(commanded + 2.0, commanded_position=commanded)
    with pytest.raises(
        robacc.InputError, match=r"2 positions whose errors, 3\.46e\+03 mm rms, .* registration needs more"
    ):
        robacc.estimate(far)
    assert robacc.estimate(far, align="none").position.rms == pytest.approx(2.0 * np.sqrt(3))
    near = Measurements(commanded + 1e-4, commanded_position=commanded)
    assert robacc.estimate(near).position.rms == pytest.approx(1e-4 * np.sqrt(3))
