"""Identifiability of coefficients on the poses, decided from the Jacobian before any fit.

Columns are scaled to unit length and taken in the catalogue's order; a column that depends on those before it is not
identifiable. The decision is by orthogonal factorisation with a fixed order and a fixed threshold, so it is the same
on every run and machine. Observability indices O1 to O5: Sun and Hollerbach 2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects.term import Term
from robacc.geometry import Array

DEPENDENT = 3e-5
"""A column with an independent part below this share of its length is dependent; a column below this share of the
longest of its unit carries no information. Model and rounding reach 1e-12; registering a target on the last axis from
noisy poses makes up levers of some micrometres, 1e-5 of an arm's reach; the weakest combinations of measured arms lie
above 1e-4."""
_NOTHING = 1e-13
"""A column below this share of the longest is rounding."""
_NAMED = 0.05
"""Share of a dependent column above which another column is named as its partner."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """A coefficient that is not identifiable on the poses."""

    name: str
    partners: tuple[str, ...]
    """The coefficients that have the same effect; empty if it has no effect at all."""

    @property
    def why(self) -> str:
        """Return the reason, one sentence."""
        if not self.partners:
            return f"{self.name} has no effect on these poses"
        listed = ", ".join(self.partners[:4]) + (" …" if len(self.partners) > 4 else "")
        together = "" if len(self.partners) == 1 else " together"
        return f"{self.name} is not distinguishable from {listed}{together} on these poses"


@dataclass(frozen=True)
class Identifiability:
    """The identifiable coefficients, and how well the poses determine them."""

    columns: NDArray[np.int64]
    """``(K,)`` numbers of the identifiable coefficients."""
    dropped: tuple[Dropped, ...]
    root: Array
    """``(K, K)`` triangular factor of the columns, scaled to unit length."""
    n_poses: int

    @cached_property
    def singular_values(self) -> Array:
        """Singular values of the scaled columns, descending."""
        return np.asarray(np.linalg.svd(self.root, compute_uv=False), dtype=np.float64)

    @property
    def condition(self) -> float:
        """Condition number of the scaled columns."""
        if self.singular_values.size == 0:
            return 1.0
        return float(self.singular_values[0] / self.singular_values[-1])

    def observability(self) -> dict[str, float]:
        """Return O1 = (prod s)^(1/L)/sqrt(m), O2 = s_L/s_1, O3 = s_L, O4 = s_L^2/s_1, O5 = 1/sum(1/s)."""
        s = self.singular_values
        if s.size == 0:
            return {}
        return {
            "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(self.n_poses)),
            "O2": float(s[-1] / s[0]),
            "O3": float(s[-1]),
            "O4": float(s[-1] ** 2 / s[0]),
            "O5": float(1.0 / np.sum(1.0 / s)),
        }


def identify(
    triangle: Array,
    names: Sequence[str],
    n_poses: int,
    units: Sequence[str] | None = None,
    least_parts: Sequence[float] | None = None,
) -> Identifiability:
    """Decide from ``triangle`` ``(R, P)``, any matrix with the Gram matrix of the whitened Jacobian (its R factor).

    If ``units`` are given, the length of a column is compared with columns of the same unit only. ``least_parts`` are
    the shares of columns that must be independent, where these are above :data:`DEPENDENT`.

    Modified Gram-Schmidt in the order of the columns: an independent column takes its direction out of all that follow.
    Its factor is as exact as Householder's (Bjorck 1967), and the directions of dependent columns never enter.
    """
    length = np.sqrt(np.sum(np.square(triangle), axis=0))
    nonzero = length > _NOTHING * float(length.max(initial=0.0))
    if units is not None:
        column_units = np.array(units, dtype=str)
        for unit in np.unique(column_units):
            of_unit = column_units == unit
            nonzero &= ~of_unit | (length > DEPENDENT * float(length[of_unit].max(initial=0.0)))
    remaining = np.asfortranarray(triangle / np.where(nonzero, length, 1.0))
    factor = np.zeros((triangle.shape[1], triangle.shape[1]))
    columns: list[int] = []
    dependent: list[tuple[int, int]] = []
    for column in np.flatnonzero(nonzero).tolist():
        vector = remaining[:, column]
        size = float(np.sqrt(vector @ vector))
        if size <= (DEPENDENT if least_parts is None else max(DEPENDENT, least_parts[column])):
            dependent.append((column, len(columns)))
            continue
        direction = vector / size
        shares = direction @ remaining[:, column:]
        remaining[:, column:] -= np.outer(direction, shares)
        factor[len(columns), column:] = shares
        columns.append(column)
    root = factor[: len(columns), columns]
    partners = _partners(root, factor, dependent, [names[i] for i in columns])
    dropped = tuple(Dropped(names[i], partners.get(i, ())) for i in range(len(names)) if i not in set(columns))
    return Identifiability(np.array(columns, dtype=np.int64), dropped, root, n_poses)


def identify_terms(triangle: Array, terms: Sequence[Term], n_poses: int) -> Identifiability:
    """Decide as :func:`identify`, by the names, units and least independent parts of ``terms``."""
    names, units = [term.name for term in terms], [term.unit for term in terms]
    return identify(triangle, names, n_poses, units, [term.least_part for term in terms])


def _partners(
    root: Array, factor: Array, dependent: Sequence[tuple[int, int]], names: Sequence[str]
) -> dict[int, tuple[str, ...]]:
    """Return the partners of each dependent column, largest share first; pairs are (column, columns before it)."""
    if not dependent:
        return {}
    right = factor[: root.shape[0], [column for column, _ in dependent]]
    for index, (_, count) in enumerate(dependent):
        right[count:, index] = 0.0
    shares = np.linalg.solve(root, right)
    partners = {}
    for index, (column, _) in enumerate(dependent):
        order = np.argsort(-np.abs(shares[:, index]), kind="stable")
        partners[column] = tuple(names[i] for i in order if abs(shares[i, index]) > _NAMED)
    return partners
