"""Centres of cubes that an arm reaches, in front of it, the most used place first."""

from __future__ import annotations

import math

import numpy as np

from robacc.geometry import Array, Poses
from robacc.iso_9283.cube import corners
from robacc.robots.arm import Arm
from robacc.robots.inverse_kinematics import inverse_kinematics, joint_ranges, spread_configurations

_SAMPLES = 2048
_RADII, _HEIGHTS = 12, 16
"""Grid of places in front of the arm that are tried as the cube's centre."""
_CENTRE_BATCH = 24
"""Number of centres whose corners are solved together, the most used place first."""
_MAX_CENTRES = 4
"""Number of centres with all corners in reach whose orientations are tried."""
_GRID = 0.01
"""Step of the centres' coordinates (a tenth of the edge for small cubes), m."""
_AXIS_ANGLE = math.radians(30.0)
"""A front direction closer to an axis of the base than this is set to that axis."""
_COLUMN_CLEARANCE = 0.1
"""Clearance between cube and first joint's axis, as a fraction of the reach."""


def reachable_centres(arm: Arm, edge: float) -> Array:
    """Return centres ``(3, C)`` of the first few cubes all of whose corners the target reaches, the most used first."""
    centres = _centres(arm, edge)
    reachable: list[Array] = []
    for start in range(0, centres.shape[1], _CENTRE_BATCH):
        batch = centres[:, start : start + _CENTRE_BATCH]
        points = np.concatenate([corners(centre, edge) for centre in batch.T], axis=1)
        targets = Poses(np.broadcast_to(np.eye(3)[..., None], (3, 3, points.shape[1])), points)
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
    azimuth = along if abs(azimuth - along) < _AXIS_ANGLE else azimuth
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
        # The column of a turning arm takes space: the cube's near side stays clear of its axis.
        nearest = 0.5 * edge * float(np.abs(front).sum()) + _COLUMN_CLEARANCE * forward.max()
        order = order[radius.ravel()[order] >= nearest]
    grid = min(_GRID, 0.1 * edge)
    places = np.vstack((front[:, None] * radius.ravel()[order], height.ravel()[order]))
    result: Array = np.round(places / grid) * grid
    return result
