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
from robacc.planning.campaign import CampaignPlan, plan_campaign
from robacc.planning.expected import free_effects

SCATTER = 3e-5


def realised(plan: CampaignPlan, noise: float, campaigns: int, fresh: int = 200) -> tuple[np.ndarray, float]:
    """RMS error of each estimate of a constant, and of the position at fresh poses, over arms of usual deviations."""
    robot, q = plan.robot, plan.visits.q
    names = [entry["name"] for entry in plan.coefficients if entry["std"] is not None]
    constants = [name for name in names if "frame" not in name]
    model = Model.of(robot, free_effects(robot, plan.fit or "base_frame,tool_frame,joint_offset,link_geometry"))
    rng = np.random.default_rng(0)
    test = plan.candidates.q[:, :fresh]
    errors, held_out = [], []
    for _ in range(campaigns):
        truth = {name: 1e-3 * rng.normal() for name in constants}
        attained = q + plan.noise.joints[:, None] * rng.normal(size=q.shape)
        measured = positions(robot, attained, truth) + noise * rng.normal(size=(3, q.shape[1]))
        fitted = fit(model, Measurements(position=measured, q=q))
        values = dict(zip(fitted.names, fitted.theta, strict=True))
        errors.append([values[name] - truth[name] for name in constants])
        predicted = fitted.predict(Measurements(position=np.zeros((3, fresh)), q=test)).translation
        held_out.append(np.mean(np.sum(np.square(predicted - positions(robot, test, truth)), axis=0)))
    return np.sqrt(np.mean(np.square(errors), axis=0)), float(np.mean(held_out)) ** 0.5


def compared(name: str, poses: int, noise: float, campaigns: int) -> tuple[float, float]:
    """Geometric mean of predicted over realised standard errors, and the same of the error at fresh poses."""
    plan = plan_campaign(arm(name).robot, "calibrate", poses, noise=noise, repeatability=SCATTER, n_candidates=600)
    errors, held_out = realised(plan, noise, campaigns)
    predicted = [
        entry["std"] for entry in plan.coefficients if entry["std"] is not None and "frame" not in entry["name"]
    ]
    return float(np.exp(np.mean(np.log(predicted / errors)))), plan.accuracy["planned"]["rms_m"] / held_out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "poses", "noise"),
    [("irb1600", 30, 5e-5), ("ur10", 30, 5e-5), ("irb1600", 30, 1e-3), ("ur10", 20, 1e-3)],
)
def test_predictions_are_realised_over_200_campaigns(name: str, poses: int, noise: float) -> None:
    ratio, held_out = compared(name, poses, noise, 200)
    assert 0.9 < ratio < 1.1
    assert 0.9 < held_out < 1.1


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
