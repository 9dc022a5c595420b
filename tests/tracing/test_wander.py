"""Likelihood of errors that wander: against the dense Gaussian density, and on steps."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.geometry import Array
from robacc.tracing import wander


def dense_gain(residual: Array, time: Array) -> float:
    """Return the gain over noise alone from the covariance matrices of all poses, on the module's grid."""
    usual = float(np.median(np.diff(time)))
    count = residual.size
    best = {True: -np.inf, False: -np.inf}
    for amplitude in wander._AMPLITUDES:
        for factor in wander._TIMES:
            apart = np.abs(time[:, None] - time)
            covariance = np.eye(time.size) + amplitude * np.exp(-apart / (factor * usual))
            squares = float(np.einsum("mi,ij,mj->", residual, np.linalg.inv(covariance), residual))
            determinant = residual.shape[0] * float(np.linalg.slogdet(covariance)[1])
            likelihood = -0.5 * count * np.log(squares / count) - 0.5 * determinant
            best[bool(amplitude)] = max(best[bool(amplitude)], likelihood)
    return float(max(best.values()) - best[False])


def test_likelihood_is_that_of_the_dense_gaussian() -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(20.0, 90.0, 40))
    residual = rng.normal(size=(3, 40)) + np.sin(time / 400.0)
    assert wander.likelihood_gain(residual, time) == pytest.approx(dense_gain(residual, time), rel=1e-9)


def test_white_noise_does_not_wander_and_a_step_is_more_than_a_wander() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(150.0)
    white = rng.normal(size=(3, 150))
    assert wander.likelihood_gain(white, time) < 3.0
    # A step of four standard deviations in two components: noise around two levels gains far more than a wander.
    stepped = white + 4.0 * (time >= 75) * np.array([[0.0], [1.0], [1.0]])
    of_step = 0.5 * white.size * np.log(np.mean(np.square(stepped)) / np.mean(np.square(white)))
    assert 0.0 < wander.likelihood_gain(stepped, time) < of_step - 50.0
