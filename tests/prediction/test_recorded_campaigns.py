"""Bounds of a model on recorded poses of a UR10: held-out poses of its campaign, and those of another one; slow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robacc

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ipa_ur10"
FIT = "base_frame,tool_frame,joint_offset,link_geometry,joint_compliance,transmission_error"


@pytest.mark.slow
@pytest.mark.skipif(not DATA.exists(), reason="needs the recorded UR10")
def test_recorded_poses_lie_within_their_bounds() -> None:
    first = robacc.read_poses(DATA / "series_B.csv")
    rows = np.arange(first.n)
    fitted, held, unseen = (first.subset(rows[rows % 3 == k]) for k in range(3))
    model = robacc.calibrate(fitted, robot=DATA / "robot.yaml", fit=FIT, holdout=held).robot
    position, orientation = robacc.predict(model, against=unseen).coverage
    assert 0.93 < position.share < 0.97
    assert 0.93 < orientation.share < 0.97
    # Another day, the target mounted anew, and every pose beyond the ranges of the fit.
    again = robacc.predict(model, against=DATA / "series_D.csv", align="base_frame,tool_frame")
    assert any("632 of 632 configurations lie outside" in note for note in again.notes)
    # Beyond the ranges bounds are wide: the next part of a gear's turn may be rougher than the last.
    position, orientation = again.coverage
    assert position.share > 0.93
    assert orientation.share > 0.93
