"""Detection limits and power of every effect at planned poses, and poses chosen for them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import REGISTRY, Term
from robacc.error_model.covariance import ACCEPTED
from robacc.fitting.fit_result import identify_terms
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.design import DesignProblem, choose, information_of, random_designs
from robacc.planning.expected import ExpectedNoise, candidate_rows, coefficients, whitened_rows, with_targets
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
    def label(self) -> str:
        """``backlash[j2]``, with settings."""
        settings = ", ".join(f"{key} {_text(value)}" for key, value in self.settings.items())
        joints = f"[{','.join(self.joints)}]" if self.joints else ""
        return f"{self.effect}{joints}{f' ({settings})' if settings else ''}"


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


def detectability(model: Model, data: Measurements, noise: ExpectedNoise) -> Detectability:
    """Return detection limits given the free effects of ``model``, for the rows of ``data`` in their order."""
    pool, missing = named_candidates(model.arm, data, model.free)
    pool = [c for c in pool if len({term.unit for term in c.terms}) == 1]
    names = [{term.name for term in candidate.terms} for candidate in pool]
    pool = [c for c, terms in zip(pool, names, strict=True) if not any(other < terms for other in names)]
    catalogue = _catalogue(pool)
    number = {key: i for i, key in enumerate(catalogue)}
    rows = whitened_rows(model, data, noise, (term for term, _ in catalogue.values()))
    count = rows.shape[2] - len(catalogue)
    flat = rows.reshape(-1, rows.shape[2])
    identified = identify_terms(np.asarray(np.linalg.qr(flat[:, :count], mode="r")), model.bind(data).terms, data.n)
    columns = flat[:, count:]
    new = _without(flat[:, identified.columns], columns)
    gram = new.T @ new
    lengths = np.sum(np.square(columns), axis=0)
    dof = float(columns.shape[0] - identified.columns.size)
    if dof <= 0:
        return Detectability((), (), missing)
    tested = []
    for candidate in pool:
        effect, first = candidate.effect, candidate.terms[0]
        place = np.array([number[effect.term_key(term)] for term in candidate.terms], dtype=np.int64)
        usual = usual_size(effect.name)
        values, vectors = visible(gram[np.ix_(place, place)], lengths[place])
        size = rms = None
        power = 0.0
        if values[0] > 0:
            test = decisive_test(values.size, dof, candidate.log_prior_of_size)
            needed = test.noncentrality_at_limit
            noncentrality = usual**2 * float(values[0])
            power = 1.0 if noncentrality > _CERTAIN * needed else test.power(noncentrality)
            limit = math.sqrt(needed / float(values[0]))
            if limit <= _LARGEST * first.typical:
                moved = rows[:, :3, count + place] @ vectors[:, 0] * math.hypot(noise.position, noise.unexplained)
                size, rms = limit, limit * rms_length(moved.T)
        tested.append(
            (place, ExpectedLimit(effect.name, effect.joints, effect.settings(), first.unit, size, usual, power, rms))
        )
    return Detectability(tuple(limit for _, limit in tested), _pairs(tested, gram), missing)


def usual_size(effect: str) -> float:
    """Return the geometric mean of the catalogue's usual range of a coefficient."""
    low, high = REGISTRY[effect].about.usual_range
    return math.sqrt(low * high)


def _catalogue(pool: Sequence[Candidate]) -> dict[str, tuple[Term, Candidate]]:
    """Return each coefficient of the candidates once, with the first candidate that has it."""
    result: dict[str, tuple[Term, Candidate]] = {}
    for candidate in pool:
        for term in candidate.terms:
            result.setdefault(candidate.effect.term_key(term), (term, candidate))
    return result


def _without(base: Array, columns: Array) -> Array:
    """Return the part of ``columns`` that is orthogonal to ``base``, taken out twice for the sake of rounding."""
    if base.shape[1] == 0:
        return columns
    basis = np.linalg.qr(base / np.linalg.norm(base, axis=0))[0]
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return columns


def _pairs(tested: Sequence[tuple[NDArray[np.int64], ExpectedLimit]], gram: Array) -> tuple[InseparablePair, ...]:
    """Return the pairs of detectable effects, one form for each effect and joint, that are not distinguishable.

    ``tested`` has the columns of each form in the products ``gram`` of new parts, and its limit.
    """
    first_forms: dict[tuple[str, tuple[str, ...]], tuple[NDArray[np.int64], ExpectedLimit]] = {}
    for place, limit in tested:
        if limit.power >= _DETECTABLE:
            first_forms.setdefault((limit.effect, limit.joints), (place, limit))
    pairs = []
    for (place, limit), (other, rival) in itertools.permutations(first_forms.values(), 2):
        block, cross = gram[np.ix_(place, place)], gram[np.ix_(place, other)]
        explained = cross @ np.linalg.pinv(gram[np.ix_(other, other)], rcond=1e-9) @ cross.T
        remaining = max(float(np.linalg.eigvalsh(block - explained)[0]), 0.0)
        evidence = 0.5 * limit.usual**2 * remaining
        if evidence < ACCEPTED:
            whitener = np.linalg.pinv(block, rcond=1e-12, hermitian=True)
            similarity = math.sqrt(min(max(float(np.linalg.eigvals(whitener @ explained).real.max()), 0.0), 1.0))
            pairs.append(InseparablePair(limit.label, rival.label, similarity, evidence))
    return tuple(sorted(pairs, key=lambda pair: (-round(pair.similarity, 9), pair.evidence)))


# Choice of poses on which a trace finds every effect at its usual size, and distinguishes it from its rivals.
#
# Given the free effects, a coefficient k of the usual size has the noncentrality v_k, the squared length of its
# whitened column orthogonal to theirs. A trace finds it with a probability near Phi(sqrt(v_k) - sqrt(c_k)), where c_k
# is the noncentrality at probability 1/2. Given its nearest rival r as well, v_k - c_kr^2 / v_r remains; from twice
# the evidence that makes a rival an alternative, the two are distinguishable. The design maximises the mean of the
# two probabilities.
#
# The information is that of the free coefficients, then the catalogue's. With x = C A^T b the regression of the
# catalogue's columns b on the free ones A, pose n adds r^T (I + A_n C A_n^T)^-1 r to the products of the columns,
# r = b_n - A_n x (Å. Björck, "Numerical Methods for Least Squares Problems", 1996, section 3.2).

_CANDIDATES = 800
"""Candidates that the search looks at, drawn at random; more gain little."""
_EXCHANGED = 100
_EXACT = 1e-6
"""Share of a column that must remain given a rival: no poses distinguish exact equals."""


@dataclass(frozen=True, slots=True)
class ExpectedPower:
    """Mean probabilities over the catalogue at the usual sizes."""

    detected: float
    separated: float
    """Probability that an effect is found and distinguished from its nearest rival."""


@dataclass(frozen=True, slots=True)
class PowerCriterion:
    """Minus the mean of the probabilities to find a coefficient, and to find it and separate it from its rival."""

    even_chance: Array
    """``(K,)`` noncentrality at which the coefficient is found with probability 1/2."""
    rival: NDArray[np.int64]
    """``(K,)`` nearest rival of each coefficient; itself where it has none."""

    def _regression(self, information: Array) -> tuple[Array, Array, Array, Array]:
        """Return what the free coefficients leave of the catalogue's.

        They are the free ones' covariance ``(P, P)``, the regression ``(P, K)`` of the columns on theirs, and the
        products ``(K,)`` of the new part of each column with itself and with its rival's.
        """
        count = information.shape[0] - self.rival.size
        cross = information[:count, count:]
        covariance: Array = np.asarray(np.linalg.inv(information[:count, :count]), dtype=np.float64)
        solution = covariance @ cross
        new = information[count:, count:] - cross.T @ solution
        return covariance, solution, np.diag(new), new[np.arange(self.rival.size), self.rival]

    def _probabilities(self, with_itself: Array, with_rival: Array) -> tuple[Array, Array]:
        """Return the probabilities ``(...)`` to find a coefficient, and to find and separate it, from ``(..., K)``."""
        from scipy.special import ndtr

        detected = ndtr(np.sqrt(np.maximum(with_itself, 0.0)) - np.sqrt(self.even_chance))
        beside = np.maximum(with_itself - np.square(with_rival) / np.maximum(with_itself[..., self.rival], 1e-12), 0.0)
        separated = ndtr(np.sqrt(beside) - np.sqrt(2.0 * ACCEPTED))
        separated = np.where(self.rival == np.arange(self.rival.size), 1.0, separated)
        return detected.mean(axis=-1), (detected * separated).mean(axis=-1)

    def power(self, information: Array) -> ExpectedPower:
        """Return the mean probabilities."""
        detected, separated = self._probabilities(*self._regression(information)[2:])
        return ExpectedPower(float(detected), float(separated))

    def cost(self, information: Array) -> float:
        """Return minus the mean of the two probabilities."""
        power = self.power(information)
        return -0.5 * (power.detected + power.separated)

    def costs(self, information: Array, rows: Array) -> Array:
        """Return ``(N,)`` the cost with each of the poses ``(N, M, P + K)`` added."""
        covariance, solution, with_itself, with_rival = self._regression(information)
        free, columns = np.split(rows, [covariance.shape[0]], axis=2)
        gain = free @ covariance @ np.swapaxes(free, 1, 2)
        factor = np.linalg.inv(np.linalg.cholesky(np.eye(rows.shape[1]) + gain))
        white = factor @ (columns - free @ solution)
        with_itself = with_itself + np.sum(np.square(white), axis=1)
        with_rival = with_rival + np.sum(white * white[:, :, self.rival], axis=1)
        detected, separated = self._probabilities(with_itself, with_rival)
        return np.asarray(-0.5 * (detected + separated))


@dataclass(frozen=True, slots=True)
class PowerProblem(DesignProblem):
    """Candidates with the columns of the free coefficients, then of the catalogue in units of the usual sizes."""

    criterion: PowerCriterion


def expected_power(problem: PowerProblem, chosen: NDArray[np.int64]) -> ExpectedPower:
    """Return the mean probabilities for the poses ``chosen``."""
    return problem.criterion.power(problem.information_with(chosen))


def random_power(problem: PowerProblem, count: int, seed: int) -> ExpectedPower:
    """Return the mean of :func:`expected_power` over random sets of ``count`` candidates."""
    draws = random_designs(problem.rows.shape[0], count, count, seed)
    powers = [(power.detected, power.separated) for power in (expected_power(problem, draw) for draw in draws)]
    return ExpectedPower(*np.mean(powers, axis=0).tolist())


def choose_for_power(problem: PowerProblem, count: int, seed: int) -> NDArray[np.int64]:
    """Return ``count`` different candidates, chosen among some drawn at random."""
    pool = np.random.default_rng([seed, 5]).permutation(problem.rows.shape[0])[: max(_CANDIDATES, count)]
    part = dataclasses.replace(problem, rows=problem.rows[pool])
    return pool[choose(part, part.best(count), seed, _EXCHANGED)]


def power_problem(
    model: Model, candidates: Measurements, noise: ExpectedNoise, already: Measurements | None
) -> PowerProblem:
    """Return the problem of choosing among ``candidates``, whose directions and speeds of approach are random.

    ``already`` has the commanded part of the poses measured already.
    """
    data = with_targets(model.arm.robot, candidates)
    catalogue = _catalogue(named_candidates(model.arm, data, model.free)[0])
    rows = candidate_rows(model, candidates, noise, (term for term, _ in catalogue.values()))
    count = rows.shape[2] - len(catalogue)
    planned = coefficients(model, rows[:, :, :count])
    n_free, n_effects = planned.columns.size, len(catalogue)
    used = np.concatenate((planned.columns, count + np.arange(n_effects)))
    # In units of the priors, and of the usual sizes.
    scale = np.append(planned.prior_std, [usual_size(candidate.effect.name) for _, candidate in catalogue.values()])
    rows = rows[:, :, used] * scale
    information = np.diag(np.repeat([1.0, 0.0], [n_free, n_effects]))
    n_already = 0
    if already is not None:
        n_already = already.n
        available = _catalogue(named_candidates(model.arm, already, model.free)[0])
        # A term that the poses measured already do not have is zero there.
        terms = [available.get(key, (dataclasses.replace(term, parts=()),))[0] for key, (term, _) in catalogue.items()]
        information += information_of(whitened_rows(model, already, noise, terms)[:, :, used] * scale)
    dof = float(rows.shape[1] * max(n_already + 30, 60) - n_free)
    log_priors = [candidate.log_prior_of_size for _, candidate in catalogue.values()]
    chance = {value: decisive_test(1, dof, value).noncentrality_at_limit for value in set(log_priors)}
    flat = rows.reshape(-1, scale.size)
    criterion = PowerCriterion(
        np.array([chance[value] for value in log_priors]), _rivals(flat[:, :n_free], flat[:, n_free:])
    )
    return PowerProblem(rows, information, criterion)


def _rivals(free: Array, columns: Array) -> NDArray[np.int64]:
    """Return ``(K,)`` the coefficient whose column is most similar over all candidates, exact equals excepted."""
    new = _without(free, columns)
    size = np.linalg.norm(new, axis=0)
    is_new = size > np.sqrt(_EXACT) * np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    new = new / np.where(is_new, size, np.inf)
    similarity = np.square(new.T @ new)
    similarity[similarity > 1.0 - _EXACT] = 0.0
    rival = np.argmax(similarity, axis=1)
    return np.asarray(np.where(similarity.max(axis=1) > 0.0, rival, np.arange(rival.size)))
