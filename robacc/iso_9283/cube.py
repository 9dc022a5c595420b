"""Test cube of ISO 9283:1998, clause 6.8, and its five poses.

The cube's edges are parallel to the base frame's axes. P1 is its centre; P2 to P5 lie on the diagonals through the
four corners of a plane tilted by 45 degrees, 10 % of the diagonal's length (8 to 12 %) from its ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.geometry import Array

Plane = Literal["x+", "x-", "y+", "y-"]
PLANES: tuple[Plane, ...] = ("x+", "x-", "y+", "y-")
"""Four planes of the standard, named by the horizontal direction in which each rises at 45 degrees."""
PREFERRED_EDGES = (1.0, 0.63, 0.4, 0.25)
"""Edge lengths that the standard prefers, m, the largest first."""
FROM_CORNER = 0.10
"""Distance of P2 to P5 from the corners, as a fraction of the diagonal's length."""
TOLERANCE = 0.02
"""Tolerance of the standard on :data:`FROM_CORNER`."""
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
        preferred = (edge for edge in PREFERRED_EDGES if abs(0.5 - self.half / edge - FROM_CORNER) <= TOLERANCE)
        return next(preferred, self.half / (0.5 - FROM_CORNER))

    @property
    def from_corner(self) -> float:
        """Distance of the outer points from the corners of that cube, as a fraction of the diagonal."""
        return 0.5 - self.half / self.edge


def five_points(centre: Array, edge: float, plane: Plane) -> Array:
    """Return P1 to P5 ``(3, 5)``, m, in the axes of the cube; P2 and P4 are opposite, as are P3 and P5."""
    level_axis = 1 if plane[0] == "x" else 0
    tilted_axis = 1 - level_axis
    rise = 1.0 if plane[1] == "+" else -1.0
    outer = np.zeros((3, 4))
    outer[level_axis] = (-1.0, 1.0, 1.0, -1.0)
    outer[2] = (-1.0, -1.0, 1.0, 1.0)
    outer[tilted_axis] = rise * outer[2]
    points = np.concatenate((np.zeros((3, 1)), (0.5 - FROM_CORNER) * edge * outer), axis=1)
    result: Array = np.asarray(centre, dtype=float)[:, None] + points
    return result


def corners(centre: Array, edge: float) -> Array:
    """Return the cube's corners ``(3, 8)``, m."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float).T
    result: Array = np.asarray(centre, dtype=float)[:, None] + 0.5 * edge * signs
    return result


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
    if np.ptp(radii) > _SIZE_TOLERANCE * mean_radius or np.max(gaps[np.arange(4), opposite]) > _SIZE_TOLERANCE:
        return "no pose is the centre of the other four"
    # A corner's coordinate along each axis is 1/sqrt(3) of its distance from the centre.
    half = mean_radius / math.sqrt(3.0)
    if np.max(np.abs(np.abs(outer) - half)) <= _SIZE_TOLERANCE * mean_radius:
        return CubeFit(centre, float(half), _rising_plane(outer))
    neighbour = next(i for i in range(1, 4) if i != opposite[0])
    sides = sorted(float(np.linalg.norm(outer[:, 0] - outer[:, i])) for i in (neighbour, opposite[neighbour]))
    if abs(sides[1] / sides[0] - math.sqrt(2.0)) <= 2.0 * _SIZE_TOLERANCE:
        return "the poses lie in a diagonal plane of a cube whose edges are not parallel to the axes of the base"
    size = f"{sides[0] * 1e3:.0f} mm by {sides[1] * 1e3:.0f} mm"
    return f"the outer poses form a rectangle of {size}; a diagonal plane has sides of 1 : √2"


def _rising_plane(outer: Array) -> Plane | None:
    for axis, name in ((0, "x"), (1, "y")):
        products = np.sign(outer[axis] * outer[2])
        if np.all(products == products[0]):
            return next(plane for plane in PLANES if plane == f"{name}{'+' if products[0] > 0 else '-'}")
    return None
