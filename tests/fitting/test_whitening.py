"""Whitening with shared scatter against the dense covariance of all rows."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.fitting.normal_equations import Whitening, whitening

POSES, CYCLES, TARGETS = 5, 4, 3
N = POSES * CYCLES * TARGETS
COMPONENTS, JOINTS = 3, 4
NOISE = 1.3
DIRECTIONAL = np.array([[2.0, 0.6, -0.5], [0.6, 0.9, 0.3], [-0.5, 0.3, 1.4]])
"""Covariance of each row beside the noise."""
CASES = [(0.5, None), (0.0, None), (0.5, DIRECTIONAL), (0.0, DIRECTIONAL)]


class Sample:
    """Rows in random order, with their covariance as one dense matrix; component by component, row by row."""

    def __init__(self, visit_std: float, noise: np.ndarray | None = None) -> None:
        rng = np.random.default_rng(1)
        order = rng.permutation(N)
        self.visits = np.repeat(np.arange(POSES * CYCLES), TARGETS)[order]
        self.weight = np.full((COMPONENTS, N), 1.0 / NOISE)
        self.columns = rng.normal(size=(COMPONENTS, JOINTS, N))
        self.scatter = visit_std * np.arange(1.0, JOINTS + 1)
        self.dense = np.diag(1.0 / np.square(self.weight.ravel()))
        self.dense += sum(std**2 * self.shared(self.visits, joint) for joint, std in enumerate(self.scatter.tolist()))
        self.noise = noise
        if noise is not None:
            self.dense += np.kron(noise, np.eye(N))

    def shared(self, groups: np.ndarray, joint: int) -> np.ndarray:
        """B B^T of a joint whose error the rows of a group share."""
        column, number = self.columns[:, joint].ravel(), np.tile(groups, COMPONENTS)
        return np.outer(column, column) * (number[:, None] == number)

    def whitening(self) -> Whitening:
        return whitening(self.weight, self.columns, self.scatter, self.visits, self.noise)


def matrix(white: Whitening) -> np.ndarray:
    unit = np.eye(COMPONENTS * N).reshape(-1, COMPONENTS, N)
    return white.apply(unit).reshape(COMPONENTS * N, -1).T


@pytest.mark.parametrize(("visit_std", "noise"), CASES)
def test_residuals_get_unit_covariance(visit_std: float, noise: np.ndarray | None) -> None:
    sample = Sample(visit_std, noise)
    white = sample.whitening()
    root = matrix(white)
    np.testing.assert_allclose(root @ sample.dense @ root.T, np.eye(COMPONENTS * N), atol=1e-12)
    unit = np.eye(COMPONENTS * N).reshape(-1, COMPONENTS, N)
    np.testing.assert_allclose(white.apply_transposed(unit).reshape(COMPONENTS * N, -1), root, atol=1e-13)


@pytest.mark.parametrize(("visit_std", "noise"), [(0.5, None), (0.5, DIRECTIONAL), (0.0, DIRECTIONAL)])
def test_rows_that_are_ignored_do_not_change_those_that_stay(visit_std: float, noise: np.ndarray | None) -> None:
    sample = Sample(visit_std, noise)
    kept = np.flatnonzero(sample.visits % 4 != 1)
    sample.weight[:, sample.visits % 4 == 1] = 0.0
    values = np.random.default_rng(2).normal(size=(COMPONENTS, N))
    white = sample.whitening()
    np.testing.assert_allclose(white.apply(values)[:, kept], white.subset(kept).apply(values[:, kept]), atol=1e-13)
