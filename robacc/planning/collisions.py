"""Collisions of the links' shapes with each other and with the surroundings, by FCL.

Shapes of one body and of bodies that one joint connects are not checked, nor pairs that touch at nearly all poses:
they overlap by design. Shapes are surfaces of triangles: a shape wholly inside another does not touch it. Spheres
around the shapes make most exact tests unnecessary.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.chain import Chain
from robacc.errors import UsageError, install_advice
from robacc.geometry import Array, Poses
from robacc.planning.link_shapes import LinkShape
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.robots.summary import low_discrepancy

SELF_COLLISION = "self-collision"
"""Reason of poses that are excluded because two links touch."""
_SAMPLED = 200
"""Poses over the joint ranges that show which pairs overlap by design."""
_ALWAYS = 0.95
"""Share of poses from which a pair counts as overlapping by design."""
_FAR = 100.0
"""m; stands for an infinite side of a box."""


@dataclass(frozen=True)
class LinkCollisions:
    """Test of poses for collisions of an arm with shapes."""

    chain: Chain
    shapes: tuple[LinkShape, ...]
    pairs: tuple[tuple[int, int], ...]
    """Numbers of the shapes that may touch."""
    first_body: int
    """First body that must keep clear of the surroundings: a turret that turns on the base does not count."""
    overlapping: tuple[tuple[str, str], ...] = ()
    """Pairs of links that touch at nearly all poses and are not checked."""

    def self_collision(self, q: Array) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses ``(J, N)`` at which two links touch."""
        result = np.zeros(q.shape[1], dtype=bool)
        frames = self._frames(q)
        for pair in self.pairs:
            at = np.flatnonzero(~result & self._near(pair, frames))
            result[at] = self._touching(pair, frames, at)
        return result

    def touching_shares(self, q: Array) -> Array:
        """Return ``(P,)`` share of the poses ``(J, N)`` at which each pair touches."""
        frames, at = self._frames(q), np.arange(q.shape[1])
        return np.array([np.mean(self._touching(pair, frames, at)) for pair in self.pairs])

    def in_box(self, q: Array, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which a link is in a box of the base frame; a side may be infinite, m."""
        import fcl

        lower, upper = np.clip(low, -_FAR, _FAR), np.clip(high, -_FAR, _FAR)
        placed = fcl.Transform(np.eye(3), 0.5 * (lower + upper))
        obstacle = fcl.CollisionObject(fcl.Box(*(upper - lower)), placed)
        result = np.zeros(q.shape[1], dtype=bool)
        frames = self._frames(q)
        for number, shape in enumerate(self.shapes):
            if shape.body >= self.first_body:
                centre = self._centre(number, frames)
                outside = np.maximum(np.maximum(lower[:, None] - centre, centre - upper[:, None]), 0.0)
                near = np.linalg.norm(outside, axis=0) <= self._spheres[number][1]
                for i in np.flatnonzero(near & ~result):
                    self._place(number, frames, int(i))
                    result[i] = self._touch(self._objects[number], obstacle)
        return result

    def beyond(self, q: Array, direction: Sequence[float], offset: float) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which a link leaves the half-space direction . p <= offset, m."""
        result = np.zeros(q.shape[1], dtype=bool)
        frames, normal = self._frames(q), np.array(direction)
        for shape in self.shapes:
            if shape.body >= self.first_body:
                frame = frames[shape.after]
                in_link = np.einsum("i,ijn->jn", normal, frame.rotation)
                farthest = np.max(shape.vertices @ in_link, axis=0)
                result |= farthest + normal @ frame.translation > offset
        return result

    def _frames(self, q: Array) -> dict[int, Poses]:
        """Return the frames of N poses in the base frame after each number of motions that carries a shape."""
        counts = sorted({shape.after for shape in self.shapes})
        n = q.shape[1]
        swept = self.chain.sweep(self.chain.scalars(q), n, (), counts).frames
        size = (3, n)
        return {
            count: Poses(np.broadcast_to(frame.rotation, (3, *size)), np.broadcast_to(frame.translation, size))
            for count, frame in zip(counts, swept, strict=True)
        }

    @cached_property
    def _spheres(self) -> list[tuple[Array, float]]:
        """Centre and radius of a sphere around each shape."""
        spheres = []
        for shape in self.shapes:
            centre = 0.5 * (shape.vertices.min(axis=0) + shape.vertices.max(axis=0))
            spheres.append((centre, float(np.linalg.norm(shape.vertices - centre, axis=1).max())))
        return spheres

    @cached_property
    def _objects(self) -> list[Any]:
        """FCL's object of each shape."""
        import fcl

        objects = []
        for shape in self.shapes:
            mesh = fcl.BVHModel()
            mesh.beginModel(len(shape.faces), len(shape.vertices))
            mesh.addSubModel(shape.vertices, shape.faces)
            mesh.endModel()
            objects.append(fcl.CollisionObject(mesh, fcl.Transform()))
        return objects

    def _centre(self, number: int, frames: dict[int, Poses]) -> Array:
        """Return ``(3, N)`` the centre of a shape's sphere, base frame, m."""
        frame = frames[self.shapes[number].after]
        result: Array = np.einsum("ijn,j->in", frame.rotation, self._spheres[number][0]) + frame.translation
        return result

    def _near(self, pair: tuple[int, int], frames: dict[int, Poses]) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which the spheres of two shapes touch."""
        first, second = (self._centre(number, frames) for number in pair)
        reach = self._spheres[pair[0]][1] + self._spheres[pair[1]][1]
        near: NDArray[np.bool_] = np.linalg.norm(first - second, axis=0) <= reach
        return near

    def _touching(self, pair: tuple[int, int], frames: dict[int, Poses], at: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which of the poses ``at`` have two shapes that touch."""
        result = np.zeros(at.size, dtype=bool)
        for place, i in enumerate(at.tolist()):
            for number in pair:
                self._place(number, frames, i)
            result[place] = self._touch(*(self._objects[number] for number in pair))
        return result

    def _place(self, number: int, frames: dict[int, Poses], i: int) -> None:
        """Move a shape's object to pose ``i``."""
        import fcl

        frame = frames[self.shapes[number].after]
        turn = np.ascontiguousarray(frame.rotation[:, :, i])
        self._objects[number].setTransform(fcl.Transform(turn, frame.translation[:, i]))

    @staticmethod
    def _touch(first: Any, second: Any) -> bool:
        """Return whether two objects of FCL touch."""
        import fcl

        return bool(fcl.collide(first, second, fcl.CollisionRequest(), fcl.CollisionResult()))


def link_collisions(robot: Robot, shapes: Sequence[LinkShape]) -> LinkCollisions:
    """Return the test for a robot and its shapes, without the pairs that overlap by design.

    Raises:
        UsageError: The extra ``collision`` is not installed.
    """
    if find_spec("fcl") is None:
        raise UsageError(f"`collisions` needs python-fcl, which is not installed; run {install_advice('collision')}")
    shapes = tuple(shapes)
    pairs = [
        (i, j) for i, j in itertools.combinations(range(len(shapes)), 2) if abs(shapes[i].body - shapes[j].body) > 1
    ]
    first = 2 if robot.variables[0].type == "revolute" else 1
    every_pair = LinkCollisions(Arm.of(robot).chain, shapes, tuple(pairs), first)
    is_always = every_pair.touching_shares(_spread_joints(robot)) > _ALWAYS
    return LinkCollisions(
        every_pair.chain,
        shapes,
        tuple(pair for pair, always in zip(pairs, is_always, strict=True) if not always),
        first,
        tuple((shapes[i].link, shapes[j].link) for (i, j), always in zip(pairs, is_always, strict=True) if always),
    )


def _spread_joints(robot: Robot) -> Array:
    """Return joint variables ``(J, n)`` spread over the limits; one turn, or one metre, for a joint without limits."""
    low, high = np.array(
        [joint.limits or ((-np.pi, np.pi) if joint.type == "revolute" else (0.0, 1.0)) for joint in robot.variables]
    ).T[..., None]
    shift = np.random.default_rng([0, 7]).uniform(size=(len(low), 1))
    result: Array = low + (high - low) * ((low_discrepancy(len(low), _SAMPLED) + shift) % 1.0)
    return result
