"""A model changed step by step is the model built at once, also where two findings share a column."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.tracing.conditioned_columns import Conditioned, Family
from robacc.tracing.whitened_columns import Columns

ROWS, POSES, COUNT = 3, 30, 9


@pytest.fixture
def system() -> Columns:
    rng = np.random.default_rng(1)
    return Columns(rng.normal(size=(ROWS, COUNT, POSES)), rng.normal(size=(ROWS, POSES)))


@pytest.fixture
def family(system: Columns) -> Family:
    return Family(system, system.columns[:, 3], np.random.default_rng(2).normal(size=(5, 2, POSES)), shrunk=False)


def assert_same(model: Conditioned, direct: Conditioned, family: Family) -> None:
    for value, expected in zip(model.remaining(family), direct.remaining(family), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(model.rhs, direct.rhs, atol=1e-9)
    pairs = np.array([[5, 6], [6, 8]])
    np.testing.assert_allclose(model.blocks(pairs), direct.blocks(pairs), atol=1e-9)
    np.testing.assert_allclose(model.reduced.T @ model.reduced, direct.reduced.T @ direct.reduced, atol=1e-9)
    assert model.cost == pytest.approx(direct.cost, rel=1e-10)
    assert model.dof == pytest.approx(direct.dof, rel=1e-10)
    assert model.rank == direct.rank


def test_a_model_extended_twice_is_the_model_of_all_its_columns(system: Columns, family: Family) -> None:
    precision = np.array([0.0, 2.0])
    model = Conditioned.on(system, [0, 1], np.zeros(2)).extended(np.array([2, 4]), precision)
    model = model.extended(np.array([7]), np.zeros(1))
    assert model.is_independent
    assert_same(model, Conditioned.on(system, [0, 1, 2, 4, 7], np.array([0.0, 0.0, 0.0, 2.0, 0.0])), family)
    without = Conditioned.on(system, [0, 1, 7], np.zeros(3))
    assert_same(model.without(slice(2, 4)), without, family)
    eight = np.array([8]), np.ones(1)
    assert_same(model.without(slice(2, 4)).extended(*eight), without.extended(*eight), family)


def test_columns_appended_later_belong_to_models_made_before(system: Columns, family: Family) -> None:
    model = Conditioned.on(system, [0, 1], np.zeros(2)).extended(np.array([2]), np.zeros(1))
    smaller = model.without(slice(2, 3))
    for conditioned in (model, smaller):
        assert conditioned.rhs.size == conditioned.reduced.shape[1] == COUNT
    for count in (1, 3):
        system.append(np.random.default_rng(count).normal(size=(ROWS, count, POSES)))
    assert system.columns.shape[1] == COUNT + 4
    assert_same(model, Conditioned.on(system, [0, 1, 2], np.zeros(3)), family)
    assert_same(smaller, Conditioned.on(system, [0, 1], np.zeros(2)), family)
    flat = np.moveaxis(system.columns, 1, 2).reshape(-1, system.count)
    np.testing.assert_allclose(system.products(np.arange(system.count)), flat.T @ flat, atol=1e-12)


def test_a_column_that_stands_twice_counts_once(system: Columns, family: Family) -> None:
    once = Conditioned.on(system, [0, 1, 2], np.zeros(3))
    assert_same(Conditioned.on(system, [0, 1, 2, 1], np.zeros(4)), once, family)
    model = Conditioned.on(system, [0], np.zeros(1)).extended(np.array([1, 2]), np.zeros(2))
    shared = model.extended(np.array([2, 7]), np.zeros(2))
    assert_same(shared, Conditioned.on(system, [0, 1, 2, 7], np.zeros(4)), family)
    # Without the first of two findings the shared column stays: such a model must be built anew.
    assert not shared.is_independent


def test_coefficients_with_priors_are_those_of_a_longer_least_squares_problem(system: Columns) -> None:
    model, columns, precision = Conditioned.on(system, [0, 1], np.zeros(2)), np.array([4, 6]), np.array([0.0, 50.0])
    flat = np.moveaxis(system.columns, 1, 2).reshape(-1, COUNT)
    rows = np.concatenate((flat[:, [0, 1, 4, 6]], np.diag(np.sqrt([0.0, 0.0, *precision]))))
    values = np.concatenate((system.residual.ravel(), np.zeros(4)))
    expected = np.linalg.lstsq(rows, values, rcond=None)[0][2:]
    np.testing.assert_allclose(model.least_squares(columns, precision), expected, rtol=1e-9)
    assert not np.allclose(model.least_squares(columns), expected, rtol=1e-3)
