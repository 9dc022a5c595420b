"""Results that could be taken for more than they are: a warning says so, and unknown figures are absent."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

import robacc

ROOT = Path(__file__).resolve().parents[2] / "sample_data"
CLEAN, NOMINAL = ROOT / "poses.csv", ROOT / "robot.yaml"
ROBOT, TRUTH = ROOT / "trace/robot.yaml", ROOT / "trace/truth.yaml"


@pytest.fixture(scope="module")
def without_frames() -> robacc.Calibrated:
    return robacc.calibrate(CLEAN, robot=NOMINAL, fit=("joint_offset[j2]", "gear_ratio"), folds=2)


def test_a_requested_effect_that_no_joint_shows_is_named(without_frames: robacc.Calibrated) -> None:
    assert any("no joint shows gear_ratio" in text for text in without_frames.warnings)


def test_a_model_worse_than_registration_alone_is_named(without_frames: robacc.Calibrated) -> None:
    after, registered = without_frames.after.fitted.position.rms, without_frames.nominal.fitted.position.rms
    assert after > registered
    [text] = [text for text in without_frames.warnings if "worse" in text]
    assert f"{1e3 * after:.3g} mm" in text
    assert text.endswith("add base_frame,tool_frame to `fit`")


def test_a_fit_to_positions_expects_no_orientation_error() -> None:
    poses = robacc.simulate(TRUTH, poses=60, seed=3, noise="0.02mm", position_only=True).data
    fitted = robacc.calibrate(poses, robot=ROBOT, fit=("base_frame", "tool_frame"), folds=2)
    targets = robacc.simulate(ROBOT, poses=4, seed=5, motion=False).data
    result = robacc.correct(targets, model=fitted.robot, beyond_range=True, most="50mm,5deg")
    document = result.document()
    after = document["expected"]["after"]
    assert after["position"]["expected_rms_m"] > 0
    assert (after["orientation"]["expected_rms_rad"], document["targets"]["after"]["rms_rad"]) == (None, None)
    columns = next(csv.reader(io.StringIO(result.per_target_csv())))
    assert "after_rms_m" in columns
    assert "after_rms_rad" not in columns


def test_a_correction_by_the_nominal_model_is_named_zero() -> None:
    targets = robacc.simulate(ROBOT, poses=3, seed=5, motion=False).data
    [text] = robacc.correct(targets, model=ROBOT).doubts
    assert "every correction is zero" in text
