"""Proposed cube and five poses for an arm: the largest preferred edge whose corners and poses the arm reaches.

The standard places the cube in the part of the working space that is used most. This module assumes that part in front
of the arm, at the middle of its reach with the first joint in the middle of its range. Among the cubes whose eight
corners the target reaches, it selects the nearest to that place whose five poses are all reached with one orientation
of the tool, within the joint limits and in one configuration of the arm.
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
from robacc.iso_9283.cube_centres import reachable_centres
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot
from robacc.robots.inverse_kinematics import inverse_kinematics, joint_ranges

Orientation = Literal["down", "forward", "own", "free"]
ORIENTATIONS: tuple[Orientation, ...] = ("down", "forward", "own", "free")
_ORIENTATION_TEXT: dict[Orientation, str] = {
    "down": "the tool's z axis pointing straight down",
    "forward": "the tool's z axis pointing level, away from the base",
    "own": "the tool's orientation constant, as the arm reaches the cube's centre",
    "free": "the tool's orientation different at each pose",
}
_DECIMALS = 11
"""Decimals of joint variables, which limit how exactly the poses are met."""
_LIMIT_CLEARANCE = 0.01
"""Clearance between a joint and its limits, as a fraction of its range."""
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

    @property
    def orientation_text(self) -> str:
        """The orientation as text."""
        return _ORIENTATION_TEXT[self.orientation]


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
    if edge is not None and not 0.0 < edge < math.inf:
        raise UsageError(f"the cube's edge is a length above 0, not {edge:g} m")
    single, notes = _single_target(robot, target)
    # In the base's axes, to which the cube's edges are parallel.
    arm = Arm.of(dataclasses.replace(single, base=Frame(), effects=()))
    base = Poses.from_xyz_rpy(np.array(robot.base.xyz)[:, None], np.array(robot.base.rpy)[:, None])
    edges = PREFERRED_EDGES if edge is None else (edge,)
    reachable: dict[float, Array] = {}
    # A smaller cube with one orientation is preferred to a larger cube without.
    for orientations in (("down", "forward", "own"), ("free",)) if orientation is None else ((orientation,),):
        for candidate_edge in edges:
            if candidate_edge not in reachable:
                reachable[candidate_edge] = reachable_centres(arm, candidate_edge)
            for candidate in orientations:
                proposal = _best_proposal(arm, reachable[candidate_edge], candidate_edge, plane, candidate)
                if proposal is not None:
                    all_notes = (*notes, *_notes(robot, proposal, orientation))
                    target_name = target or next(iter(robot.targets), None)
                    return dataclasses.replace(
                        proposal, poses=base @ proposal.poses, notes=all_notes, target=target_name
                    )
    raise InputError(_nothing_fits(robot, edge, plane, orientation))


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


def _single_target(robot: Robot, target: str | None) -> tuple[Robot, list[str]]:
    if target is not None and target not in robot.targets:
        raise UsageError(
            f"no target {target!r}; the robot file has {', '.join(robot.targets) or 'one tool without a name'}"
        )
    if not robot.targets:
        return robot, []
    name = target or next(iter(robot.targets))
    notes = [] if target or len(robot.targets) == 1 else [f"for the target {name}, the first of {len(robot.targets)}"]
    return dataclasses.replace(robot, tool=robot.targets[name], targets={}), notes


def _notes(robot: Robot, proposal: Proposal, requested: Orientation | None) -> list[str]:
    notes = []
    if robot.effects:
        notes.append("joint angles are those of the nominal kinematics; the robot file's effects are not applied")
    if proposal.edge not in PREFERRED_EDGES:
        sizes = ", ".join(f"{1e3 * preferred:.0f}" for preferred in reversed(PREFERRED_EDGES))
        notes.append(f"the standard prefers edges of {sizes} mm")
    if requested is None and proposal.orientation == "free":
        notes.append("the arm reaches no single tool orientation at all five poses: each pose has a different one")
    elif requested is None and proposal.orientation == "own":
        notes.append("the arm cannot point the tool down or forward at all five poses of a preferred cube")
    return notes


def _nothing_fits(robot: Robot, edge: float | None, plane: Plane | None, orientation: Orientation | None) -> Problem:
    size = f"of {1e3 * edge:g} mm" if edge is not None else f"of {1e3 * PREFERRED_EDGES[-1]:.0f} mm or more"
    requirements = [f"the plane {plane}"] if plane else []
    requirements += [_ORIENTATION_TEXT[orientation]] if orientation else []
    requirement_text = f" with {' and '.join(requirements)}" if requirements else ""
    fix = "give a smaller `edge`" + (", or leave out `plane` and `orientation`" if requirements else "")
    return Problem(
        f"{robot.name}: found no cube {size}{requirement_text} whose corners and five poses the arm reaches",
        fix=fix,
    )


def _best_proposal(arm: Arm, centres: Array, edge: float, plane: Plane | None, kind: Orientation) -> Proposal | None:
    """Return the proposal at the first feasible centre, with the tool rotation furthest from the joint limits."""
    for centre in centres.T:
        proposals = [
            proposal
            for rotation in _rotations(arm, kind, centre)
            if (proposal := _best_plane(arm, centre, edge, plane, kind, rotation)) is not None
        ]
        if proposals:
            return max(proposals, key=lambda proposal: round(proposal.margin, 6))
    return None


def _rotations(arm: Arm, kind: Orientation, centre: Array) -> Iterator[Array | None]:
    """Yield orientations ``(3, 3)`` of the tool to try; None: any."""
    if kind == "free":
        yield None
    elif kind == "own":
        target = Poses(np.eye(3)[..., None], centre[:, None])
        reached = inverse_kinematics(arm, target, starts=_STARTS, oriented=False)
        converged = np.flatnonzero(reached.converged[0])
        if converged.size:
            margins = np.min(_margins(arm, reached.q[:, 0, converged]), axis=0)
            best = reached.q[:, 0, converged[int(np.argmax(np.round(margins, 6)))]]
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
    """Return the plane whose five poses are reached with the joints furthest from their limits, in one configuration.

    P1 is solved from several starts, the outer poses from each of P1's solutions, so that the arm does not change its
    configuration between them. All planes together have eight outer points; each plane has four.
    """
    tool_rotation = np.eye(3) if rotation is None else rotation
    first = inverse_kinematics(
        arm, _with_orientation(centre[:, None], tool_rotation), starts=_STARTS, oriented=rotation is not None
    )
    starts = first.q[:, 0, first.converged[0]]
    if starts.shape[1] == 0:
        return None
    inner = corners(centre, (1.0 - 2.0 * FROM_CORNER) * edge)
    outer = inverse_kinematics(
        arm, _with_orientation(inner, tool_rotation), starts=starts, oriented=rotation is not None
    )
    best_proposal: Proposal | None = None
    for candidate in PLANES if plane is None else (plane,):
        points = five_points(centre, edge, candidate)
        squared_distances = np.sum(np.square(points[:, 1:, None] - inner[:, None, :]), axis=0)
        corner_indices = np.argmin(squared_distances, axis=1)
        solved = np.flatnonzero(outer.converged[corner_indices].all(axis=0))
        if solved.size == 0:
            continue
        joints = np.concatenate((starts[:, None, solved], outer.q[:, corner_indices][:, :, solved]), axis=1)
        margins = np.round(np.min(_margins(arm, joints), axis=(0, 1)), 6)
        best_index = int(np.argmax(margins))
        if margins[best_index] >= _LIMIT_CLEARANCE and (
            best_proposal is None or margins[best_index] > best_proposal.margin
        ):
            q = np.round(joints[..., best_index], _DECIMALS) + 0.0
            target_poses = arm.chain.forward(q) if rotation is None else _with_orientation(points, rotation)
            best_proposal = Proposal(edge, centre, candidate, kind, target_poses, q, float(margins[best_index]), ())
    return best_proposal


def _with_orientation(points: Array, rotation: Array) -> Poses:
    """Return poses at points ``(3, N)`` with one orientation ``(3, 3)``."""
    return Poses(np.repeat(rotation[..., None], points.shape[1], axis=2), points)


def _margins(arm: Arm, q: Array) -> Array:
    """Return distances of joints ``(J, …)`` from the nearer limit, as a fraction of the range; 0.5 without limits."""
    low, high = (ends.reshape(-1, *(1,) * (q.ndim - 1)) for ends in joint_ranges(arm))
    bounded = np.isfinite(low)
    span = np.where(bounded, high - low, 1.0)
    result: Array = np.where(bounded, np.minimum(q - low, high - q) / np.where(span > 0.0, span, 1.0), 0.5)
    return result
