"""Tree of a URDF's links, and the choice of one serial chain in it."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robacc.errors import InputError, Problem, UsageError
from robacc.robots.urdf_xml import UrdfDocument

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_NUMBERED = re.compile(r"(?i)[qja]_?([1-9]\d?)")
"""Column of a joint without a name: q1, J1, A1."""
_UNIT = re.compile(r"(_(m|mm|um|rad|deg|mrad)|\s*[\[(].*[\])])$")
"""Unit at the end of a column's name."""
_FLANGES = ("tool0", "flange")
"""Links that stand for the flange (ROS REP 199), the preferred first."""


@dataclass(frozen=True, slots=True)
class UrdfTree:
    """Links and joints of the file, as yourdfpy reads them."""

    document: UrdfDocument
    robot: Any
    """yourdfpy's Robot."""
    parent_joint: dict[str, Any]
    """Joint that moves each link."""
    elements: dict[str, Element]
    """Element of each joint, by name."""

    @property
    def roots(self) -> list[str]:
        """Links that no joint moves."""
        return [link.name for link in self.robot.links if link.name not in self.parent_joint]

    def leaves(self, base: str) -> list[str]:
        """Return the links behind ``base`` that no joint follows."""
        parents = {joint.parent for joint in self.robot.joints}
        leaves = [link.name for link in self.robot.links if link.name not in parents]
        return [name for name in leaves if name != base and self.path(base, name) is not None]

    def path(self, base: str, tip: str) -> list[Any] | None:
        """Return the joints from ``base`` to ``tip`` in order; None where ``tip`` is not behind ``base``."""
        path: list[Any] = []
        link = tip
        while link != base:
            joint = self.parent_joint.get(link)
            # The length guards against a circle of joints, which has no root to stop at.
            if joint is None or len(path) > len(self.parent_joint):
                return None
            path.append(joint)
            link = joint.parent
        return path[::-1]


def choose_chain(
    tree: UrdfTree, base_link: str | None, tip_link: str | None, joint_columns: Callable[[], Sequence[str]] | None
) -> tuple[str, str]:
    """Return the first and the last link of the chain.

    A chain's tip that the caller does not name follows from the columns of the pose file. Where they name joints, the
    chain ends behind the last of them. Where they number joints, ``q1 … qN``, the longest chain ends behind its
    N-th joint. Fixed joints behind it belong to the chain up to the flange, but a gripper does not.
    """
    columns = [_UNIT.sub("", name.strip()) for name in joint_columns()] if joint_columns and tip_link is None else []
    named = _named_joints(tree, columns)
    base = _choose_base(tree, base_link)
    if named:
        last = _last_joint(tree, base, named)
        if last is not None:
            path = tree.path(base, last.child) or []
            first = next(joint for joint in path if joint.name in named)
            unnamed = any(_moves(joint) for joint in path[: path.index(first)])
            # Joints in front that the file does not have, such as wheels, only place the base.
            return first.parent if unnamed and base_link is None else base, _flange(tree, last.child)
    count = len({match[1] for name in columns if (match := _NUMBERED.fullmatch(name))})
    if count and not named and (tip := _tip_of_length(tree, base, count)) is not None:
        return base, tip
    return base, _choose_tip(tree, base, tip_link)


def _moves(joint: Any) -> bool:
    return joint.type != "fixed" and joint.mimic is None


def _named_joints(tree: UrdfTree, columns: Sequence[str]) -> frozenset[str]:
    """Return the moving joints that a column is named after."""
    return frozenset(joint.name for joint in tree.robot.joints if _moves(joint)) & frozenset(columns)


def _last_joint(tree: UrdfTree, base: str, named: frozenset[str]) -> Any | None:
    """Return the joint of ``named`` with all others before it; None where they are on several branches."""
    for joint in tree.robot.joints:
        path = tree.path(base, joint.child) if joint.name in named else None
        if path and named <= {before.name for before in path}:
            return joint
    return None


def _tip_of_length(tree: UrdfTree, base: str, count: int) -> str | None:
    """Return the flange of the chain of ``count`` moving joints; None unless the longest chains begin with only one."""
    paths = [tree.path(base, leaf) or [] for leaf in tree.leaves(base)]
    moving = [[joint for joint in path if _moves(joint)] for path in paths]
    longest = max(map(len, moving), default=0)
    if longest <= count:
        return None
    links = {joints[count - 1].child for joints in moving if len(joints) == longest}
    return _flange(tree, links.pop()) if len(links) == 1 else None


def _flange(tree: UrdfTree, link: str) -> str:
    """Return the link behind the fixed joints that follow ``link``, in front of a gripper and of a fork."""
    while True:
        joints = [joint for joint in tree.robot.joints if joint.parent == link]
        fixed = [joint.child for joint in joints if joint.type == "fixed" and not _carries_motion(tree, joint.child)]
        named = [name for name in _FLANGES if name in fixed]
        if named:
            return named[0]
        if len(fixed) != 1 or len(joints) > 1:
            return link
        link = fixed[0]


def _carries_motion(tree: UrdfTree, link: str) -> bool:
    """Return whether a joint directly on the link moves."""
    return any(joint.parent == link and joint.type != "fixed" for joint in tree.robot.joints)


def _choose_base(tree: UrdfTree, base_link: str | None) -> str:
    if base_link is not None:
        return _known_link(tree, base_link, "`base_link`")
    roots = tree.roots
    if len(roots) == 1:
        return roots[0]
    if not roots:
        message = (
            "the joints form a loop: there is no link to start from" if tree.parent_joint else "the file has no links"
        )
        raise InputError(Problem(message, tree.document.file))
    message = f"{len(roots)} links could be the base: {_listing(roots)}"
    raise InputError(Problem(message, tree.document.file, fix="choose one with `base_link`"))


def _choose_tip(tree: UrdfTree, base: str, tip_link: str | None) -> str:
    if tip_link is not None:
        return _known_link(tree, tip_link, "`tip_link`")
    ranks: dict[tuple[int, int], list[str]] = {}
    for leaf in tree.leaves(base):
        path = tree.path(base, leaf) or []
        moving = sum(joint.type != "fixed" and joint.mimic is None for joint in path)
        ranks.setdefault((moving, len(path)), []).append(leaf)
    if not ranks:
        raise InputError(Problem(f"no joint follows the link {base!r}", tree.document.file))
    best = ranks[max(ranks)]
    if len(best) == 1:
        return best[0]
    leaves = [leaf for rank in sorted(ranks, reverse=True) for leaf in ranks[rank]]
    message = f"{len(best)} chains are equally long; the tree ends at {_listing(leaves)}"
    raise InputError(Problem(message, tree.document.file, fix="choose one with `tip_link`"))


def _known_link(tree: UrdfTree, name: str, parameter: str) -> str:
    names = [link.name for link in tree.robot.links]
    if name in names:
        return name
    suggestions = difflib.get_close_matches(name, names, 3, 0.5) or names
    raise UsageError(f"{parameter}: {tree.document.file} has no link {name!r}; it has {_listing(suggestions)}")


def _listing(names: Sequence[str]) -> str:
    text = ", ".join(names[:12])
    return f"{text} and {len(names) - 12} more" if len(names) > 12 else text
