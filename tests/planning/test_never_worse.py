"""A plan is never worse than random poses on the criterion it was asked for, on arms of different kinds."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from arms import arm
from test_acceptance import energy_distance

from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.campaign import CampaignPlan, Purpose, plan_campaign
from robacc.planning.candidates import conditions_of
from robacc.planning.design import Criterion
from robacc.planning.expected import candidate_rows, coefficients, free_effects, power_problem, region_rows

ARMS = ("irb1600", "puma560", "scara")
POSES, CANDIDATES, DRAWS = 14, 80, 30
FIT = "base_frame,tool_frame,joint_offset"


def planned(name: str, purpose: Purpose, criterion: Criterion = "I") -> CampaignPlan:
    options = {"check_every": 0, "repeats": 0, "n_candidates": CANDIDATES, "noise": 2e-5}
    return plan_campaign(arm(name).robot, purpose, POSES, criterion, FIT, **options)  # type: ignore[arg-type]


def draws(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    return [rng.choice(count, POSES, replace=False) for _ in range(DRAWS)]


@pytest.mark.parametrize("criterion", get_args(Criterion))
@pytest.mark.parametrize("name", ARMS)
def test_calibration(name: str, criterion: Criterion) -> None:
    plan = planned(name, "calibrate", criterion)
    model = Model.of(plan.robot, free_effects(plan.robot, FIT))
    q = plan.candidates.q
    poses = Measurements(position=np.zeros((3, q.shape[1])), q=q)
    rows = candidate_rows(model, poses, plan.noise)
    known = coefficients(model, rows)
    scale = known.prior_std
    rows = rows[:, :, known.columns] * scale
    # The task is every pose: other samples of the same ranges.
    region = region_rows(model, poses)[:, :, known.columns] * scale

    def value(at: np.ndarray) -> float:
        flat = rows[at].reshape(-1, scale.size)
        covariance = np.linalg.inv(np.eye(scale.size) + flat.T @ flat)
        if criterion == "D":
            return float(np.linalg.slogdet(covariance)[1])
        if criterion == "A":
            return float(np.trace(covariance))
        error = np.einsum("itp,pq,itq->t", region, covariance, region)
        return float(error.max() if criterion == "G" else error.mean())

    assert np.unique(plan.chosen).size == POSES
    assert value(plan.chosen) < min(value(at) for at in draws(q.shape[1]))


@pytest.mark.parametrize("name", ARMS)
def test_trace(name: str) -> None:
    plan = planned(name, "trace")
    model = Model.of(plan.robot, free_effects(plan.robot, FIT))
    poses = conditions_of(model, (), 0, False).at(plan.candidates.q, None)
    problem, criterion = power_problem(model, poses, plan.noise, None)
    best_random = max(-2.0 * criterion.cost(problem.information_with(at)) for at in draws(plan.candidates.n))
    assert plan.power["found"] + plan.power["separated"] > best_random
    assert plan.power["found"] > plan.power["random_found"]


@pytest.mark.parametrize("name", ARMS)
def test_acceptance(name: str) -> None:
    plan = planned(name, "acceptance")
    position, q = plan.candidates.position, plan.candidates.q

    def distance(at: np.ndarray) -> float:
        """Of positions and of joints, each over its spread."""
        scaled = [values / np.std(values, axis=1, keepdims=True) for values in (position, q)]
        return sum(energy_distance(values[:, at], values) for values in scaled)

    assert distance(plan.chosen) < min(distance(at) for at in draws(plan.candidates.n))
