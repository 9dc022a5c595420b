"""Resampled percentiles against NumPy's percentile of the drawn rows."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.statistics.records import _resampled_percentile


@pytest.mark.parametrize("n", [10, 37, 200])
def test_each_resample_has_the_percentile_of_its_rows(n: int) -> None:
    rng = np.random.default_rng(n)
    lengths, drawn = rng.exponential(size=n), rng.integers(n, size=(40, n))
    counts = np.array([np.bincount(rows, minlength=n) for rows in drawn])
    # The same two numbers and the same fraction between them: rounding only.
    np.testing.assert_allclose(
        _resampled_percentile(lengths, counts), np.percentile(lengths[drawn], 95, axis=1), rtol=1e-12
    )
