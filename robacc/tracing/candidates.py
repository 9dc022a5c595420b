"""What competes: every effect of the catalogue in every form, periodic errors of any order, corrections of any driver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Term, commanded
from robacc.effects.joint_correction import JointCorrection
from robacc.effects.transmission_error import TransmissionError
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

ORDER_STEP = 0.25
HIGHEST_ORDER = 40.0
PROFILE_ORDERS = tuple(float(order) for order in range(1, 37))
_SHRUNK_AGAINST_NAMED = 1e-3
"""Prior odds of a rich block against a named term of its own family: asked for only where the data insist."""


@dataclass(frozen=True)
class Candidate:
    """One effect in one form, with its columns."""

    effect: Effect
    terms: tuple[Term, ...]
    log_prior: float
    """Log of its prior probability: families share it evenly, and the members of each."""

    @property
    def weights(self) -> Array:
        """``(q,)`` prior standard deviation of each coefficient relative to the others."""
        block = any(term.group is not None for term in self.terms)
        return np.array([term.weight if term.group or not block else 4.0 for term in self.terms]) * np.array(
            [1.0 if block else term.typical for term in self.terms]
        )

    @property
    def is_block(self) -> bool:
        """Whether its coefficients are shrunk."""
        return any(term.group is not None for term in self.terms)

    @property
    def is_correction(self) -> bool:
        """Whether it is a block that was asked for only because named terms did not do."""
        return self.is_block and self.effect.settings().get("masses") is None


@dataclass(frozen=True)
class Waves:
    """Periodic errors of one joint over a grid of orders, evaluated without building a column each."""

    joint: str
    number: int
    orders: Array
    basis: Array
    """``(2 K, N)``: cosine and sine of each order."""
    angle: Array
    """``(N,)`` rad"""
    log_prior: float


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
        if name == JointCorrection.name or (only is not None and name not in only):
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
    count = max(len(families), 1) + 1
    candidates = []
    for forms in families.values():
        for effect in forms:
            try:
                terms = effect.terms(arm, data)
            except UsageError as error:
                missing[effect.name] = str(error)
                continue
            odds = math.log(_SHRUNK_AGAINST_NAMED) if any(term.group for term in terms) else 0.0
            if effect.settings().get("masses") in ("uncertain", "unknown"):
                odds = 0.0
            candidates.append(Candidate(effect, terms, -math.log(count * len(forms)) + odds))
    return candidates, missing


def waves(arm: Arm, data: Measurements, only: Sequence[str] | None = None) -> list[Waves]:
    """For each joint that turns, the orders its poses can show."""
    if only is not None and TransmissionError.name not in only:
        return []
    q = commanded(data, TransmissionError.name)
    names = TransmissionError.possible_joints(arm)
    result = []
    for joint in names:
        angle = q[arm.number(joint)]
        orders = supported_orders(angle)
        if orders.size == 0:
            continue
        phase = orders[:, None] * angle
        basis = np.concatenate((np.cos(phase), np.sin(phase)))
        # Neighbours of the grid say the same: what counts as independent are orders one period of the range apart.
        independent = max(1.0, float(np.ptp(angle)) / (2 * np.pi) * (orders[-1] - orders[0]))
        result.append(Waves(joint, arm.number(joint), orders, basis, angle, -math.log(20.0 * len(names) * independent)))
    return result


def supported_orders(angle: Array) -> Array:
    """Orders between one period over the range seen and what the spacing of the poses supports.

    Randomly spaced angles have no Nyquist order; the limit is that of the closest tenth of the gaps.
    """
    values = np.unique(np.round(angle, 6))
    if values.size < 8:
        return np.zeros(0)
    reach = float(values[-1] - values[0])
    gap = float(np.quantile(np.diff(values), 0.1))
    highest = min(HIGHEST_ORDER, np.pi / max(gap, 1e-6))
    lowest = max(ORDER_STEP, np.pi / reach)
    first = math.ceil(lowest / ORDER_STEP) * ORDER_STEP
    return np.arange(first, highest + 1e-9, ORDER_STEP)


def profiles(arm: Arm, data: Measurements, only: Sequence[str] | None = None) -> list[Candidate]:
    """For each joint that turns, its whole periodic profile as one shrunk block."""
    if only is not None and TransmissionError.name not in only:
        return []
    q = commanded(data, TransmissionError.name)
    names = TransmissionError.possible_joints(arm)
    result = []
    for joint in names:
        supported = supported_orders(q[arm.number(joint)])
        orders = tuple(order for order in PROFILE_ORDERS if supported.size and order <= supported[-1])
        if len(orders) < 3:
            continue
        effect = TransmissionError((joint,), orders, True)
        prior = -math.log(20.0 * len(names)) + math.log(_SHRUNK_AGAINST_NAMED)
        result.append(Candidate(effect, effect.terms(arm, data), prior))
    return result


def corrections(arm: Arm, data: Measurements) -> list[Candidate]:
    """Empirical corrections: every joint, every driver and pair of drivers."""
    effects = list(JointCorrection.candidates(arm, data))
    prior = -math.log(20.0 * max(len(effects), 1)) + math.log(_SHRUNK_AGAINST_NAMED)
    return [Candidate(effect, effect.terms(arm, data), prior) for effect in effects]


def _is_whole(effect: Effect) -> bool:
    """Whether an effect that is free leaves no other form of itself to compete: constants as a whole."""
    return effect.is_constant and not effect.settings()
