"""Planned rows of a recorded UR10: 60 of 1,495 predict the others nearly as well as a fit to all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robacc.api.inputs import load_poses, load_robot
from robacc.fitting.solver import fit
from robacc.modelling.model import Model
from robacc.planning.campaign import CampaignSettings
from robacc.planning.linear_model import free_effects
from robacc.planning.planner import plan_campaign

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ipa_ur10"
EFFECTS = "base_frame,tool_frame,joint_offset,link_geometry"


@pytest.mark.skipif(not DATA.exists(), reason="needs the recorded UR10")
@pytest.mark.slow
def test_sixty_planned_rows_do_for_all() -> None:
    robot, _ = load_robot(DATA / "robot.yaml")
    data, _ = load_poses(DATA / "series_B.csv", robot)
    assert data.q is not None

    def error(rows: np.ndarray, at: np.ndarray) -> float:
        fitted = fit(Model.of(robot, free_effects(robot, EFFECTS)), data.subset(rows))
        predicted = fitted.model.bind(data.subset(at)).poses(fitted.theta).translation
        return float(np.sqrt(np.mean(np.sum(np.square(data.position[:, at] - predicted), axis=0))))

    settings = CampaignSettings("calibrate", 60, noise=1e-5, unexplained=2.5e-4, check_every=0, repeats=0)
    plan = plan_campaign(robot, settings, candidates=data, task=data)
    chosen = plan.candidates.q[:, plan.chosen]
    rows = np.unique([int(np.argmin(np.sum(np.square(data.q - q[:, None]), axis=0))) for q in chosen.T])
    others = np.setdiff1d(np.arange(data.n), rows)
    assert rows.size == 60
    # The remaining error is a periodic error of the joints, not noise, so random rows do as well here: 1.03 to 1.12 of
    # the fit to all in twelve draws, 1.06 in the mean. Planned rows give 1.07; with other criteria, other unexplained
    # errors and orientations planned too, 1.06 to 1.14.
    assert error(rows, others) < 1.10 * error(np.arange(data.n), others)
