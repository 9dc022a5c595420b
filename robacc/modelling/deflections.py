"""Deflections of the arm under its loads, and their derivatives by every coefficient.

An equilibrium deflection follows from the force at the deflected pose. A rigid-form deflection follows from the force
at the pose without deflections, which the arm's geometry moves but no deflection does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.chain import Scalar, Sweep
from robacc.effects.base import Part
from robacc.errors import EquilibriumError
from robacc.geometry import Array
from robacc.gravity import Load, Weighted, combined, force_derivatives, forces
from robacc.robots.arm import Arm

_STEPS = 60
_CONVERGED = 1e-14
"""rad or m: largest change of a deflection by all further sweeps at which the iteration ends."""


@dataclass(frozen=True, slots=True)
class TermPart:
    """Part of term ``number``, counted over the fixed terms of a model, then its free terms."""

    number: int
    part: Part


MotionGain = tuple[int, int, Any]
"""A column, a motion, and the gain ``(N,)``, or a constant, by which the column's coefficient moves the motion."""


class _Spring(NamedTuple):
    """Deflection of a motion: ``factor``, a number or ``(N,)``, times gravity's force."""

    weighted: Weighted
    factor: Any


@dataclass(frozen=True)
class Deflections:
    """Elastic parts of a model bound to ``n`` poses of ``arm``."""

    arm: Arm
    n: int
    entries: tuple[TermPart, ...]

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Motion counts after which a sweep must keep the frame of a load."""
        return tuple(sorted({load.after for entry in self.entries for load in entry.part.loads or ()}))

    def _of_form(self, *, deflected: bool) -> list[TermPart]:
        """Return the parts whose force is evaluated at the deflected pose, or at the undeflected one."""
        return [entry for entry in self.entries if entry.part.deflected == deflected]

    # -- prediction

    def deflected(self, scalars: list[Scalar], coefficients: NDArray[Any]) -> list[Scalar]:
        """Return every scalar of the chain with deflections, from ``scalars`` of the undeflected arm.

        Raises:
            EquilibriumError: There is no equilibrium, because the arm is too soft for its weight.
        """
        if first := _springs(self._of_form(deflected=False), coefficients):
            motions = _motions(first)
            scalars = _moved(scalars, motions, self._deflections_at(scalars, motions, first))
        elastic = _springs(self._of_form(deflected=True), coefficients)
        return self._equilibrium(scalars, elastic) if elastic else scalars

    def _equilibrium(self, rigid: list[Scalar], elastic: Sequence[_Spring]) -> list[Scalar]:
        """Iterate sweeps until the deflections converge."""
        motions = _motions(elastic)
        previous, last_change = np.zeros((len(motions), self.n)), np.inf
        for _ in range(_STEPS):
            current = self._deflections_at(_moved(rigid, motions, previous), motions, elastic)
            change = float(np.max(np.abs(current - previous), initial=0.0))
            previous = current
            if change < _CONVERGED:
                break
            # Changes shrink at a constant rate. The derivative that a complex step carries lags behind them.
            rate = change / last_change
            if 0.0 < rate < 1.0 and change * rate < _CONVERGED * (1.0 - rate) and not np.iscomplexobj(current):
                break
            last_change = change
        else:
            raise EquilibriumError(
                "the elastic equilibrium does not converge: a compliance is too large for the arm's weight; "
                "check the unit of the compliance and the masses in the robot file"
            )
        return _moved(rigid, motions, previous)

    def _deflections_at(
        self, scalars: Sequence[Scalar], motions: Sequence[int], elastic: Sequence[_Spring]
    ) -> NDArray[Any]:
        """Return the deflections ``(len(motions), N)`` of motions under the forces at the pose of ``scalars``."""
        sweep = self.arm.chain.sweep(scalars, self.n, motions, self.counts)
        linear, angular = sweep.twists()
        at = [motions.index(spring.weighted.motion) for spring in elastic]
        torques = self._forces(sweep, [spring.weighted for spring in elastic], linear[:, at], angular[:, at])
        parts = [spring.factor * torque for spring, torque in zip(elastic, torques, strict=True)]
        deflections = np.zeros((len(motions), self.n), dtype=np.result_type(*parts))
        for i, part in zip(at, parts, strict=True):
            deflections[i] += part
        return deflections

    def _forces(self, sweep: Sweep, weighted: Sequence[Weighted], linear: Array, angular: Array) -> NDArray[Any]:
        frames = dict(zip(self.counts, sweep.frames, strict=True))
        return forces(np.array(self.arm.robot.gravity), weighted, frames, linear, angular)

    # -- derivative

    def derivatives(
        self,
        undeflected: Sequence[Scalar],
        followed: Sweep,
        motions: Sequence[int],
        column: Mapping[int, int],
        coefficients: Array,
    ) -> tuple[list[MotionGain], Array, Array]:
        """Return the gains of the compliances, and derivatives ``(6, W, N)`` of the poses, deflections included.

        The first are by motions that a coefficient moves itself, the second by motions that a load deflects: no force
        at the undeflected pose follows those.

        Args:
            undeflected: Scalars of the arm without deflections.
            followed: Sweep of the deflected arm over ``motions``, which include every motion that a part moves.
            motions: Indices of motions, W of them.
            column: Term number to column.
            coefficients: Coefficients of every term.
        """
        slot = {motion: i for i, motion in enumerate(motions)}
        gains: list[MotionGain] = []
        first: dict[int, Array] = {}
        deflected: Array = followed.jacobian
        if at_rest := self._of_form(deflected=False):
            sweep = self.arm.chain.sweep(undeflected, self.n, motions, self.counts)
            gains, first = self._gains(at_rest, sweep, slot, column, coefficients)
        if in_equilibrium := self._of_form(deflected=True):
            direct, slopes = self._gains(in_equilibrium, followed, slot, column, coefficients)
            gains += direct
            deflected = _followed_by(deflected, self._equilibrium_response(slopes, slot), slot)
        return gains, _followed_by(deflected, first, slot), deflected

    def _gains(
        self,
        elastic: Sequence[TermPart],
        sweep: Sweep,
        slot: Mapping[int, int],
        column: Mapping[int, int],
        coefficients: Array,
    ) -> tuple[list[MotionGain], dict[int, Array]]:
        """Return the gains of compliance coefficients and the slopes E of deflections, at the pose of ``sweep``.

        Slopes ``{motion: (W, N)}`` are the changes of a deflection per unit of each followed scalar.
        """
        slopes: dict[int, Array] = {}
        linear, angular = sweep.twists()
        requested = [entry for entry in elastic if entry.number in column]
        at = [slot[entry.part.motion] for entry in requested]
        torques = self._forces(sweep, [_weighted(entry.part) for entry in requested], linear[:, at], angular[:, at])
        gains = [
            (column[entry.number], entry.part.motion, entry.part.factor * torque)
            for entry, torque in zip(requested, torques, strict=True)
        ]
        frames, gravity = dict(zip(self.counts, sweep.frames, strict=True)), np.array(self.arm.robot.gravity)
        for spring in _springs(elastic, coefficients):
            motion = spring.weighted.motion
            slope = force_derivatives(gravity, spring.weighted, frames, tuple(slot), linear, angular)
            slopes[motion] = slopes.get(motion, 0.0) + spring.factor * slope
        return gains, slopes

    def _equilibrium_response(self, slopes: Mapping[int, Array], slot: Mapping[int, int]) -> dict[int, Array]:
        """Solve X = E + E_FF X for X ``{motion: (W, N)}``: deflections in equilibrium move each other."""
        if not slopes:
            return {}
        motions = tuple(slopes)
        rhs = np.stack([slopes[motion].T for motion in motions], axis=1)
        matrix = np.eye(len(motions)) - rhs[:, :, [slot[motion] for motion in motions]]
        solution = np.linalg.solve(matrix, rhs)
        return {motion: np.ascontiguousarray(solution[:, row].T) for row, motion in enumerate(motions)}


def _followed_by(jacobian: Array, responses: Mapping[int, Array], slot: Mapping[int, int]) -> Array:
    """Return derivatives by motions with those of the deflections that respond ``{motion: (W, N)}`` to them."""
    result = jacobian
    for motion, response in responses.items():
        result = result + jacobian[:, slot[motion]][:, None] * response
    return result


def _springs(entries: Sequence[TermPart], coefficients: NDArray[Any]) -> list[_Spring]:
    """Return the parts with a coefficient; parts of one motion without a regressor are one spring under all loads."""
    plain: dict[int, list[tuple[float, tuple[Load, ...]]]] = {}
    springs = []
    for entry in entries:
        part, value = entry.part, coefficients[entry.number]
        if value == 0:
            continue
        if isinstance(part.factor, np.ndarray) or np.iscomplexobj(coefficients):
            springs.append(_Spring(_weighted(part), value * part.factor))
        else:
            plain.setdefault(part.motion, []).append((float(value) * part.factor, part.loads or ()))
    return springs + [_Spring(Weighted(motion, combined(shares)), 1.0) for motion, shares in plain.items()]


def _weighted(part: Part) -> Weighted:
    return Weighted(part.motion, part.loads or ())


def _motions(elastic: Sequence[_Spring]) -> tuple[int, ...]:
    """Return the indices of the deflecting motions, sorted and unique."""
    return tuple(sorted({spring.weighted.motion for spring in elastic}))


def _moved(scalars: Sequence[Scalar], motions: Sequence[int], deflections: NDArray[Any]) -> list[Scalar]:
    """Return the scalars with ``deflections`` ``(len(motions), N)`` added to those of ``motions``."""
    moved = list(scalars)
    for motion, deflection in zip(motions, deflections, strict=True):
        moved[motion] = moved[motion] + deflection
    return moved
