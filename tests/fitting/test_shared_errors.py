"""Errors that poses with similar joint angles share: simulated sets, and weights against fits with other statements."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm
from predicted_positions import hold_the_truth

from robacc.calibration.calibrating import calibrate
from robacc.effects.request import build, parse_requests
from robacc.fitting.error_structure import with_error_structure
from robacc.fitting.fit_result import AddedVariance, Fit, Options
from robacc.fitting.shared_errors import all_ratios, shared_errors, with_shared_errors
from robacc.fitting.solver import fit
from robacc.fitting.whitening import Scatter
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm

NOISE = 2e-5
DECLARED = "base_frame,tool_frame,joint_offset"


def measured(seed: int, waves: int, n: int = 200) -> tuple[Measurements, Arm]:
    """Random poses of a nominal arm; beside noise, errors of three times its size that are waves of single joints."""
    chosen = Arm.of(arm("puma560").robot)
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, (len(chosen.robot.variables), n))
    data = Measurements(position=np.zeros((3, n)), q=q)
    error = NOISE * rng.standard_normal((3, n))
    for joint in rng.permutation(len(q))[:waves]:
        angle = 2.0 * np.pi * (q[joint] * rng.uniform(0.2, 0.6) + rng.uniform())
        error += 3.0 * NOISE * np.sqrt(2.0 / waves) * rng.standard_normal((3, 1)) * np.cos(angle)
    return dataclasses.replace(data, position=predict(chosen.robot, data).translation + error), chosen


def fitted(data: Measurements, chosen: Arm, options: Options) -> Fit:
    return fit(Model.of(chosen.robot, build(parse_requests(DECLARED), chosen, data)), data, options)


def test_the_ratio_of_independent_errors_is_one_in_the_mean() -> None:
    sets = [measured(seed, 0, 60) for seed in range(60)]
    ratios = [[errors.ratio for errors in all_ratios(fitted(*drawn, Options()), drawn[0])] for drawn in sets]
    mean, error = np.mean(ratios), np.std(np.mean(ratios, axis=1)) / np.sqrt(60)
    assert abs(mean - 1.0) < 3.0 * error < 0.05


@pytest.mark.parametrize("n", [30, 60, 200])
def test_independent_errors_leave_the_fit_alone(n: int) -> None:
    changed = 0
    for seed in range(40):
        data, chosen = measured(seed, 0, n)
        changed += with_shared_errors(fitted(data, chosen, Options()), data) is not None
    assert changed <= 1


def test_intervals_hold_the_truth_beside_shared_errors() -> None:
    """The arm is nominal, so the errors of predicted positions show whether the coefficients' covariance holds."""
    held: list[list[np.ndarray]] = [[], []]
    warned = 0
    for seed in range(40):
        data, chosen = measured(100 + seed, 3)
        plain = fitted(data, chosen, Options())
        structured = with_error_structure(plain, data)
        warned += any("are similar where" in text for text in structured.shared)
        for flags, result in zip(held, (plain, structured.fit), strict=True):
            flags.append(hold_the_truth(result, data, chosen))
    independent, allowed = (float(np.mean(flags)) for flags in held)
    assert independent < 0.85
    assert 0.92 < allowed < 0.98
    assert warned >= 36


def test_the_joint_of_the_errors_is_named() -> None:
    """Errors along one direction that belong to joint 2."""
    data, chosen = measured(5, 0)
    assert data.q is not None
    position = data.position + 3.0 * NOISE * np.cos(2.0 * data.q[1]) * np.array([[0.6], [0.0], [0.8]])
    data = dataclasses.replace(data, position=position)
    joints = shared_errors(fitted(data, chosen, Options()), data)
    assert [errors.joint for errors in joints][:1] == [chosen.robot.variable_names[1]]


def test_the_order_of_the_rows_does_not_matter() -> None:
    """Joints have four positions each, so that many rows share one."""
    data, chosen = measured(7, 3)
    assert data.q is not None
    grid = dataclasses.replace(data, q=np.round(data.q))
    error = data.position - predict(chosen.robot, data).translation
    grid = dataclasses.replace(grid, position=predict(chosen.robot, grid).translation + error)
    permuted = grid.subset(np.random.default_rng(8).permutation(grid.n))
    one, other = (all_ratios(fitted(rows, chosen, Options()), rows) for rows in (grid, permuted))
    np.testing.assert_allclose([e.ratio for e in one], [e.ratio for e in other], rtol=1e-7)


def test_predictions_take_the_covariance_without_shared_errors() -> None:
    """Held-out poses show these errors, so that they would count twice."""
    data, chosen = measured(100, 3)
    plain = fitted(data, chosen, Options())
    structured = with_error_structure(plain, data)
    assert structured.added is not None
    np.testing.assert_array_equal(structured.predicting.theta, structured.fit.theta)
    columns = plain.identifiability.columns
    usual, reported = (np.diag(result.covariance)[columns] for result in (structured.predicting, structured.fit))
    np.testing.assert_allclose(usual, np.diag(plain.covariance)[columns], rtol=1e-12)
    assert np.all(reported > 1.5 * usual)


def test_given_priors_stay() -> None:
    data, chosen = measured(100, 3)
    requests = parse_requests(DECLARED)
    free = calibrate(chosen.robot, data, requests, shrink=False)
    priors = {p.name: 1e-9 for p in free.parameters if p.name.startswith("joint_offset")}
    held = calibrate(chosen.robot, data, requests, priors=priors)
    for result, limits in ((free, (1e-6, 1e-3)), (held, (0.0, 1e-8))):
        assert any("are similar where" in text for text in result.warnings)
        largest = max(abs(p.value) for p in result.parameters if p.name in priors)
        assert limits[0] <= largest <= limits[1]


def test_added_variance_weights_as_a_larger_misfit_does() -> None:
    data, chosen = measured(1, 2)
    misfit = (NOISE, 1e-5)
    added = AddedVariance(factor=2.0, position=3e-5, orientation=0.0)
    beside = fitted(data, chosen, Options(robust=False, misfit=misfit, added=added))
    larger = float(np.sqrt(2.0 * NOISE**2 + 3e-5**2))
    stated = fitted(data, chosen, Options(robust=False, misfit=(larger, 1e-5)))
    np.testing.assert_allclose(beside.theta, stated.theta, rtol=0, atol=1e-12)
    np.testing.assert_allclose(beside.covariance, stated.covariance, rtol=1e-9)
    assert beside.misfit == misfit
    assert beside.chi_square == pytest.approx(stated.chi_square * (larger / NOISE) ** 2, rel=1e-9)


def test_added_variance_multiplies_the_scatter() -> None:
    data, chosen = measured(2, 2)
    scatter = Scatter(np.full(6, 5e-5), np.zeros(6))
    common = Options(robust=False, misfit=(NOISE, 1e-5), scatter=scatter)
    beside = fitted(data, chosen, dataclasses.replace(common, added=AddedVariance(4.0, 0.0, 0.0)))
    doubled = fitted(data, chosen, dataclasses.replace(common, misfit=(2.0 * NOISE, 2e-5), scatter=scatter.scaled(2.0)))
    np.testing.assert_allclose(beside.theta, doubled.theta, rtol=0, atol=1e-12)
    np.testing.assert_allclose(beside.covariance, doubled.covariance, rtol=1e-9)
    assert beside.chi_square == pytest.approx(4.0 * doubled.chi_square, rel=1e-9)
