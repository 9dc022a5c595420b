"""Write a robot as a robot file, in m and rad or in other units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import yaml

from robacc.quantities import significant
from robacc.robots.description import LENGTH_PARAMETERS, BranchJoint, Campaign, Frame, Joint, Robot
from robacc.robots.yaml_units import SI, Units


def robot_to_yaml(robot: Robot, comments: Sequence[str] = (), *, rounded: bool = False, units: Units = SI) -> str:
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


def robot_document(robot: Robot, units: Units = SI) -> dict[str, Any]:
    """Return the content of a robot file.

    Raises:
        ValueError: The robot's effects are in units other than ``units``.
    """
    if robot.effects and robot.effect_units != (units.length, units.angle):
        raise ValueError("convert effects to the units of the file before writing them")
    length_name, angle_name = units.names
    document: dict[str, Any] = {
        "robacc": 1,
        "name": robot.name,
        **({"identity": dict(robot.identity)} if robot.identity else {}),
        **({"fitted_to": list(robot.fitted_to)} if robot.fitted_to else {}),
        "convention": robot.convention,
        "units": {"length": length_name, "angle": angle_name},
        "gravity": _floats(robot.gravity),
        "base": _frame(robot.base, robot.base_tolerance, units),
    }
    if robot.targets:
        document["targets"] = {name: _frame(frame, {}, units) for name, frame in robot.targets.items()}
    else:
        document["tool"] = _frame(robot.tool, robot.tool_tolerance, units)
    if robot.payload_com is not None:
        document["payload"] = {"com": _lengths(robot.payload_com, units)}
    if robot.mass_uncertainty is not None:
        document["mass_uncertainty"] = float(robot.mass_uncertainty)
    if robot.base_link:
        document["base_link"] = robot.base_link
    if robot.tip_link:
        document["tip_link"] = robot.tip_link
    types = {joint.name: joint.type for joint in (*robot.joints, *(branch.joint for branch in robot.branches))}
    document["joints"] = [_joint(joint, robot.convention == "urdf", units, types) for joint in robot.joints]
    if robot.branches:
        document["branches"] = [_branch(branch, units, types) for branch in robot.branches]
    if robot.effects:
        document["effects"] = [_plain(effect) for effect in robot.effects]
    if robot.campaign is not None:
        document["campaign"] = _campaign(robot.campaign, units)
    if robot.fit is not None:
        document["fit"] = _plain(robot.fit)
    return document


def _campaign(campaign: Campaign, units: Units) -> dict[str, Any]:
    entry: dict[str, Any] = {"poses": list(campaign.poses)}
    before: dict[str, Any] = {}
    if campaign.base is not None:
        before["base"] = _frame(campaign.base, {}, units)
    if campaign.tool is not None:
        before["tool"] = _frame(campaign.tool, {}, units)
    if campaign.targets:
        before["targets"] = {name: _frame(frame, {}, units) for name, frame in campaign.targets.items()}
    if before:
        entry["before"] = before
    if campaign.effects:
        entry["effects"] = [_plain(effect) for effect in campaign.effects]
    return entry


def rounded_document(value: Any) -> Any:
    """Return a document with its numbers rounded to :data:`robacc.quantities.SIGNIFICANT_DIGITS`."""
    if isinstance(value, dict):
        return {key: rounded_document(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded_document(item) for item in value]
    return significant(value) if isinstance(value, float) else value


def _frame(frame: Frame, tolerance: Mapping[str, float], units: Units) -> dict[str, Any]:
    entry: dict[str, Any] = {"xyz": _lengths(frame.xyz, units), "rpy": [value / units.angle for value in frame.rpy]}
    if tolerance:
        entry["tolerance"] = _sizes(tolerance, LENGTH_PARAMETERS, units)
    return entry


def _joint(joint: Joint, is_urdf: bool, units: Units, types: Mapping[str, str]) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": joint.name, "type": "continuous" if joint.is_continuous else joint.type}
    lengths = LENGTH_PARAMETERS | ({"offset"} if joint.type == "prismatic" else set())
    values = _sizes(joint.parameters, lengths, units)
    if is_urdf:
        entry["origin"] = {
            "xyz": [values[name] for name in ("x", "y", "z")],
            "rpy": [values[name] for name in ("roll", "pitch", "yaw")],
        }
        if joint.type != "fixed":
            entry |= {"axis": _floats(joint.axis), "offset": values.get("offset", 0.0)}
    else:
        entry |= {name: value for name, value in values.items() if name != "beta" or value != 0.0}
    unit = units.of_joint(joint.type)
    optional = {
        "limits": joint.limits and [value / unit for value in joint.limits],
        "sign": -1 if joint.sign < 0 else None,
        "gear_ratio": None if joint.gear_ratio is None else float(joint.gear_ratio),
        "mass": None if joint.mass is None else float(joint.mass),
        "com": joint.com and _lengths(joint.com, units),
        "tolerance": _sizes(joint.tolerance, lengths, units) or None,
        "link": joint.link,
    }
    entry |= {key: value for key, value in optional.items() if value is not None}
    if joint.coupling:
        entry["coupling"] = {
            name: ratio * (units.of_joint(types[name]) / unit) for name, ratio in _sizes(joint.coupling, (), SI).items()
        }
    if joint.is_passive:
        entry["passive"] = True
    if joint.mimic is not None:
        multiplier = float(joint.mimic.multiplier) * (units.of_joint(types[joint.mimic.master]) / unit)
        entry["mimic"] = {"joint": joint.mimic.master, "multiplier": multiplier, "offset": joint.mimic.offset / unit}
    return entry


def _branch(branch: BranchJoint, units: Units, types: Mapping[str, str]) -> dict[str, Any]:
    entry = _joint(branch.joint, True, units, types)
    position = {"position": branch.position / units.of_joint(branch.joint.type)} if branch.position else {}
    return {"name": entry.pop("name"), "parent": branch.parent or "base", **entry, **position}


def _lengths(values: Sequence[float], units: Units) -> list[float]:
    return [float(value) / units.length for value in values]


def _sizes(values: Mapping[str, float], lengths: Collection[str], units: Units) -> dict[str, float]:
    """Return values by name in the file's units; those of ``lengths`` are lengths, the others angles."""
    return {
        str(name): float(value) / (units.length if name in lengths else units.angle) for name, value in values.items()
    }


def _floats(values: Sequence[float]) -> list[float]:
    return [float(value) for value in values]


def _plain(value: Any) -> Any:
    """Return built-in types with no shared object: NumPy types have no YAML form, shared objects become aliases."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        items = value.tolist() if hasattr(value, "tolist") else value
        return [_plain(item) for item in items] if isinstance(items, list | tuple) else items
    return value
