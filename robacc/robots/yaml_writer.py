"""Write a robot as a robot file, in m and rad."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from robacc.quantities import significant
from robacc.robots.description import Campaign, Frame, Joint, Robot


def robot_to_yaml(robot: Robot, comments: Sequence[str] = (), *, rounded: bool = False) -> str:
    """Return the robot file of a robot; reading it gives the same numbers, bit for bit.

    Args:
        robot: Robot to write; its effects are written unchanged.
        comments: Lines for the top of the file, each written behind a ``#``.
        rounded: Write estimated numbers with their significant digits only (see
            :data:`robacc.quantities.SIGNIFICANT_DIGITS`); reading them gives the same numbers to 1e-12 of their size.

    Raises:
        ValueError: The robot's effects are in units other than m and rad.
    """
    if robot.effects and robot.effect_units != (1.0, 1.0):
        raise ValueError("convert effects to m and rad before writing them")
    document: dict[str, Any] = {
        "robacc": 1,
        "name": robot.name,
        **({"fitted_to": list(robot.fitted_to)} if robot.fitted_to else {}),
        "convention": robot.convention,
        "units": {"length": "m", "angle": "rad"},
        "gravity": _floats(robot.gravity),
        "base": _frame(robot.base, robot.base_tolerance),
    }
    if robot.targets:
        document["targets"] = {name: _frame(frame, {}) for name, frame in robot.targets.items()}
    else:
        document["tool"] = _frame(robot.tool, robot.tool_tolerance)
    if robot.payload_com is not None:
        document["payload"] = {"com": _floats(robot.payload_com)}
    if robot.mass_uncertainty is not None:
        document["mass_uncertainty"] = float(robot.mass_uncertainty)
    if robot.base_link:
        document["base_link"] = robot.base_link
    if robot.tip_link:
        document["tip_link"] = robot.tip_link
    document["joints"] = [_joint(joint, robot.convention == "urdf") for joint in robot.joints]
    if robot.effects:
        document["effects"] = [_plain(effect) for effect in robot.effects]
    if robot.campaign is not None:
        document["campaign"] = _campaign(robot.campaign)
    if robot.fit is not None:
        document["fit"] = _plain(robot.fit)
    if rounded:
        document = _rounded(document)
    head = "".join(f"# {line}\n" for comment in comments for line in comment.splitlines())
    # default_flow_style None: a list or mapping without a nested one stands on one line.
    return head + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


def _campaign(campaign: Campaign) -> dict[str, Any]:
    entry: dict[str, Any] = {"poses": list(campaign.poses)}
    before: dict[str, Any] = {}
    if campaign.base is not None:
        before["base"] = _frame(campaign.base, {})
    if campaign.tool is not None:
        before["tool"] = _frame(campaign.tool, {})
    if campaign.targets:
        before["targets"] = {name: _frame(frame, {}) for name, frame in campaign.targets.items()}
    if before:
        entry["before"] = before
    if campaign.effects:
        entry["effects"] = [_plain(effect) for effect in campaign.effects]
    return entry


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return significant(value) if isinstance(value, float) else value


def _frame(frame: Frame, tolerance: Mapping[str, float]) -> dict[str, Any]:
    entry: dict[str, Any] = {"xyz": _floats(frame.xyz), "rpy": _floats(frame.rpy)}
    if tolerance:
        entry["tolerance"] = _plain(tolerance)
    return entry


def _joint(joint: Joint, is_urdf: bool) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": joint.name, "type": "continuous" if joint.is_continuous else joint.type}
    values = {name: float(value) for name, value in joint.parameters.items()}
    if is_urdf:
        entry["origin"] = {
            "xyz": [values[name] for name in ("x", "y", "z")],
            "rpy": [values[name] for name in ("roll", "pitch", "yaw")],
        }
        if joint.type != "fixed":
            entry |= {"axis": _floats(joint.axis), "offset": values.get("offset", 0.0)}
    else:
        entry |= {name: value for name, value in values.items() if name != "beta" or value != 0.0}
    optional = {
        "limits": joint.limits and _floats(joint.limits),
        "sign": -1 if joint.sign < 0 else None,
        "gear_ratio": None if joint.gear_ratio is None else float(joint.gear_ratio),
        "mass": None if joint.mass is None else float(joint.mass),
        "com": joint.com and _floats(joint.com),
        "tolerance": _plain(joint.tolerance) or None,
        "link": joint.link,
    }
    entry |= {key: value for key, value in optional.items() if value is not None}
    if joint.coupling:
        entry["coupling"] = {name: float(ratio) for name, ratio in joint.coupling.items()}
    if joint.is_passive:
        entry["passive"] = True
    if joint.mimic is not None:
        multiplier, offset = float(joint.mimic.multiplier), float(joint.mimic.offset)
        entry["mimic"] = {"joint": joint.mimic.master, "multiplier": multiplier, "offset": offset}
    return entry


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
