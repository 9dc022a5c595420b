"""Correlation of neighbouring residuals: the stated p-value is that of independent residuals."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.diagnostics.residual_correlation import correlation_p_value, space_neighbours, time_neighbours


@pytest.mark.parametrize("tails", ["Gaussian", "Student's t of 4"])
@pytest.mark.parametrize("n", [60, 200])
def test_the_stated_chance_is_that_of_independent_residuals(tails: str, n: int) -> None:
    rng = np.random.default_rng(5)
    times, p_values = 1000, np.empty((2, 1000))
    for i in range(times):
        residual = rng.normal(size=(3, n)) if tails == "Gaussian" else rng.standard_t(4, size=(3, n))
        p_values[0, i] = correlation_p_value(residual, time_neighbours(rng.permutation(n).astype(float)))
        p_values[1, i] = correlation_p_value(residual, space_neighbours(rng.normal(size=(3, n))))
    for row in p_values:
        # Binomial of 1,000 at 5 %: 3.6 to 6.4 % holds 95 times in 100; four such standard errors are allowed.
        assert abs(np.mean(row <= 0.05) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / times)
        assert np.mean(row <= 0.001) < 0.006


def test_a_drift_correlates_neighbours_in_time_and_a_field_those_in_space() -> None:
    rng = np.random.default_rng(6)
    n = 100
    clock, position = rng.permutation(n).astype(float), rng.normal(size=(3, n))
    noise = rng.normal(size=(3, n))
    drift, field = noise + 2 * np.sin(clock / 15), noise + 2 * position[::-1]
    assert (
        correlation_p_value(drift, time_neighbours(clock))
        < 1e-6
        < 1e-3
        < correlation_p_value(drift, space_neighbours(position))
    )
    assert (
        correlation_p_value(field, space_neighbours(position))
        < 1e-6
        < 1e-3
        < correlation_p_value(field, time_neighbours(clock))
    )


def test_every_pair_of_neighbours_counts_once_and_few_tell_nothing() -> None:
    position = np.array([[0.0, 0.1, 5.0, 5.1], [0, 0, 0, 0], [0, 0, 0, 0]]).repeat(10, axis=1)
    position += np.arange(40) * 10.0
    pairs = space_neighbours(position)
    assert np.all(pairs[0] < pairs[1])
    assert len({tuple(pair) for pair in pairs.T}) == pairs.shape[1]
    np.testing.assert_array_equal(time_neighbours(np.array([3.0, 1.0, 2.0])), [[1, 2], [2, 0]])
    assert space_neighbours(np.zeros((3, 29))).shape == (2, 0)
    assert correlation_p_value(np.ones((3, 20)), time_neighbours(np.arange(20.0))) == 1.0
    assert correlation_p_value(np.zeros((3, 50)), time_neighbours(np.arange(50.0))) == 1.0
