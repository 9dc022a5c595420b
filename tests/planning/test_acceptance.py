"""Number of poses that decides a limit, against draws; spread of acceptance poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from robacc.planning.campaign import needed, poses_for, spread_poses


@pytest.mark.parametrize("ratio", [0.5, 0.7, 0.8, 1.2])
def test_the_number_decides_in_nine_campaigns_of_ten(ratio: float) -> None:
    n = poses_for(ratio, "rms", 0.95, 0.95)
    rng = np.random.default_rng(0)
    # Errors along one direction, the assumption of the plan.
    square = ratio**2 * rng.chisquare(n, 20_000) / n
    upper = square * n / stats.chi2.ppf(0.05, n)
    lower = square * n / stats.chi2.ppf(0.95, n)
    decided = np.mean(upper <= 1.0 if ratio < 1 else lower >= 1.0)
    assert decided >= 0.9 - 0.007  # three standard errors of 20,000 draws
    fewer = ratio**2 * rng.chisquare(n - 1, 20_000) / stats.chi2.ppf(0.05 if ratio < 1 else 0.95, n - 1)
    assert np.mean(fewer <= 1.0 if ratio < 1 else fewer >= 1.0) < 0.9 + 0.007


def test_percentiles_need_order_statistics() -> None:
    # 59 poses within the limit bound a 95th percentile at 95 % confidence, 58 do not (Wilks).
    assert poses_for(0.1, "p95", 0.95, 0.95) == 59
    assert 1 - 0.95**59 >= 0.95 > 1 - 0.95**58
    assert poses_for(0.8, "p95", 0.95, 0.95) > poses_for(0.8, "rms", 0.95, 0.95)  # type: ignore[operator]
    assert poses_for(0.5, "max", 0.95, 0.95) == math.ceil(math.log(0.05) / math.log(0.95))


def test_a_value_at_the_limit_is_never_decided() -> None:
    assert (poses_for(1.0, "rms", 0.95, 0.95), poses_for(0.99, "rms", 0.95, 0.95)) == (None, None)
    entry = needed("limit", "rms", 1e-3, 0.95, expected=0.5e-3)
    assert (entry["true_over_limit"], entry["n_poses"]) == (0.5, entry["by_ratio"][0]["n_poses"])


def energy_distance(sample: np.ndarray, everything: np.ndarray) -> float:
    """Energy distance between two sets of points (D, n) and (D, N): zero for equal distributions."""

    def mean(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.mean(np.linalg.norm(a[:, :, None] - b[:, None], axis=0)))

    return 2 * mean(sample, everything) - mean(sample, sample) - mean(everything, everything)


def test_spread_poses_represent_the_region() -> None:
    rng = np.random.default_rng(1)
    position, q = rng.normal(size=(3, 300)), rng.uniform(-1, 1, (6, 300))
    chosen = spread_poses(position, q, 60, 0)
    assert np.unique(chosen).size == 60
    random = [rng.choice(300, 60, replace=False) for _ in range(20)]
    for values in (position, q):
        distances = [energy_distance(values[:, at], values) for at in random]
        assert energy_distance(values[:, chosen], values) < min(distances)
    # Mean and scale stay those of the region: the statistic of the errors is not biased towards its border.
    np.testing.assert_allclose(position[:, chosen].mean(axis=1), 0.0, atol=0.15)
    np.testing.assert_allclose(position[:, chosen].std(axis=1), 1.0, atol=0.15)
    assert spread_poses(position[:, :5], q[:, :5], 9, 0).tolist() == [0, 1, 2, 3, 4]
