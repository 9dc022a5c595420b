"""Widths of estimated priors: what bounds them."""

from __future__ import annotations

import numpy as np

from robacc.effects.base import Term
from robacc.fitting.gauss_newton import posterior
from robacc.fitting.normal_equations import NormalEquations
from robacc.fitting.shrinkage import LARGEST_OF_PROFILE, Priors
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
    normal = NormalEquations(np.zeros(72), gram, rhs, float(measured @ measured))
    terms = [Term(f"t{i}", "rad", TYPICAL, (), "profile") for i in range(72)]
    priors = Priors(terms, None, {})
    columns = np.arange(72)
    for _ in range(5):
        priors.update(normal, columns, float(angle.size), noise_known=True, settled=0.01)
    group_std = priors.group_stds["profile"]
    assert group_std <= LARGEST_OF_PROFILE * TYPICAL
    theta = posterior(gram, priors.precision[columns]) @ rhs
    in_gap = waves(np.linspace(0.5, 1.9, 200)) @ theta
    # Without the bound the coefficients are 5e10 rad, and 2e7 rad is predicted in the gap.
    assert np.abs(in_gap).max() < 0.1
