"""Detection limits: the smallest size at which each effect is found on these poses with probability 1/2.

An effect of coefficients c whose columns have, given the present model, the new part G (whitened Gram matrix) raises
the F test's noncentrality to c' G c over the noise variance. Its detection limit is the size at which the test, at the
level corrected for all candidates, finds it with probability 1/2. With cross-validation the test is that
of a fold: on its share of the poses, at the level of folds (:func:`robacc.tracing.selection.fold_level`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array, rms_length
from robacc.statistics.noncentral_f import f_critical, needed_noncentrality, noncentral_f_sf
from robacc.tracing.candidate_scorer import CandidateScorer
from robacc.tracing.candidates import Candidate
from robacc.tracing.conditioned_columns import Conditioned
from robacc.tracing.selection import FALSE_ALARM, Selection, fold_level

_EVEN_CHANCE = 0.5
_JOINT_FACTOR = 1.12
"""Factor on the noncentrality, because the search, half of the folds and the held-out gain must agree. In simulated
linear models (one to four directions, 40 to 200 poses; 1,050 campaigns each) they do so in 56 % of the campaigns
at the limit; with 1.06 in 51 %, with 1.0 in 48 %. Limits are 3 % on the large side."""
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


def detection_limits(selection: Selection, weight: Array, n_folds: int = 0, share: float = 1.0) -> list[DetectionLimit]:
    """Return the limit of every named candidate given the findings, except forms of mixed units.

    ``weight`` ``(M, n)`` are the whitening weights of the poses that the selection uses, which are the ``share`` of all
    poses. A finding must recur in half of ``n_folds`` folds; 0 for no cross-validation.
    """
    scorer = selection.scorer
    forms = list(_forms(scorer))
    conditioned = scorer.condition(selection.chosen)
    present = [finding.candidate for finding in selection.chosen]
    return [
        _limit(candidate, columns, scorer, conditioned, weight, n_folds, share)
        for candidate, columns in forms
        if not any(scorer.redundancy.covers(chosen, candidate) for chosen in present)
    ]


@dataclass(frozen=True, slots=True)
class DecisiveTest:
    """F test that decides whether a trace finds an effect: of a fold, or of all poses without cross-validation."""

    level: float
    dof: tuple[float, float]
    """Degrees of freedom of the effect and of the residual."""
    factor: float
    """Noncentrality of the test over that of the poses at hand."""

    @property
    def noncentrality_at_limit(self) -> float:
        """Return the noncentrality over the poses at hand at which an effect is found with probability 1/2.

        It is infinite if no degree of freedom is left to test with.
        """
        if self.dof[1] <= 0.0:
            return math.inf
        return needed_noncentrality(_EVEN_CHANCE, self.level, *self.dof) / self.factor

    def power(self, noncentrality: float) -> float:
        """Return the probability that an effect is found, from its noncentrality over the poses at hand."""
        if self.dof[1] <= 0.0:
            return 0.0
        return noncentral_f_sf(f_critical(self.level, *self.dof), *self.dof, self.factor * noncentrality)


def decisive_test(rank: int, dof: float, log_prior: float, n_folds: int = 0, share: float = 1.0) -> DecisiveTest:
    """Return the test that decides about an effect with ``rank`` new directions.

    Args:
        rank: Number of new directions.
        dof: Degrees of freedom of the residual without the effect, over the poses at hand.
        log_prior: Logarithm of the effect's share of the level.
        n_folds: Number of folds; 0 for no cross-validation.
        share: The poses at hand as a share of all poses.
    """
    train_share = 1.0 - 1.0 / n_folds if n_folds else 1.0
    level = (fold_level(train_share) if n_folds else FALSE_ALARM) * math.exp(log_prior)
    poses = train_share / share
    residual_dof = float(round(dof * poses) - rank)
    return DecisiveTest(level, (float(rank), residual_dof), poses / (_JOINT_FACTOR if n_folds else 1.0))


def visible(blocks: Array, lengths: Array) -> tuple[Array, Array]:
    """Return ``(Q,)`` eigenvalues, ascending, and ``(Q, Q)`` eigenvectors of a new part; 0 for explained directions.

    ``lengths`` ``(Q,)`` are the squared lengths of the complete columns.
    """
    values, vectors = np.linalg.eigh(blocks)
    return np.where(values > _LEAST_NEW * max(float(lengths.max()), 1e-300), values, 0.0), vectors


def _forms(scorer: CandidateScorer) -> Iterator[tuple[Candidate, NDArray[np.int64]]]:
    """Yield forms with coefficients of a common unit, except forms that contain another form."""
    free = [
        candidate
        for candidate in (*scorer.pool, *scorer.steps_in_the_middle())
        if not candidate.is_block and len({term.unit for term in candidate.terms}) == 1
    ]
    names = [{term.name for term in candidate.terms} for candidate in free]
    for candidate, term_names in zip(free, names, strict=True):
        if not any(other < term_names for other in names):
            yield candidate, scorer.columns(candidate)


def _limit(
    candidate: Candidate,
    columns: NDArray[np.int64],
    scorer: CandidateScorer,
    conditioned: Conditioned,
    weight: Array,
    n_folds: int,
    share: float,
) -> DetectionLimit:
    effect = candidate.effect
    values, vectors = visible(conditioned.block(columns), scorer.system.lengths[columns])
    size = rms = None
    if values[0] > 0:
        noise = conditioned.cost / conditioned.dof
        needed = decisive_test(values.size, conditioned.dof, candidate.log_prior, n_folds, share).noncentrality_at_limit
        size = math.sqrt(needed * noise / float(values[0]))
        if size > _LARGEST * candidate.terms[0].typical:
            size = None
    if size is not None:
        moved = np.einsum("mqn,q->mn", scorer.system.columns[:3][:, columns], vectors[:, 0]) / weight[:3]
        rms = size * rms_length(moved)
    return DetectionLimit(effect.name, effect.joints, effect.settings(), size, candidate.terms[0].unit, rms)
