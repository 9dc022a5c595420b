"""Formats of controllers that take joint zeros alone: a table to master the axes by, and the calibration of LeRobot.

A calibration file of LeRobot has ``id``, ``drive_mode``, ``homing_offset``, ``range_min`` and ``range_max`` of each
motor. The motor reports its position P in counts of 1/4096 turn, with ``homing_offset`` taken from that of its encoder
(Feetech) or added to it (Dynamixel). LeRobot makes (P - (range_min + range_max) / 2) 360/4095 degrees of it: the middle
of the range is the zero of the joint. So a ``homing_offset`` that moves with the range changes nothing, and the file
does not tell the make of the motors, which decides its sign. The range alone is corrected here: one end moves inwards
by twice the offset. The middle is then where the zero is, to a quarter of a count, and the range is within the old one.

Source: huggingface/lerobot, ``motors/motors_bus.py``, ``motors/feetech/feetech.py``, ``motors/dynamixel/dynamixel.py``.
"""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

from robacc.errors import UsageError, refuse
from robacc.exporters import Written
from robacc.robots.description import Robot
from robacc.version import __version__


def _offsets(fitted: Robot, nominal: Robot) -> list[float]:
    """Return the true joint variable minus the one that the nominal model has, rad or m, of each joint."""
    pairs = zip(fitted.variables, nominal.variables, strict=True)
    labels = ((new, old, new.offset_parameter) for new, old in pairs)
    return [new.sign * (new.parameters.get(label, 0.0) - old.parameters.get(label, 0.0)) for new, old, label in labels]


def write_offsets(robot: Robot, *, nominal: Robot | None = None) -> Written:
    """Return the table of joint offsets.

    Raises:
        UsageError: ``nominal``, the model that the controller has, is missing.
    """
    if nominal is None:
        raise UsageError("the format joint-offsets needs the nominal model, which the controller has")
    lines = [
        f"# Joint offsets, written by robacc {__version__}: true joint variable minus that of the controller.",
        "# Master the axis, or move its zero, so that the controller shows the value plus the offset.",
        "joint,offset,unit",
    ]
    for joint, offset in zip(robot.variables, _offsets(robot, nominal), strict=True):
        value, unit = (math.degrees(offset), "deg") if joint.type == "revolute" else (offset * 1e3, "mm")
        lines.append(f"{joint.name},{round(value, 7) + 0.0:.7f},{unit}")
    return Written("\n".join([*lines, ""]), ["link geometry"])


COUNTS = 4095 / math.tau
"""Counts per radian, as LeRobot computes degrees."""
_MOTOR = {"id", "drive_mode", "homing_offset", "range_min", "range_max"}


def write_lerobot(robot: Robot, *, nominal: Robot | None = None, template: str | None = None) -> Written:
    """Return the calibration file of an arm with the zeros of a model.

    Args:
        robot: Model whose joint variables are LeRobot's degrees.
        nominal: Model that the poses were taken with.
        template: Text of the arm's calibration file at that time.

    Raises:
        UsageError: An argument is missing, the file is none of LeRobot, or its motors are not those of the joints.
    """
    if nominal is None or template is None:
        needs = "`nominal`, the model of the arm before, and `template`, its calibration file"
        raise UsageError(f"the format lerobot needs {needs}")
    motors = read_calibration(template)
    named, joints, losses, worst, cut = _motors_of(robot, motors), list(robot.joints), ["link geometry"], 0.0, 0
    for joint, offset, name in zip(robot.variables, _offsets(robot, nominal), named, strict=True):
        motor, ends = motors[name], round(2 * offset * COUNTS)
        motor["range_max" if ends > 0 else "range_min"] -= ends
        narrow = (
            f"the zero of {joint.name} is {math.degrees(offset):.1f}° off, more than its range in `template` allows"
        )
        refuse((motor["range_min"] >= motor["range_max"], narrow))
        rounded = ends / 2 / COUNTS - offset
        worst, cut = max(worst, abs(rounded)), max(cut, abs(ends))
        label = joint.offset_parameter
        changed = {**joint.parameters, label: joint.parameters.get(label, 0.0) + joint.sign * rounded}
        joints[joints.index(joint)] = dataclasses.replace(joint, parameters=changed)
    losses.append(f"zeros between counts: up to {math.degrees(worst):.2g}°")
    losses.append(f"range: up to {math.degrees(cut / COUNTS):.2g}° at one end of a joint")
    text = json.dumps(motors, indent=4) + "\n"
    return Written(text, losses if cut else losses[:2], dataclasses.replace(robot, joints=tuple(joints)))


def read_calibration(text: str, name: str = "`template`") -> dict[str, dict[str, Any]]:
    """Return the motors of a calibration file, which has a ``name`` in messages, by their names.

    Raises:
        UsageError: It is none.
    """
    try:
        motors: dict[str, dict[str, Any]] = json.loads(text)
    except json.JSONDecodeError as error:
        raise UsageError(f"{name} is not JSON: line {error.lineno}: {error.msg}") from None
    is_calibration = isinstance(motors, dict) and all(
        isinstance(motor, dict) and motor.keys() >= _MOTOR and all(type(motor[key]) is int for key in _MOTOR)
        for motor in motors.values()
    )
    refuse(
        (
            not is_calibration or not motors,
            f"{name} is no calibration of LeRobot: expected motors, each with {', '.join(sorted(_MOTOR))}; "
            "calibrate an arm of LeRobot before 0.2 again",
        )
    )
    for key, motor in motors.items():
        low, high = motor["range_min"], motor["range_max"]
        refuse(
            (
                low < 0,
                f"{name}: the range of {key} begins at {low}; a motor with counts begins at 0 or above",
            ),
            (low >= high, f"{name}: the range of {key} is from {low} to {high}"),
        )
    return motors


def _motors_of(robot: Robot, motors: dict[str, dict[str, Any]]) -> list[str]:
    """Return the motor of each joint: that of its name, or else in the order of the identifiers."""
    names = robot.variable_names
    refuse((any(joint.type != "revolute" for joint in robot.variables), "the format lerobot has revolute joints only"))
    if motors.keys() >= {*names}:
        return [*names]
    by_id = sorted(motors, key=lambda name: int(motors[name]["id"]))
    # The gripper, which no pose shows, has the last motor.
    is_in_order = [motors[name]["id"] for name in by_id] == [*range(1, len(by_id) + 1)]
    listed = f"joints {', '.join(names)}; motors {', '.join(by_id)}"
    others = f"the motors of `template` are not those of the model ({listed}); give both the same names"
    refuse((not is_in_order or len(by_id) not in (len(names), len(names) + 1), others))
    return by_id[: len(names)]
