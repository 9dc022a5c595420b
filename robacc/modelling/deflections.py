"""What gives way under the loads of poses: by how much, and how that answers every coefficient.

A deflection in equilibrium follows from the force at the pose that all deflections together lead to; one of the rigid
form from the force at the pose without any, which the arm's geometry moves but no deflection does.
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
from robacc.gravity.loads import Load
from robacc.gravity.torques import Weights, force, force_derivatives
from robacc.robots.arm import Arm

_STEPS = 60
_SETTLED = 1e-14
"""rad or m: deflections change by less from one sweep to the next."""


@dataclass(frozen=True, slots=True)
class TermPart:
    """Part of term ``number`` (a model's fixed ones first, then its free ones)."""

    number: int
    part: Part


class MotionGain(NamedTuple):
    """``factor`` ``(N,)``, or a constant, by which a column's coefficient moves a motion."""

    column: int
    motion: int
    factor: Any


@dataclass(frozen=True)
class Deflections:
    """The elastic parts of a model bound to ``n`` poses of ``arm``."""

    arm: Arm
    n: int
    entries: tuple[TermPart, ...]

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Numbers of motions after which a sweep has to keep the frame that a load stands in."""
        return tuple(sorted({load.after for loads in self._loads.values() for load in loads}))

    @cached_property
    def first_order(self) -> tuple[TermPart, ...]:
        """Those whose force is that at the undeflected pose."""
        return tuple(e for e in self.entries if not e.part.deflected)

    @cached_property
    def in_equilibrium(self) -> tuple[TermPart, ...]:
        """Those whose force is that at the deflected pose."""
        return tuple(e for e in self.entries if e.part.deflected)

    @cached_property
    def _loads(self) -> dict[int, tuple[Load, ...]]:
        return {id(e.part.loads): e.part.loads for e in self.entries if e.part.loads is not None}

    # -- prediction

    def added(self, scalars: list[Scalar], coefficients: NDArray[Any]) -> list[Scalar]:
        """Every scalar of the chain with what gives way, ``scalars`` being those of the undeflected arm.

        Raises:
            EquilibriumError: there is no equilibrium, because the arm is softer than its weight allows.
        """
        first = [entry for entry in self.first_order if coefficients[entry.number] != 0]
        if first:
            motions = _motions(first)
            scalars = _moved(scalars, motions, self._at(scalars, motions, first, coefficients))
        elastic = [entry for entry in self.in_equilibrium if coefficients[entry.number] != 0]
        return self._equilibrium(scalars, elastic, coefficients) if elastic else scalars

    def _equilibrium(
        self, rigid: list[Scalar], elastic: Sequence[TermPart], coefficients: NDArray[Any]
    ) -> list[Scalar]:
        """Sweep until the deflections reproduce themselves."""
        motions = _motions(elastic)
        previous = np.zeros((len(motions), self.n), dtype=coefficients.dtype)
        for _ in range(_STEPS):
            current = self._at(_moved(rigid, motions, previous), motions, elastic, coefficients)
            change = np.max(np.abs(current - previous), initial=0.0)
            previous = current
            if change < _SETTLED:
                break
        else:
            raise EquilibriumError(
                "the elastic equilibrium does not converge: a compliance is too large for the arm's weight; "
                "check its unit, and the masses, in the robot file"
            )
        return _moved(rigid, motions, previous)

    def _at(
        self, scalars: Sequence[Scalar], motions: Sequence[int], elastic: Sequence[TermPart], coefficients: NDArray[Any]
    ) -> NDArray[Any]:
        """``(len(motions), N)``: by how much motions give way to the forces where the arm stands at ``scalars``."""
        sweep = self.arm.chain.sweep(scalars, self.n, motions, self.counts)
        placed = self._placed(sweep)
        linear, angular = sweep.twists()
        found = np.zeros((len(motions), self.n), dtype=coefficients.dtype)
        for entry in elastic:
            i = motions.index(entry.part.motion)
            moment = self._force(placed, entry.part, linear[:, i], angular[:, i])
            found[i] += coefficients[entry.number] * entry.part.factor * moment
        return found

    def _placed(self, sweep: Sweep) -> dict[int, Weights]:
        frames = dict(zip(self.counts, sweep.frames, strict=True))
        return {key: Weights.place(loads, frames) for key, loads in self._loads.items()}

    def _force(self, placed: Mapping[int, Weights], part: Part, linear: Array, angular: Array) -> NDArray[Any]:
        gravity = np.array(self.arm.robot.gravity)
        return force(gravity, placed[id(part.loads)], part.motion, linear, angular)

    # -- derivative

    def answers(
        self,
        driven: Sequence[MotionGain],
        undeflected: Sequence[Scalar],
        followed: Sweep,
        motions: Sequence[int],
        column: Mapping[int, int],
        coefficients: Array,
    ) -> tuple[list[MotionGain], list[tuple[int, Array]]]:
        """What compliances drive by themselves, and (motion, ``(P, N)``): what deflections answer to every coefficient.

        Args:
            driven: what moves motions by itself, no load in between.
            undeflected: scalars of the arm without what gives way.
            followed: sweep of the arm as it stands, over ``motions``, which hold all that anything moves.
            motions: numbers of motions.
            column: term number to column, of which there are P.
            coefficients: of every term.
        """
        slot = {motion: i for i, motion in enumerate(motions)}
        moved, found = list(driven), []
        if self.first_order:
            sweep = self.arm.chain.sweep(undeflected, self.n, motions, self.counts)
            direct, slopes = self._driven(self.first_order, sweep, slot, column, coefficients)
            found = list(self._answered(moved, [], slopes, slot, len(column)).items())
            moved += direct
        if self.in_equilibrium:
            direct, slopes = self._driven(self.in_equilibrium, followed, slot, column, coefficients)
            moved += direct
            found += self._settled(self._answered(moved, found, slopes, slot, len(column)), slopes, slot).items()
        return moved[len(driven) :], found

    def _driven(
        self,
        elastic: Sequence[TermPart],
        sweep: Sweep,
        slot: Mapping[int, int],
        column: Mapping[int, int],
        coefficients: Array,
    ) -> tuple[list[MotionGain], dict[int, Array]]:
        """How deflections answer their own coefficients, and their slopes, by the forces at the pose of ``sweep``.

        ``{motion: (W, N)}``: what a deflection changes by per unit of each scalar followed.
        """
        driven = []
        slopes: dict[int, Array] = {}
        placed, (linear, angular) = self._placed(sweep), sweep.twists()
        gravity = np.array(self.arm.robot.gravity)
        for entry in elastic:
            part, value, i = entry.part, coefficients[entry.number], slot[entry.part.motion]
            if entry.number in column:
                moment = self._force(placed, part, linear[:, i], angular[:, i])
                driven.append(MotionGain(column[entry.number], part.motion, part.factor * moment))
            if value != 0:
                slope = force_derivatives(gravity, placed[id(part.loads)], part.motion, tuple(slot), linear, angular)
                slopes[part.motion] = slopes.get(part.motion, 0.0) + value * part.factor * slope
        return driven, slopes

    def _answered(
        self,
        driven: Sequence[MotionGain],
        answers: Sequence[tuple[int, Array]],
        slopes: Mapping[int, Array],
        slot: Mapping[int, int],
        count: int,
    ) -> dict[int, Array]:
        """``{motion: (P, N)}``: E D, what every coefficient does to the deflections through what it moves."""
        found = {motion: np.zeros((count, self.n)) for motion in slopes}
        for motion, slope in slopes.items():
            for column, moved, factor in driven:
                found[motion][column] += slope[slot[moved]] * factor
            for moved, answer in answers:
                found[motion] += slope[slot[moved]] * answer
        return found

    def _settled(
        self, right: Mapping[int, Array], slopes: Mapping[int, Array], slot: Mapping[int, int]
    ) -> dict[int, Array]:
        """``{motion: (P, N)}``: X of X = E D + E_FF X, as deflections in equilibrium move each other."""
        if not slopes:
            return {}
        motions = tuple(slopes)
        matrix = np.broadcast_to(np.eye(len(motions)), (self.n, len(motions), len(motions))).copy()
        for row, motion in enumerate(motions):
            for place, other in enumerate(motions):
                matrix[:, row, place] -= slopes[motion][slot[other]]
        answer = np.linalg.solve(matrix, np.stack([right[motion].T for motion in motions], axis=1))
        return {motion: np.ascontiguousarray(answer[:, row].T) for row, motion in enumerate(motions)}


def _motions(elastic: Sequence[TermPart]) -> tuple[int, ...]:
    """The motions that give way, each once."""
    return tuple(sorted({entry.part.motion for entry in elastic}))


def _moved(scalars: Sequence[Scalar], motions: Sequence[int], by: NDArray[Any]) -> list[Scalar]:
    """Scalars with ``by`` ``(len(motions), N)`` added to those of some motions."""
    moved = list(scalars)
    for motion, deflection in zip(motions, by, strict=True):
        moved[motion] = moved[motion] + deflection
    return moved
