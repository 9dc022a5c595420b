"""Standard errors under errors that are correlated in time or over the joints, against the scatter of many draws."""

from __future__ import annotations

import functools

import independent_arm as arm
import numpy as np
import pytest

from robacc.effects.specification import build, parse_requests
from robacc.error_model.structure import with_error_structure
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm

NOISE, N = 2e-5, 80


def drawn(kind: str, seed: int) -> Measurements:
    """Poses of the nominal arm in the order of joint 2, with errors of a kind."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.2, 1.2, (6, N))
    q = q[:, np.argsort(q[1])]
    error = NOISE * rng.standard_normal((3, N))
    moved = q.copy()
    if kind == "wander":
        steps = rng.standard_normal((3, N))
        walk = np.zeros((3, N))
        for i in range(N):
            walk[:, i] = steps[:, i] if i == 0 else 0.85 * walk[:, i - 1] + np.sqrt(1 - 0.85**2) * steps[:, i]
        error += 3 * NOISE * walk
    if kind == "process":
        centres, weights = rng.uniform(-1.2, 1.2, (6, 30)), rng.standard_normal((6, 30))
        distance = np.sum(np.square(q[:, :, None] - centres[:, None]), axis=0)
        moved += 1e-4 * weights @ np.exp(-0.5 * distance / 1.5**2).T
    return Measurements(position=np.array([arm.target(row) for row in moved.T]).T + error, q=q)


def fits(data: Measurements) -> tuple[Fit, Fit]:
    """The fit that takes errors as independent, and the one that allows for their structure."""
    robot = arm.robot()
    effects = build(parse_requests("base_frame,tool_frame,joint_offset[j2,j3,j4,j5]"), Arm.of(robot), data)
    model = Model.of(robot, effects)
    plain = fit(model, data)
    return plain, with_error_structure(plain, data, Options(), functools.partial(fit, model, data)).fit


@pytest.mark.parametrize("kind", ["white", "wander", "process"])
def test_standard_errors_are_those_of_many_draws(kind: str) -> None:
    scores = []
    for seed in range(16):
        for number, fitted in enumerate(fits(drawn(kind, seed))):
            zeros = [i for i in fitted.identifiability.columns if fitted.names[i].startswith("joint_offset")]
            scores.append((number, fitted.theta[zeros] / np.sqrt(np.diag(fitted.covariance)[zeros])))
    plain, structured = (
        float(np.sqrt(np.mean(np.square(np.concatenate([s for n, s in scores if n == number]))))) for number in (0, 1)
    )
    # 64 scores, not all independent: their root mean square is within 25 % of that of Gaussians.
    assert 0.75 < structured < 1.3
    assert plain < 1.3 if kind == "white" else plain > 1.4
