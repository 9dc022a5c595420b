"""Arm for computations: a chain of elementary motions, its poses, exact Jacobian, inverse kinematics, and reach.

A chain is a product of elementary motions, each a rotation or a translation along a coordinate axis by one scalar:

    T = E_1(s_1) E_2(s_2) … E_K(s_K).

A DH row is Rz(theta) Tz(d) Tx(a) Rx(alpha), a modified one Rx(alpha) Tx(a) Rz(theta) Tz(d), a URDF joint
Tx Ty Tz Rz Ry Rx and its axis; base and tool are motions too. Equation (6) of Wu and Lee (1985) then needs no case
distinction: the column of scalar k is the twist of motion k transformed to the tool,

    rotation:     dp = z_k x (p - o_k),  dphi = z_k
    translation:  dp = z_k,              dphi = 0

with z_k the motion's axis and o_k a point on it, both in the measuring frame, from a single forward sweep.

A scalar is a float where it is the same for all poses and an ``(N,)`` array where it varies; constant runs stay
``(3, 1)`` until the first varying scalar.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from robacc.errors import Problem, UsageError, by_key, refuse
from robacc.geometry import Array, NDArray, Poses, compose, cross, log_so3, rms_length, transpose
from robacc.robots.description import (
    FRAME_PARAMETERS,
    LENGTH_PARAMETERS,
    ZERO,
    BranchJoint,
    Frame,
    Joint,
    Robot,
    Vector,
)

BLOCK = 4096
"""Poses per block: the working arrays of a block stay in the second-level cache."""


BASE = -1
TOOL = -2

Scalar = float | NDArray[Any]


class Motion(NamedTuple):
    """Elementary motion along or about coordinate ``axis`` of the preceding frame."""

    kind: Literal["rotation", "translation"]
    axis: int
    value: float
    """Nominal scalar, m or rad."""
    owner: int
    """Index of the joint in the robot's list, or :data:`BASE` or :data:`TOOL`."""
    label: str
    """``theta``, ``d``, ``alpha``, ``flex_x`` …; unique within the owner, or empty if it never varies."""

    @property
    def unit(self) -> str:
        """Unit of the scalar."""
        return "rad" if self.kind == "rotation" else "m"


class JointDrive(NamedTuple):
    """Joint variable ``joint`` added to the scalar of motion ``motion`` with a coefficient (sign or mimic ratio)."""

    motion: int
    joint: int
    coefficient: float


class Body(NamedTuple):
    """Mass on the chain, at ``com`` in the frame after motion ``after - 1``."""

    after: int
    """Number of motions before the body's frame: motions ``0 … after - 1`` move the body."""
    owner: int
    com: tuple[float, float, float]
    mass: float


class Sweep(NamedTuple):
    """Results of a forward sweep, in the measuring frame."""

    poses: Poses
    """Tool poses over N."""
    jacobian: Array
    """``(6, W, N)``: rows dp (m), dphi (rad) of the tool per unit of each wanted scalar."""
    frames: tuple[Poses, ...]
    """The frame after each of the wanted motion counts (link frames), over N."""

    def twists(self) -> tuple[Array, Array]:
        """Return spatial twists (v, w), each ``(3, W, N)``: a point c behind the motion has the velocity v + w x c."""
        linear, angular = self.jacobian[:3], self.jacobian[3:]
        return linear - cross(angular, self.poses.translation[:, None, :]), angular


@dataclass(frozen=True)
class Chain:
    """Serial arm as elementary motions. Immutable; every method is a pure function of its arguments."""

    motions: tuple[Motion, ...]
    drives: tuple[JointDrive, ...]
    n_joints: int
    """Number of joint variables."""
    bodies: tuple[Body, ...] = ()
    joint_axis: tuple[int, ...] = ()
    """Index of the motion that each joint variable drives."""

    @cached_property
    def _index(self) -> dict[tuple[int, str], int]:
        """Index of each motion by owner and label."""
        return {(motion.owner, motion.label): k for k, motion in enumerate(self.motions) if motion.label}

    def index(self, owner: int, label: str) -> int:
        """Return the index of a motion that must exist."""
        return self._index[owner, label]

    def scalars(self, q: NDArray[Any]) -> list[Scalar]:
        """Return nominal scalars at joint variables ``q`` ``(J, N)``: floats where constant, ``(N,)`` where driven."""
        values: list[Scalar] = [motion.value for motion in self.motions]
        for drive in self.drives:
            values[drive.motion] = values[drive.motion] + drive.coefficient * q[drive.joint]
        return values

    def forward(self, q: NDArray[Any]) -> Poses:
        """Return nominal tool poses in the measuring frame for joint variables ``q`` ``(J, N)`` in rad or m."""
        return self.poses(self.scalars(q), q.shape[1])

    def poses(self, scalars: Sequence[Scalar], n: int) -> Poses:
        """Return tool poses for any scalars."""
        return self.sweep(scalars, n, ()).poses

    def sweep(
        self,
        scalars: Sequence[Scalar],
        n: int,
        wanted: Sequence[int] | None = None,
        frames: Sequence[int] = (),
    ) -> Sweep:
        """Return poses, Jacobian columns of the ``wanted`` motions (default all) and frames, in one pass.

        ``frames`` are motion counts after which the frame is stored (a body's ``after``).
        """
        wanted = range(len(self.motions)) if wanted is None else wanted
        dtype = np.result_type(np.float64, *(scalar.dtype for scalar in scalars if not isinstance(scalar, float)))
        jacobian = np.empty((6, len(wanted), n), dtype=dtype)
        stored = {
            count: Poses(np.empty((3, 3, n), dtype=dtype), np.empty((3, n), dtype=dtype))
            for count in (*frames, len(self.motions))
        }
        slots = by_key((k, slot) for slot, k in enumerate(wanted))
        rotations = [slot for slot, k in enumerate(wanted) if self.motions[k].kind == "rotation"]
        for block in self.blocks(n):
            columns, origin = [np.eye(3)[:, [axis]] for axis in range(3)], np.zeros((3, 1))
            for k, motion in enumerate(self.motions):
                if k in stored:
                    _store(stored[k], columns, origin, block)
                for slot in slots.get(k, ()):
                    # A rotation's origin and axis until the tool is known, or a translation's axis and zeros.
                    axis, is_rotation = columns[motion.axis], motion.kind == "rotation"
                    jacobian[:3, slot, block] = origin if is_rotation else axis
                    jacobian[3:, slot, block] = axis if is_rotation else 0.0
                scalar = scalars[k]
                value = scalar if isinstance(scalar, float) else scalar[block]
                if not isinstance(value, float) or value != 0.0:
                    origin = _advance(columns, origin, motion, value)
            _store(stored[len(self.motions)], columns, origin, block)
            _transform_to_tool(jacobian[:, :, block], rotations, origin)
        return Sweep(stored[len(self.motions)], jacobian, tuple(stored[count] for count in frames))

    def jacobian(self, q: NDArray[Any], wanted: Sequence[int] | None = None) -> Array:
        """Return the nominal Jacobian ``(6, W, N)``, rows dp, dphi, to ``wanted`` scalars (default all K)."""
        return self.sweep(self.scalars(q), q.shape[1], wanted).jacobian

    def blocks(self, n: int) -> Iterator[slice]:
        """Return slices of at most :data:`BLOCK` poses that cover ``n``."""
        return (slice(start, min(start + BLOCK, n)) for start in range(0, n, BLOCK))


def _transform_to_tool(jacobian: NDArray[Any], rotations: Sequence[int], tip: NDArray[Any]) -> None:
    """Replace rotations' origins ``jacobian[:3, rotations]`` by the displacement of the tool, z x (p - o)."""
    # Few poses: many motions per call; many poses: a motion at a time, which fits the first-level cache.
    # Numbers per row in a NumPy call: with fewer, the call takes longer than the computation.
    step = max(1, 2048 // max(jacobian.shape[-1], 1))
    for first in range(0, len(rotations), step):
        chunk = rotations[first : first + step]
        columns: Any = chunk if step > 1 else slice(chunk[0], chunk[0] + 1)
        x, y, z = tip[:, None] - jacobian[:3, columns]
        u, v, w = jacobian[3:, columns]
        jacobian[0, columns] = v * z - w * y
        jacobian[1, columns] = w * x - u * z
        jacobian[2, columns] = u * y - v * x


def _store(target: Poses, columns: list[NDArray[Any]], origin: NDArray[Any], block: slice) -> None:
    for axis in range(3):
        target.rotation[:, axis, block] = columns[axis]
    target.translation[:, block] = origin


def _advance(columns: list[NDArray[Any]], origin: NDArray[Any], motion: Motion, value: Scalar) -> NDArray[Any]:
    """Apply a motion: turn two of the frame's axes in place, or return the moved origin."""
    if motion.kind == "translation":
        return origin + columns[motion.axis] * value
    cosine, sine = _cos_sin(value)
    j, k = (motion.axis + 1) % 3, (motion.axis + 2) % 3
    first, second = columns[j], columns[k]
    columns[j] = cosine * first + sine * second
    columns[k] = cosine * second - sine * first
    return origin


def _cos_sin(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Return cosine and sine; for arrays from the tangent of the half angle, which NumPy vectorises better.

    The absolute error is below 4e-16, also at pi, where the tangent is about 1e16 and both quotients are still exact.
    Complex arrays use the functions themselves, because a complex step at pi needs them.
    """
    if isinstance(angle, float):
        return math.cos(angle), math.sin(angle)
    if np.iscomplexobj(angle):
        return np.cos(angle), np.sin(angle)
    tangent = np.tan(0.5 * angle)
    square = tangent * tangent
    divisor = 1.0 / (1.0 + square)
    return (1.0 - square) * divisor, 2.0 * tangent * divisor


# Build the chain of elementary motions of a robot's description.

_FRAME_ORDER = ("x", "y", "z", "yaw", "pitch", "roll")
_AXIS_OF = {
    "x": 0,
    "y": 1,
    "z": 2,
    "roll": 0,
    "pitch": 1,
    "yaw": 2,
    "theta": 2,
    "d": 2,
    "a": 0,
    "alpha": 0,
    "beta": 1,
    "offset": 2,
    "flex_x": 0,
    "flex_y": 1,
    "turn_x": 0,
    "turn_y": 1,
    "turn_z": 2,
}

TURNS = ("turn_x", "turn_y", "turn_z")
"""Zero-valued rotations after those of the base, of the tool and of a URDF's origins: corrections about the frame's own
axes, which have full rank at any pitch."""
TURN_OF_ANGLE = dict(zip(("roll", "pitch", "yaw"), TURNS, strict=True))
"""Motion that a correction or an error called roll, pitch or yaw moves."""
FLEXURES = ("flex_x", "flex_y")
"""Zero-valued rotations across each joint's axis, in front of it: the bending of a bearing."""
_ROWS = {
    "standard": (*FLEXURES, "theta", "d", "a", "alpha", "beta"),
    "modified": ("alpha", "a", "beta", *FLEXURES, "theta", "d"),
}
"""Motions of a table's row, by its convention."""


def build_chain(robot: Robot) -> Chain:
    """Return the arm as elementary motions: base, joints in order, tool.

    Every joint gets two flexures in front of its axis. Joint variables drive the axis with the joint's sign; a mimic
    joint is driven by its master's variable, a coupled joint by those of its coupling too.
    """
    number = {joint.name: i for i, joint in enumerate(robot.variables)}
    motions, drives, bodies = _links(_frame_motions(robot.base, BASE), robot.joints, robot.convention, number)
    motions += _frame_motions(robot.tool, TOOL)
    index = {(motion.owner, motion.label): k for k, motion in enumerate(motions)}
    variables = ((owner, joint) for owner, joint in enumerate(robot.joints) if joint.is_variable)
    joint_axis = tuple(index[owner, joint.offset_parameter] for owner, joint in variables)
    return Chain(tuple(motions), tuple(drives), len(number), tuple(bodies), joint_axis)


def _links(
    motions: list[Motion], joints: Sequence[Joint], convention: str, number: Mapping[str, int]
) -> tuple[list[Motion], list[JointDrive], list[Body]]:
    """Return ``motions`` and those of joints behind them, what drives these, and the links' masses.

    Args:
        motions: Motions in front of the first joint.
        joints: Joints in order; their places are the owners of their motions.
        convention: Convention of the joints.
        number: Number of each joint variable, by the name of its joint.
    """
    drives: list[JointDrive] = []
    bodies: list[Body] = []
    for owner, joint in enumerate(joints):
        first = len(motions)
        motions += _joint_motions(joint, owner, convention)
        # Movement per unit of each joint variable that drives the joint, before its sign.
        own, mimic = {joint.name: 1.0} if joint.is_variable else {}, joint.mimic
        ratios = own | dict(joint.coupling) if mimic is None else {mimic.master: mimic.multiplier}
        drives += [
            JointDrive(axis, number[name], joint.sign * ratio)
            for axis in range(first, len(motions) if joint.type != "fixed" else first)
            if motions[axis].label == joint.offset_parameter
            for name, ratio in ratios.items()
        ]
        if joint.mass:
            bodies.append(Body(len(motions), owner, joint.com or ZERO, joint.mass))
    return motions, drives, bodies


def _motions(labels: Iterable[str], values: Mapping[str, float], owner: int) -> list[Motion]:
    """Return the motions of some labels, zero without a value."""
    return [
        Motion(
            "translation" if label in LENGTH_PARAMETERS else "rotation",
            _AXIS_OF[label],
            float(values.get(label, 0.0)),
            owner,
            label,
        )
        for label in labels
    ]


def _frame_motions(frame: Frame, owner: int) -> list[Motion]:
    values = dict(zip(FRAME_PARAMETERS, (*frame.xyz, *frame.rpy), strict=True))
    return _motions((*_FRAME_ORDER, *TURNS), values, owner)


def _joint_motions(joint: Joint, owner: int, convention: str) -> list[Motion]:
    values = joint.parameters
    if convention != "urdf":
        return _motions(_ROWS[convention], values, owner)
    origin = _motions((*_FRAME_ORDER, *TURNS), values, owner)
    if joint.type == "fixed":
        return origin
    offset = values.get("offset", 0.0) + (joint.sign * joint.mimic.offset if joint.mimic else 0.0)
    x, y, z = joint.axis
    across = float(np.hypot(x, y))
    yaw, pitch = float(np.arctan2(y, x)) if across > 0 else 0.0, float(np.arctan2(across, z))
    # Rz(yaw) Ry(pitch) turns z onto the axis; a motion that never varies has no label.
    forth = [Motion("rotation", 2, yaw, owner, ""), Motion("rotation", 1, pitch, owner, "")]
    back = [Motion("rotation", 1, -pitch, owner, ""), Motion("rotation", 2, -yaw, owner, "")]
    variable = Motion("rotation" if joint.type == "revolute" else "translation", 2, offset, owner, "offset")
    return [*origin, *forth, *_motions(FLEXURES, {}, owner), variable, *back]


@dataclass(frozen=True, eq=False)
class Arm:
    """Robot and the chain built from it. Joint variables are numbered from 0 in chain order."""

    robot: Robot
    chain: Chain

    @classmethod
    def of(cls, robot: Robot) -> "Arm":
        """Build the chain of a robot."""
        return cls(robot, build_chain(robot))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the joint variables."""
        return self.robot.variable_names

    @cached_property
    def owners(self) -> tuple[int, ...]:
        """Index of each joint variable's joint in the robot's list, which also has fixed and mimic joints."""
        return tuple(i for i, joint in enumerate(self.robot.joints) if joint.is_variable)

    def number(self, name: str) -> int:
        """Return the number of the joint variable called ``name``.

        Raises:
            UsageError: No variable has this name; the message lists the names.
        """
        try:
            return self.names.index(name)
        except ValueError:
            raise UsageError(f"no joint {name!r}; this arm has {', '.join(self.names)}") from None

    def joint(self, name: str) -> Joint:
        """Return the joint of a variable."""
        return self.robot.joints[self.owners[self.number(name)]]

    def is_revolute(self, name: str) -> bool:
        """Return whether the joint is revolute."""
        return self.joint(name).type == "revolute"

    def unit(self, name: str) -> str:
        """Return the unit of the joint's variable: ``rad`` or ``m``."""
        return "rad" if self.is_revolute(name) else "m"

    def axis_motion(self, name: str) -> int:
        """Return the index of the motion that the joint's variable drives."""
        return self.chain.joint_axis[self.number(name)]

    def motion(self, name: str, label: str) -> int:
        """Return the index of the motion ``label`` of the joint's row."""
        return self.chain.index(self.owners[self.number(name)], label)

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """Motions that are lengths of the arm: every d and a, or every coordinate of a URDF's origins."""
        return tuple(k for k, m in enumerate(self.chain.motions) if m.owner >= 0 and m.label in LENGTH_PARAMETERS)

    @cached_property
    def flange(self) -> int:
        """Number of motions before the tool, which end at the last link's frame."""
        return next(k for k, motion in enumerate(self.chain.motions) if motion.owner == TOOL)

    @cached_property
    def branches(self) -> tuple[tuple[int, Chain], ...]:
        """Chains of joints beside the arm's that move mass, each with the number of motions up to its carrier.

        Every link beside the arm's is a body of one of them. Their joint variables are those of the branches, and then
        the arm's.
        """
        variables = (*(branch.joint.name for branch in self.robot.branch_variables), *self.names)
        number = {name: i for i, name in enumerate(variables)}
        paths: dict[str | None, tuple[BranchJoint, ...]] = {}
        for branch in self.robot.branches:
            paths[branch.joint.name] = (*paths.get(branch.parent, ()), branch)
        places = {joint.name: owner for owner, joint in enumerate(self.robot.joints)}
        counted: set[str] = set()
        chains = []
        for path in sorted(paths.values(), key=len, reverse=True):
            if (joints := [branch.joint for branch in path])[-1].name in counted:
                continue
            motions, drives, bodies = _links([], joints, "urdf", number)
            kept = tuple(body for body in bodies if joints[body.owner].name not in counted)
            counted.update(joint.name for joint in joints)
            carrier = places.get(path[0].parent or "", BASE)
            before = 1 + max(k for k, motion in enumerate(self.chain.motions) if motion.owner == carrier)
            chains.append((before, Chain(tuple(motions), tuple(drives), len(variables), kept)))
        return tuple(chains)

    @cached_property
    def payload_com(self) -> Vector:
        """Payload's centre of mass in the last link's frame, m: from the file, else at the tool."""
        if self.robot.payload_com is not None:
            return self.robot.payload_com
        if self.robot.targets:
            x, y, z = np.mean([frame.xyz for frame in self.robot.targets.values()], axis=0)
            return float(x), float(y), float(z)
        return self.robot.tool.xyz


def outline(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return a typical pose ``(J,)`` of all ``(J, N)``, and the corners ``(3, P)`` of the line from base to tool there.

    It is the pose nearest to the median of all, each joint scaled by its range. The line, in the measuring frame, m,
    begins at the base, wherever the instrument stands. Every translation of the chain is a straight piece, so the
    corners include the shoulder and elbow of a DH table.
    """
    ranges = np.ptp(q, axis=1, keepdims=True)
    ranges[ranges == 0] = 1.0
    distance = np.sum(np.square((q - np.median(q, axis=1, keepdims=True)) / ranges), axis=0)
    typical = q[:, [int(np.argmin(distance))]]
    counts = list(range(sum(motion.owner == BASE for motion in arm.chain.motions), len(arm.chain.motions) + 1))
    frames = arm.chain.sweep(arm.chain.scalars(typical), 1, (), counts).frames
    points = np.concatenate([frame.translation for frame in frames], axis=1)
    is_new = np.any(np.abs(np.diff(points, axis=1)) > 1e-9, axis=0)
    return typical[:, 0], points[:, np.concatenate(([True], is_new))]


# Inverse kinematics: damped Newton steps on an exact Jacobian, for nominal arms and for models of real ones.
#
# All poses are solved at once. With e the error of a pose, A its Jacobian to the joints and r
# the way back to the joints of the start, a step is
#
#     as many joints as errors, or more:  dq = r + A^T (A A^T + mu)^-1 (e - A r)
#     fewer joints than errors:           dq = (A^T A + mu)^-1 A^T e
#
# Rotations count as lengths by a weight (m per rad), and so do slides as angles. The first form ends at the solution
# nearest to the start (D. E. Whitney 1969), the second at the least weighted error. The damping mu falls where a step
# brings the target nearer and rises elsewhere (K. Levenberg 1944), so that singular poses stay in place. Joints stop at
# their limits.


def joint_ranges(
    arm: Arm, endless: float = np.inf, purpose: str = "to search within", fix: str | None = None
) -> tuple[Array, Array]:
    """Return lower and upper limit ``(J,)`` of the joint variables.

    Args:
        arm: The arm.
        endless: Limit of a revolute joint without limits, rad.
        purpose: What the ranges are for, and ``fix`` how to do without limits, for the message.
        fix: See ``purpose``.

    Raises:
        InputError: A prismatic joint has no limits.
    """
    joints = arm.robot.variables
    problems = [
        Problem(
            f"the prismatic joint {joint.name} has no limits {purpose}", column=f"joints.{joint.name}.limits", fix=fix
        )
        for joint in joints
        if joint.limits is None and joint.type == "prismatic"
    ]
    refuse((problems, problems))
    low, high = np.array([joint.limits or (-endless, endless) for joint in joints]).T
    return low, high


def spread_configurations(arm: Arm, count: int) -> Array:
    """Return joint variables ``(J, count)`` spread evenly over each range.

    Revolute joints stay within half a turn of the middle of theirs.
    """
    low, high = (
        np.where(np.isfinite(limits), limits, sign * np.pi)
        for limits, sign in zip(joint_ranges(arm), (-1, 1), strict=True)
    )
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    revolute = np.array([joint.type == "revolute" for joint in arm.robot.variables])
    half = np.where(revolute, np.minimum(half, np.pi), half)
    return np.asarray(middle[:, None] + half[:, None] * (2.0 * low_discrepancy(low.size, count) - 1.0))


def low_discrepancy(dimensions: int, count: int) -> Array:
    """Return points ``(dimensions, count)`` that fill the unit cube evenly.

    They are multiples of the square roots of primes, modulo 1.

    Source: R. D. Richtmyer, "The evaluation of definite integrals, and a quasi-Monte-Carlo method based on the
    properties of algebraic numbers", Los Alamos report LA-1342, 1951.
    """
    numbers = itertools.count(2)
    primes = itertools.islice((n for n in numbers if all(n % k for k in range(2, n))), dimensions)
    products = np.sqrt(np.fromiter(primes, dtype=float))[:, None] * np.arange(1, count + 1)
    return np.asarray(products % 1.0, dtype=np.float64)


def pose_jacobian(arm: Arm, q: Array) -> tuple[Poses, Array]:
    """Return target poses at ``q`` ``(J, N)`` and their Jacobian ``(6, J, N)`` to ``q``, measuring frame."""
    drives = arm.chain.drives
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], [drive.motion for drive in drives])
    jacobian = np.zeros((6, q.shape[0], q.shape[1]))
    for i, drive in enumerate(drives):
        jacobian[:, drive.joint] += drive.coefficient * sweep.jacobian[:, i]
    return sweep.poses, jacobian


def inverse_kinematics(arm: Arm, desired: Poses, *, starts: int | Array = 16, oriented: bool = True) -> "JointSolution":
    """Return joint variables for the desired poses, from several starts each.

    Args:
        arm: The arm; its chain is inverted without effects.
        desired: Poses of the target ``(N)`` in the measuring frame.
        starts: Either the number of configurations with the nearest poses to start from, or configurations ``(J, S)``
            to start every pose from.
        oriented: Solve for position and orientation; else for position alone.

    Raises:
        InputError: A prismatic joint has no limits.
    """
    # The arm's size weighs radians against lengths independently of the unit of length.
    length = max(reach(arm, spread_configurations(arm, 64)), 1e-9)
    q0 = (
        _nearest(arm, desired, starts, oriented, length)
        if isinstance(starts, int)
        else np.repeat(starts[:, None, :], desired.translation.shape[1], axis=1)
    )
    joints, n, s = q0.shape
    repeated = Poses(np.repeat(desired.rotation, s, axis=2), np.repeat(desired.translation, s, axis=1))
    space = JointSpace.of(arm, length, length, oriented)

    def evaluate(q: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
        poses, jacobian = pose_jacobian(arm, q)
        error = pose_error(part_of(repeated, index), poses, oriented)
        return error, jacobian[: len(error)]

    solution = solve(evaluate, q0.reshape(joints, n * s), space, stay=False)
    error = np.sqrt(np.sum(np.square(space.weights[:, None] * solution.error), axis=0)).reshape(n, s)
    unlimited = np.isinf(space.low) & np.isinf(space.high)
    q = np.where(unlimited[:, None], np.arctan2(np.sin(solution.q), np.cos(solution.q)), solution.q)
    # A pose counts as reached to some hundred roundings of the arm's length.
    return JointSolution(q.reshape(joints, n, s), error, error <= 1e-11 * length)


def reach(arm: Arm, q: Array) -> float:
    """Return the rms distance, m, of the target from the base at joints ``q`` ``(J, N)``."""
    return rms_length(arm.chain.forward(q).translation - np.array(arm.robot.base.xyz)[:, None])


def _nearest(arm: Arm, desired: Poses, count: int, oriented: bool, length: float) -> Array:
    """Return the configurations ``(J, N, count)`` of the pool whose poses are nearest each desired pose."""
    # Configurations over the joint ranges; those with the nearest poses are the starts.
    pool = spread_configurations(arm, 2048)
    pool_poses = arm.chain.forward(pool)
    starts = np.empty((pool.shape[0], desired.translation.shape[1], count))
    for i in range(desired.translation.shape[1]):
        distance = np.sum(np.square(pool_poses.translation - desired.translation[:, [i]]), axis=0)
        if oriented:
            # |R1 - R2|^2 (Frobenius) is 4 (1 - cos angle): near twice the squared angle.
            rotation_distance = np.sum(np.square(pool_poses.rotation - desired.rotation[..., [i]]), axis=(0, 1))
            distance = distance + 0.5 * length**2 * rotation_distance
        starts[:, i] = pool[:, np.argsort(distance, kind="stable")[:count]]
    return starts


def pose_error(wanted: Poses, poses: Poses, oriented: bool) -> Array:
    """Return the way from ``poses`` to ``wanted``: m, and for oriented targets a rotation vector in rad."""
    position = wanted.translation - poses.translation
    turn = log_so3(compose(wanted.rotation, transpose(poses.rotation))) if oriented else position[:0]
    return np.concatenate((position, turn))


def part_of(poses: Poses, index: NDArray[np.int64]) -> Poses:
    """Return some of the poses."""
    return Poses(poses.rotation[..., index], poses.translation[:, index])


# Damped steps to wanted poses, all targets at once.

_PATIENCE = 5
"""Steps without gain after which a target is given up."""
_SETTLED = 1e-11
"""Step (rad, slides in arm lengths) at which a target is done, far below any resolution."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-14, 1e-16, 1e3
_RAISED = 1e-7
"""Damping after the first step that brings a target no nearer."""

Evaluate = Callable[[Array, NDArray[np.int64]], tuple[Array, Array]]
"""Errors ``(R, M)`` and their Jacobian ``(R, J, M)`` at joints ``(J, M)`` of the targets with numbers ``(M,)``."""


class JointSpace(NamedTuple):
    """Joints of an arm and errors of its pose, as the solver scales and limits them."""

    low: Array
    """``(J,)`` rad or m; -inf without a limit."""
    high: Array
    scale: Array
    """``(J,)`` size of a joint's unit step: 1 rad, or the arm's length for a slide."""
    length: float
    """Size of the arm, m: RMS distance of its target from its base."""
    weights: Array
    """``(R,)`` weight of each component of the error: 1 for m, a length for rad."""

    @classmethod
    def of(cls, arm: Arm, length: float, turn: float, oriented: bool) -> "JointSpace":
        """Return the joints of an arm of some size; 1 rad counts as the length ``turn``."""
        joints = arm.robot.variables
        low, high = np.array([joint.limits or (-np.inf, np.inf) for joint in joints]).T
        scale = np.array([1.0 if joint.type == "revolute" else length for joint in joints])
        return cls(low, high, scale, length, np.repeat([1.0, turn][: 1 + oriented], 3))


class JointSolution(NamedTuple):
    """Joints at the end of the iteration, for N problems, or for N poses from S starts each with starts last."""

    q: Array
    """``(J, N)`` rad or m, within the limits."""
    error: Array
    """``(R, N)`` remaining error, m and rad; from starts, its size ``(N, S)``: m, rotation times the arm's length."""
    converged: NDArray[np.bool_]
    """``(N,)`` whether the last step was below the tolerance; from starts, whether the pose is reached to rounding."""


def solve(
    evaluate: Evaluate, start: Array, joints: JointSpace, first: Array | None = None, *, stay: bool = True
) -> JointSolution:
    """Return the joints nearest to ``start`` ``(J, N)`` whose error is least.

    Args:
        evaluate: Errors and Jacobian.
        start: Joints to stay near, as far as an arm is redundant.
        joints: Limits, scales and weights.
        first: Joints to begin with; None for ``start``.
        stay: Return to the start as far as the arm is redundant; else each step is the shortest.
    """
    low, high, scale = (part[:, None] for part in (joints.low, joints.high, joints.scale))
    weights = joints.weights
    q, n = np.clip(start if first is None else first, low, high), start.shape[1]
    error, jacobian = np.zeros((weights.size, n)), np.zeros((weights.size, len(start), n))
    cost, damping = np.full(n, np.inf), np.full(n, _FIRST_DAMPING)
    stalled, settled = np.zeros(n, dtype=int), np.zeros(n, dtype=bool)
    index, trial = np.arange(n), q.copy()
    for _ in range(40):
        # Joints that bring a target nearer are taken; elsewhere the damping rises.
        new_error, new_jacobian = evaluate(trial[:, index], index)
        new_cost = np.sum(np.square(weights[:, None] * new_error), axis=0)
        nearer = new_cost <= cost[index] * (1.0 + 1e-9) + np.square(1e-13 * np.max(weights))
        taken, refused = index[nearer], index[~nearer]
        stalled[index] = np.where(new_cost < 0.999 * cost[index], 0, stalled[index] + 1)
        q[:, taken], cost[taken] = trial[:, taken], new_cost[nearer]
        error[:, taken], jacobian[..., taken] = new_error[:, nearer], new_jacobian[..., nearer]
        damping[taken] = np.maximum(0.1 * damping[taken], _LEAST_DAMPING)
        damping[refused] = np.clip(30.0 * damping[refused], _RAISED, _MOST_DAMPING)
        matrix = weights[:, None, None] * jacobian[..., index] * scale
        back = stay * (start[:, index] - q[:, index]) / scale
        at_low, at_high = q[:, index] <= low, q[:, index] >= high
        step = _step(matrix, weights[:, None] * error[:, index], back, damping[index], at_low, at_high)
        settled[index] = np.max(np.abs(step), axis=0, initial=0.0) < _SETTLED
        trial[:, index] = np.clip(q[:, index] + step * scale, low, high)
        index = index[~settled[index] & (stalled[index] < _PATIENCE)]
        if index.size == 0:
            break
    return JointSolution(q, error, settled)


def _step(
    matrix: Array, error: Array, back: Array, damping: Array, at_low: NDArray[np.bool_], at_high: NDArray[np.bool_]
) -> Array:
    """Return the scaled step ``(J, M)``; joints at a limit that would leave their range stay."""
    fixed = np.zeros(back.shape, dtype=bool)
    for _ in range(back.shape[0] + 1):
        step = _damped_step(matrix, error, back, damping)
        added = ((at_low & (step < 0.0)) | (at_high & (step > 0.0))) & ~fixed
        if not added.any():
            break
        fixed |= added
        matrix, back = np.where(fixed, 0.0, matrix), np.where(fixed, 0.0, back)
        damping = np.where(fixed.any(axis=0), np.maximum(damping, _RAISED), damping)
    largest = np.maximum(np.max(np.abs(step), axis=0, initial=0.0), 1e-300)
    # rad: largest step of a joint; longer steps leave the configuration.
    return np.asarray(step * np.minimum(1.0, 0.3 / largest))


def _damped_step(matrix: Array, error: Array, back: Array, damping: Array) -> Array:
    """Return steps ``(J, M)`` for scaled Jacobians ``(R, J, M)``, errors ``(R, M)`` and ways back ``(J, M)``."""
    rows, columns = matrix.shape[:2]
    stacked = np.moveaxis(matrix, 2, 0)
    transposed = np.swapaxes(stacked, 1, 2)
    size = np.maximum(np.einsum("mij,mij->m", stacked, stacked), 1e-300) / min(rows, columns)
    weak = (damping * size)[:, None, None]
    if columns < rows:
        normal = transposed @ stacked + weak * np.eye(columns)
        return np.asarray(np.linalg.solve(normal, transposed @ error.T[..., None])[..., 0].T)
    if columns == rows:
        back = np.zeros_like(back)
    remaining = error - np.einsum("ijm,jm->im", matrix, back)
    normal = stacked @ transposed + weak * np.eye(rows)
    return np.asarray(back + (transposed @ np.linalg.solve(normal, remaining.T[..., None]))[..., 0].T)


# Reach and moved mass of an arm.

_TRIALS = 65
"""Positions tried along each joint's range in a step of the refinement."""


def summarise(robot: Robot) -> dict[str, Any]:
    """Return the reach and the moved mass of a robot, by the keys of the result.

    The reach is that of each target; a robot without named targets has the target ``tool``. The mass is that of all
    links that have a mass, kg; None where no link has one.
    """
    targets = dict(robot.targets) or {"tool": robot.tool}
    moved = [branch.joint for branch in robot.branches if robot.carrier(branch) is not None]
    masses = [joint.mass for joint in (*robot.joints, *moved) if joint.mass is not None]
    reaches = {name: find_reach(robot, frame) for name, frame in targets.items()}
    return {"moved_mass_kg": sum(masses) if masses else None, "reach": reaches}


def find_reach(robot: Robot, target: Frame) -> dict[str, float | None]:
    """Return the reach of a target from the base's origin within the joint limits (one turn for a joint without).

    By the keys of the result: ``sampled_m`` is the reach or slightly less, ``bound_m`` the reach or more; None where a
    prismatic joint has no limits. The best of low-discrepancy samples is improved one joint at a time. The bound adds
    up the lengths between the axes, each prismatic joint at its longest.
    """
    chain = build_chain(replace(robot, base=Frame(), tool=target))
    if any(joint.type == "prismatic" and joint.limits is None for joint in robot.variables):
        return {"sampled_m": None, "bound_m": None}
    low, high = np.array([joint.limits or (-np.pi, np.pi) for joint in robot.variables]).T
    # The best of these configurations is refined.
    q = low[:, None] + (high - low)[:, None] * low_discrepancy(low.size, 8192)
    best = q[:, [int(np.argmax(_distance(chain, q)))]]
    for _ in range(4):
        for i in range(low.size):
            trial = np.repeat(best, _TRIALS + 1, axis=1)
            # The best so far stays among the trials, so a step never reduces the reach.
            trial[i, 1:] = np.linspace(low[i], high[i], _TRIALS)
            best = trial[:, [int(np.argmax(_distance(chain, trial)))]]
    travel: dict[int, list[float]] = {}
    for drive in chain.drives:
        limits = sorted(drive.coefficient * float(value) for value in (low[drive.joint], high[drive.joint]))
        ends = travel.get(drive.motion, [0.0, 0.0])
        travel[drive.motion] = [end + limit for end, limit in zip(ends, limits, strict=True)]
    total, run = 0.0, np.zeros(3)
    for k, motion in enumerate(chain.motions):
        if motion.kind == "translation":
            run[motion.axis] += max(abs(motion.value + limit) for limit in travel.get(k, [0.0]))
        elif motion.value != 0.0 or k in travel:
            total, run = total + float(np.hypot.reduce(run)), np.zeros(3)
    return {"sampled_m": float(_distance(chain, best)[0]), "bound_m": total + float(np.hypot.reduce(run))}


def _distance(chain: Chain, q: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(np.square(chain.forward(q).translation), axis=0)))
