"""Robot files (YAML): their fields as data, which read and check them, their units, and their writer.

Problems of a file have line numbers and dotted keys. Its numbers are in its own units, those of a robot in m and rad.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, compose, describe
from robacc.quantities import significant
from robacc.robots.description import (
    DH_PARAMETERS,
    IDENTITY,
    LENGTH_PARAMETERS,
    MAX_JOINTS,
    MAX_LENGTH,
    ORIGIN_PARAMETERS,
    TRAVEL_IN_MM,
    TURN,
    BranchJoint,
    Campaign,
    Convention,
    Frame,
    Joint,
    JointType,
    Mimic,
    Robot,
    Vector,
    effect_key,
    finite_limits,
    limits_likely_degrees,
    unit_axis,
)

# Units of a robot file.

_LENGTHS = {"m": 1.0, "mm": 1e-3}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180}
_MIN_LENGTH = 5e-3
"""m: an arm with only shorter lengths was written in m and declared as mm."""


@dataclass(frozen=True, slots=True)
class Units:
    """Units of a robot file's numbers."""

    length: float = 1.0
    """Unit of length in m."""
    angle: float = 1.0
    """Unit of angle in rad."""

    def of_joint(self, joint_type: str) -> float:
        """Return the unit of a joint's variable."""
        return self.length if joint_type == "prismatic" else self.angle

    def parameter(self, source: Source, node: yaml.Node, path: str, *, is_length: bool) -> float | None:
        """Return a length in m or an angle in rad; report a value that is too large, with the likely cause."""
        value = source.number(node, path)
        unit, most = (self.length, MAX_LENGTH) if is_length else (self.angle, TURN)
        if value is None or abs(value) * unit <= most:
            return None if value is None else value * unit
        message = f"is {abs(value) * unit:g} m, too long for an arm"
        fix = "it looks like mm: write length: mm under units"
        if not is_length:
            message = f"{'rad' if unit == 1.0 else 'deg'} is more than a turn"
            fix = "it looks like degrees: write angle: deg under units"
        source.report(node, path, f"{value:g} {message}", fix if unit == 1.0 else None)
        return None


# Kinds of values: each reads a node, and reports what is wrong with it at its dotted key.

Kind = Callable[[Units, Source, yaml.Node, str], Any]
"""Reader of a value; None where it cannot be read."""
Check = tuple[Callable[[float], bool], str, str | None]
"""Test of a number, the message where it fails (with ``{found}`` or ``{value}``), and how to repair it."""


def read_fields(
    section: YamlSection, kinds: Mapping[str, Kind], units: Units, required: Collection[str] = ()
) -> dict[str, Any]:
    """Return the values of a section's fields that it has; report the required ones that it lacks."""
    values = {}
    for key, kind in kinds.items():
        node = section.require(key) if key in required else section.get(key)
        value = None if node is None else kind(units, section.source, node, section.at(key))
        if value is not None:
            values[key] = value
    return values


def _section(kinds: Mapping[str, Kind], required: Collection[str] = (), into: Callable[..., Any] = dict) -> Kind:
    """Kind of a mapping with fields of these kinds, which ``into`` takes by their keys."""

    def read(units: Units, source: Source, node: yaml.Node, path: str) -> Any:
        section = source.section(node, path, tuple(kinds))
        return None if section is None else into(**read_fields(section, kinds, units, required))

    return read


def _named(kind: Kind, message: str, *, empty: bool = True) -> Kind:
    """Kind of a mapping of names to values of a kind; the ``message`` says what is expected, with ``{found}``."""

    def read(units: Units, source: Source, node: yaml.Node, path: str) -> dict[str, Any] | None:
        if not isinstance(node, yaml.MappingNode) or not (empty or node.value):
            source.report(node, path, message.format(found=describe(node)))
            return None
        values = ((name, kind(units, source, value, f"{path}.{name}")) for name, _, value in source.entries(node, path))
        return {name: value for name, value in values if value is not None}

    return read


def _list(kind: Kind, item_name: str) -> Kind:
    """Kind of a list of values of a kind."""

    def read(units: Units, source: Source, node: yaml.Node, path: str) -> tuple[Any, ...]:
        items = enumerate(source.items(node, path, item_name))
        values = [kind(units, source, item, f"{path}[{i}]") for i, item in items]
        return tuple(value for value in values if value is not None)

    return read


def _text(_: Units, source: Source, node: yaml.Node, path: str) -> str | None:
    return source.text(node, path)


def _choice(*options: str) -> Kind:
    return lambda _, source, node, path: source.choice(node, path, options)


def _number(_: Units, source: Source, node: yaml.Node, path: str) -> float | None:
    return source.number(node, path)


def _length(units: Units, source: Source, node: yaml.Node, path: str) -> float | None:
    return units.parameter(source, node, path, is_length=True)


def _angle(units: Units, source: Source, node: yaml.Node, path: str) -> float | None:
    return units.parameter(source, node, path, is_length=False)


def _checked(kind: Kind, *checks: Check) -> Kind:
    """Kind of a number that passes every check."""

    def read(units: Units, source: Source, node: yaml.Node, path: str) -> float | None:
        value: float | None = kind(units, source, node, path)
        for is_good, message, fix in checks if value is not None else ():
            if not is_good(cast(float, value)):
                source.report(node, path, message.format(found=describe(node), value=value), fix)
                break
        return value

    return read


def _vector(kind: Kind) -> Kind:
    """Kind of a list of three numbers of a kind."""

    def read(units: Units, source: Source, node: yaml.Node, path: str) -> Vector | None:
        if source.numbers(node, path, 3) is None:
            return None
        items = enumerate(cast(yaml.SequenceNode, node).value)
        values = [kind(units, source, item, f"{path}[{i}]") for i, item in items]
        return None if None in values else cast(Vector, tuple(values))

    return read


def _gravity(_: Units, source: Source, node: yaml.Node, path: str) -> tuple[float, ...] | None:
    values = source.numbers(node, path, 3)
    if values is not None and math.hypot(*values) > _MAX_GRAVITY:
        source.report(node, path, f"{list(values)} is too large for gravity", "it is always in m/s^2")
    return values


def _axis(_: Units, source: Source, node: yaml.Node, path: str) -> Vector | None:
    values = source.numbers(node, path, 3)
    axis = unit_axis(values) if values else None
    if values and axis is None:
        source.report(node, path, "the axis is zero and has no direction")
    return axis


def _limits(joint_type: JointType) -> Kind:
    def read(units: Units, source: Source, node: yaml.Node, path: str) -> tuple[float, float] | None:
        values = source.numbers(node, path, 2)
        if values is None:
            return None
        low, high = values
        if low > high:
            source.report(node, path, f"the lower limit {low:g} is above the upper limit {high:g}")
            return None
        unit, longest = units.of_joint(joint_type), max(map(abs, values))
        if joint_type == "prismatic" and unit == 1.0 and TRAVEL_IN_MM[0] < longest < TRAVEL_IN_MM[1]:
            fix = "it looks like mm: write length: mm under units"
            source.report(node, path, f"a travel of {longest:g} m is too long for an arm", fix)
        finite, problem = finite_limits(joint_type, (low * unit, high * unit))
        if problem is not None:
            source.report(node, path, problem, "leave limits out for a joint without limits")
        return finite

    return read


def _digest(_: Units, source: Source, node: yaml.Node, path: str) -> str:
    # Not through text(): YAML reads digits alone as a number, so they are written in quotes.
    digest = node.value if isinstance(node, yaml.ScalarNode) else ""
    if not re.fullmatch("[0-9a-f]{64}", digest):
        message = f"expected the SHA-256 of a pose file, 64 hexadecimal digits, found {describe(node)}"
        source.report(node, path, message, "`write_model` writes it; do not change it")
    return digest


def _mapping(fix: str | None = None) -> Kind:
    """Kind of a mapping that is kept as it is."""

    def read(_: Units, source: Source, node: yaml.Node, path: str) -> Mapping[str, Any] | None:
        if not isinstance(node, yaml.MappingNode):
            source.report(node, path, f"expected keys with values, found {describe(node)}", fix)
            return None
        return cast(Mapping[str, Any], source.plain(node, path))

    return read


def _tolerances(names: Iterable[str], lengths: Collection[str] = LENGTH_PARAMETERS) -> Kind:
    """Kind of standard deviations by name, m for the ``lengths``, else rad."""
    check = lambda value: value >= 0, "a standard deviation cannot be negative, found {found}", None
    return _section({name: _checked(_length if name in lengths else _angle, check) for name in names})


def _mimic(joint: str = "", **factors: float) -> Mimic:
    return Mimic(joint, **factors)


def _campaign(poses: tuple[str, ...] = (), before: Mapping[str, Any] = MappingProxyType({}), **more: Any) -> Campaign:
    return Campaign(poses, **before, **more)


def read_units(top: YamlSection) -> Units | None:
    """Return the units of the key ``units`` of a file; None where they cannot be read."""
    names = read_fields(top, {"units": _section(_UNITS, tuple(_UNITS))}, Units(), ["units"]).get("units", {})
    return Units(_LENGTHS[names["length"]], _ANGLES[names["angle"]]) if len(names) == len(_UNITS) else None


def named_frames(message: str, *required: str) -> Kind:
    """Kind of frames by name; without keys that are ``required`` of each, there may be none.

    The ``message`` says what is expected, with ``{found}``.
    """
    return _named(_section(_FRAME, required, Frame), message, empty=not required)


# Fields of a robot file.

FORMAT_VERSION = 1
BASE_LINK = "base"
"""Parent of a branch that the base carries."""
_MAX_GRAVITY = 50.0
"""m/s^2: five times the earth's gravity; a larger number is likely in mm/s^2."""
_COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
IDENTITY_FIELDS: dict[str, Kind] = dict.fromkeys(IDENTITY, _text)
_UNITS = {"length": _choice(*_LENGTHS), "angle": _choice(*_ANGLES)}
_FRAME = {"xyz": _vector(_length), "rpy": _vector(_angle)}
_FRAME_WITH_TOLERANCE = _section({**_FRAME, "tolerance": _tolerances(_COORDINATES)})
_TARGETS = named_frames("expected names with xyz, found {found}", "xyz")
_DIGESTS = _list(_digest, "SHA-256 of pose files")
_EFFECTS = _list(_mapping(), "effects")
_SHARE = (
    lambda value: 0.0 <= value <= 1.0,
    "expected a share from 0 to 1, found {value:g}",
    "it is relative: 0.1 for 10 %",
)
_BEFORE = {"base": _section(_FRAME, into=Frame), "tool": _section(_FRAME, into=Frame), "targets": _TARGETS}
_ROBOT: dict[str, Kind] = {
    "base": _FRAME_WITH_TOLERANCE,
    "tool": _FRAME_WITH_TOLERANCE,
    "name": _text,
    "gravity": _gravity,
    "payload": _section({"com": _vector(_length)}, ["com"]),
    "targets": _TARGETS,
    "effects": _EFFECTS,
    "base_link": _text,
    "tip_link": _text,
    "fitted_to": _DIGESTS,
    "campaign": _section({"poses": _DIGESTS, "before": _section(_BEFORE), "effects": _EFFECTS}, into=_campaign),
    "mass_uncertainty": _checked(_number, _SHARE),
    "fit": _mapping("`write_model` writes it"),
    "identity": _section(IDENTITY_FIELDS),
}
_TOP_KEYS = (
    "robacc",
    "name",
    "convention",
    "units",
    "gravity",
    "base",
    "tool",
    "payload",
    "targets",
    "joints",
    "branches",
    "effects",
    "base_link",
    "tip_link",
    "fitted_to",
    "campaign",
    "mass_uncertainty",
    "fit",
    "identity",
)

_POSITIVE = "expected a positive number, found {found}"
_DRIVE: dict[str, Kind] = {
    "sign": _checked(_number, (lambda value: abs(value) == 1, "expected 1 or -1, found {found}", None)),
    "gear_ratio": _checked(
        _number,
        (lambda value: value >= 0, _POSITIVE, "write sign: -1 where the motor turns the other way"),
        (lambda value: value > 0, _POSITIVE, None),
    ),
    "coupling": _named(_number, "expected joints with their ratios, such as {{j2: 1.0}}, found {found}", empty=False),
    "passive": _choice("true", "false"),
}
_OF_ANY_JOINT: dict[str, Kind] = {
    "name": _text,
    "link": _text,
    "mass": _checked(_number, (lambda value: value >= 0, "a mass cannot be negative, found {found}", None)),
    "com": _vector(_length),
    **_DRIVE,
    "mimic": _section({"joint": _text, "multiplier": _number, "offset": _number}, ["joint"], _mimic),
}
_FIXED_KEYS = ("name", "type", "origin", "link", "mass", "com", "tolerance")
_DH_KEYS = ("name", "type", *DH_PARAMETERS, "limits", *_DRIVE, "mass", "com", "tolerance")
_KEYS = {
    "standard": _DH_KEYS,
    "modified": _DH_KEYS,
    "urdf": (*_FIXED_KEYS, "axis", "offset", "mimic", "limits", *_DRIVE),
}
_BRANCH_KEYS = (
    *("name", "parent", "type", "origin", "link", "mass", "com"),
    *("axis", "offset", "position", "limits", "sign", "mimic"),
)
_TYPES = ("revolute", "prismatic", "continuous")


def _read_joint(section: YamlSection, index: int, convention: Convention, units: Units) -> Joint | None:
    """Return the joint of a section, None where it cannot be read."""
    is_urdf, has = convention == "urdf", section.values
    kind = read_fields(section, {"type": _choice(*_TYPES, "fixed") if is_urdf else _choice(*_TYPES)}, units, ["type"])
    if not kind:
        return None
    joint_type = cast(JointType, "revolute" if kind["type"] == "continuous" else kind["type"])
    is_fixed, is_continuous = joint_type == "fixed", kind["type"] == "continuous"
    names = ORIGIN_PARAMETERS if is_urdf else DH_PARAMETERS
    lengths = LENGTH_PARAMETERS | ({"offset"} if is_urdf and joint_type == "prismatic" else set())
    sizes = {name: _length if name in lengths else _angle for name in names}
    if is_urdf:
        kinds: dict[str, Kind] = {"origin": _section(_FRAME, into=Frame), "offset": sizes["offset"]}
        required = set() if is_fixed else {"axis"}
    else:
        # The variable's own parameter is an offset and zero by default, as is beta, which a plain table does not have.
        kinds, required = dict(sizes), {*names} - {"beta", "theta" if joint_type == "revolute" else "d"}
    if not is_fixed:
        kinds |= {"axis": _axis, "limits": _limits(joint_type)}
    values = read_fields(section, {**_OF_ANY_JOINT, **kinds, "tolerance": _tolerances(names, lengths)}, units, required)
    is_passive = values.pop("passive", None) == "true"
    checks = [
        (is_continuous and "limits" in has, "limits", "a continuous joint has no limits", "make its type revolute"),
        (
            section.get("com") is not None and section.get("mass") is None,
            "com",
            "a centre of mass needs a mass",
            "add the link's mass in kg",
        ),
        (
            "coupling" in values and "mimic" in has,
            "coupling",
            "cannot be combined with mimic",
            "list the joint here too",
        ),
        (
            is_passive and "coupling" not in has,
            "passive",
            "a passive joint moves by its coupling alone, and there is none",
            "add coupling, such as {j2: -1.0, j3: -1.0}",
        ),
        *(
            (is_fixed and key not in (*_FIXED_KEYS, "parent"), key, "a fixed joint does not have this key", None)
            for key in has
        ),
    ]
    for is_wrong, key, message, fix in checks:
        if is_wrong:
            section.source.report(has[key], section.at(key), message, fix)
    origin = values.pop("origin", Frame())
    found = dict(zip(_COORDINATES, (*origin.xyz, *origin.rpy), strict=True))
    parameters = {name: values.pop(name, found.get(name, 0.0)) for name in names}
    values["sign"] = -1 if values.get("sign") == -1 else 1
    return Joint(
        type=joint_type,
        parameters=parameters,
        is_continuous=is_continuous,
        is_passive=is_passive,
        **{"name": f"j{index + 1}", **values},
    )


def _listed_joints(
    top: YamlSection, key: str, keys: Sequence[str], units: Units, convention: Convention, required: Sequence[str] = ()
) -> tuple[list[tuple[YamlSection, Joint]], bool]:
    """Return the joints of a list that can be read, with their sections, and whether these are all."""
    source, node = top.source, top.get(key)
    items = () if node is None else source.items(node, key, "joints" if key == "joints" else "joints outside the chain")
    if len(items) > MAX_JOINTS:
        source.report(node, key, f"found {len(items)} joints, expected at most {MAX_JOINTS}")
        return [], False
    read = []
    for i, item in enumerate(items):
        section = source.section(item, f"{key}[{i}]", keys)
        for name in required if section else ():
            cast(YamlSection, section).require(name)
        if section and (joint := _read_joint(section, i, convention, units)) is not None:
            read.append((section, joint))
    return read, len(read) == len(items)


def _read_joints(top: YamlSection, convention: Convention, units: Units) -> tuple[Joint, ...]:
    source, node = top.source, top.require("joints")
    read, is_whole = _listed_joints(top, "joints", _KEYS[convention], units, convention)
    if isinstance(node, yaml.SequenceNode) and not node.value:
        source.report(node, "joints", "a robot needs at least one joint")
    lines: dict[str, int] = {}
    links: set[str | None] = {None}
    for section, joint in read:
        if joint.name in lines:
            message = f"{joint.name!r} is already the name of the joint in line {lines[joint.name]}"
            source.report(section.node, section.at("name"), message)
        if joint.link in links - {None}:
            source.report(section.node, section.at("link"), f"an earlier joint already moves {joint.link!r}")
        lines.setdefault(joint.name, section.node.start_mark.line + 1)
        links.add(joint.link)
    if not is_whole:
        return ()
    if read and not any(joint.is_variable for _, joint in read):
        source.report(node, "joints", "no joint moves: all are fixed or follow another")
    return tuple(_followers(read, units))


def _followers(
    read: Sequence[tuple[YamlSection, Joint]], units: Units, masters: Sequence[Joint] = ()
) -> Iterator[Joint]:
    """Yield the joints with their mimics and couplings in SI units; report those that follow no joint variable.

    Each joint follows others of the list, or of ``masters``.
    """
    by_name = {joint.name: joint for joint in (*masters, *(joint for _, joint in read))}
    sizes = {name: units.of_joint(joint.type) for name, joint in by_name.items() if joint.is_variable}
    for section, joint in read:
        mimic, unit, report = joint.mimic, units.of_joint(joint.type), section.source.report
        if mimic is not None and mimic.master in sizes:
            ratio = mimic.multiplier * (unit / sizes[mimic.master])
            mimic = Mimic(mimic.master, ratio, mimic.offset * unit)
        elif mimic is not None and mimic.master:
            reason = "is not a joint of this robot"
            if (master := by_name.get(mimic.master)) is not None:
                reason = "is fixed" if master.type == "fixed" else "follows another joint itself"
            message = f"{joint.name!r} follows {mimic.master!r}, which {reason}"
            report(section.node, section.at("mimic.joint"), message)
        for name in joint.coupling:
            if name not in sizes or name == joint.name:
                known = ", ".join(other for other in sizes if other != joint.name)
                message = f"{name!r} is not another joint with a variable; there are {known or 'none'}"
                report(section.node, section.at(f"coupling.{name}"), message)
        ratios = {name: ratio * (unit / sizes[name]) for name, ratio in joint.coupling.items() if name in sizes}
        yield replace(joint, mimic=mimic, coupling=ratios)


def _read_branches(top: YamlSection, joints: Sequence[Joint], units: Units) -> tuple[BranchJoint, ...]:
    """Return the joints outside the chain of the key ``branches``; each parent must be ``base`` or an earlier joint.

    A joint may follow another one outside the chain, or a joint of the chain.
    """
    source, names = top.source, {joint.name for joint in joints}
    read, _ = _listed_joints(top, "branches", _BRANCH_KEYS, units, "urdf", ("name", "parent"))
    branches = []
    for section, joint in read:
        kinds = {"parent": _text, "position": _length if joint.type == "prismatic" else _angle}
        values = read_fields(section, kinds, units)
        parent = values.get("parent", BASE_LINK)
        if joint.mimic and (place := section.get("position")) is not None:
            message = "a joint that follows another has no position of its own"
            source.report(place, section.at("position"), message)
        if joint.name in names or joint.name == BASE_LINK:
            message = f"{joint.name!r} is already the name of a joint or of the base"
            source.report(section.node, section.at("name"), message)
        if parent != BASE_LINK and parent not in names:
            message = f"{parent!r} is neither {BASE_LINK} nor a joint in front of it"
            source.report(section.node, section.at("parent"), message, f"there are {', '.join(sorted(names))}")
        names.add(joint.name)
        branches.append(BranchJoint(joint, None if parent == BASE_LINK else parent, values.get("position", 0.0)))
    beside = _followers(read, units, joints)
    return tuple(replace(branch, joint=joint) for branch, joint in zip(branches, beside, strict=True))


def parse_robot(document_text: str, file: str) -> Robot:
    """Return the robot that a robot file describes, in SI units.

    Args:
        document_text: The YAML document.
        file: Name of the file, for messages, and for the robot's name where the file gives none.

    Raises:
        InputError: The file has problems; the error carries all of them, with line and dotted key.
    """
    source = Source(file)
    top = source.section(compose(document_text, file), "", _TOP_KEYS)
    if top is None:
        source.finish()
        raise AssertionError("finish() raises where section() returned None")
    _check_version(top)
    units = read_units(top)
    convention = read_fields(top, {"convention": _choice(*_KEYS)}, Units(), ["convention"]).get("convention")
    if units is None or convention is None:
        # Without them the other keys cannot be checked; any problem reported would be false.
        source.finish()
    units, convention = cast(Units, units), cast(Convention, convention)
    joints = _read_joints(top, convention, units)
    branches = _read_branches(top, joints, units)
    values = read_fields(top, _ROBOT, units)
    if "targets" in values and "tool" in top.values:
        source.report(top.values["targets"], "targets", "cannot be combined with tool", "list the tool as a target")
    for key in ("base", "tool"):
        frame = values.get(key, {})
        values[f"{key}_tolerance"] = frame.pop("tolerance", {})
        values[key] = Frame(**frame)
    robot = Robot(
        convention=convention,
        joints=joints,
        branches=branches,
        effect_units=(units.length, units.angle),
        payload_com=values.pop("payload", {}).get("com"),
        file_text=document_text,
        **{"name": Path(file).stem, **values},
    )
    if not source.problems:
        _check_likely_units(robot, units, top)
    source.finish()
    return robot


def _check_version(top: YamlSection) -> None:
    node = top.values.get("robacc")
    if node is None:
        fix = f"write 'robacc: {FORMAT_VERSION}' as the first line"
        top.source.report(None, "robacc", "the format version is missing, so this is not a robot file of robacc", fix)
    elif not isinstance(node, yaml.ScalarNode) or node.value != str(FORMAT_VERSION):
        top.source.report(node, "robacc", f"expected format version {FORMAT_VERSION}, found {describe(node)}")


def _check_likely_units(robot: Robot, units: Units, top: YamlSection) -> None:
    """Report a robot without other problems whose numbers were likely written in units other than declared."""
    source, node = top.source, top.values["units"]
    if units.angle == 1.0 and limits_likely_degrees(robot.joints):
        first = next(joint.limits for joint in robot.joints if joint.limits and joint.type == "revolute")
        message = f"the limits of every joint (the first: {first} rad) are more than two turns"
        source.report(node, "units.angle", message, "they look like degrees: write angle: deg")
    parameters = [item for joint in robot.joints for item in joint.parameters.items()]
    fixed = [value for name, value in parameters if name not in LENGTH_PARAMETERS and name != "offset" and value]
    angles = [abs(value) / units.angle for value in fixed]
    right = (math.pi / 2, math.pi)
    if units.angle != 1.0 and angles and all(min(abs(value - angle) for angle in right) < 1e-3 for value in angles):
        message = f"the joints' angles ({angles[0]:g} and so on) are multiples of a quarter turn in rad, not in deg"
        source.report(node, "units.angle", message, "they look like radians: write angle: rad")
    travels = [value for joint in robot.joints if joint.type == "prismatic" for value in joint.limits or ()]
    lengths = [value for name, value in parameters if name in LENGTH_PARAMETERS]
    longest = max(map(abs, (*lengths, *travels)), default=0.0)
    if units.length != 1.0 and 0 < longest < _MIN_LENGTH:
        message = f"the longest length of the arm is {longest / units.length:g} mm"
        source.report(node, "units.length", message, "the lengths look like metres: write length: m")


def effect_lines(document_text: str, file: str) -> dict[str, int]:
    """Return the line of each entry of ``effects:`` by its dotted key; :func:`parse_robot` has checked the document."""
    top = Source(file).section(compose(document_text, file), "", _TOP_KEYS)
    node = top and top.get("effects")
    items = node.value if isinstance(node, yaml.SequenceNode) else ()
    return {effect_key(i): item.start_mark.line + 1 for i, item in enumerate(items)}


# Robots written as robot files.


def robot_to_yaml(robot: Robot, comments: Sequence[str] = (), *, rounded: bool = False, units: Units = Units()) -> str:
    """Return the robot file of a robot; reading it gives the same numbers, bit for bit if they are in m and rad.

    Args:
        robot: Robot to write; its effects are written unchanged.
        comments: Lines for the top of the file, each written behind a ``#``.
        rounded: Write estimated numbers with their significant digits only (see
            :data:`robacc.quantities.SIGNIFICANT_DIGITS`); reading them gives the same numbers to 1e-12 of their size.
        units: Units of the file.

    Raises:
        ValueError: The robot's effects are in other units.
    """
    document = robot_document(robot, units)
    if rounded:
        document = rounded_document(document)
    head = comment_lines(comments)
    # default_flow_style None: a list or mapping without a nested one stands on one line.
    return head + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def comment_lines(comments: Sequence[str]) -> str:
    """Return lines of comment for the top of a file."""
    return "".join(f"# {line}\n" for comment in comments for line in comment.splitlines())


def robot_document(robot: Robot, units: Units = Units()) -> dict[str, Any]:
    """Return the content of a robot file.

    Raises:
        ValueError: The robot's effects are in units other than ``units``.
    """
    if robot.effects and robot.effect_units != (units.length, units.angle):
        raise ValueError("convert effects to the units of the file before writing them")
    length, angle = ({size: name for name, size in sizes.items()} for sizes in (_LENGTHS, _ANGLES))
    types = {joint.name: joint.type for joint in (*robot.joints, *(branch.joint for branch in robot.branches))}
    targets = {name: _frame(frame, units) for name, frame in robot.targets.items()}
    payload = robot.payload_com
    return _given(
        {
            "robacc": 1,
            "name": robot.name,
            "identity": dict(robot.identity),
            "fitted_to": list(robot.fitted_to),
            "convention": robot.convention,
            "units": {"length": length[units.length], "angle": angle[units.angle]},
            "gravity": _floats(robot.gravity),
            "base": _frame(robot.base, units, robot.base_tolerance),
            "targets": targets,
            "tool": None if targets else _frame(robot.tool, units, robot.tool_tolerance),
            "payload": None if payload is None else {"com": _floats(payload, units.length)},
            "mass_uncertainty": None if robot.mass_uncertainty is None else float(robot.mass_uncertainty),
            "base_link": robot.base_link,
            "tip_link": robot.tip_link,
            "joints": [_joint(joint, robot.convention == "urdf", units, types) for joint in robot.joints],
            "branches": [_branch(branch, units, types) for branch in robot.branches],
            "effects": [_plain(effect) for effect in robot.effects],
            "campaign": None if robot.campaign is None else _campaign_entry(robot.campaign, units),
            "fit": _plain(robot.fit),
        }
    )


def _campaign_entry(campaign: Campaign, units: Units) -> dict[str, Any]:
    before = {
        "base": campaign.base and _frame(campaign.base, units),
        "tool": campaign.tool and _frame(campaign.tool, units),
        "targets": {name: _frame(frame, units) for name, frame in campaign.targets.items()},
    }
    entry = {"before": _given(before), "effects": [_plain(effect) for effect in campaign.effects]}
    return {"poses": list(campaign.poses), **_given(entry)}


def _given(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries that are there: neither None nor empty."""
    return {key: value for key, value in entry.items() if value is not None and value not in ({}, [], "")}


def rounded_document(value: Any) -> Any:
    """Return a document with its numbers rounded to :data:`robacc.quantities.SIGNIFICANT_DIGITS`."""
    if isinstance(value, dict):
        return {key: rounded_document(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded_document(item) for item in value]
    return significant(value) if isinstance(value, float) else value


def _frame(frame: Frame, units: Units, tolerance: Mapping[str, float] | None = None) -> dict[str, Any]:
    entry = {"xyz": _floats(frame.xyz, units.length), "rpy": _floats(frame.rpy, units.angle)}
    return {**entry, **_given({"tolerance": _sizes(tolerance or {}, LENGTH_PARAMETERS, units)})}


def _joint(joint: Joint, is_urdf: bool, units: Units, types: Mapping[str, str]) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": joint.name, "type": "continuous" if joint.is_continuous else joint.type}
    lengths = LENGTH_PARAMETERS | ({"offset"} if joint.type == "prismatic" else set())
    values = _sizes(joint.parameters, lengths, units)
    if is_urdf:
        coordinates = [values[name] for name in _COORDINATES]
        entry["origin"] = {"xyz": coordinates[:3], "rpy": coordinates[3:]}
        if joint.type != "fixed":
            entry |= {"axis": _floats(joint.axis), "offset": values.get("offset", 0.0)}
    else:
        entry |= {name: value for name, value in values.items() if name != "beta" or value != 0.0}
    unit = units.of_joint(joint.type)
    mimic = joint.mimic
    return entry | _given(
        {
            "limits": joint.limits and _floats(joint.limits, unit),
            "sign": -1 if joint.sign < 0 else None,
            "gear_ratio": None if joint.gear_ratio is None else float(joint.gear_ratio),
            "mass": None if joint.mass is None else float(joint.mass),
            "com": joint.com and _floats(joint.com, units.length),
            "tolerance": _sizes(joint.tolerance, lengths, units),
            "link": joint.link,
            "coupling": {
                str(name): float(ratio) * (units.of_joint(types[name]) / unit) for name, ratio in joint.coupling.items()
            },
            "passive": joint.is_passive or None,
            "mimic": mimic
            and {
                "joint": mimic.master,
                "multiplier": float(mimic.multiplier) * (units.of_joint(types[mimic.master]) / unit),
                "offset": mimic.offset / unit,
            },
        }
    )


def _branch(branch: BranchJoint, units: Units, types: Mapping[str, str]) -> dict[str, Any]:
    entry = {
        "name": branch.joint.name,
        "parent": branch.parent or BASE_LINK,
        **_joint(branch.joint, True, units, types),
    }
    return entry | _given({"position": branch.position / units.of_joint(branch.joint.type) or None})


def _sizes(values: Mapping[str, float], lengths: Collection[str], units: Units) -> dict[str, float]:
    """Return values by name in the file's units; those of ``lengths`` are lengths, the others angles."""
    return {
        str(name): float(value) / (units.length if name in lengths else units.angle) for name, value in values.items()
    }


def _floats(values: Sequence[float], unit: float = 1.0) -> list[float]:
    return [float(value) / unit for value in values]


def _plain(value: Any) -> Any:
    """Return built-in types with no shared object: NumPy types have no YAML form, shared objects become aliases."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        items = value.tolist() if hasattr(value, "tolist") else value
        return [_plain(item) for item in items] if isinstance(items, list | tuple) else items
    return value
