"""Read a robot file (YAML) into a :class:`~robacc.robots.description.Robot`; problems have lines and keys."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, compose, describe
from robacc.robots.description import (
    MAX_JOINTS,
    STANDARD_GRAVITY,
    Campaign,
    Convention,
    Frame,
    Joint,
    Robot,
    Vector,
    effect_key,
)
from robacc.robots.identity import IDENTITY, read_identity
from robacc.robots.yaml_branches import read_branches
from robacc.robots.yaml_joint import read_joint, resolve_couplings, resolve_mimics
from robacc.robots.yaml_units import Units, check_likely_units
from robacc.robots.yaml_writer import robot_to_yaml

__all__ = ["FORMAT_VERSION", "parse_robot", "robot_to_yaml"]

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
