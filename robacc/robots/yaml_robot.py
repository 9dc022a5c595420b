"""Read a robot file (YAML) into a robot: its fields are data; problems have line numbers and dotted keys."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, compose, describe
from robacc.robots.description import (
    DH_PARAMETERS,
    IDENTITY,
    LENGTH_PARAMETERS,
    MAX_JOINTS,
    ORIGIN_PARAMETERS,
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
    unit_axis,
)
from robacc.robots.yaml_units import TRAVEL_IN_MM, Units, check_likely_units, finite_limits, read_units

# Kinds of values: each reads a node, and reports what is wrong with it at its dotted key.

Kind = Callable[[Source, yaml.Node, str, Units], Any]
"""Reader of a value; None where it cannot be read."""

FORMAT_VERSION = 1
BASE_LINK = "base"
"""Parent of a branch that the base carries."""
_FRAME_TOLERANCES = ("x", "y", "z", "roll", "pitch", "yaw")
_DIGEST = re.compile("[0-9a-f]{64}")
_MAX_GRAVITY = 50.0
"""m/s^2: five times the earth's gravity; a larger number is likely in mm/s^2."""


def read_fields(
    section: YamlSection, kinds: Mapping[str, Kind], units: Units, required: Collection[str] = ()
) -> dict[str, Any]:
    """Return the values of a section's fields that it has; report the required ones that it lacks."""
    values = {}
    for key, kind in kinds.items():
        node = section.require(key) if key in required else section.get(key)
        value = None if node is None else kind(section.source, node, section.at(key), units)
        if value is not None:
            values[key] = value
    return values


def _section(kinds: Mapping[str, Kind], required: Collection[str] = ()) -> Kind:
    """Kind of a mapping with fields of these kinds."""

    def read(source: Source, node: yaml.Node, path: str, units: Units) -> dict[str, Any] | None:
        section = source.section(node, path, tuple(kinds))
        return None if section is None else read_fields(section, kinds, units, required)

    return read


def _text(source: Source, node: yaml.Node, path: str, _: Units) -> str | None:
    return source.text(node, path)


def _choice(*options: str) -> Kind:
    return lambda source, node, path, _: source.choice(node, path, options)


def _number(*checks: tuple[Callable[[float], bool], str, str | None]) -> Kind:
    """Kind of a number; each check has a test, the message where it fails (with ``{found}``), and how to repair it."""

    def read(source: Source, node: yaml.Node, path: str, _: Units) -> float | None:
        value = source.number(node, path)
        for is_good, message, fix in checks if value is not None else ():
            if not is_good(cast(float, value)):
                source.report(node, path, message.format(found=describe(node), value=value), fix)
                break
        return value

    return read


def _length(source: Source, node: yaml.Node, path: str, units: Units) -> float | None:
    return units.parameter(source, node, path, is_length=True)


def _angle(source: Source, node: yaml.Node, path: str, units: Units) -> float | None:
    return units.parameter(source, node, path, is_length=False)


def _position(source: Source, node: yaml.Node, path: str, units: Units) -> Vector | None:
    return units.vector(source, node, path)


def _frame(source: Source, node: yaml.Node, path: str, units: Units) -> Frame | None:
    section = source.section(node, path, ("xyz", "rpy"))
    return None if section is None else units.frame(section)


def _frame_with_tolerance(
    source: Source, node: yaml.Node, path: str, units: Units
) -> tuple[Frame, Mapping[str, float]] | None:
    section = source.section(node, path, ("xyz", "rpy", "tolerance"))
    return None if section is None else (units.frame(section), units.tolerances(section, _FRAME_TOLERANCES))


def _gravity(source: Source, node: yaml.Node, path: str, _: Units) -> tuple[float, ...] | None:
    values = source.numbers(node, path, 3)
    if values is not None and math.hypot(*values) > _MAX_GRAVITY:
        source.report(node, path, f"{list(values)} is too large for gravity", "it is always in m/s^2")
    return values


def _axis(source: Source, node: yaml.Node, path: str, _: Units) -> Vector | None:
    values = source.numbers(node, path, 3)
    axis = unit_axis(values) if values else None
    if values and axis is None:
        source.report(node, path, "the axis is zero and has no direction")
    return axis


def _limits(joint_type: JointType) -> Kind:
    def read(source: Source, node: yaml.Node, path: str, units: Units) -> tuple[float, float] | None:
        values = source.numbers(node, path, 2)
        if values is None:
            return None
        low, high = values
        if low > high:
            source.report(node, path, f"the lower limit {low:g} is above the upper limit {high:g}")
            return None
        unit = units.of_joint(joint_type)
        longest = max(map(abs, values)) * unit
        if joint_type == "prismatic" and unit == 1.0 and TRAVEL_IN_MM[0] < longest < TRAVEL_IN_MM[1]:
            fix = "it looks like mm: write length: mm under units"
            source.report(node, path, f"a travel of {longest:g} m is too long for an arm", fix)
        finite, problem = finite_limits(joint_type, (low * unit, high * unit))
        if problem is not None:
            source.report(node, path, problem, "leave limits out for a joint without limits")
        return finite

    return read


def _coupling(source: Source, node: yaml.Node, path: str, _: Units) -> dict[str, float] | None:
    """Return the coupling's ratios in the file's units."""
    if not isinstance(node, yaml.MappingNode) or not node.value:
        message = f"expected joints with their ratios, such as {{j2: 1.0}}, found {describe(node)}"
        source.report(node, path, message)
        return None
    return {name: source.number(value, f"{path}.{name}") or 0.0 for name, _, value in source.entries(node, path)}


def named_frames(message: str, *required: str) -> Kind:
    """Kind of frames by name; without keys that are ``required`` of each, there may be none.

    The ``message`` says what is expected, with ``{found}``.
    """

    def read(source: Source, node: yaml.Node, path: str, units: Units) -> dict[str, Frame] | None:
        if not isinstance(node, yaml.MappingNode) or (required and not node.value):
            source.report(node, path, message.format(found=describe(node)))
            return None
        frames: dict[str, Frame] = {}
        for name, _, value in source.entries(node, path):
            section = source.section(value, f"{path}.{name}", ("xyz", "rpy"))
            if section:
                for key in required:
                    section.require(key)
                frames[name] = units.frame(section)
        return frames

    return read


def _digests(source: Source, node: yaml.Node, path: str, _: Units) -> tuple[str, ...]:
    digests = []
    for i, item in enumerate(source.items(node, path, "SHA-256 of pose files")):
        # Not through text(): YAML reads digits alone as a number, so they are written in quotes.
        digest = item.value if isinstance(item, yaml.ScalarNode) else ""
        if not _DIGEST.fullmatch(digest):
            message = f"expected the SHA-256 of a pose file, 64 hexadecimal digits, found {describe(item)}"
            source.report(item, f"{path}[{i}]", message, "`write_model` writes it; do not change it")
        digests.append(digest)
    return tuple(digests)


def _plain(fix: str | None) -> Kind:
    """Kind of a mapping that is kept as it is."""

    def read(source: Source, node: yaml.Node, path: str, _: Units) -> Mapping[str, Any] | None:
        if not isinstance(node, yaml.MappingNode):
            source.report(node, path, f"expected keys with values, found {describe(node)}", fix)
            return None
        return cast(Mapping[str, Any], source.plain(node, path))

    return read


def _effects(source: Source, node: yaml.Node, path: str, units: Units) -> tuple[Mapping[str, Any], ...]:
    items = source.items(node, path, "effects")
    effects = (_plain(None)(source, item, f"{path}[{i}]", units) for i, item in enumerate(items))
    return tuple(effect for effect in effects if effect is not None)


# Fields of a robot file.

_SHARE = (
    lambda value: 0.0 <= value <= 1.0,
    "expected a share from 0 to 1, found {value:g}",
    "it is relative: 0.1 for 10 %",
)
_TARGETS = named_frames("expected names with xyz, found {found}", "xyz")
_ROBOT: dict[str, Kind] = {
    "base": _frame_with_tolerance,
    "tool": _frame_with_tolerance,
    "name": _text,
    "gravity": _gravity,
    "payload": _section({"com": _position}, ["com"]),
    "targets": _TARGETS,
    "effects": _effects,
    "base_link": _text,
    "tip_link": _text,
    "fitted_to": _digests,
    "campaign": _section(
        {
            "poses": _digests,
            "before": _section({"base": _frame, "tool": _frame, "targets": _TARGETS}),
            "effects": _effects,
        }
    ),
    "mass_uncertainty": _number(_SHARE),
    "fit": _plain("`write_model` writes it"),
    "identity": _section(dict.fromkeys(IDENTITY, _text)),
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

_LINK: dict[str, Kind] = {
    "mass": _number((lambda value: value >= 0, "a mass cannot be negative, found {found}", None)),
    "com": _position,
}
_DRIVE: dict[str, Kind] = {
    "sign": _number((lambda value: abs(value) == 1, "expected 1 or -1, found {found}", None)),
    "gear_ratio": _number(
        (
            lambda value: value >= 0,
            "expected a positive number, found {found}",
            "write sign: -1 where the motor turns the other way",
        ),
        (lambda value: value > 0, "expected a positive number, found {found}", None),
    ),
    "coupling": _coupling,
    "passive": _choice("true", "false"),
}
_MIMIC: dict[str, Kind] = {"mimic": _section({"joint": _text, "multiplier": _number(), "offset": _number()}, ["joint"])}
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
    is_urdf = convention == "urdf"
    type_of = {"type": _choice(*_TYPES, "fixed") if is_urdf else _choice(*_TYPES)}
    kind = read_fields(section, type_of, units, ["type"]).get("type")
    if kind is None:
        return None
    joint_type = cast(JointType, "revolute" if kind == "continuous" else kind)
    variable = _length if joint_type == "prismatic" else _angle
    if is_urdf:
        parameters: dict[str, Kind] = {"origin": _frame, "offset": variable}
        required = {"axis"} if kind != "fixed" else set()
    else:
        # The variable's own parameter is an offset and zero by default, as is beta, which a plain table does not have.
        parameters = {name: _length if name in LENGTH_PARAMETERS else _angle for name in DH_PARAMETERS}
        required = set(DH_PARAMETERS) - {"beta", "theta" if joint_type == "revolute" else "d"}
    moving = {"axis": _axis, "limits": _limits(joint_type)} if kind != "fixed" else {}
    kinds = {"name": _text, "link": _text, **_LINK, **parameters, **moving, **_DRIVE, **_MIMIC}
    values = read_fields(section, kinds, units, required)
    is_passive = values.pop("passive", None) == "true"
    has = section.values
    checks = [
        (
            kind == "continuous" and "limits" in has,
            "limits",
            "a continuous joint has no limits",
            "make its type revolute",
        ),
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
            (kind == "fixed" and key not in (*_FIXED_KEYS, "parent"), key, "a fixed joint does not have this key", None)
            for key in has
        ),
    ]
    for is_wrong, key, message, fix in checks:
        if is_wrong:
            section.source.report(has[key], section.at(key), message, fix)
    names = ORIGIN_PARAMETERS if is_urdf else DH_PARAMETERS
    origin = values.pop("origin", Frame())
    found = dict(zip(_FRAME_TOLERANCES, (*origin.xyz, *origin.rpy), strict=True))
    found |= {name: values.pop(name) for name in names if name in values}
    lengths = LENGTH_PARAMETERS | ({"offset"} if is_urdf and joint_type == "prismatic" else set())
    mimic = values.pop("mimic", None)
    return Joint(
        type=joint_type,
        parameters={name: found.get(name, 0.0) for name in names},
        is_continuous=kind == "continuous",
        tolerance=units.tolerances(section, names, lengths),
        is_passive=is_passive,
        mimic=None if mimic is None else Mimic(mimic.pop("joint", ""), **mimic),
        **{"name": f"j{index + 1}", **values, "sign": -1 if values.get("sign") == -1 else 1},
    )


def _check_count(source: Source, node: yaml.Node, key: str, count: int) -> bool:
    """Return whether a list has no more than :data:`MAX_JOINTS` joints; report a longer one."""
    if count > MAX_JOINTS:
        source.report(node, key, f"found {count} joints, expected at most {MAX_JOINTS}")
    return count <= MAX_JOINTS


def _read_joints(top: YamlSection, convention: Convention, units: Units) -> tuple[Joint, ...]:
    source = top.source
    node = top.require("joints")
    if node is None:
        return ()
    items = source.items(node, "joints", "joints")
    if isinstance(node, yaml.SequenceNode) and not items:
        source.report(node, "joints", "a robot needs at least one joint")
    if not _check_count(source, node, "joints", len(items)):
        return ()
    joints: list[Joint] = []
    lines: dict[str, int] = {}
    for i, item in enumerate(items):
        section = source.section(item, f"joints[{i}]", _KEYS[convention])
        joint = _read_joint(section, i, convention, units) if section else None
        if joint is None:
            continue
        if joint.name in lines:
            message = f"{joint.name!r} is already the name of the joint in line {lines[joint.name]}"
            source.report(item, f"joints[{i}].name", message)
        lines.setdefault(joint.name, item.start_mark.line + 1)
        if joint.link and any(joint.link == other.link for other in joints):
            source.report(item, f"joints[{i}].link", f"an earlier joint already moves {joint.link!r}")
        joints.append(joint)
    if len(joints) < len(items):
        return ()
    if items and not any(joint.is_variable for joint in joints):
        source.report(node, "joints", "no joint moves: all are fixed or follow another")
    return tuple(_followers(source, joints, items, units))


def _followers(
    source: Source,
    joints: Sequence[Joint],
    nodes: Sequence[yaml.Node],
    units: Units,
    masters: Sequence[Joint] = (),
    key: str = "joints",
) -> list[Joint]:
    """Return the joints with their mimics and couplings in SI units; report those that follow no joint variable.

    Each joint of the list ``key`` of the file follows others of it, or of ``masters``.
    """
    by_name = {joint.name: joint for joint in (*masters, *joints)}
    variables = [name for name, joint in by_name.items() if joint.is_variable]
    resolved = []
    for i, joint in enumerate(joints):
        mimic, unit = joint.mimic, units.of_joint(joint.type)
        if mimic is not None and mimic.master:
            master = by_name.get(mimic.master)
            if master is None or not master.is_variable:
                reason = "is fixed" if master and master.type == "fixed" else "follows another joint itself"
                reason = "is not a joint of this robot" if master is None else reason
                message = f"{joint.name!r} follows {mimic.master!r}, which {reason}"
                source.report(nodes[i], f"{key}[{i}].mimic.joint", message)
            else:
                ratio = mimic.multiplier * (unit / units.of_joint(master.type))
                joint = replace(joint, mimic=Mimic(master.name, ratio, mimic.offset * unit))
        for name in joint.coupling:
            if name not in variables or name == joint.name:
                known = ", ".join(other for other in variables if other != joint.name)
                message = f"{name!r} is not another joint with a variable; there are {known or 'none'}"
                source.report(nodes[i], f"{key}[{i}].coupling.{name}", message)
        ratios = {
            name: ratio * (unit / units.of_joint(by_name[name].type))
            for name, ratio in joint.coupling.items()
            if name in variables
        }
        resolved.append(replace(joint, coupling=ratios))
    return resolved


def _read_branches(top: YamlSection, joints: Sequence[Joint], units: Units) -> tuple[BranchJoint, ...]:
    """Return the joints outside the chain of the key ``branches``; each parent must be ``base`` or an earlier joint.

    A joint may follow another one outside the chain, or a joint of the chain.
    """
    node, source = top.get("branches"), top.source
    if node is None:
        return ()
    names = {joint.name for joint in joints}
    branches, nodes = [], []
    for i, item in enumerate(source.items(node, "branches", "joints outside the chain")):
        section = source.section(item, f"branches[{i}]", _BRANCH_KEYS)
        if section is None:
            continue
        section.require("name")
        joint = _read_joint(section, i, "urdf", units)
        parent = read_fields(section, {"parent": _text}, units, ["parent"]).get("parent")
        if joint is None:
            continue
        position = 0.0
        if (place := section.get("position")) is not None and joint.mimic:
            message = "a joint that follows another has no position of its own"
            source.report(place, section.at("position"), message)
        else:
            kind = _length if joint.type == "prismatic" else _angle
            position = read_fields(section, {"position": kind}, units).get("position", 0.0)
        if joint.name in names or joint.name == BASE_LINK:
            message = f"{joint.name!r} is already the name of a joint or of the base"
            source.report(item, section.at("name"), message)
        if parent not in (None, BASE_LINK) and parent not in names:
            message = f"{parent!r} is neither {BASE_LINK} nor a joint in front of it"
            source.report(item, section.at("parent"), message, f"there are {', '.join(sorted(names))}")
        names.add(joint.name)
        branches.append(BranchJoint(joint, None if parent == BASE_LINK else parent, position))
        nodes.append(item)
    _check_count(source, node, "branches", len(branches))
    beside = _followers(source, [branch.joint for branch in branches], nodes, units, joints, "branches")
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
    node = top.require("convention")
    convention = node and source.choice(node, "convention", ("standard", "modified", "urdf"))
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
        values[key], values[f"{key}_tolerance"] = values.get(key, (Frame(), {}))
    if (campaign := values.get("campaign")) is not None:
        before = campaign.pop("before", {})
        values["campaign"] = Campaign(campaign.pop("poses", ()), **before, **campaign)
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
        check_likely_units(robot, units, top)
    source.finish()
    return robot


def _check_version(top: YamlSection) -> None:
    node = top.values.get("robacc")
    if node is None:
        fix = f"write 'robacc: {FORMAT_VERSION}' as the first line"
        top.source.report(None, "robacc", "the format version is missing, so this is not a robot file of robacc", fix)
    elif not isinstance(node, yaml.ScalarNode) or node.value != str(FORMAT_VERSION):
        top.source.report(node, "robacc", f"expected format version {FORMAT_VERSION}, found {describe(node)}")


def effect_lines(document_text: str, file: str) -> dict[str, int]:
    """Return the line of each entry of ``effects:`` by its dotted key; :func:`parse_robot` has checked the document."""
    top = Source(file).section(compose(document_text, file), "", _TOP_KEYS)
    node = top and top.get("effects")
    items = node.value if isinstance(node, yaml.SequenceNode) else ()
    return {effect_key(i): item.start_mark.line + 1 for i, item in enumerate(items)}
