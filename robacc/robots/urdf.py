"""Read a URDF into a robot: one serial chain, its mimic joints, and the masses of links outside it."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array, Poses
from robacc.robots.description import (
    LENGTH_PARAMETERS,
    MAX_JOINTS,
    MAX_LENGTH,
    ORIGIN_PARAMETERS,
    TRAVEL_IN_MM,
    TURN,
    BranchJoint,
    Frame,
    Joint,
    JointType,
    Mimic,
    Robot,
    Vector,
    finite_limits,
    limits_likely_degrees,
    unit_axis,
)
from robacc.robots.urdf_tree import UrdfJoint, UrdfTree, numbers, read_tree

# Choose one serial chain in the tree of links.

_NUMBERED = re.compile(r"(?i)[qja]_?([1-9]\d?)")
"""Column of a joint without a name: q1, J1, A1."""
_UNIT = re.compile(r"(_(m|mm|um|rad|deg|mrad)|\s*[\[(].*[\])])$")
"""Unit at the end of a column's name."""
_FLANGES = ("tool0", "flange")
"""Links that stand for the flange (ROS REP 199), the preferred first."""


def _choose_chain(
    tree: UrdfTree, base_link: str | None, tip_link: str | None, joint_columns: Callable[[], Sequence[str]] | None
) -> tuple[str, str]:
    """Return the first and the last link of the chain.

    A chain's tip that the caller does not name follows from the columns of the pose file. Where they name joints, the
    chain ends behind the last of them. Where they number joints, ``q1 … qN``, the longest chain ends behind its
    N-th joint. Fixed joints behind it belong to the chain up to the flange, but a gripper does not.
    """
    columns = [_UNIT.sub("", name.strip()) for name in joint_columns()] if joint_columns and tip_link is None else []
    base = _choose_base(tree, base_link)
    paths = tree.paths(base)
    named = {joint for joint in tree.joints if joint.moves and joint.name in columns}
    # The joint with all others before it; there is none where they are on several branches.
    last = next((joint for joint in tree.joints if joint in named and named <= {*paths.get(joint.child, ())}), None)
    if last is not None:
        moving = [joint for joint in paths[last.child] if joint.moves]
        first = next(joint for joint in moving if joint in named)
        # Joints in front that the file does not have, such as wheels, only place the base.
        return first.parent if moving[0] is not first and base_link is None else base, _flange(tree, last.child)
    leaves = {link: paths[link] for link in tree.links if link in paths and link != base and not tree.below[link]}
    count = len({match[1] for name in columns if (match := _NUMBERED.fullmatch(name))})
    if count and not named:
        moving_paths = [[joint for joint in path if joint.moves] for path in leaves.values()]
        longest = max(map(len, moving_paths), default=0)
        links = {path[count - 1].child for path in moving_paths if len(path) == longest > count}
        if len(links) == 1:
            return base, _flange(tree, links.pop())
    return base, _choose_tip(tree, base, tip_link, leaves)


def _flange(tree: UrdfTree, link: str) -> str:
    """Return the link behind the fixed joints that follow ``link``, in front of a gripper and of a fork."""
    while True:
        joints = tree.below[link]
        fixed = [
            joint.child
            for joint in joints
            if joint.type == "fixed" and all(behind.type == "fixed" for behind in tree.below[joint.child])
        ]
        named = [name for name in _FLANGES if name in fixed]
        if named:
            return named[0]
        if len(fixed) != 1 or len(joints) > 1:
            return link
        link = fixed[0]


def _choose_base(tree: UrdfTree, base_link: str | None) -> str:
    if base_link is not None:
        return _known_link(tree, base_link, "`base_link`")
    moved = {joint.child for joint in tree.joints}
    roots = [link for link in tree.links if link not in moved]
    if len(roots) == 1:
        return roots[0]
    message, fix = "the file has no links", None
    if roots:
        message, fix = f"{len(roots)} links could be the base: {_listing(roots)}", "choose one with `base_link`"
    elif moved:
        message = "the joints form a loop: there is no link to start from"
    raise InputError(Problem(message, tree.file, fix=fix))


def _choose_tip(tree: UrdfTree, base: str, tip_link: str | None, leaves: Mapping[str, Sequence[UrdfJoint]]) -> str:
    if tip_link is not None:
        return _known_link(tree, tip_link, "`tip_link`")
    if not leaves:
        raise InputError(Problem(f"no joint follows the link {base!r}", tree.file))
    ranks = {leaf: (sum(joint.moves for joint in path), len(path)) for leaf, path in leaves.items()}
    names = sorted(ranks, key=ranks.__getitem__, reverse=True)
    n_best = sum(rank == ranks[names[0]] for rank in ranks.values())
    if n_best == 1:
        return names[0]
    message = f"{n_best} chains are equally long; the tree ends at {_listing(names)}"
    raise InputError(Problem(message, tree.file, fix="choose one with `tip_link`"))


def _known_link(tree: UrdfTree, name: str, parameter: str) -> str:
    if name in tree.links:
        return name
    names = difflib.get_close_matches(name, tree.links, 3, 0.5) or list(tree.links)
    raise UsageError(f"{parameter}: {tree.file} has no link {name!r}; it has {_listing(names)}")


def _listing(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


# Joints of the chain, and their sizes: a URDF is in m and rad.

_TYPES: dict[str, JointType] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
_LENGTH_FIX = "a URDF's lengths are in m"
_ANGLE_FIX = "a URDF's angles are in rad"


def _read_joint(tree: UrdfTree, joint: UrdfJoint) -> Joint:
    element, kind = joint.element, _TYPES.get(joint.type)
    axis = unit_axis(numbers(element.find("axis"), "xyz", "1 0 0"))
    if kind is None:
        message = f"unknown joint type {joint.type!r}"
        if joint.type in ("floating", "planar"):
            message = f"a {joint.type} joint cannot be part of a serial chain"
        tree.report(element, joint.name, message, "choose a chain without it with `base_link` and `tip_link`")
    if axis is None and joint.type != "fixed":
        tree.report(element, joint.name, "the joint's axis is zero and has no direction")
    mass, com = _inertial(tree, joint.child)
    if mass is not None and mass < 0:
        tree.report(tree.links[joint.child], joint.child, f"the link's mass is negative ({mass:g} kg)")
    # Not through a rotation: near a pitch of 90 degrees the roll and yaw computed from it lose most of their digits.
    origin = [value for key in ("xyz", "rpy") for value in numbers(element.find("origin"), key)]
    return Joint(
        name=joint.name,
        type=kind or "fixed",
        parameters=dict(zip(ORIGIN_PARAMETERS, (*origin, 0.0), strict=True)),
        axis=axis if axis and joint.type != "fixed" else (0.0, 0.0, 1.0),
        limits=_read_limits(tree, joint) if joint.type in ("revolute", "prismatic") else None,
        is_continuous=joint.type == "continuous",
        mass=mass,
        com=None if mass is None else com,
        mimic=joint.mimic,
        link=joint.child,
    )


def _read_limits(tree: UrdfTree, joint: UrdfJoint) -> tuple[float, float] | None:
    limit = joint.element.find("limit")
    if limit is None or limit.attrib.keys().isdisjoint(("lower", "upper")):
        return None
    # Where one limit is missing, the format's default for it is zero.
    lower, upper = numbers(limit, "lower", "0") + numbers(limit, "upper", "0")
    if math.isinf(lower) and math.isinf(upper):
        return None
    limits, problem = finite_limits(joint.type, (lower, upper))
    fix: str | None = "make them infinite for a joint without limits"
    if math.isinf(lower) or math.isinf(upper):
        problem, fix = f"one limit is infinite, the other is not ({lower:g}, {upper:g})", None
    elif lower > upper:
        problem, fix = f"the lower limit {lower:g} is above the upper limit {upper:g}", None
    if problem is not None:
        tree.report(joint.element, joint.name, problem, fix)
    return limits


def _inertial(tree: UrdfTree, link: str) -> tuple[float | None, Vector]:
    """Return mass, None where it has none, and centre of mass of a link, in its own frame."""
    inertial = tree.links[link].find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    if inertial is None or mass is None:
        return None, (0.0, 0.0, 0.0)
    x, y, z = numbers(inertial.find("origin"), "xyz")
    return numbers(mass, "value", "0")[0], (x, y, z)


def _check_sizes(tree: UrdfTree, joints: Sequence[Joint]) -> None:
    """Report lengths and angles that are too large for an arm."""
    elements = {joint.name: joint.element for joint in tree.joints}
    for joint in joints:
        problems = []
        for name, value in joint.parameters.items():
            if name in LENGTH_PARAMETERS and abs(value) > MAX_LENGTH:
                problems.append((f"{name} of {value:g} m is too long for an arm", _LENGTH_FIX))
            elif name not in LENGTH_PARAMETERS and abs(value) > TURN:
                problems.append((f"{name} of {value:g} rad is more than a turn", _ANGLE_FIX))
        far = max(map(abs, joint.com or (0.0,)))
        if far > MAX_LENGTH:
            problems.append((f"the centre of mass of its link is {far:g} m away, too far for an arm", _LENGTH_FIX))
        longest = max(map(abs, joint.limits)) if joint.limits and joint.type == "prismatic" else 0.0
        if TRAVEL_IN_MM[0] < longest < TRAVEL_IN_MM[1]:
            problems.append((f"a travel of {longest:g} m is too long for an arm", _LENGTH_FIX))
        for message, fix in problems:
            tree.report(elements[joint.name], joint.name, message, fix)
    if limits_likely_degrees(joints):
        tree.report(None, "", "the limits of every joint are more than two turns", _ANGLE_FIX)


# Masses of links outside the chain: grippers, hoses' clamps, cameras, a second arm.

_LEAST_MOMENT = 0.05
"""kg m: a joint that moves mass by less, such as a gripper's finger, counts as fixed; a gear of 1e-5 rad/(N m) yields
by 5 um at 1 m to it."""
_MOVING = ("revolute", "continuous", "prismatic")


class _Carried(NamedTuple):
    """Link that another carries rigidly, or the joint of a link that moves against it."""

    frame: Poses
    """Frame of the link, or of the joint at zero, in the frame of the carrier."""
    mass: float
    com: Vector
    joint: UrdfJoint | None
    """Joint that moves the link; None for a link that is carried rigidly."""


def _with_branches(tree: UrdfTree, path: Sequence[UrdfJoint]) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints of a chain, each link with the mass that it carries rigidly, and the joints of branches.

    A joint outside the chain that moves little mass stands at zero, as if it were fixed. Joints that follow others are
    not resolved yet. A chain without any mass stays without.
    """
    joints = [_read_joint(tree, joint) for joint in path]
    if not any(joint.mass for joint in joints):
        return joints, []
    on_chain = {joint.child for joint in path}
    branches = list(_branches(tree, list(_carried(tree, path[0].parent, on_chain)), None))
    for i, joint in enumerate(joints):
        carried = list(_carried(tree, path[i].child, on_chain))
        joints[i] = _loaded(joint, carried)
        branches += _branches(tree, carried, joint.name)
    return joints, branches


def _origin(joint: UrdfJoint) -> Poses:
    origin = joint.element.find("origin")
    return Poses.from_xyz_rpy(np.array(numbers(origin, "xyz")), np.array(numbers(origin, "rpy")))


def _carried(tree: UrdfTree, link: str, on_chain: Iterable[str] = (), frame: Poses | None = None) -> Iterator[_Carried]:
    """Yield the links that ``link`` carries rigidly, and those that a joint moves against it."""
    for joint in tree.below[link]:
        if joint.child in on_chain:
            continue
        child = _origin(joint) if frame is None else frame @ _origin(joint)
        if joint.type in _MOVING and _movable_moment(tree, joint) > _LEAST_MOMENT:
            yield _Carried(child, 0.0, (0.0, 0.0, 0.0), joint)
        else:
            mass, com = _inertial(tree, joint.child)
            yield _Carried(child, mass or 0.0, com, None)
            yield from _carried(tree, joint.child, (), child)


def _movable_moment(tree: UrdfTree, joint: UrdfJoint) -> float:
    """Return the most by which a joint can move the first moment of the mass behind it, kg m."""
    behind = list(_behind(tree, joint.child, 0.0))
    if joint.type != "prismatic":
        return sum(mass * distance for mass, distance in behind)
    limit = joint.element.find("limit")
    travel = abs(numbers(limit, "upper", "0")[0] - numbers(limit, "lower", "0")[0])
    return travel * sum(mass for mass, _ in behind)


def _behind(tree: UrdfTree, link: str, distance: float) -> Iterator[tuple[float, float]]:
    """Yield mass, and greatest distance from a joint at ``distance`` from ``link``, of the links from it on."""
    mass, com = _inertial(tree, link)
    yield mass or 0.0, distance + math.hypot(*com)
    for joint in tree.below[link]:
        yield from _behind(tree, joint.child, distance + math.hypot(*numbers(joint.element.find("origin"), "xyz")))


def _loaded(joint: Joint, carried: Sequence[_Carried]) -> Joint:
    """Return the joint with the masses of its link and of the links on it as a single mass."""
    rigid = [link for link in carried if link.joint is None and link.mass > 0]
    if not rigid:
        return joint
    mass = joint.mass or 0.0
    total = mass + sum(link.mass for link in rigid)
    moment: Array = mass * np.array(joint.com or (0.0, 0.0, 0.0))
    moment = moment + sum(link.mass * (link.frame.rotation @ link.com + link.frame.translation) for link in rigid)
    return replace(joint, mass=total, com=cast(Vector, tuple((moment / total).tolist())))


def _branches(tree: UrdfTree, carried: Sequence[_Carried], parent: str | None) -> Iterator[BranchJoint]:
    """Yield the moving joints among links that ``parent`` carries, and those behind them."""
    for link in carried:
        if link.joint is None:
            continue
        joint = replace(_read_joint(tree, link.joint), limits=None)
        own = _origin(link.joint)
        if not (link.frame.rotation == own.rotation).all() or not (link.frame.translation == own.translation).all():
            frame = Frame.of(link.frame)
            joint = replace(joint, parameters=dict(zip(ORIGIN_PARAMETERS, (*frame.xyz, *frame.rpy, 0.0), strict=True)))
        behind = list(_carried(tree, link.joint.child))
        yield BranchJoint(_loaded(joint, behind), parent)
        yield from _branches(tree, behind, joint.name)


# Mimic joints of the chain, and of its branches.


def _resolve_mimics(
    tree: UrdfTree, joints: Sequence[Joint], branches: Sequence[BranchJoint]
) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints with every mimic made to follow, directly, a joint variable of the chain or of a branch.

    Of the joints of the chain that follow a joint outside of it, the first becomes the variable, and any other, in the
    chain or outside, follows it: ``q_b = m_b / m_a (q_a - o_a) + o_b``. A joint that follows one which stands at zero
    keeps a variable.
    """
    by_name = {joint.name: joint for joint in tree.joints}
    inside = {joint.name for joint in joints}
    known = inside | {branch.joint.name for branch in branches}
    chain = [_direct_mimic(tree, by_name, joint) for joint in joints]
    leaders: dict[str, tuple[str, Mimic]] = {}
    for joint in chain:
        if joint.mimic is not None and joint.mimic.master not in inside and joint.mimic.multiplier != 0.0:
            leaders.setdefault(joint.mimic.master, (joint.name, joint.mimic))

    def follower(joint: Joint, rule: Mimic) -> Joint:
        leader, first = leaders[rule.master]
        ratio = rule.multiplier / first.multiplier
        return replace(joint, mimic=Mimic(leader, ratio, rule.offset - ratio * first.offset))

    for i, joint in enumerate(chain):
        rule = joint.mimic
        if rule is None or rule.master in inside:
            continue
        if rule.multiplier == 0.0:
            chain[i] = replace(joint, mimic=None)
        elif leaders[rule.master][0] == joint.name:
            chain[i] = replace(joint, mimic=None, outside=rule)
        else:
            chain[i] = follower(joint, rule)
    beside = []
    for branch in branches:
        joint = _direct_mimic(tree, by_name, branch.joint)
        rule = joint.mimic or Mimic(joint.name)
        if rule.master in leaders:
            joint = follower(joint, rule)
        elif rule.master not in known:
            joint = replace(joint, mimic=None)
        beside.append(replace(branch, joint=joint))
    return chain, beside


def _direct_mimic(tree: UrdfTree, by_name: Mapping[str, UrdfJoint], joint: Joint) -> Joint:
    """Return the joint with its mimic made to follow, directly, a joint that moves by itself, in the chain or not."""
    mimic, visited = joint.mimic, {joint.name}
    while mimic is not None:
        master = by_name.get(mimic.master)
        if master is not None and master.type != "fixed" and master.name not in visited:
            if master.mimic is None:
                return replace(joint, mimic=mimic)
            visited.add(master.name)
            # q = m1 (m2 q' + o2) + o1
            ratio, inner = mimic.multiplier, master.mimic
            mimic = Mimic(inner.master, ratio * inner.multiplier, ratio * inner.offset + mimic.offset)
            continue
        problem = "which follows it in turn: none of these joints moves by itself"
        if master is None or master.type == "fixed":
            problem = "which is not a joint of this file" if master is None else "which is fixed"
        tree.report(by_name[joint.name].element, joint.name, f"follows {mimic.master!r}, {problem}")
        break
    return joint


def parse_urdf(
    text: str,
    file: str,
    base_link: str | None = None,
    tip_link: str | None = None,
    joint_columns: Callable[[], Sequence[str]] | None = None,
) -> Robot:
    """Return one serial chain of a URDF, without opening a mesh or any other file.

    Args:
        text: The URDF.
        file: Its name, for messages.
        base_link: Link that the chain starts at; default: the root.
        tip_link: Link that the chain ends at; default: the link that ``joint_columns`` imply, else the only leaf with
            the most moving joints before it, then with the most joints.
        joint_columns: Returns the names of a pose file's columns, which say where a chain without ``tip_link`` ends.

    A joint that follows a joint outside the chain becomes a joint variable, because nothing in the chain moves it.
    Masses of links outside the chain, such as a gripper's, count with the link of the chain that carries them; joints
    that move much of it, such as those of another arm, are branches.

    Raises:
        InputError: The URDF has a problem, its chain is not serial, or the choice of a chain is ambiguous.
        UsageError: ``base_link`` or ``tip_link`` is not a link of the URDF, or the tip is not behind the base.
    """
    tree = read_tree(text, file)
    base, tip = _choose_chain(tree, base_link, tip_link, joint_columns)
    path = tree.paths(base).get(tip)
    if not path:
        raise UsageError(f"{file}: link {tip!r} is not behind link {base!r}")
    if len(path) > MAX_JOINTS:
        message = f"there are {len(path)} joints from {base!r} to {tip!r}, expected at most {MAX_JOINTS}"
        raise InputError(Problem(message, file, fix="choose a shorter chain with `base_link` and `tip_link`"))
    joints, branches = _with_branches(tree, path)
    _check_sizes(tree, [*joints, *(branch.joint for branch in branches)])
    tree.finish()
    joints, branches = _resolve_mimics(tree, joints, branches)
    if not any(joint.is_variable for joint in joints):
        tree.report(None, "", f"no joint between {base!r} and {tip!r} moves", "choose a longer chain")
    tree.finish()
    return Robot(tree.name, "urdf", tuple(joints), base_link=base, tip_link=tip, branches=tuple(branches))
