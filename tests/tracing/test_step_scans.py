"""Sums of a scan of steps against columns that are built and whitened for each place."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import measured, robot, run

from robacc.effects.change_points import step_forms
from robacc.fitting.whitening import Scatter, Whitening, whitening
from robacc.robots.arm import Arm
from robacc.tracing.step_scans import (
    Adjoints,
    StepFamily,
    StepScan,
    credible_interval,
    first_places,
    near_places,
    places_of,
    scan_of,
)
from robacc.tracing.whitened_columns import Columns

N = 48
ROWS = 3


def scan(seed: int = 0) -> tuple[StepScan, np.random.Generator]:
    """A base step, with made-up columns, of poses that were each visited twice."""
    rng = np.random.default_rng(seed)
    arm = Arm.of(robot())
    data = measured(run(N, 1), np.zeros((3, N)), 1e-5, 1)
    form = next(iter(step_forms(arm, data)))
    columns = rng.normal(size=(ROWS, 3, N))
    number = np.arange(N)
    result = scan_of(form, arm, data, columns, (number, np.arange(3.0, N + 2)), np.ones(N - 1, dtype=bool), -1.0)
    assert result is not None
    return result, rng


def correlated(rng: np.random.Generator) -> Whitening:
    """Whitening with scatter: rows i and i + N / 2 are of the same visit, and two visits of the same pose."""
    scatter = Scatter(np.array([0.5, 0.2]), np.array([0.8, 0.4]))
    weight = rng.uniform(0.5, 2.0, (ROWS, N))
    return whitening(weight, rng.normal(size=(ROWS, 2, N)), scatter, np.arange(N) % (N // 2), np.arange(N) % (N // 4))


@pytest.mark.parametrize("is_correlated", [False, True])
def test_sums_equal_the_products_of_built_columns(is_correlated: bool) -> None:
    steps, rng = scan()
    white = correlated(rng) if is_correlated else Whitening(rng.uniform(0.5, 2.0, (ROWS, N)))
    system = Columns(rng.normal(size=(ROWS, 4, N)), rng.normal(size=(ROWS, N)))
    places = np.array([4, 20, 33])
    family = StepFamily(system, steps, places, np.arange(N), Adjoints(white))
    cross = family.new_products(system.columns[:, :4]).reshape(4, places.size, 3)
    for i, place in enumerate(places):
        candidate = steps.candidate(int(place))
        built = steps.whitened(candidate, white) * candidate.weights[:, None]
        assert not np.any(steps.columns[:, :, 0] * candidate.terms[0].parts[0].factor[0])
        np.testing.assert_allclose(family.gram[i], np.einsum("mqn,mpn->qp", built, built), atol=1e-18)
        np.testing.assert_allclose(family.rhs[i], np.einsum("mqn,mn->q", built, system.residual), atol=1e-15)
        np.testing.assert_allclose(cross[:, i], np.einsum("mcn,mqn->cq", system.columns, built), atol=1e-15)


def test_a_first_scan_is_spread_and_the_next_covers_its_gaps() -> None:
    steps, _ = scan()
    at = np.arange(N)
    every = places_of(steps, at)
    assert every.min() == 4
    assert every.max() == N - 6
    few = np.arange(0, N, 2)
    assert set(places_of(steps, few)) <= set(every)
    first = first_places(steps, at)
    covered = np.unique(np.concatenate([near_places(steps, at, int(place)) for place in first]))
    np.testing.assert_array_equal(covered, every)


def test_the_interval_holds_95_percent_of_the_weight() -> None:
    evidence = np.log(np.array([1e-9, 0.01, 0.57, 0.40, 0.02, 1e-9]))
    assert credible_interval(evidence) == (2, 3)
    assert credible_interval(evidence * 0.0) == (0, 5)
