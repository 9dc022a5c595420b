"""The search: fit the declared effects, linearise, select, fit everything together, until nothing changes."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.fitting.fit_repeatability import is_same, scatter_evidence, significant_components, with_scatter
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.repeatability import MANY_COEFFICIENTS, Components
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.tracing.candidate_pool import CandidatePools
from robacc.tracing.choosing import choose
from robacc.tracing.held_out_gain import gain_of
from robacc.tracing.linearised_candidates import LinearisedCandidates, linearise
from robacc.tracing.refitting import SEARCH, frames_first, frames_of, refit
from robacc.tracing.selection import FALSE_ALARM, MOST_FINDINGS, Selection, SelectionStep
from robacc.tracing.wander import explained_by_wander

_ROUNDS = 4
"""Largest number of rounds of a joint fit and a selection."""
_SCATTER_ROUNDS = 3
"""Largest number of estimates of the scatter of the joints."""
_LEAST_SHARE = 0.25
"""Least evidence for scatter alone, as a share of that for effects, for which a search starts with scatter too."""
_CLEARLY_BETTER = 2.0
"""Standard errors by which effects must predict held-out poses better than fewer effects with scatter do, to stay."""
_LEAST_WORTH = 5.0
"""Least evidence (log Bayes factor) of a step or a drift of the scale given errors that wander (odds of 150 to 1)."""


@dataclass(frozen=True)
class SearchResult:
    """Result of the search on one set of poses; its effects are those of its fit and of its selection."""

    declared: Fit
    final: Fit
    effects: tuple[Effect, ...]
    steps: tuple[SelectionStep, ...]
    candidates: LinearisedCandidates
    """Candidates at the baseline."""
    final_candidates: LinearisedCandidates
    """Candidates at the final fit."""
    selection: Selection
    options: Options
    """Fit options, with the scatter of the joints if it is significant."""
    components: Components | None = None
    """Scatter of the joints, where it is significant."""
    named_first: bool = True
    """Whether the first selection chose named effects before corrections."""
    rounds: int = 1
    """Number of rounds of a joint fit and a selection."""
    settled: bool = True
    """False if the rounds ended, or came back to an earlier choice, before a choice repeated itself."""


@dataclass(frozen=True)
class _Round:
    """A set of effects, the fit of all of them together, and the selection that starts from them."""

    effects: tuple[Effect, ...]
    fit: Fit
    candidates: LinearisedCandidates
    """Candidates at the fit."""
    selection: Selection
    """Selection of exactly these effects, on the linearisation of their fit."""
    next: Selection
    """What the search chooses from there."""

    @property
    def keys(self) -> frozenset[tuple[object, ...]]:
        """Return the keys of the effects."""
        return frozenset(effect.search_key() for effect in self.effects)


class _Search:
    """State of one search: the baseline, and the rounds since the scatter of the joints last changed."""

    def __init__(
        self,
        model: Model,
        data: Measurements,
        options: Options,
        only: Sequence[str] | None,
        empirical: bool,
        progress: Callable[[int, int], None],
    ) -> None:
        self.model, self.data, self.options = model, data, options
        self.empirical, self.progress = empirical, progress
        self.pools = CandidatePools(data, only)
        self.progress(1, 0)
        self.all_rows = np.ones(data.n, dtype=bool)
        self.baseline = fit(model, data, options)
        self.first = self._linearised(self.baseline)
        self.components: Components | None = None
        self.steps: list[SelectionStep] = []
        self.count = 0
        self.named_first = True

    def _linearised(self, fitted: Fit, frames: tuple[Effect, ...] = ()) -> LinearisedCandidates:
        """Return the candidates at a fit of the baseline and other effects, of which ``frames`` are no candidates."""
        return linearise(fitted, self.pools.of(fitted.model.arm, (*self.model.free, *frames)))

    def start(self, most: int = MOST_FINDINGS) -> _Round:
        """Return the round without findings, and the choice of at most ``most`` of them."""
        first = self._chosen_from((), self.baseline, self.first, most)
        self.named_first = first.next.named_first
        return first

    def follow(self, last: _Round) -> _Round:
        """Fit what the last round chose, all together, and choose again from there."""
        chosen = frames_of(last.effects) + tuple(last.next.refined(choice) for choice in last.next.chosen)
        # Every fit registers an identified frame anew, so it is no candidate again.
        frames = frames_of(chosen)
        others = tuple(effect for effect in chosen if not effect.is_frame)
        self.progress(self.count + 1, len(chosen))
        fitted = refit(last.fit, (*self.baseline.model.free, *frames, *others), self.data, self.options)
        return self._chosen_from(chosen, fitted, self._linearised(fitted, frames))

    def _chosen_from(
        self, effects: tuple[Effect, ...], fitted: Fit, candidates: LinearisedCandidates, most: int = MOST_FINDINGS
    ) -> _Round:
        others = [effect for effect in effects if not effect.is_frame]
        # The round that chose these effects tried the sets around them.
        choice = choose(candidates, self.all_rows, others, self.empirical, most=most, known=others)
        self.steps.extend(choice.steps)
        self.count += 1
        return _Round(effects, fitted, candidates, candidates.selection(self.all_rows, others), choice)

    def settle(self, last: _Round) -> tuple[_Round, bool]:
        """Follow the choice until it repeats itself; return that round, and whether it did.

        A choice that comes back to an earlier one, or has not settled after :data:`_ROUNDS`, is decided by comparing
        all rounds, the last choice included.
        """
        rounds = [last]
        while True:
            chosen = frozenset(last.next.refined(choice).search_key() for choice in last.next.chosen)
            if chosen == frozenset(effect.search_key() for effect in last.effects if not effect.is_frame):
                return last, True
            if len(rounds) > _ROUNDS + 1 or any(chosen == earlier.keys for earlier in rounds):
                return _best(rounds), False
            last = self.follow(last)
            rounds.append(last)

    def without_wander(self, last: _Round) -> _Round:
        """Return the round without steps and drifts of the scale that a slow wander explains as well (:mod:`.wander`).

        The weakest goes first. A drift may come in its place.
        """
        while True:
            suspected = [effect for effect in last.effects if effect.resembles_wander]
            without = {effect: self._fit_of(last, _others(last, effect)) for effect in suspected}
            worth = {effect: self._worth_beside_wander(last, effect, fitted) for effect, fitted in without.items()}
            weakest = min(worth, key=lambda effect: worth[effect], default=None)
            if weakest is None or worth[weakest] >= _LEAST_WORTH:
                return last
            self.steps.append(SelectionStep("drop", f"{weakest}: errors wander", []))
            last = self._round_of(_others(last, weakest), without[weakest])
            drifts = [r for r in last.selection.rank() if r.candidate.effect.is_slow_drift]
            if drifts and drifts[0].p_value <= FALSE_ALARM:
                effects = (*last.effects, drifts[0].candidate.effect)
                last = self._round_of(effects, self._fit_of(last, effects))

    def _fit_of(self, last: _Round, effects: tuple[Effect, ...]) -> Fit:
        """Return the fit of the baseline and exactly these effects, started at the last one."""
        return refit(last.fit, (*self.baseline.model.free, *frames_first(effects)), self.data, self.options)

    def _round_of(self, effects: tuple[Effect, ...], fitted: Fit) -> _Round:
        """Return a round of exactly these effects, of which ``fitted`` is the fit."""
        frames, others = frames_of(effects), [effect for effect in effects if not effect.is_frame]
        candidates = self._linearised(fitted, frames)
        selection = candidates.selection(self.all_rows, others)
        return _Round(effects, fitted, candidates, selection, selection)

    def _worth_beside_wander(self, last: _Round, suspect: Effect, without: Fit) -> float:
        """Return the evidence for an effect if the errors may also wander; ``without`` is the fit without it."""
        selection = last.selection
        choice = next(c for c in selection.chosen if c.candidate.effect.search_key() == suspect.search_key())
        evidence = selection.contest(choice)[0].total
        return evidence - explained_by_wander(without, last.fit, self.data)

    def update_scatter(self, last: _Round) -> bool:
        """Estimate the joints' scatter with the findings; return whether it changed, with the baseline refitted."""
        components = significant_components(last.fit, self.data)
        if components is None:
            return False
        self.components = components
        if is_same(self.options, components) or last.fit.theta.size > MANY_COEFFICIENTS:
            # With profiles of joints in the model, scatter is reported beside them and does not change them.
            return False
        self._use(components)
        return True

    def _use(self, components: Components) -> None:
        """Fit the baseline with the joints' scatter, and linearise the candidates there."""
        self.options = with_scatter(self.options, components)
        self.baseline = refit(self.baseline, self.baseline.model.free, self.data, self.options)
        self.first = self._linearised(self.baseline)

    def beside_scatter(self, components: Components) -> _Search:
        """Return a search that starts with the joints' scatter."""
        other = copy.copy(self)
        other.components, other.steps = components, []
        other._use(components)
        return other

    def settle_with_scatter(self, first: _Round) -> tuple[_Round, bool]:
        """Search from the round ``first`` until the choice settles, with the scatter of the joints that remains."""
        last, settled = self.settle(first)
        for _ in range(_SCATTER_ROUNDS):
            if not self.update_scatter(last):
                break
            last, settled = self.settle(self.follow(dataclasses.replace(last, next=last.selection)))
        return last, settled

    def worth(self, last: _Round, white: LinearisedCandidates) -> float:
        """Return the evidence for effects and scatter together against the baseline with neither of them.

        Args:
            last: The effects and their fit.
            white: Candidates at the baseline without scatter.
        """
        others = [effect for effect in last.effects if not effect.is_frame]
        evidence = white.selection(self.all_rows, others).total()
        components = significant_components(last.fit, self.data)
        return evidence if components is None else evidence + scatter_evidence(components, self.data)


def _others(last: _Round, effect: Effect) -> tuple[Effect, ...]:
    """Return the effects of a round but one."""
    return tuple(other for other in last.effects if other != effect)


def _best(rounds: Sequence[_Round]) -> _Round:
    """Return the round with the largest posterior, from the residuals of its own fit on the rows common to all.

    The selection of a round gives what its coefficients cost: the evidence less the gain in likelihood, and the prior.
    """
    rows = np.logical_and.reduce([entry.fit.inliers for entry in rounds])
    weight = rounds[0].fit.weight * rows

    def posterior(entry: _Round) -> float:
        scorer = entry.selection.scorer
        baseline, full = scorer.condition([]), scorer.condition(entry.selection.chosen)
        cost_of_coefficients = entry.selection.total() - 0.5 * baseline.dof * np.log(baseline.cost / full.cost)
        squares = float(np.sum(np.square(entry.fit.residual * weight)))
        components = float(rows.sum() * entry.fit.residual.shape[0])
        return float(cost_of_coefficients - 0.5 * components * np.log(max(squares, 1e-300)))

    return max(rounds, key=posterior)


def search(
    model: Model,
    data: Measurements,
    options: Options = SEARCH,
    only: Sequence[str] | None = None,
    empirical: bool = True,
    progress: Callable[[int, int], None] = lambda count, n_findings: None,
) -> SearchResult:
    """Fit, select and refit until the selection is stable; then repeat with the remaining scatter of the joints.

    ``progress`` is called with the number of each round and the number of effects that it fits.

    Scatter that rows of a visit share is no effect, but by chance effects fit it. It is estimated beside the chosen
    effects, so that a real effect does not pass for scatter, and each finding is tested again beside it.
    """
    state = _Search(model, data, options, only, empirical, progress)
    last, settled = state.settle_with_scatter(state.start())
    if last.effects and state.options.scatter is None:
        state, last, settled = _better_with_scatter(state, last, settled)
    last = state.without_wander(last)
    return SearchResult(
        declared=state.baseline,
        final=last.fit,
        effects=last.effects,
        steps=tuple(state.steps),
        candidates=state.first,
        final_candidates=last.candidates,
        selection=last.next if settled else last.selection,
        options=state.options,
        components=state.components,
        named_first=state.named_first,
        rounds=state.count,
        settled=settled,
    )


def _better_with_scatter(state: _Search, last: _Round, settled: bool) -> tuple[_Search, _Round, bool]:
    """Return the search that starts with the joints' scatter, with its end, if that explains the data better.

    Where rows of a visit share scatter, a search without it explains it by many effects, and none is left to estimate.
    Beside scatter there are fewer; if there are not, what looks like scatter at the baseline is the effects themselves.
    The effects also stay if they predict held-out poses clearly better, which scatter cannot.
    """
    components = significant_components(state.baseline, state.data)
    if components is None:
        return state, last, settled
    worth = state.worth(last, state.first)
    if scatter_evidence(components, state.data) < _LEAST_SHARE * worth:
        return state, last, settled
    other = state.beside_scatter(components)
    first = other.start(len(last.effects))
    if len(first.next.chosen) >= len(last.effects):
        return state, last, settled
    end, is_settled = other.settle_with_scatter(first)
    if other.worth(end, state.first) <= worth or gain_of(last.fit, end.fit, state.data) > _CLEARLY_BETTER:
        return state, last, settled
    return other, end, is_settled
