"""Masses of a URDF's links beside the chain: grippers, hoses' clamps, cameras, a second arm."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from robacc.geometry import Array
from robacc.robots.description import Joint, Vector
from robacc.robots.urdf_chain import UrdfTree


def with_branches(tree: UrdfTree, joints: Sequence[Joint]) -> list[Joint]:
    """Return the joints of a chain, each link with the mass of the branches that hang on it.

    Joints of a branch stand at zero. A chain without any mass stays without.
    """
    if not any(joint.mass for joint in joints):
        return list(joints)
    on_chain = {joint.link for joint in joints}
    return [_loaded(tree, joint, on_chain) for joint in joints]


def _loaded(tree: UrdfTree, joint: Joint, on_chain: set[str | None]) -> Joint:
    """Return the joint with the masses of its link and of the branches on it as a single mass."""
    branches = _carried(tree, joint.link, np.eye(4), on_chain)
    if not branches:
        return joint
    link_mass, link_com = (joint.mass or 0.0, np.array(joint.com or (0.0, 0.0, 0.0)))
    total = link_mass + sum(mass for mass, _ in branches)
    moment = link_mass * link_com + sum((mass * com for mass, com in branches), np.zeros(3))
    return dataclasses.replace(joint, mass=total, com=cast(Vector, tuple(float(value) for value in moment / total)))


def _carried(tree: UrdfTree, link: str | None, frame: Array, on_chain: set[str | None]) -> list[tuple[float, Array]]:
    """Return mass and centre of mass, in the frame of the first link, of each link behind ``link`` off the chain."""
    carried = []
    for joint in tree.robot.joints:
        if joint.parent != link or joint.child in on_chain:
            continue
        child = frame if joint.origin is None else frame @ np.asarray(joint.origin, dtype=float)
        mass, com = _inertial(tree, joint.child)
        if mass > 0:
            carried.append((mass, (child @ np.append(com, 1.0))[:3]))
        carried += _carried(tree, joint.child, child, on_chain | {joint.child})
    return carried


def _inertial(tree: UrdfTree, name: str) -> tuple[float, Array]:
    """Return mass and centre of mass of a link in its own frame; 0 if it has none."""
    link: Any = next((link for link in tree.robot.links if link.name == name), None)
    if link is None or link.inertial is None or link.inertial.mass is None:
        return 0.0, np.zeros(3)
    origin = link.inertial.origin
    return float(link.inertial.mass), np.zeros(3) if origin is None else np.asarray(origin, dtype=float)[:3, 3]
