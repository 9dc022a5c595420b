"""Models of an arm with known and free effects, bound to poses: predictions and their derivatives.

:meth:`Model.bind` evaluates every regressor of a :class:`Model` for given poses; the resulting :class:`BoundModel`
predicts and linearises. With all coefficients zero it predicts the nominal chain, bit for bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.chain import TOOL, Scalar, Sweep
from robacc.effects.base import SCALE_OF_INSTRUMENT, Effect, Part, Term, commanded
from robacc.effects.drivers import Validity, united
from robacc.effects.specification import Known, faded, held_at_ends, known_effects
from robacc.errors import UsageError
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.deflections import Deflections, MotionGain, TermPart
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

# Model bound to poses: it has every regressor evaluated, and predicts and linearises for any coefficients.

_MANY_REGRESSORS = 8
"""Terms that move a motion by a regressor each, from which their sum is one product."""


class _Layout(NamedTuple):
    """Motions that a sweep must follow for the Jacobian of requested coefficients."""

    motions: tuple[int, ...]
    """The motion of each requested coefficient; each motion once if columns are composed of them."""
    composed: bool
    """Whether columns are composed of motions: some have several parts, regressors or loads, or deflections follow."""
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

    def linearise(self, theta: Array, columns: NDArray[np.int64] | None = None, rows: int = 6) -> tuple[Poses, Array]:
        """Return predicted poses and the exact Jacobian ``(6, P, N)``: dp (m), dphi (rad) per unit of coefficient.

        Coefficients that move the arm change the torques that deflect it; the derivative includes this. ``columns``
        ``(K,)`` are the indices of the requested coefficients, in order; by default all. With 3 ``rows``, the Jacobian
        is that of the position.
        """
        layout = self._layout(np.arange(len(self.terms)) if columns is None else columns)
        coefficients = self._coefficients(theta)
        sweep = self.arm.chain.sweep(self._scalars(coefficients), self.n, layout.motions, self._elastic.counts)
        jacobian = self._composed(sweep, layout, coefficients, rows) if layout.composed else sweep.jacobian[:rows]
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
    def _moved(self) -> tuple[list[tuple[int, NDArray[np.int64], Array]], list[tuple[int, int, float | Array]]]:
        """Motions without a load: those that many terms move by regressors, and every other part.

        The first are each a motion, term numbers ``(Q,)`` and regressors ``(Q, N)``; the others a term number, a motion
        and a factor.
        """
        by_motion: dict[int, list[tuple[int, Array]]] = {}
        others: list[tuple[int, int, float | Array]] = []
        for number, motion, factor in self._rigid:
            if isinstance(factor, np.ndarray) and factor.shape == (self.n,):
                by_motion.setdefault(motion, []).append((number, factor))
            else:
                others.append((number, motion, factor))
        together = []
        for motion, terms in by_motion.items():
            if len(terms) >= _MANY_REGRESSORS:
                numbers, factors = zip(*terms, strict=True)
                together.append((motion, np.array(numbers), np.stack(factors)))
            else:
                others.extend((number, motion, factor) for number, factor in terms)
        return together, others

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
            first, numbers = len(self.fixed), columns.tolist()
            column = {first + number: i for i, number in enumerate(numbers)}
            parts = [self.terms[number].parts for number in numbers]
            composed = bool(self._elastic.entries) or any(len(some) != 1 or not _is_plain(some[0]) for some in parts)
            motions = [part.motion for of_term in parts for part in of_term]
            if composed:
                moved = {*motions, *(entry.part.motion for entry in self._elastic.entries)}
                motions = sorted(moved - {SCALE_OF_INSTRUMENT})
            self._layouts[key] = _Layout(tuple(motions), composed, column)
        return self._layouts[key]

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
        together, others = self._moved
        for motion, numbers, regressors in together:
            if np.any(coefficients[numbers]):
                scalars[motion] = scalars[motion] + coefficients[numbers] @ regressors
        for number, motion, factor in others:
            if values[number] != 0:
                added = values[number] * factor
                scalars[motion] = scalars[motion] + (added if isinstance(added, float) else np.atleast_1d(added))
        return scalars

    # -- derivative

    def _composed(self, sweep: Sweep, layout: _Layout, coefficients: Array, rows: int) -> Array:
        """Return the Jacobian ``(rows, P, N)``, composed of the derivatives by the motions of ``sweep``."""
        jacobian = np.zeros((rows, len(layout.column), self.n))
        rigid = [MotionGain(layout.column[n], motion, gain) for n, motion, gain in self._rigid if n in layout.column]
        slot = {motion: i for i, motion in enumerate(layout.motions)}
        moved = sweep.jacobian
        if self._elastic.entries:
            loaded, moved, deflected = self._elastic.derivatives(
                self._undeflected(coefficients), sweep, layout.motions, layout.column, coefficients
            )
            _add(jacobian, loaded, deflected, slot)
        _add(jacobian, rigid, moved, slot)
        return jacobian


def _add(jacobian: Array, gains: Sequence[MotionGain], by_motion: Array, slot: Mapping[int, int]) -> None:
    """Add to each coefficient's column the derivatives by the motions that it moves."""
    for column, motion, factor in gains:
        jacobian[:, column] += by_motion[: len(jacobian), slot[motion]] * factor


def _is_plain(part: Part) -> bool:
    """Return whether a coefficient of the part moves a motion by just as much."""
    return _is_rigid(part) and isinstance(part.factor, float) and part.factor == 1.0


def _is_rigid(part: Part) -> bool:
    """Return whether a part moves a motion of the chain without a load."""
    return part.loads is None and part.motion != SCALE_OF_INSTRUMENT


@dataclass(frozen=True)
class Model:
    """Arm, its known effects (with values), and the free effects to be fitted."""

    arm: Arm
    known: tuple[Known, ...] = ()
    free: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, robot: Robot, free: Sequence[Effect] = ()) -> Model:
        """Return the model that a robot file describes, with ``free`` effects added.

        Raises:
            InputError: The ``effects:`` of the file cannot be read.
        """
        return cls(Arm.of(robot), known_effects(robot), tuple(free))

    def with_free(self, *effects: Effect) -> Model:
        """Return the model with more free effects."""
        return dataclasses.replace(self, free=(*self.free, *effects))

    def bind(self, data: Measurements, validity: Sequence[Validity] | None = None, *, fades: bool = True) -> BoundModel:
        """Evaluate every regressor for these poses.

        A known effect is held at the ends of its validity range, or fades beyond it. A free one does so only
        if ``validity`` gives the range that each was fitted on; a known effect that is free too then has the range of
        both. Without ``fades`` no free effect fades: its coefficients' uncertainty does not.

        Raises:
            UsageError: The poses lack a column that an effect needs, or do not fit the arm.
        """
        q = commanded(data, "a prediction from the robot")
        if q.shape[0] != self.arm.chain.n_joints:
            raise UsageError(f"the robot has {self.arm.chain.n_joints} joints, but the poses have {q.shape[0]}")
        fixed: list[Term] = []
        values: list[float] = []
        for known in self.known:
            limit = self._range_of(known, validity)
            terms = faded(known.effect, self.arm, held_at_ends(known.effect, self.arm, data, limit), limit)
            fixed.extend(terms)
            values.extend(known.values.get(term.name, 0.0) for term in terms)
        limits = validity if validity is not None else ({},) * len(self.free)
        free = [
            faded(effect, self.arm, held_at_ends(effect, self.arm, data, limit), limit if fades else {})
            for effect, limit in zip(self.free, limits, strict=True)
        ]
        nominal = _with_targets(self.arm, self.arm.chain.scalars(q), data)
        return BoundModel(
            self.arm,
            data.n,
            tuple(nominal),
            tuple(fixed),
            np.array(values),
            tuple(term for terms in free for term in terms),
            tuple(i for i, terms in enumerate(free) for _ in terms),
        )

    def _range_of(self, known: Known, validity: Sequence[Validity] | None) -> Validity:
        """Return the ranges beyond which a known effect is held or fades; empty for one that is fitted."""
        number = next((i for i, effect in enumerate(self.free) if effect.key() == known.effect.key()), None)
        if number is None:
            return known.validity
        return {} if validity is None else united(known.validity, validity[number])


def predict(robot: Robot, data: Measurements) -> Poses:
    """Predict the target poses ``(N)`` at the commanded joints, effects of the robot file included."""
    bound = Model.of(robot).bind(data)
    return bound.poses(np.zeros(0))


def _with_targets(arm: Arm, scalars: list[Scalar], data: Measurements) -> list[Scalar]:
    """Replace the tool by the measured target of each row."""
    targets = arm.robot.targets
    if not targets:
        return scalars
    if data.target is None:
        if len(targets) > 1:
            raise UsageError(f"the robot has the targets {', '.join(targets)}; add a column target to the poses")
        chosen = np.full(data.n, next(iter(targets)))
    else:
        chosen = data.target
    frames = {name: (*frame.xyz, *frame.rpy) for name, frame in targets.items()}
    for coordinate, label in enumerate(("x", "y", "z", "roll", "pitch", "yaw")):
        column = np.zeros(data.n)
        for name, frame in frames.items():
            column[chosen == name] = frame[coordinate]
        scalars[arm.chain.index(TOOL, label)] = column
    return scalars
