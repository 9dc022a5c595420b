"""Candidates: every effect of the catalogue in every form, periodic errors of any order, steps, lines of sight."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Term, commanded
from robacc.effects.instrument import LineOfSight, Place, first_places, lines_of_sight, neighbours
from robacc.effects.periodic import (
    HIGHEST_OF_ALL,
    HIGHEST_OF_SLIDE,
    ORDER_STEP,
    PERIODIC,
    high_orders,
    of_order,
    searched_order,
    supported_orders,
)
from robacc.effects.step import (
    CHANGE_POINT,
    FEWEST,
    at_place,
    is_step,
    place_of,
    places,
    possible_places,
    step_forms,
)
from robacc.errors import UsageError
from robacc.fitting.visits import visit_numbers
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

TYPICAL_CANDIDATES = 80.0
"""Effects times joints on a six-axis arm: the number of candidates that a searched order or place is up against."""
PROFILE_ORDERS = tuple(float(order) for order in range(1, 37))
"""Orders of a joint's complete profile in a model file."""
_STEP_PLACES = 40
"""Largest number of places at which a step is tried first; those between them are tried beside a step that is found."""
_PEAKS = 6
"""Peaks of a joint's spectrum that become candidates."""
_LEAST_GAIN = 1.0
"""Gain of a peak, in units of log likelihood, below which it is noise."""
_TIME_FACTORS = (0.7, 0.9, 1.1, 1.4)
"""Factors of a time constant that are tried beside one in the model; the first tried are a factor of 2 apart."""
_PLACE_STEPS = (0.25, 0.06, 0.015)
"""Steps of the refinement of an instrument's place, rad and log distance; the grid's spacing is twice the first."""


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
        first = self.terms[0].typical
        scales = np.geomspace(low / first, 1e3 * high / first, _SCALES)
        weight = np.minimum(1.0, np.sqrt(2.0 * high / first / scales))
        return scales, np.log(weight / weight.sum())

    @property
    def log_prior_of_size(self) -> float:
        """Return the log prior probability of the candidate at its most probable size."""
        return self.log_prior + float(np.max(self.scales[1]))


_SCALES = 12
"""Number of sizes that the evidence is averaged over, a factor of 3 to 5 apart."""


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
        if reason is not None:
            missing[name] = reason
            continue
        if (reason := cls.missing_form(arm, data)) is not None:
            missing[name] = reason
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
    for forms in families.values():
        for effect in forms:
            try:
                terms = effect.terms(arm, data)
            except UsageError as error:
                missing[effect.name] = str(error)
                continue
            share = len(units) * units[effect.name, effect.joints]
            candidates.append(Candidate(effect, terms, math.log(effect.prior_odds / share)))
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
    is_high: bool = False
    """Whether the orders are above the usual."""

    @cached_property
    def _wave(self) -> NDArray[np.complex128]:
        """Return ``(K, N)`` each order over the poses."""
        return np.exp(1j * np.multiply.outer(self.orders, self.angle))

    def peaks(self, residual: Array, square: Array) -> Array:
        """Return the orders where the residual's spectrum has its largest peaks.

        Args:
            residual: ``(N,)`` J'P y, the weighted residual along the joint.
            square: ``(N,)`` squared whitened column of the joint. The gain of an order is nearly its squared amplitude
                over their sum.
        """
        gain = np.square(np.abs(self._wave @ residual)) / max(float(np.sum(square)), 1e-300)
        ends = np.concatenate(([-1.0], gain, [-1.0]))
        at = np.flatnonzero((gain >= ends[:-2]) & (gain >= ends[2:]) & (gain > _LEAST_GAIN))
        peaks: Array = self.orders[at[np.argsort(-gain[at], kind="stable")[:_PEAKS]]]
        return peaks


def order_grids(arm: Arm, data: Measurements) -> Iterator[OrderGrid]:
    """Yield the usual orders of each joint, and those above."""
    q = commanded(data, PERIODIC)
    for joint in arm.names:
        angle = q[arm.number(joint)]
        largest = HIGHEST_OF_ALL if arm.is_revolute(joint) else HIGHEST_OF_SLIDE
        for is_high, supported in enumerate((supported_orders(angle), high_orders(angle, largest))):
            orders = supported[(supported != 1.0) & (supported != 2.0)]
            if orders.size:
                # Neighbours of the grid are redundant: orders half a period of the range apart count as independent.
                independent = max(1.0, 2 * float(np.ptp(angle)) / (2 * np.pi) * (orders[-1] - orders[0]))
                log_prior = -math.log(TYPICAL_CANDIDATES * independent)
                yield OrderGrid(joint, arm.number(joint), orders, angle, log_prior, bool(is_high))


def step_candidates(arm: Arm, data: Measurements, log_prior: float) -> Iterator[Candidate]:
    """Yield steps of every form at places over the campaign."""
    _, between = places(data, visit_numbers(data))
    between = between[FEWEST - 1 : len(between) - FEWEST + 1]
    if not between.size:
        return
    for form in step_forms(arm, data):
        possible = possible_places(form, between)
        few = possible[
            np.unique(np.linspace(0, possible.size - 1, min(possible.size, _STEP_PLACES)).round().astype(int))
        ]
        for place in few.tolist():
            yield _candidate(at_place(form, place, data), arm, data, log_prior - math.log(few.size))


def sight_candidates(arm: Arm, data: Measurements) -> Iterator[Candidate]:
    """Yield effects of the line of sight from places about the poses where the instrument may stand."""
    position, _ = lines_of_sight(arm, data, "a line of sight")
    grid = first_places(position)
    for cls in REGISTRY.values():
        if issubclass(cls, LineOfSight) and data.n > 1:
            forms = list(cls().forms())
            for form in forms:
                log_prior = -math.log(TYPICAL_CANDIDATES * len(forms) * len(grid))
                yield from (_candidate(form.at(_rounded(place)), arm, data, log_prior) for place in grid)


class Pool:
    """All candidates on given poses: those of the start, and forms beside an effect in the model."""

    def __init__(self, arm: Arm, data: Measurements, present: Sequence[Effect], only: Sequence[str] | None) -> None:
        """Make the candidates of the start; ``only`` restricts them to effects of those names."""
        self.arm, self.data, self.only = arm, data, only
        named, self.missing = named_candidates(arm, data, present, only)
        self.named = tuple(named)
        """Forms of the catalogue, without those that a search makes."""
        self.all = list(named)
        units = max(len({candidate.effect_name for candidate in named}), 1)
        if self._allows(CHANGE_POINT):
            self.all += step_candidates(arm, data, -math.log(3.0 * units))
        self.all += [c for c in sight_candidates(arm, data) if self._allows(c.effect.name)]
        self.grids = tuple(order_grids(arm, data)) if self._allows(PERIODIC) else ()
        self._numbers = {candidate.key: number for number, candidate in enumerate(self.all)}
        self._extended: set[tuple[object, ...]] = set()

    def _allows(self, name: str) -> bool:
        return self.only is None or name in self.only

    def add(self, forms: Iterable[tuple[Effect, float]]) -> None:
        """Add effects with their log priors, unless they are candidates already."""
        for form, log_prior in forms:
            if form.key() not in self._numbers:
                self._numbers[form.key()] = len(self.all)
                self.all.append(_candidate(form, self.arm, self.data, log_prior))

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
            if self._allows(name):
                beside = cls.beside(effect, self.arm, self.data)
                forms += [(form, math.log(form.prior_odds / TYPICAL_CANDIDATES)) for form in beside]
        self.add(forms)

    def _settings_near(self, effect: Effect) -> Iterator[Effect]:
        """Yield the effect with other settings near its own: its order, its place in time or in space."""
        yield from effect.refinements(self.arm, self.data)
        if isinstance(effect, LineOfSight):
            centre = lines_of_sight(self.arm, self.data, effect.name)[0].mean(axis=1)
            for step in _PLACE_STEPS:
                yield from (effect.at(_rounded(place)) for place in neighbours(np.array(effect.place), centre, step))
        elif is_step(effect):
            between = possible_places(effect, places(self.data, visit_numbers(self.data))[1])
            nearest = between[np.argsort(np.abs(between - place_of(effect)), kind="stable")[:20]]
            yield from (at_place(effect, place, self.data) for place in nearest.tolist())
        elif (constant := getattr(effect, "time_constant", None)) is not None:
            near_constants = [float(f"{constant * factor:.4g}") for factor in _TIME_FACTORS]
            yield from (dataclasses.replace(effect, time_constant=other) for other in near_constants)  # type: ignore[call-arg]
        elif (order := searched_order(effect)) is not None:
            on_grid = abs(order / ORDER_STEP - round(order / ORDER_STEP)) < 1e-6
            step = ORDER_STEP / (4.0 if on_grid else 16.0)
            near = [round(order + k * step, 4) for k in (-2, -1, 1, 2)]
            yield from (of_order(effect.joints[0], other) for other in near if other > 0)


def _candidate(effect: Effect, arm: Arm, data: Measurements, log_prior: float) -> Candidate:
    return Candidate(effect, effect.terms(arm, data), log_prior)


def _rounded(place: Array) -> Place:
    """Return a place to the millimetre."""
    x, y, z = (round(float(value), 3) for value in place)
    return (x, y, z)
