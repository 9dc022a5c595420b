"""Detection limits: the smallest size at which each effect is found on these poses with probability 1/2.

An effect of coefficients c whose columns have, given the present model, the new part G (whitened Gram matrix) raises
the statistic t^2 by c' G c over the noise variance. A search accepts q coefficients from the t^2 on at which the
evidence at the best prior size, (t^2 - q)/2 - q/2 log(t^2/q), exceeds the prior odds and :data:`ACCEPTED`; an effect
has its detection limit where the noise takes it there with probability 1/2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.change_points import is_step
from robacc.error_model.estimate import ACCEPTED
from robacc.geometry import Array, rms_length
from robacc.statistics.distributions import chi2_sf
from robacc.statistics.noncentral_f import f_critical, needed_noncentrality, noncentral_f_sf
from robacc.tracing.candidates import Candidate
from robacc.tracing.search import SearchResult

_LARGEST = 300.0
"""Largest limit, in multiples of the usual size; an effect that needs more has no detection limit."""
_LEAST_NEW = 1e-6
"""Share of its squared length below which the new part of a direction counts as explained by the present model."""


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """Smallest size of one form of an effect that these poses show with probability 1/2."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    limit: float | None
    """Size in ``unit``. With several coefficients: the length of their vector in its least visible direction, such as
    the amplitude of a periodic error whatever its phase. None if no plausible size is found."""
    unit: str
    rms: float | None
    """Displacement of the target by an effect of that size, root mean square over the poses, m."""


@dataclass(frozen=True, slots=True)
class DecisiveTest:
    """F test at the level that the accepted odds are worth."""

    level: float
    dof: tuple[float, float]
    """Degrees of freedom of the effect and of the residual."""

    @property
    def noncentrality_at_limit(self) -> float:
        """Return the noncentrality at which an effect is found with probability 1/2; infinite without any dof."""
        return math.inf if self.dof[1] <= 0.0 else needed_noncentrality(0.5, self.level, *self.dof)

    def power(self, noncentrality: float) -> float:
        """Return the probability that an effect is found."""
        if self.dof[1] <= 0.0:
            return 0.0
        return noncentral_f_sf(f_critical(self.level, *self.dof), *self.dof, noncentrality)


def decisive_test(rank: int, dof: float, log_prior: float) -> DecisiveTest:
    """Return the test that decides about a candidate with ``rank`` new directions.

    Args:
        rank: Number of new directions.
        dof: Degrees of freedom of the residual without the effect.
        log_prior: Log prior probability of the candidate at its most probable size.
    """
    needed = ACCEPTED - log_prior
    statistic = float(rank)
    # The evidence grows with the statistic by (1 - q / t^2) / 2: Newton steps from above converge.
    statistic += 2.0 * needed + rank
    for _ in range(50):
        evidence = 0.5 * (statistic - rank) - 0.5 * rank * math.log(statistic / rank)
        statistic += (needed - evidence) / (0.5 * (1.0 - rank / statistic))
    return DecisiveTest(max(chi2_sf(statistic, float(rank)), 1e-300), (float(rank), float(round(dof) - rank)))


def detection_limits(found: SearchResult) -> list[DetectionLimit]:
    """Return the limit of every named candidate given the findings, except forms of mixed units."""
    reduced, _, square = found.evidence.conditioned(found.final_columns)
    dof = found.evidence.columns.shape[0] - found.evidence.effective(np.ones(len(found.state.theta), dtype=bool))
    present = {effect.key() for effect in found.effects}
    weight = 1.0 / found.noise.independent(found.state.linear.rows.stated).T
    result = []
    for candidate, columns in _forms(found):
        if candidate.key in present:
            continue
        own = found.evidence.columns[:, columns]
        new = own.T @ own - reduced[:, columns].T @ reduced[:, columns]
        values, vectors = visible(new, np.einsum("nq,nq->q", own, own))
        effect, size, rms = candidate.effect, None, None
        if values[0] > 0 and dof > 0:
            needed = decisive_test(values.size, dof, candidate.log_prior_of_size).noncentrality_at_limit
            multiple = math.sqrt(needed * square / dof / float(values[0]))
            size = multiple * float(candidate.sizes[0]) if multiple <= _LARGEST else None
            if size is not None:
                moved = (own @ vectors[:, 0]).reshape(weight.shape)[:3] / weight[:3]
                rms = multiple * rms_length(moved)
        result.append(DetectionLimit(effect.name, effect.joints, effect.settings(), size, candidate.terms[0].unit, rms))
    return result


def visible(blocks: Array, lengths: Array) -> tuple[Array, Array]:
    """Return ``(Q,)`` eigenvalues, ascending, and ``(Q, Q)`` eigenvectors of a new part; 0 for explained directions.

    ``lengths`` ``(Q,)`` are the squared lengths of the complete columns.
    """
    values, vectors = np.linalg.eigh(blocks)
    return np.where(values > _LEAST_NEW * max(float(lengths.max()), 1e-300), values, 0.0), vectors


def _forms(found: SearchResult) -> Iterator[tuple[Candidate, NDArray[np.int64]]]:
    """Yield forms with coefficients of a common unit, except forms that contain another form; steps in the middle."""
    candidates, places = found.pool.all[: len(found.evidence.places)], found.evidence.places
    named = [c for c in found.pool.named if len({term.unit for term in c.terms}) == 1]
    names = {candidate.key: {term.name for term in candidate.terms} for candidate in named}
    steps: dict[tuple[object, ...], list[tuple[Candidate, NDArray[np.int64]]]] = {}
    for candidate, columns in zip(candidates, places, strict=True):
        if (own := names.get(candidate.key)) is not None:
            if not any(other < own for other in names.values()):
                yield candidate, columns
        elif is_step(candidate.effect) and len({term.unit for term in candidate.terms}) == 1:
            form = (candidate.effect.joints, *(term.name for term in candidate.terms))
            steps.setdefault(form, []).append((candidate, columns))
    for same in steps.values():
        yield same[len(same) // 2]
