"""Coefficients over arms: coverage of their intervals on fleets drawn here, and the estimate by another solver."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2

from robacc.history import ArmFit, fleet_of


def fleet(values, stds):
    return [
        ArmFit(f"a{i}", {"joint_offset.j1": (float(v), float(s), "rad")}, {("joint_offset.j1",) * 2: float(s) ** 2})
        for i, (v, s) in enumerate(zip(values, stds, strict=True))
    ]


@pytest.mark.parametrize("n", [5, 30])
@pytest.mark.parametrize("ratio", [0.5, 3.0])
def test_intervals_of_mean_and_spread_hold_the_truth(n, ratio):
    rng, spread, mean, draws = np.random.default_rng(n), 0, 0, 400
    for _ in range(draws):
        stds = 1e-5 * np.exp(rng.normal(0, 0.5, n))
        values = 1e-3 + rng.normal(0, ratio * 1e-5, n) + rng.normal(0, stds)
        (one,), _, _ = fleet_of(fleet(values, stds))
        spread += one["std_low"] <= ratio * 1e-5 <= one["std_high"]
        mean += one["mean_low"] <= 1e-3 <= one["mean_high"]
    # 95 % with 400 draws: 92 to 98 % are 2.8 standard deviations; strangers that are none narrow a few.
    assert 0.92 <= spread / draws <= 0.98
    assert 0.91 <= mean / draws <= 1.0


def test_spread_agrees_with_another_solver():
    rng, n = np.random.default_rng(1), 12
    stds = rng.uniform(0.5, 2.0, n)
    values = rng.normal(0, 2.0, n) + rng.normal(0, stds)

    def squares(variance):
        weights = 1.0 / (stds**2 + variance)
        return weights @ (values - np.average(values, weights=weights)) ** 2

    (one,), strangers, _ = fleet_of(fleet(values, stds))
    assert not strangers
    wanted = [n - 1, chi2.ppf(0.975, n - 1), chi2.ppf(0.025, n - 1)]
    found = [brentq(lambda v, q=q: squares(v) - q, 0, 1e3) if squares(0) > q else 0.0 for q in wanted]
    assert np.square([one["std"], one["std_low"], one["std_high"]]) == pytest.approx(found, rel=1e-6)


def test_strangers_are_rare_in_fleets_without_one_and_found_in_fleets_with_one():
    rng, false = np.random.default_rng(2), 0
    for _ in range(200):
        values, stds = rng.normal(0, 1.0, 20), np.full(20, 0.3)
        false += bool(fleet_of(fleet(values, stds))[1])
        values[3] = 8.0
        assert fleet_of(fleet(values, stds))[1][0]["arm"] == "a3"
    assert false <= 200 * 0.05 + 3 * np.sqrt(200 * 0.05 * 0.95)


def test_covariance_over_arms_is_that_of_the_coefficients_without_the_noise_of_the_fits():
    rng, n = np.random.default_rng(3), 4000
    truth = np.array([[1.0, 0.6], [0.6, 2.0]])
    noise = np.array([[0.5, 0.2], [0.2, 0.3]])
    values = rng.multivariate_normal([0, 0], truth, n) + rng.multivariate_normal([0, 0], noise, n)
    keys = ("joint_offset.j1", "joint_offset.j2")
    arms = [
        ArmFit(
            f"a{i}",
            {key: (float(row[k]), float(noise[k, k] ** 0.5), "rad") for k, key in enumerate(keys)},
            {(keys[a], keys[b]): float(noise[a, b]) for a in range(2) for b in range(a + 1)},
        )
        for i, row in enumerate(values)
    ]
    _, _, covariance = fleet_of(arms)
    assert covariance["names"] == [*keys]
    assert covariance["matrix"] == pytest.approx(truth, abs=0.15)
