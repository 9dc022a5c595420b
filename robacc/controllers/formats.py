"""Models as text in the formats of controllers and simulators, with what each format leaves out."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from robacc.controllers.dh_table import dh_table, modified_rows
from robacc.controllers.joint_frames import frame_of_poses, joint_frames, pose_of
from robacc.controllers.link_yaml import hash_line_of, link_names, links_text
from robacc.controllers.restricted import RemainingError, Restricted, kinematic_part, offsets_only, remaining_error
from robacc.controllers.ur_calibration import ur_arm_of, ur_deltas_text, ur_robot
from robacc.controllers.ur_models import UR_ARMS, ur_table
from robacc.errors import UsageError
from robacc.robots.description import Frame, Joint, Robot
from robacc.robots.urdf_writer import robot_to_urdf
from robacc.robots.yaml_writer import robot_to_yaml
from robacc.version import __version__


class ControllerFormat(StrEnum):
    """Format of an exported model."""

    urdf = "urdf"
    """URDF."""
    mdh = "mdh"
    """Robot file with a modified Denavit-Hartenberg table (Craig)."""
    json = "json"
    """Joint origins, standard and modified table as JSON."""
    ur_calibration = "ur-calibration"
    """``calibration.conf`` of a controller of Universal Robots."""
    ur_kinematics = "ur-kinematics"
    """Kinematics file of ur_description (ROS)."""
    xarm = "xarm"
    """Kinematics file of xarm_description (ROS)."""
    joint_offsets = "joint-offsets"
    """Table of joint offsets, for controllers that take nothing but a mastering."""


KINEMATICS_SCHEMA = "robacc.kinematics/1"
"""Value of ``schema`` in a file of the format json."""


_EXACT = 1e-9
"""Remaining error (m, rad) below which nothing is left out."""


@dataclass(frozen=True, slots=True)
class ExportedModel:
    """Model as text."""

    text: str
    controller: Robot
    """Arm that the text describes, with the model's base and tool."""
    tool: Frame
    """Measured target in the last frame of the format, to be set as the tool."""
    not_carried: tuple[str, ...]
    refitted: tuple[str, ...]
    remaining: RemainingError
    arm: str | None = None
    """Arm of Universal Robots that the numbers refer to."""


def export_model(
    robot: Robot,
    form: ControllerFormat,
    *,
    nominal: Robot | None = None,
    arm: str | None = None,
    template: str | None = None,
) -> ExportedModel:
    """Return a model in a format, its parameters fitted again to what the format cannot hold.

    Args:
        robot: Model, with the effects of its file.
        form: Format.
        nominal: Nominal arm of the controller, for ``joint-offsets``.
        arm: Arm of Universal Robots, for ``ur-calibration``; default: recognised by its lengths.
        template: Text of the arm's own file, whose other lines are kept (``ur-calibration``, ``ur-kinematics``).

    Raises:
        UsageError: The arm does not fit the format, or an argument is missing.
    """
    if form is ControllerFormat.joint_offsets:
        if nominal is None:
            raise UsageError("the format joint-offsets needs the nominal model, which the controller has")
        if nominal.variable_names != robot.variable_names:
            raise UsageError("the model and the nominal model have different joints")
        part = offsets_only(robot, nominal)
        text = _offsets_text(part.robot, nominal)
        result = _exported(robot, part, text, part.robot, part.robot.tool, ("link geometry",))
        is_exact = max(result.remaining.position_max, result.remaining.orientation_max) < _EXACT
        return dataclasses.replace(result, not_carried=()) if is_exact else result
    part = kinematic_part(robot)
    chosen = None
    if form is ControllerFormat.urdf:
        text, losses = robot_to_urdf(part.robot)
        return _exported(robot, part, text, part.robot, part.robot.tool, losses)
    if form is ControllerFormat.mdh:
        controller = _modified_robot(part.robot)
        return _exported(robot, part, robot_to_yaml(controller), controller, controller.tool, ())
    frames = joint_frames(part.robot)
    if form is ControllerFormat.json:
        text = json.dumps(_document(part.robot), indent=2) + "\n"
        return _exported(robot, part, text, part.robot, part.robot.tool, ())
    if form is ControllerFormat.ur_calibration:
        if arm is not None and arm not in UR_ARMS:
            raise UsageError(f"no arm {arm!r} of Universal Robots; robacc knows {', '.join(UR_ARMS)}")
        chosen = arm or ur_arm_of(frames)
        text, table = ur_deltas_text(part.robot, chosen, template)
        deltas = tuple(
            type(row)(row.theta - base.theta, row.d - base.d, row.a - base.a, row.alpha - base.alpha)
            for row, base in zip(table.rows, ur_table(chosen), strict=True)
        )
        written = ur_robot(deltas, chosen)
        base = frame_of_poses(pose_of(robot.base) @ table.base)
        tool = frame_of_poses(table.tool @ pose_of(robot.tool))
        # The description's last frame stands at the flange of the table.
        last = frame_of_poses(pose_of(written.tool) @ pose_of(tool))
        return _exported(robot, part, text, dataclasses.replace(written, base=base, tool=last), tool, (), chosen)
    header = f"written by robacc {__version__} from {robot.name}"
    text, last = links_text(frames, link_names(frames, form.value), header, hash_line_of(template or ""))
    tool = frame_of_poses(pose_of(last) @ pose_of(robot.tool))
    return _exported(robot, part, text, part.robot, tool, ())


def _exported(
    robot: Robot,
    part: Restricted,
    text: str,
    controller: Robot,
    tool: Frame,
    losses: tuple[str, ...],
    arm: str | None = None,
) -> ExportedModel:
    effects = [f"effect {name}" for name in (*part.refitted, *part.excluded)]
    remaining = remaining_error(part.complete, controller)
    kept = [loss for loss in losses if not loss.startswith("effect ")]
    return ExportedModel(text, controller, tool, (*effects, *kept), part.refitted, remaining, arm)


def _modified_robot(robot: Robot) -> Robot:
    """Return an arm as a robot file with a modified table."""
    table = dh_table(joint_frames(robot), hayati=True)
    rows, flange = modified_rows(table)
    joints = tuple(
        Joint(
            joint.name,
            joint.type,
            {"theta": row.theta, "d": row.d, "a": row.a, "alpha": row.alpha, "beta": row.beta},
            limits=joint.limits,
            gear_ratio=joint.gear_ratio,
        )
        for joint, row in zip(robot.variables, rows, strict=True)
    )
    base = frame_of_poses(pose_of(robot.base) @ table.base)
    tool = frame_of_poses(flange @ pose_of(robot.tool))
    return Robot(robot.name, "modified", joints, base=base, tool=tool, gravity=robot.gravity)


def _document(robot: Robot) -> dict[str, Any]:
    """Return the JSON document of an arm: m and rad."""
    frames = joint_frames(robot)
    steps = frames.steps()
    table = dh_table(frames)
    modified, flange = modified_rows(table)
    joints = []
    for joint, step, row, other in zip(frames.joints, steps, table.rows, modified, strict=False):
        joints.append(
            {
                "name": joint.name,
                "type": joint.type,
                "limits": None if joint.limits is None else list(joint.limits),
                "origin": _plain(frame_of_poses(step)),
                "dh": {"theta": row.theta, "d": row.d, "a": row.a, "alpha": row.alpha},
                "modified_dh": {"alpha": other.alpha, "a": other.a, "theta": other.theta, "d": other.d},
            }
        )
    return {
        "schema": KINEMATICS_SCHEMA,
        "robacc": __version__,
        "name": robot.name,
        "units": {"length": "m", "angle": "rad"},
        "gravity": list(robot.gravity),
        "base": _plain(robot.base),
        "joints": joints,
        "tool": _plain(frame_of_poses(steps[-1] @ pose_of(robot.tool))),
        "dh_base": _plain(frame_of_poses(pose_of(robot.base) @ table.base)),
        "dh_tool": _plain(frame_of_poses(table.tool @ pose_of(robot.tool))),
        "modified_dh_tool": _plain(frame_of_poses(flange @ pose_of(robot.tool))),
    }


def _plain(frame: Frame) -> dict[str, list[float]]:
    return {"xyz": list(frame.xyz), "rpy": list(frame.rpy)}


def _offsets_text(fitted: Robot, nominal: Robot) -> str:
    """Return the table of joint offsets: true joint variable minus the one that the nominal model has."""
    lines = [
        f"# Joint offsets, written by robacc {__version__}: true joint variable minus that of the controller.",
        "# Master the axis, or move its zero, so that the controller shows the value plus the offset.",
        "joint,offset,unit",
    ]
    for new, old in zip(fitted.variables, nominal.variables, strict=True):
        label = new.offset_parameter
        change = new.sign * (new.parameters.get(label, 0.0) - old.parameters.get(label, 0.0))
        value, unit = (change * 180 / np.pi, "deg") if new.type == "revolute" else (change * 1e3, "mm")
        lines.append(f"{new.name},{round(float(value), 7) + 0.0:.7f},{unit}")
    return "\n".join([*lines, ""])
