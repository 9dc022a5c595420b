"""Standard errors beside unequal errors: against fits without each visit, and against simulated sets."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm
from predicted_positions import hold_the_truth

from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.fitting.unequal_errors import with_unequal_errors
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm

NOISE = 2e-5
DECLARED = "base_frame,tool_frame,joint_offset"


def measured(seed: int, ratio: float, targets: int = 1, n: int = 60) -> tuple[Measurements, Arm]:
    """Random poses of a nominal arm; where it is stretched out, the noise is ``ratio`` times that of other poses."""
    chosen = Arm.of(arm("puma560").robot)
    rng = np.random.default_rng(seed)
    q = np.repeat(rng.uniform(-1.5, 1.5, (len(chosen.robot.variables), n)), targets, axis=1)
    visit = np.repeat(np.array([f"v{i}" for i in range(n)]), targets) if targets > 1 else None
    data = Measurements(position=np.zeros((3, q.shape[1])), q=q, visit=visit)
    nominal = predict(chosen.robot, data).translation
    reach = np.linalg.norm(nominal, axis=0)
    std = NOISE * np.where(reach > np.quantile(reach, 0.7), ratio, 1.0)
    position = nominal + std * rng.standard_normal((3, q.shape[1]))
    return dataclasses.replace(data, position=position), chosen


def fitted(data: Measurements, chosen: Arm, options: Options) -> Fit:
    return fit(Model.of(chosen.robot, build(parse_requests(DECLARED), chosen, data)), data, options)


@pytest.mark.parametrize("targets", [1, 2])
def test_standard_errors_are_those_of_the_jackknife(targets: int) -> None:
    data, chosen = measured(1, 8.0, targets)
    whole = fitted(data, chosen, Options(robust=False))
    columns = whole.identifiability.columns
    again = Options(robust=False, misfit=whole.misfit, start=whole.theta, tolerance=1e-12)
    square = np.zeros(columns.size)
    for row in range(0, data.n, targets):
        visit = np.arange(row, row + targets)
        # Fits relative to the robot that the whole fit registered, so coefficients are comparable.
        without = fit(whole.model, data.subset(np.delete(np.arange(data.n), visit)), again)
        square += np.square(without.theta[columns] - whole.theta[columns])
    usual = np.sqrt(np.diag(whole.covariance)[columns])
    wider = np.sqrt(np.diag(with_unequal_errors(whole, data).covariance)[columns])
    np.testing.assert_allclose(wider, np.maximum(usual, np.sqrt(square)), rtol=2e-3)
    assert np.max(wider / usual) > 1.1


def test_equal_errors_leave_the_standard_errors_alone() -> None:
    changed = 0
    for seed in range(40):
        data, chosen = measured(seed, 1.0)
        plain = fitted(data, chosen, Options())
        changed += with_unequal_errors(plain, data) is not plain
    assert changed <= 2


def test_intervals_hold_the_truth_beside_unequal_errors() -> None:
    """Predicted positions where the noise is large: 95 % intervals hold the truth, those of equal errors do not."""
    held: list[list[np.ndarray]] = [[], []]
    for seed in range(60):
        data, chosen = measured(100 + seed, 8.0)
        plain = fitted(data, chosen, Options(robust=False))
        reach = np.linalg.norm(data.position, axis=0)
        stretched = data.subset(np.flatnonzero(reach > np.quantile(reach, 0.7)))
        for flags, result in zip(held, (plain, with_unequal_errors(plain, data)), strict=True):
            flags.append(hold_the_truth(result, stretched, chosen))
    equal, allowed = (float(np.mean(flags)) for flags in held)
    assert equal < 0.91
    assert 0.935 < allowed < 0.965


def test_few_visits_say_nothing_of_unequal_errors() -> None:
    data, chosen = measured(3, 8.0, n=19)
    plain = fitted(data, chosen, Options(robust=False))
    assert with_unequal_errors(plain, data) is plain
