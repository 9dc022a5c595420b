"""Evidence and significance of candidates, against direct computations that share no code with them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import null_space

from robacc.tracing.conditioned_columns import Conditioned, Family
from robacc.tracing.evidence import Scores, judge
from robacc.tracing.whitened_columns import Columns

ROWS, BASE = 60, 8


def problem(seed: int, columns: int, size: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of a model ``(60, 8)``, of a candidate ``(60, Q)``, and a residual with the candidate in it."""
    rng = np.random.default_rng(seed)
    base = rng.normal(size=(ROWS, BASE))
    # Partly what the model can mimic.
    candidate = rng.normal(size=(ROWS, columns)) + base[:, :columns] * 0.7
    residual = rng.normal(size=ROWS) + base @ rng.normal(size=BASE) + size * candidate.sum(axis=1)
    return base, candidate, residual


def scores(base: np.ndarray, candidate: np.ndarray, residual: np.ndarray, *, block: bool = False) -> Scores:
    """As a selection has them: three components a pose, the candidate orthogonalised to the model."""

    def by_pose(matrix: np.ndarray) -> np.ndarray:
        return np.moveaxis(matrix.reshape(3, ROWS // 3, -1), 2, 1)

    system = Columns(by_pose(base), residual.reshape(3, -1))
    columns = system.append(by_pose(candidate))
    present = Conditioned.on(system, range(BASE), np.zeros(BASE))
    return judge(
        present.block(columns)[None],
        present.rhs[columns][None],
        system.lengths[columns][None],
        present.cost,
        present.dof,
        np.array([block]),
    )


def direct_evidence(base: np.ndarray, candidate: np.ndarray, residual: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Log marginal likelihood ratio at each width, from the covariance matrix of what the model leaves (REML).

    y = Q^T residual with Q spanning what the model cannot reach is N(0, s^2 (1 + w X X^T)); s^2 at its best value.
    """
    rest = null_space(base.T)
    y, x = rest.T @ residual, rest.T @ candidate
    n = y.size

    def profile(covariance: np.ndarray) -> float:
        scale = y @ np.linalg.solve(covariance, y) / n
        return float(stats.multivariate_normal(cov=scale * covariance).logpdf(y))

    nothing = profile(np.eye(n))
    return np.array([profile(np.eye(n) + width * x @ x.T) - nothing for width in widths])


@pytest.mark.parametrize("size", [0.0, 0.3, 1.0, 5.0])
def test_evidence_of_one_column_is_its_closed_form(size: float) -> None:
    for seed in range(5):
        base, candidate, residual = problem(seed, 1, size)
        found = scores(base, candidate, residual)
        rest = null_space(base.T)
        y, x = rest.T @ residual, (rest.T @ candidate)[:, 0]
        n, share = y.size, (x @ y) ** 2 / (x @ x) / (y @ y)
        # With t = w x.x / (1 + w x.x) it is -n/2 log(1 - t share) + 1/2 log(1 - t), whose derivative has one zero.
        best = max((n * share - 1) / (share * (n - 1)), 0.0)
        expected = -0.5 * n * np.log1p(-best * share) + 0.5 * np.log1p(-best)
        assert found.rank.tolist() == [1]
        assert found.dof == pytest.approx(n, rel=1e-12)
        assert found.cost == pytest.approx(y @ y, rel=1e-10)
        # Widths are tried on a grid of factors of 1.6: near the top that costs at most a few hundredths of a nat.
        assert expected - 0.03 <= found.evidence[0] <= expected + 1e-9


@pytest.mark.parametrize("size", [0.0, 0.2, 2.0])
def test_evidence_of_several_columns_is_the_largest_marginal_likelihood(size: float) -> None:
    for seed in range(4):
        base, candidate, residual = problem(seed, 4, size)
        found = scores(base, candidate, residual)
        at_own_width = direct_evidence(base, candidate, residual, found.prior_var)
        assert found.evidence[0] == pytest.approx(max(at_own_width[0], 0.0), abs=1e-8)
        anywhere = direct_evidence(base, candidate, residual, np.geomspace(1e-6, 1e6, 200))
        # Half a step of the grid is 0.23 in log width: by the curvature of four coefficients, 0.23^2 nats at most.
        assert found.evidence[0] >= anywhere.max() - 0.053


def test_significance_is_the_f_test_of_nested_fits() -> None:
    for seed in range(5):
        for columns, size in ((1, 0.0), (1, 0.3), (3, 0.1), (4, 1.0)):
            base, candidate, residual = problem(seed, columns, size)
            found = scores(base, candidate, residual)

            def left(matrix: np.ndarray, residual: np.ndarray = residual) -> float:
                solution = np.linalg.lstsq(matrix, residual, rcond=None)[0]
                return float(np.sum(np.square(residual - matrix @ solution)))

            alone, both = left(base), left(np.hstack((base, candidate)))
            freedom = ROWS - BASE - columns
            expected = stats.f.sf((alone - both) / columns / (both / freedom), columns, freedom)
            assert found.gain[0] == pytest.approx(alone - both, rel=1e-9)
            assert found.p_value(0) == pytest.approx(expected, rel=1e-7)


def test_significance_of_a_block_is_that_of_its_width() -> None:
    base, candidate, residual = problem(3, 6, 0.2)
    found = scores(base, candidate, residual, block=True)
    assert found.evidence[0] > 0
    assert found.p_value(0) == pytest.approx(0.5 * stats.chi2.sf(2 * found.evidence[0], 1), rel=1e-10)


def test_significance_holds_its_level_where_there_is_nothing() -> None:
    p_values = [scores(*problem(seed, 2)).p_value(0) for seed in range(400)]
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
    # For a block the test of its width is conservative, never the other way: 5 standard errors of 400.
    blocks = [scores(*problem(seed, 8), block=True).p_value(0) for seed in range(400)]
    assert np.mean(np.array(blocks) <= 0.05) <= 0.05 + 5 * np.sqrt(0.05 * 0.95 / 400)


def test_what_the_model_can_mimic_is_no_evidence() -> None:
    base, candidate, residual = problem(1, 3, 2.0)
    mimic = base @ np.random.default_rng(2).normal(size=(BASE, 3))
    found = scores(base, mimic, residual)
    assert (found.rank[0], found.evidence[0], found.p_value(0)) == (0, 0.0, 1.0)
    # Two new columns and one that is old: as if the old one were not there.
    part = scores(base, np.column_stack((candidate[:, :2], base[:, 0])), residual)
    assert part.rank[0] == 2
    assert part.p_value(0) == pytest.approx(scores(base, candidate[:, :2], residual).p_value(0), rel=1e-8)


def test_an_absurd_coefficient_is_no_explanation() -> None:
    # The same column in units a billion times too small would need a coefficient that no arm has: its prior does not
    # reach that far, and the evidence is gone, while a factor of a hundred changes nothing.
    base, candidate, residual = problem(2, 1, 1.0)
    usual = scores(base, candidate, residual).evidence[0]
    assert usual > 3
    assert scores(base, 1e-2 * candidate, residual).evidence[0] == pytest.approx(usual, abs=0.03)
    assert scores(base, 1e-9 * candidate, residual).evidence[0] < 1e-6


def test_conditioning_with_a_prior_is_ridge_regression() -> None:
    base, candidate, residual = problem(4, 2, 0.5)
    precision = np.array([0.0, 3.0, 10.0, 0.0, 100.0, 0.0, 1.0, 0.0])

    def by_pose(matrix: np.ndarray) -> np.ndarray:
        return np.moveaxis(matrix.reshape(3, ROWS // 3, -1), 2, 1)

    system = Columns(by_pose(np.hstack((base, candidate))), residual.reshape(3, -1))
    found = Conditioned.on(system, range(BASE), precision)
    # A prior is rows of its own: sqrt(precision) theta = 0.
    padded = np.vstack((base, np.diag(np.sqrt(precision))))
    solution, *_ = np.linalg.lstsq(padded, np.concatenate((residual, np.zeros(BASE))), rcond=None)
    energy = np.sum(np.square(residual - base @ solution)) + precision @ np.square(solution)
    assert found.cost == pytest.approx(energy, rel=1e-10)
    hat = base @ np.linalg.solve(base.T @ base + np.diag(precision), base.T)
    np.testing.assert_allclose(found.block(np.array([8, 9])), candidate.T @ (candidate - hat @ candidate), rtol=1e-9)
    np.testing.assert_allclose(found.blocks(np.array([[8, 9], [9, 8]]))[0], found.block(np.array([8, 9])), rtol=1e-12)
    np.testing.assert_allclose(found.rhs[8:], candidate.T @ (residual - hat @ residual), rtol=1e-9)
    assert found.dof == pytest.approx(ROWS - np.trace(hat), rel=1e-10)


def test_new_parts_of_a_family_are_those_of_its_columns_built() -> None:
    """Also where a column of the model is active twice, and in a model without some columns of a larger one."""
    generator = np.random.default_rng(5)
    n_rows, n_active, n_forms = 3, 7, 4
    columns = generator.normal(size=(n_rows, n_active, 40))
    system = Columns(columns, generator.normal(size=(n_rows, 40)))
    shared = generator.normal(size=(n_rows, 40))
    basis = generator.normal(size=(n_forms, 2, 40))
    family = Family(system, shared, basis, False)
    built = np.einsum("mn,bqn->mnbq", shared, basis).reshape(-1, n_forms * 2)
    flat = np.moveaxis(columns, 1, 2).reshape(-1, n_active)

    def new_parts(active: list[int]) -> tuple[np.ndarray, np.ndarray]:
        new = built - flat[:, active] @ np.linalg.lstsq(flat[:, active], built, rcond=None)[0]
        rhs = new.T @ system.residual.reshape(-1)
        gram = np.einsum("rbp,rbq->bpq", *(2 * [new.reshape(-1, n_forms, 2)]))
        return gram, rhs.reshape(n_forms, 2)

    model = Conditioned.on(system, [0, 1, 2, 3, 2, 3], np.zeros(6))
    smaller = Conditioned.on(system, [0, 4, 1, 2], np.zeros(4)).without(slice(1, 3))
    for conditioned, active in ((model, [0, 1, 2, 3]), (smaller, [0, 2]), (smaller, [0, 2])):
        for found, expected in zip(conditioned.remaining(family), new_parts(active), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    pair = np.array([[5, 6]])
    new = flat[:, 5:7] - flat[:, [0, 2]] @ np.linalg.lstsq(flat[:, [0, 2]], flat[:, 5:7], rcond=None)[0]
    np.testing.assert_allclose(smaller.blocks(pair)[0], new.T @ new, rtol=1e-9)
    np.testing.assert_allclose(
        smaller.reduced.T @ smaller.reduced, flat.T @ flat - _remaining_gram(flat, [0, 2]), atol=1e-9
    )


def _remaining_gram(columns: np.ndarray, active: list[int]) -> np.ndarray:
    new = columns - columns[:, active] @ np.linalg.lstsq(columns[:, active], columns, rcond=None)[0]
    return np.asarray(new.T @ new)


@pytest.mark.parametrize("size", [2, 3, 6])
def test_the_best_of_each_group_is_the_best_of_all_scores(size: int) -> None:
    rng = np.random.default_rng(size)
    columns = rng.normal(size=(60, 80, size))
    # Some candidates have columns that depend on each other.
    columns[::3, :, -1] = columns[::3, :, 0]
    residual = rng.normal(size=80) + columns[7] @ rng.normal(size=size) + 0.5 * columns[41, :, 0]
    blocks, rhs = np.swapaxes(columns, 1, 2) @ columns, np.einsum("bnq,n->bq", columns, residual)
    inputs = blocks, rhs, np.sum(np.square(columns), axis=1), float(residual @ residual), 70.0, np.zeros(60, dtype=bool)
    groups = [slice(0, 30), slice(30, 60)]
    all_scores, best_scores = judge(*inputs), judge(*inputs, groups)
    for group in groups:
        best = group.start + int(np.argmax(all_scores.evidence[group]))
        assert group.start + int(np.argmax(best_scores.evidence[group])) == best
        assert best_scores.evidence[best] == pytest.approx(all_scores.evidence[best], rel=1e-12)
        assert best_scores.gain[best] == pytest.approx(all_scores.gain[best], rel=1e-12)
        assert best_scores.rank[best] == all_scores.rank[best]
    assert np.all(best_scores.evidence <= all_scores.evidence + 1e-12)
