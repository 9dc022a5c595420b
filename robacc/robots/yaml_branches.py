"""Read the joints outside the chain of a robot file: what else the arm's links carry and what moves it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from robacc.io.yaml_nodes import YamlSection
from robacc.robots.description import MAX_JOINTS, BranchJoint, Joint
from robacc.robots.yaml_joint import BASE_LINK, read_branch, resolve_mimics
from robacc.robots.yaml_units import Units


def read_branches(top: YamlSection, joints: Sequence[Joint], units: Units) -> tuple[BranchJoint, ...]:
    """Return the joints outside the chain of the key ``branches``; each parent must be ``base`` or an earlier joint.

    A joint may follow another one outside the chain, or a joint of the chain.
    """
    node, source = top.get("branches"), top.source
    if node is None:
        return ()
    names = {joint.name for joint in joints}
    branches, nodes = [], []
    for i, item in enumerate(source.items(node, "branches", "joints outside the chain")):
        path = f"branches[{i}]"
        branch = read_branch(source, item, i, units)
        if branch is None:
            continue
        name = branch.joint.name
        if name in names or name == BASE_LINK:
            source.report(item, f"{path}.name", f"{name!r} is already the name of a joint or of the base")
        if branch.parent is not None and branch.parent not in names:
            message = f"{branch.parent!r} is neither {BASE_LINK} nor a joint in front of it"
            source.report(item, f"{path}.parent", message, f"there are {', '.join(sorted(names))}")
        names.add(name)
        branches.append(branch)
        nodes.append(item)
    if len(branches) > MAX_JOINTS:
        source.report(node, "branches", f"found {len(branches)} joints, expected at most {MAX_JOINTS}")
    beside = resolve_mimics(source, [branch.joint for branch in branches], nodes, units, joints, "branches")
    if source.problems:
        return ()
    return tuple(replace(branch, joint=joint) for branch, joint in zip(branches, beside, strict=True))
