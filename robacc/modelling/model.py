"""Models of an arm with known and free effects, bound to poses: predictions and their derivatives.

:meth:`Model.bind` evaluates every regressor of a :class:`Model` for given poses; the resulting :class:`BoundModel`
predicts and linearises. With all coefficients zero it predicts the nominal chain, bit for bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from robacc.effects.base import RADIUS, SCALE_OF_INSTRUMENT, Effect, Part, Term, commanded
from robacc.effects.drivers import Validity, united
from robacc.effects.specification import Known, faded, held_at_ends, known_effects
from robacc.errors import EquilibriumError, refuse
from robacc.geometry import (
    Array,
    NDArray,
    Poses,
    compose,
    left_jacobian_inverse,
    log_between,
    rotate,
    rotate_back,
    skew,
    transpose,
    vector_lengths,
)
from robacc.gravity import Load, Weighted, combined, force_derivatives, forces
from robacc.measurements import IMAGES, SHOWN, Measurements
from robacc.poses.cameras import projection
from robacc.robots.arm import BASE, TOOL, Arm, Scalar, Sweep
from robacc.robots.description import FRAME_PARAMETERS, Frame, Robot

# Deflections of the arm under its loads, and their derivatives by every coefficient.
#
# An equilibrium deflection follows from the force at the deflected pose. A rigid-form deflection follows from the force
# at the pose without deflections, which the arm's geometry moves but no deflection does.

_CONVERGED = 1e-14
"""rad or m: largest change of a deflection by all further sweeps at which the iteration ends."""


class TermPart(NamedTuple):
    """Part of term ``number``, counted over the fixed terms of a model, then its free terms."""

    number: int
    part: Part


MotionGain = tuple[int, int, Any]
"""A column, a motion, and the gain ``(N,)``, or a constant, by which the column's coefficient moves the motion."""
_Spring = tuple[Weighted, Any]
"""A motion with its loads, and the factor, a number or ``(N,)``, of gravity's force by which the motion deflects."""


def _followed_by(jacobian: Array, responses: Mapping[int, Array], slot: Mapping[int, int]) -> Array:
    """Return derivatives by motions with those of the deflections that respond ``{motion: (W, N)}`` to them."""
    result = jacobian
    for motion, response in responses.items():
        result = result + jacobian[:, slot[motion]][:, None] * response
    return result


def _springs(entries: Sequence[TermPart], coefficients: NDArray[Any]) -> list[_Spring]:
    """Return the parts with a coefficient; parts of one motion without a regressor are one spring under all loads."""
    plain: dict[int, list[tuple[float, tuple[Load, ...]]]] = {}
    springs: list[_Spring] = []
    for number, part in ((entry.number, entry.part) for entry in entries if coefficients[entry.number] != 0):
        if isinstance(part.factor, np.ndarray) or np.iscomplexobj(coefficients):
            springs.append((Weighted(part.motion, part.loads or ()), coefficients[number] * part.factor))
        else:
            plain.setdefault(part.motion, []).append((float(coefficients[number]) * part.factor, part.loads or ()))
    return springs + [(Weighted(motion, combined(shares)), 1.0) for motion, shares in plain.items()]


def _moved(scalars: Sequence[Scalar], deflections: Mapping[int, NDArray[Any]]) -> list[Scalar]:
    """Return the scalars of the motions with deflections added."""
    return [scalar + deflections[i] if i in deflections else scalar for i, scalar in enumerate(scalars)]


# Model bound to poses: it has every regressor evaluated, and predicts and linearises for any coefficients.


_Layout = tuple[dict[int, int], list[TermPart], list[int], bool]
"""Columns of requested coefficients in a Jacobian: of each term by its number; their parts; the motions that a sweep
follows, that of each column if all are plain, else each motion once; and whether all are plain: each coefficient moves
one motion by just as much, so that its column is that of the motion."""


@dataclass(frozen=True)
class JacobianByMotion:
    """Jacobian ``(M, P, N)`` whose columns are sums of parts: columns of motions times regressors."""

    motions: Array
    """``(M, W, N)`` columns of motions; without parts, those of the coefficients."""
    size: int
    """P."""
    parts: tuple[NDArray[np.int64], NDArray[np.int64], Array] | None = None
    """Number of the coefficient of each part ``(Q,)``, number of its motion's column, and its regressor ``(Q, N)``."""

    @property
    def dense(self) -> Array:
        """The Jacobian."""
        if self.parts is None:
            return self.motions
        jacobian = np.zeros((len(self.motions), self.size, self.motions.shape[2]))
        for place, slot, factor in zip(*self.parts, strict=True):
            jacobian[:, place] += self.motions[:, slot] * factor
        return jacobian


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
    kind: NDArray[Any] | None = None
    """``(N,)`` what each row shows, of :data:`~robacc.measurements.SHOWN`; None for its pose."""
    seen: Array | None = None
    """``(4, N)`` points of a board whose images rows are; see :class:`~robacc.measurements.Measurements`."""
    earlier: tuple[BoundModel, NDArray[np.bool_]] | None = None
    """The same model at the poses that distances are measured from, and the rows ``(N,)`` of such; None if none are."""
    _layouts: dict[bytes, _Layout] = dataclasses.field(init=False, repr=False, compare=False, default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free coefficients."""
        return tuple(term.name for term in self.terms)

    def with_terms(self, terms: Collection[Term]) -> BoundModel:
        """Return the model with further free terms."""
        earlier = None if self.earlier is None else (self.earlier[0].with_terms(terms), self.earlier[1])
        return dataclasses.replace(self, terms=(*self.terms, *terms), earlier=earlier)

    @cached_property
    def with_joints(self) -> BoundModel:
        """The model with the joint variables as further free terms."""
        return self.with_terms([Term(name, "", 1.0, (Part(self.arm.axis_motion(name)),)) for name in self.arm.names])

    def poses(self, theta: NDArray[Any]) -> Poses:
        """Predict the poses of the target in the measuring frame; where a row shows something else, that."""
        coefficients = np.concatenate((self.fixed_values, theta))
        poses = self.arm.chain.poses(self._scalars(coefficients), self.n)
        scale = self._amount(SCALE_OF_INSTRUMENT, coefficients)
        poses = Poses(poses.rotation, poses.translation * (1.0 + scale)) if np.any(scale) else poses
        if self.kind is None:
            return poses
        if self.earlier is not None:
            other, rows = self.earlier
            poses = Poses(poses.rotation, poses.translation - rows * other.poses(theta).translation)
        return Poses(poses.rotation, observed(self.kind, self.seen, poses, self._amount(RADIUS, coefficients))[0])

    def linearise(self, theta: Array, columns: NDArray[np.int64] | None = None, rows: int = 6) -> tuple[Poses, Array]:
        """Return predicted poses and the exact Jacobian ``(6, P, N)``: dp (m), dphi (rad) per unit of coefficient.

        Coefficients that move the arm change the torques that deflect it; the derivative includes this. ``columns``
        ``(K,)`` are the indices of the requested coefficients, in order; by default all. With 3 ``rows``, the Jacobian
        is that of the position.
        """
        poses, jacobian = self.linearise_by_motion(theta, columns, rows)
        return poses, jacobian.dense

    def linearise_by_motion(
        self, theta: Array, columns: NDArray[np.int64] | None = None, rows: int = 6
    ) -> tuple[Poses, JacobianByMotion]:
        """Return what :meth:`linearise` does, with the columns of motions and the regressors apart."""
        column, requested, motions, is_plain = self._layout(np.arange(len(self.terms)) if columns is None else columns)
        coefficients = np.concatenate((self.fixed_values, theta))
        sweep = self.arm.chain.sweep(self._scalars(coefficients), self.n, motions, self._counts)
        rows, wanted = rows if self.kind is None else 6, rows
        by_motion, slot = sweep.jacobian, {motion: number for number, motion in enumerate(motions)}
        parts = [(column[e.number], slot[e.part.motion], e.part.factor) for e in requested if _is_rigid(e.part)]
        if self._elastic:
            undeflected = self._undeflected(coefficients)
            loaded, moved, deflected = self._derivatives(undeflected, sweep, motions, column, coefficients)
            parts = [*((place, slot[motion] + len(slot), factor) for place, motion, factor in loaded), *parts]
            by_motion = np.concatenate((moved, deflected), axis=1)
        poses, by_motion = sweep.poses, by_motion[:rows]
        if self._beyond_chain:
            stretch, distance = 1.0 + self._amount(SCALE_OF_INSTRUMENT, coefficients), vector_lengths(poses.translation)
            # Of a sphere only the distance from its centre counts, which falls short by the radius.
            grown = np.stack((poses.translation, -poses.translation / np.maximum(distance, 1e-300)), axis=1)
            grown = np.concatenate((grown, np.zeros((rows - 3, 2, self.n))))
            parts += [
                (column[e.number], by_motion.shape[1] + (e.part.motion == RADIUS), e.part.factor)
                for e in self._beyond_chain
                if e.number in column
            ]
            by_motion = np.concatenate((by_motion[:3] * stretch, by_motion[3:]))
            by_motion = by_motion if is_plain else np.concatenate((by_motion, grown), axis=1)
            poses = Poses(poses.rotation, poses.translation * stretch)
        jacobian = JacobianByMotion(by_motion, len(column))
        if not is_plain:
            places, slots, factors = ([part[k] for part in parts] for k in range(3))
            factor = np.array([np.full(self.n, each) for each in factors]).reshape(len(parts), self.n)
            numbers = np.array(places, dtype=np.int64), np.array(slots, dtype=np.int64)
            jacobian = dataclasses.replace(jacobian, parts=(*numbers, factor))
        if self.kind is None:
            return poses, jacobian
        if self.earlier is not None:
            other, between = self.earlier
            start, before = other.linearise(theta, columns)
            poses = Poses(poses.rotation, poses.translation - between * start.translation)
            jacobian = JacobianByMotion(jacobian.dense - between * before, jacobian.size)
        position, gradient = observed(self.kind, self.seen, poses, self._amount(RADIUS, coefficients))
        shown = np.einsum("abn,bpn->apn", gradient, jacobian.motions)
        moved = np.concatenate((shown, jacobian.motions[3:]))[:wanted]
        return Poses(poses.rotation, position), dataclasses.replace(jacobian, motions=moved)

    def _layout(self, columns: NDArray[np.int64]) -> _Layout:
        """Return how the columns of requested coefficients follow from a sweep; layouts are kept."""
        key = columns.tobytes()
        if key not in self._layouts:
            numbers, elastic = columns.tolist(), self._elastic
            column = {len(self.fixed) + number: i for i, number in enumerate(numbers)}
            requested = [entry for entry in self._entries if entry.number in column]
            # Each coefficient moves a motion by just as much.
            is_plain = (
                not elastic
                and len(requested) == len(column)
                and all(
                    _is_rigid(e.part) and isinstance(e.part.factor, float) and e.part.factor == 1.0 for e in requested
                )
            )
            own = [part.motion for number in numbers for part in self.terms[number].parts]
            of_chain = (motion for motion in {*own, *(e.part.motion for e in elastic)} if motion >= 0)
            motions = own if is_plain else sorted(of_chain)
            self._layouts[key] = (column, requested, motions, is_plain)
        return self._layouts[key]

    @cached_property
    def _entries(self) -> tuple[TermPart, ...]:
        """Parts of the fixed terms, then of the free ones."""
        return tuple(TermPart(i, part) for i, term in enumerate((*self.fixed, *self.terms)) for part in term.parts)

    @cached_property
    def _elastic(self) -> list[TermPart]:
        """Parts by which a load deflects a motion."""
        return [entry for entry in self._entries if entry.part.loads is not None]

    @cached_property
    def _regressors(self) -> list[tuple[int, NDArray[np.int64], Array]]:
        """Motions that terms move by regressors: of each the numbers of the terms ``(Q,)``, and the regressors."""
        by_motion: dict[int, list[TermPart]] = {}
        for entry in self._entries:
            if _is_rigid(entry.part) and isinstance(entry.part.factor, np.ndarray):
                by_motion.setdefault(entry.part.motion, []).append(entry)
        return [
            (motion, np.array([entry.number for entry in entries]), np.stack([entry.part.factor for entry in entries]))
            for motion, entries in by_motion.items()
        ]

    @cached_property
    def _constants(self) -> list[TermPart]:
        """Parts that move a motion by a constant."""
        return [e for e in self._entries if _is_rigid(e.part) and not isinstance(e.part.factor, np.ndarray)]

    @cached_property
    def _beyond_chain(self) -> list[TermPart]:
        """Parts of pseudo-motions: the instrument's scale, and radii of spheres."""
        return [entry for entry in self._entries if entry.part.motion < 0]

    def _amount(self, motion: int, coefficients: NDArray[Any]) -> Any:
        """Return by how much the instrument's scale differs from 1, or the radius of each row's sphere, m."""
        return sum(coefficients[e.number] * e.part.factor for e in self._beyond_chain if e.part.motion == motion)

    def _undeflected(self, coefficients: NDArray[Any]) -> list[Scalar]:
        """Return every scalar of the chain without deflections."""
        scalars, values = list(self.nominal), coefficients.tolist()
        for motion, numbers, factors in self._regressors:
            if np.any(coefficients[numbers]):
                scalars[motion] = scalars[motion] + coefficients[numbers] @ factors
        for number, part in self._constants:
            if values[number] != 0:
                added = values[number] * part.factor
                scalars[part.motion] = scalars[part.motion] + (added if isinstance(added, float) else np.array([added]))
        return scalars

    @cached_property
    def _counts(self) -> tuple[int, ...]:
        """Motion counts after which a sweep must keep the frame of a load."""
        return tuple(sorted({load.after for entry in self._elastic for load in entry.part.loads or ()}))

    def _of_form(self, *, deflected: bool) -> list[TermPart]:
        """Return the parts whose force is evaluated at the deflected pose, or at the undeflected one."""
        return [entry for entry in self._elastic if entry.part.deflected == deflected]

    def _scalars(self, coefficients: NDArray[Any]) -> list[Scalar]:
        """Return every scalar of the chain, deflections included.

        Raises:
            EquilibriumError: There is no equilibrium, because the arm is too soft for its weight.
        """
        scalars = self._undeflected(coefficients)
        if first := _springs(self._of_form(deflected=False), coefficients):
            scalars = _moved(scalars, self._deflections_at(scalars, first))
        if not (elastic := _springs(self._of_form(deflected=True), coefficients)):
            return scalars
        deflections, last_change = dict[int, NDArray[Any]](), np.inf
        for _ in range(60):
            previous, deflections = deflections, self._deflections_at(_moved(scalars, deflections), elastic)
            changes = [np.abs(values - previous.get(motion, 0.0)) for motion, values in deflections.items()]
            change = float(np.max(changes, initial=0.0))
            # Changes shrink at a constant rate. The derivative that a complex step carries lags behind them.
            rate, is_real = change / last_change, not any(map(np.iscomplexobj, deflections.values()))
            if change < _CONVERGED or (0.0 < rate < 1.0 and is_real and change * rate < _CONVERGED * (1.0 - rate)):
                return _moved(scalars, deflections)
            last_change = change
        raise EquilibriumError(
            "the elastic equilibrium does not converge: a compliance is too large for the arm's weight; "
            "check the unit of the compliance and the masses in the robot file"
        )

    def _deflections_at(self, scalars: Sequence[Scalar], springs: Sequence[_Spring]) -> dict[int, NDArray[Any]]:
        """Return the deflections ``(N,)`` by motion under the forces at the pose of ``scalars``."""
        motions = sorted({weighted.motion for weighted, _ in springs})
        sweep = self.arm.chain.sweep(scalars, self.n, motions, self._counts)
        torques = self._forces(sweep, motions, [weighted for weighted, _ in springs])
        deflections: dict[int, NDArray[Any]] = {}
        for (weighted, factor), torque in zip(springs, torques, strict=True):
            deflections[weighted.motion] = deflections.get(weighted.motion, 0.0) + factor * torque
        return deflections

    def _forces(self, sweep: Sweep, motions: Sequence[int], weighted: Sequence[Weighted]) -> NDArray[Any]:
        """Return gravity's force along each of the motions at the pose of a sweep over ``motions``."""
        linear, angular = sweep.twists()
        at = [motions.index(item.motion) for item in weighted]
        frames = dict(zip(self._counts, sweep.frames, strict=True))
        return forces(np.array(self.arm.robot.gravity), weighted, frames, linear[:, at], angular[:, at])

    def _derivatives(
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
            sweep = self.arm.chain.sweep(undeflected, self.n, motions, self._counts)
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
        requested = [entry for entry in elastic if entry.number in column]
        torques = self._forces(sweep, list(slot), [Weighted(e.part.motion, e.part.loads or ()) for e in requested])
        gains = [
            (column[entry.number], entry.part.motion, entry.part.factor * torque)
            for entry, torque in zip(requested, torques, strict=True)
        ]
        slopes: dict[int, Array] = {}
        frames, gravity = dict(zip(self._counts, sweep.frames, strict=True)), np.array(self.arm.robot.gravity)
        for weighted, factor in _springs(elastic, coefficients):
            slope = force_derivatives(gravity, weighted, frames, tuple(slot), *sweep.twists())
            slopes[weighted.motion] = slopes.get(weighted.motion, 0.0) + factor * slope
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


def _is_rigid(part: Part) -> bool:
    """Return whether a part moves a motion of the chain without a load."""
    return part.loads is None and part.motion >= 0


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
        n_joints = self.arm.chain.n_joints
        refuse((len(q) != n_joints, f"the robot has {n_joints} joints, but the poses have {len(q)}"))
        limits = validity if validity is not None else ({},) * len(self.free)
        own = dict(zip((effect.key() for effect in self.free), limits, strict=True))
        known_limits = [
            known.validity
            if (key := known.effect.key()) not in own
            else {}
            if validity is None
            else united(known.validity, own[key])
            for known in self.known
        ]
        fixed = [
            (term, known.values.get(term.name, 0.0))
            for known, limit in zip(self.known, known_limits, strict=True)
            for term in faded(known.effect, self.arm, held_at_ends(known.effect, self.arm, data, limit), limit)
        ]
        free = [
            faded(effect, self.arm, held_at_ends(effect, self.arm, data, limit), limit if fades else {})
            for effect, limit in zip(self.free, limits, strict=True)
        ]
        scalars, targets = self.arm.chain.scalars(q), self.arm.robot.targets
        lacking = f"the robot has the targets {', '.join(targets)}; add a column target to the poses"
        refuse((len(targets) > 1 and data.target is None, lacking))
        if targets:
            chosen = np.full(data.n, next(iter(targets))) if data.target is None else data.target
            scalars = _with_frames(self.arm, scalars, TOOL, targets, chosen)
        if data.fixture is not None:
            # The base is where it stands, seen from the socket, plane or anchor of each row.
            robot = self.arm.robot
            spheres = {name: each.radius for name, each in robot.fixtures.items() if each.radius}
            fixed += [(Term(name, "m", 1.0, (Part(RADIUS, data.fixture == name),)), spheres[name]) for name in spheres]
            bases = {name: fixture.base for name, fixture in robot.fixtures.items()} | {"": robot.base}
            scalars = _with_frames(self.arm, scalars, BASE, bases, data.fixture)
        earlier = None
        if data.reference is not None and data.kind is not None and data.fixture is not None:
            between: NDArray[np.bool_] = (data.kind == "distance") & (data.fixture == "")
            earlier = self.bind(data.reference, validity, fades=fades), between
        return BoundModel(
            self.arm,
            data.n,
            tuple(scalars),
            tuple(term for term, _ in fixed),
            np.array([value for _, value in fixed]),
            tuple(term for terms in free for term in terms),
            tuple(i for i, terms in enumerate(free) for _ in terms),
            data.kind,
            data.seen,
            earlier,
        )


def predict(robot: Robot, data: Measurements) -> Poses:
    """Predict the target poses ``(N)`` at the commanded joints, effects of the robot file included."""
    return Model.of(robot).bind(data).poses(np.zeros(0))


def _with_frames(
    arm: Arm, scalars: list[Scalar], owner: int, frames: Mapping[str, Frame], chosen: NDArray[Any]
) -> list[Scalar]:
    """Replace a frame of the chain by the one that is ``chosen`` ``(N,)`` by its name for each row."""
    for coordinate, label in enumerate(FRAME_PARAMETERS):
        column = np.zeros(chosen.size)
        for name, frame in frames.items():
            column[chosen == name] = (*frame.xyz, *frame.rpy)[coordinate]
        scalars[arm.chain.index(owner, label)] = column
    return scalars


# Observation: kinds of measurement, noise, residuals and their exact derivative.
#
# With p the position of the target in the frame of a fixture, a row of kind `point` shows p, which is 0 in the socket;
# `plane` its z, the height above the plane; `line` its x and y across the line, which are 0; `distance` its length |p|,
# or that of the difference of two positions; `sphere` |p| less a radius. Where the fixture stands is unknown: six
# coordinates of the base for each, of which the poses determine three, or four of a line. `image` shows the ray of a
# point X of a board, in m at the usual depth: with R the orientation of the target, X is at p + R X before a camera
# beside the arm, whose frame that of the fixture is, and at R'(X - p) before one that is the target. What a row does
# not show is 0, measured and predicted.


def observed(kind: NDArray[Any], seen: Array | None, poses: Poses, radius: Array | float) -> tuple[NDArray[Any], Array]:
    """Return what rows of these kinds ``(N,)`` show of poses, and the derivative ``(3, 6, N)`` by dp and dphi.

    ``radius`` ``(N,)`` is that of the sphere of each row, m, and 0 of other rows.
    """
    position, is_length = poses.translation, np.isin(kind, ("distance", "sphere"))
    shown = np.array([SHOWN[name] for name in kind.tolist()]).T
    value, gradient = position * shown, np.eye(3, 6)[..., None] * shown[:, None]
    value[2, is_length] = np.sqrt(np.sum(np.square(position[:, is_length]), axis=0))
    gradient[2, :3, is_length] = (position[:, is_length].real / np.maximum(value[2, is_length].real, 1e-300)).T
    value[2] -= radius
    if seen is None:
        return value, gradient
    for from_hand in (False, True):
        rows = np.flatnonzero(kind == IMAGES[from_hand])
        turn, depth = poses.rotation[..., rows], seen[3, rows]
        lever = seen[:3, rows] - position[:, rows] if from_hand else rotate(turn, seen[:3, rows])
        at = rotate_back(turn, lever) if from_hand else position[:, rows] + lever
        ahead = depth * projection(at.real)
        if from_hand:
            ahead = -compose(ahead, transpose(turn.real))
        value[:, rows] = depth * at / at[2]
        value[2, rows], gradient[2][:, rows] = 0.0, 0.0
        gradient[:2, :3, rows], gradient[:2, 3:, rows] = ahead, -compose(ahead, skew(lever.real))
    return value, gradient


NoiseSource = Literal["file", "file and misfit", "repeats", "residual", "given"]


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviation along each axis of the error that the model does not predict."""

    position: float
    """m, RMS over poses and axes."""
    orientation: float | None
    """rad; None where orientation was not measured."""
    source: NoiseSource
    along_axes: tuple[float, float, float] | None = None
    """m, along x, y, z of the measuring frame; None if they do not differ."""

    @classmethod
    def of_variances(cls, position: Array, orientation: float | None, source: NoiseSource) -> Noise:
        """Return the noise of mean variances ``position`` ``(3,)`` (m²) along the axes.

        ``orientation`` is a standard deviation, rad.
        """
        x, y, z = np.sqrt(position).tolist()
        differ = max(x, y, z) > 1.01 * min(x, y, z)
        return cls(float(np.sqrt(np.mean(position))), orientation, source, (x, y, z) if differ else None)


def residuals(data: Measurements, poses: Poses) -> Array:
    """Return the residuals ``(M, N)``: measured minus predicted pose, in the measuring frame.

    Position (m) comes first. Where orientation was measured (M = 6), the rotation vector log(R_measured R_predicted^T)
    (rad) follows.
    """
    position = data.position - poses.translation
    return position if data.rotation is None else np.concatenate((position, log_between(data.rotation, poses.rotation)))


def joint_columns(model: Model, data: Measurements) -> Array:
    """Return ``(6, J, N)`` Jacobian of the joint variables at the model's robot, without its free effects."""
    return dataclasses.replace(model, free=()).bind(data).with_joints.linearise(np.zeros(len(model.arm.names)))[1]


def observed_jacobian(jacobian: Array, residual: Array) -> Array:
    """Return minus the derivative of :func:`residuals`, ``(M, P, N)``, from rows dp, dphi of the predicted pose.

    log(R exp(-dphi)) = r - J_r^-1(r) dphi with J_r(r) = J_l(-r), so orientation is exact for residuals of any size.
    """
    if residual.shape[0] == 3:
        return jacobian[:3]
    turned = np.einsum("ijn,jpn->ipn", left_jacobian_inverse(-residual[3:]), jacobian[3:])
    return np.concatenate((jacobian[:3], turned))
