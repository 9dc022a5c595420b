"""Candidates, every effect of the catalogue in every form, and the evidence for each beside a model."""

import copy
import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr

from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Term, commanded, settings_of
from robacc.effects.campaign import (
    FEWEST,
    LineOfSight,
    Place,
    Step,
    first_places,
    lines_of_sight,
    neighbours,
    places,
    possible_places,
    step_forms,
)
from robacc.effects.periodic import (
    HIGHEST_OF_ALL,
    HIGHEST_OF_SLIDE,
    HIGHEST_ORDER,
    ORDER_STEP,
    TransmissionError,
    searched_order,
    supported_orders,
)
from robacc.error_model.covariance import Whitened
from robacc.errors import UsageError
from robacc.fitting.levels import ACCEPTED, BEST, BLOCK_NUMBERS, NEW, STEPS
from robacc.fitting.visits import visit_numbers
from robacc.geometry import Array, NDArray
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.statistics.intervals import chi2_sf, f_critical, needed_noncentrality, noncentral_f_sf

TYPICAL_CANDIDATES = 80.0
"""Effects times joints on a six-axis arm: the number of candidates that a searched order or place is up against."""
PROFILE_ORDERS = tuple(float(order) for order in range(1, int(2 * HIGHEST_ORDER) + 1))
"""Orders of a joint's complete profile in a model file: up to twice the highest order that competes as an effect."""


EffectName = tuple[str, tuple[str, ...]]
"""Name of an effect and its joints."""


@dataclass(frozen=True)
class Candidate:
    """An effect in one form, with its terms."""

    effect: Effect
    terms: tuple[Term, ...]
    log_prior: float
    """Log of its prior probability."""

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Identity among all candidates."""
        return self.effect.key()

    @property
    def effect_name(self) -> EffectName:
        """Name and joints of the effect."""
        return self.effect.name, self.effect.joints

    @cached_property
    def sizes(self) -> Array:
        """``(q,)`` usual size of each coefficient."""
        return np.array([term.typical * term.weight for term in self.terms])

    @cached_property
    def scales(self) -> tuple[Array, Array]:
        """Multiples of the usual sizes, and the log prior of each: even within the usual range, falling above it.

        Above the range the prior falls as the root, so that absurd sizes are possible but cost.
        """
        low, high = self.effect.about.usual_range
        first = self.terms[0].typical / self.terms[0].stretch
        return _sizes_averaged(low / first, high / first)

    @property
    def log_prior_of_size(self) -> float:
        """Return the log prior probability of the candidate at its most probable size."""
        return self.log_prior + float(np.max(self.scales[1]))


@lru_cache(maxsize=64)
def _sizes_averaged(low: float, high: float) -> tuple[Array, Array]:
    """Return the multiples of :attr:`Candidate.scales`, a factor of 3 to 5 apart; kept for forms of the same effect."""
    scales = np.geomspace(low, 1e3 * high, 12)
    weight = np.minimum(1.0, np.sqrt(2.0 * high / scales))
    return scales, np.log(weight / weight.sum())


def named_candidates(
    arm: Arm, data: Measurements, present: Sequence[Effect], only: Sequence[str] | None = None
) -> tuple[list[Candidate], dict[str, str]]:
    """Return every named form that these data allow, and the reason why others are missing.

    A reason may concern the usual form of an effect alone. ``only`` restricts to effects of those names. Forms that
    ``present`` contains already, and frames and constants that are completely free, are no candidates.
    """
    whole_constants = {
        (effect.name, joint)
        for effect in present
        for joint in (effect.joints or ("",))
        if effect.traits.is_constant and not effect.settings()  # constants as a whole exclude all their other forms
    }
    keys = {effect.key() for effect in present}
    families: dict[str, list[Effect]] = {}
    missing: dict[str, str] = {}
    for name, cls in REGISTRY.items():
        if cls.traits.is_empirical or (only is not None and name not in only):
            continue
        reason = cls.missing(arm, data)
        if (partly := cls.missing(arm, data, usual=True)) is not None:
            missing[name] = partly
        if reason is not None:
            continue
        forms = [
            effect
            for effect in cls.candidates(arm, data)
            if effect.key() not in keys
            and not all((name, joint) in whole_constants for joint in (effect.joints or ("",)))
        ]
        if forms:
            families[name] = forms
    # Every effect on every joint is equally likely; the forms of an effect share its probability.
    units = Counter((effect.name, effect.joints) for forms in families.values() for effect in forms)
    candidates = []
    for effect in itertools.chain.from_iterable(families.values()):
        try:
            terms = effect.terms(arm, data)
        except UsageError as error:
            missing[effect.name] = str(error)
            continue
        share = len(units) * units[effect.name, effect.joints]
        candidates.append(Candidate(effect, terms, math.log(effect.form.prior_odds / share)))
    return candidates, missing


@dataclass(frozen=True, eq=False)
class OrderGrid:
    """Orders of a periodic error of one joint that its poses can identify."""

    joint: str
    number: int
    orders: Array
    """``(K,)`` evenly spaced."""
    angle: Array
    """``(N,)`` rad, or m of a slide."""
    log_prior: float

    @cached_property
    def _wave(self) -> NDArray[np.complex128]:
        """Return ``(K, N)`` each order over the poses."""
        return np.exp(1j * np.multiply.outer(self.orders, self.angle))

    def peaks(self, residual: Array, square: Array) -> Array:
        """Return the orders where the residual's spectrum has its largest peaks; a gain below 1 is noise.

        Args:
            residual: ``(N,)`` J'P y, the weighted residual along the joint.
            square: ``(N,)`` squared whitened column of the joint. The gain of an order is nearly its squared amplitude
                over their sum.
        """
        gain = np.square(np.abs(self._wave @ residual)) / max(float(np.sum(square)), 1e-300)
        ends = np.concatenate(([-1.0], gain, [-1.0]))
        at = np.flatnonzero((gain >= ends[:-2]) & (gain >= ends[2:]) & (gain > 1.0))
        return np.asarray(self.orders[at[np.argsort(-gain[at], kind="stable")[:BEST]]])


def order_grids(arm: Arm, data: Measurements) -> Iterator[OrderGrid]:
    """Yield the usual orders of each joint, and those above."""
    q = commanded(data, TransmissionError.name)
    for joint in arm.names:
        angle = q[arm.number(joint)]
        supported = supported_orders(angle, HIGHEST_OF_ALL if arm.is_revolute(joint) else HIGHEST_OF_SLIDE)
        is_high = supported > HIGHEST_ORDER
        for orders in (supported[~is_high & (supported != 1.0) & (supported != 2.0)], supported[is_high]):
            if orders.size:
                # Neighbours of the grid are redundant: orders half a period of the range apart count as independent.
                independent = max(1.0, 2 * float(np.ptp(angle)) / (2 * np.pi) * float(np.ptp(orders)))
                log_prior = -math.log(TYPICAL_CANDIDATES * independent)
                yield OrderGrid(joint, arm.number(joint), orders, angle, log_prior)


class Pool:
    """All candidates on given poses: those of the start, and forms beside an effect in the model."""

    def __init__(self, arm: Arm, data: Measurements, present: Sequence[Effect], only: Sequence[str] | None) -> None:
        """Make the candidates of the start; ``only`` restricts them to effects of those names."""
        self.arm, self.data = arm, data
        self._names = set(REGISTRY if only is None else only)
        named, self.missing = named_candidates(arm, data, present, only)
        self.named = tuple(named)
        """Forms of the catalogue, without those that a search makes."""
        self.all = list(named)
        self._numbers = {candidate.key: number for number, candidate in enumerate(named)}
        self.add(self._searched_forms(len({candidate.effect_name for candidate in named})))
        self.grids = tuple(order_grids(arm, data)) if TransmissionError.name in self._names else ()
        self._extended: set[tuple[object, ...]] = set()

    def _searched_forms(self, units: int) -> Iterator[tuple[Effect, float]]:
        """Yield steps at places over the campaign, and lines of sight from places where the instrument may stand."""
        _, between = places(self.data, visit_numbers(self.data))
        between = between[FEWEST - 1 : len(between) - FEWEST + 1]
        if Step.name in self._names and between.size:
            for form in step_forms(self.arm, self.data):
                possible = possible_places(form, between)
                # Those between them are tried beside a step that is found.
                chosen = np.linspace(0, possible.size - 1, min(possible.size, 40)).round().astype(int)
                few = possible[np.unique(chosen)].tolist()
                log_prior = -math.log(3.0 * max(units, 1) * len(few))
                yield from ((form.starting(place, self.data), log_prior) for place in few)
        grid = first_places(lines_of_sight(self.arm, self.data, "a line of sight").translation)
        for name, cls in REGISTRY.items():
            if issubclass(cls, LineOfSight) and name in self._names and self.data.n > 1:
                forms = [
                    dataclasses.replace(cls(), **{declared.field: choice})  # type: ignore[arg-type]
                    for declared in settings_of(cls).values()
                    for choice in declared.choices
                ]
                log_prior = -math.log(TYPICAL_CANDIDATES * len(forms) * len(grid))
                yield from (
                    (dataclasses.replace(form, place=_rounded(place)), log_prior) for form in forms for place in grid
                )

    def add(self, forms: Iterable[tuple[Effect, float]]) -> None:
        """Add effects with their log priors, unless they are candidates already."""
        for form, log_prior in forms:
            if form.key() not in self._numbers:
                self._numbers[form.key()] = len(self.all)
                self.all.append(Candidate(form, form.terms(self.arm, self.data), log_prior))

    def number(self, candidate: Candidate) -> int:
        """Return the place of a candidate in :attr:`all`."""
        return self._numbers[candidate.key]

    def extend(self, candidate: Candidate) -> None:
        """Add the forms that are candidates beside one in the model."""
        if candidate.key in self._extended:
            return
        self._extended.add(candidate.key)
        effect = candidate.effect
        forms = [(form, candidate.log_prior) for form in self._settings_near(effect)]
        for name, cls in REGISTRY.items():
            if name in self._names:
                beside = cls.beside(effect, self.arm, self.data)
                forms += [(form, math.log(form.form.prior_odds / TYPICAL_CANDIDATES)) for form in beside]
        self.add(forms)

    def _settings_near(self, effect: Effect) -> Iterator[Effect]:
        """Yield the effect with other settings near its own: its order, its place in time or in space."""
        yield from effect.refinements(self.arm, self.data)
        if isinstance(effect, LineOfSight):
            centre = lines_of_sight(self.arm, self.data, effect.name).translation.mean(axis=1)
            # rad and log distance; the grid's spacing is twice the first.
            for step in 0.25 ** np.arange(1, 4):
                near_places = neighbours(np.array(effect.place), centre, step)
                yield from (dataclasses.replace(effect, place=_rounded(place)) for place in near_places)
        elif isinstance(effect, Step):
            between = possible_places(effect, places(self.data, visit_numbers(self.data))[1])
            nearest = between[np.argsort(np.abs(between - effect.place), kind="stable")[:20]]
            yield from (effect.starting(place, self.data) for place in nearest.tolist())
        elif (constant := getattr(effect, "time_constant", None)) is not None:
            # The first tried are a factor of 2 apart.
            near_constants = [
                float(f"{constant * factor:.4g}") for factor in (2.0 ** np.array([-0.5, -0.125, 0.125, 0.5]))
            ]
            yield from (dataclasses.replace(effect, time_constant=other) for other in near_constants)  # type: ignore[call-arg]
        elif (order := searched_order(effect)) is not None:
            on_grid = abs(order / ORDER_STEP - round(order / ORDER_STEP)) < 1e-6
            step = ORDER_STEP / (4.0 if on_grid else 16.0)
            near = [round(order + k * step, 4) for k in (-2, -1, 1, 2)]
            yield from (TransmissionError(effect.joints[:1], (other,)) for other in near if other > 0)


def _rounded(place: Array) -> Place:
    """Return a place to the millimetre."""
    x, y, z = (round(float(value), 3) for value in place)
    return (x, y, z)


# Evidence for candidates: the log Bayes factor of adding each to a model, sizes integrated out, and its rivals.
#
# A candidate with columns Z (times the usual sizes) and coefficients u ~ N(0, t^2 I) adds to y'P y a term that depends
# on G = Z'P Z and b = Z'P y alone. With the noise's scale integrated out over v degrees of freedom the log Bayes factor
# is
#
#     -v/2 log(1 - b'(G + I s^2/t^2)^-1 b / y'P y) - 1/2 log|I + G t^2/s^2|,
#
# averaged over a grid of t (:attr:`Candidate.scales`); for one column it depends on one t statistic.


@dataclass(frozen=True)
class Scores:
    """Candidates beside a model."""

    evidence: "Evidence"
    restored: Array
    """``(q, K)`` products that the model of ``evidence`` has beyond this one, which lacks q of its coefficients."""
    products: Array
    """``(K,)`` Z'P y."""
    log_odds: Array
    """``(C,)`` log Bayes factor plus log prior odds; -inf for candidates that the model contains, or not scored."""
    log_bayes: Array
    """``(C,)``"""
    scale: Array
    """``(C,)`` multiple of the usual size with the largest evidence."""
    gain: Array
    """``(C,)`` share of y'P y that the candidate explains at that size."""

    def ranking(self) -> NDArray[np.int64]:
        """Return candidates, best first; equals, which rounding must not order, by number."""
        return np.argsort(-np.round(np.nan_to_num(self.log_odds, neginf=-1e9), 6), kind="stable")

    def fitted(self, number: int) -> Array:
        """Return the least-squares coefficients of a candidate beside the model, in units of the usual sizes."""
        at = self.evidence.places[number]
        new = self.evidence.new(at, at, self.restored)
        return np.asarray(np.linalg.pinv(new, rcond=NEW, hermitian=True) @ self.products[at])

    def similarity(self, *pair: int) -> float:
        """Return the cosine between the least-squares fits of two candidates to the residual beside the model."""
        fits = [(self.fitted(number), self.evidence.places[number]) for number in pair]
        (own, across), (_, other) = (
            [float(fit @ self.evidence.new(a, b, self.restored) @ rival) for rival, b in fits] for fit, a in fits
        )
        return min(max(across / math.sqrt(own * other), -1.0), 1.0) if min(own, other) > 0.0 else 0.0


class Evidence:
    """Scores of candidates beside the effects of a whitened model, and beside all but some of them."""

    def __init__(
        self, white: Whitened, blocks: Iterable[Array], candidates: Sequence[Candidate], numbers: Sequence[int]
    ) -> None:
        """Take the columns ``(N, M, k)`` of the candidates ``numbers``, which are scored, in blocks."""
        self.white = white
        self.rows = np.concatenate([np.empty((0, white.y.size)), *(white.apply(block).T for block in blocks)])
        """``(K, n)`` whitened columns of the candidates."""
        self._reduced = np.ascontiguousarray(
            solve_triangular(white.triangle, (self.rows @ white.columns).T, lower=True).T
        )
        self._inverse = solve_triangular(white.triangle, np.eye(len(white.triangle)), lower=True)
        self._products = self.rows @ white.y - self._reduced @ white.reduced
        self.square = float(white.y @ white.y - white.reduced @ white.reduced)
        """y'P y."""
        self._log_prior = np.array([candidate.log_prior for candidate in candidates])
        self._positive = np.array([candidate.effect.traits.is_nonnegative for candidate in candidates], dtype=bool)
        sizes = np.array([len(candidates[number].terms) for number in numbers], dtype=np.int64)
        own_columns = np.split(np.arange(len(self.rows)), np.cumsum(sizes)[:-1])
        self.places = dict(zip(numbers, own_columns, strict=False))
        """Columns of each candidate that is scored."""
        # Candidates of the same number of coefficients: their numbers, columns (C, q), traces of the products of
        # columns, what is new of these products (C, q, q), and multiples of the usual size with the log prior of each.
        self._groups = []
        for size in np.unique(sizes):
            same = np.asarray(numbers, dtype=np.int64)[sizes == size]
            at = np.array([self.places[number] for number in same.tolist()])
            scales, log_prior = np.stack([candidates[number].scales for number in same.tolist()], axis=1)
            gram = _products(self.rows, at)
            new, trace = gram - _products(self._reduced, at), np.trace(gram, axis1=1, axis2=2)
            self._groups.append((same, at, trace, new, scales, log_prior))

    def new(self, first: NDArray[np.int64], second: NDArray[np.int64], restored: Array | None = None) -> Array:
        """Return the products of some columns with others, less what the model explains; it may lack coefficients."""
        new = self.rows[first] @ self.rows[second].T - self._reduced[first] @ self._reduced[second].T
        return np.asarray(new if restored is None else new + restored[:, first].T @ restored[:, second])

    def effective(self, chosen: NDArray[np.bool_]) -> float:
        """Return how many of the ``chosen`` coefficients ``(P,)`` of the model the data decide, not the prior."""
        return float(np.sum((1.0 - np.sum(np.square(self._inverse), axis=0))[chosen]))

    def beside(self, white: Whitened) -> Scores:
        """Return the scores by the products with P y of another model, the products of columns as beside this one."""
        other = copy.copy(self)
        other._products = self.rows @ self.white.coloured(white.weighted_residual(1)[:, 0])
        other.square = float(white.y @ white.y - white.reduced @ white.reduced)
        return other.scores(np.empty(0, dtype=np.int64), 0.0)

    def scores(self, absent: NDArray[np.int64], flat: float) -> Scores:
        """Return the scores beside the model without ``absent`` columns; the data decide ``flat`` coefficients."""
        directions = np.linalg.qr(self._inverse[:, absent])[0]
        restored, along_y = (self._reduced @ directions).T, directions.T @ self.white.reduced
        products, square = self._products + along_y @ restored, self.square + float(along_y @ along_y)
        dof = max(float(self.white.measured - flat), 1.0)
        count = self._log_prior.size
        log_bayes, scale, gain = np.full(count, -np.inf), np.ones(count), np.zeros(count)
        for numbers, at, trace, new, scales, log_prior in self._groups:
            values, vectors = np.linalg.eigh(new + _products(restored.T, at))
            along = np.einsum("cqr,cq->cr", vectors, products[at])
            seen = values > NEW * trace[:, None]
            values, along = np.where(seen, values, 0.0)[:, None, :], np.where(seen, along, 0.0)[:, None, :]
            noise = np.full(scales.shape, square / dof)
            for _ in range(3):
                precision = (noise / np.square(scales))[:, :, None]
                explained = np.sum(np.square(along) / (values + precision), axis=2)
                noise = np.maximum(square - explained, 1e-9 * square) / dof
            log_scales = -0.5 * dof * np.log(noise * dof / square) - 0.5 * np.sum(np.log1p(values / precision), axis=2)
            if at.shape[1] == 1:
                sign = along[:, :, 0] / np.sqrt((values[:, :, 0] + precision[:, :, 0]) * noise)
                log_scales += np.where(self._positive[numbers][:, None], math.log(2.0) + log_ndtr(sign), 0.0)
            log_scales += log_prior
            best = np.argmax(log_scales, axis=1)
            each = np.arange(best.size)
            log_bayes[numbers] = np.where(seen.any(axis=1), np.logaddexp.reduce(log_scales, axis=1), -np.inf)
            scale[numbers] = scales[each, best]
            gain[numbers] = explained[each, best] / square
        return Scores(self, restored, products, log_bayes + self._log_prior, log_bayes, scale, gain)


def _products(rows: Array, at: NDArray[np.int64]) -> Array:
    """Return the products ``(C, q, q)`` of each of ``C`` sets ``(C, q)`` of rows ``(K, n)``."""
    pieces = np.array_split(at, 1 + 8 * at.size * rows.shape[1] // BLOCK_NUMBERS)
    return np.concatenate([np.einsum("cqn,crn->cqr", rows[piece], rows[piece]) for piece in pieces])


# The test that the evidence amounts to.
#
# An effect of coefficients c whose columns have, given the present model, the new part G (whitened Gram matrix) raises
# the statistic t^2 by c' G c over the noise variance. A search accepts q coefficients from the t^2 on at which the
# evidence at the best prior size, (t^2 - q)/2 - q/2 log(t^2/q), exceeds the prior odds and :data:`ACCEPTED`; an effect
# has its detection limit where the noise takes it there with probability 1/2.


@dataclass(frozen=True, slots=True)
class DecisiveTest:
    """F test at the level that the accepted odds are worth."""

    level: float
    dof: tuple[float, float]
    """Degrees of freedom of the effect and of the residual."""

    @property
    def noncentrality_at_limit(self) -> float:
        """Return the noncentrality at which an effect is found with probability 1/2; infinite without any dof."""
        return math.inf if self.dof[1] <= 0.0 else needed_noncentrality(0.5, self.level, *self.dof)

    def power(self, noncentrality: float) -> float:
        """Return the probability that an effect is found."""
        is_testable = self.dof[1] > 0.0
        return noncentral_f_sf(f_critical(self.level, *self.dof), *self.dof, noncentrality) if is_testable else 0.0


def decisive_test(rank: int, dof: float, log_prior: float) -> DecisiveTest:
    """Return the test that decides about a candidate with ``rank`` new directions.

    Args:
        rank: Number of new directions.
        dof: Degrees of freedom of the residual without the effect.
        log_prior: Log prior probability of the candidate at its most probable size.
    """
    needed = ACCEPTED - log_prior
    # The evidence grows with the statistic by (1 - q / t^2) / 2: Newton steps from above converge.
    statistic = 2.0 * (needed + rank)
    for _ in range(STEPS):
        evidence = 0.5 * (statistic - rank) - 0.5 * rank * math.log(statistic / rank)
        statistic += (needed - evidence) / (0.5 * (1.0 - rank / statistic))
    return DecisiveTest(max(chi2_sf(statistic, float(rank)), 1e-300), (float(rank), float(round(dof) - rank)))


def visible(blocks: Array, lengths: Array) -> tuple[Array, Array]:
    """Return ``(Q,)`` eigenvalues, ascending, and ``(Q, Q)`` eigenvectors of a new part; 0 for explained directions.

    ``lengths`` ``(Q,)`` are the squared lengths of the complete columns.
    """
    values, vectors = np.linalg.eigh(blocks)
    return np.where(values > NEW * max(float(lengths.max()), 1e-300), values, 0.0), vectors
