"""What competes: every effect of the catalogue in every form, periodic errors of any order, empirical corrections."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Term, commanded
from robacc.effects.orders import supported_orders
from robacc.effects.periodic import PERIODIC, periodic_joints, profile
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

PROFILE_ORDERS = tuple(float(order) for order in range(1, 37))
"""Of a joint's whole profile."""
_UNITS = 80.0
"""Effects times joints that compete on a six-axis arm: what a searched order or a block has against it."""
_SHRUNK_AGAINST_NAMED = 1e-3
"""Prior odds of a rich block against a named term of its own family: asked for only where the data insist."""
BLOCK_LOG_PRIOR = math.log(_SHRUNK_AGAINST_NAMED / _UNITS)
"""Of a rich block of one joint."""
_FEWEST_ORDERS = 3
"""Orders below which a whole profile is no more than its named lines."""


@dataclass(frozen=True)
class Candidate:
    """One effect in one form, with its columns."""

    effect: Effect
    terms: tuple[Term, ...]
    log_prior: float
    """Log of its prior probability."""

    @cached_property
    def key(self) -> tuple[object, ...]:
        """What tells it from every other."""
        return self.effect.key()

    def holds(self, other: Candidate, over: Mapping[str, float]) -> bool:
        """Whether it leaves nothing to another: itself, or one order where it is the joint's whole profile.

        ``over`` is the range that each joint was seen in: over more than a turn whole orders do not make up the ones
        between them, so those still compete.
        """
        return self.effect.covers(other.effect, over)

    @cached_property
    def weights(self) -> Array:
        """``(q,)`` usual size of each coefficient: its prior's standard deviation up to a common factor."""
        free = 4.0 if self.is_block else 1.0
        return np.array([term.typical * (term.weight if term.group else free) for term in self.terms])

    @property
    def is_block(self) -> bool:
        """Whether its coefficients are shrunk."""
        return any(term.group is not None for term in self.terms)

    @property
    def is_correction(self) -> bool:
        """Whether it is a block that was asked for only because named terms did not do."""
        return self.effect.is_profile()


@dataclass(frozen=True, eq=False)
class OrderGrid:
    """Periodic errors of one joint over a grid of orders."""

    joint: str
    number: int
    orders: Array
    """``(K,)`` evenly spaced."""
    angle: Array
    """``(N,)`` rad"""
    log_prior: float


@dataclass(frozen=True)
class Batch:
    """Rich blocks of one joint and one size, which are judged together and without building their columns."""

    number: int
    candidates: tuple[Candidate, ...]
    basis: Array
    """``(B, Q, N)`` regressors times weights."""


def named_candidates(
    arm: Arm, data: Measurements, taken: Sequence[Effect], only: Sequence[str] | None = None
) -> tuple[list[Candidate], dict[str, str]]:
    """Every named form that can be offered, and why the other effects cannot.

    ``only`` restricts to effects of those names. Forms that ``taken`` holds already, and frames and constants that are
    free as a whole, do not compete.
    """
    whole = {(effect.name, joint) for effect in taken for joint in (effect.joints or ("",)) if _is_whole(effect)}
    keys = {effect.key() for effect in taken}
    families: dict[str, list[Effect]] = {}
    missing: dict[str, str] = {}
    for name, cls in REGISTRY.items():
        if cls.is_empirical or (only is not None and name not in only):
            continue
        why = cls.missing(arm, data)
        if why is not None:
            missing[name] = why
            continue
        forms = [
            effect
            for effect in cls.candidates(arm, data)
            if effect.key() not in keys and not all((name, joint) in whole for joint in (effect.joints or ("",)))
        ]
        if forms:
            families[name] = forms
    # Every effect on every joint is as likely as any other; the forms of one share its part.
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
            candidates.append(Candidate(effect, terms, -math.log(share)))
    return candidates, missing


def order_grids(arm: Arm, data: Measurements, only: Sequence[str] | None = None) -> list[OrderGrid]:
    """For each joint that turns, the orders its poses can show."""
    if only is not None and PERIODIC not in only:
        return []
    q = commanded(data, PERIODIC)
    names = periodic_joints(arm)
    result = []
    for joint in names:
        angle = q[arm.number(joint)]
        orders = supported_orders(angle)
        if orders.size == 0:
            continue
        # Neighbours of the grid say the same: what counts as independent are orders half a period of the range apart.
        independent = max(1.0, 2 * float(np.ptp(angle)) / (2 * np.pi) * (orders[-1] - orders[0]))
        result.append(OrderGrid(joint, arm.number(joint), orders, angle, -math.log(_UNITS * independent)))
    return result


def profiles(arm: Arm, data: Measurements, only: Sequence[str] | None = None) -> list[Candidate]:
    """For each joint that turns, its whole periodic profile as one shrunk block."""
    if only is not None and PERIODIC not in only:
        return []
    q = commanded(data, PERIODIC)
    names = periodic_joints(arm)
    result = []
    for joint in names:
        supported = supported_orders(q[arm.number(joint)])
        orders = tuple(order for order in PROFILE_ORDERS if supported.size and order <= supported[-1])
        if len(orders) < _FEWEST_ORDERS:
            continue
        effect = profile(joint, orders)
        result.append(Candidate(effect, effect.terms(arm, data), BLOCK_LOG_PRIOR))
    return result


def corrections(arm: Arm, data: Measurements, only: Sequence[str] | None = None) -> list[Candidate]:
    """Empirical corrections: every joint, every driver and pair of drivers."""
    effects = [
        effect
        for cls in REGISTRY.values()
        if cls.is_empirical and (only is None or cls.name in only)
        for effect in cls.candidates(arm, data)
    ]
    prior = -math.log(_UNITS * max(len(effects), 1) / len(arm.names)) + math.log(_SHRUNK_AGAINST_NAMED)
    return [Candidate(effect, effect.terms(arm, data), prior) for effect in effects]


def batches(arm: Arm, candidates: Sequence[Candidate], rows: NDArray[np.int64]) -> list[Batch]:
    """Blocks sorted by joint and size, on the poses ``rows``."""
    sorted_out: dict[tuple[int, int], list[Candidate]] = {}
    for candidate in candidates:
        sorted_out.setdefault((arm.number(candidate.effect.joints[0]), len(candidate.terms)), []).append(candidate)
    result = []
    for (number, _), members in sorted_out.items():
        basis = np.stack(
            [
                np.stack([term.parts[0].factor[rows] * w for term, w in zip(one.terms, one.weights, strict=True)])  # type: ignore[index]
                for one in members
            ]
        )
        result.append(Batch(number, tuple(members), basis))
    return result


def _is_whole(effect: Effect) -> bool:
    """Whether an effect that is free leaves no other form of itself to compete: constants as a whole."""
    return effect.is_constant and not effect.settings()
