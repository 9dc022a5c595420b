"""Masses of a URDF's links outside the chain: grippers, hoses' clamps, cameras, a second arm."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from robacc.geometry import Array, rpy_from_rotation
from robacc.robots.description import ORIGIN_PARAMETERS, BranchJoint, Joint, Vector
from robacc.robots.urdf_chain import UrdfTree

_LEAST_MOMENT = 0.05
"""kg m: a joint that moves mass by less, such as a gripper's finger, counts as fixed; a gear of 1e-5 rad/(N m) yields
by 5 um at 1 m to it."""
_MOVING = ("revolute", "continuous", "prismatic")


def with_branches(
    tree: UrdfTree, base: str, joints: Sequence[Joint], read_joint: Callable[[Any], Joint]
) -> tuple[list[Joint], tuple[BranchJoint, ...]]:
    """Return the joints of a chain, each link with the mass that it carries rigidly, and the joints of branches.

    A joint outside the chain that moves little mass stands at zero, as if it were fixed. Joints that follow others are
    not resolved yet (:mod:`.urdf_mimics`). A chain without any mass stays without.

    Args:
        tree: The URDF's tree.
        base: First link of the chain.
        joints: Joints of the chain.
        read_joint: Returns the description of a joint of the tree.
    """
    if not any(joint.mass for joint in joints):
        return list(joints), ()
    beside = _Beside(tree, frozenset(joint.link for joint in joints))
    loaded = []
    branches = list(_branches(beside, beside.carried(base), None, read_joint))
    for joint in joints:
        carried = list(beside.carried(joint.link))
        loaded.append(_loaded(joint, carried))
        branches += _branches(beside, carried, joint.name, read_joint)
    return loaded, tuple(branches)


class _Link(NamedTuple):
    """Link that another carries rigidly, or the joint of a link that moves against it."""

    frame: Array
    """``(4, 4)`` of the link, or of the joint at zero, in the frame of the carrier."""
    mass: float
    com: Array
    joint: Any | None
    """Joint that moves the link; None for a link that is carried rigidly."""


@dataclass(frozen=True)
class _Beside:
    """Links of a tree beside a chain."""

    tree: UrdfTree
    on_chain: frozenset[str | None]

    @cached_property
    def joints(self) -> dict[str, list[Any]]:
        """Joints off the chain, by the link that carries them."""
        joints: dict[str, list[Any]] = {}
        for joint in self.tree.robot.joints:
            if joint.child not in self.on_chain:
                joints.setdefault(joint.parent, []).append(joint)
        return joints

    @cached_property
    def inertials(self) -> dict[str, tuple[float, Array]]:
        """Mass and centre of mass of each link that has them, in its own frame."""
        return {
            link.name: (float(link.inertial.mass), _transform(link.inertial.origin)[:3, 3])
            for link in self.tree.robot.links
            if link.inertial is not None and link.inertial.mass is not None
        }

    def inertial(self, link: str) -> tuple[float, Array]:
        """Return mass and centre of mass of a link, in its own frame; zeros if it has none."""
        return self.inertials.get(link, (0.0, np.zeros(3)))

    def carried(self, link: str | None, frame: Array | None = None) -> Iterator[_Link]:
        """Yield the links that ``link`` carries rigidly, and those that a joint moves against it."""
        for joint in self.joints.get(link or "", ()):
            child = _transform(joint.origin) if frame is None else frame @ _transform(joint.origin)
            if joint.type in _MOVING and self._movable_moment(joint) > _LEAST_MOMENT:
                yield _Link(child, 0.0, np.zeros(3), joint)
            else:
                yield _Link(child, *self.inertial(joint.child), None)
                yield from self.carried(joint.child, child)

    def _movable_moment(self, joint: Any) -> float:
        """Return the most by which a joint can move the first moment of the mass behind it, kg m."""
        behind = list(self._behind(joint.child, 0.0))
        if joint.type != "prismatic":
            return sum(mass * distance for mass, distance in behind)
        limit = joint.limit
        travel = 0.0 if limit is None else abs((limit.upper or 0.0) - (limit.lower or 0.0))
        return travel * sum(mass for mass, _ in behind)

    def _behind(self, link: str, distance: float) -> Iterator[tuple[float, float]]:
        """Yield mass, and greatest distance from a joint at ``distance`` from ``link``, of the links from it on."""
        mass, com = self.inertial(link)
        yield mass, distance + float(np.linalg.norm(com))
        for joint in self.joints.get(link, ()):
            yield from self._behind(joint.child, distance + float(np.linalg.norm(_transform(joint.origin)[:3, 3])))


def _loaded(joint: Joint, carried: Sequence[_Link]) -> Joint:
    """Return the joint with the masses of its link and of the links on it as a single mass."""
    rigid = [link for link in carried if link.joint is None and link.mass > 0]
    if not rigid:
        return joint
    link_mass, link_com = (joint.mass or 0.0, np.array(joint.com or (0.0, 0.0, 0.0)))
    total = link_mass + sum(link.mass for link in rigid)
    moments = [link.mass * (link.frame @ np.append(link.com, 1.0))[:3] for link in rigid]
    moment = link_mass * link_com + sum(moments, np.zeros(3))
    return dataclasses.replace(joint, mass=total, com=cast(Vector, tuple(float(value) for value in moment / total)))


def _branches(
    beside: _Beside, carried: Iterator[_Link] | Sequence[_Link], parent: str | None, read_joint: Callable[[Any], Joint]
) -> Iterator[BranchJoint]:
    """Yield the moving joints among links that ``parent`` carries, and those behind them."""
    for link in carried:
        if link.joint is None:
            continue
        joint = dataclasses.replace(read_joint(link.joint), limits=None)
        if not np.array_equal(link.frame, _transform(link.joint.origin)):
            joint = dataclasses.replace(joint, parameters=_origin(link.frame))
        behind = list(beside.carried(joint.link))
        yield BranchJoint(_loaded(joint, behind), parent)
        yield from _branches(beside, behind, joint.name, read_joint)


def _origin(frame: Array) -> dict[str, float]:
    """Return the parameters of a joint's origin ``(4, 4)``."""
    values = [float(value) for value in (*frame[:3, 3], *rpy_from_rotation(frame[:3, :3]))]
    return dict.fromkeys(ORIGIN_PARAMETERS, 0.0) | dict(zip(ORIGIN_PARAMETERS, values, strict=False))


def _transform(origin: Any) -> Array:
    """Return an origin of yourdfpy ``(4, 4)``; the identity for None."""
    return np.eye(4) if origin is None else np.asarray(origin, dtype=float)
