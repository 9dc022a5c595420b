"""Choosing among candidates on one linearisation: forward, with every finding put to the test again after each step."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from robacc.effects.base import Effect
from robacc.effects.orders import ORDER_STEP
from robacc.effects.periodic import of_order, searched_order
from robacc.tracing.candidate_scorer import CandidateScorer, Chosen, Ranked
from robacc.tracing.candidates import Candidate

FALSE_ALARM = 0.002
"""Bound over all candidates together that anything at all is named on a clean arm. The promise is one in a hundred;
orders and forms are searched more finely than they are counted: of 200 simulated clean arms four had something named at
0.005, each with a corrected p-value between 0.001 and 0.005."""
_SWAP = 1.0
"""A rival takes a finding's place where it is better by more than this: equals do not change places for ever."""
_MOST = 12
"""Findings at most."""
_FEW_ENOUGH = 6
"""More findings than this are a sign of something without a name; testing each again would not mend that."""
_SWEEPS = 4
"""Times at most that all findings are put to the test after a step."""


@dataclass
class SelectionStep:
    """What one step saw and did, for the record."""

    action: str
    chosen: str | None
    ranking: list[Ranked]


@dataclass
class Selection:
    """The state of one choice."""

    field: CandidateScorer
    chosen: list[Chosen] = dataclasses.field(default_factory=list)
    steps: list[SelectionStep] = dataclasses.field(default_factory=list)

    def rank(self, with_blocks: bool = False) -> list[Ranked]:
        """Everything that competes beside what is chosen, best first."""
        return self.field.rank(self.field.condition(self.chosen), self.chosen, with_blocks)

    def start_with(self, candidate: Candidate) -> None:
        """Take a candidate into the model without contest; it is put to the test by what follows."""
        one = self.field.taken(candidate, 0.0)
        own = self.field.own(one, self.field.condition(self.chosen))
        self.chosen.append(self.field.taken(candidate, own.width))

    def add(self, ranked: Ranked) -> None:
        """Take a candidate into the model; it takes the place of what it holds already."""
        self.chosen = [other for other in self.chosen if not self.field.holds(ranked.candidate, other.candidate)]
        self.chosen.append(self.field.taken(ranked.candidate, ranked.width))
        self._settle_order(self.chosen[-1])

    def _settle_order(self, one: Chosen) -> None:
        """Improve a searched order at once: what the grid of orders leaves of a line would look like another line."""
        effect = self.refined(one)
        if effect.key() != one.candidate.key:
            better = self.field.taken(dataclasses.replace(one.candidate, effect=effect, terms=()), 0.0)
            self.chosen[self.chosen.index(one)] = better

    def refined(self, one: Chosen) -> Effect:
        """A finding with its order improved off the grid, where it is a single searched order."""
        effect = one.candidate.effect
        order = searched_order(effect)
        wave = next((w for w in self.field.waves if w.joint in effect.joints), None)
        if order is None or wave is None:
            return effect
        conditioned = self.field.condition(self.chosen, without=one)
        for span in (ORDER_STEP, ORDER_STEP / 8):
            order = self.field.best_order(conditioned, wave, order, span)
        return of_order(wave.joint, round(order, 4))

    def run(self, with_blocks: bool = False) -> None:
        """Forward until nothing is significant, each time putting every earlier finding to the test again."""
        if self.chosen:
            self._revise()
        self._forward(with_blocks)
        if not with_blocks and len(self.chosen) <= _FEW_ENOUGH:
            self._rebuild()

    def _forward(self, with_blocks: bool, without: tuple[object, ...] | None = None) -> None:
        seen: set[frozenset[tuple[object, ...]]] = set()
        while len(self.chosen) < _MOST:
            # A set of findings that comes back would come back for ever.
            present = frozenset(one.candidate.key for one in self.chosen)
            if present in seen:
                return
            seen.add(present)
            ranking = self.rank(with_blocks)
            if without is not None:
                ranking = [one for one in ranking if one.candidate.key != without]
            best = ranking[0] if ranking else None
            if best is None or best.p_value > FALSE_ALARM:
                self.steps.append(SelectionStep("stop", None, ranking))
                return
            self.add(best)
            self.steps.append(SelectionStep("add", str(best.candidate.effect), ranking))
            self._revise(without)

    def _rebuild(self) -> None:
        """Forbid each finding in turn and choose again: what greed took first may have stood in for two others."""
        for one in sorted(self.chosen, key=lambda item: -item.columns.size):
            if one not in self.chosen or one.candidate.effect.is_frame:
                continue
            before, total, steps = list(self.chosen), self.total(), list(self.steps)
            self.chosen = [other for other in before if other is not one]
            self._forward(False, one.candidate.key)
            if self.total() > total + _SWAP:
                steps.append(SelectionStep("rebuild", f"without {one.candidate.effect}", []))
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
            self.steps.append(SelectionStep("drop", str(one.candidate.effect), ranking[:10]))
            return True
        ranking = [rival for rival in ranking if rival.candidate.key != without]
        best = ranking[0] if ranking else own
        if best.total > own.total + _SWAP:
            at = self.chosen.index(one)
            self.chosen[at] = self.field.taken(best.candidate, best.width)
            self._settle_order(self.chosen[at])
            self.steps.append(SelectionStep("swap", f"{one.candidate.effect} -> {best.candidate.effect}", ranking[:10]))
            return True
        return False

    def prune(self) -> None:
        """Drop what the other findings leave no need of, the least needed first."""
        while self.chosen:
            weakest = max(self.chosen, key=self._p_value)
            if self._p_value(weakest) <= FALSE_ALARM:
                return
            self.chosen.remove(weakest)
            self.steps.append(SelectionStep("drop", str(weakest.candidate.effect), []))

    def _p_value(self, one: Chosen) -> float:
        """Of a finding, with every other finding kept."""
        return self.field.own(one, self.field.condition(self.chosen, without=one)).p_value

    def contest(self, one: Chosen) -> tuple[Ranked, list[Ranked]]:
        """A finding against all named rivals for its place, with every other finding kept."""
        conditioned = self.field.condition(self.chosen, without=one)
        own = self.field.own(one, conditioned)
        others = [other for other in self.chosen if other is not one]
        ranking = self.field.rank(conditioned, others)
        key = one.candidate.key
        return own, [rival for rival in ranking if rival.candidate.key != key]

    def similarity(self, one: Chosen, rival: Candidate) -> float:
        """Cosine between what a finding and a rival take out of the residual, all other findings kept."""
        return self.field.similarity(self.chosen, one, rival)

    def total(self) -> float:
        """Log posterior odds of everything chosen together, against nothing: each in turn given those before it."""
        return sum(
            self.field.own(one, self.field.condition(self.chosen[:i])).total for i, one in enumerate(self.chosen)
        )
