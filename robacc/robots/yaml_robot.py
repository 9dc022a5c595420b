"""Robot files (YAML): their fields as data, which read and check them, their units, and their writer.

Problems of a file have line numbers and dotted keys. Its numbers are in its own units, those of a robot in m and rad.
"""

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, describe, top_section
from robacc.quantities import significant
from robacc.robots.description import (
    DH_PARAMETERS,
    FRAME_PARAMETERS,
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


# Kinds of values: each reads a node, and reports what is wrong with it at its dotted key.

Kind = Callable[[Source, yaml.Node, str], Any]
"""Reader of a value; None where it cannot be read. ``units`` of the source are those of its numbers."""
Check = tuple[Callable[[Any], bool], str, str | None]
"""Test of a value, the message where it fails (with ``{found}`` or ``{value}``), and how to repair it."""


def read_fields(section: YamlSection, kinds: Mapping[str, Kind], required: Collection[str] = ()) -> dict[str, Any]:
    """Return the values of a section's fields that it has; report the required ones that it lacks."""
    nodes = {key: section.require(key) if key in required else section.get(key) for key in kinds}
    values = {key: kinds[key](section.source, node, section.at(key)) for key, node in nodes.items() if node is not None}
    return {key: value for key, value in values.items() if value is not None}


def read_section(
    source: Source,
    node: yaml.Node,
    path: str,
    *,
    kinds: Mapping[str, Kind],
    required: Collection[str] = (),
    into: Callable[..., Any] = dict,
) -> Any:
    """Read a mapping with fields of ``kinds``, which ``into`` takes by their keys."""
    section = source.section(node, path, tuple(kinds))
    return None if section is None else into(**read_fields(section, kinds, required))


def _named(
    source: Source, node: yaml.Node, path: str, *, kind: Kind, message: str, empty: bool = False
) -> dict[str, Any] | None:
    """Read a mapping of names to values of a kind; the ``message`` says what is expected, with ``{found}``."""
    if not isinstance(node, yaml.MappingNode) or not (empty or node.value):
        source.report(node, path, message.format(found=describe(node)))
        return None
    values = ((name, kind(source, value, f"{path}.{name}")) for name, _, value in source.entries(node, path))
    return {name: value for name, value in values if value is not None}


def read_list(source: Source, node: yaml.Node, path: str, *, kind: Kind, item_name: str) -> tuple[Any, ...]:
    """Read a list of values of a kind."""
    values = [kind(source, item, f"{path}[{i}]") for i, item in enumerate(source.items(node, path, item_name))]
    return tuple(value for value in values if value is not None)


def read_size(source: Source, node: yaml.Node, path: str, *, is_length: bool) -> float | None:
    """Read a length in m or an angle in rad; report a value that is too large, with the likely cause."""
    value, units = source.number(node, path), cast(Units, source.units)
    unit, most = (units.length, MAX_LENGTH) if is_length else (units.angle, TURN)
    if value is None or abs(value) * unit <= most:
        return None if value is None else value * unit
    message = f"is {abs(value) * unit:g} m, too long for an arm"
    fix = "it looks like mm: write length: mm under units"
    if not is_length:
        message = f"{'rad' if unit == 1.0 else 'deg'} is more than a turn"
        fix = "it looks like degrees: write angle: deg under units"
    source.report(node, path, f"{value:g} {message}", fix if unit == 1.0 else None)
    return None


_length: Kind = partial(read_size, is_length=True)
_angle: Kind = partial(read_size, is_length=False)
_lengths = partial(Source.numbers, count=3, kind=_length)


def _checked(source: Source, node: yaml.Node, path: str, *, kind: Kind, checks: Iterable[Check]) -> Any:
    """Read a value of a kind, and report the first check that it fails."""
    value = kind(source, node, path)
    failed = (check for check in checks if value is not None and not check[0](value))
    for _, message, fix in list(failed)[:1]:
        source.report(node, path, message.format(found=describe(node), value=value), fix)
    return value


def _axis(source: Source, node: yaml.Node, path: str) -> Vector | None:
    values = source.numbers(node, path, 3)
    axis = unit_axis(values) if values else None
    if values and axis is None:
        source.report(node, path, "the axis is zero and has no direction")
    return axis


def _limits(source: Source, node: yaml.Node, path: str, *, joint_type: JointType) -> tuple[float, float] | None:
    values = source.numbers(node, path, 2)
    if values is None:
        return None
    low, high = values
    if low > high:
        source.report(node, path, f"the lower limit {low:g} is above the upper limit {high:g}")
        return None
    unit, longest = cast(Units, source.units).of_joint(joint_type), max(map(abs, values))
    if joint_type == "prismatic" and unit == 1.0 and TRAVEL_IN_MM[0] < longest < TRAVEL_IN_MM[1]:
        source.report(
            node,
            path,
            f"a travel of {longest:g} m is too long for an arm",
            "it looks like mm: write length: mm under units",
        )
    finite, problem = finite_limits(joint_type, (low * unit, high * unit))
    if problem is not None:
        source.report(node, path, problem, "leave limits out for a joint without limits")
    return finite


def _digest(source: Source, node: yaml.Node, path: str) -> str:
    # Not as a text: YAML reads digits alone as a number, so they are written in quotes.
    digest = node.value if isinstance(node, yaml.ScalarNode) else ""
    if not re.fullmatch("[0-9a-f]{64}", digest):
        source.report(
            node,
            path,
            f"expected the SHA-256 of a pose file, 64 hexadecimal digits, found {describe(node)}",
            "`write_model` writes it; do not change it",
        )
    return digest


def _mapping(source: Source, node: yaml.Node, path: str, *, fix: str | None = None) -> Mapping[str, Any] | None:
    """Read a mapping that is kept as it is."""
    if isinstance(node, yaml.MappingNode):
        return cast(Mapping[str, Any], source.plain(node, path))
    source.report(node, path, f"expected keys with values, found {describe(node)}", fix)
    return None


def _choice(*options: str) -> Kind:
    return partial(Source.choice, options=options)


def tolerances(
    names: Iterable[str],
    lengths: Collection[str] = LENGTH_PARAMETERS,
    message: str = "a standard deviation cannot be negative, found {found}",
) -> Kind:
    """Kind of standard deviations by name, m for the ``lengths``, else rad; ``message`` is of a negative one."""
    checks = [(lambda value: value >= 0, message, None)]
    kinds = {name: partial(_checked, kind=_length if name in lengths else _angle, checks=checks) for name in names}
    return partial(read_section, kinds=kinds)


def _mimic(joint: str = "", **factors: float) -> Mimic:
    return Mimic(joint, **factors)


def _campaign(poses: tuple[str, ...] = (), before: Mapping[str, Any] = MappingProxyType({}), **more: Any) -> Campaign:
    return Campaign(poses, **before, **more)


def read_units(top: YamlSection) -> Units | None:
    """Return the units of the key ``units`` of a file, which they now are of; None where they cannot be read."""
    names = read_fields(top, {"units": partial(read_section, kinds=_UNITS, required=_UNITS)}, ["units"]).get(
        "units", {}
    )
    is_whole = len(names) == len(_UNITS)
    units = top.source.units = Units(_LENGTHS[names["length"]], _ANGLES[names["angle"]]) if is_whole else None
    return units


# Fields of a robot file.

FORMAT_VERSION = 1
BASE_LINK = "base"
"""Parent of a branch that the base carries."""
IDENTITY_FIELDS: dict[str, Kind] = dict.fromkeys(IDENTITY, Source.text)
_UNITS = {"length": _choice(*_LENGTHS), "angle": _choice(*_ANGLES)}
_FRAME: dict[str, Kind] = {"xyz": _lengths, "rpy": partial(Source.numbers, count=3, kind=_angle)}
_PLAIN_FRAME = partial(read_section, kinds=_FRAME, into=Frame)
FRAMES = partial(
    _named, kind=_PLAIN_FRAME, message="expected frames by name, each with xyz and rpy, found {found}", empty=True
)
"""Frames by name, of which there may be none."""
_FRAME_WITH_TOLERANCE = partial(read_section, kinds={**_FRAME, "tolerance": tolerances(FRAME_PARAMETERS)})
_TARGETS = partial(
    _named,
    kind=partial(read_section, kinds=_FRAME, required=["xyz"], into=Frame),
    message="expected names with xyz, found {found}",
)
_DIGESTS = partial(read_list, kind=_digest, item_name="SHA-256 of pose files")
_EFFECTS = partial(read_list, kind=_mapping, item_name="effects")
_BEFORE: dict[str, Kind] = {"base": _PLAIN_FRAME, "tool": _PLAIN_FRAME, "targets": _TARGETS}
_CAMPAIGN: dict[str, Kind] = {"poses": _DIGESTS, "before": partial(read_section, kinds=_BEFORE), "effects": _EFFECTS}


def _number(*checks: Check) -> Kind:
    """Kind of a number that passes every check."""
    return partial(_checked, kind=Source.number, checks=checks)


_ROBOT: dict[str, Kind] = {
    "base": _FRAME_WITH_TOLERANCE,
    "tool": _FRAME_WITH_TOLERANCE,
    "name": Source.text,
    "gravity": partial(
        _checked,
        kind=partial(Source.numbers, count=3),
        checks=[
            (
                # Five times the earth's gravity; a larger number is likely in mm/s^2.
                lambda value: math.hypot(*value) <= 50.0,
                "[{value[0]}, {value[1]}, {value[2]}] is too large for gravity",
                "it is always in m/s^2",
            )
        ],
    ),
    "payload": partial(read_section, kinds={"com": _lengths}, required=["com"]),
    "targets": _TARGETS,
    "effects": _EFFECTS,
    "base_link": Source.text,
    "tip_link": Source.text,
    "fitted_to": _DIGESTS,
    "campaign": partial(read_section, kinds=_CAMPAIGN, into=_campaign),
    "mass_uncertainty": _number(
        (
            lambda value: 0.0 <= value <= 1.0,
            "expected a share from 0 to 1, found {value:g}",
            "it is relative: 0.1 for 10 %",
        )
    ),
    "fit": partial(_mapping, fix="`write_model` writes it"),
    "identity": partial(read_section, kinds=IDENTITY_FIELDS),
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
    "sign": _number((lambda value: abs(value) == 1, "expected 1 or -1, found {found}", None)),
    "gear_ratio": _number(
        (lambda value: value >= 0, _POSITIVE, "write sign: -1 where the motor turns the other way"),
        (lambda value: value > 0, _POSITIVE, None),
    ),
    "coupling": partial(
        _named,
        kind=Source.number,
        message="expected joints with their ratios, such as {{j2: 1.0}}, found {found}",
    ),
    "passive": _choice("true", "false"),
}
_OF_ANY_JOINT: dict[str, Kind] = {
    "name": Source.text,
    "link": Source.text,
    "mass": _number((lambda value: value >= 0, "a mass cannot be negative, found {found}", None)),
    "com": _lengths,
    **_DRIVE,
    "mimic": partial(
        read_section,
        kinds={"joint": Source.text, "multiplier": Source.number, "offset": Source.number},
        required=["joint"],
        into=_mimic,
    ),
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


def _read_joint(section: YamlSection, index: int, convention: Convention) -> Joint | None:
    """Return the joint of a section, None where it cannot be read."""
    is_urdf, has = convention == "urdf", section.values
    kind = read_fields(section, {"type": _choice(*_TYPES, *["fixed"] * is_urdf)}, ["type"]).get("type")
    if kind is None:
        return None
    joint_type = cast(JointType, "revolute" if kind == "continuous" else kind)
    is_fixed, is_continuous = joint_type == "fixed", kind == "continuous"
    names = ORIGIN_PARAMETERS if is_urdf else DH_PARAMETERS
    lengths = LENGTH_PARAMETERS | ({"offset"} if is_urdf and joint_type == "prismatic" else set())
    # The variable's own parameter is an offset and zero by default, as is beta, which a plain table does not have.
    required = {*names} - {"beta", "theta" if joint_type == "revolute" else "d"}
    kinds: dict[str, Kind] = {name: _length if name in lengths else _angle for name in names}
    if is_urdf:
        kinds, required = {"origin": _PLAIN_FRAME, "offset": kinds["offset"]}, set() if is_fixed else {"axis"}
    if not is_fixed:
        kinds |= {"axis": _axis, "limits": partial(_limits, joint_type=joint_type)}
    values = read_fields(section, {**_OF_ANY_JOINT, **kinds, "tolerance": tolerances(names, lengths)}, required)
    is_passive = values.pop("passive", None) == "true"
    section.report_if(
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
    )
    origin = values.pop("origin", Frame())
    found = dict(zip(FRAME_PARAMETERS, (*origin.xyz, *origin.rpy), strict=True))
    values["parameters"] = {name: values.pop(name, found.get(name, 0.0)) for name in names}
    values["sign"] = -1 if values.get("sign") == -1 else 1
    flags = {"is_continuous": is_continuous, "is_passive": is_passive}
    return Joint(type=joint_type, **flags, **{"name": f"j{index + 1}", **values})


def _listed_joints(
    top: YamlSection, key: str, keys: Sequence[str], convention: Convention
) -> tuple[list[tuple[YamlSection, Joint]], bool]:
    """Return the joints of a list that can be read, with their sections, and whether these are all."""
    source, node = top.source, top.get(key)
    items = () if node is None else source.items(node, key, "joints" if key == "joints" else "joints outside the chain")
    if len(items) > MAX_JOINTS:
        source.report(node, key, f"found {len(items)} joints, expected at most {MAX_JOINTS}")
        return [], False
    sections = [source.section(item, f"{key}[{i}]", keys) for i, item in enumerate(items)]
    read = [
        (section, joint)
        for i, section in enumerate(sections)
        if section and (joint := _read_joint(section, i, convention))
    ]
    return read, len(read) == len(items)


def _read_joints(top: YamlSection, convention: Convention) -> tuple[Joint, ...]:
    node = top.require("joints")
    read, is_whole = _listed_joints(top, "joints", _KEYS[convention], convention)
    if isinstance(node, yaml.SequenceNode) and not node.value:
        top.report("joints", "a robot needs at least one joint")
    lines: dict[str, int] = {}
    links = [joint.link for _, joint in read]
    for i, (section, joint) in enumerate(read):
        line = lines.setdefault(joint.name, section.node.start_mark.line + 1)
        is_moved = joint.link is not None and joint.link in links[:i]
        section.report_if(
            (
                joint.name in [earlier.name for _, earlier in read[:i]],
                "name",
                f"{joint.name!r} is already the name of the joint in line {line}",
                None,
            ),
            (is_moved, "link", f"an earlier joint already moves {joint.link!r}", None),
        )
    if is_whole and read and not any(joint.is_variable for _, joint in read):
        top.report("joints", "no joint moves: all are fixed or follow another")
    return tuple(_followers(read)) if is_whole else ()


def _followers(read: Sequence[tuple[YamlSection, Joint]], masters: Sequence[Joint] = ()) -> Iterator[Joint]:
    """Yield the joints with their mimics and couplings in SI units; report those that follow no joint variable.

    Each joint follows others of the list, or of ``masters``.
    """
    by_name = {joint.name: joint for joint in (*masters, *(joint for _, joint in read))}
    for section, joint in read:
        units, mimic = section.source.units, joint.mimic
        # Units of the masters' variables, in that of the joint's own.
        sizes = {
            name: units.of_joint(joint.type) / units.of_joint(master.type)
            for name, master in by_name.items()
            if master.is_variable
        }
        if mimic is not None and mimic.master in sizes:
            ratio, offset = mimic.multiplier * sizes[mimic.master], mimic.offset * units.of_joint(joint.type)
            mimic = Mimic(mimic.master, ratio, offset)
        elif mimic is not None and mimic.master:
            reason = "is not a joint of this robot"
            if (master := by_name.get(mimic.master)) is not None:
                reason = "is fixed" if master.type == "fixed" else "follows another joint itself"
            section.report("mimic.joint", f"{joint.name!r} follows {mimic.master!r}, which {reason}")
        for name in joint.coupling.keys() - (sizes.keys() - {joint.name}):
            known = ", ".join(other for other in sizes if other != joint.name) or "none"
            section.report(f"coupling.{name}", f"{name!r} is not another joint with a variable; there are {known}")
        ratios = {name: ratio * sizes[name] for name, ratio in joint.coupling.items() if name in sizes}
        yield replace(joint, mimic=mimic, coupling=ratios)


def _read_branches(top: YamlSection, joints: Sequence[Joint]) -> tuple[BranchJoint, ...]:
    """Return the joints outside the chain of the key ``branches``; each parent must be ``base`` or an earlier joint.

    A joint may follow another one outside the chain, or a joint of the chain.
    """
    names = {joint.name for joint in joints}
    read, _ = _listed_joints(top, "branches", _BRANCH_KEYS, "urdf")
    branches = []
    for section, joint in read:
        section.require("name")
        kinds: dict[str, Kind] = {"parent": Source.text, "position": _length if joint.type == "prismatic" else _angle}
        values = read_fields(section, kinds, ["parent"])
        parent = values.get("parent", BASE_LINK)
        in_use, neither = f"{joint.name!r} is already the name of a joint or of the base", f"{parent!r} is neither"
        section.report_if(
            (
                joint.mimic is not None and section.get("position") is not None,
                "position",
                "a joint that follows another has no position of its own",
                None,
            ),
            (joint.name in {*names, BASE_LINK}, "name", in_use, None),
            (
                parent not in {*names, BASE_LINK},
                "parent",
                f"{neither} {BASE_LINK} nor a joint in front of it",
                f"there are {', '.join(sorted(names))}",
            ),
        )
        names.add(joint.name)
        branches.append(BranchJoint(joint, None if parent == BASE_LINK else parent, values.get("position", 0.0)))
    beside = _followers(read, joints)
    return tuple(branch._replace(joint=joint) for branch, joint in zip(branches, beside, strict=True))


def parse_robot(document_text: str, file: str) -> Robot:
    """Return the robot that a robot file describes, in SI units.

    Args:
        document_text: The YAML document.
        file: Name of the file, for messages, and for the robot's name where the file gives none.

    Raises:
        InputError: The file has problems; the error carries all of them, with line and dotted key.
    """
    top = top_section(document_text, file, _TOP_KEYS)
    source, version = top.source, top.values.get("robacc")
    if version is None:
        source.report(
            None,
            "robacc",
            "the format version is missing, so this is not a robot file of robacc",
            f"write 'robacc: {FORMAT_VERSION}' as the first line; give a table of a paper as a CSV",
        )
    elif not isinstance(version, yaml.ScalarNode) or version.value != str(FORMAT_VERSION):
        top.report("robacc", f"expected format version {FORMAT_VERSION}, found {describe(version)}")
    units = read_units(top)
    convention = read_fields(top, {"convention": _choice(*_KEYS)}, ["convention"]).get("convention")
    if units is None or convention is None:
        # Without them the other keys cannot be checked; any problem reported would be false.
        source.raise_if_any()
    units, convention = cast(Units, units), cast(Convention, convention)
    joints = _read_joints(top, convention)
    branches = _read_branches(top, joints)
    values = read_fields(top, _ROBOT)
    if "targets" in values and "tool" in top.values:
        top.report("targets", "cannot be combined with tool", "list the tool as a target")
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
    source.raise_if_any()
    return robot


def _check_likely_units(robot: Robot, units: Units, top: YamlSection) -> None:
    """Report a robot without other problems whose numbers were likely written in units other than declared."""
    parameters = [item for joint in robot.joints for item in joint.parameters.items()]
    fixed = [value for name, value in parameters if name not in LENGTH_PARAMETERS and name != "offset" and value]
    angles = [abs(value) / units.angle for value in fixed]
    quarter_turns = (min(abs(value - math.pi / 2), abs(value - math.pi)) < 1e-3 for value in angles)
    travels = [value for joint in robot.joints if joint.type == "prismatic" for value in joint.limits or ()]
    lengths = [value for name, value in parameters if name in LENGTH_PARAMETERS]
    longest = max(map(abs, (*lengths, *travels)), default=0.0)
    if units.angle == 1.0 and limits_likely_degrees(robot.joints):
        first = next(joint.limits for joint in robot.joints if joint.limits and joint.type == "revolute")
        message = f"the limits of every joint (the first: {first} rad) are more than two turns"
        top.source.report(top.values["units"], "units.angle", message, "they look like degrees: write angle: deg")
    if units.angle != 1.0 and angles and all(quarter_turns):
        message = f"the joints' angles ({angles[0]:g} and so on) are multiples of a quarter turn in rad, not in deg"
        top.source.report(top.values["units"], "units.angle", message, "they look like radians: write angle: rad")
    # m: an arm with only shorter lengths was written in m and declared as mm.
    if units.length != 1.0 and 0 < longest < 5e-3:
        message = f"the longest length of the arm is {longest / units.length:g} mm"
        top.source.report(top.values["units"], "units.length", message, "the lengths look like metres: write length: m")


def effect_lines(document_text: str, file: str) -> dict[str, int]:
    """Return the line of each entry of ``effects:`` by its dotted key; :func:`parse_robot` has checked the document."""
    node = top_section(document_text, file, _TOP_KEYS).get("effects")
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
    document = robot_document(robot, units, rounded=rounded)
    # default_flow_style None: a list or mapping without a nested one stands on one line.
    # The covariance of a thousand coefficients takes 5 s without libyaml.
    dumper: Any = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper
    text = yaml.dump(document, None, dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)
    return comment_lines(comments) + text


def comment_lines(comments: Sequence[str]) -> str:
    """Return lines of comment for the top of a file."""
    return "".join(f"# {line}\n" for comment in comments for line in comment.splitlines())


def robot_document(robot: Robot, units: Units = Units(), *, rounded: bool = False) -> dict[str, Any]:
    """Return the content of a robot file; ``rounded`` to :data:`robacc.quantities.SIGNIFICANT_DIGITS`.

    Raises:
        ValueError: The robot's effects are in units other than ``units``.
    """
    if robot.effects and robot.effect_units != (units.length, units.angle):
        raise ValueError("convert effects to the units of the file before writing them")
    length, angle = ({size: name for name, size in sizes.items()} for sizes in (_LENGTHS, _ANGLES))
    types = {joint.name: joint.type for joint in (*robot.joints, *(branch.joint for branch in robot.branches))}
    campaign = robot.campaign or Campaign(())
    before = {
        "base": campaign.base and _frame(campaign.base, units),
        "tool": campaign.tool and _frame(campaign.tool, units),
        "targets": _frames(campaign.targets, units),
    }
    document = _given(
        {
            "robacc": 1,
            "name": robot.name,
            "identity": robot.identity,
            "fitted_to": robot.fitted_to,
            "convention": robot.convention,
            "units": {"length": length[units.length], "angle": angle[units.angle]},
            "gravity": _floats(robot.gravity),
            "base": _frame(robot.base, units, robot.base_tolerance),
            "targets": _frames(robot.targets, units),
            "tool": None if robot.targets else _frame(robot.tool, units, robot.tool_tolerance),
            "payload": None if robot.payload_com is None else {"com": _floats(robot.payload_com, units.length)},
            "mass_uncertainty": robot.mass_uncertainty,
            "base_link": robot.base_link,
            "tip_link": robot.tip_link,
            "joints": [_joint(joint, robot.convention, units, types) for joint in robot.joints],
            "branches": [
                {
                    "name": branch.joint.name,
                    "parent": branch.parent or BASE_LINK,
                    **_joint(branch.joint, "urdf", units, types),
                    **_given({"position": branch.position / units.of_joint(branch.joint.type) or None}),
                }
                for branch in robot.branches
            ],
            "effects": robot.effects,
            "campaign": _given({"poses": campaign.poses, "before": _given(before), "effects": campaign.effects}),
            "fit": robot.fit,
        }
    )
    return cast(dict[str, Any], _plain(document, rounded))


def _given(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries that are there: neither None nor empty."""
    return {key: value for key, value in entry.items() if value is not None and value not in ({}, [], (), "")}


def _frame(frame: Frame, units: Units, tolerance: Mapping[str, float] = MappingProxyType({})) -> dict[str, Any]:
    entry = {"xyz": _floats(frame.xyz, units.length), "rpy": _floats(frame.rpy, units.angle)}
    return {**entry, **_given({"tolerance": _sizes(tolerance, LENGTH_PARAMETERS, units)})}


def _frames(frames: Mapping[str, Frame], units: Units) -> dict[str, Any]:
    return {name: _frame(frame, units) for name, frame in frames.items()}


def _joint(joint: Joint, convention: Convention, units: Units, types: Mapping[str, str]) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": joint.name, "type": "continuous" if joint.is_continuous else joint.type}
    lengths = LENGTH_PARAMETERS | ({"offset"} if joint.type == "prismatic" else set())
    values = _sizes(joint.parameters, lengths, units)
    if convention == "urdf":
        coordinates = [values[name] for name in FRAME_PARAMETERS]
        entry["origin"] = {"xyz": coordinates[:3], "rpy": coordinates[3:]}
        if joint.type != "fixed":
            entry |= {"axis": _floats(joint.axis), "offset": values.get("offset", 0.0)}
    else:
        entry |= {name: value for name, value in values.items() if name != "beta" or value != 0.0}
    unit, mimic = units.of_joint(joint.type), joint.mimic
    ratios = {**joint.coupling, **({mimic.master: mimic.multiplier} if mimic else {})}
    ratios = {name: float(ratio) * (units.of_joint(types[name]) / unit) for name, ratio in ratios.items()}
    return entry | _given(
        {
            "limits": joint.limits and _floats(joint.limits, unit),
            "sign": -1 if joint.sign < 0 else None,
            "gear_ratio": None if joint.gear_ratio is None else float(joint.gear_ratio),
            "mass": None if joint.mass is None else float(joint.mass),
            "com": joint.com and _floats(joint.com, units.length),
            "tolerance": _sizes(joint.tolerance, lengths, units),
            "link": joint.link,
            "coupling": {name: ratios[name] for name in joint.coupling},
            "passive": joint.is_passive or None,
            "mimic": mimic
            and {"joint": mimic.master, "multiplier": ratios[mimic.master], "offset": mimic.offset / unit},
        }
    )


def _sizes(values: Mapping[str, float], lengths: Collection[str], units: Units) -> dict[str, float]:
    """Return values by name in the file's units; those of ``lengths`` are lengths, the others angles."""
    return {name: value / (units.length if name in lengths else units.angle) for name, value in values.items()}


def _floats(values: Sequence[float], unit: float = 1.0) -> list[float]:
    return [value / unit for value in values]


def _plain(value: Any, rounded: bool) -> Any:
    """Return built-in types with no shared object: NumPy types have no YAML form, shared objects become aliases."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return {str(key): _plain(item, rounded) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, rounded) for item in value]
    return significant(value) if rounded and isinstance(value, float) else value
