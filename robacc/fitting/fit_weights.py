"""Weights of the residuals in one fit: noise and misfit, and scatter of the joints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Options
from robacc.fitting.misfit import row_weights
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitening import Whitening, whitening, whitening_of_noise
from robacc.geometry import Array
from robacc.measurements import Measurements


class FitWeights:
    """Reciprocal standard deviations ``row`` ``(M, N)`` of the noise, and whitening with them."""

    def __init__(
        self, data: Measurements, options: Options, joint_columns: Array | None, misfit: tuple[float, float]
    ) -> None:
        """Weight ``data`` for a ``misfit`` of position (m) and orientation (rad).

        ``joint_columns`` ``(M, J, N)`` are those of the joint variables; None without scatter.
        """
        self._data, self._columns, self._scatter = data, joint_columns, options.scatter
        self._visits = visit_numbers(data)
        self._latest: Whitening | None = None
        self.set_misfit(misfit)

    def set_misfit(self, misfit: tuple[float, float]) -> None:
        """Weight for another misfit."""
        self.row: Array = row_weights(self._data, misfit)

    def whitening(self, inliers: NDArray[np.bool_] | None = None) -> Whitening:
        """Return the whitening of the inliers, or of all rows if ``inliers`` is None."""
        weight = self.row if inliers is None else self.row * inliers
        if self._latest is None or not np.array_equal(self._latest.weight, weight):
            self._latest = self._whitening(weight)
        return self._latest

    def _whitening(self, weight: Array) -> Whitening:
        noise = self._data.correlated_noise
        if self._columns is not None and self._scatter is not None:
            return whitening(weight, self._columns, self._scatter, self._visits, noise)
        return Whitening(weight) if noise is None else whitening_of_noise(weight, noise)
