"""The search: effects and terms of the covariance are added, dropped and swapped by one marginal likelihood.

Each move counts by the change of log likelihood and log prior odds, and is made beyond :data:`ACCEPTED`. Effects are
chosen beside independent noise first. Where terms of the covariance may gain, beside these effects or in the place of
one, they are added to the effects that stand out, a second search adds the terms first, and a third begins from the
effects of the first beside the terms of the second; the most probable model is the result. No finding is withdrawn
afterwards.
"""

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect, Part, Term
from robacc.effects.campaign import Step
from robacc.effects.periodic import PoseCorrection, TransmissionError, are_separable, orders_of, searched_order
from robacc.error_model.covariance import (
    TERMS,
    CovarianceParameters,
    Linearised,
    Rows,
    Whitened,
    by_row,
    estimated,
    gains_at_sizes,
    log_evidence,
    too_many_gross_errors,
    usual_std,
    whitened,
    with_gross_errors,
    with_term_if_worth,
    with_terms_that_gain,
)
from robacc.errors import RobaccError
from robacc.fitting.closed_form import register_frames
from robacc.fitting.levels import (
    ACCEPTED,
    BLOCK_NUMBERS,
    EXAMPLES,
    LARGEST,
    NEGLIGIBLE,
    NORMAL_95,
    RESOLUTION,
    ROUNDS,
    SHORTLIST,
    STEPS,
)
from robacc.fitting.solver import broad_precision, broad_stds, by_effect
from robacc.fitting.visits import random_rows, row_ranks
from robacc.geometry import Array, NDArray, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import BoundModel, Model, residuals
from robacc.robots.arm import Arm
from robacc.tracing.candidates import (
    PROFILE_ORDERS,
    Candidate,
    EffectName,
    Evidence,
    Pool,
    Scores,
    decisive_test,
    visible,
)

MOST_COMPONENTS = 1200
"""Components that a search uses: the covariance of all rows is never larger."""
MOST_FINDINGS = 24
"""Findings at most, which bounds the time alone: of five real arms, none has more than 20."""
MOVES_ALONE = 4
"""Moves beside independent noise before terms of the covariance are tried, which bounds the time alone: arms without
such errors mostly need fewer."""
_OF_FRAMES = 0.1
"""Prior standard deviation of declared frames, m and rad: they are registered first. The arm's constants have the broad
prior of a fit, other declared effects :data:`LARGEST` usual sizes."""

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Ranked:
    """A candidate's score at one step."""

    effect: Effect
    evidence: float
    """Log Bayes factor."""
    log_prior: float
    gain: float
    """Share of the whitened squares that it explains."""

    @property
    def log_odds(self) -> float:
        """Return the log posterior odds that the effect is there."""
        return self.evidence + self.log_prior

    @property
    def p_value(self) -> float:
        """Return the posterior probability that the effect is not there."""
        return 1.0 / (1.0 + math.exp(min(self.log_odds, 700.0)))


@dataclass(frozen=True)
class SearchStep:
    """One move of a search, with the best candidates at the time."""

    action: str
    chosen: str | None
    ranking: tuple[Ranked, ...]


@dataclass(frozen=True)
class State:
    """A model in the search: effects in it, their coefficients, and the covariance."""

    noise: CovarianceParameters
    bound: BoundModel
    theta: Array
    linear: Linearised
    chosen: tuple[Candidate, ...] = ()
    scales: tuple[float, ...] = ()
    """Multiple of the usual size of each effect's prior."""
    steps: tuple[SearchStep, ...] = ()


@dataclass(frozen=True, slots=True)
class Alternative:
    """A rival that explains the same residual nearly as well."""

    effect: str
    joints: tuple[str, ...]
    similarity: float
    """Cosine between the fits of the two to the residual: 1 if they are not distinguishable on these poses."""
    evidence_difference: float
    """Log odds of the finding less those of the rival; negative if the rival is more probable."""
    settings: dict[str, object]


@dataclass(frozen=True)
class Identified(Ranked):
    """An effect in the final model, with its scores and those of its rivals given all other effects."""

    alternatives: tuple[Alternative, ...] = ()
    """Rivals within :data:`ACCEPTED`, nearest first: at most one form of each effect and joint."""
    aliases: tuple[float, ...] = ()
    """Other orders of a periodic error that the poses do not distinguish from its own."""
    places: tuple[float, float] | None = None
    """First and last place of the 95 % interval of a step."""


@dataclass(frozen=True)
class SearchResult:
    """The most probable model of a search."""

    model: Model
    """The declared effects, with base and tool registered."""
    identified: tuple[Identified, ...]
    """In the order in which they were added; empirical corrections come last."""
    next: tuple[Ranked, ...]
    """Candidates beside the final model, best first."""
    settled: bool
    evidence: Evidence
    """Of the candidates beside the final model."""
    pool: Pool
    state: State

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return the identified effects."""
        return tuple(identified.effect for identified in self.identified)

    @property
    def coefficients(self) -> dict[tuple[object, str], float]:
        """Return the coefficients of the search's model; see :func:`by_effect`."""
        effects = (*self.model.free, *(candidate.effect for candidate in self.state.chosen))
        return by_effect(effects, self.state.bound.owners, self.state.bound.names, self.state.theta)


def search(
    model: Model, data: Measurements, only: Sequence[str] | None = None, progress: Progress = lambda count: None
) -> SearchResult:
    """Return the most probable effects beside the free ones of ``model``, and the covariance of the rest.

    ``only`` restricts the candidates to effects of those names. ``progress`` is called after each move, with the
    number of effects in the model.
    """
    return _Search(model, data, only, progress).run()


class _Search:
    def __init__(self, model: Model, data: Measurements, only: Sequence[str] | None, progress: Progress) -> None:
        rows = random_rows(data, MOST_COMPONENTS // (3 if data.rotation is None else 6))
        self.data = data if rows.size == data.n else data.subset(rows)
        names = {effect.name for effect in model.free}
        robot = register_frames(model.arm.robot, self.data, "base_frame" in names, "tool_frame" in names)
        self.model = dataclasses.replace(model, arm=Arm.of(robot))
        self.rows = Rows.of(self.model.arm, self.data, row_ranks(self.data))
        bound = self.model.bind(self.data)
        self.broad = broad_stds(self.model, bound.terms, bound.owners)
        """Standard deviations of the broad prior of declared constants near nominal; inf for other coefficients."""
        self.pool = Pool(self.model.arm, self.data, self.model.free, only)
        self.progress, self.settled = progress, True

    def run(self) -> SearchResult:
        """Search, and return the most probable model."""
        start = self._start()
        ends = self._search_from(start)
        if too_many_gross_errors(max(ends, key=self._log_posterior).noise):
            # They may show what the model lacks: a backlash, whose smaller side looks like gross errors.
            noise = estimated(dataclasses.replace(start.noise, factor=np.ones(self.data.n)), start.linear)
            ends += self._search_from(dataclasses.replace(start, noise=noise))
        ends = [self._with_likely_scatter(end) for end in ends]
        # An error of the pose without a name, which says nothing of other places, must be more probable by the odds of
        # acceptance: a profile took the place of a gear's ratio in four of six arms.
        odds = [
            self._log_posterior(end) - ACCEPTED * any(TERMS[name].part == "pose" for name in end.noise.terms)
            for end in ends
        ]
        best = self._fitted(ends[int(np.argmax(odds))], rounds=STEPS)
        scores, without = self._scores(best)
        identified = [
            self._identified(candidate, beside, best.chosen)
            for candidate, beside in zip(best.chosen, without, strict=True)
        ]
        return SearchResult(
            model=self.model,
            identified=(*identified, *self._corrections(best)),
            next=tuple(
                ranked for ranked in self._ranked(scores) if ranked.effect not in [one.effect for one in best.chosen]
            ),
            settled=self.settled,
            evidence=scores.evidence,
            pool=self.pool,
            state=best,
        )

    def _with_likely_scatter(self, state: State) -> State:
        """Return the state with scatter of the joints in place of other errors of the arm, where as probable.

        Few visits do not tell scatter from a profile of high orders, a process of short length or a small effect, and
        scatter claims less: of 36 poses of three targets, a correction of the position was found for a clean arm, of 40
        photos a periodic error. What is found beside scatter stays.
        """
        terms = {name: values for name, values in state.noise.terms.items() if TERMS[name].part != "pose"}
        rivals = [dataclasses.replace(state, noise=dataclasses.replace(state.noise, terms=terms))]
        if len(terms) == len(state.noise.terms):
            rivals = [] if "scatter" in terms else [self._without(state, k) for k in range(len(state.chosen))]
        for rival in rivals:
            noise = with_term_if_worth(rival.noise, rival.linear, "scatter")
            other = dataclasses.replace(rival, noise=noise)
            if "scatter" in noise.terms and self._log_posterior(state) - self._log_posterior(other) < ACCEPTED:
                return self._with_likely_scatter(self._settled(other)[0])
        return state

    # -- fits

    def _linearised(self, bound: BoundModel, theta: Array, scales: Sequence[float]) -> Linearised:
        free = self.model.free
        multiples = np.array([*([LARGEST] * len(free)), *scales])[list(bound.owners)]
        stds = multiples * [term.typical * term.weight for term in bound.terms]
        constant = np.flatnonzero(np.isfinite(self.broad))  # Columns of declared effects are first.
        stds[constant] = broad_precision(self.broad[constant], theta[constant]) ** -0.5
        stds[[owner < len(free) and free[owner].traits.is_frame for owner in bound.owners]] = _OF_FRAMES
        return Linearised.at(bound, theta, stds, self.rows, self.data)

    def _start(self) -> State:
        """Return the fit of the declared effects beside independent noise; rows far off have less weight."""
        bound = self.model.bind(self.data)
        theta = np.zeros(len(bound.terms))
        kinds = residuals(self.data, bound.poses(theta)).reshape(-1, 3, self.data.n)
        # The median of the length of three normal components is 1.54 standard deviations, that of one 0.674.
        usual = np.where(self.rows.shown[:, :3].all(axis=1), 1.54, 0.674)
        stds = np.sqrt(np.mean(np.square(kinds), axis=(1, 2)))
        noise = CovarianceParameters(np.log(np.maximum(stds, RESOLUTION)), np.ones(self.data.n))
        state = State(noise, bound, theta, self._linearised(bound, theta, ()))
        for _ in range(STEPS):
            state, moved = self._step(state)
            lengths = np.linalg.norm(residuals(self.data, bound.poses(state.theta)).reshape(kinds.shape), axis=1)
            stds = np.maximum(np.median(lengths / usual, axis=1), RESOLUTION) / math.sqrt(
                max(0.1, 1.0 - theta.size / kinds.size)
            )
            noise = CovarianceParameters(np.log(stds), np.sqrt(1.0 + np.square(lengths[0] / (3.0 * stds[0]))))
            state = dataclasses.replace(state, noise=noise)
            if moved < NEGLIGIBLE:
                break
        return self._fitted(dataclasses.replace(state, noise=with_gross_errors(noise, state.linear)))

    def _step(self, state: State) -> tuple[State, float]:
        """Take one Gauss-Newton step with a line search; return its length in standard deviations of all rows, too."""
        white, prior = whitened(state.noise, state.linear), state.linear.prior_std
        step = white.coefficients * prior - state.theta

        def objective(linear: Linearised, theta: Array) -> float:
            error = white.apply(linear.y - linear.columns @ theta)
            return float(error @ error + np.sum(np.square(theta / prior)))

        start, share = objective(state.linear, state.theta), 1.0
        while share > 0.02:
            theta = state.theta + share * step
            with contextlib.suppress(RobaccError):
                linear = self._linearised(state.bound, theta, state.scales)
                if objective(linear, theta) <= start * (1 + 1e-9):
                    moved = float(np.linalg.norm(white.columns @ (share * step / prior)))
                    return dataclasses.replace(state, theta=theta, linear=linear), moved
            share *= 0.3
        return state, 0.0

    def _fitted(self, state: State, rounds: int = ROUNDS) -> State:
        """Return a state whose effects are fitted to convergence, with its noise estimated again."""
        for _ in range(rounds):
            state, moved = self._step(state)
            # Length of the last step, in standard deviations of all rows together.
            if moved < NEGLIGIBLE:
                break
        return dataclasses.replace(state, noise=with_gross_errors(state.noise, state.linear))

    def _with_effects(self, state: State, chosen: Sequence[Candidate], scales: Sequence[float]) -> State:
        """Return a state fitted with other effects; coefficients that it had are the start of the fit."""
        before, after = (
            (*self.model.free, *(candidate.effect for candidate in some)) for some in (state.chosen, chosen)
        )
        values = by_effect(before, state.bound.owners, state.bound.names, state.theta)
        bound = dataclasses.replace(self.model, free=after).bind(self.data)
        coefficients = by_effect(after, bound.owners, bound.names, np.zeros(len(bound.terms)))
        theta = np.array([values.get(coefficient, 0.0) for coefficient in coefficients])
        return self._fitted(
            State(
                state.noise,
                bound,
                theta,
                self._linearised(bound, theta, scales),
                tuple(chosen),
                tuple(scales),
                state.steps,
            )
        )

    def _without(self, state: State, number: int) -> State:
        """Return a state fitted without one of its effects."""
        kept = [k for k in range(len(state.chosen)) if k != number]
        return self._with_effects(state, [state.chosen[k] for k in kept], [state.scales[k] for k in kept])

    # -- scores

    def _add_orders(self, state: State, white: Whitened) -> None:
        """Make the orders at the peaks of each joint's spectrum candidates: of the residual, and without each order."""
        linear, owners = state.linear, np.array(state.bound.owners, dtype=np.int64) - len(self.model.free)
        periodic = [k for k, candidate in enumerate(state.chosen) if orders_of(candidate.effect)]
        square = np.sum(np.square(linear.joints / state.noise.independent(linear.rows.stated).T), axis=1)
        for without in (None, *periodic):
            kept = None if without is None else np.flatnonzero(owners != without)
            along = np.einsum("jan,na->jn", linear.joints, white.weighted_residual(linear.y.shape[1], kept))
            for grid in self.pool.grids:
                peaks = grid.peaks(along[grid.number], square[grid.number])
                self.pool.add((TransmissionError((grid.joint,), (order,)), grid.log_prior) for order in peaks.tolist())

    def _columns(self, state: State, candidates: Sequence[Candidate]) -> Iterator[Array]:
        """Yield in blocks ``(N, M, k)`` the columns of candidates at a state, times their usual sizes.

        A coefficient that moves one motion by a regressor has that motion's column times the regressor.
        """
        sources: dict[object, Term] = {}
        columns: list[tuple[object, Array | float]] = []
        for candidate in candidates:
            for term, size in zip(candidate.terms, candidate.sizes.tolist(), strict=True):
                part = term.parts[0]
                if len(term.parts) == 1 and part.loads is None and part.motion >= 0:
                    sources.setdefault(part.motion, Term(f"motion {part.motion}", "", 1.0, (Part(part.motion),)))
                    columns.append((part.motion, np.asarray(part.factor) * size))
                else:
                    sources[candidate.key, term.name] = term
                    columns.append(((candidate.key, term.name), size))
        count, added = len(state.bound.terms), len(sources)
        extended = state.bound.with_terms(sources.values())
        theta = np.concatenate((state.theta, np.zeros(added)))
        components = self.rows.stated.shape[1]
        _, jacobian = extended.linearise(theta, np.arange(count, count + added), rows=components)
        slots = dict(zip(sources, range(added), strict=True))
        at_a_time = max(BLOCK_NUMBERS // (8 * components * self.data.n), 1)
        for start in range(0, len(columns), at_a_time):
            block = [jacobian[:, slots[source]] * factor for source, factor in columns[start : start + at_a_time]]
            yield np.array(block).T

    def _scores(self, state: State, numbers: NDArray[np.int64] | None = None) -> tuple[Scores, list[Scores]]:
        """Return the scores beside a state, and beside it without each of its effects.

        ``numbers`` are those of the candidates that are scored, with all that join the pool; all if None.
        """
        earlier = len(self.pool.all)
        for candidate in state.chosen:
            self.pool.extend(candidate)
        white = whitened(state.noise, state.linear)
        self._add_orders(state, white)
        pool = self.pool.all
        if numbers is None:
            numbers = np.arange(len(pool))
        else:
            own = [self.pool.number(candidate) for candidate in state.chosen]
            numbers = np.unique(np.concatenate((numbers, own, np.arange(earlier, len(pool)))).astype(np.int64))
        evidence = Evidence(
            white, self._columns(state, [pool[number] for number in numbers.tolist()]), pool, numbers.tolist()
        )
        owners = np.array(state.bound.owners, dtype=np.int64) - len(self.model.free)
        flat = evidence.effective(owners < 0)
        without = [evidence.scores(np.flatnonzero(owners == k), flat) for k in range(len(state.chosen))]
        return evidence.scores(np.empty(0, dtype=np.int64), flat), without

    def _log_posterior(self, state: State) -> float:
        """Return the log posterior probability of effects and terms together, up to a constant."""
        total = log_evidence(state.noise, state.linear)
        for candidate, scale in zip(state.chosen, state.scales, strict=True):
            scales, log_prior = candidate.scales
            nearest = int(np.argmin(np.abs(np.log(scales / scale))))
            total += candidate.log_prior + float(log_prior[nearest]) - ACCEPTED
            total += math.log(2.0) * candidate.effect.traits.is_nonnegative
        return float(total)

    # -- moves

    def _search_from(self, start: State) -> list[State]:
        """Return the ends of searches from a state: beside independent noise, with terms added there, and terms first.

        Effects that stand out are found before terms, which would hide them; terms that are found first hide effects
        that only resemble them. Last come the effects that stand out beside the terms that were found first: estimated
        without an effect, a term takes its place. On 72 poses of an iiwa, a process hid the compliance of a joint.
        """
        state, gain = self._settled(start, MOVES_ALONE)
        ends, noise = [], with_terms_that_gain(state.noise, state.linear)
        rival = dataclasses.replace(state, noise=noise)
        alone, left = self._settled(state, STEPS, rival if noise.terms else None) if gain > 0.0 else (state, gain)
        if left == 0.0 or not noise.terms:
            ends, state, noise = [alone], alone, with_terms_that_gain(alone.noise, alone.linear)
        ends += [self._with_terms(state, noise)] if noise.terms else []
        if noise.terms or self._terms_rival(state):
            noise = with_terms_that_gain(start.noise, start.linear)
            ends += [self._with_terms(start, noise, ends[-1])] if noise.terms else []
            ends += [self._with_terms(state, ends[-1].noise, ends[-1])] if noise.terms and state.chosen else []
        return ends

    def _with_terms(self, state: State, noise: CovarianceParameters, rival: State | None = None) -> State:
        """Return the end of a search beside the terms of ``noise``, to which others come, and from which idle go.

        It ends early where it cannot reach ``rival``.
        """
        while noise.terms.keys() != state.noise.terms.keys():
            now, earlier = set(noise.terms), set(state.noise.terms)
            changes = (("add", now - earlier), ("drop", earlier - now))
            moves = [SearchStep(action, f"covariance: {n}", ()) for action, names in changes for n in sorted(names)]
            state = dataclasses.replace(state, noise=noise, steps=(*state.steps, *moves))
            state, gain = self._settled(state, STEPS, rival)
            if gain > 0.0:
                break
            noise = with_terms_that_gain(state.noise, state.linear)
        return state

    def _terms_rival(self, state: State) -> bool:
        """Return whether a term in the place of an effect gains more than the effect: a wander in place of a step."""
        _, without = self._scores(state, np.empty(0, dtype=np.int64)) if state.chosen else (None, [])
        for k, (candidate, beside) in enumerate(zip(state.chosen, without, strict=True)):
            other = self._without(state, k)
            if any(
                gain > beside.log_odds[self.pool.number(candidate)]
                for name in TERMS
                if name not in other.noise.terms
                for gain, *_ in gains_at_sizes(other.noise, other.linear, name)
            ):
                return True
        return False

    def _settled(self, state: State, moves: int = STEPS, rival: State | None = None) -> tuple[State, float]:
        """Return the state from which no effect that is added, dropped or swapped gains, and 0.

        Before more than ``moves`` moves, or where it cannot reach ``rival``, return that state and the gain of the next
        move.
        """
        visited = {frozenset(candidate.key for candidate in state.chosen)}
        shortlist: NDArray[np.int64] | None = None
        while True:
            scores, without = self._scores(state, shortlist)
            if shortlist is None:
                whole = scores.evidence
            if self._refined(scores):
                best = [some.ranking()[:SHORTLIST] for some in (scores, *without)]
                scores, without = self._scores(state, np.unique(np.concatenate(best)))
            own = [self.pool.number(candidate) for candidate in state.chosen]
            scales = tuple(float(beside.scale[i]) for beside, i in zip(without, own, strict=True))
            state = dataclasses.replace(state, scales=scales)
            move = self._best_move(state, scores, without, visited)
            if move is None and shortlist is None:
                return self._logged(state, "stop", None, scores), 0.0
            if move is None:
                shortlist = None
                continue
            action, chosen, scales, names, beside, gain = move
            # Gains mostly diminish: further moves gain no more than as many of the present one.
            is_behind = (
                rival is not None
                and len(visited) > MOVES_ALONE
                and self._log_posterior(rival) - self._log_posterior(state)
                > gain * max(MOST_FINDINGS - len(state.chosen), 1)
            )
            if is_behind or len(visited) > moves:
                self.settled &= is_behind or moves < STEPS
                return state, gain
            # The best beside the model, and beside it without each effect, are scored next. That decides about time,
            # not about the result: before a search ends, all candidates are scored. A new effect may show what it hid:
            # all are scored beside independent noise, and those that are best by the residual where that takes longer.
            listed = [some.ranking()[:SHORTLIST] for some in (scores, *without)]
            visited.add(frozenset(candidate.key for candidate in chosen))
            state = self._with_effects(self._logged(state, action, names, beside), chosen, scales)
            if action == "add" and state.noise.terms:
                listed.append(whole.beside(whitened(state.noise, state.linear)).ranking()[:SHORTLIST])
            shortlist = None if action == "add" and not state.noise.terms else np.unique(np.concatenate(listed))

    def _refined(self, scores: Scores) -> bool:
        """Make forms near the best of each effect candidates; return whether there are new ones."""
        count, best = len(self.pool.all), dict[EffectName, Candidate]()
        for number in scores.ranking().tolist():
            if scores.log_odds[number] <= ACCEPTED or len(best) == EXAMPLES:
                break
            best.setdefault(self.pool.all[number].effect_name, self.pool.all[number])
        for candidate in best.values():
            self.pool.extend(candidate)
        return len(self.pool.all) > count

    def _best_move(
        self,
        state: State,
        scores: Scores,
        without: Sequence[Scores],
        visited: Collection[frozenset[tuple[object, ...]]],
    ) -> tuple[str, tuple[Candidate, ...], tuple[float, ...], str, Scores, float] | None:
        """Return the move that gains most to effects not yet visited, and its gain; None if none gains."""
        count = len(state.chosen)
        # A swap gains 1 at least: log odds below that are not worth more than a bare mention (Kass and Raftery 1995).
        # Gain and least gain, action, places of the effects that leave, candidates that come, and scores without them.
        moves: list[tuple[float, float, str, slice, list[int], Scores]] = []
        for best in self._best(scores, state.chosen) if count < MOST_FINDINGS else ():
            gain = float(scores.log_odds[best]) - ACCEPTED
            moves.append((gain, 0.0, "add", slice(count, count), [best], scores))
        for k, (candidate, beside) in enumerate(zip(state.chosen, without, strict=True)):
            own = float(beside.log_odds[self.pool.number(candidate)])
            moves.append((ACCEPTED - own, 0.0, "drop", slice(k, k + 1), [], beside))
            for rival in self._best(beside, [other for other in state.chosen if other is not candidate], candidate):
                gain = float(beside.log_odds[rival]) - own
                moves.append((gain, 1.0, "swap", slice(k, k + 1), [rival], beside))
        for gain, least, action, at, numbers, beside in sorted(moves, key=lambda move: -move[0]):
            new = [self.pool.all[number] for number in numbers]
            chosen, scales = list(state.chosen), list(state.scales)
            names = " -> ".join(str(candidate.effect) for candidate in (*chosen[at], *new))
            chosen[at], scales[at] = new, [float(beside.scale[number]) for number in numbers]
            if gain > least and frozenset(candidate.key for candidate in chosen) not in visited:
                return action, tuple(chosen), tuple(scales), names, beside, gain
        return None

    def _best(self, scores: Scores, others: Sequence[Candidate], not_itself: Candidate | None = None) -> list[int]:
        """Return the number of the best candidate that is no form of an effect in the model, if there is one."""
        for number in scores.ranking().tolist():
            candidate = self.pool.all[number]
            if not math.isfinite(scores.log_odds[number]):
                break
            is_present = candidate is not_itself or any(self._is_form_of(candidate, other) for other in others)
            if not is_present and self._can_be(candidate, scores):
                return [number]
        return []

    def _can_be(self, candidate: Candidate, scores: Scores) -> bool:
        """Return whether a candidate, as the data fit it, is no effect that implausible coefficients exclude."""
        return not candidate.effect.form.rejects_implausible or not candidate.effect.implausible(
            candidate.terms, (scores.fitted(self.pool.number(candidate)) * candidate.sizes).tolist()
        )

    def _is_form_of(self, candidate: Candidate, other: Candidate) -> bool:
        """Return whether two candidates are forms of one effect: an effect of one name and joint is found once.

        Steps at different places are different effects, and so are orders of a joint that its range separates.
        """
        if candidate.effect_name != other.effect_name:
            return False
        if any(searched_order(one.effect) is not None for one in (candidate, other)):
            return not self._are_separable(candidate, other)
        return not isinstance(candidate.effect, Step) or candidate.key == other.key

    def _are_separable(self, one: Candidate, other: Candidate) -> bool:
        """Return whether the poses separate every order of one periodic error of a joint from those of another."""
        assert self.data.q is not None
        extent = float(np.ptp(self.data.q[self.model.arm.number(one.effect.joints[0])]))
        pairs = itertools.product(orders_of(one.effect), orders_of(other.effect))
        return all(are_separable(first, second, extent) for first, second in pairs)

    def _logged(self, state: State, action: str, chosen: str | None, scores: Scores) -> State:
        self.progress(len(state.chosen))
        return dataclasses.replace(state, steps=(*state.steps, SearchStep(action, chosen, self._ranked(scores))))

    def _ranked(self, scores: Scores) -> tuple[Ranked, ...]:
        """Return the best form of each effect on each joint, best first."""
        best: dict[EffectName, int] = {}
        for number in scores.ranking().tolist():
            if math.isfinite(scores.log_odds[number]):
                best.setdefault(self.pool.all[number].effect_name, number)
        return tuple(self._rank(scores, number) for number in best.values())

    def _rank(self, scores: Scores, number: int) -> Ranked:
        candidate, log_bayes = self.pool.all[number], float(scores.log_bayes[number])
        return Ranked(candidate.effect, log_bayes, candidate.log_prior, float(scores.gain[number]))

    # -- result

    def _identified(self, candidate: Candidate, scores: Scores, chosen: Sequence[Candidate]) -> Identified:
        own = self.pool.number(candidate)
        alternatives: dict[tuple[object, ...], Alternative] = {}
        aliases: list[float] = []
        at: list[float] = []
        for number in scores.ranking().tolist():
            rival, behind = self.pool.all[number], float(scores.log_odds[own]) - float(scores.log_odds[number])
            if not behind <= ACCEPTED:  # NaN where the poses show neither of them.
                break
            effect, forms = rival.effect, [each.effect for each in (rival, candidate) if isinstance(each.effect, Step)]
            if len(forms) == 2 and forms[0].starting(0.0, self.data) == forms[1].starting(0.0, self.data):
                at += [forms[0].place] if behind <= 0.5 * NORMAL_95**2 else []
            elif rival.effect_name == candidate.effect_name:
                if searched_order(effect) is not None and self._are_separable(rival, candidate):
                    aliases.append(orders_of(effect)[0])
            elif self._can_be(rival, scores) and not any(
                rival.effect_name in (other.effect_name, *alternatives) for other in chosen
            ):
                alternatives[rival.effect_name] = Alternative(
                    effect.name, effect.joints, scores.similarity(own, number), behind, effect.settings()
                )
        return Identified(
            **vars(self._rank(scores, own)),
            alternatives=tuple(alternatives.values()),
            aliases=tuple(aliases[:EXAMPLES]),
            places=(min(at), max(at)) if at else None,
        )

    def _corrections(self, state: State) -> Iterator[Identified]:
        """Yield what stands in a model file for the processes over the joints, where the model needs them."""
        terms, arm, moves = state.noise.terms, self.model.arm, self.rows.moves
        price = 0.5 * math.log(self.data.n)

        def log_odds(other: CovarianceParameters) -> float:
            """Return the log posterior odds over a noise that lacks a process, and in which the joints may scatter."""
            if "scatter" not in terms:
                other = with_term_if_worth(other, state.linear, "scatter")
            return log_evidence(state.noise, state.linear) - log_evidence(other, state.linear)

        for j, joint in enumerate(arm.names if "profile" in terms else ()):
            without = terms["profile"].copy()
            without[j] = TERMS["profile"].bounds(len(without))[j][0]
            if moves[j] and arm.is_revolute(joint):
                odds = log_odds(state.noise.with_term("profile", without))
                if odds > ACCEPTED:
                    yield Identified(
                        TransmissionError((joint,), PROFILE_ORDERS, shrunk=True), odds + price, -price, 0.0
                    )
        if "smooth" in terms:
            assert self.data.q is not None
            joints = [joint for joint, does in zip(arm.names, moves, strict=True) if does]
            lengths = np.exp(terms["smooth"][1:]) / self.rows.scale
            correction = PoseCorrection.over(arm, self.data, joints, lengths[moves].tolist())
            price *= TERMS["smooth"].variances(terms["smooth"], state.linear, usual_std(state.noise, state.linear))
            yield Identified(correction, log_odds(state.noise.without("smooth")) + price, -price, 0.0)


# Detection limits of effects on the measured poses.


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """Smallest size of one form of an effect that these poses show with probability 1/2."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    limit: float | None
    """Size in ``unit``. With several coefficients: the length of their vector in its least visible direction, such as
    the amplitude of a periodic error whatever its phase. None if no plausible size is found."""
    unit: str
    rms: float | None
    """Displacement of the target by an effect of that size, root mean square over the poses, m."""


def detection_limits(found: SearchResult) -> list[DetectionLimit]:
    """Return the limit of every named candidate given the findings, except forms of mixed units."""
    dof = found.evidence.white.measured - found.evidence.effective(np.ones(len(found.state.theta), dtype=bool))
    present = {effect.key() for effect in found.effects}
    weight = 1.0 / found.state.noise.independent(found.state.linear.rows.stated).T
    result = []
    for candidate, columns in _forms(found):
        if candidate.key in present:
            continue
        own = found.evidence.rows[columns].T
        values, vectors = visible(found.evidence.new(columns, columns), np.einsum("nq,nq->q", own, own))
        effect, size, rms = candidate.effect, None, None
        if values[0] > 0 and dof > 0:
            needed = decisive_test(values.size, dof, candidate.log_prior_of_size).noncentrality_at_limit
            multiple = math.sqrt(needed * found.evidence.square / dof / float(values[0]))
            size = multiple * float(candidate.sizes[0]) if multiple <= candidate.scales[0][-1] else None
            if size is not None:
                rms = multiple * rms_length(by_row(own @ vectors[:, 0], len(weight)).T[:3] / weight[:3])
        result.append(DetectionLimit(effect.name, effect.joints, effect.settings(), size, candidate.terms[0].unit, rms))
    return result


def _forms(found: SearchResult) -> Iterator[tuple[Candidate, NDArray[np.int64]]]:
    """Yield forms with coefficients of a common unit, except forms that contain another form; steps in the middle."""
    named = [c for c in found.pool.named if len({term.unit for term in c.terms}) == 1]
    names = {candidate.key: {term.name for term in candidate.terms} for candidate in named}
    steps: dict[tuple[object, ...], list[tuple[Candidate, NDArray[np.int64]]]] = {}
    for number, columns in found.evidence.places.items():
        candidate = found.pool.all[number]
        if (own := names.get(candidate.key)) is not None:
            if not any(other < own for other in names.values()):
                yield candidate, columns
        elif isinstance(candidate.effect, Step) and len({term.unit for term in candidate.terms}) == 1:
            form = (candidate.effect.joints, *(term.name for term in candidate.terms))
            steps.setdefault(form, []).append((candidate, columns))
    for same in steps.values():
        yield same[len(same) // 2]
