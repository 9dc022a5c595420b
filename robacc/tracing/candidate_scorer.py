"""What competes on one linearisation, and how each candidate scores beside a given model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robacc.effects.periodic import of_order
from robacc.geometry import Array
from robacc.tracing.candidates import Batch, Candidate, OrderGrid
from robacc.tracing.evidence import Columns, Conditioned, Family, Scores, judge

_WORTH_A_TEST = 2.0
"""Nats below which evidence is not put to the test of significance."""
_TRIED = 17
"""Orders tried within a span."""
_KEPT = 24
"""Conditioned systems kept at hand: more than findings are put to the test between two steps."""

Expand = Callable[[Candidate], Array]


@dataclass(frozen=True, eq=False)
class Chosen:
    """A candidate in the model, with its columns' numbers in the system."""

    candidate: Candidate
    columns: NDArray[np.int64]
    precision: Array


@dataclass(frozen=True)
class Ranked:
    """A candidate's score at one step."""

    candidate: Candidate
    evidence: float
    log_prior: float
    p_value: float
    """Corrected for how many compete."""
    gain: float
    width: float

    @property
    def total(self) -> float:
        """Log posterior odds, up to a constant."""
        return self.evidence + self.log_prior


@dataclass
class CandidateScorer:
    """Everything that competes on some poses, and the model's own columns."""

    system: Columns
    base: tuple[int, ...]
    """Columns of the declared effects."""
    pool: Sequence[Candidate]
    places: Sequence[NDArray[np.int64]]
    """For each of the pool its columns in the system."""
    waves: Sequence[OrderGrid]
    joint_columns: Array
    """``(M, J, N)`` whitened columns of each joint's variable."""
    expand: Expand
    """Whitened ``(M, Q, N)`` columns of a candidate that has none in the system yet."""
    rows: NDArray[np.int64]
    """Numbers of the poses that it is judged on."""
    blocks: Sequence[Batch] = ()
    """Rich blocks, scored only where the caller asks for them."""
    _batches: list[tuple[list[int], NDArray[np.int64], Array]] = field(default_factory=list)
    _placed: dict[tuple[object, ...], NDArray[np.int64]] = field(default_factory=dict)
    _spectra: list[Family] = field(default_factory=list)
    _forms: list[Family] = field(default_factory=list)
    _ranges: dict[str, float] = field(default_factory=dict)
    _conditioned: dict[tuple[Chosen, ...], Conditioned] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Sort the pool into batches of equal size, which are judged together."""
        sizes: dict[int, list[int]] = {}
        for i, columns in enumerate(self.places):
            sizes.setdefault(columns.size, []).append(i)
            self._placed[self.pool[i].key] = columns
        for members in sizes.values():
            index = np.stack([self.places[i] for i in members])
            weight = np.stack([self.pool[i].weights for i in members])
            self._batches.append((members, index, weight))
        self._ranges = {one.joint: float(np.ptp(one.angle)) for one in self.waves if one.angle.size}
        self._spectra = [self._spectrum(one, one.orders) for one in self.waves]

    def columns(self, candidate: Candidate) -> NDArray[np.int64]:
        """A candidate's columns in the system, built where it has none yet."""
        key = candidate.key
        if key not in self._placed:
            self._placed[key] = self.system.append(self.expand(candidate))
        return self._placed[key]

    def taken(self, candidate: Candidate, width: float) -> Chosen:
        """A candidate as a part of the model; of a block ``width`` is the width of its prior."""
        precision = np.zeros(candidate.weights.size if candidate.terms else 2)
        if candidate.is_block and width > 0:
            precision = 1.0 / (width * np.square(candidate.weights))
        return Chosen(candidate, self.columns(candidate), precision)

    def condition(self, chosen: Sequence[Chosen], without: Chosen | None = None) -> Conditioned:
        """The system with the columns of the declared effects and of those chosen taken out."""
        if without is not None:
            return self.condition(chosen).without(without.columns)
        key = tuple(chosen)
        found = self._conditioned.get(key)
        if found is None or found.reduced.shape[1] < self.system.columns.shape[1]:
            active, precision = list(self.base), [0.0] * len(self.base)
            for one in chosen:
                active.extend(one.columns.tolist())
                precision.extend(one.precision.tolist())
            found = Conditioned(self.system, active, np.array(precision))
            if len(self._conditioned) >= _KEPT:
                self._conditioned.pop(next(iter(self._conditioned)))
            self._conditioned[key] = found
        return found

    def rank(self, conditioned: Conditioned, present: Sequence[Chosen], with_blocks: bool = False) -> list[Ranked]:
        """Everything that competes beside those present, best first; of a joint's orders only the best one."""
        ranked: list[Ranked] = []
        diagonal = np.diag(self.system.gram)
        for members, index, weight in self._batches:
            scores = judge(
                conditioned.blocks(index) * weight[:, :, None] * weight[:, None, :],
                conditioned.moment[index] * weight,
                diagonal[index] * np.square(weight),
                conditioned.energy,
                conditioned.freedom,
                np.array([self.pool[i].is_block for i in members]),
            )
            ranked.extend(_ranked(self.pool[i], scores, k) for k, i in enumerate(members))
        for wave, family in zip(self.waves, self._spectra, strict=True):
            scores = family.judge(conditioned, best_only=True)
            best = int(np.argmax(scores.evidence))
            effect = of_order(wave.joint, float(wave.orders[best]))
            ranked.append(_ranked(Candidate(effect, (), wave.log_prior), scores, best))
        if with_blocks:
            ranked.extend(self._rank_blocks(conditioned))
        keys = {one.candidate.key for one in present}
        profiles = [one.candidate for one in present if one.candidate.is_block]
        open_to = [
            one
            for one in ranked
            if one.candidate.key not in keys and not any(self.holds(profile, one.candidate) for profile in profiles)
        ]
        # Where two explain exactly the same, rounding (and so the order of rows) must not choose between them.
        return sorted(open_to, key=lambda one: -round(one.total, 6))

    def holds(self, present: Candidate, other: Candidate) -> bool:
        """Whether a candidate in the model leaves nothing to another one."""
        return present.holds(other, self._ranges)

    def _rank_blocks(self, conditioned: Conditioned) -> list[Ranked]:
        if len(self._forms) != len(self.blocks):
            self._forms = [
                Family(self.system, self.joint_columns[:, batch.number], batch.basis, True) for batch in self.blocks
            ]
        ranked: list[Ranked] = []
        for batch, family in zip(self.blocks, self._forms, strict=True):
            scores = family.judge(conditioned)
            ranked.extend(_ranked(one, scores, i) for i, one in enumerate(batch.candidates))
        return ranked

    def own(self, one: Chosen, conditioned: Conditioned) -> Ranked:
        """Score of a candidate whose columns stand in the system, beside a model without it."""
        weight = one.candidate.weights if one.candidate.terms else np.ones(one.columns.size)
        scores = judge(
            (conditioned.block(one.columns) * weight[:, None] * weight)[None],
            (conditioned.moment[one.columns] * weight)[None],
            (np.diag(self.system.gram)[one.columns] * np.square(weight))[None],
            conditioned.energy,
            conditioned.freedom,
            np.array([one.candidate.is_block]),
        )
        return _ranked(one.candidate, scores, 0)

    def strongest_order(self, conditioned: Conditioned, wave: OrderGrid) -> tuple[float, float]:
        """The order of one joint's waves that explains most, and its evidence in nats."""
        scores = self._spectra[list(self.waves).index(wave)].judge(conditioned, best_only=True)
        best = int(np.argmax(scores.evidence))
        return float(wave.orders[best]), float(scores.evidence[best])

    def best_order(self, conditioned: Conditioned, wave: OrderGrid, order: float, span: float) -> float:
        """The order of one joint within ``span`` of ``order`` that explains most."""
        orders = order + np.linspace(-span, span, _TRIED)
        scores = self._spectrum(wave, orders).judge(conditioned, best_only=True)
        return float(orders[int(np.argmax(scores.evidence))])

    def _spectrum(self, wave: OrderGrid, orders: Array) -> Family:
        """Cosine and sine of evenly spaced orders, each from the one before."""
        turned = np.empty((orders.size, wave.angle.size), dtype=np.complex128)
        turned[0] = np.exp(1j * orders[0] * wave.angle)
        turned[1:] = np.exp(1j * (orders[1] - orders[0]) * wave.angle) if orders.size > 1 else 1.0
        np.cumprod(turned, axis=0, out=turned)
        basis = np.stack((turned.real, turned.imag), axis=1)
        return Family(self.system, self.joint_columns[:, wave.number], basis, False)

    def similarity(self, chosen: Sequence[Chosen], one: Chosen, rival: Candidate) -> float:
        """Cosine between what one of the chosen and a rival take out of the residual, all others kept."""
        columns = self.columns(rival)
        conditioned = self.condition(chosen, without=one)
        both = [conditioned.least_squares(one.columns), conditioned.least_squares(columns)]
        cross = self.system.gram[np.ix_(one.columns, columns)]
        cross = cross - conditioned.reduced[:, one.columns].T @ conditioned.reduced[:, columns]
        lengths = [
            float(weight @ conditioned.block(place) @ weight)
            for weight, place in zip(both, (one.columns, columns), strict=True)
        ]
        if min(lengths) <= 0:
            return 0.0
        cosine = float(both[0] @ cross @ both[1] / math.sqrt(lengths[0] * lengths[1]))
        return min(max(cosine, -1.0), 1.0)


def _ranked(candidate: Candidate, scores: Scores, i: int) -> Ranked:
    p_value = (
        min(1.0, scores.p_value(i) * math.exp(-candidate.log_prior)) if scores.evidence[i] > _WORTH_A_TEST else 1.0
    )
    return Ranked(
        candidate,
        float(scores.evidence[i]),
        candidate.log_prior,
        p_value,
        float(scores.gain[i]),
        float(scores.width[i]),
    )
