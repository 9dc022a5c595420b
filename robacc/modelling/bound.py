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
from robacc.geometry import Array, Poses
from robacc.modelling.deflections import Deflections, MotionGain, TermPart
from robacc.robots.arm import Arm


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

        What moves the arm changes the moments that it gives way to, deflections in equilibrium included; the derivative
        has that too. ``columns`` ``(K,)`` names the coefficients to build, in order; by default all.
        """
        layout = self._layout(np.arange(len(self.terms)) if columns is None else columns)
        count = len(layout.column)
        coefficients = self._coefficients(theta)
        sweep = self.arm.chain.sweep(self._scalars(coefficients), self.n, layout.motions, self._elastic.counts)
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
    def _entries(self) -> tuple[TermPart, ...]:
        return tuple(TermPart(i, part) for i, term in enumerate((*self.fixed, *self.terms)) for part in term.parts)

    @cached_property
    def _rigid(self) -> tuple[tuple[int, int, float | Array], ...]:
        """Term number, motion and regressor of all that moves a motion by itself."""
        return tuple((e.number, e.part.motion, e.part.factor) for e in self._entries if _is_rigid(e.part))

    @cached_property
    def _elastic(self) -> Deflections:
        return Deflections(self.arm, self.n, tuple(e for e in self._entries if e.part.loads is not None))

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
        if self._elastic.entries:
            needed |= {part.motion for number in columns for part in self.terms[number].parts}
            needed |= {entry.part.motion for entry in self._elastic.entries}
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
        """Every scalar of the chain, what gives way included."""
        return self._elastic.added(self._undeflected(coefficients), coefficients)

    def _undeflected(self, coefficients: NDArray[Any]) -> list[Scalar]:
        """Every scalar of the chain without what gives way under a load."""
        scalars = list(self.nominal)
        values = coefficients.tolist()
        for number, motion, factor in self._rigid:
            if values[number] != 0:
                added = values[number] * factor
                scalars[motion] = scalars[motion] + (added if isinstance(added, float) else np.atleast_1d(added))
        return scalars

    # -- derivative

    def _compose(self, jacobian: Array, followed: Sweep, layout: _Layout, coefficients: Array) -> None:
        """Put the compound columns together from the motions followed, and add how the deflections answer."""
        jacobian[:, list(layout.compound)] = 0.0
        driven = [MotionGain(layout.column[n], motion, by) for n, motion, by in self._rigid if n in layout.column]
        answers: list[tuple[int, Array]] = []
        if self._elastic.entries:
            undeflected = self._undeflected(coefficients)
            direct, answers = self._elastic.answers(
                driven, undeflected, followed, layout.followed, layout.column, coefficients
            )
            driven += direct
        slot = {motion: i for i, motion in enumerate(layout.followed)}
        compound = set(layout.compound)
        for column, motion, factor in driven:
            if column in compound:
                jacobian[:, column] += followed.jacobian[:, slot[motion]] * factor
        for motion, answer in answers:
            jacobian += followed.jacobian[:, slot[motion]][:, None, :] * answer


def _is_rigid(part: Part) -> bool:
    """Whether a part moves a motion of the chain by itself, no load in between."""
    return part.loads is None and part.motion != SCALE_OF_INSTRUMENT
