"""Detection limits and power of every effect at planned poses, and poses chosen for them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import REGISTRY, Term
from robacc.error_model.covariance import ACCEPTED
from robacc.fitting.fit_result import identify_terms
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.linear_model import ExpectedNoise, coefficients, pose_rows, whitened, with_targets
from robacc.tracing.candidates import Candidate, named_candidates
from robacc.tracing.detection import decisive_test, visible

# Detection limits and power of every effect at planned poses, and pairs of effects that are not distinguishable.
#
# The poses are in their planned order, so directions and speeds of approach and the time are known. The noise is known
# too; the test is that of a trace (:mod:`robacc.tracing.detection`).

_LARGEST = 300.0
"""Largest limit, in multiples of the typical size."""
_CERTAIN = 10.0
"""Multiple of the noncentrality at probability 1/2 from which an effect is found for certain, to nine digits."""
_DETECTABLE = 0.5
"""Power from which an effect counts as detectable at its usual size."""


@dataclass(frozen=True, slots=True)
class ExpectedLimit:
    """Detection limit of one form of an effect, and the power at its usual size."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    unit: str
    limit: float | None
    """Size found with probability 1/2; with several coefficients, in the direction least visible. None: never."""
    usual: float
    """Usual size: geometric mean of the catalogue's range."""
    power: float
    """Probability that an effect of the usual size is found."""
    rms: float | None
    """Displacement of the target by an effect of the limit's size, m rms over the poses."""

    @property
    def where(self) -> str:
        """``backlash[j2]``, without settings."""
        return self.effect + (f"[{','.join(self.joints)}]" if self.joints else "")

    @property
    def label(self) -> str:
        """``backlash[j2]``, with settings."""
        settings = ", ".join(f"{key} {_text(value)}" for key, value in self.settings.items())
        return self.where + (f" ({settings})" if settings else "")


def _text(value: object) -> str:
    """Return a setting as text: the members of a list with ``+`` between them."""
    if isinstance(value, list | tuple):
        return "+".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, slots=True)
class InseparablePair:
    """Two effects of which the second explains the first, at its usual size, within the noise."""

    first: str
    second: str
    similarity: float
    """Largest cosine between the new parts of their columns."""
    evidence: float
    """Expected difference in evidence (log Bayes factor) if the first is the truth, at its usual size."""


@dataclass(frozen=True, slots=True)
class Detectability:
    """What a trace of the planned poses can find."""

    limits: tuple[ExpectedLimit, ...]
    pairs: tuple[InseparablePair, ...]
    missing: dict[str, str]
    """Reason why an effect cannot be tested, by effect."""


@dataclass(frozen=True)
class _Form:
    candidate: Candidate
    columns: NDArray[np.int64]
    limit: ExpectedLimit


def detectability(model: Model, data: Measurements, noise: ExpectedNoise) -> Detectability:
    """Return detection limits given the free effects of ``model``, for the rows of ``data`` in their order."""
    pool, missing = named_candidates(model.arm, data, model.free)
    pool = [c for c in pool if len({term.unit for term in c.terms}) == 1]
    names = [{term.name for term in candidate.terms} for candidate in pool]
    pool = [c for c, terms in zip(pool, names, strict=True) if not any(other < terms for other in names)]
    base, columns, places = _columns(model, data, noise, pool)
    orthogonal = _without(base, columns)
    gram = orthogonal.T @ orthogonal
    lengths = np.sum(np.square(columns), axis=0)
    dof = float(columns.shape[0] - base.shape[1])
    if dof <= 0:
        return Detectability((), (), missing)
    weight = 1.0 / math.hypot(noise.position, noise.unexplained)
    rows = columns.reshape(-1, data.n, columns.shape[1])
    forms = [
        _Form(candidate, place, _limit(candidate, place, gram, lengths, dof, rows, weight))
        for candidate, place in zip(pool, places, strict=True)
    ]
    return Detectability(tuple(form.limit for form in forms), _pairs(forms, gram), missing)


def _columns(
    model: Model, data: Measurements, noise: ExpectedNoise, pool: list[Candidate]
) -> tuple[Array, Array, list[NDArray[np.int64]]]:
    """Return whitened columns ``(M N, K)`` of the free effects that are identifiable, and of the pool's terms."""
    unique: dict[str, Term] = {}
    for candidate in pool:
        for term in candidate.terms:
            unique.setdefault(candidate.effect.term_key(term), term)
    number = {key: i for i, key in enumerate(unique)}
    places = [np.array([number[c.effect.term_key(term)] for term in c.terms], dtype=np.int64) for c in pool]
    bound = model.bind(data)
    count = len(bound.terms)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *unique.values()))
    rows = 3 if noise.orientation is None else 6
    jacobian = extended.linearise(np.zeros(len(extended.terms)))[1][:rows]
    white = whitened(model, data, noise, jacobian)
    flat = np.moveaxis(white, 1, 2).reshape(-1, white.shape[1])
    free = flat[:, :count]
    triangle = np.asarray(np.linalg.qr(free, mode="r"))
    terms = bound.terms
    identified = identify_terms(triangle, terms, data.n)
    return free[:, identified.columns], flat[:, count:], places


def _without(base: Array, columns: Array) -> Array:
    """Return the part of ``columns`` that is orthogonal to ``base``, taken out twice for the sake of rounding."""
    if base.shape[1] == 0:
        return columns
    basis = np.linalg.qr(base / np.linalg.norm(base, axis=0))[0]
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return columns


def _limit(
    candidate: Candidate,
    place: NDArray[np.int64],
    gram: Array,
    lengths: Array,
    dof: float,
    rows: Array,
    weight: float,
) -> ExpectedLimit:
    effect = candidate.effect
    usual = usual_size(effect.name)
    values, vectors = visible(gram[np.ix_(place, place)], lengths[place])
    size = rms = None
    power = 0.0
    if values[0] > 0:
        test = decisive_test(values.size, dof, candidate.log_prior_of_size)
        needed = test.noncentrality_at_limit
        size = math.sqrt(needed / float(values[0]))
        noncentrality = usual**2 * float(values[0])
        power = 1.0 if noncentrality > _CERTAIN * needed else test.power(noncentrality)
        if size > _LARGEST * candidate.terms[0].typical:
            size = None
    if size is not None:
        moved = np.einsum("mnq,q->mn", rows[:3][:, :, place], vectors[:, 0]) / weight
        rms = size * rms_length(moved)
    return ExpectedLimit(
        effect.name, effect.joints, effect.settings(), candidate.terms[0].unit, size, usual, power, rms
    )


def usual_size(effect: str) -> float:
    """Return the geometric mean of the catalogue's usual range of a coefficient."""
    low, high = REGISTRY[effect].about.usual_range
    return math.sqrt(low * high)


def _pairs(forms: list[_Form], gram: Array) -> tuple[InseparablePair, ...]:
    """Return the pairs of detectable effects, one form for each effect and joint, that are not distinguishable."""
    first_forms: dict[tuple[str, tuple[str, ...]], _Form] = {}
    for form in forms:
        if form.limit.power >= _DETECTABLE:
            first_forms.setdefault((form.limit.effect, form.limit.joints), form)
    entries = list(first_forms.values())
    pairs = []
    for form in entries:
        block = gram[np.ix_(form.columns, form.columns)]
        usual = form.limit.usual
        for rival in entries:
            if rival is form:
                continue
            cross = gram[np.ix_(form.columns, rival.columns)]
            explained = cross @ np.linalg.pinv(gram[np.ix_(rival.columns, rival.columns)], rcond=1e-9) @ cross.T
            remaining = max(float(np.linalg.eigvalsh(block - explained)[0]), 0.0)
            evidence = 0.5 * usual**2 * remaining
            if evidence < ACCEPTED:
                whitener = np.linalg.pinv(block, rcond=1e-12, hermitian=True)
                similarity = math.sqrt(min(max(float(np.linalg.eigvals(whitener @ explained).real.max()), 0.0), 1.0))
                pairs.append(InseparablePair(form.limit.label, rival.limit.label, similarity, evidence))
    return tuple(sorted(pairs, key=lambda pair: (-round(pair.similarity, 9), pair.evidence)))


# Choice of poses on which a trace finds every effect at its usual size, and distinguishes it from its rivals.
#
# Given the free effects, a coefficient k of the usual size has the noncentrality v_k, the squared length of its
# whitened column orthogonal to theirs. A trace finds it with a probability near Phi(sqrt(v_k) - sqrt(c_k)), where c_k
# is the noncentrality at probability 1/2. Given its nearest rival r as well, v_k - c_kr^2 / v_r remains; from twice
# the evidence that makes a rival an alternative, the two are distinguishable. The design maximises the mean of the
# two probabilities.
#
# With x = C A^T b the regression of the columns b on the free ones A, pose n adds r^T (I + A_n C A_n^T)^-1 r to the
# products of the columns, r = b_n - A_n x; recursive least squares updates x (Å. Björck, "Numerical Methods for Least
# Squares Problems", 1996, section 3.2).

_CANDIDATES = 800
"""Candidates that the search looks at, drawn at random; more gain little."""
_EXCHANGED = 100
_PASSES = 2
_LEAST_GAIN = 1e-3
_RANDOM_DRAWS = 10
_EXACT = 1e-6
"""Share of a column that must remain given a rival: no poses distinguish exact equals."""


@dataclass(frozen=True, slots=True)
class PowerProblem:
    """Candidates, and the coefficients that their poses are to show."""

    rows: Array
    """``(M, N, P)`` whitened columns of the free effects at N candidates, in units of their priors."""
    effects: Array
    """``(M, N, K)`` whitened columns of the catalogue's coefficients, in units of their usual size."""
    information: Array
    """``(P, P)`` information on the free effects before the first pose."""
    with_free: Array
    """``(P, K)`` products of the columns of free effects and catalogue over the poses measured already."""
    products: Array
    """``(K, K)`` products of the catalogue's columns over the poses measured already."""
    even_chance: Array
    """``(K,)`` noncentrality at which the coefficient is found with probability 1/2."""
    rival: NDArray[np.int64]
    """``(K,)`` nearest rival of each coefficient; itself where it has none."""

    def part(self, at: NDArray[np.int64]) -> PowerProblem:
        """Return the problem with the candidates ``at`` alone."""
        return dataclasses.replace(self, rows=self.rows[:, at], effects=self.effects[:, at])

    def probabilities(self, with_itself: Array, with_rival: Array) -> tuple[Array, Array]:
        """Return the probabilities ``(..., K)`` that each coefficient is found, and separated from its rival.

        ``with_itself`` and ``with_rival`` ``(..., K)`` are products of its column with itself and with its rival's,
        orthogonal to the free effects.
        """
        from scipy.special import ndtr

        detected = ndtr(np.sqrt(np.maximum(with_itself, 0.0)) - np.sqrt(self.even_chance))
        beside = np.maximum(with_itself - np.square(with_rival) / np.maximum(with_itself[..., self.rival], 1e-12), 0.0)
        separated = ndtr(np.sqrt(beside) - np.sqrt(2.0 * ACCEPTED))
        return detected, np.where(self.rival == np.arange(self.rival.size), 1.0, separated)

    def value(self, with_itself: Array, with_rival: Array) -> Array:
        """Return the mean of the probabilities to find a coefficient, and to find it and separate it from its rival."""
        detected, separated = self.probabilities(with_itself, with_rival)
        result: Array = np.mean(0.5 * detected * (1.0 + separated), axis=-1)
        return result

    def of(self, chosen: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the products of each coefficient with itself and with its rival, for the poses ``chosen``."""
        search = _PowerSearch(self.part(chosen), np.zeros(chosen.size, dtype=bool), everything=True)
        return search.with_itself, search.with_rival


@dataclass(frozen=True, slots=True)
class ExpectedPower:
    """Mean probabilities over the catalogue at the usual sizes."""

    detected: float
    separated: float
    """Probability that an effect is found and distinguished from its nearest rival."""


def expected_power(problem: PowerProblem, chosen: NDArray[np.int64]) -> ExpectedPower:
    """Return the mean probabilities for the poses ``chosen``."""
    detected, separated = problem.probabilities(*problem.of(chosen))
    return ExpectedPower(float(detected.mean()), float((detected * separated).mean()))


def random_power(problem: PowerProblem, count: int, seed: int) -> ExpectedPower:
    """Return the mean of :func:`expected_power` over random sets of ``count`` candidates."""
    generator = np.random.default_rng([seed, count])
    draws = [
        expected_power(problem, generator.choice(problem.rows.shape[1], count, replace=False))
        for _ in range(_RANDOM_DRAWS)
    ]
    return ExpectedPower(float(np.mean([d.detected for d in draws])), float(np.mean([d.separated for d in draws])))


def choose_for_power(problem: PowerProblem, count: int, seed: int) -> NDArray[np.int64]:
    """Return ``count`` different candidates: the best of a greedy and a random design, improved by exchange."""
    n = problem.rows.shape[1]
    generator = np.random.default_rng([seed, 5])
    pool = np.sort(generator.permutation(n)[: max(_CANDIDATES, count)])
    part = problem.part(pool)
    search = _PowerSearch(part, np.ones(pool.size, dtype=bool))
    greedy = np.array([search.add_best() for _ in range(min(count, pool.size))], dtype=np.int64)
    random = generator.choice(pool.size, greedy.size, replace=False)
    start = max((greedy, random), key=lambda at: float(problem.value(*part.of(at))))
    others = np.setdiff1d(np.arange(pool.size), start)
    others = others[generator.permutation(others.size)[:_EXCHANGED]]
    limited = np.concatenate((start, others))
    result: NDArray[np.int64] = pool[limited[_exchanged(part.part(limited), start.size)]]
    return result


def _exchanged(problem: PowerProblem, count: int) -> NDArray[np.int64]:
    """Improve the design of the first ``count`` candidates: each gives way to the best other, if that is better."""
    chosen = np.arange(count)
    search = _PowerSearch(problem, np.arange(problem.rows.shape[1]) >= count, chosen=chosen)
    value = search.value
    for _ in range(_PASSES):
        start = value
        for place in range(count):
            before, removed = search.state(), int(chosen[place])
            search.change(removed, -1.0)
            search.free[removed] = True
            added = search.add_best()
            if added != removed and search.value > value:
                chosen[place], value = added, search.value
            else:
                search.free[added], search.free[removed] = True, False
                search.restore(before)
        if value - start <= _LEAST_GAIN * value:
            break
    return chosen


class _PowerSearch:
    """State of a search: the free effects' information, the catalogue's regression on them, and its products."""

    def __init__(
        self,
        problem: PowerProblem,
        free: NDArray[np.bool_],
        chosen: NDArray[np.int64] | None = None,
        everything: bool = False,
    ) -> None:
        self.problem, self.free = problem, free
        at = np.arange(problem.rows.shape[1]) if everything else chosen
        information, with_free = problem.information, problem.with_free
        with_itself = np.diag(problem.products)
        with_rival = problem.products[np.arange(with_itself.size), problem.rival]
        if at is not None:
            rows = problem.rows[:, at].reshape(-1, problem.rows.shape[2])
            columns = problem.effects[:, at].reshape(-1, problem.effects.shape[2])
            information, with_free = information + rows.T @ rows, with_free + rows.T @ columns
            with_itself = with_itself + np.sum(np.square(columns), axis=0)
            with_rival = with_rival + np.sum(columns * columns[:, problem.rival], axis=0)
        self.information = information
        self.covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        self.solution = self.covariance @ with_free
        self.with_itself = with_itself - np.sum(with_free * self.solution, axis=0)
        self.with_rival = with_rival - np.sum(with_free * self.solution[:, problem.rival], axis=0)
        if not everything:
            self.residual = problem.effects - problem.rows @ self.solution

    @property
    def value(self) -> float:
        """Return the criterion of the present design."""
        return float(self.problem.value(self.with_itself, self.with_rival))

    def state(self) -> tuple[Array, ...]:
        """Return the state without the free candidates."""
        return self.information, self.covariance, self.solution, self.with_itself, self.with_rival, self.residual

    def restore(self, state: tuple[Array, ...]) -> None:
        """Return to a state."""
        self.information, self.covariance, self.solution, self.with_itself, self.with_rival, self.residual = state

    def change(self, index: int, sign: float) -> None:
        """Add (``sign`` 1) or remove (-1) a pose."""
        rows, residual = self.problem.rows[:, index], self.residual[:, index]
        span = self.covariance @ rows.T
        inverse = sign * np.linalg.inv(np.eye(rows.shape[0]) + sign * rows @ span)
        gained = inverse @ residual
        self.with_itself = self.with_itself + np.sum(residual * gained, axis=0)
        self.with_rival = self.with_rival + np.sum(residual * gained[:, self.problem.rival], axis=0)
        self.solution = self.solution + span @ gained
        # Anew, as rounding in updates of a covariance adds up.
        self.information = self.information + sign * rows.T @ rows
        self.covariance = np.asarray(np.linalg.inv(self.information), dtype=np.float64)
        self.residual = self.residual - (self.problem.rows @ span) @ gained

    def add_best(self) -> int:
        """Add the best free candidate and return its number."""
        at = np.flatnonzero(self.free)
        rows, residual = self.problem.rows[:, at], self.residual[:, at]
        gain = np.einsum("inp,jnp->nij", rows @ self.covariance, rows)
        factor = np.linalg.inv(np.linalg.cholesky(np.eye(rows.shape[0]) + gain))
        white = np.einsum("nij,jnk->ink", factor, residual)
        with_itself = self.with_itself + np.sum(np.square(white), axis=0)
        with_rival = self.with_rival + np.sum(white * white[:, :, self.problem.rival], axis=0)
        best = int(at[np.argmax(self.problem.value(with_itself, with_rival))])
        self.free[best] = False
        self.change(best, 1.0)
        return best


def power_problem(
    model: Model, candidates: Measurements, noise: ExpectedNoise, already: Measurements | None
) -> PowerProblem:
    """Return the problem of choosing among ``candidates``, whose directions and speeds of approach are random.

    ``already`` has the commanded part of the poses measured already.
    """
    data = with_targets(model.arm.robot, candidates)
    terms, sizes, log_priors = _terms(model, data)
    rows = pose_rows(_design_columns(model, data, noise, terms), max(len(model.arm.robot.targets), 1))
    count = rows.shape[2] - len(terms)
    planned = coefficients(model, rows[:, :, :count])
    free, effects = rows[:, :, planned.columns] * planned.prior_std, rows[:, :, count:] * sizes
    products = np.zeros((sizes.size, sizes.size))
    information, with_free = np.eye(planned.columns.size), np.zeros((planned.columns.size, sizes.size))
    n_already = 0
    if already is not None and already.q is not None:
        n_already = already.n
        columns = np.moveaxis(_design_columns(model, already, noise, _terms_like(model, already, terms)), 1, 2)
        measured = (columns[:, :, planned.columns] * planned.prior_std).reshape(-1, planned.columns.size)
        effect_rows = (columns[:, :, count:] * sizes).reshape(-1, sizes.size)
        information, with_free = information + measured.T @ measured, measured.T @ effect_rows
        products = effect_rows.T @ effect_rows
    dof = float(rows.shape[0] * max(n_already + 30, 60) - planned.columns.size)
    chance = {value: decisive_test(1, dof, value).noncentrality_at_limit for value in set(log_priors)}
    even_chance = np.array([chance[value] for value in log_priors])
    return PowerProblem(free, effects, information, with_free, products, even_chance, _rivals(free, effects))


def _rivals(free: Array, effects: Array) -> NDArray[np.int64]:
    """Return ``(K,)`` the coefficient whose column is most similar over all candidates, exact equals excepted."""
    rows, columns = free.reshape(-1, free.shape[2]), effects.reshape(-1, effects.shape[2])
    basis = np.linalg.qr(rows)[0]
    new = columns - basis @ (basis.T @ columns)
    size = np.linalg.norm(new, axis=0)
    is_new = size > np.sqrt(_EXACT) * np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    new = new / np.where(is_new, size, np.inf)
    similarity = np.square(new.T @ new)
    similarity[similarity > 1.0 - _EXACT] = 0.0
    rival = np.argmax(similarity, axis=1)
    result: NDArray[np.int64] = np.where(similarity.max(axis=1) > 0.0, rival, np.arange(rival.size))
    return result


def _terms(model: Model, data: Measurements) -> tuple[dict[str, Term], Array, list[float]]:
    """Return the terms of all named effects that these poses can show, each once, their usual sizes and log priors."""
    pool, _ = named_candidates(model.arm, data, model.free)
    terms: dict[str, Term] = {}
    sizes: list[float] = []
    log_priors: list[float] = []
    for candidate in pool:
        for term in candidate.terms:
            key = candidate.effect.term_key(term)
            if key not in terms:
                terms[key] = term
                sizes.append(usual_size(candidate.effect.name))
                log_priors.append(candidate.log_prior_of_size)
    return terms, np.array(sizes), log_priors


def _terms_like(model: Model, data: Measurements, wanted: dict[str, Term]) -> dict[str, Term]:
    """Return the same terms for other poses; one that these poses do not have is zero there."""
    available, _, _ = _terms(model, data)
    return {key: available.get(key, dataclasses.replace(term, parts=())) for key, term in wanted.items()}


def _design_columns(model: Model, data: Measurements, noise: ExpectedNoise, terms: dict[str, Term]) -> Array:
    """Return whitened columns ``(M, P, N)`` of the free effects, then of ``terms``."""
    bound = model.bind(data)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *terms.values()))
    rows = 3 if noise.orientation is None else 6
    return whitened(model, data, noise, extended.linearise(np.zeros(len(extended.terms)))[1][:rows])
