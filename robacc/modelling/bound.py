"""Model bound to poses: it has every regressor evaluated, and predicts and linearises for any coefficients."""

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
    """Motions that a sweep must follow for the Jacobian of requested coefficients."""

    motions: tuple[int, ...]
    """A motion for each requested coefficient, then those of :attr:`followed`."""
    followed: tuple[int, ...]
    """Motions from which the columns of coefficients with several parts, regressors or loads are composed."""
    compound: tuple[int, ...]
    """Columns that are composed of several motions or scaled."""
    column: Mapping[int, int]
    """Term number to column."""


@dataclass(frozen=True)
class BoundModel:
    """Model with regressors evaluated for N poses. ``theta`` ``(P,)`` are the free coefficients."""

    arm: Arm
    n: int
    nominal: tuple[Scalar, ...]
    fixed: tuple[Term, ...]
    fixed_values: Array
    terms: tuple[Term, ...]
    owners: tuple[int, ...] = ()
    """Index of each term's effect among the free effects of the model."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free coefficients."""
        return tuple(term.name for term in self.terms)

    def poses(self, theta: NDArray[Any]) -> Poses:
        """Predict the poses of the target in the measuring frame."""
        coefficients = self._coefficients(theta)
        return self._scaled(self.arm.chain.poses(self._scalars(coefficients), self.n), coefficients)

    def linearise(self, theta: Array, columns: NDArray[np.int64] | None = None) -> tuple[Poses, Array]:
        """Return predicted poses and the exact Jacobian ``(6, P, N)``: dp (m), dphi (rad) per unit of coefficient.

        Coefficients that move the arm change the torques that deflect it; the derivative includes this. ``columns``
        ``(K,)`` are the indices of the requested coefficients, in order; by default all.
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

    # -- parts of the terms

    @cached_property
    def _entries(self) -> tuple[TermPart, ...]:
        return tuple(TermPart(i, part) for i, term in enumerate((*self.fixed, *self.terms)) for part in term.parts)

    @cached_property
    def _rigid(self) -> tuple[tuple[int, int, float | Array], ...]:
        """Term number, motion and regressor of each part that moves a motion without a load."""
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
            self._layouts[key] = self._new_layout(columns.tolist())
        return self._layouts[key]

    def _new_layout(self, columns: Sequence[int]) -> _Layout:
        first = len(self.fixed)
        column_motions, compound = [], []
        for column, number in enumerate(columns):
            parts = self.terms[number].parts
            # Motion 0 is a placeholder for a column that is composed afterwards.
            simple = len(parts) == 1 and _is_rigid(parts[0]) and isinstance(parts[0].factor, float)
            simple = simple and parts[0].factor == 1.0
            column_motions.append(parts[0].motion if simple else 0)
            if not simple:
                compound.append(column)
        needed = {part.motion for column in compound for part in self.terms[columns[column]].parts}
        if self._elastic.entries:
            needed |= {part.motion for number in columns for part in self.terms[number].parts}
            needed |= {entry.part.motion for entry in self._elastic.entries}
        followed = tuple(sorted(needed - {SCALE_OF_INSTRUMENT}))
        return _Layout(
            (*column_motions, *followed),
            followed,
            tuple(compound),
            {first + number: i for i, number in enumerate(columns)},
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
        """Return every scalar of the chain, deflections included."""
        return self._elastic.deflected(self._undeflected(coefficients), coefficients)

    def _undeflected(self, coefficients: NDArray[Any]) -> list[Scalar]:
        """Return every scalar of the chain without deflections."""
        scalars = list(self.nominal)
        values = coefficients.tolist()
        for number, motion, factor in self._rigid:
            if values[number] != 0:
                added = values[number] * factor
                scalars[motion] = scalars[motion] + (added if isinstance(added, float) else np.atleast_1d(added))
        return scalars

    # -- derivative

    def _compose(self, jacobian: Array, followed: Sweep, layout: _Layout, coefficients: Array) -> None:
        """Compose the compound columns from the followed motions, and add the responses of the deflections."""
        jacobian[:, list(layout.compound)] = 0.0
        gains = [MotionGain(layout.column[n], motion, gain) for n, motion, gain in self._rigid if n in layout.column]
        responses: list[tuple[int, Array]] = []
        if self._elastic.entries:
            undeflected = self._undeflected(coefficients)
            direct, responses = self._elastic.responses(
                gains, undeflected, followed, layout.followed, layout.column, coefficients
            )
            gains += direct
        slot = {motion: i for i, motion in enumerate(layout.followed)}
        compound = set(layout.compound)
        for column, motion, factor in gains:
            if column in compound:
                jacobian[:, column] += followed.jacobian[:, slot[motion]] * factor
        for motion, response in responses:
            jacobian += followed.jacobian[:, slot[motion]][:, None, :] * response


def _is_rigid(part: Part) -> bool:
    """Return whether a part moves a motion of the chain without a load."""
    return part.loads is None and part.motion != SCALE_OF_INSTRUMENT
