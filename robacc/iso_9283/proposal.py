"""The cube and its five poses for an arm: the largest preferred edge whose corners and poses the arm reaches.

The cube is to stand in the part of the working space that is used most; that is taken to be in front of the arm, at the
middle of what it reaches there with its first joint in the middle of its range. Of the cubes whose eight corners the
target reaches, the one nearest there is taken that lets all five poses be reached with one orientation of the tool,
within the joint limits and in one configuration of the arm.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array, Poses, rotation_about
from robacc.iso_9283.cube import FROM_CORNER, PLANES, PREFERRED_EDGES, Plane, corners, five_points
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot
from robacc.robots.inverse_kinematics import inverse_kinematics, joint_ranges, spread_configurations

Orientation = Literal["down", "forward", "own", "free"]
ORIENTATIONS: tuple[Orientation, ...] = ("down", "forward", "own", "free")
_WORDS: dict[Orientation, str] = {
    "down": "the tool's z axis pointing straight down",
    "forward": "the tool's z axis pointing level, away from the base",
    "own": "the tool's orientation constant, as the arm has it at the cube's centre",
    "free": "the tool's orientation changing from pose to pose",
}
_SAMPLES = 2048
_RADII, _HEIGHTS = 12, 16
"""Places in front of the arm that are tried as the cube's centre."""
_AT_ONCE = 24
"""Centres whose corners are looked at together, the most usual first."""
_TRIED = 4
"""Centres with all corners in reach whose orientations are tried."""
_GRID = 0.01
"""Centres are at whole centimetres (of a tenth of the edge for small cubes), m."""
_ALIGNED = math.radians(30.0)
"""A front that is nearer to an axis of the base than this is taken to be along it."""
_DECIMALS = 11
"""Of joint variables: what the poses are met to."""
_COLUMN = 0.1
"""Of the reach, that a cube keeps from the first joint's axis."""
_CLEAR = 0.01
"""Of its range, that every joint keeps from its limits."""
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
    """Least distance of a joint from its limits, as a part of its range; 0.5 is the middle."""
    notes: tuple[str, ...]
    target: str | None = None
    """The one brought there, of a robot with several."""

    @property
    def words(self) -> str:
        """The orientation in words."""
        return _WORDS[self.orientation]


def propose(
    robot: Robot,
    *,
    edge: float | None = None,
    plane: Plane | None = None,
    orientation: Orientation | None = None,
    target: str | None = None,
) -> Proposal:
    """The cube and the five poses of an arm.

    Args:
        robot: The arm; its kinematics without effects, as its controller has them.
        edge: m; None: the largest of the preferred ones that fits.
        plane: Of the cube's four; None: the one in which the joints stay furthest from their limits.
        orientation: Of the tool; None: the first of :data:`ORIENTATIONS` that the arm can hold at all five poses.
        target: Of a robot with several; None: the first.

    Raises:
        InputError: no cube fits, or a slide has no limits.
        UsageError: a target that there is not, or an edge that is no length.
    """
    if edge is not None and not 0.0 < edge < math.inf:
        raise UsageError(f"the cube's edge is a length above zero, not {edge:g} m")
    single, notes = _single_target(robot, target)
    # In the base's own axes, to which the cube's edges are parallel.
    arm = Arm.of(dataclasses.replace(single, base=Frame(), effects=()))
    base = Poses.from_xyz_rpy(np.array(robot.base.xyz)[:, None], np.array(robot.base.rpy)[:, None])
    edges = PREFERRED_EDGES if edge is None else (edge,)
    within: dict[float, Array] = {}
    # A smaller cube with one orientation goes before a larger one without.
    for kinds in (("down", "forward", "own"), ("free",)) if orientation is None else ((orientation,),):
        for size in edges:
            if size not in within:
                within[size] = _within_reach(arm, size)
            for kind in kinds:
                found = _in_cube_of(arm, within[size], size, plane, kind)
                if found is not None:
                    every = (*notes, *_remarks(robot, found, orientation))
                    named = target or next(iter(robot.targets), None)
                    return dataclasses.replace(found, poses=base @ found.poses, notes=every, target=named)
    raise InputError(_nothing_fits(robot, edge, plane, orientation))


def planned_poses(found: Proposal, cycles: int, payload: float | None = None) -> Measurements:
    """The five poses visited in order, ``cycles`` times; nothing is measured, so the attained positions are zero."""
    visit = np.tile(np.arange(5), cycles)
    return Measurements(
        position=np.zeros((3, visit.size)),
        q=found.q[:, visit],
        commanded_position=found.poses.translation[:, visit],
        commanded_rotation=found.poses.rotation[..., visit],
        pose=np.array([f"P{i + 1}" for i in visit]),
        cycle=np.repeat(np.arange(1, cycles + 1), 5).astype(str) if cycles > 1 else None,
        target=None if found.target is None else np.full(visit.size, found.target),
        payload=None if payload is None else np.full(visit.size, payload),
    )


def _single_target(robot: Robot, target: str | None) -> tuple[Robot, list[str]]:
    if target is not None and target not in robot.targets:
        raise UsageError(f"no target {target!r}; the robot file has {', '.join(robot.targets) or 'one tool, unnamed'}")
    if not robot.targets:
        return robot, []
    name = target or next(iter(robot.targets))
    notes = [] if target or len(robot.targets) == 1 else [f"for the target {name}, the first of {len(robot.targets)}"]
    return dataclasses.replace(robot, tool=robot.targets[name], targets={}), notes


def _remarks(robot: Robot, found: Proposal, wanted: Orientation | None) -> list[str]:
    remarks = []
    if robot.effects:
        remarks.append("joint angles are of the robot file's nominal kinematics, its effects left out")
    if found.edge not in PREFERRED_EDGES:
        sizes = ", ".join(f"{1e3 * one:.0f}" for one in reversed(PREFERRED_EDGES))
        remarks.append(f"the standard prefers edges of {sizes} mm")
    if wanted is None and found.orientation == "free":
        remarks.append("no one orientation of the tool was found for all five poses: each has that of its joint angles")
    elif wanted is None and found.orientation == "own":
        remarks.append("pointing down or forward was not found possible at all five poses of such a cube")
    return remarks


def _nothing_fits(robot: Robot, edge: float | None, plane: Plane | None, orientation: Orientation | None) -> Problem:
    size = f"of {1e3 * edge:g} mm" if edge is not None else f"of {1e3 * PREFERRED_EDGES[-1]:.0f} mm or more"
    wishes = [f"the plane {plane}"] if plane else []
    wishes += [_WORDS[orientation]] if orientation else []
    with_ = f" with {' and '.join(wishes)}" if wishes else ""
    fix = "ask for a smaller cube with --edge" + (", or leave the plane and orientation open" if wishes else "")
    return Problem(
        f"{robot.name}: found no cube {size}{with_} that the arm reaches with all corners and five poses", fix=fix
    )


def _within_reach(arm: Arm, edge: float) -> Array:
    """``(3, C)`` centres of cubes all of whose corners the target reaches, the most usual first, at most a few."""
    centres = _centres(arm, edge)
    found: list[Array] = []
    for start in range(0, centres.shape[1], _AT_ONCE):
        some = centres[:, start : start + _AT_ONCE]
        points = np.concatenate([corners(centre, edge) for centre in some.T], axis=1)
        wanted = Poses(np.broadcast_to(np.eye(3)[..., None], (3, 3, points.shape[1])), points)
        reached = inverse_kinematics(arm, wanted, starts=3, oriented=False).converged.any(axis=1)
        found += list(some[:, reached.reshape(-1, 8).all(axis=1)].T)
        if len(found) >= _TRIED:
            break
    return np.array(found[:_TRIED]).reshape(-1, 3).T


def _centres(arm: Arm, edge: float) -> Array:
    """``(3, C)`` places on an upright plane in front of the arm, the most usual first."""
    q = spread_configurations(arm, _SAMPLES)
    low, high = joint_ranges(arm)
    q[0] = 0.5 * (low[0] + high[0]) if np.isfinite(low[0]) else 0.0
    positions = arm.chain.forward(q).translation
    furthest = positions[:, int(np.argmax(np.hypot(positions[0], positions[1])))]
    azimuth = math.atan2(furthest[1], furthest[0])
    along = 0.5 * math.pi * round(azimuth / (0.5 * math.pi))
    azimuth = along if abs(azimuth - along) < _ALIGNED else azimuth
    front = np.array([math.cos(azimuth), math.sin(azimuth)])
    forward = front @ positions[:2]
    ahead = forward > 0.0
    middle = np.median(forward[ahead]), np.median(positions[2, ahead])
    radius, height = np.meshgrid(
        np.linspace(0.0, forward.max(), _RADII + 1)[1:],
        np.linspace(positions[2].min(), positions[2].max(), _HEIGHTS),
    )
    order = np.argsort(np.hypot(radius - middle[0], height - middle[1]).ravel(), kind="stable")
    if arm.robot.variables[0].type == "revolute":
        # The column that a turning arm stands on takes room: the cube's near side keeps clear of its axis.
        nearest = 0.5 * edge * float(np.abs(front).sum()) + _COLUMN * forward.max()
        order = order[radius.ravel()[order] >= nearest]
    grid = min(_GRID, 0.1 * edge)
    places = np.vstack((front[:, None] * radius.ravel()[order], height.ravel()[order]))
    result: Array = np.round(places / grid) * grid
    return result


def _in_cube_of(arm: Arm, centres: Array, edge: float, plane: Plane | None, kind: Orientation) -> Proposal | None:
    """The proposal at the first of the centres that has one; of the tool's turns the one furthest from the limits."""
    for centre in centres.T:
        found = [
            one
            for rotation in _rotations(arm, kind, centre)
            if (one := _best_plane(arm, centre, edge, plane, kind, rotation)) is not None
        ]
        if found:
            return max(found, key=lambda one: round(one.margin, 6))
    return None


def _rotations(arm: Arm, kind: Orientation, centre: Array) -> Iterator[Array | None]:
    """Orientations ``(3, 3)`` of the tool to try; None: any."""
    if kind == "free":
        yield None
    elif kind == "own":
        wanted = Poses(np.eye(3)[..., None], centre[:, None])
        reached = inverse_kinematics(arm, wanted, starts=_STARTS, oriented=False)
        good = np.flatnonzero(reached.converged[0])
        if good.size:
            margins = np.min(_margins(arm, reached.q[:, 0, good]), axis=0)
            best = reached.q[:, 0, good[int(np.argmax(np.round(margins, 6)))]]
            yield arm.chain.forward(best[:, None]).rotation[..., 0]
    else:
        azimuth = math.atan2(centre[1], centre[0])
        pointed = rotation_about(0, math.pi) if kind == "down" else rotation_about(1, 0.5 * math.pi)
        for roll in range(_ROLLS):
            turn = rotation_about(2, 2.0 * math.pi * roll / _ROLLS)
            yield rotation_about(2, azimuth) @ pointed @ turn


def _best_plane(
    arm: Arm, centre: Array, edge: float, plane: Plane | None, kind: Orientation, rotation: Array | None
) -> Proposal | None:
    """The plane whose five poses are reached with the joints furthest from their limits, in one configuration.

    P1 is solved from several starts, the outer poses from each of P1's solutions, so that the arm need not change over
    between them. Those of all planes are eight points; each plane has four.
    """
    turned = np.eye(3) if rotation is None else rotation
    first = inverse_kinematics(arm, _held(centre[:, None], turned), starts=_STARTS, oriented=rotation is not None)
    starts = first.q[:, 0, first.converged[0]]
    if starts.shape[1] == 0:
        return None
    inner = corners(centre, (1.0 - 2.0 * FROM_CORNER) * edge)
    outer = inverse_kinematics(arm, _held(inner, turned), starts=starts, oriented=rotation is not None)
    best: Proposal | None = None
    for one in PLANES if plane is None else (plane,):
        points = five_points(centre, edge, one)
        apart = np.sum(np.square(points[:, 1:, None] - inner[:, None, :]), axis=0)
        chosen = np.argmin(apart, axis=1)
        whole = np.flatnonzero(outer.converged[chosen].all(axis=0))
        if whole.size == 0:
            continue
        every = np.concatenate((starts[:, None, whole], outer.q[:, chosen][:, :, whole]), axis=1)
        margins = np.round(np.min(_margins(arm, every), axis=(0, 1)), 6)
        i = int(np.argmax(margins))
        if margins[i] >= _CLEAR and (best is None or margins[i] > best.margin):
            q = np.round(every[..., i], _DECIMALS) + 0.0
            held = arm.chain.forward(q) if rotation is None else _held(points, rotation)
            best = Proposal(edge, centre, one, kind, held, q, float(margins[i]), ())
    return best


def _held(points: Array, rotation: Array) -> Poses:
    """Points ``(3, N)`` with one orientation ``(3, 3)``."""
    return Poses(np.repeat(rotation[..., None], points.shape[1], axis=2), points)


def _margins(arm: Arm, q: Array) -> Array:
    """Distance of each joint ``(J, …)`` from the nearer of its limits as a part of its range; 0.5 without limits."""
    low, high = (ends.reshape(-1, *(1,) * (q.ndim - 1)) for ends in joint_ranges(arm))
    bounded = np.isfinite(low)
    span = np.where(bounded, high - low, 1.0)
    result: Array = np.where(bounded, np.minimum(q - low, high - q) / np.where(span > 0.0, span, 1.0), 0.5)
    return result
