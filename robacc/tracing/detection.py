"""What these poses could have shown: the size at which each effect would be found.

An effect of coefficients c whose columns have, beside the present model, the new part G (whitened Gram matrix) raises
the F test's noncentrality to c' G c over the noise variance. Its detection limit is the size at which the test, at the
level corrected for everything that competes, finds it with probability one half. A finding has to be found again by
half of the folds too, each of which learns from a share of the poses: the noncentrality is taken on that share.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.statistics.noncentral_f import needed_noncentrality
from robacc.tracing.candidate_scorer import CandidateScorer
from robacc.tracing.candidates import Candidate
from robacc.tracing.evidence import Conditioned
from robacc.tracing.selection import FALSE_ALARM, Selection

EVEN_CHANCE = 0.5
_BEYOND = 300.0
"""Times its usual size: an effect that would have to be larger than this is not shown at all."""
_NEW = 1e-6
"""A direction whose new part is less than this share of its squared length is one that the present model mimics."""


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """The size of one form of an effect that the poses would have shown with even chances."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    limit: float | None
    """In ``unit``; of several coefficients the length of their vector in its least visible direction, such as the
    amplitude of a periodic error whatever its phase. None where no size that an arm could have would be found."""
    unit: str
    rms: float | None
    """How far an effect of that size moves the target, root mean square over the poses, m."""


def detection_limits(selection: Selection, weight: Array, n_folds: int = 0, share: float = 1.0) -> list[DetectionLimit]:
    """The limit of every named form that competes beside what has been chosen, but for forms of mixed units.

    ``weight`` ``(M, n)`` are the whitening weights of the poses that the choice looked at, which are the ``share`` of
    all poses. ``n_folds`` is how many folds a finding has to be found again by half of; 0 for none.
    """
    field = selection.field
    conditioned = field.condition(selection.chosen)
    learnt = (1.0 - 1.0 / n_folds if n_folds else 1.0) / share
    present = [one.candidate for one in selection.chosen]
    return [
        _limit(candidate, columns, field, conditioned, weight, learnt)
        for candidate, columns in _forms(field)
        if not any(field.holds(one, candidate) for one in present)
    ]


def noncentrality_at_limit(rank: int, freedom: float, log_prior: float, learnt: float = 1.0) -> float:
    """The noncentrality over all poses at which an effect of ``rank`` new directions is found with even chances.

    ``learnt`` is the share of the poses that each of the folds learns from.
    """
    level = FALSE_ALARM * math.exp(log_prior)
    return needed_noncentrality(EVEN_CHANCE, level, float(rank), round(freedom * learnt) - rank) / learnt


def visible(blocks: Array, lengths: Array) -> tuple[Array, Array]:
    """``(Q,)`` eigenvalues, ascending, and ``(Q, Q)`` eigenvectors of a new part; what is mimicked has value 0.

    ``lengths`` ``(Q,)`` are the squared lengths of the whole columns.
    """
    values, vectors = np.linalg.eigh(blocks)
    return np.where(values > _NEW * max(float(lengths.max()), 1e-300), values, 0.0), vectors


def _forms(field: CandidateScorer) -> Iterator[tuple[Candidate, NDArray[np.int64]]]:
    """Forms whose coefficients can be added up to one size, but for those that others make up."""
    free = [one for one in field.pool if not one.is_block and len({term.unit for term in one.terms}) == 1]
    names = [{term.name for term in one.terms} for one in free]
    for one, own in zip(free, names, strict=True):
        if not any(other < own for other in names):
            yield one, field.columns(one)


def _limit(
    candidate: Candidate,
    columns: NDArray[np.int64],
    field: CandidateScorer,
    conditioned: Conditioned,
    weight: Array,
    learnt: float,
) -> DetectionLimit:
    effect = candidate.effect
    values, vectors = visible(conditioned.block(columns), np.diag(field.system.gram)[columns])
    size = rms = None
    if values[0] > 0:
        noise = conditioned.energy / conditioned.freedom
        needed = noncentrality_at_limit(values.size, conditioned.freedom, candidate.log_prior, learnt)
        size = math.sqrt(needed * noise / float(values[0]))
        if size > _BEYOND * candidate.terms[0].typical:
            size = None
    if size is not None:
        moved = np.einsum("mqn,q->mn", field.system.columns[:3][:, columns], vectors[:, 0]) / weight[:3]
        rms = size * float(np.sqrt(np.mean(np.sum(np.square(moved), axis=0))))
    return DetectionLimit(effect.name, effect.joints, effect.settings(), size, candidate.terms[0].unit, rms)
