"""Errors that turn with the instrument's line of sight: base class of the effects of its searched place."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE
from robacc.effects.base import Effect, Part, Term, commanded, setting
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

Place = tuple[float, float, float]
FARTHEST = 12.0
"""Largest distance, m, from which an arm is measured. Seen from farther away, an angle's error is a scale along an
axis, and a drift of the scale is one of the base."""


@dataclass(frozen=True)
class LineOfSight(Effect):
    """Shifts of the measured point along directions that the line of sight decides.

    The poses rarely state where the instrument stands, so a trace searches for it. The directions are those at the
    commanded pose of the registered arm: an error of the direction of 1 mrad changes a shift by a thousandth.
    """

    place: Place = setting((0.0, 0.0, 0.0), key="instrument", unit="length", written=True, last=True)
    """Instrument's place in the measuring frame, m."""

    @abc.abstractmethod
    def forms(self) -> Iterator[LineOfSight]:
        """Yield every form, each at this place."""

    @property
    @abc.abstractmethod
    def labels(self) -> tuple[tuple[str, str, float], ...]:
        """Label, unit and usual size of each coefficient."""

    @abc.abstractmethod
    def shifts(self, position: Array, rotation: Array, places: Array) -> Array:
        """Return ``(P, Q, 3, N)`` shift of the measured point for each of the Q coefficients at 1.

        Args:
            position: ``(3, N)`` targets in the measuring frame, m.
            rotation: ``(3, 3, N)`` orientation of the tool.
            places: ``(P, 3)`` places of the instrument.
        """

    def at(self, place: Place) -> LineOfSight:
        """Return the same form at another place."""
        return dataclasses.replace(self, place=place)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the coefficients, each of which moves the base along x, y and z of the measuring frame."""
        position, rotation = lines_of_sight(arm, data, self.name)
        shifts = self.shifts(position, rotation, np.array([self.place]))[0]
        motions = [arm.chain.index(BASE, label) for label in "xyz"]
        return tuple(
            Term(
                f"{self.name}.{label}",
                unit,
                typical,
                tuple(Part(motion, shift[i]) for i, motion in enumerate(motions)),
            )
            for (label, unit, typical), shift in zip(self.labels, shifts, strict=True)
        )


def lines_of_sight(arm: Arm, data: Measurements, effect: str) -> tuple[Array, Array]:
    """Return ``(3, N)`` targets and ``(3, 3, N)`` orientations of the tool at the commanded poses."""
    poses = arm.chain.poses(arm.chain.scalars(commanded(data, effect)), data.n)
    position = np.broadcast_to(poses.translation, (3, data.n))
    return position, np.broadcast_to(poses.rotation, (3, 3, data.n))


def beams(position: Array, places: Array) -> tuple[Array, Array]:
    """Return ``(P, 3, N)`` unit vectors from the places to the targets, and ``(P, N)`` distances."""
    offset = position - places[:, :, None]
    distance = np.maximum(np.sqrt(np.sum(np.square(offset), axis=1)), 1e-9)
    return offset / distance[:, None], distance


def perpendicular(vector: Array, beam: Array) -> Array:
    """Return ``(P, 3, N)`` unit vectors along ``vector`` ``(3, N)`` perpendicular to the beams."""
    across = vector - beam * np.sum(vector * beam, axis=1, keepdims=True)
    length = np.sqrt(np.sum(np.square(across), axis=1, keepdims=True))
    result: Array = across / np.maximum(length, 1e-9)
    return result


def first_places(position: Array) -> Array:
    """Return ``(P, 3)`` places about the targets where a search begins: the origin if it is outside them, and a grid.

    The grid has twelve directions about the vertical at the targets' height and 30 degrees above, at 1.6 and 3.2 times
    the targets' reach.
    """
    centre = position.mean(axis=1)
    reach = float(np.sqrt(np.max(np.sum(np.square(position - centre[:, None]), axis=0), initial=0.0)))
    azimuth, elevation, distance = np.meshgrid(
        np.arange(12) * np.pi / 6, (0.0, np.pi / 6), (1.6 * reach, 3.2 * reach), indexing="ij"
    )
    grid = centre + spherical(azimuth.ravel(), elevation.ravel(), distance.ravel())
    origin_is_outside = float(np.sqrt(centre @ centre)) > 1.2 * reach
    return np.concatenate((np.zeros((1, 3)), grid)) if origin_is_outside else grid


def spherical(azimuth: Array, elevation: Array, distance: Array) -> Array:
    """Return ``(P, 3)`` vectors of these directions and lengths."""
    flat = distance * np.cos(elevation)
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)), axis=1)


def neighbours(place: Array, centre: Array, step: float) -> Array:
    """Return ``(27, 3)`` places about ``place`` that differ by ``step`` in azimuth, elevation and log distance.

    None is farther than :data:`FARTHEST` from the centre, unless ``place`` is.
    """
    offset = place - centre
    distance = float(np.sqrt(offset @ offset))
    azimuth = math.atan2(offset[1], offset[0])
    elevation = math.asin(max(-1.0, min(1.0, offset[2] / max(distance, 1e-9))))
    steps = np.array((-step, 0.0, step))
    turned, raised, scaled = (part.ravel() for part in np.meshgrid(steps, steps, steps, indexing="ij"))
    raised = np.clip(elevation + raised, -1.5, 1.5)
    distances = np.minimum(distance * np.exp(scaled), max(distance, FARTHEST))
    return centre + spherical(azimuth + turned, raised, distances)
