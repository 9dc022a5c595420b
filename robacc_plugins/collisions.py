"""Collisions of the links' shapes with each other and with the surroundings, by FCL.

Shapes of one body and of bodies that one joint connects are not checked, nor pairs that touch at nearly all poses:
they overlap by design. Shapes are surfaces of triangles: a shape wholly inside another does not touch it.
"""

from __future__ import annotations

import itertools
import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice
from robacc.geometry import Array, Poses
from robacc.robots.arm import Arm, Chain, low_discrepancy
from robacc.robots.description import Robot

# Collision shapes of a URDF's links, each fixed to a link of the chain.


@dataclass(frozen=True, slots=True)
class LinkShape:
    """Triangles of one link, in the frame of the link of the chain that carries it."""

    link: str
    vertices: Array
    """``(K, 3)`` m"""
    faces: NDArray[np.int64]
    """``(F, 3)`` numbers of vertices"""
    after: int
    """Number of motions of the chain before the frame that carries the shape."""
    body: int
    """Number of moving joints before it; shapes of one body do not move against each other."""


def read_link_shapes(path: str, robot: Robot) -> tuple[LinkShape, ...]:
    """Return the collision shapes of all links of a URDF, with other branches at zero.

    Args:
        path: URDF; meshes are searched for relative to it.
        robot: The chain that was read from it.

    Raises:
        InputError: A mesh is missing or cannot be read.
        UsageError: The URDF has no collision geometry.
    """
    model = _loaded(path)
    scene = model.collision_scene
    graph = scene.graph
    carriers = _carriers(robot)
    parents = {joint.child: joint.parent for joint in model.robot.joints}
    shapes: dict[str, list[tuple[Array, NDArray[np.int64]]]] = {}
    for node in graph.nodes_geometry:
        link = graph.transforms.parents[node]
        placed, name = graph.get(node, frame_from=link)
        mesh = scene.geometry[name]
        if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
            defect = "no triangles" if len(mesh.faces) == 0 else "vertices that are not finite"
            message = f"the collision mesh {name} of link {link} has {defect}"
            raise InputError(Problem(message, path, fix="export the mesh again, or leave out `collisions`"))
        carrier = _carrier(link, parents, carriers, robot.base_link)
        on_carrier = np.asarray(graph.get(link, frame_from=carrier)[0]) @ placed
        vertices = np.asarray(mesh.vertices) @ on_carrier[:3, :3].T + on_carrier[:3, 3]
        shapes.setdefault(link, []).append((vertices, np.asarray(mesh.faces, dtype=np.int64)))
    if not shapes:
        raise UsageError(f"`collisions`: {path} has no collision geometry; leave out `collisions`")
    result = []
    for link, parts in shapes.items():
        after, body = carriers[_carrier(link, parents, carriers, robot.base_link)]
        counts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
        faces = np.vstack([part + first for (_, part), first in zip(parts, counts[:-1], strict=True)])
        result.append(LinkShape(link, np.vstack([vertices for vertices, _ in parts]), faces, after, body))
    return tuple(sorted(result, key=lambda shape: shape.body))


def _loaded(path: str) -> Any:
    """Return yourdfpy's model with its collision meshes."""
    from yourdfpy import URDF, filename_handler_magic

    missing: list[str] = []
    folder = Path(os.path.abspath(path)).parent
    package = next((above for above in (folder, *folder.parents) if (above / "package.xml").is_file()), folder)

    def resolved(fname: str) -> str:
        mesh = Path(os.path.abspath(filename_handler_magic(fname, dir=os.path.dirname(path))))
        named = fname.partition("package://")[2].split("/")[0]
        homes = (package, *(above / named for above in folder.parents[:-1] if named.strip(".")))
        if not mesh.is_file():
            missing.append(f"{fname} is not there")
        elif not any(map(mesh.is_relative_to, homes)):
            missing.append(f"{fname} lies outside the folder or package of the URDF")
            return ""
        return str(mesh)

    # The reader reports missing meshes in its log only; `resolved` collects them.
    logger = logging.getLogger("yourdfpy.urdf")
    was_disabled, logger.disabled = logger.disabled, True
    try:
        model = URDF.load(
            path,
            build_scene_graph=False,
            load_meshes=False,
            build_collision_scene_graph=True,
            load_collision_meshes=True,
            filename_handler=resolved,
        )
    except Exception as error:  # whatever the readers of the many formats raise
        if not missing:
            fix = "export the meshes again as STL or OBJ, or leave out `collisions`"
            raise InputError(Problem(f"a collision mesh cannot be read: {error}", path, fix=fix)) from error
    finally:
        logger.disabled = was_disabled
    if missing:
        names = list(dict.fromkeys(missing))
        more = f", and {len(names) - 1} more" if len(names) > 1 else ""
        fix = "put the meshes beside the URDF, or leave out `collisions`"
        raise InputError(Problem(f"the collision mesh {names[0]}{more}", path, fix=fix))
    return model


def _carriers(robot: Robot) -> dict[str, tuple[int, int]]:
    """Return the numbers of motions and of moving joints before each link of the chain."""
    ends: dict[int, int] = {}
    for k, motion in enumerate(Arm.of(robot).chain.motions):
        if motion.owner >= 0:
            ends[motion.owner] = k + 1
    result = {str(robot.base_link): (0, 0)}
    after = body = 0
    for number, joint in enumerate(robot.joints):
        after = ends.get(number, after)
        body += joint.type != "fixed"
        result[str(joint.link)] = after, body
    return result


def _carrier(link: str, parents: dict[str, str], carriers: dict[str, tuple[int, int]], base: str | None) -> str:
    """Return the link of the chain that carries ``link``: the nearest before it, else the base."""
    while link not in carriers and link in parents:
        link = parents[link]
    return link if link in carriers else str(base)


_SAMPLED = 200
"""Poses over the joint ranges that show which pairs overlap by design."""
_ALWAYS = 0.95
"""Share of poses from which a pair counts as overlapping by design."""
_FAR = 100.0
"""m; stands for an infinite side of a box."""


@dataclass(frozen=True)
class ShapeCollisions:
    """Test of poses for collisions of an arm with shapes."""

    chain: Chain
    shapes: tuple[LinkShape, ...]
    checked: tuple[tuple[int, int], ...]
    """Numbers of the shapes that may touch."""
    first_body: int
    """First body that must keep clear of the surroundings: a turret that turns on the base does not count."""
    overlapping: tuple[tuple[str, str], ...] = ()
    """Pairs of links that touch at nearly all poses and are not checked."""

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Links of each pair that is checked."""
        return tuple((self.shapes[i].link, self.shapes[j].link) for i, j in self.checked)

    def self_collision(self, q: Array) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses ``(J, N)`` at which two links touch."""
        result: NDArray[np.bool_] = np.any(self.touching(q), axis=0)
        return result

    def touching(self, q: Array) -> NDArray[np.bool_]:
        """Return ``(P, N)`` which of the pairs touch at the poses ``(J, N)``."""
        return self._touching(q, self.checked)

    def in_box(self, q: Array, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
        """Return ``(N,)`` the poses at which a link is in a box of the base frame; a side may be infinite, m."""
        import fcl

        lower, upper = np.clip(low, -_FAR, _FAR), np.clip(high, -_FAR, _FAR)
        box = fcl.CollisionObject(fcl.Box(*(upper - lower)), fcl.Transform(np.eye(3), 0.5 * (lower + upper)))
        number = len(self.shapes)
        pairs = [(i, number) for i, shape in enumerate(self.shapes) if shape.body >= self.first_body]
        result: NDArray[np.bool_] = np.any(self._touching(q, pairs, box), axis=0)
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

    def _touching(self, q: Array, pairs: Sequence[tuple[int, int]], *obstacles: Any) -> NDArray[np.bool_]:
        """Return ``(P, N)`` which pairs of shapes, and of the obstacles after them, touch at poses ``(J, N)``."""
        import fcl

        frames = self._frames(q)
        objects = [*self._objects, *obstacles]
        result = np.zeros((len(pairs), q.shape[1]), dtype=bool)
        for i in range(q.shape[1]):
            for shape, placed in zip(self.shapes, objects, strict=False):
                frame = frames[shape.after]
                turn = np.ascontiguousarray(frame.rotation[:, :, i])
                placed.setTransform(fcl.Transform(turn, frame.translation[:, i]))
            for k, (first, second) in enumerate(pairs):
                contacts = fcl.collide(objects[first], objects[second], fcl.CollisionRequest(), fcl.CollisionResult())
                result[k, i] = contacts > 0
        return result

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


def link_collisions(path: str, robot: Robot) -> ShapeCollisions:
    """Return the test for the shapes of a URDF, without the pairs that overlap by design.

    Args:
        path: URDF; meshes are searched for relative to it.
        robot: The chain that was read from it.

    Raises:
        InputError: A mesh is missing or cannot be read.
        UsageError: The URDF has no collision geometry, or the extra ``collision`` is not installed.
    """
    shapes = read_link_shapes(path, robot)
    if find_spec("fcl") is None:
        raise UsageError(f"`collisions` needs python-fcl, which is not installed; run {install_advice('collision')}")
    pairs = [
        (i, j) for i, j in itertools.combinations(range(len(shapes)), 2) if abs(shapes[i].body - shapes[j].body) > 1
    ]
    first = 2 if robot.variables[0].type == "revolute" else 1
    every_pair = ShapeCollisions(Arm.of(robot).chain, shapes, tuple(pairs), first)
    # Spread over the limits; over one turn, or one metre, of a joint without limits.
    low, high = np.array(
        [joint.limits or ((-np.pi, np.pi) if joint.type == "revolute" else (0.0, 1.0)) for joint in robot.variables]
    ).T[..., None]
    shift = np.random.default_rng([0, 7]).uniform(size=(len(low), 1))
    spread: Array = low + (high - low) * ((low_discrepancy(len(low), _SAMPLED) + shift) % 1.0)
    is_always = every_pair.touching(spread).mean(axis=1) > _ALWAYS
    return ShapeCollisions(
        every_pair.chain,
        shapes,
        tuple(pair for pair, always in zip(pairs, is_always, strict=True) if not always),
        first,
        tuple((shapes[i].link, shapes[j].link) for (i, j), always in zip(pairs, is_always, strict=True) if always),
    )
