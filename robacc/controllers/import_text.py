"""Arms from the files of controllers and of their ROS drivers."""

from __future__ import annotations

import json
from typing import Any

from robacc.controllers.formats import KINEMATICS_SCHEMA
from robacc.controllers.link_yaml import parse_links
from robacc.controllers.ur_calibration import is_ur_calibration, parse_deltas, ur_robot
from robacc.controllers.ur_models import UR_ARMS
from robacc.errors import InputError, Problem, UsageError
from robacc.robots.description import Frame, Joint, Robot

_ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")


def parse_controller_file(text: str, file: str, arm: str | None = None) -> Robot:
    """Return the arm of a controller's file: ``calibration.conf``, a ROS kinematics file, or a robacc JSON export.

    Args:
        text: Content.
        file: Name for messages.
        arm: Arm of Universal Robots that a ``calibration.conf`` belongs to.

    Raises:
        InputError: The file is none of these, or has errors.
        UsageError: ``arm`` is missing or unknown.
    """
    if is_ur_calibration(text):
        if arm not in UR_ARMS:
            reason = "does not say which arm it belongs to" if arm is None else f"cannot belong to {arm!r}"
            raise UsageError(f"{file} {reason}; name the arm, one of {', '.join(UR_ARMS)}")
        return ur_robot(parse_deltas(text, file), arm)
    robot = _parse_json(text, file) if text.lstrip().startswith("{") else parse_links(text, file)
    if arm is not None:
        raise UsageError(f"only a calibration.conf needs the name of its arm; {file} has all lengths")
    return robot


def _parse_json(text: str, file: str) -> Robot:
    try:
        document: Any = json.loads(text, parse_constant=_no_number)
    except json.JSONDecodeError as error:
        raise InputError(Problem(f"is not JSON: {error.msg}", file, error.lineno)) from None
    except ValueError as error:
        raise InputError(Problem(str(error), file)) from None
    if not isinstance(document, dict) or document.get("schema") != KINEMATICS_SCHEMA:
        raise InputError(Problem(f"is not a kinematics file of robacc ({KINEMATICS_SCHEMA})", file))
    try:
        joints = []
        for entry in document["joints"]:
            origin = _frame(entry["origin"])
            values = dict(zip(_ORIGIN, (*origin.xyz, *origin.rpy), strict=True))
            limits = entry.get("limits")
            if entry["type"] not in ("revolute", "prismatic"):
                raise ValueError(f"type {entry['type']!r}")
            joints.append(
                Joint(
                    str(entry["name"]),
                    entry["type"],
                    {**values, "offset": 0.0},
                    limits=None if limits is None else (float(limits[0]), float(limits[1])),
                )
            )
        gravity = tuple(float(value) for value in document["gravity"])
        x, y, z = gravity
        base, tool = _frame(document["base"]), _frame(document["tool"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        message = f"a key is missing or has an unexpected value: {error}"
        raise InputError(Problem(message, file, fix="export the model again")) from None
    return Robot(str(document.get("name", "arm")), "urdf", tuple(joints), base=base, tool=tool, gravity=(x, y, z))


def _frame(value: Any) -> Frame:
    x, y, z = (float(number) for number in value["xyz"])
    roll, pitch, yaw = (float(number) for number in value["rpy"])
    return Frame((x, y, z), (roll, pitch, yaw))


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is not a finite number")
