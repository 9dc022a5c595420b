"""Candidates on one linearisation, and the score of each beside a given model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.periodic import of_order
from robacc.geometry import Array
from robacc.tracing.candidates import Batch, Candidate, OrderGrid
from robacc.tracing.conditioned_columns import Columns, Conditioned, Family
from robacc.tracing.evidence import Scores, judge
from robacc.tracing.place_scans import PlaceFamily, PlaceScan
from robacc.tracing.ranking import Chosen, Ranked
from robacc.tracing.step_scans import (
    StepFamily,
    StepScan,
    credible_interval,
    first_places,
    places_of,
    scan_for,
)

HANDICAP = math.log(1000.0)
"""Log prior odds against a candidate whose coefficients would be implausible."""
IMPOSSIBLE = 1e9
"""Log prior odds against a candidate whose coefficients cannot be."""
_JUDGED = 12
"""Best candidates whose coefficients are judged."""
_LEAST_EVIDENCE = 2.0
"""Evidence (log Bayes factor) below which no significance test is made."""
_CACHED = 24
"""Conditioned systems in the cache: more than the findings that are tested between two steps."""

Expand = Callable[[Candidate], Array]
FamilyOfSteps = Callable[[StepScan, NDArray[np.int64]], StepFamily]


@dataclass
class CandidateScorer:
    """Scorer of all candidates on some poses, beside the columns of the present model."""

    system: Columns
    base: tuple[int, ...]
    """Columns of the declared effects."""
    pool: Sequence[Candidate]
    places: Sequence[NDArray[np.int64]]
    """Columns in the system, for each candidate of the pool."""
    order_grids: Sequence[OrderGrid]
    high_grids: Sequence[OrderGrid]
    """Orders above those that compete with every candidate."""
    joint_columns: Array
    """``(M, J, N)`` whitened columns of each joint's variable."""
    expand: Expand
    """Function that returns the whitened ``(M, Q, N)`` columns of a candidate outside the system."""
    rows: NDArray[np.int64]
    """Numbers of the poses that the candidates are scored on."""
    step_scans: Sequence[StepScan] = ()
    poses: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Numbers of the poses of the linearisation that the candidates are scored on."""
    family_of_steps: FamilyOfSteps | None = None
    """Function that returns the family of a scan's steps at several places."""
    place_scans: Sequence[PlaceScan] = ()
    """Forms of effects of the line of sight, scored only if no other candidate is significant."""
    refinements: Callable[[Effect], Sequence[Batch]] = lambda effect: ()
    """Function that returns the forms in which a search refines an effect."""
    beside: Callable[[Effect], Sequence[Batch]] = lambda effect: ()
    """Function that returns what is a candidate only beside an effect."""
    blocks: Sequence[Batch] = ()
    """Rich blocks, scored only at the caller's request."""
    _batches: list[tuple[list[int], NDArray[np.int64], Array]] = field(default_factory=list)
    _placed: dict[tuple[object, ...], NDArray[np.int64]] = field(default_factory=dict)
    _spectra: list[Family] = field(default_factory=list)
    _steps: list[tuple[StepScan, StepFamily]] = field(default_factory=list)
    _high_spectra: list[Family] = field(default_factory=list)
    _sights: list[PlaceFamily] = field(default_factory=list)
    _block_families: list[Family] = field(default_factory=list)
    _ranges: dict[str, float] = field(default_factory=dict)
    _covered: dict[tuple[tuple[object, ...], tuple[object, ...]], bool] = field(default_factory=dict)
    _conditioned: dict[tuple[Chosen, ...], Conditioned] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Sort the pool into batches of equal size, which are scored together."""
        sizes: dict[int, list[int]] = {}
        for i, columns in enumerate(self.places):
            sizes.setdefault(columns.size, []).append(i)
            self._placed[self.pool[i].key] = columns
        for members in sizes.values():
            index = np.stack([self.places[i] for i in members])
            weight = np.stack([self.pool[i].weights for i in members])
            self._batches.append((members, index, weight))
        self._ranges = {grid.joint: float(np.ptp(grid.angle)) for grid in self.order_grids if grid.angle.size}
        self._spectra = [self.spectrum(grid, grid.orders) for grid in self.order_grids]
        for scan in self.step_scans:
            places = first_places(scan, self.poses)
            if self.family_of_steps is not None and places.size:
                self._steps.append((scan, self.family_of_steps(scan, places)))

    def columns(self, candidate: Candidate) -> NDArray[np.int64]:
        """Return the numbers of a candidate's columns in the system; append the columns if they are missing."""
        key = candidate.key
        if key not in self._placed:
            self._placed[key] = self.system.append(self.expand(candidate))
        return self._placed[key]

    def as_chosen(self, candidate: Candidate, prior_var: float) -> Chosen:
        """Return a candidate as a part of the model; ``prior_var`` is the prior variance of a block."""
        precision = np.zeros(candidate.weights.size if candidate.terms else 2)
        if candidate.is_block and prior_var > 0:
            precision = 1.0 / (prior_var * np.square(candidate.weights))
        return Chosen(candidate, self.columns(candidate), precision)

    def condition(self, chosen: Sequence[Chosen], without: Chosen | None = None) -> Conditioned:
        """Return the system orthogonalised to the declared effects and to ``chosen``, except ``without``."""
        if without is not None:
            return self.condition(chosen).without(without.columns)
        key = tuple(chosen)
        result = self._conditioned.get(key)
        if result is None or result.n_columns < self.system.columns.shape[1]:
            active, precision = list(self.base), [0.0] * len(self.base)
            for finding in chosen:
                active.extend(finding.columns.tolist())
                precision.extend(finding.precision.tolist())
            result = Conditioned.on(self.system, active, np.array(precision))
            if len(self._conditioned) >= _CACHED:
                self._conditioned.pop(next(iter(self._conditioned)))
            self._conditioned[key] = result
        return result

    def rank(self, conditioned: Conditioned, present: Sequence[Chosen], with_blocks: bool = False) -> list[Ranked]:
        """Return all candidates beside ``present``, best first; of each joint's orders only the best."""
        ranked: list[Ranked] = []
        lengths = self.system.lengths
        for members, index, weight in self._batches:
            scores = judge(
                conditioned.blocks(index) * weight[:, :, None] * weight[:, None, :],
                conditioned.rhs[index] * weight,
                lengths[index] * np.square(weight),
                conditioned.cost,
                conditioned.dof,
                np.array([self.pool[i].is_block for i in members]),
            )
            ranked.extend(_ranked(self.pool[i], scores, k) for k, i in enumerate(members))
        for grid, family in zip(self.order_grids, self._spectra, strict=True):
            scores = family.judge(conditioned, best_only=True)
            best = int(np.argmax(scores.evidence))
            effect = of_order(grid.joint, float(grid.orders[best]))
            ranked.append(_ranked(Candidate(effect, (), grid.log_prior), scores, best))
        for scan, steps in self._steps:
            scores = steps.judge(conditioned, best_only=True)
            best = int(np.argmax(scores.evidence))
            ranked.append(_ranked(scan.candidate(int(steps.places[best])), scores, best))
        if with_blocks:
            ranked.extend(self._rank_blocks(conditioned))
        keys = {finding.candidate.key for finding in present}
        profiles = [finding.candidate for finding in present if finding.candidate.is_block]
        competing = [
            entry
            for entry in ranked
            if entry.candidate.key not in keys
            and not any(self.covers(profile, entry.candidate) for profile in profiles)
        ]
        # If two candidates explain exactly the same, rounding (and so the order of rows) must not choose between them.
        ordered = sorted(competing, key=lambda entry: -round(entry.total, 6))
        judged = [self._with_handicap(entry, conditioned) for entry in ordered[:_JUDGED]] + ordered[_JUDGED:]
        return sorted(judged, key=lambda entry: -round(entry.total, 6))

    def _with_handicap(self, entry: Ranked, conditioned: Conditioned) -> Ranked:
        """Return the score, lowered if the candidate's coefficients would be implausible or impossible."""
        candidate = entry.candidate
        if candidate.is_block or not candidate.terms or entry.p_value >= 1.0:
            return entry
        # Columns of a step are built when it is chosen; until then it has no coefficients to judge.
        columns = self._placed.get(candidate.key)
        if columns is None or columns.max() >= conditioned.n_columns:
            return entry
        values = conditioned.least_squares(columns)
        if candidate.effect.implausible(candidate.terms, values.tolist()) is None:
            return entry
        if candidate.effect.implausible_is_impossible:
            return replace(entry, log_prior=entry.log_prior - IMPOSSIBLE, p_value=1.0)
        return replace(
            entry,
            log_prior=entry.log_prior - HANDICAP,
            p_value=min(1.0, entry.p_value * math.exp(HANDICAP)),
        )

    def rank_high_orders(self, conditioned: Conditioned, present: Sequence[Chosen]) -> list[Ranked]:
        """Return the best high order of each joint beside ``present``, best first."""
        if len(self._high_spectra) != len(self.high_grids):
            self._high_spectra = [self.spectrum(grid, grid.orders) for grid in self.high_grids]
        keys = {finding.candidate.key for finding in present}
        ranked: list[Ranked] = []
        for grid, family in zip(self.high_grids, self._high_spectra, strict=True):
            scores = family.judge(conditioned, best_only=True)
            best = int(np.argmax(scores.evidence))
            candidate = Candidate(of_order(grid.joint, float(grid.orders[best])), (), grid.log_prior)
            if candidate.key not in keys:
                ranked.append(_ranked(candidate, scores, best))
        return sorted(ranked, key=lambda entry: -round(entry.total, 6))

    def rank_places(self, conditioned: Conditioned, present: Sequence[Chosen]) -> list[Ranked]:
        """Return the best place of each form of an effect of the line of sight beside ``present``, best first."""
        if len(self._sights) != len(self.place_scans):
            self._sights = [scan.family(self.system, self.poses, scan.places) for scan in self.place_scans]
        keys = {finding.candidate.effect.search_key() for finding in present}
        ranked: list[Ranked] = []
        for scan, family in zip(self.place_scans, self._sights, strict=True):
            if scan.form.search_key() not in keys:
                scores = family.judge(conditioned, best_only=True)
                best = int(np.argmax(scores.evidence))
                ranked.append(_ranked(scan.candidate(scan.places[best]), scores, best))
        return sorted(ranked, key=lambda entry: -round(entry.total, 6))

    def rank_beside(self, conditioned: Conditioned, present: Sequence[Chosen]) -> list[Ranked]:
        """Return what is a candidate only beside one of the findings ``present``, best first."""
        keys = {finding.candidate.effect.search_key() for finding in present}
        ranked: list[Ranked] = []
        for batch in (batch for finding in present for batch in self.beside(finding.candidate.effect)):
            scores = self.family_of(batch).judge(conditioned)
            ranked.extend(
                _ranked(candidate, scores, i)
                for i, candidate in enumerate(batch.candidates)
                if candidate.effect.search_key() not in keys
            )
        return sorted(ranked, key=lambda entry: -round(entry.total, 6))

    def order_evidence(self, conditioned: Conditioned, joint: str) -> tuple[Array, Array]:
        """Return all orders of a joint that the poses support, and the evidence of each."""
        orders, evidence = [], []
        for grid in (*self.order_grids, *self.high_grids):
            if grid.joint == joint:
                orders.append(grid.orders)
                evidence.append(self.spectrum(grid, grid.orders).judge(conditioned).evidence)
        return (np.concatenate(orders), np.concatenate(evidence)) if orders else (np.zeros(0), np.zeros(0))

    def covers(self, present: Candidate, other: Candidate) -> bool:
        """Return whether a candidate in the model makes another candidate redundant."""
        pair = present.key, other.key
        if pair not in self._covered:
            self._covered[pair] = present.covers(other, self._ranges)
        return self._covered[pair]

    def _rank_blocks(self, conditioned: Conditioned) -> list[Ranked]:
        if len(self._block_families) != len(self.blocks):
            self._block_families = [
                Family(self.system, self.joint_columns[:, batch.number], batch.basis, True) for batch in self.blocks
            ]
        ranked: list[Ranked] = []
        for batch, family in zip(self.blocks, self._block_families, strict=True):
            scores = family.judge(conditioned)
            ranked.extend(_ranked(candidate, scores, i) for i, candidate in enumerate(batch.candidates))
        return ranked

    def score(self, finding: Chosen, conditioned: Conditioned) -> Ranked:
        """Return the score of a candidate with columns in the system, beside a model without it."""
        weight = finding.candidate.weights if finding.candidate.terms else np.ones(finding.columns.size)
        scores = judge(
            (conditioned.block(finding.columns) * weight[:, None] * weight)[None],
            (conditioned.rhs[finding.columns] * weight)[None],
            (self.system.lengths[finding.columns] * np.square(weight))[None],
            conditioned.cost,
            conditioned.dof,
            np.array([finding.candidate.is_block]),
        )
        return _ranked(finding.candidate, scores, 0)

    def strongest_order(self, conditioned: Conditioned, grid: OrderGrid) -> tuple[float, float]:
        """Return the order of a joint with the largest evidence, and that evidence (log Bayes factor)."""
        scores = self._spectra[list(self.order_grids).index(grid)].judge(conditioned, best_only=True)
        best = int(np.argmax(scores.evidence))
        return float(grid.orders[best]), float(scores.evidence[best])

    def step_interval(self, conditioned: Conditioned, effect: Effect) -> tuple[float, float] | None:
        """Return the first and last place of a step that the poses support at 95 %; None if none is searched."""
        scan = scan_for(self.step_scans, effect)
        if scan is None or self.family_of_steps is None:
            return None
        places = places_of(scan, self.poses)
        if places.size == 0:
            return None
        low, high = credible_interval(self.family_of_steps(scan, places).judge(conditioned).evidence)
        return float(scan.places[places[low]]), float(scan.places[places[high]])

    def steps_in_the_middle(self) -> list[Candidate]:
        """Return each form of a step at the middle of its places."""
        return [scan.candidate(int(steps.places[steps.places.size // 2])) for scan, steps in self._steps]

    def family_of(self, batch: Batch) -> Family:
        """Return a batch of effects that are not shrunk as a family."""
        return Family(self.system, self.joint_columns[:, batch.number], batch.basis, False)

    def spectrum(self, grid: OrderGrid, orders: Array) -> Family:
        """Return cosine and sine of evenly spaced orders, each computed from the order before."""
        waves = np.empty((orders.size, grid.angle.size), dtype=np.complex128)
        waves[0] = np.exp(1j * orders[0] * grid.angle)
        waves[1:] = np.exp(1j * (orders[1] - orders[0]) * grid.angle) if orders.size > 1 else 1.0
        np.cumprod(waves, axis=0, out=waves)
        basis = np.stack((waves.real, waves.imag), axis=1)
        return Family(self.system, self.joint_columns[:, grid.number], basis, False)


def _ranked(candidate: Candidate, scores: Scores, i: int) -> Ranked:
    p_value = (
        min(1.0, scores.p_value(i) * math.exp(-candidate.log_prior)) if scores.evidence[i] > _LEAST_EVIDENCE else 1.0
    )
    return Ranked(
        candidate,
        float(scores.evidence[i]),
        candidate.log_prior,
        p_value,
        float(scores.gain[i]),
        float(scores.prior_var[i]),
    )
