"""Predicted errors against campaigns that the tool itself fits, simulated and recorded; plans of too few poses."""

from pathlib import Path

import numpy as np
import pytest
from arms import arm
from sample_files import ROOT
from test_design import positions

import robacc
from robacc.fitting.priors import weak_kinds
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.campaign import plan_campaign
from robacc.planning.expected import free_effects

SCATTER = 3e-5


def test_the_fit_of_a_model_is_known(tmp_path: Path) -> None:
    robot, poses = ROOT / "sample_data" / "robot.yaml", ROOT / "sample_data" / "poses.csv"
    effects = "base_frame,tool_frame,joint_offset,link_geometry"
    fitted = robacc.calibrate(poses, robot=robot, fit=effects)
    model = tmp_path / "model.yaml"
    fitted.write_model(model)
    plan = robacc.plan(robot, model=model, candidates=150, poses=3, repeats=0, check_every=0)
    assert "noise of the model's fit" in plan.noise.source
    assert plan.noise.position == pytest.approx(fitted.fit.noise.position, rel=1e-6)
    assert plan.sufficiency["of_model"]
    before = {entry.name: entry.std for entry in fitted.parameters if entry.std is not None}
    after = {entry["name"]: entry["std"] for entry in plan.coefficients if entry["std"] is not None}
    common = sorted(set(before) & set(after))
    assert len(common) > 15
    # Three more poses make every standard error smaller, but not by much beside those of the fit.
    shares = np.array([after[name] / before[name] for name in common])
    assert np.all(shares < 1.001)
    assert 0.5 < shares.mean() < 1.0


def test_the_prior_is_that_of_the_fit() -> None:
    noise = 1e-3
    plan = plan_campaign(arm("irb1600").robot, "calibrate", 20, noise=noise, repeatability=SCATTER, n_candidates=300)
    robot, q = plan.robot, plan.visits.q
    rng = np.random.default_rng(1)
    measured = positions(robot, q, {}) + noise * rng.normal(size=(3, q.shape[1]))
    effects = free_effects(robot, "base_frame,tool_frame,joint_offset,link_geometry")
    fitted = fit(Model.of(robot, effects), Measurements(position=measured, q=q))
    kinds = weak_kinds(fitted)
    assert ("link_geometry", "m", 3e-3) in {(kind.effect, kind.unit, kind.std) for kind in kinds}
    # With the variance v of the poses alone, a constant of the usual deviation u and a prior of precision
    # k = 1 / (9 u^2 + 1.5 s^2), s^2 = (u^2 + v) / (1 + k v)^2 the variance of its estimate, has an error of
    # (v + k^2 v^2 u^2) / (1 + k v)^2: at most 3.99 u^2, at v = 15.5 u^2.
    stds = [entry["std"] for entry in plan.coefficients if entry["std"] is not None and "frame" not in entry["name"]]
    assert max(stds) < 2.0e-3


@pytest.mark.parametrize(("settings", "enough"), [({}, 9), ({"noise_orientation": 1e-4}, 5)])
def test_a_plan_of_too_few_poses_is_warned_of(settings: dict[str, float], enough: int) -> None:
    """A position has three coordinates, and a pose six; positions identify 27 coefficients, poses some more."""
    few, least = (
        plan_campaign(arm("puma560").robot, "calibrate", poses, n_candidates=100, **settings)  # type: ignore[arg-type]
        for poses in (enough - 1, enough)
    )
    assert f"plan at least {enough} poses" in "".join(few.warnings)
    assert least.warnings == ()
