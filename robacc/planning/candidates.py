"""Candidate poses of a plan: sampled, in circumstances and under constraints, and filtered with counts."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from robacc.errors import InputError, Problem, UsageError, given, refuse
from robacc.geometry import Array, NDArray, Poses, rotate
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.quantities import parse_quantity
from robacc.robots.arm import Arm, inverse_kinematics, joint_ranges
from robacc.robots.description import BranchJoint, Robot
from robacc.simulation.simulate import even_joints

# Constraints of a measurement campaign: which poses the robot may take and the instrument can see.
#
# Places are in the robot's base frame, in m. A box or half-space to stay out of holds for the target and for every
# joint and corner of the arm that moves; a box to stay in holds for the target.

_AXES = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
class Zone:
    """Half-space, or axis-parallel box: the points p with normals . p <= offsets, m."""

    normals: Array
    """``(K, 3)``; of a box, those of the high ends, then those of the low ends."""
    offsets: Array
    """``(K,)``; infinite where a box has no end."""
    text: str

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return which points ``(3, ...)`` lie inside."""
        heights = np.moveaxis(np.tensordot(self.normals, points, axes=1), 0, -1)
        return np.asarray(np.all(heights <= self.offsets, axis=-1))


@dataclass(frozen=True, slots=True)
class Sight:
    """Line of sight from the instrument to the target."""

    position: Sequence[float]
    """Instrument, ``(3,)`` m."""
    axis: Sequence[float] | None = None
    """Direction in the target's frame that the reflector faces; None: the reflector is turned by hand, or is a ball."""
    cone: float = np.radians(30.0)
    """Half angle of the reflector's acceptance, rad."""
    distance: Sequence[float] = (0.0, np.inf)
    """Nearest and farthest distance, m."""


class LinkCollisions(Protocol):
    """Test of poses for collisions of an arm's links, which a plug-in of the group ``robacc.collisions`` makes."""

    @property
    def pairs(self) -> Sequence[tuple[str, str]]:
        """Links of each pair that is checked."""

    @property
    def overlapping(self) -> Sequence[tuple[str, str]]:
        """Links of each pair that is not checked, because they touch at nearly all poses."""

    def self_collision(self, q: Array) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses ``(J, N)``, rad or m, at which two links touch."""

    def in_box(self, q: Array, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which a link is in a box of the base frame; a side may be infinite, m."""

    def beyond(self, q: Array, direction: Sequence[float], offset: float) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which a link leaves the half-space direction . p <= offset, m."""


@dataclass(frozen=True, slots=True)
class Constraints:
    """Everything that decides whether a pose is feasible."""

    margin: float = 0.02
    """Share of a joint's range to keep from each limit."""
    inside: Zone | None = None
    outside: tuple[Zone, ...] = ()
    half_spaces: tuple[Zone, ...] = ()
    sight: Sight | None = None
    max_condition: float | None = None
    """Largest condition number of the joints' Jacobian."""
    collisions: LinkCollisions | None = None
    """Test of the links' shapes; None: links have no thickness."""


def parse_box(text: str, name: str) -> Zone:
    """Parse ``x=0.2:0.9,y=-500mm:500mm,z=0.1:``; a missing side or axis has no limit.

    Raises:
        UsageError: The text is not that; ``name`` is the parameter's name.
    """
    ends = {axis: (-np.inf, np.inf) for axis in _AXES}
    for part in text.split(","):
        expected = f"`{name}`: expected a box such as x=0.2:0.9,z=100mm:, found {text!r}"
        axis, *sides = given(re.fullmatch(r"\s*([xyz])\s*=([^:]*):([^:]*)", part), expected).groups()
        low, high = (length(side, name) if side.strip() else end for side, end in zip(sides, ends[axis], strict=True))
        refuse((low >= high, f"`{name}`: {axis} ends before it begins in {text!r}"))
        ends[axis] = low, high
    lows, highs = np.array([*ends.values()]).T
    return Zone(np.concatenate((np.eye(3), -np.eye(3))), np.concatenate((highs, -lows)), text)


def parse_half_space(text: str, name: str) -> Zone:
    """Parse ``z>=0.1``, ``x<=800mm`` or ``0.7x+0.7y<=1.2``: the side to stay on.

    Raises:
        UsageError: The text is not that.
    """
    expected = f"`{name}`: expected a side to stay on such as z>=0.1 or 0.7x+0.7y<=1.2, found {text!r}"
    match = given(re.fullmatch(r"(.+?)(<=|>=)(.+)", text.replace(" ", "")), expected)
    products = list(re.finditer(r"([+-]?)\s*(\d*\.?\d*)\s*\*?\s*([xyz])", match[1]))
    refuse((not products or "".join(product[0] for product in products) != match[1], expected))
    side = 1.0 if match[2] == "<=" else -1.0
    normal = np.zeros(3)
    for product in products:
        normal[_AXES.index(product[3])] += side * float(product[2] or 1.0) * (-1.0 if product[1] == "-" else 1.0)
    size = float(np.linalg.norm(normal))
    refuse((size == 0.0, f"`{name}`: {text!r} names no direction"))
    return Zone(normal[None] / size, np.array([side * length(match[3], name) / size]), text)


def lengths(text: str | Sequence[float], name: str, expected: str) -> tuple[float, ...]:
    """Parse lengths, m, as many as there are in the example at the end of ``expected``: ``2.5,0,1.2``, ``0.5:15``.

    Raises:
        UsageError: The text is not that; ``name`` is the parameter's name.
    """
    example = expected.rpartition(" ")[2]
    separator = ":" if ":" in example else ","
    parts = text.split(separator) if isinstance(text, str) else text
    refuse((len(parts) != len(example.split(separator)), f"`{name}`: expected {expected}, found {text!r}"))
    return tuple(length(part, name) for part in parts)


def length(text: str | float, name: str) -> float:
    """Return a coordinate in m: a bare number is in m.

    Raises:
        UsageError: It is no length.
    """
    size, dimension = (parse_quantity(text) if isinstance(text, str) else (float(text), None)) or (np.nan, None)
    is_length = dimension != "angle" and np.isfinite(size)
    refuse((not is_length, f"`{name}`: expected a length in m or with a unit (m, mm, um), found {text!r}"))
    return float(size)


# Filters of candidate poses, with a count of what each excludes.


def filtered(model: Model, q: Array, constraints: Constraints) -> tuple[Array, dict[str, NDArray[np.bool_]]]:
    """Return the target of joint variables ``(J, N)``, and which of them ``(N,)`` are not feasible, by reason.

    The target ``(3, N)`` is in the base frame, m, and the mean of several targets.
    """
    arm, links = model.arm, constraints.collisions
    low, high = np.array([joint.limits or (-1e9, 1e9) for joint in arm.robot.variables]).T[..., None]
    # A microradian: the resolution that commanded joints are rounded to.
    keep = constraints.margin * (high - low) - 1e-6
    excluded = {"joint limits with margin": np.any((q < low + keep) | (q > high - keep), axis=0)}
    targets = _targets(arm, q)
    positions = np.stack([target.translation for target in targets], axis=1)
    if constraints.inside is not None:
        excluded[f"target outside the box {constraints.inside.text}"] = ~np.all(
            constraints.inside.contains(positions), axis=0
        )
    is_of_arm = constraints.outside or constraints.half_spaces
    points = np.concatenate((moving_points(arm, q), positions), axis=1) if is_of_arm else positions
    for box in constraints.outside:
        reached = np.any(box.contains(points), axis=0)
        excluded[f"a point of the arm inside the box {box.text}"] = (
            reached if links is None else reached | links.in_box(q, [*-box.offsets[3:]], [*box.offsets[:3]])
        )
    for side in constraints.half_spaces:
        beyond = ~np.all(side.contains(points), axis=0)
        excluded[f"a point of the arm beyond {side.text}"] = (
            beyond if links is None else beyond | links.beyond(q, [*side.normals[0]], float(side.offsets[0]))
        )
    if links is not None:
        excluded["self-collision"] = links.self_collision(q)
    if constraints.max_condition is not None:
        reason = f"near a singularity (condition above {constraints.max_condition:g})"
        excluded[reason] = joint_condition(arm, q) > constraints.max_condition
    if (sight := constraints.sight) is not None:
        nearest, farthest = sight.distance
        ray = np.array(sight.position)[:, None, None] - positions
        distance = np.linalg.norm(ray, axis=0)
        if nearest > 0:
            excluded[f"nearer to the instrument than {nearest:g} m"] = np.any(distance < nearest, axis=0)
        if np.isfinite(farthest):
            excluded[f"farther from the instrument than {farthest:g} m"] = np.any(distance > farthest, axis=0)
        if sight.axis is not None:
            facing = np.stack([rotate(target.rotation, np.array(sight.axis)[:, None]) for target in targets], axis=1)
            cosine = np.sum(facing * ray, axis=0) / np.maximum(distance * np.linalg.norm(sight.axis), 1e-12)
            excluded[f"reflector turned away by more than {np.degrees(sight.cone):g}°"] = np.any(
                cosine < np.cos(sight.cone), axis=0
            )
    return np.mean(positions, axis=1), excluded


def _targets(arm: Arm, q: Array) -> list[Poses]:
    """Return the nominal pose of each target in the base frame at joint variables ``(J, N)``."""
    to_base, n = arm.robot.base.pose.inverse(), q.shape[1]
    data = Measurements(position=np.zeros((3, n)), q=q)
    rows = [replace(data, target=np.full(n, name)) for name in arm.robot.targets]
    return [to_base @ Model(arm).bind(poses).poses(np.zeros(0)) for poses in rows or [data]]


def targets_in_base(robot: Robot, q: Array) -> Array:
    """Return ``(3, N)`` nominal positions of the target in the base frame, m; the mean of several targets."""
    return np.asarray(np.mean([target.translation for target in _targets(Arm.of(robot), q)], axis=0))


def moving_points(arm: Arm, q: Array) -> Array:
    """Return ``(3, K, N)`` corners of the arm's outline that move, in the base frame, m."""
    counts = [k + 1 for k, motion in enumerate(arm.chain.motions[: arm.flange]) if motion.kind == "translation"]
    n = q.shape[1]
    frames = arm.chain.sweep(arm.chain.scalars(q), n, (), counts).frames
    points = np.stack([frame.translation for frame in frames], axis=1) if frames else np.zeros((3, 0, n))
    if points.shape[2] > 1:
        # m; a corner of the arm that moves less stands still and is part of the pedestal.
        points = points[:, np.ptp(points, axis=2).max(axis=0) > 1e-6]
    to_base = arm.robot.base.pose.inverse()
    return rotate(to_base.rotation, points) + to_base.translation[:, None, None]


def joint_condition(arm: Arm, q: Array) -> Array:
    """Return ``(N,)`` condition number of the joints' Jacobian, lengths in units of the target's mean distance."""
    jacobian = arm.chain.jacobian(q, arm.chain.joint_axis)
    place = (arm.robot.base.pose.inverse() @ arm.chain.forward(q)).translation
    jacobian[:3] /= max(float(np.mean(np.linalg.norm(place, axis=0))), 1e-9)
    values = np.linalg.svd(np.moveaxis(jacobian, 2, 0), compute_uv=False)
    with np.errstate(divide="ignore"):
        return np.asarray(values[:, 0] / values[:, -1])


TASK_POSES = 400
"""Poses that the mean and the worst error over the task's region are computed from."""
_MOST_DRAWS = 40
"""Most samples drawn, as a multiple of the candidates sought."""


@dataclass(frozen=True, slots=True)
class CandidatePoses:
    """Feasible poses to choose from, and the count of what was excluded."""

    q: Array
    """``(J, N)`` feasible joint variables, rad or m."""
    position: Array
    """``(3, N)`` target in the base frame, m."""
    ids: NDArray[np.str_] | None
    """``(N,)`` names of given candidates; None for sampled ones."""
    n_drawn: int
    """Number of candidates before the filters."""
    excluded: Sequence[Mapping[str, Any]]
    """Reasons, the largest first, with the keys of the result: the number of candidates that a reason excludes, whether
    another does or not, and that it alone excludes."""
    source: str
    payload: Array | None = None
    """``(N,)`` kg; None where no payload was given."""
    n_payloads: int = 1
    """Number of payloads that each pose is a candidate with."""
    in_sockets: bool = False
    """Whether the target is in sockets, so that its place need not be measured."""
    socket: NDArray[np.str_] | None = None
    """``(N,)`` socket of unknown place that the target is in, empty where the position is measured; None if all are."""

    @property
    def n(self) -> int:
        """Number of feasible candidates: poses times payloads."""
        return int(self.q.shape[1])

    @property
    def n_poses(self) -> int:
        """Number of feasible poses."""
        return self.n // self.n_payloads


def measured_in(data: Measurements, socket: NDArray[np.str_] | None) -> Measurements:
    """Return the poses as measurements in sockets of unknown place ``(N,)``; see :class:`CandidatePoses`."""
    kind = None if socket is None else np.where(socket == "", "position", "point")
    return replace(data, kind=kind, fixture=socket)


def _feasible(
    model: Model,
    constraints: Constraints,
    draws: Iterable[Array],
    count: int,
    none: str = "no pose is feasible",
    ids: NDArray[np.str_] | None = None,
    source: str = "{} samples within the joint limits",
    socket: NDArray[np.str_] | None = None,
) -> CandidatePoses:
    """Return the first ``count`` feasible poses of ``draws``, blocks ``(J, n)``, or as many as there are.

    Raises:
        UsageError: No pose is feasible; the message begins with ``none`` and names the reason that excludes most.
    """
    parts, n_feasible = [], 0
    for block in draws:
        position, excluded = filtered(model, block, constraints)
        parts.append((block, position, np.array([*excluded.values()])))
        n_feasible += int(np.count_nonzero(~np.any(parts[-1][2], axis=0)))
        if n_feasible >= count:
            break
    q, position, mask = (np.concatenate(blocks, axis=1) for blocks in zip(*parts, strict=True))
    number, n_drawn = np.sum(mask, axis=0), q.shape[1]
    exclusions: list[dict[str, Any]] = sorted(
        (
            {"reason": reason, "count": int(np.count_nonzero(own)), "alone": int(np.count_nonzero(own & (number == 1)))}
            for reason, own in zip(excluded, mask, strict=True)
            if own.any()
        ),
        key=lambda entry: -entry["count"],
    )
    if not n_feasible:
        others = "".join(f"; {entry['count']} by: {entry['reason']}" for entry in exclusions[1:])
        raise UsageError(
            f"{none}: of {n_drawn} poses, {exclusions[0]['count']} are excluded by: {exclusions[0]['reason']}{others}. "
            f"Relax {'the first of these' if others else 'this demand'}"
        )
    at = np.flatnonzero(number == 0)[:count]
    return CandidatePoses(
        q[:, at],
        position[:, at],
        None if ids is None else ids[at],
        n_drawn,
        exclusions,
        source.format(n_drawn),
        socket=None if socket is None else socket[at],
    )


def _drawn(robot: Robot, margin: float, count: int, skip: int, seed: int, times: int) -> Iterator[Array]:
    """Yield blocks ``(J, count)`` of joint variables spread evenly within the limits less ``margin``.

    They are the entries of a low-discrepancy sequence after the first ``skip``; ``seed`` shifts the sequence.

    Raises:
        InputError: A prismatic joint has no limits.
    """
    for number in range(times):
        q = even_joints(
            robot,
            count,
            np.random.default_rng([seed, len(robot.variables)]),
            "to choose poses within",
            "give it limits",
            margin=margin,
            skip=skip + count * number,
        )
        low, high = (limit[:, None] for limit in joint_ranges(Arm.of(robot), np.pi))
        keep = margin * (high - low)
        # Decimals of commanded joint variables, as in a simulation.
        yield np.clip(np.round(q, 6), low + keep, high - keep)


def sampled_candidates(model: Model, constraints: Constraints, count: int, seed: int) -> CandidatePoses:
    """Return ``count`` feasible poses, or as many as are among :data:`_MOST_DRAWS` times that many samples.

    Raises:
        UsageError: No sample is feasible; the message names the reason that excludes most.
    """
    return _feasible(
        model, constraints, _drawn(model.arm.robot, constraints.margin, count, 0, seed, _MOST_DRAWS), count
    )


def given_candidates(
    model: Model, constraints: Constraints, data: Measurements, count: int, seed: int
) -> CandidatePoses:
    """Return the feasible poses among the rows of a file; a repeated pose counts once.

    Rows without joints are sockets: places that about ``count`` poses bring the target to.

    Raises:
        UsageError: The rows have neither joints nor places, or none is feasible.
    """
    if data.q is None:
        q, names = _in_sockets(model, constraints, data, -(-count // data.n), seed)
        return replace(
            _feasible(model, constraints, [q], count, ids=names, source="{} poses in sockets"), in_sockets=True
        )
    q = data.q
    first = np.sort(np.unique(data.groups(), return_index=True)[1])
    pool = _feasible(
        model,
        constraints,
        [q[:, first]],
        first.size,
        ids=None if data.pose is None else data.pose[first].astype(str),
        source="{} given poses",
        socket=None if data.fixture is None else data.fixture[first],
    )
    return replace(pool, in_sockets=pool.socket is not None)


def _in_sockets(
    model: Model, constraints: Constraints, data: Measurements, count: int, seed: int
) -> tuple[Array, NDArray[np.str_]]:
    """Return joint variables ``(J, N)`` with the target in sockets, at most ``count`` for each, and names of the poses.

    ``data`` has the places of the sockets in the base frame, m, and their names.

    Raises:
        UsageError: There are no places, or no joints bring the target to one.
    """
    refuse(
        (not data.position.any(), "the candidates have neither joint columns nor places x, y, z of sockets"),
        (model.arm.robot.targets, "only a tool has places in sockets: give a robot without targets"),
    )
    starts = next(_drawn(model.arm.robot, constraints.margin, count, 0, seed, 1))
    places = model.arm.robot.base.pose @ Poses(Poses.identity(data.n).rotation, data.position)
    solution = inverse_kinematics(model.arm, places, starts=starts, oriented=False)
    names = [f"S{i + 1}" if data.pose is None else str(data.pose[i]) for i in range(data.n)]
    for name, reached in zip(names, solution.converged, strict=True):
        refuse((not reached.any(), f"no joints within the limits bring the target to socket {name}"))
    socket, start = np.nonzero(solution.converged)
    q = np.round(solution.q[:, socket, start], 6)
    return q, np.array([f"{names[i]}-{k + 1}" for i, k in zip(socket, start, strict=True)])


def task_joints(model: Model, constraints: Constraints, region: Zone | None, seed: int) -> Array:
    """Return joint variables ``(J, T)`` of the task: poses that the robot may take, with the target in ``region``.

    The instrument need not see them.

    Raises:
        UsageError: None of the samples lies in the region.
    """
    free = replace(constraints, sight=None, inside=region or constraints.inside)
    # Place in the sequence where poses that are not candidates begin, so that none of them is a candidate too.
    draws = _drawn(model.arm.robot, free.margin, 5 * TASK_POSES, 7_919, seed + 1, 2 * _MOST_DRAWS)
    return _feasible(model, free, draws, TASK_POSES, "no pose of the task is feasible").q


# Circumstances of planned poses before their order is known: payload, approach, temperature.


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
        count, ids = len(self.payloads), candidates.ids
        if count == 0:
            return candidates
        named = [f"{name}@{payload:g}kg" for payload in self.payloads for name in (() if ids is None else ids)]
        return replace(
            candidates,
            q=np.tile(candidates.q, count),
            position=np.tile(candidates.position, count),
            ids=np.array(named) if ids is not None and count > 1 else ids,
            payload=np.repeat(np.array(self.payloads, dtype=np.float64), candidates.n),
            n_payloads=count,
            socket=None if candidates.socket is None else np.tile(candidates.socket, count),
        )


def conditions_of(model: Model, payloads: tuple[float, ...], seed: int, is_for_fit: bool) -> Conditions:
    """Return the circumstances that the effects of ``model`` depend on.

    Without ``payloads`` the arm carries none, 0 kg, if a known effect depends on the payload. ``is_for_fit`` says that
    the poses are chosen for the coefficients of the free effects.

    Raises:
        UsageError: A free effect needs payloads that differ, or a circumstance that a plan does not have; or there are
            several payloads to choose from, and no free effect depends on them.
    """
    # Two poses that differ in all joints, with directions and speeds.
    arm, q = model.arm, np.tile([0.0, 1.0], (len(model.arm.names), 1))
    bare = Measurements(position=np.zeros((3, 2)), q=q, direction=2 * q - 1, speed=q)
    loaded = replace(bare, payload=np.array([0.0, 1.0]))
    fixed = [entry.effect for entry in model.known]
    if not payloads and any(effect.missing(arm, bare) and not effect.missing(arm, loaded) for effect in fixed):
        payloads = (0.0,)
    warm = replace(bare, temperature=np.array([0.0, 1.0]))
    is_warm = any(effect.missing(arm, bare) and not effect.missing(arm, warm) for effect in fixed)
    planned = replace(bare, payload=np.array([min(payloads), max(payloads)]) if payloads else None)
    for effect in model.free:
        reason, needs_loads = effect.missing(arm, planned), effect.missing(arm, loaded) is None
        refuse(
            (reason and needs_loads, f"`fit`: {effect.name} needs loads: {reason}; give `payload`, such as 0,5"),
            (reason, f"`fit`: {effect.name} cannot be planned: {reason}; leave it out"),
        )
    refuse(
        (
            is_for_fit and len(payloads) > 1 and not any(effect.missing(arm, bare) for effect in model.free),
            "`payload`: no effect of `fit` depends on the payload, so any pose may have any; "
            "add payload_compliance to `fit`, or give the payload of this campaign alone",
        )
    )
    return Conditions(payloads, 20.0 if is_warm else None, seed)


# Joints outside the chain in a plan: they stand still at their positions of the robot file.


def branches_at_rest(robot: Robot, n: int) -> tuple[Array | None, tuple[str, ...]]:
    """Return positions ``(B, n)`` and names of joints outside the chain; None if they load no joint of the chain."""
    if not _loading(robot):
        return None, ()
    moving = robot.branch_variables
    return np.array([[branch.position] * n for branch in moving]), tuple(branch.joint.name for branch in moving)


def at_rest_warning(robot: Robot) -> tuple[str, ...]:
    """Return a sentence about the joints outside the chain that must stand still; nothing if there are none."""
    listed = ", ".join(f"{branch.joint.name} at {_with_unit(branch)}" for branch in _loading(robot))
    return (
        (
            f"the plan holds the joints outside the chain still: {listed}; their weight counts at these positions, "
            "which the planned rows state; to change them, set position in the robot file",
        )
        if listed
        else ()
    )


def check_at_rest(robot: Robot, poses: Measurements) -> None:
    """Check that columns of joints outside the chain hold these at their positions.

    Raises:
        InputError: One of them is elsewhere.
    """
    if poses.branches is None:
        return
    for branch, values in zip(robot.branch_variables, poses.branches, strict=True):
        # A file rounds them.
        for row in np.flatnonzero(np.abs(values - branch.position) > 1e-4):
            raise InputError(
                Problem(
                    f"found {_with_unit(branch, float(values[row]))}, expected {_with_unit(branch)}: a plan moves only "
                    "the joints of the chain",
                    poses.source,
                    None if poses.rows is None else int(poses.rows[row]),
                    branch.joint.name,
                    "set the position of this joint in the robot file to where it stands, or remove the column",
                )
            )


def _loading(robot: Robot) -> list[BranchJoint]:
    """Return the moving joints outside the chain whose weight a joint of the chain carries."""
    return [branch for branch in robot.branch_variables if robot.has_masses and robot.carrier(branch) is not None]


def _with_unit(branch: BranchJoint, value: float | None = None) -> str:
    position = branch.position if value is None else value
    return f"{1e3 * position:.4g} mm" if branch.joint.type == "prismatic" else f"{np.degrees(position):.4g}°"
