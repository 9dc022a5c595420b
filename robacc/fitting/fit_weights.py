"""Weights of the residuals in one fit: noise and misfit, scatter of the joints, variance added for shared errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Options
from robacc.fitting.misfit import row_weights
from robacc.fitting.places import places
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitening import Scatter, Whitening, whitening, whitening_of_noise
from robacc.geometry import Array
from robacc.measurements import Measurements


class FitWeights:
    """Reciprocal standard deviations ``row`` ``(M, N)`` of noise and added variance, and whitening with them."""

    def __init__(
        self, data: Measurements, options: Options, joint_columns: Array | None, misfit: tuple[float, float]
    ) -> None:
        """Weight ``data`` for a ``misfit`` of position (m) and orientation (rad).

        ``joint_columns`` ``(M, J, N)`` are those of the joint variables; None without scatter.
        """
        self._data, self._added = data, options.added
        self._scatter: tuple[Array, Scatter, NDArray[np.int64], NDArray[np.int64]] | None = None
        if joint_columns is not None and options.scatter is not None:
            # Rows of a place share errors; without such errors, those of a commanded pose.
            sharing = places(data) if options.scatter.pose_std.any() else data.groups()
            self._scatter = joint_columns, options.scatter, visit_numbers(data), sharing
        self._latest: Whitening | None = None
        self.set_misfit(misfit)

    def set_misfit(self, misfit: tuple[float, float]) -> None:
        """Weight for another misfit."""
        self._of_noise = row_weights(self._data, misfit)
        self.row: Array = self._of_noise
        if self._added is not None:
            further = np.repeat((self._added.position, self._added.orientation), 3)[: self.row.shape[0], None]
            self.row = self._of_noise / np.sqrt(self._added.factor + np.square(self._of_noise * further))

    def whitening(self, inliers: NDArray[np.bool_] | None = None) -> Whitening:
        """Return the whitening of the inliers, or of all rows if ``inliers`` is None."""
        weight = self.row if inliers is None else self.row * inliers
        if self._latest is None or not np.array_equal(self._latest.weight, weight):
            self._latest = self._whitening(weight, 1.0 if self._added is None else self._added.factor)
        return self._latest

    def whitening_of_noise(self, inliers: NDArray[np.bool_]) -> Whitening:
        """Return the whitening of the inliers without added variance."""
        if self._added is None:
            return self.whitening(inliers)
        return self._whitening(self._of_noise * inliers, 1.0)

    def _whitening(self, weight: Array, factor: float) -> Whitening:
        """Return the whitening with ``factor`` times the variances of the scatter and of correlated noise."""
        noise = None if self._data.correlated_noise is None else factor * self._data.correlated_noise
        if self._scatter is None:
            return Whitening(weight) if noise is None else whitening_of_noise(weight, noise)
        joint_columns, scatter, visits, sharing = self._scatter
        return whitening(weight, joint_columns, scatter.scaled(factor**0.5), visits, sharing, noise)
