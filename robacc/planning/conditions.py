"""Circumstances of planned poses before their order is known: payload, approach, temperature."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.candidates import CandidatePoses

_ROOM_TEMPERATURE = 20.0
"""Degrees Celsius; where a known effect of the model depends on the temperature."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Circumstances of poses whose order is not known yet."""

    payloads: tuple[float, ...]
    """kg; empty where no effect depends on the payload."""
    temperature: float | None
    """Degrees Celsius; None where no effect of the model depends on it."""
    seed: int

    def at(self, q: Array, payload: Array | None, stream: int = 4) -> Measurements:
        """Return unmeasured poses at ``q`` ``(J, n)`` with ``payload`` ``(n,)``.

        Directions and speeds of approach are random: the order of the visits, which is chosen later, gives each joint
        both directions.
        """
        speed = np.random.default_rng([self.seed, stream]).uniform(-1.0, 1.0, q.shape)
        n = q.shape[1]
        return Measurements(
            position=np.zeros((3, n)),
            q=q,
            direction=np.sign(speed),
            speed=speed,
            payload=payload,
            temperature=self.constant_temperature(n),
        )

    def constant_temperature(self, n: int) -> Array | None:
        """Return ``(n,)`` the temperature, degrees Celsius; None where no effect of the model depends on it."""
        return None if self.temperature is None else np.full(n, self.temperature)

    def in_turn(self, n: int) -> Array | None:
        """Return ``(n,)`` the payloads in turn, kg; None without payloads."""
        return np.resize(np.array(self.payloads, dtype=np.float64), n) if self.payloads else None

    def with_payloads(self, candidates: CandidatePoses) -> CandidatePoses:
        """Return every candidate with every payload: all candidates with the first payload, then with the next."""
        count = len(self.payloads)
        if count == 0:
            return candidates
        ids = candidates.ids
        if ids is not None and count > 1:
            ids = np.array([f"{name}@{payload:g}kg" for payload in self.payloads for name in ids])
        return dataclasses.replace(
            candidates,
            q=np.tile(candidates.q, count),
            position=np.tile(candidates.position, count),
            ids=ids,
            payload=np.repeat(np.array(self.payloads, dtype=np.float64), candidates.n),
            n_payloads=count,
        )


def conditions_of(model: Model, payloads: tuple[float, ...], seed: int, is_for_fit: bool) -> Conditions:
    """Return the circumstances that the effects of ``model`` depend on.

    Without ``payloads`` the arm carries none, 0 kg, if a known effect depends on the payload. ``is_for_fit`` says that
    the poses are chosen for the coefficients of the free effects.

    Raises:
        UsageError: A free effect needs payloads that differ, or a circumstance that a plan does not have; or there are
            several payloads to choose from, and no free effect depends on them.
    """
    bare = _sample(model)
    loaded, warm = (
        dataclasses.replace(bare, payload=np.array([0.0, 1.0])),
        dataclasses.replace(bare, temperature=np.array([0.0, 1.0])),
    )
    fixed = [entry.effect for entry in model.known]
    if not payloads and any(_lacks(effect, model, bare) and not _lacks(effect, model, loaded) for effect in fixed):
        payloads = (0.0,)
    is_warm = any(_lacks(effect, model, bare) and not _lacks(effect, model, warm) for effect in fixed)
    result = Conditions(payloads, _ROOM_TEMPERATURE if is_warm else None, seed)
    planned = dataclasses.replace(bare, payload=np.array([min(payloads), max(payloads)]) if payloads else None)
    for effect in model.free:
        reason = _lacks(effect, model, planned)
        if reason is None:
            continue
        if not _lacks(effect, model, loaded):
            raise UsageError(f"`fit`: {effect.name} needs loads: {reason}; give `payload`, such as 0,5")
        raise UsageError(f"`fit`: {effect.name} cannot be planned: {reason}; leave it out")
    if is_for_fit and len(payloads) > 1 and not any(_lacks(effect, model, bare) for effect in model.free):
        raise UsageError(
            "`payload`: no effect of `fit` depends on the payload, so any pose may have any; "
            "add payload_compliance to `fit`, or give the payload of this campaign alone"
        )
    return result


def _lacks(effect: Effect, model: Model, data: Measurements) -> str | None:
    """Return the reason why ``data`` cannot show an effect; None if it can."""
    return effect.missing(model.arm, data)


def _sample(model: Model) -> Measurements:
    """Return two poses that differ in all joints, with directions and speeds."""
    q = np.tile([0.0, 1.0], (len(model.arm.names), 1))
    return Measurements(position=np.zeros((3, 2)), q=q, direction=2 * q - 1, speed=q)
