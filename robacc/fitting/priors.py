"""Gaussian priors about zero: given ones, tolerances, those of weakly identifiable constants and of groups."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Term
from robacc.fitting.normal_equations import NormalEquations, PoseEquations, posterior
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array
from robacc.modelling.model import Model
from robacc.robots.description import Robot

# Weakly identifiable constants of the arm: poses are few, or all have one orientation.
#
# Without a prior, noise moves such a constant by centimetres along a direction that has no effect on these poses but
# does on others. The constants of its kind then share a Gaussian prior about nominal, whose standard deviation is
# estimated from the data (:mod:`robacc.fitting.priors`): zeros that are wrong by degrees widen their own prior,
# and leave that of the lengths narrow. Given priors take precedence.

BADLY_MADE = 3.0
"""Deviation of a constant of a badly made arm, over its usual size: 3 mm or 3 mrad."""
WEAK = 0.3
"""Share of that deviation above which a standard error makes a constant weakly identifiable."""


@dataclass(frozen=True, slots=True)
class ConstantKind:
    """Constants that share a prior: joint zeros, link lengths or link angles."""

    name: str
    members: tuple[int, ...]
    """Numbers of the coefficients."""
    usual: float
    """Usual size, m or rad."""


def constant_kinds(equations: PoseEquations, model: Model) -> tuple[ConstantKind, ...]:
    """Return the kinds of constants among the sought coefficients; frames belong to none."""
    members: dict[str, list[int]] = {}
    for i in equations.columns.tolist():
        effect, term = model.free[equations.owners[i]], equations.terms[i]
        if effect.is_constant and not effect.is_frame and term.group is None:
            members.setdefault(f"{effect.name} ({term.unit})", []).append(i)
    return tuple(
        ConstantKind(name, tuple(columns), max(equations.terms[i].typical for i in columns))
        for name, columns in members.items()
    )


def badly_made(equations: PoseEquations, model: Model) -> Array:
    """Return ``(K,)`` the deviation of each sought coefficient on a badly made arm (m or rad); inf of no constant."""
    constant = [effect.is_constant and not effect.is_frame for effect in model.free]
    return np.array(
        [
            BADLY_MADE * equations.terms[i].typical if constant[equations.owners[i]] else np.inf
            for i in equations.columns
        ]
    )


def std_at_nominal(equations: PoseEquations, white: Whitening, precision: Array) -> Array:
    """Return ``(K,)`` standard errors of the sought coefficients at the nominal robot.

    A coefficient that drifts goes to where it appears well identifiable; the nominal robot shows its real standard
    error. ``white`` has weight zero for rows left out, ``precision`` ``(P,)`` is of the priors.
    """
    _, normal = equations.linearise(np.zeros(len(equations.terms)), white)
    std: Array = np.sqrt(np.diag(posterior(normal.gram, precision[equations.columns])))
    return std


# Gaussian priors about zero: given ones, and those of groups, whose standard deviation is estimated from the data.
#
# Terms of a group share a standard deviation, that of the largest marginal likelihood for the present linearisation
# (MacKay 1992; REML), by MacKay's fixed point and, near it, Fisher's scoring. The constants of a kind
# (:mod:`robacc.fitting.priors`) are a group too. Since they are few, their standard deviation has a prior of
# its own, worth :data:`PSEUDO_CONSTANTS` constants of the usual size: without it the estimate could be zero, and the
# intervals with it.

PSEUDO_CONSTANTS = 2.0
"""Weight of the usual size in the estimated standard deviation of a kind of constants, in constants."""
_LOG_FACTORS = tuple(np.linspace(-1.2, 1.8, 7).tolist())
"""Grid of the widths: logarithms of their ratios to the estimates."""
_MOST_KINDS = 3
"""Kinds of constants up to which their widths are integrated."""
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
_INNER = 0.1
"""The same, over the change that counts as settled: later linearisations continue the iteration."""


class Priors:
    """Precision of every coefficient's prior; the groups' standard deviations are improved in place."""

    def __init__(self, terms: Sequence[Term], prior_stds: Array | None, start: Mapping[str, float]) -> None:
        """Start from ``prior_stds`` ``(P,)``, standard deviations, inf or NaN for none.

        A group starts at its standard deviation in ``start``, or at its terms' usual size.
        """
        self._terms = terms
        self._weights = np.array([term.weight for term in terms], dtype=np.float64)
        self._usual: dict[str, float] = {}
        """Usual size of the constants of each kind."""
        self.groups: dict[str, list[int]] = {}
        for i, term in enumerate(terms):
            if term.group is not None:
                self.groups.setdefault(term.group, []).append(i)
        self.group_stds = {name: start[name] for name in self.groups if name in start}
        """Standard deviation of each group, in units of its terms' weights."""
        sizes = [start.get(t.group, t.typical) * t.weight if t.group else np.inf for t in terms]
        self.precision: Array = 1.0 / np.square(np.array(sizes, dtype=np.float64))
        if prior_stds is not None:
            known = np.isfinite(prior_stds) & (prior_stds > 0)
            self.precision[known] = 1.0 / np.square(prior_stds[known])

    def add_kind(self, kind: str, members: Sequence[int], usual: float, start: float | None = None) -> None:
        """Put the constants ``members`` under a common prior; those with a prior already keep theirs.

        Args:
            kind: Name of the kind.
            members: Numbers of the coefficients.
            usual: Usual size of such a constant, m or rad.
            start: Standard deviation to start from, m or rad; that of a badly made arm if None.
        """
        without_prior = [i for i in members if self.precision[i] == 0.0]
        if kind in self.groups or not without_prior:
            return
        self.groups[kind], self._usual[kind] = without_prior, usual
        self._weights[without_prior] = 1.0
        self.group_stds[kind] = BADLY_MADE * usual if start is None else start
        self.precision[without_prior] = self.group_stds[kind] ** -2

    @property
    def kind_stds(self) -> dict[str, float]:
        """Return the estimated standard deviation of each kind of constants, m or rad."""
        return {kind: self.group_stds[kind] for kind in self._usual}

    def covariance(self, normal: NormalEquations, columns: NDArray[np.int64]) -> Array:
        """Return ``(K, K)`` posterior covariance of the coefficients, over the uncertain widths of the kinds' priors.

        The widths are integrated over a grid around their estimates, by the marginal likelihood of the linearisation
        and the prior of the width: cov = E[cov(s)] + E[(theta(s) - theta) (theta(s) - theta)^T].
        """
        prior = self.precision[columns]
        inverse = normal.posterior(prior)
        index = {int(column): i for i, column in enumerate(columns)}
        members = [
            np.array([index[i] for i in self.groups[kind] if i in index], dtype=np.int64) for kind in self._usual
        ]
        if not sum(indices.size for indices in members):
            return inverse
        # A width changes the precision of its kind alone, so that the others' equations stay eliminated.
        joined = np.concatenate(members)
        information = posterior(inverse[np.ix_(joined, joined)], np.zeros(joined.size))
        to_all = inverse[:, joined] @ information
        theta = inverse[joined] @ normal.rhs
        log_factors = np.array(
            list(itertools.product(_LOG_FACTORS if len(members) <= _MOST_KINDS else (0.0,), repeat=len(members)))
        )
        kind_of = np.repeat(np.arange(len(members)), [indices.size for indices in members])
        precision = prior[joined] * np.exp(-2.0 * log_factors[:, kind_of])
        matrices = information + np.eye(joined.size) * (precision - prior[joined])[:, None, :]
        inverses = np.linalg.inv(matrices)
        differences = inverses @ (information @ theta) - theta
        log_weight = 0.5 * (differences @ (information @ theta) - np.linalg.slogdet(matrices)[1])
        log_weight += 0.5 * np.log(precision).sum(axis=1)
        for kind, log_factor in zip(self._usual, log_factors.T, strict=True):
            std = self.group_stds[kind] * np.exp(log_factor)
            log_weight -= PSEUDO_CONSTANTS * (np.log(std) + 0.5 * np.square(BADLY_MADE * self._usual[kind] / std))
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        mean = np.einsum("s,sij->ij", weight, inverses) + (differences.T * weight) @ differences
        return np.asarray(inverse + to_all @ (mean - inverse[np.ix_(joined, joined)]) @ to_all.T, dtype=np.float64)

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
            if name in self._usual:
                n_determined += PSEUDO_CONSTANTS
                sum_of_squares += PSEUDO_CONSTANTS * (BADLY_MADE * self._usual[name]) ** 2
            determined.append(max(n_determined, 1e-3))
            ratios.append(max(sum_of_squares, 1e-18) / self.group_stds[name] ** 2)
            current.append(self.group_stds[name])
        score = 0.5 * (np.array(ratios) - np.array(determined))
        membership = np.zeros((len(places), prior.size))
        for row, indices in zip(membership, places.values(), strict=True):
            row[indices] = 1.0
        information = 0.5 * membership @ squared @ membership.T
        usual = [self._usual.get(name, 0.0) / std for name, std in zip(places, current, strict=True)]
        information += np.diag(0.5 * PSEUDO_CONSTANTS * BADLY_MADE**2 * np.square(usual) + _LEAST_INFORMATION)
        scoring = np.linalg.solve(information, score)
        fixed_point = np.log(np.array(ratios) / np.array(determined))
        steps = np.where(np.abs(scoring) < _NEAR, scoring, fixed_point)
        for name, indices, std, step in zip(places, places.values(), current, steps.tolist(), strict=True):
            group_std = max(std * math.exp(0.5 * step), 1e-9)
            members = columns[indices].tolist()
            self.group_stds[name] = group_std if name in self._usual else min(group_std, self._largest(members))

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
