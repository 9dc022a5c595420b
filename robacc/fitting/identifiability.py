"""What the poses cannot tell apart, found from the Jacobian before any fit, and said in words.

Columns are scaled to unit length and taken in the catalogue's order; a column that those before it already reproduce
gets no number. The decision is by orthogonal factorisation with a fixed order and a fixed threshold, so it is the same
on every run and machine. Observability indices O1 to O5: Sun and Hollerbach 2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array

DEPENDENT = 3e-5
"""A column whose part that is new is below this share of its length is dependent; one below this share of the longest
of its unit tells nothing. Model and rounding reach 1e-12; registering a target on the last axis from noisy poses makes
up levers of some micrometres, 1e-5 of an arm's reach; the weakest combinations measured arms show lie above 1e-4."""
_NOTHING = 1e-13
"""A column below this share of the longest is rounding."""
_NAMED = 0.05
"""A kept column is named as a partner where its share of the dependent one exceeds this."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """A coefficient that the poses cannot identify."""

    name: str
    partners: tuple[str, ...]
    """The coefficients that do the same; empty where it does nothing at all."""

    @property
    def why(self) -> str:
        """In words."""
        if not self.partners:
            return f"{self.name} has no effect on these poses"
        shown = ", ".join(self.partners[:4]) + (" …" if len(self.partners) > 4 else "")
        together = "" if len(self.partners) == 1 else " together"
        return f"{self.name} cannot be told from {shown}{together} on these poses"


@dataclass(frozen=True)
class Identifiability:
    """Which coefficients are kept, and how well the poses show them."""

    kept: NDArray[np.int64]
    dropped: tuple[Dropped, ...]
    root: Array
    """``(K, K)`` triangular factor of the kept columns, scaled to unit length."""
    n_poses: int

    @cached_property
    def singular_values(self) -> Array:
        """Of the kept, scaled columns, descending."""
        return np.asarray(np.linalg.svd(self.root, compute_uv=False), dtype=np.float64)

    @property
    def condition(self) -> float:
        """Condition number of the kept, scaled columns."""
        if self.singular_values.size == 0:
            return 1.0
        return float(self.singular_values[0] / self.singular_values[-1])

    def observability(self) -> dict[str, float]:
        """O1 = (prod s)^(1/L)/sqrt(m), O2 = s_L/s_1, O3 = s_L, O4 = s_L^2/s_1, O5 = 1/sum(1/s)."""
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
    triangle: Array, names: Sequence[str], n_poses: int, units: Sequence[str] | None = None
) -> Identifiability:
    """Decide from ``triangle`` ``(R, P)``, any matrix with the Gram matrix of the whitened Jacobian (its R factor).

    Columns are compared in length with those of the same one of ``units``, where these are given.

    Modified Gram-Schmidt in the order of the columns: a column that is new takes its direction out of all that follow.
    Its factor is as exact as Householder's (Bjorck 1967), and the directions of columns left out never enter.
    """
    length = np.sqrt(np.sum(np.square(triangle), axis=0))
    there = length > _NOTHING * float(length.max(initial=0.0))
    if units is not None:
        kinds = np.array(units, dtype=str)
        for kind in np.unique(kinds):
            same = kinds == kind
            there &= ~same | (length > DEPENDENT * float(length[same].max(initial=0.0)))
    rest = np.asfortranarray(triangle / np.where(there, length, 1.0))
    factor = np.zeros((triangle.shape[1], triangle.shape[1]))
    kept: list[int] = []
    before: list[tuple[int, int]] = []
    for column in np.flatnonzero(there).tolist():
        own = rest[:, column]
        size = float(np.sqrt(own @ own))
        if size <= DEPENDENT:
            before.append((column, len(kept)))
            continue
        direction = own / size
        shares = direction @ rest[:, column:]
        rest[:, column:] -= np.outer(direction, shares)
        factor[len(kept), column:] = shares
        kept.append(column)
    root = factor[: len(kept), kept]
    partners = _partners(root, factor, before, [names[i] for i in kept])
    dropped = tuple(Dropped(names[i], partners.get(i, ())) for i in range(len(names)) if i not in set(kept))
    return Identifiability(np.array(kept, dtype=np.int64), dropped, root, n_poses)


def _partners(
    root: Array, factor: Array, dependent: Sequence[tuple[int, int]], names: Sequence[str]
) -> dict[int, tuple[str, ...]]:
    """For each dependent column, of which so many kept ones went before, those that make it up, largest share first."""
    if not dependent:
        return {}
    right = factor[: root.shape[0], [column for column, _ in dependent]]
    for place, (_, count) in enumerate(dependent):
        right[count:, place] = 0.0
    shares = np.linalg.solve(root, right)
    found = {}
    for place, (column, _) in enumerate(dependent):
        order = np.argsort(-np.abs(shares[:, place]), kind="stable")
        found[column] = tuple(names[i] for i in order if abs(shares[i, place]) > _NAMED)
    return found
