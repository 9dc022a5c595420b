"""Read a robot file (YAML) into a robot: its joints, chain and branches; problems have line numbers."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, compose, describe
from robacc.robots.description import (
    DH_PARAMETERS,
    IDENTITY,
    LENGTH_PARAMETERS,
    MAX_JOINTS,
    ORIGIN_PARAMETERS,
    STANDARD_GRAVITY,
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
    read_identity,
)
from robacc.robots.yaml_units import Units, check_likely_units, finite_limits

# Read a joint of a robot file.

_LINK_KEYS = ("mass", "com", "tolerance")
_DRIVE_KEYS = ("limits", "sign", "gear_ratio", "coupling", "passive")
_FIXED_KEYS = ("name", "type", "origin", "link", *_LINK_KEYS)
_KEYS = {
    "standard": ("name", "type", *DH_PARAMETERS, *_DRIVE_KEYS, *_LINK_KEYS),
    "modified": ("name", "type", *DH_PARAMETERS, *_DRIVE_KEYS, *_LINK_KEYS),
    "urdf": (*_FIXED_KEYS, "axis", "offset", "mimic", *_DRIVE_KEYS),
}
_BRANCH_KEYS = (
    *("name", "parent", "type", "origin", "link", "mass", "com"),
    *("axis", "offset", "position", "limits", "sign", "mimic"),
)
BASE_LINK = "base"
"""Parent of a branch that the base carries."""
_DH_TYPES = ("revolute", "prismatic", "continuous")
_MIN_AXIS = 1e-9
"""An axis shorter than this has no direction."""
_UNIT_AXIS = 1e-12
"""An axis this near to unit length keeps its numbers, so that a file written and read again is the same."""


def read_joint(source: Source, node: yaml.Node, index: int, convention: Convention, units: Units) -> Joint | None:
    """Return the joint of a list entry, None where it cannot be read; ``source`` collects problems."""
    section = source.section(node, f"joints[{index}]", _KEYS[convention])
    return _read_joint(section, index, convention, units) if section else None


def read_branch(source: Source, node: yaml.Node, index: int, units: Units) -> BranchJoint | None:
    """Return the joint outside the chain of a list entry, None where it cannot be read."""
    section = source.section(node, f"branches[{index}]", _BRANCH_KEYS)
    if section is None:
        return None
    section.require("name")
    joint = _read_joint(section, index, "urdf", units)
    parent_node, position_node = section.require("parent"), section.get("position")
    parent = source.text(parent_node, section.at("parent")) if parent_node else None
    position = 0.0
    if joint and position_node and joint.mimic:
        source.report(position_node, section.at("position"), "a joint that follows another has no position of its own")
    elif joint and position_node:
        is_length = joint.type == "prismatic"
        position = units.parameter(source, position_node, section.at("position"), is_length=is_length) or 0.0
    return BranchJoint(joint, None if parent == BASE_LINK else parent, position) if joint else None


def _read_joint(section: YamlSection, index: int, convention: Convention, units: Units) -> Joint | None:
    source = section.source
    types = (*_DH_TYPES, "fixed") if convention == "urdf" else _DH_TYPES
    type_node = section.require("type")
    kind = source.choice(type_node, section.at("type"), types) if type_node else None
    if kind is None:
        return None
    joint_type = cast(JointType, "revolute" if kind == "continuous" else kind)
    _check_keys_of_type(section, kind)
    name_node = section.get("name")
    name = source.text(name_node, section.at("name")) if name_node else f"j{index + 1}"
    link = section.get("link")
    mass, com = _read_mass(section, units)
    read_parameters = _read_origin if convention == "urdf" else _read_dh
    return Joint(
        name=name or f"j{index + 1}",
        type=joint_type,
        parameters=read_parameters(section, joint_type, units),
        axis=_read_axis(section) if convention == "urdf" and joint_type != "fixed" else (0.0, 0.0, 1.0),
        limits=_read_limits(section, joint_type, units),
        is_continuous=kind == "continuous",
        sign=_read_sign(section),
        gear_ratio=_read_gear_ratio(section),
        mass=mass,
        com=com,
        tolerance=_read_tolerance(section, joint_type, convention, units),
        mimic=_read_mimic(section),
        coupling=_read_coupling(section),
        is_passive=_read_passive(section),
        link=source.text(link, section.at("link")) if link else None,
    )


def _check_keys_of_type(section: YamlSection, kind: str) -> None:
    for key in section.values:
        if kind == "fixed" and key not in (*_FIXED_KEYS, "parent"):
            section.source.report(section.values[key], section.at(key), "a fixed joint does not have this key")
    if kind == "continuous" and "limits" in section.values:
        message = "a continuous joint has no limits"
        section.source.report(section.values["limits"], section.at("limits"), message, "make its type revolute")


def _read_dh(section: YamlSection, joint_type: JointType, units: Units) -> dict[str, float]:
    # The variable's own parameter is an offset and zero by default, as is beta, which a plain table does not have.
    optional = {"beta", "theta" if joint_type == "revolute" else "d"}
    values = dict.fromkeys(DH_PARAMETERS, 0.0)
    for name in DH_PARAMETERS:
        node = section.get(name) if name in optional else section.require(name)
        if node:
            is_length = name in LENGTH_PARAMETERS
            values[name] = units.parameter(section.source, node, section.at(name), is_length=is_length) or 0.0
    return values


def _read_origin(section: YamlSection, joint_type: JointType, units: Units) -> dict[str, float]:
    node = section.get("origin")
    origin = node and section.source.section(node, section.at("origin"), ("xyz", "rpy"))
    values = dict.fromkeys(ORIGIN_PARAMETERS, 0.0)
    if origin:
        frame = units.frame(origin)
        values |= dict(zip(ORIGIN_PARAMETERS, (*frame.xyz, *frame.rpy), strict=False))
    offset = section.get("offset")
    if offset:
        is_length = joint_type == "prismatic"
        values["offset"] = units.parameter(section.source, offset, section.at("offset"), is_length=is_length) or 0.0
    return values


def _read_tolerance(
    section: YamlSection, joint_type: JointType, convention: Convention, units: Units
) -> dict[str, float]:
    if convention != "urdf":
        return units.tolerances(section, DH_PARAMETERS)
    lengths = LENGTH_PARAMETERS | ({"offset"} if joint_type == "prismatic" else set())
    return units.tolerances(section, ORIGIN_PARAMETERS, lengths)


def _read_axis(section: YamlSection) -> Vector:
    node = section.require("axis")
    values = section.source.numbers(node, section.at("axis"), 3) if node else None
    if values is None:
        return (0.0, 0.0, 1.0)
    length = math.hypot(*values)
    if length < _MIN_AXIS:
        section.source.report(node, section.at("axis"), "the axis is zero and has no direction")
        return (0.0, 0.0, 1.0)
    if abs(length - 1) < _UNIT_AXIS:
        return cast(Vector, values)
    return (values[0] / length, values[1] / length, values[2] / length)


def _read_limits(section: YamlSection, joint_type: JointType, units: Units) -> tuple[float, float] | None:
    node = section.get("limits")
    path = section.at("limits")
    values = section.source.numbers(node, path, 2) if node else None
    if values is None:
        return None
    if values[0] > values[1]:
        section.source.report(node, path, f"the lower limit {values[0]:g} is above the upper limit {values[1]:g}")
        return None
    if joint_type == "fixed":  # it has no limits, and the problem is reported already
        return None
    if node and joint_type == "prismatic":
        limits = units.travel(section.source, node, path, (values[0], values[1]))
    else:
        limits = (values[0] * units.angle, values[1] * units.angle)
    finite, problem = finite_limits(joint_type, limits)
    if problem is not None:
        section.source.report(node, path, problem, "leave limits out for a joint without limits")
    return finite


def _read_sign(section: YamlSection) -> Literal[1, -1]:
    node = section.get("sign")
    value = section.source.number(node, section.at("sign")) if node else None
    if node and value is not None and abs(value) != 1:
        section.source.report(node, section.at("sign"), f"expected 1 or -1, found {describe(node)}")
    return -1 if value == -1 else 1


def _read_gear_ratio(section: YamlSection) -> float | None:
    node = section.get("gear_ratio")
    value = section.source.number(node, section.at("gear_ratio")) if node else None
    if node and value is not None and value <= 0:
        fix = "write sign: -1 where the motor turns the other way" if value < 0 else None
        section.source.report(
            node, section.at("gear_ratio"), f"expected a positive number, found {describe(node)}", fix
        )
    return value


def _read_mass(section: YamlSection, units: Units) -> tuple[float | None, Vector | None]:
    source, node, com_node = section.source, section.get("mass"), section.get("com")
    mass = source.number(node, section.at("mass")) if node else None
    if node and mass is not None and mass < 0:
        source.report(node, section.at("mass"), f"a mass cannot be negative, found {describe(node)}")
    com = units.position(source, com_node, section.at("com")) if com_node else None
    if com_node and not node:
        source.report(com_node, section.at("com"), "a centre of mass needs a mass", "add the link's mass in kg")
    return mass, com


def _read_mimic(section: YamlSection) -> Mimic | None:
    node = section.get("mimic")
    inner = node and section.source.section(node, section.at("mimic"), ("joint", "multiplier", "offset"))
    if not inner:
        return None
    master_node = inner.require("joint")
    master = inner.source.text(master_node, inner.at("joint")) if master_node else None
    values = {"multiplier": 1.0, "offset": 0.0}
    for key in values:
        item = inner.get(key)
        number = inner.source.number(item, inner.at(key)) if item else None
        values[key] = values[key] if number is None else number
    return Mimic(master or "", values["multiplier"], values["offset"])


def _read_coupling(section: YamlSection) -> dict[str, float]:
    """Return the coupling's ratios in the file's units."""
    node = section.get("coupling")
    if node is None:
        return {}
    if not isinstance(node, yaml.MappingNode) or not node.value:
        message = f"expected joints with their ratios, such as {{j2: 1.0}}, found {describe(node)}"
        section.source.report(node, section.at("coupling"), message)
        return {}
    if "mimic" in section.values:
        section.source.report(node, section.at("coupling"), "cannot be combined with mimic", "list the joint here too")
    ratios: dict[str, float] = {}
    for name, _, value in section.source.entries(node, section.at("coupling")):
        ratio = section.source.number(value, f"{section.at('coupling')}.{name}")
        ratios[name] = 0.0 if ratio is None else ratio
    return ratios


def _read_passive(section: YamlSection) -> bool:
    node = section.get("passive")
    if node is None:
        return False
    choice = section.source.choice(node, section.at("passive"), ("true", "false"))
    if choice == "true" and "coupling" not in section.values:
        message = "a passive joint moves by its coupling alone, and there is none"
        section.source.report(node, section.at("passive"), message, "add coupling, such as {j2: -1.0, j3: -1.0}")
    return choice == "true"


def resolve_couplings(
    source: Source, joints: Sequence[Joint], nodes: Sequence[yaml.Node], units: Units
) -> tuple[Joint, ...]:
    """Return the joints with their couplings in SI units; report couplings to what is no other joint variable."""
    variables = {joint.name: joint for joint in joints if joint.is_variable}
    resolved = []
    for i, joint in enumerate(joints):
        ratios: dict[str, float] = {}
        for name, ratio in joint.coupling.items():
            other = variables.get(name)
            if other is None or name == joint.name:
                known = ", ".join(key for key in variables if key != joint.name)
                message = f"{name!r} is not another joint with a variable; there are {known or 'none'}"
                source.report(nodes[i], f"joints[{i}].coupling.{name}", message)
                continue
            unit, other_unit = (units.length if item.type == "prismatic" else units.angle for item in (joint, other))
            ratios[name] = ratio * (unit / other_unit)
        resolved.append(dataclasses.replace(joint, coupling=ratios))
    return tuple(resolved)


def resolve_mimics(
    source: Source,
    joints: Sequence[Joint],
    nodes: Sequence[yaml.Node],
    units: Units,
    masters: Sequence[Joint] = (),
    key: str = "joints",
) -> tuple[Joint, ...]:
    """Return the joints with their mimics in SI units; report mimics that follow no joint with a variable.

    Each joint of the list ``key`` of the file follows another one of it, or one of ``masters``.
    """
    by_name = {joint.name: joint for joint in (*masters, *joints)}
    resolved = []
    for i, joint in enumerate(joints):
        if joint.mimic is None or not joint.mimic.master:
            resolved.append(joint)
            continue
        path, master = f"{key}[{i}].mimic.joint", by_name.get(joint.mimic.master)
        if master is None:
            message = f"{joint.name!r} follows {joint.mimic.master!r}, which is not a joint of this robot"
            source.report(nodes[i], path, message)
        elif not master.is_variable:
            kind = "is fixed" if master.type == "fixed" else "follows another joint itself"
            source.report(nodes[i], path, f"{joint.name!r} follows {master.name!r}, which {kind}")
        else:
            unit = units.length if joint.type == "prismatic" else units.angle
            master_unit = units.length if master.type == "prismatic" else units.angle
            mimic = Mimic(master.name, joint.mimic.multiplier * (unit / master_unit), joint.mimic.offset * unit)
            joint = dataclasses.replace(joint, mimic=mimic)
        resolved.append(joint)
    return tuple(resolved)


# Read the joints outside the chain of a robot file: what else the arm's links carry and what moves it.


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


FORMAT_VERSION = 1

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
_FRAME_TOLERANCES = ("x", "y", "z", "roll", "pitch", "yaw")
_DIGEST = re.compile("[0-9a-f]{64}")
_MAX_GRAVITY = 50.0
"""m/s^2: five times the earth's gravity; a larger number is likely in mm/s^2."""


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
    units = _read_units(top)
    convention = _read_choice(top, "convention", ("standard", "modified", "urdf"))
    if units is None or convention is None:
        # Without them the other keys cannot be checked; any problem reported would be false.
        source.finish()
    robot = replace(_read_robot(top, cast(Units, units), cast(Convention, convention)), file_text=document_text)
    if not source.problems:
        check_likely_units(robot, cast(Units, units), top)
    source.finish()
    return robot


def file_units(document_text: str, file: str) -> Units:
    """Return the units of a robot file that :func:`parse_robot` has read before."""
    top = Source(file).section(compose(document_text, file), "", _TOP_KEYS)
    return cast(Units, top and _read_units(top))


def _read_robot(top: YamlSection, units: Units, convention: Convention) -> Robot:
    joints = _read_joints(top, convention, units)
    base, base_tolerance = _read_frame(top, "base", units)
    tool, tool_tolerance = _read_frame(top, "tool", units)
    return Robot(
        name=_read_text(top, "name") or Path(top.source.file).stem,
        convention=convention,
        joints=joints,
        branches=read_branches(top, joints, units),
        base=base,
        tool=tool,
        gravity=_read_gravity(top),
        payload_com=_read_payload(top, units),
        targets=_read_targets(top, units),
        effects=_read_effects(top),
        effect_units=(units.length, units.angle),
        base_tolerance=base_tolerance,
        tool_tolerance=tool_tolerance,
        base_link=_read_text(top, "base_link"),
        tip_link=_read_text(top, "tip_link"),
        fitted_to=_read_digests(top, "fitted_to"),
        campaign=_read_campaign(top, units),
        mass_uncertainty=_read_mass_uncertainty(top),
        fit=_read_fit(top),
        identity=_read_identity(top),
    )


def _check_version(top: YamlSection) -> None:
    node = top.values.get("robacc")
    if node is None:
        fix = f"write 'robacc: {FORMAT_VERSION}' as the first line"
        top.source.report(None, "robacc", "the format version is missing, so this is not a robot file of robacc", fix)
    elif not isinstance(node, yaml.ScalarNode) or node.value != str(FORMAT_VERSION):
        top.source.report(node, "robacc", f"expected format version {FORMAT_VERSION}, found {describe(node)}")


def _read_units(top: YamlSection) -> Units | None:
    node = top.require("units")
    section = node and top.source.section(node, "units", ("length", "angle"))
    if not section:
        return None
    length = _read_choice(section, "length", ("m", "mm"))
    angle = _read_choice(section, "angle", ("rad", "deg"))
    return Units.of(length, angle) if length and angle else None


def _read_choice(section: YamlSection, key: str, options: Sequence[str]) -> str | None:
    node = section.require(key)
    return section.source.choice(node, section.at(key), options) if node else None


def _read_text(section: YamlSection, key: str) -> str | None:
    node = section.get(key)
    return section.source.text(node, section.at(key)) if node else None


def _read_gravity(top: YamlSection) -> Vector:
    node = top.get("gravity")
    values = top.source.numbers(node, "gravity", 3) if node else None
    if values is None:
        return STANDARD_GRAVITY
    if sum(value * value for value in values) > _MAX_GRAVITY**2:
        top.source.report(node, "gravity", f"{list(values)} is too large for gravity", "it is always in m/s^2")
    return cast(Vector, values)


def _read_frame(top: YamlSection, key: str, units: Units) -> tuple[Frame, Mapping[str, float]]:
    node = top.get(key)
    section = node and top.source.section(node, key, ("xyz", "rpy", "tolerance"))
    if not section:
        return Frame(), {}
    return units.frame(section), units.tolerances(section, _FRAME_TOLERANCES)


def _read_payload(top: YamlSection, units: Units) -> Vector | None:
    node = top.get("payload")
    section = node and top.source.section(node, "payload", ("com",))
    com = section.require("com") if section else None
    return units.position(top.source, com, "payload.com") if com else None


def _read_targets(top: YamlSection, units: Units) -> dict[str, Frame]:
    node = top.get("targets")
    if node is None:
        return {}
    source = top.source
    if not isinstance(node, yaml.MappingNode) or not node.value:
        source.report(node, "targets", f"expected names with xyz, found {describe(node)}")
        return {}
    if "tool" in top.values:
        source.report(node, "targets", "cannot be combined with tool", "list the tool as a target")
    targets: dict[str, Frame] = {}
    for name, _, value in source.entries(node, "targets"):
        section = source.section(value, f"targets.{name}", ("xyz", "rpy"))
        if section:
            section.require("xyz")
            targets[name] = units.frame(section)
    return targets


def _read_mass_uncertainty(top: YamlSection) -> float | None:
    node = top.get("mass_uncertainty")
    value = top.source.number(node, "mass_uncertainty") if node else None
    if value is not None and not 0.0 <= value <= 1.0:
        fix = "it is relative: 0.1 for 10 %"
        top.source.report(node, "mass_uncertainty", f"expected a share from 0 to 1, found {value:g}", fix)
    return value


def _read_campaign(top: YamlSection, units: Units) -> Campaign | None:
    node = top.get("campaign")
    section = node and top.source.section(node, "campaign", ("poses", "before", "effects"))
    if not section:
        return None
    before_node = section.get("before")
    before = before_node and top.source.section(before_node, "campaign.before", ("base", "tool", "targets"))
    frames: dict[str, Frame | None] = {"base": None, "tool": None}
    for key in frames:
        frame = before.get(key) if before else None
        frame_section = frame and top.source.section(frame, f"campaign.before.{key}", ("xyz", "rpy"))
        if frame_section:
            frames[key] = units.frame(frame_section)
    return Campaign(
        poses=_read_digests(section, "poses"),
        base=frames["base"],
        tool=frames["tool"],
        targets=_read_targets(before, units) if before else {},
        effects=_read_effects(section),
    )


def _read_digests(top: YamlSection, key: str) -> tuple[str, ...]:
    node = top.get(key)
    digests = []
    for i, item in enumerate(top.source.items(node, top.at(key), "SHA-256 of pose files") if node else ()):
        # Not through text(): YAML reads digits alone as a number, so they are written in quotes.
        digest = item.value if isinstance(item, yaml.ScalarNode) else ""
        if not _DIGEST.fullmatch(digest):
            message = f"expected the SHA-256 of a pose file, 64 hexadecimal digits, found {describe(item)}"
            top.source.report(item, f"{top.at(key)}[{i}]", message, "`write_model` writes it; do not change it")
        digests.append(digest)
    return tuple(digests)


def _read_identity(top: YamlSection) -> dict[str, str]:
    node = top.get("identity")
    section = node and top.source.section(node, "identity", tuple(IDENTITY))
    return read_identity(section) if section else {}


def _read_fit(top: YamlSection) -> Mapping[str, Any] | None:
    node = top.get("fit")
    if node is None:
        return None
    if not isinstance(node, yaml.MappingNode):
        top.source.report(node, "fit", f"expected keys with values, found {describe(node)}", "`write_model` writes it")
        return None
    fit: Mapping[str, Any] = top.source.plain(node, "fit")
    return fit


def _read_joints(top: YamlSection, convention: Convention, units: Units) -> tuple[Joint, ...]:
    source = top.source
    node = top.require("joints")
    if node is None:
        return ()
    items = source.items(node, "joints", "joints")
    if isinstance(node, yaml.SequenceNode) and not items:
        source.report(node, "joints", "a robot needs at least one joint")
    if len(items) > MAX_JOINTS:
        source.report(node, "joints", f"found {len(items)} joints, expected at most {MAX_JOINTS}")
        return ()
    joints: list[Joint] = []
    lines: dict[str, int] = {}
    complete = True
    for i, item in enumerate(items):
        joint = read_joint(source, item, i, convention, units)
        if joint is None:
            complete = False
            continue
        if joint.name in lines:
            message = f"{joint.name!r} is already the name of the joint in line {lines[joint.name]}"
            source.report(item, f"joints[{i}].name", message)
        lines.setdefault(joint.name, item.start_mark.line + 1)
        if joint.link and any(joint.link == other.link for other in joints):
            source.report(item, f"joints[{i}].link", f"an earlier joint already moves {joint.link!r}")
        joints.append(joint)
    if complete and items and not any(joint.is_variable for joint in joints):
        source.report(node, "joints", "no joint moves: all are fixed or follow another")
    if not complete:
        return ()
    return resolve_couplings(source, resolve_mimics(source, joints, items, units), items, units)


def _read_effects(top: YamlSection) -> tuple[Mapping[str, Any], ...]:
    node = top.get("effects")
    if node is None:
        return ()
    effects: list[Mapping[str, Any]] = []
    for i, item in enumerate(top.source.items(node, top.at("effects"), "effects")):
        path = top.at(effect_key(i))
        if isinstance(item, yaml.MappingNode):
            effects.append(top.source.plain(item, path))
        else:
            top.source.report(item, path, f"expected keys with values, found {describe(item)}")
    return tuple(effects)


def effect_lines(document_text: str, file: str) -> dict[str, int]:
    """Return the line of each entry of ``effects:`` by its dotted key; :func:`parse_robot` has checked the document."""
    top = Source(file).section(compose(document_text, file), "", _TOP_KEYS)
    node = top and top.get("effects")
    items = node.value if isinstance(node, yaml.SequenceNode) else ()
    return {effect_key(i): item.start_mark.line + 1 for i, item in enumerate(items)}
