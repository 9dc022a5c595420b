"""Choice of poses on which a trace finds every effect at its usual size, and distinguishes it from its rivals.

Given the free effects, a coefficient k of the usual size has the noncentrality v_k, the squared length of its whitened
column orthogonal to theirs. A trace finds it with a probability near Phi(sqrt(v_k) - sqrt(c_k)), where c_k is the
noncentrality at probability 1/2. Given its nearest rival r as well, v_k - c_kr^2 / v_r remains; from twice the evidence
that makes a rival an alternative, the two are distinguishable. The design maximises the mean of the two probabilities.

With x = C A^T b the regression of the columns b on the free ones A, pose n adds r^T (I + A_n C A_n^T)^-1 r to the
products of the columns, r = b_n - A_n x; recursive least squares updates x (Å. Björck, "Numerical Methods for Least
Squares Problems", 1996, section 3.2).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Term
from robacc.error_model.estimate import ACCEPTED
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.detectability import usual_size
from robacc.planning.linear_model import ExpectedNoise, coefficients, pose_rows, whitened, with_targets
from robacc.tracing.candidates import named_candidates
from robacc.tracing.detection import decisive_test

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
    rows = pose_rows(_columns(model, data, noise, terms), max(len(model.arm.robot.targets), 1))
    count = rows.shape[2] - len(terms)
    planned = coefficients(model, rows[:, :, :count])
    free, effects = rows[:, :, planned.columns] * planned.prior_std, rows[:, :, count:] * sizes
    products = np.zeros((sizes.size, sizes.size))
    information, with_free = np.eye(planned.columns.size), np.zeros((planned.columns.size, sizes.size))
    n_already = 0
    if already is not None and already.q is not None:
        n_already = already.n
        columns = np.moveaxis(_columns(model, already, noise, _terms_like(model, already, terms)), 1, 2)
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


def _columns(model: Model, data: Measurements, noise: ExpectedNoise, terms: dict[str, Term]) -> Array:
    """Return whitened columns ``(M, P, N)`` of the free effects, then of ``terms``."""
    bound = model.bind(data)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *terms.values()))
    rows = 3 if noise.orientation is None else 6
    return whitened(model, data, noise, extended.linearise(np.zeros(len(extended.terms)))[1][:rows])
