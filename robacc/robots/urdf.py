"""URDF, read into a robot: one serial chain of its links, with the masses of links outside it."""

import difflib
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import cast
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from robacc.errors import InputError, Problem, listing, refuse
from robacc.geometry import Array, Poses
from robacc.io.files import ProblemLog
from robacc.robots.description import (
    LENGTH_PARAMETERS,
    MAX_JOINTS,
    MAX_LENGTH,
    ORIGIN_PARAMETERS,
    TRAVEL_IN_MM,
    TURN,
    ZERO,
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

# Links and joints of a URDF: its XML read safely, each number checked, each problem with its line.

_ELEMENTS: Mapping[str, tuple[str, ...]] = {
    "": ("robot",),
    "robot": ("link", "joint"),
    "link": ("inertial",),
    "inertial": ("origin", "mass"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
}
"""Elements read below each element; meshes, colours, transmissions and simulator data do not affect the chain."""
_NAMES: Mapping[str, tuple[str, ...]] = {
    "link": ("name",),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint",),
}
"""Attributes that an element must have."""
_NUMBERS: Mapping[str, Mapping[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "limit": {"lower": 1, "upper": 1},
    "mimic": {"multiplier": 1, "offset": 1},
}
"""Count of numbers in each numeric attribute."""
_OTHER_MODELS = {"sdf": "an SDF model", "mujoco": "a MuJoCo model", "COLLADA": "a mesh", "robot_model": "not a URDF"}

_Link = str | None
"""Name of a link, as a :class:`Joint` has it; the links of a URDF all have one."""


def _numbers(element: Element | None, attribute: str, default: str = "0 0 0") -> list[float]:
    """Return the numbers of an attribute that was checked, or of its default."""
    return [float(part) for part in (default if element is None else element.get(attribute, default)).split()]


class _Tree:
    """Tree of links and joints, with every name and number checked."""

    def __init__(self, text: str, file: str) -> None:
        """Read a URDF.

        Raises:
            InputError: The text is not well-formed XML, is not a URDF, is xacro, has wrong names or numbers, or two
                joints move one link.
        """
        self.log, (self.root, self.lines) = ProblemLog(file), _parsed(text, file)
        _check(self)
        self.log.raise_if_any()
        self.links: dict[_Link, Element] = {element.get("name", ""): element for element in self.root.iter("link")}
        self.elements = {element.get("name", ""): element for element in self.root.iter("joint")}
        movers: dict[_Link, str] = {}
        for name, element in self.elements.items():
            for role in ("parent", "child"):
                if (link := _link_of(element, role)) not in self.links:
                    self.report(element, name, f"its {role} link {link!r} does not exist")
            if movers.setdefault(link, name) != name:
                self.report(element, name, f"moves the link {link!r}, as {movers[link]!r} does: not a serial chain")
        self.log.raise_if_any()
        self.joints = {name: _read_joint(self, element) for name, element in self.elements.items()}
        """Joints by name; the type of one that no chain can have is as written, see :func:`_check_joints`."""
        self.below: dict[_Link, list[Joint]] = {name: [] for name in self.links}
        """Joints on each link, by its name."""
        for name, joint in self.joints.items():
            self.below[_link_of(self.elements[name], "parent")].append(joint)

    def report(self, element: Element | None, name: str, message: str, fix: str | None = None) -> None:
        """Add a problem of the joint or link ``name``."""
        self.log.add(message, None if element is None else self.lines[element], name or None, fix)

    def paths(self, base: _Link) -> dict[_Link, list[Joint]]:
        """Return the joints from ``base`` to each link behind it, by the link's name."""
        paths: dict[_Link, list[Joint]] = {base: []}
        open_ = [base]
        for link in open_:
            # A circle of joints comes back to the base.
            new = {joint.link: [*paths[link], joint] for joint in self.below[link] if joint.link not in paths}
            paths |= new
            open_ += new
        return paths


def _link_of(element: Element, role: str) -> str:
    """Return the name of the parent or the child link of a joint."""
    link = element.find(role)
    return "" if link is None else link.get("link", "")


def _parsed(text: str, file: str) -> tuple[Element, dict[Element, int]]:
    """Return the root of the elements that are read, and the 1-based line of each one's opening tag.

    A document type is an error before anything is expanded: a URDF has none, and entities can exhaust the memory or
    read other files.
    """
    parser, builder = expat.ParserCreate(), TreeBuilder()
    lines: dict[Element, int] = {}
    selected: list[tuple[str, ...] | None] = [_ELEMENTS[""]]
    # Elements read below each open element; None below one that is not read itself.

    def fail(message: str, fix: str | None = None) -> None:
        raise InputError(Problem(message, file, parser.CurrentLineNumber, fix=fix))

    def doctype(name: str, *_: object) -> None:
        fail(f"a document type (<!DOCTYPE {name}>) is not allowed in a URDF", "remove it and its entities")

    def start(tag: str, attributes: dict[str, str]) -> None:
        is_read = tag in (selected[-1] or ())
        has_formula = is_read and any("${" in value or "$(" in value for value in attributes.values())
        if tag.startswith("xacro:") or has_formula:
            fail("this is xacro, not URDF", "run xacro first: xacro robot.xacro > robot.urdf")
        if len(selected) == 1 and not is_read:
            fail(
                f"the root element is <{tag}>, so this is {_OTHER_MODELS.get(tag, 'not a URDF')}; a URDF's root is "
                "<robot>"
            )
        selected.append(_ELEMENTS.get(tag, ()) if is_read else None)
        if is_read:
            lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    def end(tag: str) -> None:
        if selected.pop() is not None:
            builder.end(tag)

    parser.StartDoctypeDeclHandler, parser.StartElementHandler, parser.EndElementHandler = doctype, start, end
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise InputError(Problem(f"not well-formed XML: {reason}", file, error.lineno)) from None
    return builder.close(), lines


def _check(tree: _Tree) -> None:
    """Report wrong names and numbers, and names that stand twice."""
    if not (robot_name := tree.root.get("name", "robot")).isprintable():
        tree.report(tree.root, "", f"<robot name>: expected a name, found {robot_name!r}")
    first_lines: dict[tuple[str, str], int] = {}
    for owner in tree.root:
        name = owner.get("name", "")
        line = first_lines.setdefault((owner.tag, name), tree.lines[owner])
        if name and line != tree.lines[owner]:
            tree.report(owner, name, f"there is already a {owner.tag} {name!r} in line {line}")
        for element in owner.iter():
            for attribute in _NAMES.get(element.tag, ()):
                value = element.get(attribute, "")
                if not value.strip():
                    tree.report(element, name, f"<{element.tag}> needs the attribute {attribute!r}")
                elif not value.isprintable():
                    tree.report(element, name, f"<{element.tag} {attribute}>: expected a name, found {value!r}")
            for attribute, count in _NUMBERS.get(element.tag, {}).items():
                text = element.get(attribute, " ".join("0" * count))
                if not _are_numbers(text, count, infinite=element.tag == "limit"):
                    expected = f"expected {'a number' if count == 1 else f'{count} numbers'}, found {text[:60]!r}"
                    tree.report(element, name, f"<{element.tag} {attribute}>: {expected}")
        for tag in ("parent", "child") if owner.tag == "joint" else ():
            if owner.find(tag) is None:
                tree.report(owner, name, f"the joint has no <{tag}>")


def _are_numbers(text: str, count: int, *, infinite: bool) -> bool:
    """Return whether a text is so many finite numbers; an ``infinite`` limit means no limit."""
    try:
        # float() also accepts 1_000 and digits of other scripts, which no other reader of URDF does.
        values = [float(part) for part in text.split()] if text.isascii() and "_" not in text else []
    except ValueError:
        return False
    return len(values) == count and all(math.isfinite(value) or (infinite and math.isinf(value)) for value in values)


# Choose one serial chain in the tree of links.

_UNIT = re.compile(r"(_(m|mm|um|rad|deg|mrad)|\s*[\[(].*[\])])$")
"""Unit at the end of a column's name."""
_FLANGES = ("tool0", "flange")
"""Links that stand for the flange (ROS REP 199), the preferred first."""
_GRIPPER = re.compile(r"(?i)(grip|finger|jaw|knuckle|claw)(?!.*ro(ll|t))")
"""Name of a joint that closes a gripper, but not of one that turns it."""


def _moving(path: Sequence[Joint]) -> list[Joint]:
    """Return the joints that move by themselves."""
    return [joint for joint in path if joint.type != "fixed" and joint.mimic is None]


def _choose_chain(
    tree: _Tree, base_link: str | None, tip_link: str | None, joint_columns: Callable[[], Sequence[str]] | None
) -> tuple[_Link, _Link]:
    """Return the first and the last link of the chain.

    A chain's tip that the caller does not name follows from the columns of the pose file. Where they name joints, the
    chain ends behind the last of them that moves no gripper. Where they number joints, ``q1 … qN``, the longest chain
    ends behind its N-th joint. Fixed joints behind it belong to the chain up to the flange, but a gripper does not.
    """
    columns = [_UNIT.sub("", name.strip()) for name in joint_columns()] if joint_columns and tip_link is None else []
    moved = {joint.link for joint in tree.joints.values()}
    roots = (
        [_known_link(tree, base_link, "`base_link`")]
        if base_link
        else [link for link in tree.links if link not in moved]
    )
    several, loop = f"{len(roots)} links could be the base", "the joints form a loop: there is no link to start from"
    refuse(
        (roots[1:], Problem(f"{several}: {listing(roots, 12)}", tree.log.file, fix="choose one with `base_link`")),
        (not roots, Problem(loop if moved else "the file has no links", tree.log.file)),
    )
    base = roots[0]
    paths = tree.paths(base)
    named = {joint.name for joint in _moving([*tree.joints.values()]) if joint.name in columns}
    named = {name for name in named if not _GRIPPER.search(name)} or named
    for name in named:
        # The joint with all others before it; there is none where they are on several branches.
        path = _moving(paths.get(tree.joints[name].link, []))
        if named <= {joint.name for joint in path}:
            first = next(joint for joint in path if joint.name in named)
            # Joints in front that the file does not have, such as wheels, only place the base.
            start = base if base_link or path[0] is first else _link_of(tree.elements[first.name], "parent")
            return start, _flange(tree, tree.joints[name].link)
    leaves = {link: paths[link] for link in tree.links if link in paths and link != base and not tree.below[link]}
    # Columns of joints without a name: q1, J1, A1.
    count = len({match[1] for name in columns if (match := re.fullmatch(r"(?i)[qja]_?([1-9]\d?)", name))})
    moving = {leaf: _moving(path) for leaf, path in leaves.items()}
    longest = 0 if named else max(map(len, moving.values()), default=0)
    links = {path[count - 1].link for path in moving.values() if len(path) == longest > count > 0}
    if len(links) == 1:
        return base, _flange(tree, links.pop())
    if tip_link is not None:
        return base, _known_link(tree, tip_link, "`tip_link`")
    refuse((not leaves, Problem(f"no joint follows the link {base!r}", tree.log.file)))
    ranks = {leaf: (len(moving[leaf]), [leaf == name for name in _FLANGES], len(leaves[leaf])) for leaf in leaves}
    names = sorted(ranks, key=ranks.__getitem__, reverse=True)
    n_best = sum(
        rank == ranks[names[0]] or (rank[0] == ranks[names[0]][0] and moving[leaf] != moving[names[0]])
        for leaf, rank in ranks.items()
    )
    refuse(
        (
            n_best > 1,
            Problem(
                f"{n_best} chains are equally long; the tree ends at {listing(names, 12)}",
                tree.log.file,
                fix="choose one with `tip_link`",
            ),
        )
    )
    return base, names[0]


def _flange(tree: _Tree, link: _Link) -> _Link:
    """Return the link behind the joints after ``link`` that do not move by themselves, before a gripper or a fork."""
    joints = tree.below[link]
    fixed = [joint.link for joint in joints if not _moving([joint, *tree.below[joint.link]])]
    flange = next((name for name in _FLANGES if name in fixed), None)
    return flange or (_flange(tree, fixed[0]) if len(fixed) == len(joints) == 1 else link)


def _known_link(tree: _Tree, name: str, parameter: str) -> _Link:
    known = [str(link) for link in tree.links]
    names = difflib.get_close_matches(name, known, 3, 0.5) or known
    refuse((name not in known, f"{parameter}: {tree.log.file} has no link {name!r}; it has {listing(names, 12)}"))
    return name


# Joints, and their sizes: a URDF is in m and rad.

_TYPES = ("revolute", "prismatic", "fixed")
_LENGTH_FIX, _ANGLE_FIX = "a URDF's lengths are in m", "a URDF's angles are in rad"


def _read_joint(tree: _Tree, element: Element) -> Joint:
    """Return the joint of an element; reduced URDFs let fixed joints follow others, which says nothing."""
    link, rule, kind = _link_of(element, "child"), element.find("mimic"), str(element.get("type"))
    mimic = (
        Mimic(str(rule.get("joint")), *_numbers(rule, "multiplier", "1"), *_numbers(rule, "offset", "0"))
        if rule is not None and kind != "fixed"
        else None
    )
    axis = None if kind == "fixed" else unit_axis(_numbers(element.find("axis"), "xyz", "1 0 0"))
    mass = tree.links[link].find("inertial/mass")
    limits = _stated_limits(element)
    # Not through a rotation: near a pitch of 90 degrees the roll and yaw computed from it lose most of their digits.
    origin = [value for key in ("xyz", "rpy") for value in _numbers(element.find("origin"), key)]
    return Joint(
        name=str(element.get("name")),
        type=cast(JointType, "revolute" if kind == "continuous" else kind),
        parameters=dict(zip(ORIGIN_PARAMETERS, (*origin, 0.0), strict=True)),
        axis=axis or (0.0, 0.0, 1.0),
        limits=finite_limits(kind, limits)[0] if limits and kind in ("revolute", "prismatic") else None,
        is_continuous=kind == "continuous",
        mass=None if mass is None else _numbers(mass, "value", "0")[0],
        com=None if mass is None else cast(Vector, tuple(_numbers(tree.links[link].find("inertial/origin"), "xyz"))),
        mimic=mimic,
        link=link,
    )


def _stated_limits(element: Element) -> tuple[float, float] | None:
    """Return the limits of a joint as written; None where it has none, or says with infinite ones that it has none."""
    limit = element.find("limit")
    # Where one limit is missing, the format's default for it is zero.
    lower, upper = _numbers(limit, "lower", "0") + _numbers(limit, "upper", "0")
    is_missing = limit is None or limit.attrib.keys().isdisjoint(("lower", "upper"))
    return None if is_missing or (math.isinf(lower) and math.isinf(upper)) else (lower, upper)


def _check_joints(tree: _Tree, joints: Sequence[Joint]) -> None:
    """Report joints that no chain can have, and sizes that no arm has."""
    for joint in joints:
        element, has_limits = tree.elements[joint.name], joint.type in ("revolute", "prismatic")
        limits = _stated_limits(element) if has_limits and not joint.is_continuous else None
        lower, upper = limits or (0.0, 0.0)
        too_large = finite_limits(joint.type, limits)[1] if limits else None
        unknown = (
            f"a {joint.type} joint cannot be part of a serial chain"
            if joint.type in ("floating", "planar")
            else f"unknown joint type {joint.type!r}"
        )
        no_axis = joint.type != "fixed" and unit_axis(_numbers(element.find("axis"), "xyz", "1 0 0")) is None
        infinite = math.isinf(lower) or math.isinf(upper)
        one_infinite = f"one limit is infinite, the other is not ({lower:g}, {upper:g})"
        far = max(map(abs, joint.com or ZERO))
        travel = max(map(abs, joint.limits)) if joint.limits and joint.type == "prismatic" else 0.0
        problems = [
            (joint.type not in _TYPES, unknown, "choose a chain without it with `base_link` and `tip_link`"),
            (no_axis, "the joint's axis is zero and has no direction", None),
            (infinite, one_infinite, None),
            (lower > upper and not infinite, f"the lower limit {lower:g} is above the upper limit {upper:g}", None),
            (
                too_large is not None and not infinite and lower <= upper,
                str(too_large),
                "make them infinite for a joint without limits",
            ),
            *(
                (abs(value) > MAX_LENGTH, f"{name} of {value:g} m is too long for an arm", _LENGTH_FIX)
                if name in LENGTH_PARAMETERS
                else (abs(value) > TURN, f"{name} of {value:g} rad is more than a turn", _ANGLE_FIX)
                for name, value in joint.parameters.items()
            ),
            (far > MAX_LENGTH, f"the centre of mass of its link is {far:g} m away, too far for an arm", _LENGTH_FIX),
            (
                TRAVEL_IN_MM[0] < travel < TRAVEL_IN_MM[1],
                f"a travel of {travel:g} m is too long for an arm",
                _LENGTH_FIX,
            ),
        ]
        for is_wrong, message, fix in problems:
            if is_wrong:
                tree.report(element, joint.name, message, fix)
        if (own := tree.joints[joint.name].mass or 0.0) < 0:
            tree.report(tree.links[joint.link], str(joint.link), f"the link's mass is negative ({own:g} kg)")
    if limits_likely_degrees(joints):
        tree.report(None, "", "the limits of every joint are more than two turns", _ANGLE_FIX)


# Masses of links outside the chain: grippers, hoses' clamps, cameras, a second arm.


_Carried = tuple[Poses, Joint, bool]
"""Frame of a link in that of the link which carries it; its joint; and whether the joint moves it.

A joint that does not move its link counts as fixed, at zero.
"""


def _with_branches(tree: _Tree, path: Sequence[Joint], base: _Link) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints of a chain, each link with the mass that it carries rigidly, and the joints of branches.

    A joint outside the chain that moves little mass stands at zero, as if it were fixed. Joints that follow others are
    not resolved yet. A chain without any mass stays without.
    """
    if not any(joint.mass for joint in path):
        return list(path), []
    on_chain = {joint.link for joint in path}
    branches = list(_branches(tree, list(_carried(tree, base, Poses.identity(), on_chain)), None))
    joints = []
    for joint in path:
        carried = list(_carried(tree, joint.link, Poses.identity(), on_chain))
        joints.append(_loaded(joint, carried))
        branches += _branches(tree, carried, joint.name)
    return joints, branches


def origin_of(joint: Joint) -> Poses:
    """Return the origin of a joint in the convention of a URDF."""
    coordinates = np.array([joint.parameters[label] for label in ORIGIN_PARAMETERS[:6]])
    return Poses.from_xyz_rpy(coordinates[:3], coordinates[3:])


def _carried(tree: _Tree, link: _Link, frame: Poses, on_chain: Collection[_Link] = ()) -> Iterator[_Carried]:
    """Yield the links that ``link`` carries rigidly, and those that a joint moves against it."""
    for joint in tree.below[link]:
        if joint.link not in on_chain:
            child = frame @ origin_of(joint)
            # kg m: a joint that moves mass by less, such as a gripper's finger, counts as fixed; a gear of 1e-5 rad/(N
            # m) yields by 5 um at 1 m to it.
            moves = joint.type in ("revolute", "prismatic") and _movable_moment(tree, joint) > 0.05
            yield child, joint, moves
            if not moves:
                yield from _carried(tree, joint.link, child)


def _movable_moment(tree: _Tree, joint: Joint) -> float:
    """Return the most by which a joint can move the first moment of the mass behind it, kg m."""
    limit = tree.elements[joint.name].find("limit")
    travel = abs(_numbers(limit, "upper", "0")[0] - _numbers(limit, "lower", "0")[0])
    behind = _behind(tree, joint, 0.0)
    return sum(mass * (travel if joint.type == "prismatic" else distance) for mass, distance in behind)


def _behind(tree: _Tree, joint: Joint, distance: float) -> Iterator[tuple[float, float]]:
    """Yield mass, and greatest distance from an axis ``distance`` in front of a joint, of the links from its own on."""
    yield joint.mass or 0.0, distance + math.hypot(*(joint.com or ZERO))
    for other in tree.below[joint.link]:
        yield from _behind(tree, other, distance + math.hypot(*(other.parameters[label] for label in "xyz")))


def _loaded(joint: Joint, carried: Sequence[_Carried]) -> Joint:
    """Return the joint with the masses of its link and of the links on it as a single mass."""
    rigid = [(frame, link.mass, link.com or ZERO) for frame, link, moves in carried if not moves]
    masses = [(mass, frame.rotation @ com + frame.translation) for frame, mass, com in rigid if mass and mass > 0]
    if not masses:
        return joint
    own = joint.mass or 0.0
    total = own + sum(mass for mass, _ in masses)
    moment: Array = sum((mass * place for mass, place in masses), own * np.array(joint.com or ZERO))
    return replace(joint, mass=total, com=cast(Vector, tuple((moment / total).tolist())))


def _branches(tree: _Tree, carried: Sequence[_Carried], parent: str | None) -> Iterator[BranchJoint]:
    """Yield the moving joints among links that ``parent`` carries, and those behind them."""
    for frame, moving in ((frame, joint) for frame, joint, moves in carried if moves):
        joint = replace(moving, limits=None)
        if (frame.matrices() != origin_of(moving).matrices()).any():
            origin = Frame.of(frame)
            values = zip(ORIGIN_PARAMETERS, (*origin.xyz, *origin.rpy, 0.0), strict=True)
            joint = replace(joint, parameters=dict(values))
        behind = list(_carried(tree, moving.link, Poses.identity()))
        yield BranchJoint(_loaded(joint, behind), parent)
        yield from _branches(tree, behind, joint.name)


# Mimic joints of the chain, and of its branches.


def _resolve_mimics(
    tree: _Tree, joints: Sequence[Joint], branches: Sequence[BranchJoint]
) -> tuple[list[Joint], list[BranchJoint]]:
    """Return the joints with every mimic made to follow, directly, a joint variable of the chain or of a branch.

    Of the joints of the chain that follow a joint outside of it, the first becomes the variable, and any other, in the
    chain or outside, follows it: ``q_b = m_b / m_a (q_a - o_a) + o_b``. A joint that follows one which stands at zero
    keeps a variable.
    """
    inside = {joint.name for joint in joints}
    known = inside | {branch.joint.name for branch in branches}
    chain = [_direct_mimic(tree, joint) for joint in joints]
    leaders: dict[str, tuple[str, Mimic]] = {}
    for joint in chain:
        if joint.mimic is not None and joint.mimic.master not in inside and joint.mimic.multiplier != 0.0:
            leaders.setdefault(joint.mimic.master, (joint.name, joint.mimic))

    def resolved(joint: Joint, known: Collection[str]) -> Joint:
        rule = joint.mimic or Mimic(joint.name)
        if rule.master not in leaders or not (rule.multiplier or joint.name not in inside):
            return joint if rule.master in known else replace(joint, mimic=None)
        name, leader = leaders[rule.master]
        if name == joint.name:
            return replace(joint, mimic=None, outside=rule)
        ratio = rule.multiplier / leader.multiplier
        return replace(joint, mimic=Mimic(name, ratio, rule.offset - ratio * leader.offset))

    beside = [branch._replace(joint=resolved(_direct_mimic(tree, branch.joint), known)) for branch in branches]
    return [resolved(joint, inside) for joint in chain], beside


def _direct_mimic(tree: _Tree, joint: Joint) -> Joint:
    """Return the joint with its mimic made to follow, directly, a joint that moves by itself, in the chain or not."""
    mimic, visited = joint.mimic, {joint.name}
    while mimic is not None:
        master = tree.joints.get(mimic.master)
        if master is None or master.type == "fixed" or master.name in visited:
            is_circle = master is not None and master.type != "fixed"
            circle = "which follows it in turn: none of these joints moves by itself"
            problem = circle if is_circle else "which is fixed" if master else "which is not a joint of this file"
            tree.report(tree.elements[joint.name], joint.name, f"follows {mimic.master!r}, {problem}")
            break
        if master.mimic is None:
            return replace(joint, mimic=mimic)
        visited.add(master.name)
        # q = m1 (m2 q' + o2) + o1
        ratio, inner = mimic.multiplier, master.mimic
        mimic = Mimic(inner.master, ratio * inner.multiplier, ratio * inner.offset + mimic.offset)
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
    tree = _Tree(text, file)
    base, tip = _choose_chain(tree, base_link, tip_link, joint_columns)
    path = tree.paths(base).get(tip, [])
    many = f"there are {len(path)} joints from {base!r} to {tip!r}, expected at most {MAX_JOINTS}"
    refuse(
        (not path, f"{file}: link {tip!r} is not behind link {base!r}"),
        (len(path) > MAX_JOINTS, Problem(many, file, fix="choose a shorter chain with `base_link` and `tip_link`")),
    )
    joints, branches = _with_branches(tree, path, base)
    _check_joints(tree, [*joints, *(branch.joint for branch in branches)])
    tree.log.raise_if_any()
    joints, branches = _resolve_mimics(tree, joints, branches)
    if not any(joint.is_variable for joint in joints):
        tree.report(None, "", f"no joint between {base!r} and {tip!r} moves", "choose a longer chain")
    tree.log.raise_if_any()
    name = tree.root.get("name", "robot")
    return Robot(name, "urdf", tuple(joints), base_link=base, tip_link=tip, branches=tuple(branches))
