"""Gaussian priors about zero: those that are given, and those of groups, whose width the data decide.

Terms of a group share a width; it is the one of largest marginal likelihood for the present linearisation (MacKay 1992;
REML), found by MacKay's fixed point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Term
from robacc.fitting.gauss_newton import posterior
from robacc.fitting.normal_equations import NormalEquations
from robacc.geometry import Array

_ROUNDS = 60
_SETTLED = 1e-3
"""Widths that change by less than this share from one round to the next are found."""


class Priors:
    """Precision of every coefficient's prior; the groups' widths are improved in place."""

    def __init__(self, terms: Sequence[Term], given: Array | None, start: Mapping[str, float]) -> None:
        """``given`` ``(P,)`` are standard deviations, inf or NaN for none.

        A group starts at the width that ``start`` has of it, or at its terms' usual size.
        """
        self._terms = terms
        self.groups: dict[str, list[int]] = {}
        for i, term in enumerate(terms):
            if term.group is not None:
                self.groups.setdefault(term.group, []).append(i)
        self.widths = {name: start[name] for name in self.groups if name in start}
        """Of each group, in units of its terms' weights."""
        sizes = [start.get(t.group, t.typical) * t.weight if t.group else np.inf for t in terms]
        self.precision: Array = 1.0 / np.square(np.array(sizes, dtype=np.float64))
        if given is not None:
            known = np.isfinite(given) & (given > 0)
            self.precision[known] = 1.0 / np.square(given[known])

    def effective(self, gram: Array, columns: NDArray[np.int64]) -> float:
        """Number of coefficients the data decided: all of them without priors, fewer with."""
        prior = self.precision[columns]
        if not prior.any():
            return float(columns.size)
        return float(columns.size - prior @ np.diag(posterior(gram, prior)))

    def widen(
        self, normal: NormalEquations, columns: NDArray[np.int64], components: float, noise_known: bool, settled: float
    ) -> bool:
        """Find the groups' widths, and where noise is not known its scale; whether one changed by ``settled``.

        ``components`` is the number of residuals that take part.
        """
        place = {int(column): i for i, column in enumerate(columns)}
        before = dict(self.widths)
        noise = 1.0
        for _ in range(_ROUNDS):
            previous = dict(self.widths)
            self._set(noise)
            prior = self.precision[columns]
            spread = np.diag(inverse := posterior(normal.gram, prior))
            theta = inverse @ normal.moment
            for name, members in self.groups.items():
                at = [place[i] for i in members]
                sizes = np.array([self._terms[i].weight for i in members])
                decided = len(members) - float(prior[at] @ spread[at])
                size = float(np.sum(np.square(theta[at] / sizes)))
                self.widths[name] = float(np.sqrt(max(size / max(decided, 1e-3), 1e-18)))
            if not noise_known:
                decided = columns.size - float(prior @ spread)
                noise = float(max(normal.left(theta) / max(components - decided, 1.0), 1e-12))
            if not self._changed(previous, _SETTLED):
                break
        self._set(noise)
        return self._changed(before, settled)

    def _set(self, noise: float) -> None:
        for name, members in self.groups.items():
            width = self.widths.setdefault(name, self._terms[members[0]].typical)
            for i in members:
                self.precision[i] = noise / (width * self._terms[i].weight) ** 2

    def _changed(self, before: dict[str, float], share: float) -> bool:
        return any(abs(width - before.get(name, 0.0)) > share * width for name, width in self.widths.items())
