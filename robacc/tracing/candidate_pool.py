"""All candidates on the poses of a search, made once for every linearisation of models with the same declared effects.

Candidates depend on the arm, the poses and the declared effects, not on a fit's coefficients.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Term
from robacc.effects.change_points import CHANGE_POINT, mixed_places, places, step_forms
from robacc.fitting.visits import visit_numbers
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.tracing.candidates import (
    TYPICAL_CANDIDATES,
    Batch,
    Candidate,
    batches,
    corrections,
    named_candidates,
    profiles,
)
from robacc.tracing.step_scans import usable_places

SELECTION_POSES = 800
"""Largest number of poses that a selection uses; fits and figures use all poses."""
_LINEARISED_POSES = 4 * SELECTION_POSES
"""Largest number of poses that columns are made for: a fold's selection, which lacks some, still has enough."""


@dataclass(frozen=True, eq=False)
class CandidatePool:
    """Candidates given the declared effects of an arm, on n of N poses: all, or :data:`_LINEARISED_POSES` of them."""

    arm: Arm
    data: Measurements
    """Measurements of those poses."""
    rows: NDArray[np.int64]
    """``(n,)`` their row numbers in the complete data."""
    declared: tuple[Effect, ...]
    only: tuple[str, ...] | None
    """Names of the effects that are candidates; None for all."""
    candidates: tuple[Candidate, ...]
    """Named candidates."""
    missing: dict[str, str]
    """Reason why an effect is no candidate, by effect."""
    _refined_forms: dict[tuple[object, ...], list[Candidate]] = dataclasses.field(default_factory=dict)
    """Forms of the effects that any selection has refined, by their keys."""
    _forms_beside: dict[tuple[object, ...], list[Candidate]] = dataclasses.field(default_factory=dict)
    """Candidates that need an effect that any selection has found, by the keys of these effects."""

    @classmethod
    def of(
        cls,
        arm: Arm,
        data: Measurements,
        rows: NDArray[np.int64],
        declared: Sequence[Effect],
        only: Sequence[str] | None = None,
    ) -> CandidatePool:
        """Return the candidates of an arm on the poses ``data``, of which ``rows`` are the row numbers."""
        named, missing = named_candidates(arm, data, declared, only)
        return cls(arm, data, rows, tuple(declared), None if only is None else tuple(only), tuple(named), missing)

    @cached_property
    def declared_count(self) -> int:
        """Number of the declared effects' coefficients."""
        return sum(len(effect.terms(self.arm, self.data)) for effect in self.declared)

    @cached_property
    def terms(self) -> dict[str, Term]:
        """Terms of the candidates by their keys; those that several forms share occur once."""
        unique: dict[str, Term] = {}
        for candidate in self.candidates:
            for term in candidate.terms:
                unique.setdefault(candidate.effect.term_key(term), term)
        return unique

    @cached_property
    def term_numbers(self) -> tuple[NDArray[np.int64], ...]:
        """Numbers of each candidate's terms among :attr:`terms`."""
        number = {key: i for i, key in enumerate(self.terms)}
        return tuple(
            np.array([number[candidate.effect.term_key(term)] for term in candidate.terms])
            for candidate in self.candidates
        )

    @cached_property
    def step_forms(self) -> dict[Effect, tuple[Term, ...]]:
        """Forms of a step with their terms; none if steps are not among :attr:`only`."""
        if self.only is not None and CHANGE_POINT not in self.only:
            return {}
        return {form: form.terms(self.arm, self.data) for form in step_forms(self.arm, self.data)}

    @cached_property
    def step_places(self) -> tuple[NDArray[np.int64], Array]:
        """Number ``(n,)`` of each pose in the sequence, and the places of a step between them."""
        return places(self.data, visit_numbers(self.data))

    @cached_property
    def usable_step_places(self) -> NDArray[np.bool_]:
        """Whether a search may use each place of a step."""
        return usable_places(mixed_places(self.data, self.step_places[0]))

    @cached_property
    def blocks(self) -> list[Candidate]:
        """Rich blocks: periodic profiles and empirical corrections."""
        return [*profiles(self.arm, self.data, self.only), *corrections(self.arm, self.data, self.only)]

    @cached_property
    def _block_batches(self) -> list[Batch]:
        return batches(self.arm, self.blocks, np.arange(self.data.n))

    def block_batches(self, at: NDArray[np.int64]) -> list[Batch]:
        """Return the rich blocks on the poses ``at``."""
        return [dataclasses.replace(batch, basis=batch.basis[:, :, at]) for batch in self._block_batches]

    def refinements(self, effect: Effect, at: NDArray[np.int64]) -> list[Batch]:
        """Return the forms in which a search refines an effect, on the poses ``at``."""
        key = effect.key()
        if key not in self._refined_forms:
            self._refined_forms[key] = self._candidates_of(effect.refinements(self.arm, self.data))
        return batches(self.arm, self._refined_forms[key], at)

    def beside(self, effect: Effect, at: NDArray[np.int64]) -> list[Batch]:
        """Return the candidates that need an effect, on the poses ``at``."""
        key = effect.key()
        if key not in self._forms_beside:
            classes = [cls for name, cls in REGISTRY.items() if self.only is None or name in self.only]
            forms = [form for cls in classes for form in cls.beside(effect, self.arm, self.data)]
            self._forms_beside[key] = self._candidates_of(forms)
        return batches(self.arm, self._forms_beside[key], at)

    def _candidates_of(self, effects: Iterable[Effect]) -> list[Candidate]:
        return [Candidate(form, form.terms(self.arm, self.data), log_prior_beside(form)) for form in effects]


class CandidatePools:
    """Pools of candidates on the same measurements, one for each arm and its declared effects."""

    def __init__(self, data: Measurements, only: Sequence[str] | None = None) -> None:
        """Store the measurements and the names of the effects that are candidates; None for all."""
        self._rows = thinned(data, np.arange(data.n), _LINEARISED_POSES)
        self._data, self._only = data.subset(self._rows), only
        self._pools: list[CandidatePool] = []

    def of(self, arm: Arm, declared: Sequence[Effect]) -> CandidatePool:
        """Return the pool of an arm given its declared effects."""
        effects = tuple(declared)
        for pool in self._pools:
            if pool.arm is arm and pool.declared == effects:
                return pool
        self._pools.append(CandidatePool.of(arm, self._data, self._rows, effects, self._only))
        return self._pools[-1]


def log_prior_beside(effect: Effect) -> float:
    """Return the log prior of an effect that is a candidate only if there is a certain finding."""
    return math.log(effect.odds_beside / TYPICAL_CANDIDATES)


def thinned(data: Measurements, at: NDArray[np.int64], max_poses: int) -> NDArray[np.int64]:
    """Return the rows ``at``, or ``max_poses`` of them, sampled by commanded pose and not by place in the file."""
    if at.size <= max_poses:
        return at
    groups = data.groups()[at]
    draw = np.random.default_rng(0).permutation(int(groups.max()) + 1)[groups]
    return np.sort(at[np.argsort(draw, kind="stable")[:max_poses]])
