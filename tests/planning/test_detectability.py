"""Planned detection limits against F tests on simulated campaigns with kinematics of their own; choice for a trace."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm
from scipy import stats
from test_expected import NOISE, SCATTER, jacobian, whitener

from robacc.planning.campaign import CampaignPlan, plan_campaign

CAMPAIGNS = 200


@pytest.fixture(scope="module")
def plan() -> CampaignPlan:
    options = {"noise": NOISE, "repeatability": SCATTER, "n_candidates": 300}
    return plan_campaign(arm("irb1600").robot, "trace", 40, fit="base_frame,tool_frame,joint_offset", **options)


def found(plan: CampaignPlan, columns: np.ndarray, size: float, level: float) -> float:
    """Share of campaigns in which an F test at ``level`` finds an effect with columns (3, N) of that size."""
    robot, q = plan.robot, plan.q
    names = [entry["name"] for entry in plan.coefficients if entry["std"] is not None]
    factors = whitener(robot, q, plan.noise.joints)
    base = np.einsum("nij,jpn->inp", factors, jacobian(robot, q, names)).reshape(-1, len(names))
    effect = np.einsum("nij,jn->in", factors, columns).ravel()
    basis = np.linalg.qr(base / np.linalg.norm(base, axis=0))[0]
    new = effect - basis @ (basis.T @ effect)
    dof = new.size - len(names) - 1
    rng = np.random.default_rng(4)
    hits = 0
    for _ in range(CAMPAIGNS):
        data = size * effect + rng.normal(size=new.size)
        data = data - basis @ (basis.T @ data)
        gain = float(new @ data) ** 2 / float(new @ new)
        hits += stats.f.sf(gain / ((data @ data - gain) / dof), 1, dof) < level
    return hits / CAMPAIGNS


@pytest.mark.parametrize("joint", ["j2", "j4"])
def test_backlash_at_three_limits_is_found(plan: CampaignPlan, joint: str) -> None:
    limits = plan.detectability["limits"]
    (limit,) = [entry for entry in limits if (entry["effect"], entry["joints"]) == ("backlash", (joint,))]
    names = [entry.name for entry in plan.robot.variables]
    direction = plan.visits().direction
    moved = jacobian(plan.robot, plan.q, [f"joint_offset.{joint}"])[:, 0] * direction[names.index(joint)]
    level = 0.01 / len({(entry["effect"], entry["joints"]) for entry in limits})
    assert found(plan, moved, 3 * limit["limit"], level) >= 0.95
    # A finding must recur in folds of 80 % of the poses: all poses find the limit in more than half of the campaigns.
    assert 0.4 < found(plan, moved, limit["limit"], level) < 0.9
    assert found(plan, moved, 0.3 * limit["limit"], level) < 0.1


def test_trace_poses_show_more_than_random_ones(plan: CampaignPlan) -> None:
    assert plan.power["found"] > 1.05 * plan.power["random_found"]
    assert plan.power["separated"] > 1.05 * plan.power["random_separated"]


def test_exact_equals_are_named(plan: CampaignPlan) -> None:
    pairs = {(pair["first"], pair["second"]): pair for pair in plan.detectability["pairs"]}
    # d of two parallel axes moves the target in the same way.
    first, second = "link_geometry[j2] (labels d)", "link_geometry[j3] (labels d)"
    assert pairs[first, second]["similarity"] == pytest.approx(1.0, abs=1e-6)
    assert pairs[first, second]["evidence"] == pytest.approx(0.0, abs=1e-6)
