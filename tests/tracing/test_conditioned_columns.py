"""A model that has a column twice, from two forms of an effect, is the model that has it once."""

from __future__ import annotations

import numpy as np

from robacc.tracing.conditioned_columns import Columns, Conditioned, Family


def test_a_column_that_stands_twice_counts_once() -> None:
    rng = np.random.default_rng(1)
    system = Columns(rng.normal(size=(3, 4, 30)), rng.normal(size=(3, 30)))
    basis = rng.normal(size=(5, 2, 30))
    scores = []
    for active in ([0, 1, 2], [0, 1, 2, 1]):
        model = Conditioned.on(system, active, np.zeros(len(active)))
        family = Family(system, system.columns[:, 3], basis, False)
        scores.append(family.judge(model).evidence)
        # The same without a finding, which takes another path.
        scores.append(family.judge(model.without(np.array([2]))).evidence)
    np.testing.assert_allclose(scores[0], scores[2], rtol=1e-9)
    np.testing.assert_allclose(scores[1], scores[3], rtol=1e-9)
    assert np.ptp(scores[0]) > 0
