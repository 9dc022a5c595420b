"""Resamples of poses for the bootstrap."""

from __future__ import annotations

import numpy as np

from robacc.geometry import Array


def resampled_counts(size: int, draws: int, seed: int | tuple[int, ...]) -> Array:
    """Return how often each of ``size`` poses occurs in each resample, ``(draws, size)``, read-only."""
    indices = np.random.default_rng(seed).integers(size, size=(draws, size))
    indices += size * np.arange(draws)[:, None]
    counts = np.bincount(indices.ravel(), minlength=draws * size).reshape(draws, size).astype(float)
    counts.flags.writeable = False
    return counts
