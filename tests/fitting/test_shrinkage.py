"""Widths of estimated priors: what bounds them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from robacc.effects.base import Term
from robacc.fitting.levels import LARGEST
from robacc.fitting.normal_equations import NormalEquations, posterior
from robacc.fitting.solver import Priors
from robacc.geometry import Array

ORDERS = np.arange(1, 37) / 2
TYPICAL = 1e-4


def waves(angle: Array) -> Array:
    """Return ``(N, 72)`` cosines and sines of the orders."""
    return np.concatenate([np.cos(angle[:, None] * ORDERS), np.sin(angle[:, None] * ORDERS)], axis=1)


def test_a_profile_with_a_gap_stays_of_its_usual_size_there() -> None:
    """An error of 30 mrad that the orders cannot hold, seen from 0 to 0.4 rad and from 2.0 to 2.4 rad."""
    rng = np.random.default_rng(3)
    angle = np.concatenate([rng.uniform(0.0, 0.4, 3000), rng.uniform(2.0, 2.4, 3000)])
    noise_std = 1e-5
    design = waves(angle) / noise_std
    measured = (30e-3 * np.sign(angle - 1.0) * angle + rng.normal(scale=noise_std, size=angle.size)) / noise_std
    gram, rhs = design.T @ design, design.T @ measured
    normal = NormalEquations(np.zeros(72), gram[None], rhs[None], np.array([measured @ measured]))
    terms = [Term(f"t{i}", "rad", TYPICAL, (), "profile") for i in range(72)]
    priors = Priors(terms, np.full(72, np.inf), np.full(72, np.inf), {})
    columns = np.arange(72)
    for _ in range(5):
        priors.update(normal, columns, float(angle.size), noise_known=True, settled=0.01)
    group_std = priors.group_stds["profile"]
    assert group_std <= LARGEST * TYPICAL
    theta = posterior(gram, priors.precision[columns]) @ rhs
    in_gap = waves(np.linspace(0.5, 1.9, 200)) @ theta
    # Without the bound the coefficients are 5e10 rad, and 2e7 rad is predicted in the gap.
    assert np.abs(in_gap).max() < 0.1


def linear_problem(seed: int) -> tuple[Array, Array, NormalEquations]:
    """Return design, data and normal equations of two groups of ten and five coefficients and four free ones."""
    rng = np.random.default_rng(seed)
    truth = np.concatenate((rng.normal(scale=3e-4, size=10), rng.normal(scale=2e-5, size=5), rng.normal(size=4)))
    design = rng.normal(size=(60, 19)) * np.repeat((1e4, 1e5, 1e2), (10, 5, 4))
    measured = design @ truth + rng.normal(size=60)
    gram, rhs = design.T @ design, design.T @ measured
    normal = NormalEquations(np.zeros(19), gram[None], rhs[None], np.array([measured @ measured]))
    return design, measured, normal


@pytest.mark.parametrize("start", [1e-6, 1e-3])
@pytest.mark.parametrize("seed", range(4))
def test_group_stds_have_the_largest_marginal_likelihood(seed: int, start: float) -> None:
    design, measured, normal = linear_problem(seed)
    terms = [Term(f"t{i}", "rad", TYPICAL, (), "a" if i < 10 else "b" if i < 15 else None) for i in range(19)]
    priors = Priors(terms, np.full(19, np.inf), np.full(19, np.inf), {"a": start, "b": start})
    for _ in range(6):
        priors.update(normal, np.arange(19), 60.0, noise_known=True, settled=0.01)
    free = design[:, 15:]

    def restricted_likelihood(log_stds: Array) -> float:
        std = np.exp(np.repeat(log_stds, (10, 5)))
        covariance = np.eye(60) + (design[:, :15] * np.square(std)) @ design[:, :15].T
        precision = np.linalg.inv(covariance)
        projected = precision - precision @ free @ np.linalg.solve(free.T @ precision @ free, free.T @ precision)
        determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(free.T @ precision @ free)[1]
        return -0.5 * float(determinants + measured @ projected @ measured)

    best = minimize(lambda x: -restricted_likelihood(x), np.log([3e-4, 2e-5]), method="Nelder-Mead").x
    reached = np.log([priors.group_stds["a"], priors.group_stds["b"]])
    assert restricted_likelihood(reached) > restricted_likelihood(best) - 1e-4
