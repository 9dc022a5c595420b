"""Resamples of poses."""

from __future__ import annotations

import numpy as np
import pytest

from robacc.statistics.intervals import resampled_counts


def test_each_resample_has_as_many_poses_as_the_sample_and_each_pose_once_on_average() -> None:
    counts = resampled_counts(20, 4000, 3)
    assert counts.shape == (4000, 20)
    assert np.all(counts.sum(axis=1) == 20)
    # Five standard errors of a mean of 4,000 binomial counts of variance 0.95.
    assert counts.mean(axis=0) == pytest.approx(np.ones(20), abs=5 * np.sqrt(0.95 / 4000))


def test_resamples_are_read_only_and_repeat_with_their_seed() -> None:
    counts = resampled_counts(5, 10, (1, 2))
    assert np.array_equal(counts, resampled_counts(5, 10, (1, 2)))
    assert not np.array_equal(counts, resampled_counts(5, 10, (1, 3)))
    with pytest.raises(ValueError, match="read-only"):
        counts[0, 0] = 1.0
