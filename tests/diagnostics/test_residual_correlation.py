"""Neighbours that are alike: the chance stated is the chance found, and a clean residual is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.diagnostics.residual_correlation import _in_space, _in_time, _p_value


@pytest.mark.parametrize("tails", ["Gaussian", "Student's t of 4"])
@pytest.mark.parametrize("n", [60, 200])
def test_the_stated_chance_is_that_of_independent_residuals(tails: str, n: int) -> None:
    rng = np.random.default_rng(5)
    times, found = 1000, np.empty((2, 1000))
    for i in range(times):
        residual = rng.normal(size=(3, n)) if tails == "Gaussian" else rng.standard_t(4, size=(3, n))
        found[0, i] = _p_value(residual, _in_time(rng.permutation(n).astype(float)))
        found[1, i] = _p_value(residual, _in_space(rng.normal(size=(3, n))))
    for p_values in found:
        # Binomial of 1,000 at 5 %: 3.6 to 6.4 % holds 95 times in 100; four such standard errors are allowed.
        assert abs(np.mean(p_values <= 0.05) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / times)
        assert np.mean(p_values <= 0.001) < 0.006


def test_drift_shows_in_time_and_not_in_space_and_the_other_way_round() -> None:
    rng = np.random.default_rng(6)
    n = 100
    clock, position = rng.permutation(n).astype(float), rng.normal(size=(3, n))
    noise = rng.normal(size=(3, n))
    drift, field = noise + 2 * np.sin(clock / 15), noise + 2 * position[::-1]
    assert _p_value(drift, _in_time(clock)) < 1e-6 < 1e-3 < _p_value(drift, _in_space(position))
    assert _p_value(field, _in_space(position)) < 1e-6 < 1e-3 < _p_value(field, _in_time(clock))


def test_every_pair_of_neighbours_counts_once_and_few_tell_nothing() -> None:
    position = np.array([[0.0, 0.1, 5.0, 5.1], [0, 0, 0, 0], [0, 0, 0, 0]]).repeat(10, axis=1)
    position += np.arange(40) * 10.0
    pairs = _in_space(position)
    assert np.all(pairs[0] < pairs[1])
    assert len({tuple(pair) for pair in pairs.T}) == pairs.shape[1]
    np.testing.assert_array_equal(_in_time(np.array([3.0, 1.0, 2.0])), [[1, 2], [2, 0]])
    assert _in_space(np.zeros((3, 29))).shape == (2, 0)
    assert _p_value(np.ones((3, 20)), _in_time(np.arange(20.0))) == 1.0
    assert _p_value(np.zeros((3, 50)), _in_time(np.arange(50.0))) == 1.0
