"""Candidates: every effect of the catalogue in every form, periodic errors of any order, empirical corrections."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Term, commanded
from robacc.effects.orders import HIGHEST_OF_ALL, HIGHEST_OF_SLIDE, high_orders, supported_orders
from robacc.effects.periodic import PERIODIC, periodic_joints, profile
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

PROFILE_ORDERS = tuple(float(order) for order in range(1, 37))
"""Orders of a joint's complete profile."""
TYPICAL_CANDIDATES = 80.0
"""Effects times joints on a six-axis arm: the number of candidates that a searched order or a block is up against."""
_SHRUNK_AGAINST_NAMED = 1e-3
"""Prior odds of a rich block against a named term of its family: small, so that only clear data select it."""
BLOCK_LOG_PRIOR = math.log(_SHRUNK_AGAINST_NAMED / TYPICAL_CANDIDATES)
"""Log prior probability of a joint's rich block."""
_LEAST_ORDERS = 3
"""Orders below which a complete profile is no more than its named harmonics."""


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

    def covers(self, other: Candidate, ranges: Mapping[str, float]) -> bool:
        """Return whether this candidate makes another redundant: the same, or an order of the joint's complete profile.

        ``ranges`` is the measured range of each joint. Over more than a turn whole orders do not reproduce the orders
        between them, so those orders remain candidates.
        """
        return self.effect.covers(other.effect, ranges)

    @cached_property
    def weights(self) -> Array:
        """``(q,)`` usual size of each coefficient: its prior's standard deviation up to a common factor."""
        free = 4.0 if self.is_block else 1.0
        return np.array([term.typical * (term.weight if term.group else free) for term in self.terms])

    @cached_property
    def is_block(self) -> bool:
        """Return whether its coefficients are shrunk."""
        return any(term.group is not None for term in self.terms)

    @cached_property
    def is_correction(self) -> bool:
        """Return whether it is a block that is tried only if named terms are insufficient."""
        return self.effect.is_profile()


@dataclass(frozen=True, eq=False)
class OrderGrid:
    """Periodic errors of one joint over a grid of orders."""

    joint: str
    number: int
    orders: Array
    """``(K,)`` evenly spaced."""
    angle: Array
    """``(N,)`` rad, or m of a slide."""
    log_prior: float


@dataclass(frozen=True)
class Batch:
    """Rich blocks of equal joint and size, which are scored together and without building their columns."""

    number: int
    candidates: tuple[Candidate, ...]
    basis: Array
    """``(B, Q, N)`` regressors times weights."""


def named_candidates(
    arm: Arm, data: Measurements, present: Sequence[Effect], only: Sequence[str] | None = None
) -> tuple[list[Candidate], dict[str, str]]:
    """Return every named form that these data allow, and the reason why others are missing.

    A reason may concern the usual form of an effect alone. ``only`` restricts to effects of those names. Forms that
    ``present`` contains already, and frames and constants that are completely free, are no candidates.
    """
    whole_constants = {
        (effect.name, joint) for effect in present for joint in (effect.joints or ("",)) if _is_whole(effect)
    }
    keys = {effect.key() for effect in present}
    families: dict[str, list[Effect]] = {}
    missing: dict[str, str] = {}
    for name, cls in REGISTRY.items():
        if cls.is_empirical or (only is not None and name not in only):
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


def _periodic_angles(arm: Arm, data: Measurements, only: Sequence[str] | None) -> Iterator[tuple[str, Array]]:
    """Yield joints and their variables ``(N,)``, rad or m; none if periodic errors are not among ``only``."""
    if only is None or PERIODIC in only:
        q = commanded(data, PERIODIC)
        for joint in periodic_joints(arm):
            yield joint, q[arm.number(joint)]


def order_grids(
    arm: Arm, data: Measurements, only: Sequence[str] | None = None, *, high: bool = False
) -> list[OrderGrid]:
    """Return, for each joint, the orders that its poses can identify; with ``high`` those above the usual."""
    result = []
    for joint, angle in _periodic_angles(arm, data, only):
        largest = HIGHEST_OF_ALL if arm.is_revolute(joint) else HIGHEST_OF_SLIDE
        orders = high_orders(angle, largest) if high else supported_orders(angle)
        if orders.size == 0:
            continue
        # Neighbours of the grid are redundant: orders half a period of the range apart count as independent.
        independent = max(1.0, 2 * float(np.ptp(angle)) / (2 * np.pi) * (orders[-1] - orders[0]))
        result.append(OrderGrid(joint, arm.number(joint), orders, angle, -math.log(TYPICAL_CANDIDATES * independent)))
    return result


def profiles(arm: Arm, data: Measurements, only: Sequence[str] | None = None) -> list[Candidate]:
    """Return, for each rotary joint, its complete periodic profile as a shrunk block."""
    result = []
    for joint, angle in _periodic_angles(arm, data, only):
        supported = supported_orders(angle)
        orders = tuple(order for order in PROFILE_ORDERS if supported.size and order <= supported[-1])
        if len(orders) < _LEAST_ORDERS or not arm.is_revolute(joint):
            continue
        effect = profile(joint, orders)
        result.append(Candidate(effect, effect.terms(arm, data), BLOCK_LOG_PRIOR))
    return result


def corrections(arm: Arm, data: Measurements, only: Sequence[str] | None = None) -> list[Candidate]:
    """Return the empirical corrections: every joint, every driver and pair of drivers."""
    effects = [
        effect
        for cls in REGISTRY.values()
        if cls.is_empirical and (only is None or cls.name in only)
        for effect in cls.candidates(arm, data)
    ]
    prior = -math.log(TYPICAL_CANDIDATES * max(len(effects), 1) / len(arm.names)) + math.log(_SHRUNK_AGAINST_NAMED)
    return [Candidate(effect, effect.terms(arm, data), prior) for effect in effects]


def batches(arm: Arm, candidates: Sequence[Candidate], rows: NDArray[np.int64]) -> list[Batch]:
    """Return blocks sorted by joint and size, on the poses ``rows``."""
    by_joint_and_size: dict[tuple[int, int], list[Candidate]] = {}
    for candidate in candidates:
        by_joint_and_size.setdefault((arm.number(candidate.effect.joints[0]), len(candidate.terms)), []).append(
            candidate
        )
    result = []
    for (number, _), members in by_joint_and_size.items():
        basis = np.stack(
            [
                np.stack(
                    [
                        term.parts[0].factor[rows] * weight  # type: ignore[index]
                        for term, weight in zip(candidate.terms, candidate.weights, strict=True)
                    ]
                )
                for candidate in members
            ]
        )
        result.append(Batch(number, tuple(members), basis))
    return result


def _is_whole(effect: Effect) -> bool:
    """Return whether a free effect excludes all its other forms as candidates: constants as a whole."""
    return effect.is_constant and not effect.settings()
