"""Test cube of ISO 9283:1998, clause 6.8: its five poses, and a proposal of cube and poses for an arm.

The cube's edges are parallel to the base frame's axes. P1 is its centre; P2 to P5 lie on the diagonals through the
four corners of a plane tilted by 45 degrees, 10 % of the diagonal's length (8 to 12 %) from its ends.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import numpy as np

from robacc.errors import InputError, Problem, refuse
from robacc.geometry import Array, Poses, rotation_about
from robacc.measurements import Measurements
from robacc.robots.arm import Arm, inverse_kinematics, joint_ranges, spread_configurations
from robacc.robots.description import Frame, Robot

Plane = Literal["x+", "x-", "y+", "y-"]
PLANES: tuple[Plane, ...] = ("x+", "x-", "y+", "y-")
"""Four planes of the standard, named by the horizontal direction in which each rises at 45 degrees."""
PREFERRED_EDGES = (1.0, 0.63, 0.4, 0.25)
"""Edge lengths that the standard prefers, m, the largest first."""
PREFERRED_SIZES = ", ".join(f"{1e3 * edge:.0f}" for edge in reversed(PREFERRED_EDGES))
"""The same in mm, as text."""
FROM_CORNER = 0.10
"""Distance of P2 to P5 from the corners, as a fraction of the diagonal's length."""
_SIZE_TOLERANCE = 0.01
"""Relative difference below which two sizes count as equal: 1 mm in 100 mm is accepted."""


@dataclass(frozen=True, slots=True)
class CubeFit:
    """Position of five points in the standard's cube."""

    centre: int
    """Index of P1 among the points."""
    half: float
    """Half the side of the cube that has the four outer points as corners, m."""
    plane: Plane | None
    """None: an upright diagonal plane, which is not one of the standard's four."""

    @property
    def edge(self) -> float:
        """Return the preferred edge with the points 8 to 12 % from its corners, else the edge with them at 10 %, m."""
        # Tolerance of the standard on `FROM_CORNER`.
        preferred = (edge for edge in PREFERRED_EDGES if abs(0.5 - self.half / edge - FROM_CORNER) <= 0.02)
        return next(preferred, self.half / (0.5 - FROM_CORNER))

    @property
    def from_corner(self) -> float:
        """Distance of the outer points from the corners of that cube, as a fraction of the diagonal."""
        return 0.5 - self.half / self.edge


def five_points(centre: Array, edge: float, plane: Plane) -> Array:
    """Return P1 to P5 ``(3, 5)``, m, in the axes of the cube; P2 and P4 are opposite, as are P3 and P5."""
    level, up = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    along = up if plane[1] == "+" else -up
    outer = np.stack((along, level, up) if plane[0] == "x" else (level, along, up))
    points = np.concatenate((np.zeros((3, 1)), (0.5 - FROM_CORNER) * edge * outer), axis=1)
    return np.asarray(np.asarray(centre, dtype=float)[:, None] + points)


def corners(centre: Array, edge: float) -> Array:
    """Return the cube's corners ``(3, 8)``, m."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float).T
    return np.asarray(np.asarray(centre, dtype=float)[:, None] + 0.5 * edge * signs)


def fit_cube(points: Array) -> CubeFit | str:
    """Fit the standard's cube to five points ``(3, 5)``, m, in the axes of the base; return the reason if none fits."""
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
        # The four planes in their order: along x and y, rising and falling.
        slopes = [sign * outer[axis] * outer[2] for axis in (0, 1) for sign in (1.0, -1.0)]
        rising = [plane for plane, slope in zip(PLANES, slopes, strict=True) if np.all(slope > 0.0)]
        return CubeFit(centre, half, rising[0] if rising else None)
    neighbour = next(i for i in range(1, 4) if i != opposite[0])
    sides = sorted(float(np.linalg.norm(outer[:, 0] - outer[:, i])) for i in (neighbour, opposite[neighbour]))
    if abs(sides[1] / sides[0] - math.sqrt(2.0)) <= 2.0 * _SIZE_TOLERANCE:
        return "the poses lie in a diagonal plane of a cube whose edges are not parallel to the axes of the base"
    size = f"{sides[0] * 1e3:.0f} mm by {sides[1] * 1e3:.0f} mm"
    return f"the outer poses form a rectangle of {size}; a diagonal plane has sides of 1 : √2"


# Centres of cubes that an arm reaches, in front of it, the most used place first.

_SAMPLES = 2048
_RADII, _HEIGHTS = 12, 16
"""Grid of places in front of the arm that are tried as the cube's centre."""
_CENTRE_BATCH = 24
"""Number of centres whose corners are solved together, the most used place first."""
_MAX_CENTRES = 4
"""Number of centres with all corners in reach whose orientations are tried."""


def reachable_centres(arm: Arm, edge: float) -> Array:
    """Return centres ``(3, C)`` of the first few cubes all of whose corners the target reaches, the most used first."""
    centres = _centres(arm, edge)
    reachable: list[Array] = []
    for start in range(0, centres.shape[1], _CENTRE_BATCH):
        batch = centres[:, start : start + _CENTRE_BATCH]
        targets = _at(np.concatenate([corners(centre, edge) for centre in batch.T], axis=1), np.eye(3))
        reached = inverse_kinematics(arm, targets, starts=3, oriented=False).converged.any(axis=1)
        reachable += list(batch[:, reached.reshape(-1, 8).all(axis=1)].T)
        if len(reachable) >= _MAX_CENTRES:
            break
    return np.array(reachable[:_MAX_CENTRES]).reshape(-1, 3).T


def _centres(arm: Arm, edge: float) -> Array:
    """Return places ``(3, C)`` on an upright plane in front of the arm, the most used first."""
    q = spread_configurations(arm, _SAMPLES)
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
        # The column of a turning arm takes space: the cube's near side stays clear of its axis.
        # Clearance between cube and first joint's axis, as a fraction of the reach.
        nearest = 0.5 * edge * float(np.abs(front).sum()) + 0.1 * forward.max()
        order = order[radius.ravel()[order] >= nearest]
    # Step of the centres' coordinates (a tenth of the edge for small cubes), m.
    grid = min(0.01, 0.1 * edge)
    places = np.vstack((front[:, None] * radius.ravel()[order], height.ravel()[order]))
    return np.asarray(np.round(places / grid) * grid)


# Proposed cube and five poses for an arm: the largest preferred edge whose corners and poses the arm reaches.
#
# The standard places the cube in the part of the working space that is used most. This module assumes that part in
# front of the arm, at the middle of its reach with the first joint in the middle of its range. Among the cubes whose
# eight corners the target reaches, it selects the nearest to that place whose five poses are all reached with one
# orientation of the tool, within the joint limits and in one configuration of the arm.

Orientation = Literal["down", "forward", "own", "free"]
ORIENTATIONS: tuple[Orientation, ...] = ("down", "forward", "own", "free")
ORIENTATION_TEXT: dict[Orientation, str] = {
    "down": "the tool's z axis pointing straight down",
    "forward": "the tool's z axis pointing level, away from the base",
    "own": "the tool's orientation constant, as the arm reaches the cube's centre",
    "free": "the tool's orientation different at each pose",
}
_DECIMALS = 11
"""Decimals of joint variables, which limit how exactly the poses are met."""
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
    names = ", ".join(robot.targets) or "one tool without a name"
    refuse(
        (
            edge is not None and not 0.0 < edge < math.inf,
            f"the cube's edge is a length above 0, not {edge or 0.0:g} m",
        ),
        (target is not None and target not in robot.targets, f"no target {target!r}; the robot file has {names}"),
    )
    name = target or next(iter(robot.targets), None)
    tool = robot.tool if name is None else robot.targets[name]
    # In the base's axes, to which the cube's edges are parallel.
    arm = Arm.of(dataclasses.replace(robot, tool=tool, targets={}, base=Frame(), effects=()))
    edges = PREFERRED_EDGES if edge is None else (edge,)
    # A smaller cube with one orientation is preferred to a larger cube without.
    preferred = (ORIENTATIONS[:3], ORIENTATIONS[3:]) if orientation is None else ((orientation,),)
    centres = cache(partial(reachable_centres, arm))
    for size, kind in ((size, kind) for kinds in preferred for size in edges for kind in kinds):
        proposal = _best_proposal(arm, centres(size), size, plane, kind)
        if proposal is not None:
            base = Poses.from_xyz_rpy(np.array(robot.base.xyz)[:, None], np.array(robot.base.rpy)[:, None])
            first = target is None and len(robot.targets) > 1
            found = kind if orientation is None else None
            notes = (
                (first, f"for the target {name}, the first of {len(robot.targets)}"),
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
            texts = tuple(note for applies, note in notes if applies)
            return dataclasses.replace(proposal, poses=base @ proposal.poses, notes=texts, target=name)
    cube = f"of {1e3 * edge:g} mm" if edge is not None else f"of {1e3 * PREFERRED_EDGES[-1]:.0f} mm or more"
    required = [f"the plane {plane}"] if plane else []
    required += [ORIENTATION_TEXT[orientation]] if orientation else []
    cube += f" with {' and '.join(required)}" if required else ""
    fix = "give a smaller `edge`" + (", or leave out `plane` and `orientation`" if required else "")
    message = f"{robot.name}: found no cube {cube} whose corners and five poses the arm reaches"
    raise InputError(Problem(message, fix=fix))


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


def _best_proposal(arm: Arm, centres: Array, edge: float, plane: Plane | None, kind: Orientation) -> Proposal | None:
    """Return the proposal at the first feasible centre, with the tool rotation furthest from the joint limits."""
    for centre in centres.T:
        tried = [_best_plane(arm, centre, edge, plane, kind, rotation) for rotation in _rotations(arm, kind, centre)]
        proposals = [proposal for proposal in tried if proposal is not None]
        if proposals:
            return max(proposals, key=lambda proposal: round(proposal.margin, 6))
    return None


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
        for roll in range(_ROLLS):
            turn = rotation_about(2, 2.0 * math.pi * roll / _ROLLS)
            yield rotation_about(2, math.atan2(centre[1], centre[0])) @ pointed @ turn


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
        points = five_points(centre, edge, candidate)
        nearest = np.argmin(np.sum(np.square(points[:, 1:, None] - inner[:, None, :]), axis=0), axis=1)
        solved = np.flatnonzero(outer.converged[nearest].all(axis=0))
        if solved.size == 0:
            continue
        joints = np.concatenate((starts[:, None, solved], outer.q[:, nearest][:, :, solved]), axis=1)
        margins = np.round(np.min(_margins(arm, joints), axis=(0, 1)), 6)
        i = int(np.argmax(margins))
        # Clearance between a joint and its limits, as a fraction of its range.
        if margins[i] >= 0.01 and (best is None or margins[i] > best.margin):
            q = np.round(joints[..., i], _DECIMALS) + 0.0
            poses = arm.chain.forward(q) if rotation is None else _at(points, rotation)
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
