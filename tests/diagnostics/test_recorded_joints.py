"""Joints read back, and joints recorded with few digits, on an arm with matrices of its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from arms import arm
from independent_arm import Run, measured, robot, run, targets
from searched import ARM, fitted, found, model, values_of

import robacc
from robacc.diagnostics.recorded import evident_rounding, read_back_warning
from robacc.measurements import Measurements
from robacc.poses.csv_file import format_poses, read_poses
from robacc.robots.arm import Arm
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.search import search
from robacc.tracing.trace import trace

NOISE = 1e-5
N = 80
POSES = run(N, seed=41)
OFF = np.random.default_rng(42).normal(scale=2e-4, size=(6, N))
"""How far the joints read back are off the commanded ones, rad."""


def with_both(share: float) -> Measurements:
    """An arm that stands a share of the way from its command to the joints read back."""
    data = measured(POSES, targets(POSES.q + share * OFF), NOISE, 3)
    return dataclasses.replace(data, read_back=POSES.q + OFF)


def test_an_arm_that_stands_at_the_joints_read_back_is_told() -> None:
    data = with_both(1.0)
    (effect,) = found(data)
    assert str(effect) == "read_back"
    final = fitted(data, (effect,))
    values = values_of(final)
    assert values["read_back"] == pytest.approx(1.0, abs=0.05)
    assert "follow the joints read back, not those commanded" in effect.statement(ARM, values)
    assert not list(read_back_warning(final, data))


def test_joints_read_before_settling_leave_the_commanded_ones_in_force() -> None:
    data = with_both(0.0)
    assert found(data) == ()
    (text,) = read_back_warning(fitted(data), data)
    assert "read before the arm had settled" in text
    share = float(text.split("share of ")[1].split(" ")[0])
    assert abs(share) < 0.05


def test_a_fit_without_the_effect_says_where_the_arm_stood() -> None:
    data = with_both(1.0)
    (text,) = read_back_warning(fitted(data), data)
    assert "give the joints read back as q1 … qN" in text
    assert float(text.split("share of ")[1].split(" ")[0]) == pytest.approx(1.0, abs=0.05)


def test_joints_of_another_unit_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("q1,read_q1,x,y,z\n0.5,28.6,1,0,0\n0.6,34.4,1,0,0\n")
    with pytest.raises(Exception, match="check the unit and the order of the columns read back"):
        read_poses(path)


def test_commanded_joints_may_say_so(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("cmd_q1_deg,cmd_q2_deg,x,y,z\n10,20,1,0,0\n11,21,1,0,0\n")
    data = read_poses(path)
    np.testing.assert_allclose(np.degrees(data.q), [[10, 11], [20, 21]])


def test_an_export_with_both_has_both(tmp_path: Path) -> None:
    path = tmp_path / "export.csv"
    rows = "\n".join(f"{i},{2 * i},{i + 0.01},{2 * i + 0.02},{100 + i},{i},{2 * i}" for i in range(10, 20))
    path.write_text("J1 cmd [deg],J2 cmd [deg],J1 actual [deg],J2 actual [deg],X [mm],Y [mm],Z [mm]\n" + rows + "\n")
    data = read_poses(path)
    np.testing.assert_allclose(np.degrees(data.read_back - data.q), np.tile([[0.01], [0.02]], 10), atol=1e-9)


def rounded(step_degrees: float, is_command: bool) -> Measurements:
    """Poses with joints in whole steps: commanded so, or recorded so."""
    whole = np.radians(np.round(np.degrees(POSES.q) / step_degrees) * step_degrees)
    position = targets(whole if is_command else POSES.q)
    return measured(Run(whole, POSES.direction, POSES.time), position, NOISE, 4)


def test_rounding_is_named_and_counts_as_scatter() -> None:
    data = rounded(0.1, is_command=False)
    result = trace(model(data), data, n_folds=2)
    assert result.verdict == "clean"
    (text,) = [warning for warning in result.warnings if "rounded" in warning]
    assert text.startswith("the joint variables are rounded to 0.1 degrees")
    expected = evident_rounding(fitted(data), data)
    np.testing.assert_allclose(expected.std, np.radians(0.1) / np.sqrt(12.0))
    moved = targets(data.q) - targets(POSES.q)
    assert expected.position == pytest.approx(float(np.sqrt(np.mean(np.sum(moved**2, axis=0)))), rel=0.15)


def test_commands_in_whole_steps_and_exact_positions_show_no_rounding() -> None:
    data = rounded(0.1, is_command=True)
    result = fitted(data)
    assert evident_rounding(result, data) is None
    exact = dataclasses.replace(result, residual=np.zeros_like(result.residual))
    assert evident_rounding(exact, data) is None


def test_an_error_that_resembles_the_difference_is_no_settling() -> None:
    """The measured positions move against the difference, as no arm between command and reading does."""
    data = with_both(-0.8)
    (text,) = read_back_warning(fitted(data), data)
    assert "only 0 to 1 is possible" in text
    assert "settled" not in text
    assert search(model(data), data, only=["read_back", "gear_ratio"]).effects == ()


UR10 = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ipa_ur10"
needs_data = pytest.mark.skipif(not UR10.is_dir(), reason="the real data are not here")


def recorded(series: str) -> tuple[Arm, Measurements]:
    """Every fifth pose of a recorded campaign."""
    arm = robacc.read_robot(UR10 / "robot.yaml")
    data = robacc.read_poses(UR10 / f"series_{series}.csv", robot=arm)
    return Arm.of(arm), data.subset(np.arange(0, data.n, 5))


@needs_data
@pytest.mark.parametrize("series", ["B", "D"])
def test_real_joints_are_not_rounded_until_they_are(series: str) -> None:
    arm, data = recorded(series)
    assert evident_rounding(fitted(data, (), arm), data) is None
    for step, is_evident in ((1e-4, False), (1e-3, False), (0.1, True)):
        rounded = dataclasses.replace(data, q=np.radians(step * np.round(np.degrees(data.q) / step)))
        rounding = evident_rounding(fitted(rounded, (), arm), rounded)
        assert (rounding is not None) is is_evident, step


@pytest.mark.parametrize("is_command", [False, True])
def test_an_estimate_names_the_rounding_that_its_errors_show(tmp_path: Path, is_command: bool) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(format_poses(rounded(0.1, is_command)), encoding="utf-8")
    warnings = robacc.estimate(path, robot=robot(), align=("base_frame", "tool_frame")).warnings
    texts = [text for text in warnings if "rounded" in text]
    assert len(texts) == (0 if is_command else 1)
    if texts:
        assert texts[0].startswith("the joint variables are rounded to 0.1 degrees, which moves the target by ")


def test_positions_that_a_controller_computed_are_told_from_measured_ones(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    for noise, told in ((0.0, True), (2e-5, False)):
        data = simulate(arm("puma560").robot, Plan(40, seed=4, noise_position=noise, orientation=False)).data
        rounded_to_um = dataclasses.replace(data, position=np.round(data.position, 6))
        path.write_text(format_poses(rounded_to_um), encoding="utf-8")
        warnings = robacc.estimate(path, robot=arm("puma560").robot, align="none").warnings
        assert any("look computed from the joints, not measured" in text for text in warnings) == told
