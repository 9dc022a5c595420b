"""The standard's cube and its five poses: clause 6.8 of ISO 9283:1998.

The cube's edges are parallel to the base frame's axes. P1 is its centre; P2 to P5 stand on the diagonals through the
four corners of a plane that is tilted by 45 degrees, 10 % of the diagonal's length (8 to 12 %) from its ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.geometry import Array

Plane = Literal["x+", "x-", "y+", "y-"]
PLANES: tuple[Plane, ...] = ("x+", "x-", "y+", "y-")
"""The four planes of the standard, named by the horizontal direction in which each rises at 45 degrees."""
PREFERRED_EDGES = (1.0, 0.63, 0.4, 0.25)
"""m, the largest first."""
FROM_CORNER = 0.10
"""Of the diagonal's length."""
TOLERANCE = 0.02
"""The standard's on :data:`FROM_CORNER`."""
_ALIKE = 0.01
"""Sizes that differ by less than this part are equal: placing poses to a millimetre in 100 is no fault."""


@dataclass(frozen=True, slots=True)
class CubeFit:
    """How five points stand in the standard's cube."""

    centre: int
    """Which of the points is P1."""
    half: float
    """Half the side of the cube that has the four outer points as corners, m."""
    plane: Plane | None
    """None: a diagonal plane that stands upright, which is none of the standard's four."""

    @property
    def edge(self) -> float:
        """The preferred edge that puts the points 8 to 12 % from its corners, else that which puts them at 10 %, m."""
        fitting = (e for e in PREFERRED_EDGES if abs(0.5 - self.half / e - FROM_CORNER) <= TOLERANCE)
        return next(fitting, self.half / (0.5 - FROM_CORNER))

    @property
    def from_corner(self) -> float:
        """Distance of the outer points from the corners of that cube, as a part of the diagonal."""
        return 0.5 - self.half / self.edge


def five_points(centre: Array, edge: float, plane: Plane) -> Array:
    """P1 to P5 ``(3, 5)``, m, in the axes of the cube; P2 and P4 are opposite, as are P3 and P5."""
    along = 1 if plane[0] == "x" else 0
    tilted = 1 - along
    rise = 1.0 if plane[1] == "+" else -1.0
    outer = np.zeros((3, 4))
    outer[along] = (-1.0, 1.0, 1.0, -1.0)
    outer[2] = (-1.0, -1.0, 1.0, 1.0)
    outer[tilted] = rise * outer[2]
    points = np.concatenate((np.zeros((3, 1)), (0.5 - FROM_CORNER) * edge * outer), axis=1)
    result: Array = np.asarray(centre, dtype=float)[:, None] + points
    return result


def corners(centre: Array, edge: float) -> Array:
    """``(3, 8)`` the cube's corners, m."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float).T
    result: Array = np.asarray(centre, dtype=float)[:, None] + 0.5 * edge * signs
    return result


def fit_cube(points: Array) -> CubeFit | str:
    """Where five points ``(3, 5)``, m, in the axes of the base, stand in a cube; else what is wrong with them."""
    centre = int(np.argmin(np.sum(np.square(points - points.mean(axis=1, keepdims=True)), axis=0)))
    outer = np.delete(points, centre, axis=1) - points[:, [centre]]
    radius = np.sqrt(np.sum(np.square(outer), axis=0))
    size = float(radius.mean())
    if size == 0.0:
        return "the five poses are one"
    gap = np.sqrt(np.sum(np.square(outer[:, :, None] + outer[:, None, :]), axis=0)) / size
    opposite = np.argmin(gap, axis=1)
    if np.ptp(radius) > _ALIKE * size or np.max(gap[np.arange(4), opposite]) > _ALIKE:
        return "no pose is the centre of the other four"
    # Corners of a cube about its centre: with 1/sqrt(3) of their distance along each axis.
    half = size / math.sqrt(3.0)
    if np.max(np.abs(np.abs(outer) - half)) <= _ALIKE * size:
        return CubeFit(centre, float(half), _plane(outer))
    third = next(i for i in range(1, 4) if i != opposite[0])
    sides = sorted(float(np.linalg.norm(outer[:, 0] - outer[:, i])) for i in (third, opposite[third]))
    if abs(sides[1] / sides[0] - math.sqrt(2.0)) <= 2.0 * _ALIKE:
        return "the poses lie in a diagonal plane of a cube whose edges are not parallel to the axes of the base"
    return f"the outer poses are a rectangle of {sides[0] * 1e3:.0f} mm by {sides[1] * 1e3:.0f} mm, not of 1 : √2"


def _plane(outer: Array) -> Plane | None:
    for axis, name in ((0, "x"), (1, "y")):
        products = np.sign(outer[axis] * outer[2])
        if np.all(products == products[0]):
            return next(plane for plane in PLANES if plane == f"{name}{'+' if products[0] > 0 else '-'}")
    return None
