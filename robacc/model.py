"""A model: an arm with effects, some known and some free, and what it predicts for measured poses.

:class:`Model` is what is assumed; :meth:`Model.bind` evaluates every regressor for given poses, and the
:class:`BoundModel` predicts and linearises. With all coefficients zero it predicts the nominal chain, bit for bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.chain import TOOL, Scalar, Sweep
from robacc.effects.base import SCALE_OF_INSTRUMENT, Effect, Part, Term, commanded
from robacc.effects.specification import Known, known_effects
from robacc.elasticity import Weights, force, force_derivatives
from robacc.errors import EquilibriumError, UsageError
from robacc.geometry import Array, Poses
from robacc.loads import Load
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

_EQUILIBRIUM_STEPS = 60
_EQUILIBRIUM = 1e-14
"""rad or m: deflections change by less from one sweep to the next."""


@dataclass(frozen=True)
class Model:
    """An arm, the effects known of it (with values), and the effects free to be fitted."""

    arm: Arm
    known: tuple[Known, ...] = ()
    free: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, robot: Robot, free: Sequence[Effect] = ()) -> Model:
        """The model that a robot file describes, with some effects free besides.

        Raises:
            InputError: the file's ``effects:`` cannot be read.
        """
        return cls(Arm.of(robot), known_effects(robot), tuple(free))

    def with_free(self, *effects: Effect) -> Model:
        """The model with more effects free."""
        return dataclasses.replace(self, free=(*self.free, *effects))

    def bind(self, data: Measurements) -> BoundModel:
        """Evaluate every regressor for these poses.

        Raises:
            UsageError: the poses lack what an effect needs, or do not fit the arm.
        """
        q = commanded(data, "a prediction from the robot")
        if q.shape[0] != self.arm.chain.n_joints:
            raise UsageError(f"the robot has {self.arm.chain.n_joints} joints, the poses have {q.shape[0]}")
        fixed: list[Term] = []
        values: list[float] = []
        for known in self.known:
            terms = known.effect.terms(self.arm, data)
            fixed.extend(terms)
            values.extend(known.values.get(term.name, 0.0) for term in terms)
        free = [effect.terms(self.arm, data) for effect in self.free]
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


def predict(robot: Robot, data: Measurements) -> Poses:
    """The target poses ``(N)`` that a robot file predicts for commanded joints, its effects included."""
    bound = Model.of(robot).bind(data)
    return bound.poses(np.zeros(0))


def _with_targets(arm: Arm, scalars: list[Scalar], data: Measurements) -> list[Scalar]:
    """Replace the tool by the target that each row measured."""
    targets = arm.robot.targets
    if not targets:
        return scalars
    if data.target is None:
        if len(targets) > 1:
            raise UsageError(f"the robot has targets {', '.join(targets)}; the poses need a column target")
        chosen = np.full(data.n, next(iter(targets)))
    else:
        chosen = data.target
    for axis, (place, turn) in enumerate((("x", "roll"), ("y", "pitch"), ("z", "yaw"))):
        for label, values in (
            (place, {name: frame.xyz[axis] for name, frame in targets.items()}),
            (turn, {name: frame.rpy[axis] for name, frame in targets.items()}),
        ):
            column = np.zeros(data.n)
            for name, value in values.items():
                column[chosen == name] = value
            scalars[arm.chain.index(TOOL, label)] = column
    return scalars


@dataclass(frozen=True)
class _Entry:
    """Part of term ``number`` (fixed ones first, then free)."""

    number: int
    part: Part


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

    @cached_property
    def _entries(self) -> tuple[_Entry, ...]:
        return tuple(_Entry(i, part) for i, term in enumerate((*self.fixed, *self.terms)) for part in term.parts)

    @cached_property
    def _loads(self) -> dict[int, tuple[Load, ...]]:
        return {id(e.part.loads): e.part.loads for e in self._entries if e.part.loads is not None}

    @cached_property
    def _counts(self) -> tuple[int, ...]:
        return tuple(sorted({load.after for loads in self._loads.values() for load in loads}))

    @cached_property
    def _wanted(self) -> tuple[int, ...]:
        return tuple(sorted({e.part.motion for e in self._entries if e.part.motion != SCALE_OF_INSTRUMENT}))

    def _coefficients(self, theta: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate((self.fixed_values, theta))

    def poses(self, theta: NDArray[Any]) -> Poses:
        """Predicted poses of the target in the measuring frame."""
        coefficients = self._coefficients(theta)
        scalars = self._scalars(coefficients)
        return self._scaled(self.arm.chain.poses(scalars, self.n), coefficients)

    def linearise(self, theta: Array) -> tuple[Poses, Array]:
        """Predicted poses, and ``(6, P, N)`` rows dp (m), dphi (rad) per unit of each free coefficient, exact.

        The deflection of elastic parts changes the moments that cause it; the derivative has that too.
        """
        coefficients = self._coefficients(theta)
        scalars = self._scalars(coefficients)
        sweep = self.arm.chain.sweep(scalars, self.n, self._wanted, self._counts)
        direct = self._direct(sweep, coefficients)
        scale = 1.0 + self._instrument_scale(coefficients)
        jacobian = np.zeros((6, len(self.terms), self.n))
        slot = {k: i for i, k in enumerate(self._wanted)}
        first = len(self.fixed)
        for number, motion, factor in direct.columns:
            if number >= first:
                jacobian[:, number - first] += sweep.jacobian[:, slot[motion]] * factor
        for motion, response in direct.elastic.items():
            jacobian += sweep.jacobian[:, slot[motion]][:, None, :] * response[first:]
        jacobian[:3] *= scale
        for entry in self._entries:
            if entry.part.motion == SCALE_OF_INSTRUMENT and entry.number >= first:
                jacobian[:3, entry.number - first] += sweep.poses.translation * entry.part.factor
        return self._scaled(sweep.poses, coefficients), jacobian

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
        elastic = []
        for entry in self._entries:
            value = coefficients[entry.number]
            if value == 0 or entry.part.motion == SCALE_OF_INSTRUMENT:
                continue
            if entry.part.loads is None:
                added = value * entry.part.factor
                scalars[entry.part.motion] = scalars[entry.part.motion] + _plain(added)
            else:
                elastic.append(entry)
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

    def _direct(self, sweep: Sweep, coefficients: Array) -> _Response:
        """How each scalar answers each coefficient: regressors as they stand, and what the equilibrium adds."""
        slot = {k: i for i, k in enumerate(self._wanted)}
        columns: list[tuple[int, int, Any]] = []
        placed = self._placed(sweep)
        linear, angular = sweep.twists() if placed else (sweep.jacobian[:3], sweep.jacobian[3:])
        slopes: dict[int, Array] = {}
        gravity = np.array(self.arm.robot.gravity)
        for entry in self._entries:
            part = entry.part
            if part.motion == SCALE_OF_INSTRUMENT:
                continue
            factor: Any = part.factor
            if part.loads is not None:
                i = slot[part.motion]
                factor = factor * self._force(placed, part, linear[:, i], angular[:, i])
                value = coefficients[entry.number]
                if value != 0:
                    weights = placed[id(part.loads)]
                    slope = force_derivatives(gravity, weights, part.motion, self._wanted, linear, angular)
                    slopes[part.motion] = slopes.get(part.motion, 0.0) + value * part.factor * slope
            columns.append((entry.number, part.motion, factor))
        return _Response(tuple(columns), self._elastic_response(columns, slopes, slot))

    def _elastic_response(
        self, columns: Sequence[tuple[int, int, Any]], slopes: Mapping[int, Array], slot: Mapping[int, int]
    ) -> dict[int, Array]:
        """``{motion: (P_all, N)}``: solve X = E D + E_FF X, the deflections' answer to every coefficient."""
        if not slopes:
            return {}
        motions = tuple(slopes)
        count = len(self.fixed) + len(self.terms)
        right = np.zeros((self.n, len(motions), count))
        matrix = np.broadcast_to(np.eye(len(motions)), (self.n, len(motions), len(motions))).copy()
        for row, motion in enumerate(motions):
            for number, driven, factor in columns:
                right[:, row, number] += slopes[motion][slot[driven]] * factor
            for column, other in enumerate(motions):
                matrix[:, row, column] -= slopes[motion][slot[other]]
        answer = np.linalg.solve(matrix, right)
        return {motion: np.ascontiguousarray(answer[:, row].T) for row, motion in enumerate(motions)}


@dataclass(frozen=True)
class _Response:
    columns: tuple[tuple[int, int, Any], ...]
    elastic: dict[int, Array]


def _plain(value: Any) -> Scalar:
    """A Python float where the value is one number, so that constants stay cheap."""
    if np.ndim(value) == 0 and not np.iscomplexobj(value):
        return float(value)
    result: NDArray[Any] = np.atleast_1d(value)
    return result
