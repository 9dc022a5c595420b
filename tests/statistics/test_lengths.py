"""Lengths of Gaussian vectors, many at once, against scipy, the exact integral and the closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, special, stats

from robacc.statistics.lengths import (
    _cdf_and_density,
    length_probability,
    length_quantile,
    length_quantiles,
    mean_lengths,
    mixture_quantile,
    principal_variances,
)

SHAPES = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0.1, 1e-3], [4e-8, 1e-8, 1e-12], [1, 1e-9, 1e-9]])[:, ::-1].T


def length_probabilities(radius: float, variances: np.ndarray) -> np.ndarray:
    """Return P(|Z| <= radius) ``(N,)`` for variances ``(3, N)``."""
    return _cdf_and_density(np.full(variances.shape[1], radius * radius), variances)[0]


@pytest.mark.parametrize("probability", [0.5, 0.95, 0.999])
def test_quantiles_agree_with_the_exact_integral(probability: float) -> None:
    quantiles = length_quantiles(probability, SHAPES)
    exact = [length_quantile(probability, np.zeros(3), v) for v in SHAPES.T]
    # What the path's twelve nodes are good for; in a far tail a probability of 1e-10 counts for more.
    np.testing.assert_allclose(quantiles, exact, rtol=1e-8)
    chi = [np.sqrt(stats.chi2.ppf(probability, k)) for k in (1, 2, 3)]
    np.testing.assert_allclose(quantiles[:3], chi, rtol=1e-8)


def test_probabilities_agree_with_the_exact_integral() -> None:
    for radius in (1e-4, 0.3, 1.0, 4.0):
        exact = [length_probability(radius, np.zeros(3), v) for v in SHAPES.T]
        np.testing.assert_allclose(length_probabilities(radius, SHAPES), exact, atol=2e-9)


def test_no_scatter_has_no_length() -> None:
    variances = np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    assert (length_quantiles(0.95, variances)[0], mean_lengths(variances)[0]) == (0.0, 0.0)
    assert mixture_quantile(0.95, np.zeros((3, 4))) == 0.0
    # Half of the poses err not at all: 95 % of all is 90 % of the others.
    assert mixture_quantile(0.95, variances) == pytest.approx(np.sqrt(stats.chi2.ppf(0.9, 3)), rel=1e-8)


def test_mixture_quantile_solves_the_mixture() -> None:
    variances = np.random.default_rng(0).exponential(1e-8, (3, 6000)) + 1e-12
    radius = mixture_quantile(0.95, variances)
    subset = variances[:, ::100]
    exact = [length_probability(mixture_quantile(0.95, subset), np.zeros(3), v) for v in subset.T]
    assert np.mean(exact) == pytest.approx(0.95, abs=1e-9)
    assert np.mean(length_probabilities(radius, variances)) == pytest.approx(0.95, abs=1e-9)


def test_mean_length_is_the_integral_of_the_survival() -> None:
    for v in SHAPES[:, :4].T:
        scale = np.sqrt(v.sum())
        tail, _ = integrate.quad(lambda r, v=v: 1 - length_probability(r, np.zeros(3), v), 1e-9, 12 * scale, limit=200)
        assert mean_lengths(np.sort(v)[:, None])[0] == pytest.approx(tail, rel=1e-6)


def test_principal_variances_are_those_of_the_axes() -> None:
    rng = np.random.default_rng(2)
    axes = np.linalg.qr(rng.normal(size=(400, 3, 3)))[0]
    values = np.sort(rng.uniform(0.0, 1.0, (400, 3)) ** 6, axis=1)
    found = principal_variances(np.einsum("nij,nj,nkj->ikn", axes, values, axes))
    np.testing.assert_allclose(found, values.T, atol=1e-14)
    assert principal_variances(np.zeros((3, 3, 0))).shape == (3, 0)


def test_mean_length_is_an_elliptic_integral() -> None:
    variances = np.hstack((SHAPES, np.sort(10.0 ** np.random.default_rng(3).uniform(-14, 1, (3, 500)), axis=0)))
    exact = np.sqrt(8.0 / np.pi) * special.elliprg(*variances)
    np.testing.assert_allclose(mean_lengths(variances), exact, rtol=1e-13)
    assert mean_lengths(np.full((3, 1), 2.5))[0] == pytest.approx(2.0 * np.sqrt(5.0 / np.pi), rel=1e-14)
    assert mean_lengths(np.zeros((3, 0))).shape == (0,)


def test_principal_variances_are_never_negative() -> None:
    vector = np.array([1.0, 2.0, 3.0])
    covariance = np.outer(vector, vector)[:, :, None]
    values = principal_variances(covariance)
    assert np.all(values >= 0)
    assert values[2, 0] == pytest.approx(14.0)
