"""Candidates on one linearisation, and the score of each given a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.periodic import of_order, orders_of
from robacc.geometry import Array
from robacc.tracing.candidates import Batch, Candidate, EffectName, OrderGrid
from robacc.tracing.conditioned_columns import Conditioned, Family
from robacc.tracing.evidence import judge
from robacc.tracing.form_families import BatchFamily, FormFamilies
from robacc.tracing.place_scans import PlaceScan
from robacc.tracing.pool_batches import PoolBatch, pool_batches
from robacc.tracing.ranking import Chosen, Ranked, sorted_by_odds
from robacc.tracing.redundancy import Redundancy
from robacc.tracing.searched_forms import SearchedForm, SearchedForms
from robacc.tracing.step_scans import (
    StepFamily,
    StepScan,
    credible_interval,
    first_places,
    places_of,
    scan_for,
)
from robacc.tracing.whitened_columns import Columns

HANDICAP = math.log(1000.0)
"""Log prior odds against a candidate whose coefficients would be implausible."""
IMPOSSIBLE = 1e9
"""Log prior odds against a candidate whose coefficients cannot be."""
_JUDGED = 12
"""Best candidates whose coefficients are judged."""
_CACHED = 24
"""Conditioned systems in the cache: more than the findings that are tested between two steps."""

Expand = Callable[[Candidate], Array]


@dataclass
class CandidateScorer:
    """Scorer of all candidates on some poses, given the columns of the present model."""

    system: Columns
    base: tuple[int, ...]
    """Columns of the declared effects."""
    base_precision: Array
    """Prior precision of their coefficients, whitened; zero for none."""
    pool: Sequence[Candidate]
    places: Sequence[NDArray[np.int64]]
    """Columns in the system, for each candidate of the pool."""
    order_grids: Sequence[OrderGrid]
    high_grids: Sequence[OrderGrid]
    """Orders above those that compete with every candidate."""
    families: FormFamilies
    """Families of forms on these poses."""
    expand: Expand
    """Function that returns the whitened ``(M, Q, N)`` columns of a candidate outside the system."""
    rows: NDArray[np.int64]
    """Numbers of the poses that the candidates are scored on."""
    step_scans: Sequence[StepScan] = ()
    poses: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Numbers of the poses of the linearisation that the candidates are scored on."""
    place_scans: Sequence[PlaceScan] = ()
    """Forms of effects of the line of sight, scored only if no other candidate is significant."""
    blocks: Sequence[Batch] = ()
    """Rich blocks, scored only at the caller's request."""
    _batches: list[PoolBatch] = field(default_factory=list)
    _placed: dict[tuple[object, ...], NDArray[np.int64]] = field(default_factory=dict)
    _spectra: list[Family] = field(default_factory=list)
    _steps: list[tuple[StepScan, StepFamily]] = field(default_factory=list)
    _searched: SearchedForms = field(default_factory=lambda: SearchedForms(()))
    _high_orders: SearchedForms | None = None
    _sights: SearchedForms | None = None
    _block_families: list[BatchFamily] = field(default_factory=list)
    redundancy: Redundancy = field(init=False)
    """Candidates that findings make redundant."""
    _conditioned: dict[tuple[Chosen, ...], Conditioned] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Sort the pool into batches of like size, which are scored together."""
        self._placed = {candidate.key: columns for candidate, columns in zip(self.pool, self.places, strict=True)}
        self._batches = pool_batches(self.pool, self.places, range(len(self.pool)))
        ranges = {grid.joint: float(np.ptp(grid.angle)) for grid in self.order_grids if grid.angle.size}
        self.redundancy = Redundancy(self.pool, ranges)
        orders = [self._orders(grid) for grid in self.order_grids]
        self._spectra = [form.family for form in orders]
        for scan in self.step_scans:
            places = first_places(scan, self.poses)
            if places.size:
                self._steps.append((scan, self.families.steps(scan, places)))
        self._searched = SearchedForms([*orders, *(_steps_of(scan, family) for scan, family in self._steps)])

    def columns(self, candidate: Candidate) -> NDArray[np.int64]:
        """Return the numbers of a candidate's columns in the system; append the columns if they are missing."""
        key = candidate.key
        if key not in self._placed:
            self._placed[key] = self.system.append(self.expand(candidate))
        return self._placed[key]

    def as_chosen(self, candidate: Candidate, prior_var: float) -> Chosen:
        """Return a candidate as a part of the model; ``prior_var`` is the prior variance of a block."""
        return Chosen(candidate, self.columns(candidate), self._precision(candidate, prior_var))

    @staticmethod
    def _precision(candidate: Candidate, prior_var: float) -> Array:
        """Return the prior precision of a candidate's coefficients; zero but for a block."""
        if candidate.is_block and prior_var > 0:
            return np.asarray(1.0 / (prior_var * np.square(candidate.weights)))
        return np.zeros(candidate.weights.size if candidate.terms else 2)

    def condition(self, chosen: Sequence[Chosen], without: Chosen | None = None) -> Conditioned:
        """Return the system orthogonalised to the declared effects and to ``chosen``, except ``without``."""
        if without is not None:
            complete = self.condition(chosen)
            if not complete.is_independent:
                return self.condition([finding for finding in chosen if finding is not without])
            sizes = [finding.columns.size for finding in chosen]
            first = len(self.base) + sum(sizes[: list(chosen).index(without)])
            return complete.without(slice(first, first + without.columns.size))
        key = tuple(chosen)
        result = self._conditioned.pop(key, None)
        if result is None:
            if chosen:
                result = self.condition(chosen[:-1]).extended(chosen[-1].columns, chosen[-1].precision)
            else:
                result = Conditioned.on(self.system, self.base, self.base_precision)
        # The one used longest ago is forgotten first.
        self._conditioned[key] = result
        if len(self._conditioned) > _CACHED:
            self._conditioned.pop(next(iter(self._conditioned)))
        return result

    def rank(
        self,
        conditioned: Conditioned,
        present: Sequence[Chosen],
        with_blocks: bool = False,
        among: Collection[EffectName] | None = None,
    ) -> list[Ranked]:
        """Return all candidates given ``present``, or those of the effects ``among``, best first.

        Of each joint's orders only the best competes.
        """
        keys = {finding.candidate.key for finding in present}
        profiles = [finding.candidate for finding in present if finding.candidate.is_block]
        orders = _single_orders(present)
        absent = keys.union(*(self.redundancy.keys_covered_by(candidate) for candidate in (*profiles, *orders)))
        ranked: list[Ranked] = []
        for batch in self._batches if among is None else self._batches_among(among):
            scores = batch.judge(conditioned)
            ranked.extend(Ranked(self.pool[i], scores, k) for k, i in enumerate(batch.members))
        others = self._searched.best(
            conditioned,
            lambda candidate: self.redundancy.is_covered(candidate, orders),
            lambda form: (
                any(self.redundancy.covers_form(profile, form) for profile in profiles)
                or (among is not None and form.effect_name not in among)
            ),
        )
        if with_blocks:
            others += self._rank_blocks(
                conditioned, lambda block: block.key in keys or self.redundancy.is_covered(block, profiles)
            )
        competing = [entry for entry in ranked if entry.candidate.key not in absent]
        competing.extend(
            entry
            for entry in others
            if entry.candidate.key not in keys and not self.redundancy.is_covered(entry.candidate, profiles)
        )
        ordered = sorted_by_odds(competing)
        judged = [self._with_handicap(entry, conditioned) for entry in ordered[:_JUDGED]]
        return sorted_by_odds(judged + ordered[_JUDGED:]) if any(entry.handicap for entry in judged) else ordered

    def _batches_among(self, among: Collection[EffectName]) -> list[PoolBatch]:
        """Return the pool's candidates of some effects in batches."""
        members = [i for i, candidate in enumerate(self.pool) if candidate.effect_name in among]
        return pool_batches(self.pool, self.places, members)

    def _with_handicap(self, entry: Ranked, conditioned: Conditioned) -> Ranked:
        """Return the score, lowered if the candidate's coefficients would be implausible or impossible."""
        candidate = entry.candidate
        # Coefficients of profiles and corrections have no usual size of their own.
        is_judged = any(term.group is None for term in candidate.terms)
        if not is_judged or not entry.is_tested:
            return entry
        # Columns of a step are built when it is chosen; until then it has no coefficients to judge.
        columns = self._placed.get(candidate.key)
        if columns is None:
            return entry
        values = conditioned.least_squares(columns, self._precision(candidate, entry.prior_var))
        if candidate.effect.implausible(candidate.terms, values.tolist()) is None:
            return entry
        return replace(entry, handicap=IMPOSSIBLE if candidate.effect.rejects_implausible else HANDICAP)

    def rank_high_orders(self, conditioned: Conditioned, present: Sequence[Chosen]) -> list[Ranked]:
        """Return the best high order of each joint given ``present``, best first."""
        if self._high_orders is None:
            self._high_orders = SearchedForms([self._orders(grid) for grid in self.high_grids])
        orders = _single_orders(present)
        return sorted_by_odds(
            self._high_orders.best(conditioned, lambda candidate: self.redundancy.is_covered(candidate, orders))
        )

    def rank_places(self, conditioned: Conditioned, present: Sequence[Chosen]) -> list[Ranked]:
        """Return the best place of each form of an effect of the line of sight given ``present``, best first."""
        if self._sights is None:
            self._sights = SearchedForms([self._places_of(scan) for scan in self.place_scans])
        keys = {finding.candidate.effect.search_key() for finding in present}
        best = self._sights.best(conditioned)
        return sorted_by_odds(r for r in best if r.candidate.effect.search_key() not in keys)

    def rank_beside(self, conditioned: Conditioned, present: Sequence[Chosen]) -> list[Ranked]:
        """Return the candidates that need one of the findings ``present``, best first."""
        keys = {finding.candidate.effect.search_key() for finding in present}
        ranked: list[Ranked] = []
        for batch, family in (pair for finding in present for pair in self.families.beside(finding.candidate.effect)):
            scores = family.judge(conditioned)
            ranked.extend(
                Ranked(candidate, scores, i)
                for i, candidate in enumerate(batch.candidates)
                if candidate.effect.search_key() not in keys
            )
        return sorted_by_odds(ranked)

    def order_evidence(self, conditioned: Conditioned, joint: str) -> tuple[Array, Array]:
        """Return all orders of a joint that the poses support, and the evidence of each."""
        orders, evidence = [], []
        for grid in (*self.order_grids, *self.high_grids):
            if grid.joint == joint:
                orders.append(grid.orders)
                evidence.append(self.families.orders(grid, grid.orders).judge(conditioned).evidence)
        return (np.concatenate(orders), np.concatenate(evidence)) if orders else (np.zeros(0), np.zeros(0))

    def _rank_blocks(self, conditioned: Conditioned, is_absent: Callable[[Candidate], bool]) -> list[Ranked]:
        """Return the rich blocks beside a model, without those that are absent if all of a family are."""
        if len(self._block_families) != len(self.blocks):
            self._block_families = self.families.of(self.blocks, shrunk=True)
        ranked: list[Ranked] = []
        for batch, family in self._block_families:
            if all(is_absent(candidate) for candidate in batch.candidates):
                continue
            scores = family.judge(conditioned)
            ranked.extend(Ranked(candidate, scores, i) for i, candidate in enumerate(batch.candidates))
        return ranked

    def score(self, finding: Chosen, conditioned: Conditioned) -> Ranked:
        """Return the score of a candidate with columns in the system, given a model without it."""
        weight = finding.candidate.weights if finding.candidate.terms else np.ones(finding.columns.size)
        scores = judge(
            (conditioned.block(finding.columns) * weight[:, None] * weight)[None],
            (conditioned.rhs[finding.columns] * weight)[None],
            (self.system.lengths[finding.columns] * np.square(weight))[None],
            conditioned.cost,
            conditioned.dof,
            np.array([finding.candidate.is_block]),
        )
        return self._with_handicap(Ranked(finding.candidate, scores, 0), conditioned)

    def strongest_order(self, conditioned: Conditioned, grid: OrderGrid) -> tuple[float, float]:
        """Return the order of a joint with the largest evidence, and that evidence (log Bayes factor)."""
        best, scores = self._spectra[list(self.order_grids).index(grid)].best(conditioned)
        return float(grid.orders[best]), float(scores.evidence[best])

    def step_interval(self, conditioned: Conditioned, effect: Effect) -> tuple[float, float] | None:
        """Return the first and last place of a step that the poses support at 95 %; None if none is searched."""
        scan = scan_for(self.step_scans, effect)
        if scan is None:
            return None
        places = places_of(scan, self.poses)
        if places.size == 0:
            return None
        low, high = credible_interval(self.families.steps(scan, places).judge(conditioned).evidence)
        return float(scan.places[places[low]]), float(scan.places[places[high]])

    def steps_in_the_middle(self) -> list[Candidate]:
        """Return each form of a step at the middle of its places."""
        return [scan.candidate(int(steps.places[steps.places.size // 2])) for scan, steps in self._steps]

    def _orders(self, grid: OrderGrid) -> SearchedForm:
        """Return the orders of a grid."""

        def candidate(i: int) -> Candidate:
            return Candidate(of_order(grid.joint, float(grid.orders[i])), (), grid.log_prior)

        return SearchedForm(self.families.orders(grid, grid.orders), candidate)

    def _places_of(self, scan: PlaceScan) -> SearchedForm:
        """Return the places of an effect of the line of sight."""
        family = scan.family(self.system, self.poses, scan.places)
        return SearchedForm(family, lambda i: scan.candidate(scan.places[i]))


def _steps_of(scan: StepScan, steps: StepFamily) -> SearchedForm:
    """Return the places of a step."""
    return SearchedForm(steps, lambda i: scan.candidate(int(steps.places[i])))


def _single_orders(present: Sequence[Chosen]) -> list[Candidate]:
    """Return the periodic errors of one order among the findings."""
    candidates = (finding.candidate for finding in present)
    return [candidate for candidate in candidates if len(orders_of(candidate.effect)) == 1]
