"""Constraints of a measurement campaign: which poses the robot may take and the instrument can see.

Places are in the robot's base frame, in m. A box or half-space to stay out of holds for the target and for every joint
and corner of the arm that moves; a box to stay in holds for the target.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.planning.collisions import LinkCollisions
from robacc.quantities import parse_quantity

_AXES = "xyz"
_INEQUALITY = re.compile(r"(.+?)(<=|>=)(.+)")
_PRODUCT = re.compile(r"([+-]?)\s*(\d*\.?\d*)\s*\*?\s*([xyz])")


@dataclass(frozen=True, slots=True)
class SafetyBox:
    """Axis-parallel box, m; a side may be infinite."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    text: str

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return which points ``(3, ...)`` lie inside."""
        inside: NDArray[np.bool_] = np.all(
            [(row >= low) & (row <= high) for row, low, high in zip(points, self.low, self.high, strict=True)],
            axis=0,
        )
        return inside


@dataclass(frozen=True, slots=True)
class HalfSpace:
    """Half-space to stay in: normal . p <= offset, m."""

    normal: tuple[float, float, float]
    offset: float
    text: str

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return which points ``(3, ...)`` lie inside."""
        inside: NDArray[np.bool_] = np.einsum("i,i...->...", np.array(self.normal), points) <= self.offset
        return inside


@dataclass(frozen=True, slots=True)
class Sight:
    """Line of sight from the instrument to the target."""

    position: tuple[float, float, float]
    """Instrument, m."""
    axis: tuple[float, float, float] | None = None
    """Direction in the target's frame that the reflector faces; None: the reflector is turned by hand, or is a ball."""
    cone: float = np.radians(30.0)
    """Half angle of the reflector's acceptance, rad."""
    distance: tuple[float, float] = (0.0, np.inf)
    """Nearest and farthest distance, m."""


@dataclass(frozen=True, slots=True)
class Constraints:
    """Everything that decides whether a pose is feasible."""

    margin: float = 0.02
    """Share of a joint's range to keep from each limit."""
    inside: SafetyBox | None = None
    outside: tuple[SafetyBox, ...] = ()
    half_spaces: tuple[HalfSpace, ...] = ()
    min_height: float | None = None
    """m above the base's origin, along z."""
    sight: Sight | None = None
    max_condition: float | None = None
    """Largest condition number of the joints' Jacobian."""
    collisions: LinkCollisions | None = None
    """Test of the links' shapes; None: links have no thickness."""


def parse_box(text: str, name: str) -> SafetyBox:
    """Parse ``x=0.2:0.9,y=-500mm:500mm,z=0.1:``; a missing side or axis has no limit.

    Raises:
        UsageError: The text is not that; ``name`` is the parameter's name.
    """
    low, high = [-np.inf] * 3, [np.inf] * 3
    for part in text.split(","):
        axis, equals, ends = part.strip().partition("=")
        sides = ends.split(":")
        if not equals or axis.strip() not in tuple(_AXES) or len(sides) != 2:
            raise UsageError(f"`{name}`: expected a box such as x=0.2:0.9,z=100mm:, found {text!r}")
        index = _AXES.index(axis.strip())
        for side, values in zip(sides, (low, high), strict=True):
            if side.strip():
                values[index] = length(side, name)
        if low[index] >= high[index]:
            raise UsageError(f"`{name}`: {axis.strip()} ends before it begins in {text!r}")
    return SafetyBox((low[0], low[1], low[2]), (high[0], high[1], high[2]), text)


def parse_half_space(text: str, name: str) -> HalfSpace:
    """Parse ``z>=0.1``, ``x<=800mm`` or ``0.7x+0.7y<=1.2``: the side to stay on.

    Raises:
        UsageError: The text is not that.
    """
    match = _INEQUALITY.fullmatch(text.replace(" ", ""))
    products = list(_PRODUCT.finditer(match[1])) if match else []
    if match is None or not products or "".join(product[0] for product in products) != match[1]:
        raise UsageError(f"`{name}`: expected a side to stay on such as z>=0.1 or 0.7x+0.7y<=1.2, found {text!r}")
    side = 1.0 if match[2] == "<=" else -1.0
    normal = [0.0, 0.0, 0.0]
    for product in products:
        factor = float(product[2] or 1.0) * (-1.0 if product[1] == "-" else 1.0)
        normal[_AXES.index(product[3])] += side * factor
    size = float(np.linalg.norm(normal))
    if size == 0.0:
        raise UsageError(f"`{name}`: {text!r} names no direction")
    offset = side * length(match[3], name) / size
    return HalfSpace((normal[0] / size, normal[1] / size, normal[2] / size), offset, text)


def parse_vector(text: str | Sequence[float], name: str) -> tuple[float, float, float]:
    """Parse three lengths ``2.5,0,1.2`` or ``2500mm,0,1200mm``, m.

    Raises:
        UsageError: The text is not that.
    """
    parts = text.split(",") if isinstance(text, str) else list(text)
    if len(parts) != 3:
        raise UsageError(f"`{name}`: expected three numbers such as 2.5,0,1.2, found {text!r}")
    x, y, z = (length(part, name) for part in parts)
    return x, y, z


def parse_distance(text: str | Sequence[float], name: str) -> tuple[float, float]:
    """Parse nearest and farthest distance ``0.5:15``, m.

    Raises:
        UsageError: The text is not that, or the farthest is not beyond the nearest.
    """
    parts = text.split(":") if isinstance(text, str) else list(text)
    if len(parts) != 2:
        raise UsageError(f"`{name}`: expected nearest and farthest such as 0.5:15, found {text!r}")
    near, far = (length(part, name) for part in parts)
    if not 0 <= near < far:
        raise UsageError(f"`{name}`: the farthest distance must be beyond the nearest, found {text!r}")
    return near, far


def length(text: str | float, name: str) -> float:
    """Return a coordinate in m: a bare number is in m.

    Raises:
        UsageError: It is no length.
    """
    quantity = parse_quantity(text) if isinstance(text, str) else (float(text), None)
    if quantity is None or quantity[1] == "angle" or not np.isfinite(quantity[0]):
        raise UsageError(f"`{name}`: expected a length in m or with a unit (m, mm, um), found {text!r}")
    return quantity[0]
