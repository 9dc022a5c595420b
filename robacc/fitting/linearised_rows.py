"""Linearised and whitened rows of measured poses, and their Gram matrix.

A joint's profile has many coefficients, whose columns are all the column of one motion times regressors over the poses.
They are not built: with c and d whitened columns of two motions, f and g regressors, the product of two such columns is
the sum over the poses of (c . d) f g. Rows that are whitened together mix their regressors, so that theirs are built.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.whitening import Whitening
from robacc.geometry import Array


@dataclass(frozen=True, slots=True)
class Profile:
    """Coefficients whose columns are the whitened ``column`` ``(M, n)`` of a motion times ``factors`` ``(Q, n)``."""

    places: NDArray[np.int64]
    """``(Q,)`` indices among the sought coefficients."""
    column: Array
    factors: Array


@dataclass(frozen=True, slots=True)
class LinearisedRows:
    """Linearisation of n rows, not whitened, with D columns and the motions of F profiles."""

    built: NDArray[np.int64]
    """``(D,)`` indices of the columns among the sought coefficients."""
    columns: Array
    """``(M, D, n)``"""
    residual: Array
    """``(M, n)``"""
    places: tuple[NDArray[np.int64], ...]
    """Indices of each profile's coefficients among the sought ones, ``(Q,)``."""
    motions: Array
    """``(M, F, n)``"""
    factors: tuple[Array, ...]
    """Regressors of each profile, ``(Q, n)``."""

    def subset(self, rows: NDArray[np.int64]) -> LinearisedRows:
        """Return some of the rows."""
        return LinearisedRows(
            self.built,
            self.columns[:, :, rows],
            self.residual[:, rows],
            self.places,
            self.motions[:, :, rows],
            tuple(factors[:, rows] for factors in self.factors),
        )

    def whitened(self, white: Whitening) -> WhitenedRows:
        """Return the rows whitened; of rows that are whitened together every column is built, as regressors mix."""
        if white.mixes_rows and self.places:
            return self._completed().whitened(white)
        rows = np.concatenate((self.columns, self.residual[:, None], self.motions), axis=1).transpose(1, 0, 2).copy()
        white.apply_inplace(rows)
        count = self.built.size
        return WhitenedRows(
            self.built, rows[: count + 1], tuple(map(Profile, self.places, rows[count + 1 :], self.factors))
        )

    def _completed(self) -> LinearisedRows:
        """Return the same with every column built."""
        size = self.built.size + sum(places.size for places in self.places)
        columns = np.empty((len(self.columns), size, self.residual.shape[1]))
        columns[:, self.built] = self.columns
        for i, places in enumerate(self.places):
            columns[:, places] = self.motions[:, i, None] * self.factors[i]
        return LinearisedRows(np.arange(size), columns, self.residual, (), self.motions[:, :0], ())


@dataclass(frozen=True, slots=True)
class WhitenedRows:
    """Whitened linearisation of rows."""

    places: NDArray[np.int64]
    """``(D,)`` indices of the built columns among the sought coefficients."""
    rows: Array
    """``(D + 1, M, n)`` built columns, and the residual."""
    profiles: tuple[Profile, ...]

    @property
    def flat(self) -> Array:
        """Return ``(D + 1, M n)`` built columns and the residual."""
        return self.rows.reshape(self.rows.shape[0], -1)

    def gram(self) -> Array:
        """Return ``(K + 1, K + 1)`` the Gram matrix of all columns and the residual."""
        flat = self.flat
        built: Array = flat @ flat.T
        if not self.profiles:
            return built
        size = self.places.size + sum(profile.places.size for profile in self.profiles)
        result = np.empty((size + 1, size + 1))
        at = np.append(self.places, size)
        result[np.ix_(at, at)] = built
        for i, profile in enumerate(self.profiles):
            cross = np.einsum("kmn,mn->kn", self.rows, profile.column) @ profile.factors.T
            result[np.ix_(at, profile.places)], result[np.ix_(profile.places, at)] = cross, cross.T
            scaled = profile.factors * np.sqrt(np.einsum("mn,mn->n", profile.column, profile.column))
            result[np.ix_(profile.places, profile.places)] = scaled @ scaled.T
            for other in self.profiles[:i]:
                scaled = profile.factors * np.einsum("mn,mn->n", profile.column, other.column)
                cross = scaled @ other.factors.T
                result[np.ix_(profile.places, other.places)], result[np.ix_(other.places, profile.places)] = (
                    cross,
                    cross.T,
                )
        return result
