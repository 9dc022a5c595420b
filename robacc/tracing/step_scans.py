"""Scan of the poses for steps: the score of a step at every place, from sums over the poses.

A step at place k has the columns of its always-on form on the poses after k and zero before, so that its products with
any column are sums over the poses after k. The products of all places follow from one pass over the poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.change_points import FEWEST, after_step, at_place, place_of, same_form
from robacc.fitting.whitening import Whitening, blocks_of
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.tracing.candidates import Candidate
from robacc.tracing.conditioned_columns import Family
from robacc.tracing.whitened_columns import Columns

_MOST_PLACES = 48
"""Largest number of places of a first scan; the best is then improved among all places."""
_LEAST_BEFORE = 0.25
"""Least share of the visits before a change of the load."""
_CREDIBLE = 0.95
"""Posterior probability of a step's interval."""


@dataclass(frozen=True, eq=False)
class StepScan:
    """One form of a step, on all poses of a linearisation, and the places where it may lie."""

    form: Effect
    arm: Arm
    data: Measurements
    columns: Array
    """``(M, Q, n)`` columns of the form before all poses, not whitened."""
    number: NDArray[np.int64]
    """``(n,)`` number of each pose in the sequence."""
    places: Array
    """``(P,)`` place of the step before each number but the first."""
    eligible: NDArray[np.int64]
    """Indices of the places that a search may use."""
    log_prior: float
    _candidates: dict[int, Candidate] = field(default_factory=dict)

    def whitened(self, candidate: Candidate, whitening: Whitening) -> Array:
        """Return ``(M, Q, n)`` whitened columns of a step of the form."""
        after = after_step(candidate.effect, self.data)
        return np.moveaxis(whitening.apply(np.moveaxis(self.columns * after, 1, 0)), 0, 1)

    def place_index(self, effect: Effect) -> int:
        """Return the index of the place of a step."""
        return min(int(np.searchsorted(self.places, place_of(effect))), self.places.size - 1)

    def candidate(self, place: int) -> Candidate:
        """Return the step at a place, by the place's index."""
        if place not in self._candidates:
            effect = at_place(self.form, float(self.places[place]), self.data)
            self._candidates[place] = Candidate(effect, effect.terms(self.arm, self.data), self.log_prior)
        return self._candidates[place]


class Adjoints:
    """Columns multiplied by the transposed whitening, for all families of steps on the same poses."""

    def __init__(self, whitening: Whitening) -> None:
        """Store the whitening of the poses."""
        self.whitening = whitening
        self._last: tuple[Array, Array] | None = None

    def of(self, columns: Array) -> Array:
        """Return ``(M, A, N)`` of ``columns`` ``(M, A, N)``; the last result is kept."""
        if self._last is None or self._last[0] is not columns:
            adjoint = self.whitening.apply_transposed(np.moveaxis(columns, 1, 0))
            self._last = columns, np.moveaxis(adjoint, 0, 1)
        return self._last[1]


class StepFamily(Family):
    """Steps of one form at several places, on some poses; their columns are never built."""

    def __init__(
        self, system: Columns, scan: StepScan, places: NDArray[np.int64], at: NDArray[np.int64], adjoints: Adjoints
    ) -> None:
        """Store the sums over the poses ``at`` after each of ``places``; ``adjoints`` belong to those poses."""
        self.places, self.shrunk = places, False
        weights = scan.candidate(int(scan.eligible[0])).weights
        self._adjoints, self._columns = adjoints, scan.columns[:, :, at] * weights[:, None]
        number = scan.number[at]
        self._order = np.argsort(number, kind="stable")
        # A step at place k begins at number k + 1.
        self._starts = np.searchsorted(number[self._order], places + 1)
        self.gram = np.moveaxis(self._sums(_gram_increments(adjoints.whitening, self._columns, number)), 2, 0)
        adjoint = adjoints.whitening.apply_transposed(system.residual)
        self.rhs = self._sums(np.einsum("mqn,mn->qn", self._columns, adjoint)).T
        self._store_none(places.size * self._columns.shape[1])

    def _sums(self, increments: Array) -> Array:
        """Return ``(..., B)`` sums over the poses after each place of ``(..., n)``."""
        total = np.concatenate((np.zeros((*increments.shape[:-1], 1)), np.cumsum(increments[..., self._order], -1)), -1)
        result: Array = total[..., -1:] - total[..., self._starts]
        return result

    def new_products(self, columns: Array) -> Array:
        """Return ``(A, B Q)`` products of ``columns`` ``(M, A, N)`` with every column of the family."""
        sums = self._sums(np.einsum("mqn,mcn->cqn", self._columns, self._adjoints.of(columns)))
        return np.moveaxis(sums, 2, 1).reshape(len(sums), -1)


def scan_of(
    form: Effect,
    arm: Arm,
    data: Measurements,
    columns: Array,
    places: tuple[NDArray[np.int64], Array],
    usable: NDArray[np.bool_],
    log_prior: float,
) -> StepScan | None:
    """Return the scan of a form over the ``usable`` places; None if there is no such place.

    ``log_prior`` is that of a step of unknown place, which its places share.
    """
    number, before = places
    eligible = np.flatnonzero(usable)
    if eligible.size == 0:
        return None
    shared = log_prior - math.log(min(eligible.size, _MOST_PLACES))
    return StepScan(form, arm, data, columns, number, before, eligible, shared)


def usable_places(mixed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return ``(P,)`` places with enough visits on each side that lie between each other in joint space."""
    before = np.arange(1, mixed.size + 1)
    return np.asarray(mixed & (before >= FEWEST) & (mixed.size + 1 - before >= FEWEST))


def late_places(count: int) -> NDArray[np.bool_]:
    """Return ``(P,)`` which of ``count`` places leave enough visits before them to show what was not there yet.

    The baseline has the base, the target and the zeros, of which a step is a change, but no load. A load that changes
    after the first poses is the same as one that was there all the time, or as the compliance of its joints.
    """
    return np.asarray(np.arange(1, count + 1) >= _LEAST_BEFORE * (count + 1))


def places_of(scan: StepScan, at: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return eligible places of which no two divide the poses ``at`` equally, with enough visits on either side."""
    visits = np.unique(scan.number[at])
    count = np.cumsum(np.bincount(visits, minlength=scan.places.size + 1))[:-1]
    before = count[scan.eligible]
    enough = (before >= FEWEST) & (visits.size - before >= FEWEST)
    _, first = np.unique(before[enough], return_index=True)
    return scan.eligible[enough][first]


def first_places(scan: StepScan, at: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places of a first scan of the poses ``at``, evenly spread, each with enough poses on either side."""
    eligible = places_of(scan, at)
    if eligible.size <= _MOST_PLACES:
        return eligible
    return np.unique(eligible[np.linspace(0, eligible.size - 1, _MOST_PLACES).round().astype(np.int64)])


def near_places(scan: StepScan, at: NDArray[np.int64], place: int) -> NDArray[np.int64]:
    """Return all places about one of a first scan, as far as the neighbours of the scan."""
    eligible = places_of(scan, at)
    reach = -(-eligible.size // _MOST_PLACES) + 1
    middle = int(np.searchsorted(eligible, place))
    return eligible[max(middle - reach, 0) : middle + reach + 1]


def credible_interval(evidence: Array) -> tuple[int, int]:
    """Return first and last index of the 95 % interval of a step's place, from the evidence at every place."""
    weight = np.exp(evidence - evidence.max())
    order = np.argsort(-weight, kind="stable")
    count = int(np.searchsorted(np.cumsum(weight[order]) / weight.sum(), _CREDIBLE)) + 1
    return int(order[:count].min()), int(order[:count].max())


def _gram_increments(whitening: Whitening, columns: Array, number: NDArray[np.int64]) -> Array:
    """Return ``(Q, Q, n)``, of which the sum over the poses after a place is the Gram matrix of the step there.

    Within a block of correlated rows, each row adds its product with itself and twice that with all later rows.
    """
    weighted = np.moveaxis(columns, 1, 0) * whitening.weight
    # Each row alone; rows in blocks are overwritten.
    result: Array = np.einsum("qmn,pmn->qpn", weighted, weighted)
    for block in whitening.blocks:
        count, n = block.rows.shape
        components = columns.shape[0]
        precision = np.swapaxes(block.factor, 1, 2) @ block.factor
        later = number[block.rows][:, None, :] > number[block.rows][:, :, None]
        same = number[block.rows][:, None, :] == number[block.rows][:, :, None]
        share = np.tile(later + 0.5 * same, (1, components, components))
        part = np.moveaxis(weighted[:, :, block.rows], 2, 0)  # (V, Q, M, n)
        stacked = part.reshape(count, part.shape[1], components * n)
        product = (stacked @ np.swapaxes(precision * share, 1, 2)).reshape(part.shape)
        rows = np.einsum("vqmn,vpmn->qpvn", part, product)
        result[:, :, block.rows] = rows + np.swapaxes(rows, 0, 1)
    if whitening.pose_errors is not None:
        result -= _shared_increments(whitening, weighted, number)
    return result


def _shared_increments(whitening: Whitening, weighted: Array, number: NDArray[np.int64]) -> Array:
    """Return ``(Q, Q, n)`` the part of the increments that errors common to the visits of a pose explain."""
    errors = whitening.pose_errors
    assert errors is not None
    columns = whitening.multiply_by_visit(np.moveaxis(errors.columns, 1, 0).copy())
    products = np.einsum("jmn,qmn->nqj", columns, weighted)
    later = np.empty_like(products)
    for rows in blocks_of(errors.poses):
        after = number[rows][:, None, :] > number[rows][:, :, None]
        same = number[rows][:, None, :] == number[rows][:, :, None]
        part = products[rows].reshape(*rows.shape, -1)
        later[rows] = ((after + 0.5 * same) @ part).reshape(*rows.shape, *products.shape[1:])
    result = np.einsum("nqi,nij,npj->qpn", products, errors.inner(), later)
    return np.asarray(result + np.swapaxes(result, 0, 1))


def scan_for(scans: Sequence[StepScan], effect: Effect) -> StepScan | None:
    """Return the scan that an effect is a step of, or None."""
    return next((scan for scan in scans if same_form(scan.form, effect)), None)
