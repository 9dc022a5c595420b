"""Choosing among candidates on one linearisation: forward, with every finding put to the test again after each step."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robacc.effects.transmission_error import TransmissionError
from robacc.geometry import Array
from robacc.registration import ALIGNABLE
from robacc.tracing.candidates import Batch, Candidate, Waves
from robacc.tracing.evidence import Columns, Conditioned, Scores, judge

FALSE_ALARM = 0.002
"""Bound over all candidates together that anything at all is named on a clean arm. The promise is one in a hundred;
orders and forms are searched more finely than they are counted: of 200 simulated clean arms four had something named at
0.005, each with a corrected p-value between 0.001 and 0.005."""
RIVAL = 5.0
"""A rival within this many nats of the finding's own evidence (odds of 150 to 1) is named as an alternative."""
_SWAP = 1.0
"""A rival takes a finding's place where it is better by more than this: equals do not change places for ever."""
_MOST = 12
_FEW_ENOUGH = 6
"""More findings than this are a sign of something without a name; testing each again would not mend that."""
_SWEEPS = 4

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
class Step:
    """What one step saw and did, for the record."""

    action: str
    chosen: str | None
    ranking: list[Ranked]


@dataclass
class Selection:
    """The state of one choice."""

    system: Columns
    base: tuple[int, ...]
    pool: Sequence[Candidate]
    places: Sequence[NDArray[np.int64]]
    """For each of the pool its columns in the system."""
    waves: Sequence[Waves]
    joint_columns: Array
    """``(M, J, N)`` whitened columns of each joint's variable."""
    expand: Expand
    """Whitened ``(M, Q, N)`` columns of a candidate that has none in the system yet."""
    blocks: Sequence[Batch] = ()
    """Rich blocks, scored only where the caller asks for them."""
    chosen: list[Chosen] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    _batches: list[tuple[list[int], NDArray[np.int64], Array]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Sort the pool into batches of equal size, which are judged together."""
        sizes: dict[int, list[int]] = {}
        for i, columns in enumerate(self.places):
            sizes.setdefault(columns.size, []).append(i)
        for members in sizes.values():
            index = np.stack([self.places[i] for i in members])
            weight = np.stack([self.pool[i].weights for i in members])
            self._batches.append((members, index, weight))

    # -- scoring

    def condition(self, without: Chosen | None = None) -> Conditioned:
        """The system with the present model's columns taken out."""
        active, precision = list(self.base), [0.0] * len(self.base)
        for one in self.chosen:
            if one is not without:
                active.extend(one.columns.tolist())
                precision.extend(one.precision.tolist())
        return Conditioned(self.system, active, np.array(precision))

    def rank(self, conditioned: Conditioned, with_blocks: bool = False) -> list[Ranked]:
        """Everything that competes, best first; the best order of each joint's waves, not every one."""
        ranked: list[Ranked] = []
        full = conditioned.full()
        diagonal = np.diag(self.system.gram)
        for members, index, weight in self._batches:
            blocks = full[index[:, :, None], index[:, None, :]] * weight[:, :, None] * weight[:, None, :]
            moments = conditioned.moment[index] * weight
            shrunk = np.array([self.pool[i].is_block for i in members])
            lengths = diagonal[index] * np.square(weight)
            scores = judge(blocks, moments, lengths, conditioned.energy, conditioned.freedom, shrunk)
            ranked.extend(_ranked(self.pool[i], scores, k) for k, i in enumerate(members))
        ranked.extend(self._rank_waves(conditioned))
        if with_blocks:
            ranked.extend(self._rank_blocks(conditioned))
        present = {one.candidate.effect.key() for one in self.chosen}
        ranked = [one for one in ranked if one.candidate.effect.key() not in present]
        return sorted(ranked, key=lambda one: -one.total)

    def _rank_waves(self, conditioned: Conditioned) -> list[Ranked]:
        result = []
        residual = self._residual(conditioned)
        for one in self.waves:
            scores = self._judge_waves(conditioned, one, residual)
            best = int(np.argmax(scores.evidence))
            effect = TransmissionError((one.joint,), (float(one.orders[best]),))
            result.append(_ranked(Candidate(effect, (), one.log_prior), scores, best))
        return result

    def best_order(self, one: Chosen, wave: Waves, order: float, span: float) -> float:
        """The order within ``span`` of ``order`` that explains most, all other findings kept."""
        conditioned = self.condition(without=one)
        orders = order + np.linspace(-span, span, 17)
        phase = orders[:, None] * wave.angle
        fine = dataclasses.replace(wave, orders=orders, basis=np.concatenate((np.cos(phase), np.sin(phase))))
        scores = self._judge_waves(conditioned, fine, self._residual(conditioned))
        return float(orders[int(np.argmax(scores.evidence))])

    def _judge_waves(self, conditioned: Conditioned, one: Waves, residual: Array) -> Scores:
        """Scores of every order of one joint; sums over components come first, so no column is ever built."""
        column = self.joint_columns[:, one.number]
        collapsed = np.einsum("mcn,mn->cn", self.system.columns[:, conditioned.active], column)
        reduced = (conditioned.root.T @ collapsed) @ one.basis.T
        square = np.einsum("mn,mn->n", column, column)
        count = one.orders.size
        cosine, sine = one.basis[:count], one.basis[count:]
        blocks = np.empty((count, 2, 2))
        blocks[:, 0, 0] = np.square(cosine) @ square
        blocks[:, 1, 1] = np.square(sine) @ square
        blocks[:, 0, 1] = blocks[:, 1, 0] = (cosine * sine) @ square
        lengths = np.stack((blocks[:, 0, 0], blocks[:, 1, 1]), axis=1)
        pairs = np.stack((reduced[:, :count], reduced[:, count:]), axis=2)
        blocks = blocks - np.einsum("rki,rkj->kij", pairs, pairs)
        moment = one.basis @ np.einsum("mn,mn->n", column, residual)
        moments = np.stack((moment[:count], moment[count:]), axis=1)
        shrunk = np.zeros(count, dtype=bool)
        return judge(blocks, moments, lengths, conditioned.energy, conditioned.freedom, shrunk)

    def _residual(self, conditioned: Conditioned) -> Array:
        """``(M, N)`` residual with the model's columns taken out."""
        weight = conditioned.root @ conditioned.explained
        result: Array = self.system.residual - np.einsum(
            "mcn,c->mn", self.system.columns[:, conditioned.active], weight
        )
        return result

    def _rank_blocks(self, conditioned: Conditioned) -> list[Ranked]:
        result: list[Ranked] = []
        residual = self._residual(conditioned)
        for batch in self.blocks:
            column = self.joint_columns[:, batch.number]
            collapsed = np.einsum("mcn,mn->cn", self.system.columns[:, conditioned.active], column)
            square = np.einsum("mn,mn->n", column, column)
            count, size, n = batch.basis.shape
            reduced = ((conditioned.root.T @ collapsed) @ batch.basis.reshape(-1, n).T).reshape(-1, count, size)
            whole = np.matmul(batch.basis * square, np.swapaxes(batch.basis, 1, 2))
            blocks = whole - np.einsum("rbi,rbj->bij", reduced, reduced)
            moments = batch.basis @ np.einsum("mn,mn->n", column, residual)
            lengths = np.diagonal(whole, axis1=1, axis2=2)
            shrunk = np.ones(count, dtype=bool)
            scores = judge(blocks, moments, lengths, conditioned.energy, conditioned.freedom, shrunk)
            result.extend(_ranked(one, scores, i) for i, one in enumerate(batch.candidates))
        return result

    # -- choosing

    def start_with(self, candidate: Candidate) -> None:
        """Take a candidate into the model without contest; it is put to the test by what follows."""
        one = Chosen(candidate, self._columns(candidate), np.zeros(max(len(candidate.terms), 1)))
        own = self._own(one, self.condition())
        self.chosen.append(Chosen(candidate, one.columns, self._precision(own)))

    def add(self, ranked: Ranked) -> Chosen:
        """Take a candidate into the model."""
        one = Chosen(ranked.candidate, self._columns(ranked.candidate), self._precision(ranked))
        self.chosen.append(one)
        return one

    def _columns(self, candidate: Candidate) -> NDArray[np.int64]:
        for i, other in enumerate(self.pool):
            if other is candidate:
                return self.places[i]
        return self.system.append(self.expand(candidate))

    def _precision(self, ranked: Ranked) -> Array:
        weights = ranked.candidate.weights if ranked.candidate.terms else np.ones(2)
        if not ranked.candidate.is_block or ranked.width <= 0:
            return np.zeros(weights.size)
        result: Array = 1.0 / (ranked.width * np.square(weights))
        return result

    def run(self, with_blocks: bool = False, most: int = _MOST) -> None:
        """Forward until nothing is significant, each time putting every earlier finding to the test again."""
        if self.chosen:
            self._revise()
        self._forward(with_blocks, most)
        if not with_blocks and len(self.chosen) <= _FEW_ENOUGH:
            self._rebuild(most)

    def _forward(self, with_blocks: bool, most: int, without: tuple[object, ...] | None = None) -> None:
        seen: set[frozenset[tuple[object, ...]]] = set()
        while len(self.chosen) < most:
            # A set of findings that comes back would come back for ever.
            present = frozenset(one.candidate.effect.key() for one in self.chosen)
            if present in seen:
                return
            seen.add(present)
            ranking = self.rank(self.condition(), with_blocks)
            if without is not None:
                ranking = [one for one in ranking if one.candidate.effect.key() != without]
            best = ranking[0] if ranking else None
            if best is None or best.p_value > FALSE_ALARM:
                self.steps.append(Step("stop", None, ranking))
                return
            self.add(best)
            self.steps.append(Step("add", str(best.candidate.effect), ranking))
            self._revise(without)

    def _rebuild(self, most: int) -> None:
        """Forbid each finding in turn and choose again: what greed took first may have stood in for two others."""
        for one in sorted(self.chosen, key=lambda item: -item.columns.size):
            if one not in self.chosen or one.candidate.effect.name in ALIGNABLE:
                continue
            before, total, steps = list(self.chosen), self.total(), list(self.steps)
            self.chosen = [other for other in before if other is not one]
            self._forward(False, most, one.candidate.effect.key())
            if self.total() > total + _SWAP:
                steps.append(Step("rebuild", f"without {one.candidate.effect}", []))
                self.steps = steps
            else:
                self.chosen, self.steps = before, steps

    def _revise(self, without: tuple[object, ...] | None = None) -> None:
        """Drop what is no longer needed, and give a finding's place to a rival that does better in it."""
        if len(self.chosen) > _FEW_ENOUGH:
            return
        for _ in range(_SWEEPS):
            if not any([self._revise_one(one, without) for one in list(self.chosen)]):
                return

    def _revise_one(self, one: Chosen, without: tuple[object, ...] | None) -> bool:
        if one not in self.chosen or len(self.chosen) < 2:
            return False
        own, ranking = self.contest(one)
        if own.p_value > FALSE_ALARM:
            self.chosen.remove(one)
            self.steps.append(Step("drop", str(one.candidate.effect), ranking[:10]))
            return True
        ranking = [rival for rival in ranking if rival.candidate.effect.key() != without]
        best = ranking[0] if ranking else own
        if best.total > own.total + _SWAP:
            at = self.chosen.index(one)
            new = Chosen(best.candidate, self._columns(best.candidate), self._precision(best))
            self.chosen[at] = new
            self.steps.append(Step("swap", f"{one.candidate.effect} -> {best.candidate.effect}", ranking[:10]))
            return True
        return False

    def contest(self, one: Chosen) -> tuple[Ranked, list[Ranked]]:
        """A finding against all named rivals for its place, with every other finding kept."""
        conditioned = self.condition(without=one)
        own = self._own(one, conditioned)
        kept = self.chosen
        self.chosen = [other for other in kept if other is not one]
        try:
            ranking = self.rank(conditioned)
        finally:
            self.chosen = kept
        key = one.candidate.effect.key()
        return own, [rival for rival in ranking if rival.candidate.effect.key() != key]

    def likeness(self, one: Chosen, rival: Candidate) -> float:
        """Cosine between what a finding and a rival take out of the residual, all other findings kept."""
        columns = self._columns(rival)
        conditioned = self.condition(without=one)
        both = [self._taken(conditioned, one.columns), self._taken(conditioned, columns)]
        cross = self.system.gram[np.ix_(one.columns, columns)]
        cross = cross - conditioned.reduced[:, one.columns].T @ conditioned.reduced[:, columns]
        lengths = [
            float(weight @ conditioned.block(place) @ weight)
            for weight, place in zip(both, (one.columns, columns), strict=True)
        ]
        if min(lengths) <= 0:
            return 0.0
        return float(both[0] @ cross @ both[1] / math.sqrt(lengths[0] * lengths[1]))

    def _taken(self, conditioned: Conditioned, columns: NDArray[np.int64]) -> Array:
        """Least-squares coefficients of some columns' new parts for what is left."""
        return np.asarray(
            np.linalg.lstsq(conditioned.block(columns), conditioned.moment[columns], rcond=1e-10)[0], dtype=np.float64
        )

    def _own(self, one: Chosen, conditioned: Conditioned) -> Ranked:
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

    def total(self) -> float:
        """Log posterior odds of everything chosen together, against nothing: each in turn given those before it."""
        kept, self.chosen = self.chosen, []
        result = 0.0
        try:
            for one in kept:
                result += self._own(one, self.condition()).total
                self.chosen.append(one)
        finally:
            self.chosen = kept
        return result


def _ranked(candidate: Candidate, scores: Scores, i: int) -> Ranked:
    p_value = min(1.0, scores.p_value(i) * math.exp(-candidate.log_prior)) if scores.evidence[i] > 2.0 else 1.0
    return Ranked(
        candidate,
        float(scores.evidence[i]),
        candidate.log_prior,
        p_value,
        float(scores.gain[i]),
        float(scores.width[i]),
    )
