"""Choice for a trace: updates against least squares from the ground, and gain over random poses."""

from __future__ import annotations

import numpy as np
from scipy import stats

from robacc.planning.power import PowerProblem, choose_for_power, expected_power, random_power


def problem(seed: int = 0, n: int = 60, free: int = 4, effects: int = 7) -> PowerProblem:
    rng = np.random.default_rng(seed)
    rows, columns = rng.normal(size=(3, n, free)), rng.normal(size=(3, n, effects))
    # Poses differ in what they show, or every choice would be as good.
    columns *= np.exp(rng.normal(size=(n, effects)))
    columns[:, :, 1] = columns[:, :, 0] + 0.3 * columns[:, :, 1]
    rival = np.arange(effects)
    rival[0], rival[1] = 1, 0
    empty = np.zeros((effects, effects))
    return PowerProblem(
        rows, columns, 1e-6 * np.eye(free), np.zeros((free, effects)), empty, np.full(effects, 30.0), rival
    )


def explained(case: PowerProblem, chosen: np.ndarray, k: int, beside: list[int]) -> float:
    """Squared length of column k of the chosen poses, orthogonal to the free ones and those ``beside``."""
    others = [case.rows[:, chosen].reshape(-1, case.rows.shape[2])]
    others += [case.effects[:, chosen, i].reshape(-1, 1) for i in beside]
    column = case.effects[:, chosen, k].ravel()
    solution = np.linalg.lstsq(np.hstack(others), column, rcond=None)[0]
    return float(np.sum(np.square(column - np.hstack(others) @ solution)))


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


def test_updates_keep_the_value() -> None:
    from robacc.planning.power import _PowerSearch

    case = problem(3)
    search = _PowerSearch(case, np.ones(60, dtype=bool))
    added = [search.add_best() for _ in range(12)]
    search.change(added[4], -1.0)
    remaining = np.array(added[:4] + added[5:])
    np.testing.assert_allclose(search.value, float(case.value(*case.of(remaining))), rtol=1e-6)
    # The best addition is that of all additions.
    values = {k: float(case.value(*case.of(np.append(remaining, k)))) for k in np.flatnonzero(search.free)}
    assert search.add_best() == max(values, key=lambda k: values[k])


def test_choice_is_never_worse_than_random() -> None:
    for seed in range(3):
        case = problem(seed)
        chosen = choose_for_power(case, 12, seed)
        assert np.unique(chosen).size == 12
        rng = np.random.default_rng(seed)
        random = [float(case.value(*case.of(rng.choice(60, 12, replace=False)))) for _ in range(30)]
        assert float(case.value(*case.of(chosen))) > max(random)
        assert expected_power(case, chosen).detected > random_power(case, 12, seed).detected
