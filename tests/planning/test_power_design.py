"""Choice for a trace: costs against least squares from the ground, and gain over random poses."""

from __future__ import annotations

import numpy as np
from scipy import stats

from robacc.planning.power import PowerCriterion, PowerProblem, choose_for_power, expected_power, random_power


def problem(seed: int = 0, n: int = 60, free: int = 4, effects: int = 7) -> PowerProblem:
    rng = np.random.default_rng(seed)
    rows, columns = rng.normal(size=(n, 3, free)), rng.normal(size=(n, 3, effects))
    # Poses differ in what they show, or every choice would be as good.
    columns *= np.exp(rng.normal(size=(n, 1, effects)))
    columns[:, :, 1] = columns[:, :, 0] + 0.3 * columns[:, :, 1]
    rival = np.arange(effects)
    rival[0], rival[1] = 1, 0
    information = np.diag(np.repeat([1e-6, 0.0], [free, effects]))
    return PowerProblem(np.concatenate((rows, columns), 2), information, PowerCriterion(np.full(effects, 30.0), rival))


def explained(case: PowerProblem, chosen: np.ndarray, k: int, beside: list[int]) -> float:
    """Squared length of column k of the chosen poses, orthogonal to the four free ones and those ``beside``."""
    columns = case.rows[chosen].reshape(-1, case.rows.shape[2])
    column, others = columns[:, 4 + k], columns[:, [*range(4), *(4 + i for i in beside)]]
    solution = np.linalg.lstsq(others, column, rcond=None)[0]
    return float(np.sum(np.square(column - others @ solution)))


def test_the_value_is_that_of_least_squares() -> None:
    case, chosen = problem(), np.arange(3, 20)
    detected = [stats.norm.cdf(explained(case, chosen, k, []) ** 0.5 - 30**0.5) for k in range(7)]
    separated = np.ones(7)
    for k in (0, 1):
        separated[k] = stats.norm.cdf(explained(case, chosen, k, [1 - k]) ** 0.5 - 6**0.5)
    power = expected_power(case, chosen)
    np.testing.assert_allclose(
        [power.detected, power.separated], [np.mean(detected), np.mean(detected * separated)], rtol=1e-6
    )
    assert case.cost(chosen) == -0.5 * (power.detected + power.separated)


def test_additions_agree_with_the_cost_of_all_poses() -> None:
    case, chosen = problem(3), np.array([3, 7, 11, 20, 41, 52])
    costs = case.costs_beside(chosen)
    others = np.setdiff1d(np.arange(60), chosen)
    np.testing.assert_allclose(costs[others], [case.cost(np.append(chosen, k)) for k in others], rtol=1e-6)
    assert np.isinf(costs[chosen]).all()


def test_choice_is_never_worse_than_random() -> None:
    for seed in range(3):
        case = problem(seed)
        chosen = choose_for_power(case, 12, seed)
        assert np.unique(chosen).size == 12
        rng = np.random.default_rng(seed)
        assert case.cost(chosen) < min(case.cost(rng.choice(60, 12, replace=False)) for _ in range(30))
        assert expected_power(case, chosen).detected > random_power(case, 12, seed).detected
