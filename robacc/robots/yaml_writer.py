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
    types = {joint.name: joint.type for joint in (*robot.joints, *(branch.joint for branch in robot.branches))}
    targets = {name: _frame(frame, {}, units) for name, frame in robot.targets.items()}
    payload = robot.payload_com
    return _given(
        {
            "robacc": 1,
            "name": robot.name,
            "identity": dict(robot.identity),
            "fitted_to": list(robot.fitted_to),
            "convention": robot.convention,
            "units": {"length": length_name, "angle": angle_name},
            "gravity": _floats(robot.gravity),
            "base": _frame(robot.base, robot.base_tolerance, units),
            "targets": targets,
            "tool": None if targets else _frame(robot.tool, robot.tool_tolerance, units),
            "payload": None if payload is None else {"com": _floats(payload, units.length)},
            "mass_uncertainty": None if robot.mass_uncertainty is None else float(robot.mass_uncertainty),
            "base_link": robot.base_link,
            "tip_link": robot.tip_link,
            "joints": [_joint(joint, robot.convention == "urdf", units, types) for joint in robot.joints],
            "branches": [_branch(branch, units, types) for branch in robot.branches],
            "effects": [_plain(effect) for effect in robot.effects],
            "campaign": None if robot.campaign is None else _campaign(robot.campaign, units),
            "fit": _plain(robot.fit),
        }
    )


def _campaign(campaign: Campaign, units: Units) -> dict[str, Any]:
    frames = {"base": campaign.base, "tool": campaign.tool}
    before: dict[str, Any] = {key: _frame(frame, {}, units) for key, frame in frames.items() if frame is not None}
    before["targets"] = {name: _frame(frame, {}, units) for name, frame in campaign.targets.items()}
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


def _frame(frame: Frame, tolerance: Mapping[str, float], units: Units) -> dict[str, Any]:
    entry: dict[str, Any] = {"xyz": _floats(frame.xyz, units.length), "rpy": _floats(frame.rpy, units.angle)}
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
    entry = _joint(branch.joint, True, units, types)
    position = {"position": branch.position / units.of_joint(branch.joint.type)} if branch.position else {}
    return {"name": entry.pop("name"), "parent": branch.parent or "base", **entry, **position}


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
