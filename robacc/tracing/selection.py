"""Selection among candidates on one linearisation: forward, with a new test of every finding after each step."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from dataclasses import dataclass

from robacc.effects.base import Effect
from robacc.statistics.distributions import chi2_quantile, chi2_sf
from robacc.tracing.candidate_scorer import CandidateScorer
from robacc.tracing.candidates import TYPICAL_CANDIDATES, Candidate, EffectName
from robacc.tracing.ranking import Chosen, Ranked, sorted_by_odds
from robacc.tracing.refinement import refined

FALSE_ALARM = 0.002
"""Bound on the probability, over all candidates, that anything is found on a clean arm. The promise is one in a
hundred. Orders and forms are searched more finely than they are counted: of 200 simulated clean arms four had a finding
at 0.005, each with a corrected p-value between 0.001 and 0.005."""
_LARGEST_LEVEL = 0.05
"""Largest level of a fold."""
_SWAP = 1.0
"""Evidence by which a rival must be better to take a finding's place: equals do not change places for ever."""
MOST_FINDINGS = 12
"""Largest number of findings."""
_MOST_REVISED = 6
"""Findings beyond which none is tested again: so many are a sign of an effect outside the catalogue."""
_SWEEPS = 4
"""Largest number of new tests of all findings after a step."""
_UNCHANGED = 0.9
"""Share of what it explains that a finding keeps if a step concerns neither it nor its rivals."""


def fold_level(share: float) -> float:
    """Return the level at which a ``share`` of the poses shows what all poses just show at :data:`FALSE_ALARM`.

    A test statistic grows with the number of poses. At the level of all poses, folds would reject findings that the
    complete search found with certainty enough.
    """
    statistic = chi2_quantile(1.0 - FALSE_ALARM / TYPICAL_CANDIDATES, 1.0)
    return min(TYPICAL_CANDIDATES * chi2_sf(share * statistic, 1.0), _LARGEST_LEVEL)


@dataclass
class SelectionStep:
    """Record of one step and its ranking."""

    action: str
    chosen: str | None
    ranking: list[Ranked]


@dataclass
class Selection:
    """State of one selection."""

    scorer: CandidateScorer
    chosen: list[Chosen] = dataclasses.field(default_factory=list)
    steps: list[SelectionStep] = dataclasses.field(default_factory=list)
    most: int = MOST_FINDINGS
    """Number of findings from which none is added."""
    level: float = FALSE_ALARM
    """Corrected p-value up to which a candidate is a finding."""
    named_first: bool = True
    """Whether named effects were chosen before corrections."""
    known: tuple[Effect, ...] = ()
    """Findings of an earlier selection, which tried the sets around them."""
    _gains: dict[tuple[object, ...], float] = dataclasses.field(default_factory=dict)
    """What each finding explained (sum of squares) when it was tested against all rivals, by its key."""

    def rank(self, with_blocks: bool = False) -> list[Ranked]:
        """Return all candidates given the chosen effects, best first."""
        return self.scorer.rank(self.scorer.condition(self.chosen), self.chosen, with_blocks)

    def start_with(self, candidate: Candidate) -> None:
        """Add a candidate to the model without a test; later steps test it."""
        finding = self.scorer.as_chosen(candidate, 0.0)
        ranked = self.scorer.score(finding, self.scorer.condition(self.chosen))
        self.chosen.append(self.scorer.as_chosen(candidate, ranked.prior_var))

    def add(self, ranked: Ranked) -> None:
        """Add a candidate to the model in place of the findings that it covers."""
        self.chosen = [
            other for other in self.chosen if not self.scorer.redundancy.covers(ranked.candidate, other.candidate)
        ]
        self.chosen.append(self.scorer.as_chosen(ranked.candidate, ranked.prior_var))
        self._settle(self.chosen[-1])
        # It has just won against all others.
        self._gains[self.chosen[-1].candidate.key] = self._score(self.chosen[-1]).gain

    def _settle(self, finding: Chosen) -> None:
        """Improve a searched setting at once: off the grid, a harmonic's remainder would look like another harmonic."""
        better = self._improved(finding)
        if better.key != finding.candidate.key:
            self.chosen[self.chosen.index(finding)] = self.scorer.as_chosen(better, 0.0)

    def refined(self, finding: Chosen) -> Effect:
        """Return the effect of a finding, with a searched setting improved."""
        return self._improved(finding).effect

    def _improved(self, finding: Chosen) -> Candidate:
        """Return a finding with its searched setting improved, unless another finding then covers it."""
        better = refined(self.scorer, self.scorer.condition(self.chosen, without=finding), finding)
        others = [other.candidate for other in self.chosen if other is not finding]
        others = [other for other in others if not self.scorer.redundancy.covers(other, finding.candidate)]
        return finding.candidate if any(self.scorer.redundancy.covers(other, better) for other in others) else better

    def run(self, with_blocks: bool = False) -> None:
        """Add candidates until none is significant, with new tests of earlier findings after each step."""
        if self.chosen:
            self._revise()
        self._forward(with_blocks)
        if not with_blocks and len(self.chosen) <= _MOST_REVISED and not self.is_known():
            self._rebuild()

    def is_known(self) -> bool:
        """Return whether the findings are those of the earlier selection."""
        effects = [finding.candidate.effect for finding in self.chosen if not finding.candidate.effect.is_frame]
        return len(effects) == len(self.known) and all(
            any(known.is_same_finding(effect) for effect in effects) for known in self.known
        )

    def _forward(self, with_blocks: bool, without: tuple[object, ...] | None = None) -> None:
        previous_sets: set[frozenset[tuple[object, ...]]] = set()
        while len(self.chosen) < self.most:
            # A set of findings that recurs would recur for ever.
            present = frozenset(finding.candidate.key for finding in self.chosen)
            if present in previous_sets:
                return
            previous_sets.add(present)
            ranking = self.rank(with_blocks)
            if without is not None:
                ranking = [finding for finding in ranking if finding.candidate.key != without]
            best = ranking[0] if ranking else None
            if (best is None or best.p_value > self.level) and without is None:
                conditioned = self.scorer.condition(self.chosen)
                high = self.scorer.rank_high_orders(conditioned, self.chosen)
                high += self.scorer.rank_places(conditioned, self.chosen)
                high += self.scorer.rank_beside(conditioned, self.chosen)
                high = sorted_by_odds(high)
                best = high[0] if high and high[0].p_value <= self.level else best
                ranking = high[:1] + ranking if high and best is high[0] else ranking
            if best is None or best.p_value > self.level:
                if self._revise(without):
                    continue
                self.steps.append(SelectionStep("stop", None, ranking))
                return
            self.add(best)
            self.steps.append(SelectionStep("add", str(best.candidate.effect), ranking))
            self._revise(without, changed_only=len(self.chosen) < _MOST_REVISED)

    def _rebuild(self) -> None:
        """Forbid each finding in turn and select again: an early finding may stand in for two others."""
        for finding in sorted(self.chosen, key=lambda entry: -entry.columns.size):
            if finding not in self.chosen or finding.candidate.effect.is_frame:
                continue
            before, total, steps = list(self.chosen), self.total(), list(self.steps)
            self.chosen = [other for other in before if other is not finding]
            self._forward(False, finding.candidate.key)
            if self.total() > total + _SWAP:
                steps.append(SelectionStep("rebuild", f"without {finding.candidate.effect}", []))
                self.steps = steps
            else:
                self.chosen, self.steps = before, steps

    def _revise(self, without: tuple[object, ...] | None = None, *, changed_only: bool = False) -> bool:
        """Drop findings that are no longer significant, and replace a finding by a better rival.

        With ``changed_only``, findings that explain what they did in their last test are not tested again.

        Returns:
            Whether a finding was dropped or replaced.
        """
        is_revised = False
        if len(self.chosen) > _MOST_REVISED:
            return is_revised
        for _ in range(_SWEEPS):
            findings = [f for f in self.chosen if not (changed_only and self._is_unchanged(f))]
            if not any([self._revise_finding(finding, without) for finding in findings]):
                break
            is_revised = True
        return is_revised

    def _is_unchanged(self, finding: Chosen) -> bool:
        """Return whether a finding explains what it did in its last test, and is significant."""
        gain = self._gains.get(finding.candidate.key)
        if gain is None:
            return False
        ranked = self._score(finding)
        return _UNCHANGED * gain <= ranked.gain <= gain / _UNCHANGED and ranked.p_value <= self.level

    def _revise_finding(self, finding: Chosen, without: tuple[object, ...] | None) -> bool:
        if finding not in self.chosen or len(self.chosen) < 2:
            return False
        ranked, ranking = self.contest(finding)
        self._gains[finding.candidate.key] = ranked.gain
        if ranked.p_value > self.level:
            self.chosen.remove(finding)
            self.steps.append(SelectionStep("drop", str(finding.candidate.effect), ranking[:10]))
            return True
        ranking = [rival for rival in ranking if rival.candidate.key != without]
        best = ranking[0] if ranking else ranked
        if best.total > ranked.total + _SWAP:
            at = self.chosen.index(finding)
            self.chosen[at] = self.scorer.as_chosen(best.candidate, best.prior_var)
            self._settle(self.chosen[at])
            self.steps.append(
                SelectionStep("swap", f"{finding.candidate.effect} -> {best.candidate.effect}", ranking[:10])
            )
            return True
        return False

    def prune(self, inflation: Callable[[Effect], float] = lambda effect: 1.0) -> None:
        """Drop findings that are not significant given the others, the weakest first.

        ``inflation`` returns the variance of an effect's coefficients over that for independent errors.
        """

        def p_value(finding: Chosen) -> float:
            return self._score(finding).p_value_beside(inflation(finding.candidate.effect))

        while self.chosen:
            weakest = max(self.chosen, key=p_value)
            if p_value(weakest) <= self.level:
                return
            self.chosen.remove(weakest)
            self.steps.append(SelectionStep("drop", str(weakest.candidate.effect), []))

    def _score(self, finding: Chosen) -> Ranked:
        """Return the score of a finding given all others."""
        return self.scorer.score(finding, self.scorer.condition(self.chosen, without=finding))

    def contest(self, finding: Chosen, among: Collection[EffectName] | None = None) -> tuple[Ranked, list[Ranked]]:
        """Return the score of a finding and of all named rivals for its place, given all other findings.

        With ``among``, all rivals of these effects are there, and perhaps some of others.
        """
        conditioned = self.scorer.condition(self.chosen, without=finding)
        ranked = self.scorer.score(finding, conditioned)
        others = [other for other in self.chosen if other is not finding]
        ranking = self.scorer.rank(conditioned, others, among=among)
        if instead := self.scorer.rank_beside(conditioned, [finding]):
            ranking = sorted([*ranking, *instead], key=lambda entry: -round(entry.total, 6))
        key = finding.candidate.key
        return ranked, [rival for rival in ranking if rival.candidate.key != key]

    def total(self) -> float:
        """Return the log posterior odds of all findings together against none: each in turn given those before."""
        return sum(
            self.scorer.score(finding, self.scorer.condition(self.chosen[:i])).total
            for i, finding in enumerate(self.chosen)
        )
