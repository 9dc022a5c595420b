"""Collision shapes of a URDF's links, each fixed to a link of the chain."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


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

    def resolved(fname: str) -> str:
        path_of_mesh = str(filename_handler_magic(fname, dir=os.path.dirname(path)))
        if not os.path.isfile(path_of_mesh):
            missing.append(fname)
        return path_of_mesh

    try:
        # The reader reports missing meshes in its log only; `resolved` collects them.
        with _silent("yourdfpy.urdf"):
            model = URDF.load(
                path,
                build_scene_graph=False,
                load_meshes=False,
                build_collision_scene_graph=True,
                load_collision_meshes=True,
                filename_handler=resolved,
            )
    except (ValueError, ImportError, OSError, KeyError, IndexError) as error:
        if not missing:
            fix = "export the meshes again as STL or OBJ, or leave out `collisions`"
            raise InputError(Problem(f"a collision mesh cannot be read: {error}", path, fix=fix)) from error
    _refuse_missing(missing, path)
    return model


@contextmanager
def _silent(name: str) -> Iterator[None]:
    """Keep a logger silent within a ``with`` block; its level is as before afterwards."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)


def _refuse_missing(missing: Sequence[str], path: str) -> None:
    """Raise InputError if a mesh of the URDF is missing."""
    if missing:
        names = list(dict.fromkeys(missing))
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        message = f"the collision mesh {names[0]}{more} is not there"
        raise InputError(Problem(message, path, fix="put the meshes beside the URDF, or leave out `collisions`"))


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
