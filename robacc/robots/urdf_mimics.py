"""Resolve the mimic joints of a URDF's chain, and of its branches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element

from robacc.robots.description import BranchJoint, Joint, Mimic
from robacc.robots.urdf_xml import UrdfDocument


def resolve_mimics(
    document: UrdfDocument, elements: Mapping[str, Element], all_joints: Sequence[Any], joints: Sequence[Joint]
) -> list[Joint]:
    """Return the chain's joints with every mimic made to follow, directly, a joint variable of the chain.

    Args:
        document: The URDF, which collects the problems.
        elements: Each joint's element, by its name.
        all_joints: Joints of the file, as yourdfpy reads them.
        joints: Joints of the chain.
    """
    return _with_outside_masters(_direct_mimics(document, elements, all_joints, joints))


def resolve_branch_mimics(
    document: UrdfDocument,
    elements: Mapping[str, Element],
    all_joints: Sequence[Any],
    joints: Sequence[Joint],
    branches: Sequence[BranchJoint],
) -> tuple[BranchJoint, ...]:
    """Return the joints outside the chain with every mimic made to follow, directly, a variable of chain or branches.

    A joint that a joint of the chain follows moves as that one tells: ``q_m = (q_a - o_a) / m_a``. A joint that follows
    one which stands at zero keeps a variable.

    Args:
        document: The URDF, which collects the problems.
        elements: Each joint's element, by its name.
        all_joints: Joints of the file, as yourdfpy reads them.
        joints: Joints of the chain, whose mimics are not resolved.
        branches: Joints outside the chain, whose mimics are not resolved.
    """
    inside = {joint.name for joint in joints}
    leaders: dict[str, tuple[str, Mimic]] = {}
    for joint in _direct_mimics(document, elements, all_joints, joints):
        if joint.mimic is not None and joint.mimic.master not in inside and joint.mimic.multiplier != 0.0:
            leaders.setdefault(joint.mimic.master, (joint.name, joint.mimic))
    beside = _direct_mimics(document, elements, all_joints, [branch.joint for branch in branches])
    known = inside | {joint.name for joint in beside}
    result = []
    for branch, joint in zip(branches, beside, strict=True):
        rule = joint.mimic or Mimic(joint.name)
        if rule.master in leaders:
            leader, first = leaders[rule.master]
            ratio = rule.multiplier / first.multiplier
            joint = replace(joint, mimic=Mimic(leader, ratio, rule.offset - ratio * first.offset))
        elif rule.master not in known:
            joint = replace(joint, mimic=None)
        result.append(replace(branch, joint=joint))
    return tuple(result)


def _direct_mimics(
    document: UrdfDocument, elements: Mapping[str, Element], all_joints: Sequence[Any], joints: Sequence[Joint]
) -> list[Joint]:
    """Return the joints with every mimic made to follow, directly, a joint that moves by itself.

    That joint may be outside the chain.
    """
    by_name = {joint.name: joint for joint in all_joints}
    resolved = []
    for joint in joints:
        mimic, visited = joint.mimic, {joint.name}
        while mimic is not None:
            master = by_name.get(mimic.master)
            problem = None
            if master is None:
                problem = "which is not a joint of this file"
            elif master.type == "fixed":
                problem = "which is fixed"
            elif master.name in visited:
                problem = "which follows it in turn: none of these joints moves by itself"
            if problem or master is None:
                document.report(elements[joint.name], joint.name, f"follows {mimic.master!r}, {problem}")
                break
            visited.add(master.name)
            if master.mimic is None:
                joint = replace(joint, mimic=mimic)
                break
            # q = m1 (m2 q' + o2) + o1
            inner = master.mimic
            offset = mimic.multiplier * inner.offset + mimic.offset
            mimic = Mimic(inner.joint, mimic.multiplier * inner.multiplier, offset)
        resolved.append(joint)
    return resolved


def _with_outside_masters(joints: Sequence[Joint]) -> list[Joint]:
    """Return the joints, with a variable for each joint outside the chain that some of them follow.

    The first follower becomes the variable, and any other follows it:
    ``q_b = m_b / m_a (q_a - o_a) + o_b``.
    """
    inside = {joint.name for joint in joints}
    leaders: dict[str, tuple[str, Mimic]] = {}
    result = []
    for joint in joints:
        rule = joint.mimic
        if rule is None or rule.master in inside:
            result.append(joint)
        elif rule.multiplier == 0.0:
            result.append(replace(joint, mimic=None))
        elif rule.master not in leaders:
            leaders[rule.master] = joint.name, rule
            result.append(replace(joint, mimic=None, outside=rule))
        else:
            leader, first = leaders[rule.master]
            ratio = rule.multiplier / first.multiplier
            result.append(replace(joint, mimic=Mimic(leader, ratio, rule.offset - ratio * first.offset)))
    return result
