"""Priors about zero: the broad one of the arm's constants, given ones, tolerances, and those of groups."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect, Term
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import NormalEquations, posterior
from robacc.geometry import Array
from robacc.robots.description import Robot

# Broad prior of the arm's constants, and the constants that it bounds.
#
# Poses may be few, or all have one orientation. Without a prior, noise then moves a constant by centimetres along a
# direction that has no effect on these poses but does on others. Each constant of the arm therefore has a Cauchy prior
# about nominal, which near nominal is a Gaussian one with the standard deviation b of a badly made arm. Its tails are
# heavy: an arm may differ from its file by any amount that the data show. At a constant c it pulls as a Gaussian prior
# of precision 1 / (b^2 + c^2 / 2) does (iterative reweighting; Holland and Welsch 1977). Given priors are Gaussian.

BADLY_MADE = 3.0
"""Standard deviation of the broad prior near nominal, over the usual size of a constant: 3 mm or 3 mrad."""
WEAK = 0.3
"""Share of that standard deviation above which a standard error makes a constant weakly identifiable."""


@dataclass(frozen=True, slots=True)
class WeakKind:
    """Constants of one effect and unit, of which some are weakly identifiable."""

    effect: str
    unit: str
    std: float
    """Standard deviation of the broad prior near nominal, in ``unit``."""
    names: tuple[str, ...]
    """Names of the weakly identifiable constants."""


def broad_stds(free: Sequence[Effect], terms: Sequence[Term], owners: Sequence[int]) -> Array:
    """Return ``(P,)`` standard deviations of the constants' broad prior near nominal, m or rad; inf for all others."""
    is_constant = [effect.traits.is_constant and not effect.traits.is_frame for effect in free]
    return np.array(
        [BADLY_MADE * term.typical if is_constant[owner] else np.inf for term, owner in zip(terms, owners, strict=True)]
    )


def broad_precision(std: Array, theta: Array) -> Array:
    """Return the precision ``(P,)`` with which the broad prior pulls coefficients ``theta``; 0 where ``std`` is inf."""
    precision: Array = 1.0 / (np.square(std) + 0.5 * np.square(theta))
    return precision


def weak_kinds(fit: Fit) -> tuple[WeakKind, ...]:
    """Return the kinds of constants of which some are weakly identifiable: the broad prior bounds these.

    Constants with another prior are not weakly identifiable.
    """
    columns = fit.identifiability.columns
    broad = broad_stds(fit.model.free, fit.terms, fit.owners)[columns]
    is_weak = np.sqrt(np.diag(posterior(fit.gram, fit.precision))) > WEAK * broad
    is_weak &= np.isclose(fit.precision, broad_precision(broad, fit.theta[columns]), rtol=0.5)
    kinds: dict[tuple[str, str, float], list[str]] = {}
    for i, std in zip(columns[is_weak].tolist(), broad[is_weak].tolist(), strict=True):
        kinds.setdefault((fit.model.free[fit.owners[i]].name, fit.terms[i].unit, std), []).append(fit.names[i])
    return tuple(WeakKind(*kind, tuple(names)) for kind, names in kinds.items())


# Priors of a fit: the broad one, given ones, and those of groups, whose standard deviation is estimated from the data.
#
# Terms of a group share a standard deviation, that of the largest marginal likelihood for the present linearisation
# (MacKay 1992; REML), by MacKay's fixed point and, near it, Fisher's scoring.

LARGEST_OF_PROFILE = 10.0
"""Standard deviation of a profile's group that it cannot exceed, over its terms' usual size.

Where poses leave gaps, large coefficients that cancel at the poses fit as well as small ones; what the effect can be
decides then.
"""
_NEAR = 1.0
"""Change of the logarithm of a variance below which a step of scoring is trusted."""
_LEAST_INFORMATION = 1e-9
"""Added to the information on the logarithm of a variance, which is zero for a group without any effect."""
_ROUNDS = 60
_SETTLED = 1e-3
"""Change of the groups' standard deviations, as a share, at which the iteration ends."""
_FOLLOWED = 0.1
"""Change of a broad prior's precision, as a share, below which it is settled: it moves a constant by less."""
_INNER = 0.1
"""The same, over the change that counts as settled: later linearisations continue the iteration."""


class Priors:
    """Precision of every coefficient's prior; broad priors and the groups' deviations are improved in place."""

    def __init__(self, terms: Sequence[Term], given: Array, broad: Array, start: Mapping[str, float]) -> None:
        """Start from standard deviations ``(P,)`` of ``given`` and ``broad`` priors, inf for none; a given one counts.

        A group starts at its standard deviation in ``start``, or at its terms' usual size.
        """
        self._broad = np.where(np.isfinite(given), np.inf, broad)
        self.is_broad = np.isfinite(self._broad)
        """``(P,)`` mask of the coefficients with a broad prior."""
        self._terms = terms
        self._weights = np.array([term.weight for term in terms], dtype=np.float64)
        self.groups: dict[str, list[int]] = {}
        for i, term in enumerate(terms):
            if term.group is not None:
                self.groups.setdefault(term.group, []).append(i)
        self.group_stds = {name: start[name] for name in self.groups if name in start}
        """Standard deviation of each group, in units of its terms' weights."""
        sizes = [
            start.get(term.group, term.typical) * term.weight if term.group else std
            for term, std in zip(terms, given.tolist(), strict=True)
        ]
        self.precision: Array = 1.0 / np.square(np.array(sizes, dtype=np.float64))

    def follow(self, theta: Array) -> bool:
        """Let broad priors pull as they do at ``theta`` ``(P,)``; return False, without a change, if they nearly do."""
        precision = np.where(self.is_broad, broad_precision(self._broad, theta), self.precision)
        if np.all(np.abs(self.precision - precision) <= _FOLLOWED * precision):
            return False
        self.precision = precision
        return True

    def log_density(self, theta: Array) -> float:
        """Return the log density of coefficients ``(P,)``, up to a constant."""
        is_gaussian = ~self.is_broad & (self.precision > 0)
        precision, own = self.precision[is_gaussian], theta[is_gaussian]
        broad = np.log1p(0.5 * np.square(theta / self._broad))
        return float(0.5 * np.sum(np.log(precision) - precision * np.square(own)) - np.sum(broad))

    def effective(self, normal: NormalEquations, columns: NDArray[np.int64]) -> float:
        """Return the number of coefficients that the data determine: all without priors, fewer with."""
        prior = self.precision[columns]
        if not prior.any():
            return float(columns.size)
        return float(columns.size - prior @ np.diag(normal.posterior(prior)))

    def update(
        self, normal: NormalEquations, columns: NDArray[np.int64], components: float, noise_known: bool, settled: float
    ) -> bool:
        """Update the groups' standard deviations, and the noise if unknown; return whether one changed by ``settled``.

        ``components`` is the number of residuals of the inliers.
        """
        index = {int(column): i for i, column in enumerate(columns)}
        places = {
            name: np.array([index[i] for i in group if i in index], dtype=np.int64)
            for name, group in self.groups.items()
        }
        if not places:
            return False
        before = dict(self.group_stds)
        noise_var = 1.0
        for _ in range(_ROUNDS):
            previous = dict(self.group_stds)
            self._set(noise_var)
            prior = self.precision[columns]
            inverse = normal.posterior(prior)
            theta = inverse @ normal.rhs
            self._improve(inverse, theta, prior, places, columns)
            if not noise_known:
                n_determined = columns.size - float(prior @ np.diag(inverse))
                noise_var = float(max(normal.expected_cost(theta) / max(components - n_determined, 1.0), 1e-12))
            if not self._changed(previous, max(_SETTLED, _INNER * settled)):
                break
        self._set(noise_var)
        return self._changed(before, settled)

    def _improve(
        self,
        inverse: Array,
        theta: Array,
        prior: Array,
        places: Mapping[str, NDArray[np.int64]],
        columns: NDArray[np.int64],
    ) -> None:
        """Take one step of the groups' standard deviations towards the largest marginal likelihood.

        Far from it the step is the fixed point's, near it that of Fisher's scoring in the logarithms of the variances:
        with B = 1 - P^(1/2) C P^(1/2), the information is half of the squared norm of B's block of two groups.
        """
        root = np.sqrt(prior)
        squared = np.square(np.eye(prior.size) - root[:, None] * inverse * root)
        determined, ratios, current = [], [], []
        for name, indices in places.items():
            n_determined = indices.size - float(prior[indices] @ np.diag(inverse)[indices])
            sum_of_squares = float(np.sum(np.square(theta[indices] / self._weights[columns[indices]])))
            determined.append(max(n_determined, 1e-3))
            ratios.append(max(sum_of_squares, 1e-18) / self.group_stds[name] ** 2)
            current.append(self.group_stds[name])
        score = 0.5 * (np.array(ratios) - np.array(determined))
        membership = np.zeros((len(places), prior.size))
        for row, indices in zip(membership, places.values(), strict=True):
            row[indices] = 1.0
        information = 0.5 * membership @ squared @ membership.T
        information += _LEAST_INFORMATION * np.eye(len(places))
        scoring = np.linalg.solve(information, score)
        fixed_point = np.log(np.array(ratios) / np.array(determined))
        steps = np.where(np.abs(scoring) < _NEAR, scoring, fixed_point)
        for name, indices, std, step in zip(places, places.values(), current, steps.tolist(), strict=True):
            group_std = max(std * math.exp(0.5 * step), 1e-9)
            self.group_stds[name] = min(group_std, self._largest(columns[indices].tolist()))

    def _largest(self, members: Sequence[int]) -> float:
        """Return the largest standard deviation of a profile's group."""
        return LARGEST_OF_PROFILE * max(self._terms[i].typical for i in members)

    def _set(self, noise_var: float) -> None:
        for name, members in self.groups.items():
            group_std = self.group_stds.setdefault(name, self._terms[members[0]].typical)
            for i in members:
                self.precision[i] = noise_var / (group_std * self._weights[i]) ** 2

    def _changed(self, before: dict[str, float], share: float) -> bool:
        return any(
            abs(group_std - before.get(name, 0.0)) > share * group_std for name, group_std in self.group_stds.items()
        )


# Tolerances of a robot file as priors of its constants.


def tolerance_priors(robot: Robot) -> dict[str, float]:
    """Return the robot file's tolerances as prior standard deviations, by coefficient name."""
    priors = {}
    for joint in robot.joints:
        for label, deviation in joint.tolerance.items():
            is_offset = label == joint.offset_parameter
            name = f"joint_offset.{joint.name}" if is_offset else f"link_geometry.{joint.name}.{label}"
            priors[name] = deviation
    return priors
