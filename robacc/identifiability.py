"""What the poses cannot tell apart, found from the Jacobian before any fit, and said in words.

Columns are scaled to unit length and taken in the catalogue's order; a column that those before it already reproduce
gets no number. The decision is by orthogonal factorisation with a fixed order and a fixed threshold, so it is the same
on every run and machine. Observability indices O1 to O5: Sun and Hollerbach 2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array

DEPENDENT = 1e-6
"""A column whose part that is new is below this share of its length is dependent: model and rounding reach 1e-12, while
the weakest combinations that measured arms show lie above 1e-4."""
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


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Which coefficients are kept, and how well the poses show them."""

    kept: NDArray[np.int64]
    dropped: tuple[Dropped, ...]
    singular_values: Array
    """Of the kept, scaled columns, descending."""
    n_poses: int

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


def identify(triangle: Array, names: Sequence[str], n_poses: int) -> Identifiability:
    """Decide from ``triangle`` ``(R, P)``, any matrix with the Gram matrix of the whitened Jacobian (its R factor)."""
    length = np.sqrt(np.sum(np.square(triangle), axis=0))
    largest = float(length.max(initial=0.0))
    basis = np.zeros((triangle.shape[0], 0))
    kept: list[int] = []
    dropped: list[Dropped] = []
    for column in range(triangle.shape[1]):
        if length[column] <= 1e-13 * largest:
            dropped.append(Dropped(names[column], ()))
            continue
        scaled = triangle[:, column] / length[column]
        new = scaled - basis @ (basis.T @ scaled)
        new = new - basis @ (basis.T @ new)
        size = float(np.sqrt(new @ new))
        if size > DEPENDENT:
            basis = np.column_stack((basis, new / size))
            kept.append(column)
            continue
        scaled_kept = triangle[:, kept] / length[kept]
        shares = np.linalg.lstsq(scaled_kept, scaled, rcond=None)[0]
        order = np.argsort(-np.abs(shares), kind="stable")
        partners = tuple(names[kept[i]] for i in order if abs(shares[i]) > _NAMED)
        dropped.append(Dropped(names[column], partners))
    values = np.linalg.svd(triangle[:, kept] / length[kept], compute_uv=False) if kept else np.zeros(0)
    return Identifiability(np.array(kept, dtype=np.int64), tuple(dropped), values, n_poses)
