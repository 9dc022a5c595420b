"""Test poses of ISO 9283:1998, the evaluation of measured poses, and the conditions of the standard's protocol."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from robacc.accuracy.error_statistics import assumption_tests
from robacc.accuracy.estimation import (
    TOO_LARGE,
    UNREGISTERED,
    check_confidence,
    commanded_poses,
    register,
)
from robacc.errors import InputError, Problem, applying, refuse
from robacc.geometry import Array, Poses, rms_length, rotation_about
from robacc.iso_9283 import ORIENTATION_TEXT
from robacc.iso_9283.criteria import (
    Characteristic,
    CommandedPose,
    Iso9283Result,
    accuracy,
    distance_criteria,
    drift,
    exchangeability,
    multidirectional,
    repeatability,
    visits_of,
)
from robacc.measurements import STILL, Measurements, motion_between_visits, numbered_visits, too_far
from robacc.robots.arm import Arm, inverse_kinematics, joint_ranges, spread_configurations
from robacc.robots.description import Frame, Robot

if TYPE_CHECKING:
    from robacc.fitting.registration import Alignment

# Test cube of ISO 9283:1998, clause 6.8: its five poses, and a proposal of cube and poses for an arm.
#
# The cube's edges are parallel to the base frame's axes. P1 is its centre; P2 to P5 lie on the diagonals through the
# four corners of a plane tilted by 45 degrees, 10 % of the diagonal's length (8 to 12 %) from its ends.

Plane = Literal["x+", "x-", "y+", "y-"]
PLANES: dict[Plane, tuple[int, ...]] = {
    "x+": (0, 2, 7, 5),
    "x-": (4, 6, 3, 1),
    "y+": (0, 4, 7, 3),
    "y-": (2, 6, 5, 1),
}
"""Corners of the cube, as :func:`corners` numbers them, next to P2 to P5 in the four planes of the standard.

The planes are named by the horizontal direction in which each rises at 45 degrees.
"""
PREFERRED_EDGES = (1.0, 0.63, 0.4, 0.25)
"""Edge lengths that the standard prefers, m, the largest first."""
PREFERRED_SIZES = ", ".join(f"{1e3 * edge:.0f}" for edge in reversed(PREFERRED_EDGES))
"""The same in mm, as text."""
FROM_CORNER = 0.10
"""Distance of P2 to P5 from the corners, as a fraction of the diagonal's length."""
_SIZE_TOLERANCE = 0.01
"""Relative difference below which two sizes count as equal: 1 mm in 100 mm is accepted."""


def corners(centre: Array, edge: float) -> Array:
    """Return the cube's corners ``(3, 8)``, m; the binary digits of a corner's number are its sides along x, y, z."""
    return np.asarray(centre[:, None] + 0.5 * edge * np.array([*product((-1.0, 1.0), repeat=3)]).T)


def five_points(centre: Array, edge: float, plane: Plane) -> Array:
    """Return P1 to P5 ``(3, 5)``, m, in the axes of the cube; P2 and P4 are opposite, as are P3 and P5."""
    inner = corners(centre, (1.0 - 2.0 * FROM_CORNER) * edge)
    return np.column_stack((centre, inner[:, PLANES[plane]]))


def fit_cube(points: Array) -> tuple[int, float, float, Plane | None] | str:
    """Fit the standard's cube to five points ``(3, 5)``, m, in the axes of the base; return the reason if none fits.

    Returns:
        Index of P1 among the points; the preferred edge that has the outer points 8 to 12 % of the diagonal from its
        corners, the standard's tolerance, else the edge with 10 %, m; that share; and the plane, None for an upright
        one, which is not one of the standard's four.
    """
    centre = int(np.argmin(np.sum(np.square(points - points.mean(axis=1, keepdims=True)), axis=0)))
    outer = np.delete(points, centre, axis=1) - points[:, [centre]]
    radii = np.sqrt(np.sum(np.square(outer), axis=0))
    mean_radius = float(radii.mean())
    if mean_radius == 0.0:
        return "the five poses are at the same position"
    gaps = np.sqrt(np.sum(np.square(outer[:, :, None] + outer[:, None, :]), axis=0)) / mean_radius
    opposite = np.argmin(gaps, axis=1)
    if np.ptp(radii) > _SIZE_TOLERANCE * mean_radius or np.max(gaps.min(axis=1)) > _SIZE_TOLERANCE:
        return "no pose is the centre of the other four"
    # A corner's coordinate along each axis is 1/sqrt(3) of its distance from the centre.
    half = mean_radius / math.sqrt(3.0)
    if np.max(np.abs(np.abs(outer) - half)) <= _SIZE_TOLERANCE * mean_radius:
        numbers = {*(np.array([4, 2, 1]) @ (outer > 0.0)).tolist()}
        rising = next((plane for plane, own in PLANES.items() if numbers == {*own}), None)
        preferred = (edge for edge in PREFERRED_EDGES if abs(0.5 - half / edge - FROM_CORNER) <= 0.02)
        edge = next(preferred, half / (0.5 - FROM_CORNER))
        return centre, edge, 0.5 - half / edge, rising
    neighbour = next(i for i in range(1, 4) if i != opposite[0])
    sides = sorted(float(np.linalg.norm(outer[:, 0] - outer[:, i])) for i in (neighbour, opposite[neighbour]))
    if abs(sides[1] / sides[0] - math.sqrt(2.0)) <= 2.0 * _SIZE_TOLERANCE:
        return "the poses lie in a diagonal plane of a cube whose edges are not parallel to the axes of the base"
    return (
        f"the outer poses form a rectangle of {sides[0] * 1e3:.0f} mm by {sides[1] * 1e3:.0f} mm; a diagonal plane has "
        "sides of 1 : √2"
    )


# Centres of cubes that an arm reaches, in front of it, the most used place first.

_RADII, _HEIGHTS = 12, 16
"""Grid of places in front of the arm that are tried as the cube's centre."""
_CENTRE_BATCH = 24
"""Number of centres whose corners are solved together, the most used place first."""
_MAX_CENTRES = 4
"""Number of centres with all corners in reach whose orientations are tried."""


def reachable_centres(arm: Arm, edge: float) -> Array:
    """Return centres ``(3, C)`` of the first few cubes all of whose corners the target reaches, the most used first."""
    q = spread_configurations(arm, 2048)
    low, high = joint_ranges(arm)
    q[0] = 0.5 * (low[0] + high[0]) if np.isfinite(low[0]) else 0.0
    positions = arm.chain.forward(q).translation
    furthest = positions[:, int(np.argmax(np.hypot(positions[0], positions[1])))]
    azimuth = math.atan2(furthest[1], furthest[0])
    along = 0.5 * math.pi * round(azimuth / (0.5 * math.pi))
    # A front direction closer to an axis of the base than this is set to that axis.
    azimuth = along if abs(azimuth - along) < math.radians(30.0) else azimuth
    front = np.array([math.cos(azimuth), math.sin(azimuth)])
    forward = front @ positions[:2]
    middle = np.median(forward[forward > 0.0]), np.median(positions[2, forward > 0.0])
    radius, height = np.meshgrid(
        np.linspace(0.0, forward.max(), _RADII + 1)[1:],
        np.linspace(positions[2].min(), positions[2].max(), _HEIGHTS),
    )
    order = np.argsort(np.hypot(radius - middle[0], height - middle[1]).ravel(), kind="stable")
    if arm.robot.variables[0].type == "revolute":
        # The column of a turning arm takes space: the cube's near side stays a tenth of the reach clear of its axis.
        nearest = 0.5 * edge * float(np.abs(front).sum()) + 0.1 * forward.max()
        order = order[radius.ravel()[order] >= nearest]
    # Step of the centres' coordinates (a tenth of the edge for small cubes), m.
    grid = min(0.01, 0.1 * edge)
    centres = np.round(np.vstack((front[:, None] * radius.ravel()[order], height.ravel()[order])) / grid) * grid
    reachable: list[Array] = []
    for start in range(0, centres.shape[1], _CENTRE_BATCH):
        batch = centres[:, start : start + _CENTRE_BATCH]
        targets = _at(np.concatenate([corners(centre, edge) for centre in batch.T], axis=1), np.eye(3))
        reached = inverse_kinematics(arm, targets, starts=3, oriented=False).converged.any(axis=1)
        reachable += list(batch[:, reached.reshape(-1, 8).all(axis=1)].T)
        if len(reachable) >= _MAX_CENTRES:
            break
    return np.array(reachable[:_MAX_CENTRES]).reshape(-1, 3).T


# Proposed cube and five poses for an arm: the largest preferred edge whose corners and poses the arm reaches.
#
# The standard places the cube in the part of the working space that is used most. This module assumes that part in
# front of the arm, at the middle of its reach with the first joint in the middle of its range. Among the cubes whose
# eight corners the target reaches, it selects the nearest to that place whose five poses are all reached with one
# orientation of the tool, within the joint limits and in one configuration of the arm.

Orientation = Literal["down", "forward", "own", "free"]
ORIENTATIONS: tuple[Orientation, ...] = ("down", "forward", "own", "free")
_STARTS = 8
_ROLLS = 8


@dataclass(frozen=True, slots=True)
class Proposal:
    """Five poses to test an arm at."""

    edge: float
    """m"""
    centre: Array
    """``(3,)`` in the base's axes, m."""
    plane: Plane
    orientation: Orientation
    poses: Poses
    """P1 to P5 of the target in the measuring frame."""
    q: Array
    """``(J, 5)`` joint variables, rad or m."""
    margin: float
    """Smallest distance of a joint from its limits, as a fraction of its range; 0.5 is the middle."""
    notes: tuple[str, ...]
    target: str | None = None
    """Name of the target at these poses, if the robot has several."""


def propose(
    robot: Robot,
    *,
    edge: float | None = None,
    plane: Plane | None = None,
    orientation: Orientation | None = None,
    target: str | None = None,
) -> Proposal:
    """Propose the cube and the five poses of an arm.

    Args:
        robot: The arm; its kinematics without effects, as its controller computes them.
        edge: Edge of the cube, m; None: the largest preferred edge that fits.
        plane: Plane of the cube; None: the plane in which the joints stay furthest from their limits.
        orientation: Orientation of the tool; None: the first of :data:`ORIENTATIONS` possible at all five poses.
        target: Name of the target if the robot has several; None: the first.

    Raises:
        InputError: No cube fits, or a prismatic joint has no limits.
        UsageError: The robot has no such target, or the edge is not a length above zero.
    """
    refuse(
        (
            edge is not None and not 0.0 < edge < math.inf,
            f"the cube's edge is a length above 0, not {edge or 0.0:g} m",
        ),
        (
            target is not None and target not in robot.targets,
            f"no target {target!r}; the robot file has {', '.join(robot.targets) or 'one tool without a name'}",
        ),
    )
    name = target or next(iter(robot.targets), None)
    tool = robot.tool if name is None else robot.targets[name]
    # In the base's axes, to which the cube's edges are parallel.
    arm = Arm.of(replace(robot, tool=tool, targets={}, base=Frame(), effects=()))
    edges = PREFERRED_EDGES if edge is None else (edge,)
    # A smaller cube with one orientation is preferred to a larger cube without.
    preferred = (ORIENTATIONS[:3], ORIENTATIONS[3:]) if orientation is None else ((orientation,),)
    centres = cache(partial(reachable_centres, arm))
    tried = ((size, kind, at) for kinds in preferred for size in edges for kind in kinds for at in centres(size).T)
    for size, kind, centre in tried:
        proposals = (
            _best_plane(arm, centre, size, plane, kind, rotation) for rotation in _rotations(arm, kind, centre)
        )
        # The tool rotation that is furthest from the joint limits.
        proposal = max(filter(None, proposals), key=lambda one: round(one.margin, 6), default=None)
        if proposal is not None:
            found = kind if orientation is None else None
            notes = applying(
                (
                    target is None and len(robot.targets) > 1,
                    f"for the target {name}, the first of {len(robot.targets)}",
                ),
                (
                    bool(robot.effects),
                    "joint angles are those of the nominal kinematics; the robot file's effects are not applied",
                ),
                (size not in PREFERRED_EDGES, f"the standard prefers edges of {PREFERRED_SIZES} mm"),
                (
                    found == "free",
                    "the arm reaches no single tool orientation at all five poses: each pose has a different one",
                ),
                (found == "own", "the arm cannot point the tool down or forward at all five poses of a preferred cube"),
            )
            return replace(
                proposal,
                poses=Poses.from_xyz_rpy(np.array(robot.base.xyz)[:, None], np.array(robot.base.rpy)[:, None])
                @ proposal.poses,
                notes=notes,
                target=name,
            )
    cube = f"of {1e3 * edge:g} mm" if edge is not None else f"of {1e3 * PREFERRED_EDGES[-1]:.0f} mm or more"
    required = [f"the plane {plane}"] if plane else []
    required += [ORIENTATION_TEXT[orientation]] if orientation else []
    cube += f" with {' and '.join(required)}" if required else ""
    raise InputError(
        Problem(
            f"{robot.name}: found no cube {cube} whose corners and five poses the arm reaches",
            fix="give a smaller `edge`" + ", or leave out `plane` and `orientation`" * bool(required),
        )
    )


def planned_poses(proposal: Proposal, cycles: int, payload: float | None = None) -> Measurements:
    """Return the five poses in order, ``cycles`` times; nothing is measured yet, so the attained positions are zero."""
    visit = np.tile(np.arange(5), cycles)
    return Measurements(
        position=np.zeros((3, visit.size)),
        q=proposal.q[:, visit],
        commanded_position=proposal.poses.translation[:, visit],
        commanded_rotation=proposal.poses.rotation[..., visit],
        pose=np.array([f"P{i + 1}" for i in visit]),
        cycle=np.repeat(np.arange(1, cycles + 1), 5).astype(str) if cycles > 1 else None,
        target=None if proposal.target is None else np.full(visit.size, proposal.target),
        payload=None if payload is None else np.full(visit.size, payload),
    )


def _rotations(arm: Arm, kind: Orientation, centre: Array) -> Iterator[Array | None]:
    """Yield orientations ``(3, 3)`` of the tool to try; None: any."""
    if kind == "free":
        yield None
    elif kind == "own":
        reached = inverse_kinematics(arm, _at(centre[:, None], np.eye(3)), starts=_STARTS, oriented=False)
        q = reached.q[:, 0, reached.converged[0]]
        if q.size:
            best = int(np.argmax(np.round(np.min(_margins(arm, q), axis=0), 6)))
            yield arm.chain.forward(q[:, [best]]).rotation[..., 0]
    else:
        pointed = rotation_about(0, math.pi) if kind == "down" else rotation_about(1, 0.5 * math.pi)
        outwards = rotation_about(2, math.atan2(centre[1], centre[0])) @ pointed
        yield from (outwards @ rotation_about(2, 2.0 * math.pi * roll / _ROLLS) for roll in range(_ROLLS))


def _best_plane(
    arm: Arm, centre: Array, edge: float, plane: Plane | None, kind: Orientation, rotation: Array | None
) -> Proposal | None:
    """Return the plane whose five poses are reached with the joints furthest from their limits, in one configuration.

    P1 is solved from several starts, the outer poses from each of P1's solutions, so that the arm does not change its
    configuration between them. All planes together have eight outer points; each plane has four.
    """
    own, is_oriented = np.eye(3) if rotation is None else rotation, rotation is not None
    first = inverse_kinematics(arm, _at(centre[:, None], own), starts=_STARTS, oriented=is_oriented)
    starts = first.q[:, 0, first.converged[0]]
    if starts.shape[1] == 0:
        return None
    inner = corners(centre, (1.0 - 2.0 * FROM_CORNER) * edge)
    outer = inverse_kinematics(arm, _at(inner, own), starts=starts, oriented=is_oriented)
    best: Proposal | None = None
    for candidate in PLANES if plane is None else (plane,):
        nearest = list(PLANES[candidate])
        solved = np.flatnonzero(outer.converged[nearest].all(axis=0))
        if solved.size == 0:
            continue
        joints = np.concatenate((starts[:, None, solved], outer.q[:, nearest][:, :, solved]), axis=1)
        margins = np.round(np.min(_margins(arm, joints), axis=(0, 1)), 6)
        i = int(np.argmax(margins))
        # Clearance between a joint and its limits, as a fraction of its range.
        if margins[i] >= 0.01 and (best is None or margins[i] > best.margin):
            # The decimals limit how exactly the poses are met.
            q = np.round(joints[..., i], 11) + 0.0
            poses = arm.chain.forward(q) if rotation is None else _at(five_points(centre, edge, candidate), rotation)
            best = Proposal(edge, centre, candidate, kind, poses, q, float(margins[i]), ())
    return best


def _at(points: Array, rotation: Array) -> Poses:
    """Return poses at points ``(3, N)`` with one orientation ``(3, 3)``."""
    return Poses(np.repeat(rotation[..., None], points.shape[1], axis=2), points)


def _margins(arm: Arm, q: Array) -> Array:
    """Return distances of joints ``(J, …)`` from the nearer limit, as a fraction of the range; 0.5 without limits."""
    low, high = (ends.reshape(-1, *(1,) * (q.ndim - 1)) for ends in joint_ranges(arm))
    bounded = np.isfinite(low)
    span = np.where(bounded, high - low, 1.0)
    return np.asarray(np.where(bounded, np.minimum(q - low, high - q) / np.where(span > 0.0, span, 1.0), 0.5))


# Evaluation of measured poses.

# Conditions of the standard's protocol, and whether the data meet them, violate them or do not record them.
#
# Clauses of ISO 9283:1998: 6.2 (conditions prior to testing), 6.3 (environment), 6.5 (instrumentation), 6.6 (load),
# 6.7 (velocity), 6.8 (poses), 6.9 (cycles), 7.2 (approaches), 7.4 (stabilisation).

CYCLES = 30
_POSE_COUNT = 5
_AMBIENT, _AMBIENT_TOLERANCE = 20.0, 2.0
_STEP_TOLERANCE = 0.02
"""Relative tolerance within which a load or velocity counts as a rated step."""

Status = Literal["met", "not_met", "unknown"]
Finding = tuple[Status, str]
"""Whether a condition is met, and the reason."""


def protocol(
    files: Sequence[Measurements],
    poses: Sequence[CommandedPose],
    robot: Robot | None,
    repeatability: Characteristic,
    shift: Characteristic,
    rated_load: float | None,
) -> Sequence[Mapping[str, str]]:
    """Return every condition, in the order of the clauses, with the keys of the result."""

    def logged(column: str, missing: str, judge: Callable[[list[Any]], Finding]) -> Finding:
        """Judge the values of a column, one array for each file; unknown where a file lacks it."""
        values = [getattr(data, column) for data in files]
        return ("unknown", missing) if any(value is None for value in values) else judge(values)

    warm_up = "the warm-up is not recorded"
    if shift.position.interval.lower and shift.position.value is not None:
        moved = f"the barycentre of {shift.position_at} moved {shift.position.value * 1e3:.2g} mm during the run"
        warm_up = f"{warm_up}, but {moved}"
    n_poses = sorted({sum(pose.number == number for pose in poses) for number in range(len(files))})
    n_visits = sorted({pose.data.n for pose in poses})
    five_poses = f"{' and '.join(map(str, n_poses))} commanded pose{'s' * (n_poses != [1])}"
    cycles = (
        f"{n_visits[0]} visit{'s' * (n_visits[0] > 1)} of each commanded pose"
        if len(n_visits) == 1
        else f"{n_visits[0]} to {n_visits[-1]} visits of a commanded pose"
    )
    diagonal, corner_distance = _cube([pose for pose in poses if pose.number == 0], robot)
    turning = [
        pose.label
        for pose in poses
        if (way := pose.data.direction) is not None and np.unique(way[:, np.any(way != 0, axis=0)], axis=1).shape[1] > 1
    ]
    several = f"{', '.join(turning[:3])}{' …' * (len(turning) > 3)} approached from several directions"
    approach = _first(
        (bool(turning), "not_met", f"{several}: AP and RP include vAP"),
        (True, "met", "every visit of a pose has the same approach direction"),
    )
    no_sigma = "no columns sigma_x, sigma_y, sigma_z"
    no_approach = "approach directions are not known; `ordered` derives them from the rows"
    findings: tuple[tuple[str, str, Finding], ...] = (
        ("warm-up", "6.2", ("unknown", warm_up)),
        ("temperature", "6.3", logged("temperature", "no column temperature_c", _temperature)),
        ("measuring uncertainty", "6.5", logged("sigma_position", no_sigma, lambda v: _instrument(v, repeatability))),
        ("rated load", "6.6", logged("payload", "no column payload_kg", lambda loads: _load(loads, rated_load))),
        ("rated velocity", "6.7", logged("speed", "no speed columns", lambda speeds: _velocity(files, speeds))),
        ("five poses", "6.8", ("met" if n_poses == [_POSE_COUNT] else "not_met", five_poses)),
        ("diagonal plane", "6.8", diagonal),
        ("10 % from the corners", "6.8", corner_distance),
        ("30 cycles", "6.9", ("met" if n_visits[0] >= CYCLES else "not_met", cycles)),
        ("one approach", "7.2", logged("direction", no_approach, lambda _: approach)),
        ("stabilisation", "7.4", ("unknown", "the time between arrival and measurement is not recorded")),
    )
    return [
        {"condition": name, "clause": clause, "status": status, "why": why} for name, clause, (status, why) in findings
    ]


def _first(*cases: tuple[bool, Status, str]) -> Finding:
    """Return the finding of the first case that holds."""
    return next((status, why) for holds, status, why in cases if holds)


def _temperature(logged: list[Array]) -> Finding:
    low, high = min(float(values.min()) for values in logged), max(float(values.max()) for values in logged)
    text, most = f"{low:.1f} °C to {high:.1f} °C", _AMBIENT_TOLERANCE
    is_ambient = max(abs(low - _AMBIENT), abs(high - _AMBIENT)) <= most
    return _first(
        (high - low > 2.0 * most, "not_met", f"{text}: varies by more than ± {most:.0f} °C"),
        (is_ambient, "met", f"{text}, within 20 °C ± {most:.0f} °C"),
        (True, "met", f"{text}: constant within ± 2 °C but not at 20 °C; state it with the result"),
    )


def _instrument(sigmas: list[Array], repeatability: Characteristic) -> Finding:
    smallest = min((place.position.value for place in repeatability.places), default=None)
    if smallest is None:
        return "unknown", "there is no RP to compare it with"
    expanded = 2.0 * max(float(np.max(sigma)) for sigma in sigmas)
    # Largest measuring uncertainty as a fraction of the criterion.
    share = expanded / smallest if smallest > 0.0 else np.inf
    text = f"expanded (k = 2) {expanded * 1e3:.2g} mm is {100 * share:.0f} % of the smallest RP"
    return "met" if share <= 0.25 else "not_met", f"{text}; at most 25 % is allowed"


def _load(loads: list[Array], rated: float | None) -> Finding:
    low, high = min(float(load.min()) for load in loads), max(float(load.max()) for load in loads)
    return _first(
        (
            high - low > _STEP_TOLERANCE * max(high, 1e-9),
            "not_met",
            f"the load varies from {low:g} kg to {high:g} kg",
        ),
        (rated is None, "unknown", f"{high:g} kg throughout; give `rated_load` to compare"),
        (True, *_rated_share(high / (rated or 1.0), (1.0, 0.1), f"{high:g} kg of {rated or 0:g} kg", "load")),
    )


def _velocity(files: Sequence[Measurements], speeds: list[Array]) -> Finding:
    is_derived = any(
        np.allclose(speed, motion_between_visits(data.q, visits)[1], atol=1e-9)
        for data, speed in zip(files, speeds, strict=True)
        if data.q is not None
        for visits in [numbered_visits(data.groups(), data.visit, data.cycle, data.target)]
    )
    fastest = np.concatenate([np.max(np.abs(speed), axis=0) for speed in speeds])
    fastest = fastest[fastest > 0.0]
    low, high = 100 * fastest.min(initial=np.inf), 100 * fastest.max(initial=0.0)
    share = float(fastest.mean()) if fastest.size else 0.0
    return _first(
        (is_derived, "unknown", "speeds are derived from the order of rows: they are relative, not absolute"),
        (fastest.size == 0, "unknown", "every speed is 0"),
        (
            high - low > 100 * _STEP_TOLERANCE,
            "not_met",
            f"the fastest joint's speed varies from {low:.0f} % to {high:.0f} %",
        ),
        (True, *_rated_share(share, (1.0, 0.5, 0.1), "the fastest joint's last motion", "velocity")),
    )


def _rated_share(share: float, steps: tuple[float, ...], description: str, quantity: str) -> Finding:
    """Return the status of a share of the rated value and the reason, which names the standard's optional steps."""
    step = next((step for step in steps if abs(share - step) <= _STEP_TOLERANCE * max(step, 0.1)), None)
    text, optional = f"{description}: {100 * share:.0f} %", ", ".join(f"{100 * step:.0f} %" for step in steps[1:])
    return _first(
        (step is None, "not_met", f"{text}; the standard requires 100 %; optional steps are {optional}"),
        (step == 1.0, "met", f"{description}: 100 %"),
        (
            True,
            "met",
            f"{description}: {100 * (step or 0):.0f} %, an optional step; a test at 100 % {quantity} is needed too",
        ),
    )


def _cube(poses: Sequence[CommandedPose], robot: Robot | None) -> tuple[Finding, Finding]:
    """Return the conditions on the diagonal plane and on the distance from the corners."""
    points = [pose.commanded for pose in poses if pose.commanded is not None]
    if len(points) < len(poses):
        return (("unknown", "the commanded positions are not known"),) * 2
    if len(points) != _POSE_COUNT:
        return (("not_met", "needs five commanded poses"),) * 2
    base = Frame().pose if robot is None else robot.base.pose
    fit = fit_cube(base.rotation.T @ (np.stack(points, axis=1) - base.translation[:, None]))
    if isinstance(fit, str):
        return (("not_met", fit),) * 2
    (centre, edge, share, rising), cube = fit, f"a cube of {fit[1] * 1e3:.0f} mm"
    upright = "the diagonal plane is upright; the standard's planes rise at 45°"
    return _first(
        (rising is None, "not_met", upright),
        (True, "met", f"{poses[centre].label} is the centre, and the plane rises at 45° towards {rising}"),
    ), _first(
        (any(abs(edge - preferred) < 1e-9 for preferred in PREFERRED_EDGES), "met", f"{100 * share:.1f} % in {cube}"),
        (True, "unknown", f"10 % in {cube}, not a preferred size; the preferred edges are {PREFERRED_SIZES} mm"),
    )


def iso9283(
    files: Sequence[Measurements],
    robot: Robot | None = None,
    *,
    align: Sequence[str] = (),
    confidence: float = 0.95,
    seed: int = 0,
    windows: int | None = None,
    rated_load: float | None = None,
) -> Iso9283Result:
    """Evaluate the pose criteria of ISO 9283 for one robot per file.

    Args:
        files: Measured poses of at least one file. Without ``robot`` and without commanded poses in a file there is
            repeatability but no accuracy.
        robot: Gives the commanded pose of every row at its q, effects included; replaces commanded poses in the file.
        align: Frames of :data:`robacc.fitting.registration.ALIGNABLE` that are fitted to each file's poses.
        confidence: Confidence of every interval.
        seed: Seed of the bootstrap.
        windows: Number of windows that each pose's visits are divided into for the drift; None: ten visits each.
        rated_load: Rated load in kg; None: not known.

    Raises:
        UsageError: The arguments contradict each other or the data.
        InputError: The data lack something that the call needs.
    """
    check_confidence(confidence)
    refuse(
        (not files, "no file of measured poses is given; give at least one"),
        (
            windows is not None and windows < 2,
            f"drift is a change between windows: `drift_windows` is at least 2, not {windows}",
        ),
        (
            rated_load is not None and not 0.0 < rated_load < np.inf,
            f"`rated_load` is above 0 kg, not {rated_load or 0:g}",
        ),
        (
            bool(align) and robot is None and any(data.commanded_position is None for data in files),
            "`align` registers commanded poses, and there are none: give `robot`, or columns cmd_x, cmd_y, cmd_z",
        ),
    )
    names = [
        (data.source or f"file {i + 1}").replace("\\", "/").rstrip("/").rpartition("/")[2]
        for i, data in enumerate(files)
    ]
    sources = [f"{name} ({i + 1})" if names.count(name) > 1 else name for i, name in enumerate(names)]
    # Without a robot and without commands in a file, the commanded poses are not known.
    commands = [
        (None, None) if robot is None and data.commanded_position is None else commanded_poses(data, robot)
        for data in files
    ]
    nominal = poses_by_file = shared = [visits_of(data, commands[i], sources[i], i) for i, data in enumerate(files)]
    # Sixty times the standard's five.
    most = 300
    problems = [
        Problem(
            f"has {len(poses)} commanded poses; the standard's criteria need a few poses, at most {most}",
            poses[0].source,
            fix="name the commanded poses in a column pose; the command estimate takes poses that are visited once",
        )
        for poses in nominal
        if len(poses) > most
    ]
    refuse((problems, problems))
    alignments = [register(data, robot, align) for data in files] if align else []
    if alignments:
        base = Frame().pose if robot is None else robot.base.pose
        moves = [base @ alignment.robot.base.pose.inverse() for alignment in alignments]
        # Registered robots were measured in different frames: positions move from the registered to the nominal base.
        shared = [
            tuple(
                pose._replace(data=replace(pose.data, position=move.rotation @ pose.data.position + offset))
                for pose in poses
            )
            for move, poses in zip(moves, nominal, strict=True)
            for offset in [move.translation[:, None]]
        ]
        poses_by_file = [
            visits_of(data, commanded_poses(data, robot, alignments[i]), sources[i], i) for i, data in enumerate(files)
        ]
    poses = tuple(pose for file_poses in poses_by_file for pose in file_poses)
    scatter = repeatability(poses, confidence, seed)
    *drifts, shift = drift(poses, confidence, seed, windows)
    robot = alignments[0].robot if robot is not None and alignments else robot
    return Iso9283Result(
        n_poses=sum(data.n for data in files),
        sources=tuple(sources),
        commanded=None if all(position is None for position, _ in commands) else "file" if robot is None else "robot",
        poses=poses,
        characteristics=(
            accuracy(poses, confidence),
            scatter,
            multidirectional(poses, confidence),
            *distance_criteria(poses, confidence),
            *drifts,
            shift,
            exchangeability(shared, confidence),
        ),
        protocol=protocol(files, poses, robot, scatter, shift, rated_load),
        alignments=tuple(alignments),
        # The largest AP_p of each file.
        unaligned=np.array(
            [
                max(float(np.linalg.norm(one.deviation.mean(axis=1))) for one in of_file if one.deviation is not None)
                for of_file in nominal
            ]
        )
        if alignments
        else None,
        confidence=confidence,
        notes=_notes(poses, alignments, robot, files, shift),
        warnings=_warnings(files, poses_by_file, bool(alignments)),
    )


def _notes(
    poses: Sequence[CommandedPose],
    alignments: "Sequence[Alignment]",
    robot: Robot | None,
    files: Sequence[Measurements],
    shift: Characteristic,
) -> tuple[str, ...]:
    effects = dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects) if robot is not None else ()
    # The scatter of the visits, sphered for each pose, may have longer tails than a Gaussian.
    sphered = []
    for pose in poses:
        attained = pose.data.position
        values, axes = np.linalg.eigh(np.cov(attained)) if pose.data.n > 9 else (np.zeros(3), np.eye(3))
        if values[0] > 1e-12 * values[-1]:
            sphered.append((axes / np.sqrt(values)).T @ (attained - attained.mean(axis=1, keepdims=True)))
    test = assumption_tests(np.concatenate(sphered, axis=1)).kurtosis if sphered else None
    p_value = 1.0 if test is None or test.p_value is None else test.p_value
    notes = applying(
        (
            True,
            "RP is how closely the visits of a pose agree with each other; their distance from the commanded pose is "
            "AP",
        ),
        (
            any(sum(pose.number == number for pose in poses) > 1 for number in range(len(files))),
            "every criterion is the largest over all measured poses or pairs of poses; where the standard prescribes "
            "fewer (for distances P2 to P4, for drift P1), the JSON result has the value of each pose",
        ),
        (
            robot is not None and any(data.commanded_position is not None for data in files),
            "commanded poses are from the robot; the files' cmd_ columns were not used",
        ),
        (bool(effects), f"the robot file's effects are applied to the command: {', '.join(effects)}"),
        *(
            (True, note)
            for alignment in alignments
            for note in (
                f"{'AP, dAP and E' if len(files) > 1 else 'AP and dAP'} are after registration with "
                f"{alignment.n_parameters} parameters, fitted to the same poses"
                + " of each robot: E lacks what differs between their base frames"
                * (len(files) > 1),
                *alignment.notes,
            )
        ),
        (
            any(pose.at_pole for pose in poses),
            "a, b, c are rotations about x, y, z of the measuring frame where pitch is within 10° of 90°: roll and yaw "
            "are not defined there",
        ),
        (
            bool(shift.position.interval.lower),
            "the robot drifted during the run by more than the scatter explains: AP and RP include the drift",
        ),
        # p-value below which a note says that the scatter is not Gaussian.
        (
            p_value <= 0.01,
            f"the scatter of the visits has longer tails than a Gaussian (Mardia's kurtosis, p = {p_value:.1g}): the "
            "intervals of RP assume a Gaussian and are too narrow",
        ),
    )
    return tuple(dict.fromkeys(notes))


def _warnings(
    files: Sequence[Measurements], poses_by_file: Sequence[Sequence[CommandedPose]], registered: bool
) -> tuple[str, ...]:
    moves = [
        (float(np.max(np.abs(pose.data.position - pose.deviation - pose.commanded[:, None]))), pose.label)
        for poses in poses_by_file
        for pose in poses
        if pose.deviation is not None and pose.commanded is not None
    ]
    move, label = max(moves, key=lambda entry: entry[0], default=(0.0, ""))
    # Readings have more digits than an arm repeats, unless one is copied or the instrument is too coarse.
    equal = [
        pose.label
        for of_file in poses_by_file
        for pose in of_file
        if pose.data.n > 1 and np.ptp(pose.data.position, axis=1).max() == 0.0
    ]
    # A single pose does not show whether the accuracy of a robot is too bad for an arm.
    is_far = any(
        too_far(
            rms_length(np.column_stack([pose.deviation.mean(axis=1) for pose in poses if pose.deviation is not None])),
            np.column_stack([pose.data.position.mean(axis=1) for pose in poses]),
        )
        for poses in poses_by_file
        if len(poses) > 1 and all(pose.deviation is not None for pose in poses)
    )
    warnings = applying(
        *((True, warning) for data in files for warning in data.warnings),
        (
            move > STILL,
            f"the command of {label} differs by {move * 1e3:.2g} mm between its visits, but cycles repeat one "
            "commanded pose; put commanded joint values into the q columns, not encoder readings",
        ),
        (is_far, TOO_LARGE if registered else UNREGISTERED),
        (
            bool(equal),
            f"all visits of {', '.join(equal[:5])} have the same position to the last digit: they were not measured "
            "one by one, or the instrument is too coarse, and RP is no result",
        ),
    )
    return tuple(dict.fromkeys(warnings))
