"""The warning of a large condition number names the coefficients that the poses know least."""

from __future__ import annotations

import dataclasses

import numpy as np
from arms import arm

from robacc.effects.request import build, parse_requests
from robacc.fitting.solver import fit
from robacc.fitting.warnings import condition_warning
from robacc.modelling.model import Model, predict
from robacc.simulation.simulate import Plan, simulate


def test_poses_of_nearly_one_orientation_leave_the_tool_unknown() -> None:
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    poses = simulate(robot, Plan(80, seed=2, noise_position=0.0, orientation=False)).data
    rng, q = np.random.default_rng(0), poses.q.copy()
    # The orientation of the flange stays the same but for a thousandth.
    q[4] = 0.6 - q[1] - q[2]
    q[0], q[3], q[5] = (1e-3 * rng.standard_normal(poses.n) for _ in range(3))
    q[4] += 1e-3 * rng.standard_normal(poses.n)
    poses = dataclasses.replace(poses, q=q)
    position = predict(robot, poses).translation + 2e-5 * rng.standard_normal((3, poses.n))
    data = dataclasses.replace(poses, position=position)
    start = Model.of(robot)
    model = Model(start.arm, start.known, build(parse_requests("base_frame,tool_frame"), start.arm, data))
    (warning,) = condition_warning(fit(model, data))
    assert "weakly identifiable on these poses, most of all" in warning
    assert "tool_frame." in warning
    assert " mm)" in warning
