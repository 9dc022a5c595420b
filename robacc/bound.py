"""A model bound to poses: every regressor evaluated, so that it predicts and linearises for any coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.chain import Scalar, Sweep
from robacc.effects.base import SCALE_OF_INSTRUMENT, Part, Term
from robacc.elasticity import Weights, force, force_derivatives
from robacc.errors import EquilibriumError
from robacc.geometry import Array, Poses
from robacc.loads import Load
from robacc.robots.arm import Arm

_EQUILIBRIUM_STEPS = 60
_EQUILIBRIUM = 1e-14
"""rad or m: deflections change by less from one sweep to the next."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """Part of term ``number`` (fixed ones first, then free)."""

    number: int
    part: Part


@dataclass(frozen=True, slots=True)
class _Layout:
    """What a sweep has to follow so that its Jacobian is, column by column, that of the wanted coefficients."""

    motions: tuple[int, ...]
    """A motion for each wanted coefficient, then those of :attr:`followed`."""
    followed: tuple[int, ...]
    """Motions that coefficients of several parts, of regressors and of loads are put together from."""
    compound: tuple[int, ...]
    """Columns that are not simply a motion's own."""
    column: Mapping[int, int]
    """Term number to column."""


@dataclass(frozen=True)
class BoundModel:
    """A model with its regressors evaluated for N poses. ``theta`` ``(P,)`` are the free coefficients."""

    arm: Arm
    n: int
    nominal: tuple[Scalar, ...]
    fixed: tuple[Term, ...]
    fixed_values: Array
    terms: tuple[Term, ...]
    owners: tuple[int, ...] = ()
    """For each term the number of its effect among the model's free ones."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free coefficients."""
        return tuple(term.name for term in self.terms)

    def poses(self, theta: NDArray[Any]) -> Poses:
        """Predicted poses of the target in the measuring frame."""
        coefficients = self._coefficients(theta)
        return self._scaled(self.arm.chain.poses(self._scalars(coefficients), self.n), coefficients)

    def linearise(self, theta: Array, columns: NDArray[np.int64] | None = None) -> tuple[Poses, Array]:
        """Predicted poses, and ``(6, P, N)`` rows dp (m), dphi (rad) per unit of each free coefficient, exact.

        The deflection of elastic parts changes the moments that cause it; the derivative has that too. ``columns``
        ``(K,)`` names the coefficients to build, in order; by default all.
        """
        layout = self._layout(np.arange(len(self.terms)) if columns is None else columns)
        count = len(layout.column)
        coefficients = self._coefficients(theta)
        sweep = self.arm.chain.sweep(self._scalars(coefficients), self.n, layout.motions, self._counts)
        jacobian = sweep.jacobian[:, :count]
        followed = Sweep(sweep.poses, sweep.jacobian[:, count:], sweep.frames)
        self._compose(jacobian, followed, layout, coefficients)
        scale = self._instrument_scale(coefficients)
        if np.any(scale):
            jacobian[:3] *= 1.0 + scale
        for entry in self._entries:
            if entry.part.motion == SCALE_OF_INSTRUMENT and entry.number in layout.column:
                jacobian[:3, layout.column[entry.number]] += sweep.poses.translation * entry.part.factor
        return self._scaled(sweep.poses, coefficients), jacobian

    # -- what the terms are made of

    @cached_property
    def _entries(self) -> tuple[_Entry, ...]:
        return tuple(_Entry(i, part) for i, term in enumerate((*self.fixed, *self.terms)) for part in term.parts)

    @cached_property
    def _rigid(self) -> tuple[tuple[int, int, float | Array], ...]:
        """Term number, motion and regressor of all that moves a motion by itself."""
        return tuple((e.number, e.part.motion, e.part.factor) for e in self._entries if _is_rigid(e.part))

    @cached_property
    def _elastic(self) -> tuple[_Entry, ...]:
        return tuple(e for e in self._entries if e.part.loads is not None)

    @cached_property
    def _loads(self) -> dict[int, tuple[Load, ...]]:
        return {id(e.part.loads): e.part.loads for e in self._entries if e.part.loads is not None}

    @cached_property
    def _counts(self) -> tuple[int, ...]:
        return tuple(sorted({load.after for loads in self._loads.values() for load in loads}))

    @cached_property
    def _layouts(self) -> dict[bytes, _Layout]:
        return {}

    def _layout(self, columns: NDArray[np.int64]) -> _Layout:
        key = columns.tobytes()
        if key not in self._layouts:
            self._layouts[key] = self._laid_out(columns.tolist())
        return self._layouts[key]

    def _laid_out(self, columns: Sequence[int]) -> _Layout:
        first = len(self.fixed)
        own, compound = [], []
        for column, number in enumerate(columns):
            parts = self.terms[number].parts
            # Motion 0 holds the place of a column that is put together afterwards.
            plain = len(parts) == 1 and _is_rigid(parts[0]) and isinstance(parts[0].factor, float)
            plain = plain and parts[0].factor == 1.0
            own.append(parts[0].motion if plain else 0)
            if not plain:
                compound.append(column)
        needed = {part.motion for column in compound for part in self.terms[columns[column]].parts}
        if self._elastic:
            needed |= {part.motion for number in columns for part in self.terms[number].parts}
            needed |= {entry.part.motion for entry in self._elastic}
        followed = tuple(sorted(needed - {SCALE_OF_INSTRUMENT}))
        return _Layout(
            (*own, *followed), followed, tuple(compound), {first + number: i for i, number in enumerate(columns)}
        )

    def _coefficients(self, theta: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate((self.fixed_values, theta))

    # -- prediction

    def _instrument_scale(self, coefficients: NDArray[Any]) -> Any:
        return sum(
            coefficients[e.number] * e.part.factor for e in self._entries if e.part.motion == SCALE_OF_INSTRUMENT
        )

    def _scaled(self, poses: Poses, coefficients: NDArray[Any]) -> Poses:
        scale = self._instrument_scale(coefficients)
        if isinstance(scale, int) or not np.any(scale):
            return poses
        return Poses(poses.rotation, poses.translation * (1.0 + scale))

    def _scalars(self, coefficients: NDArray[Any]) -> list[Scalar]:
        """Every scalar of the chain, elastic ones in equilibrium."""
        scalars = list(self.nominal)
        values = coefficients.tolist()
        for number, motion, factor in self._rigid:
            if values[number] != 0:
                added = values[number] * factor
                scalars[motion] = scalars[motion] + (added if isinstance(added, float) else np.atleast_1d(added))
        elastic = [entry for entry in self._elastic if values[entry.number] != 0]
        return self._equilibrium(scalars, elastic, coefficients) if elastic else scalars

    def _equilibrium(self, rigid: list[Scalar], elastic: Sequence[_Entry], coefficients: NDArray[Any]) -> list[Scalar]:
        """Sweep until the deflections reproduce themselves.

        Raises:
            EquilibriumError: they do not, because the arm is softer than its weight allows.
        """
        motions = tuple(sorted({entry.part.motion for entry in elastic}))
        slot = {k: i for i, k in enumerate(motions)}
        previous = np.zeros((len(motions), self.n), dtype=coefficients.dtype)
        for _ in range(_EQUILIBRIUM_STEPS):
            scalars = list(rigid)
            for motion, deflection in zip(motions, previous, strict=True):
                scalars[motion] = scalars[motion] + deflection
            sweep = self.arm.chain.sweep(scalars, self.n, motions, self._counts)
            placed = self._placed(sweep)
            linear, angular = sweep.twists()
            current = np.zeros_like(previous)
            for entry in elastic:
                i = slot[entry.part.motion]
                moment = self._force(placed, entry.part, linear[:, i], angular[:, i])
                current[i] += coefficients[entry.number] * entry.part.factor * moment
            change = np.max(np.abs(current - previous), initial=0.0)
            previous = current
            if change < _EQUILIBRIUM:
                break
        else:
            raise EquilibriumError(
                "the elastic equilibrium does not converge: a compliance is too large for the arm's weight"
            )
        for motion, deflection in zip(motions, previous, strict=True):
            rigid[motion] = rigid[motion] + deflection
        return rigid

    def _placed(self, sweep: Sweep) -> dict[int, Weights]:
        frames = dict(zip(self._counts, sweep.frames, strict=True))
        return {key: Weights.place(loads, frames) for key, loads in self._loads.items()}

    def _force(self, placed: Mapping[int, Weights], part: Part, linear: Array, angular: Array) -> NDArray[Any]:
        gravity = np.array(self.arm.robot.gravity)
        return force(gravity, placed[id(part.loads)], part.motion, linear, angular)

    # -- derivative

    def _compose(self, jacobian: Array, followed: Sweep, layout: _Layout, coefficients: Array) -> None:
        """Put the compound columns together from the motions followed, and add how the deflections answer."""
        jacobian[:, list(layout.compound)] = 0.0
        driven, slopes = self._driven(followed, layout, coefficients)
        slot = {motion: i for i, motion in enumerate(layout.followed)}
        compound = set(layout.compound)
        for column, motion, factor in driven:
            if column in compound:
                jacobian[:, column] += followed.jacobian[:, slot[motion]] * factor
        for motion, response in self._elastic_response(driven, slopes, slot, len(layout.column)).items():
            jacobian += followed.jacobian[:, slot[motion]][:, None, :] * response

    def _driven(
        self, followed: Sweep, layout: _Layout, coefficients: Array
    ) -> tuple[list[tuple[int, int, Any]], dict[int, Array]]:
        """How scalars answer coefficients: (column, motion, factor) as they stand, and the slopes of the deflections.

        ``{motion: (W, N)}``: what a deflection changes by per unit of each scalar followed.
        """
        column = layout.column
        driven = [(column[n], motion, factor) for n, motion, factor in self._rigid if n in column]
        slopes: dict[int, Array] = {}
        if not self._elastic:
            return driven, slopes
        placed, (linear, angular) = self._placed(followed), followed.twists()
        gravity = np.array(self.arm.robot.gravity)
        for entry in self._elastic:
            part, value, i = entry.part, coefficients[entry.number], layout.followed.index(entry.part.motion)
            if entry.number in column:
                moment = self._force(placed, part, linear[:, i], angular[:, i])
                driven.append((column[entry.number], part.motion, part.factor * moment))
            if value != 0:
                weights = placed[id(part.loads)]
                slope = force_derivatives(gravity, weights, part.motion, layout.followed, linear, angular)
                slopes[part.motion] = slopes.get(part.motion, 0.0) + value * part.factor * slope
        return driven, slopes

    def _elastic_response(
        self,
        driven: Sequence[tuple[int, int, Any]],
        slopes: Mapping[int, Array],
        slot: Mapping[int, int],
        count: int,
    ) -> dict[int, Array]:
        """``{motion: (P, N)}``: solve X = E D + E_FF X, the deflections' answer to every coefficient."""
        if not slopes:
            return {}
        motions = tuple(slopes)
        right = np.zeros((self.n, len(motions), count))
        matrix = np.broadcast_to(np.eye(len(motions)), (self.n, len(motions), len(motions))).copy()
        for row, motion in enumerate(motions):
            for column, moved, factor in driven:
                right[:, row, column] += slopes[motion][slot[moved]] * factor
            for place, other in enumerate(motions):
                matrix[:, row, place] -= slopes[motion][slot[other]]
        answer = np.linalg.solve(matrix, right)
        return {motion: np.ascontiguousarray(answer[:, row].T) for row, motion in enumerate(motions)}


def _is_rigid(part: Part) -> bool:
    """Whether a part moves a motion of the chain by itself, no load in between."""
    return part.loads is None and part.motion != SCALE_OF_INSTRUMENT
