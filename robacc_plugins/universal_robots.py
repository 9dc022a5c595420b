"""Calibration files of Universal Robots' controllers (``calibration.conf``): differences from the nominal table.

The controller adds ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha`` to its nominal Denavit-Hartenberg
rows. The other lines of the file (joint checksums, raw offsets) belong to one arm; they are kept from its own file.

Layout: files of public backups, and UR's forum, thread "Calibrated kinematics info" (18921). Nominal parameters:
Universal Robots, "DH parameters for calculations of kinematics and dynamics", support article 45257.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import operator
import re
from collections.abc import Sequence

import numpy as np

from robacc.errors import InputError, Problem, refuse
from robacc.exporters import Written
from robacc.geometry import Poses
from robacc.robots.description import Frame, Robot
from robacc_plugins.denavit_hartenberg import DhRow, dh_table, joint_at, joint_frames, steps, unit_across

UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
_LENGTHS = {
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "ur20": (0.2363, -0.8620, -0.7287, 0.2010, 0.1593, 0.1543),
    "ur30": (0.2363, -0.6370, -0.5037, 0.2010, 0.1593, 0.1543),
}
"""d1, a2, a3, d4, d5, d6 in m."""
UR_ARMS = tuple(_LENGTHS)
_FIELDS = {"delta_theta": "theta", "delta_a": "a", "delta_d": "d", "delta_alpha": "alpha"}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LINE = re.compile(r"^[ \t]*(delta_(?:theta|a|d|alpha))[ \t]*=[ \t]*\[([^\]\r\n]*)\]", re.M)
_MARK = re.compile(r"^[ \t]*delta_(?:theta|a|d|alpha)[ \t]*=", re.M)
_LARGEST_DIFFERENCE = 5e-3
"""m: an arm that differs more from every arm of Universal Robots is none of them."""


def _ur_table(arm: str) -> tuple[DhRow, ...]:
    """Return the nominal standard table of an arm of :data:`UR_ARMS`."""
    d1, a2, a3, d4, d5, d6 = _LENGTHS[arm]
    return (
        DhRow(0.0, d1, 0.0, math.pi / 2),
        DhRow(0.0, 0.0, a2, 0.0),
        DhRow(0.0, 0.0, a3, 0.0),
        DhRow(0.0, d4, 0.0, math.pi / 2),
        DhRow(0.0, d5, 0.0, -math.pi / 2),
        DhRow(0.0, d6, 0.0, 0.0),
    )


def _deltas_text(deltas: Sequence[DhRow], template: str | None) -> str:
    """Return the calibration file of an arm; with a ``template``, its own file, whose other lines are kept."""
    lines = {
        key: f"{key} = [ {', '.join(f'{getattr(row, field):.18g}' for row in deltas)}]"
        for key, field in _FIELDS.items()
    }
    if template is None:
        return "\n".join(["[mounting]", *lines.values(), ""])
    return _LINE.sub(lambda match: lines[match[1]], template)


def _parse_deltas(text: str, file: str) -> list[DhRow]:
    """Return the differences of the six rows from the nominal ones.

    Raises:
        InputError: A line is missing, is given twice, or has not six numbers.
    """
    columns: dict[str, list[float]] = {}
    problems = []
    for match in _LINE.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        parts = [part.strip() for part in match[2].split(",")]
        if match[1] in columns:
            problems.append(Problem(f"{match[1]} is given twice", file, line))
        elif len(parts) != len(UR_JOINTS) or not all(re.fullmatch(_NUMBER, part) for part in parts):
            problems.append(Problem(f"{match[1]} needs six numbers, found [{match[2].strip()[:60]}]", file, line))
        else:
            columns[match[1]] = [float(part) for part in parts]
    missing = [key for key in _FIELDS if key not in columns]
    if missing and not problems:
        fix = "give calibration.conf from the folder .urcontrol of the controller"
        problems.append(Problem(f"{', '.join(missing)} is missing", file, fix=fix))
    if problems:
        raise InputError(problems)
    named = {field: columns[key] for key, field in _FIELDS.items()}
    return [DhRow(**dict(zip(named, row, strict=True))) for row in zip(*named.values(), strict=True)]


def _ur_robot(deltas: Sequence[DhRow], arm: str) -> Robot:
    """Return the calibrated arm, its joint frames on the axes where the nominal arm has them."""
    table = _ur_table(arm)
    frames = _frames([DhRow(*map(operator.add, *rows)) for rows in zip(table, deltas, strict=True)])
    for i, near in enumerate(_frames(table)[:-2]):
        # On the same axis, with the origin and the x axis nearest to the nominal ones.
        z = frames[i].rotation[:, 2]
        x = unit_across(near.rotation[:, 0], z)
        origin = frames[i].translation + z * (z @ (near.translation - frames[i].translation))
        frames[i] = Poses(np.stack((x, np.cross(z, x), z), axis=1), origin)
    *origins, tool = steps(frames)
    joints = tuple(map(joint_at, origins, UR_JOINTS))
    return Robot(f"Universal Robots {arm.upper()}, calibrated", "urdf", joints, tool=tool)


def _frames(rows: Sequence[DhRow]) -> list[Poses]:
    """Return the joint frames of a table, each behind theta and d of its row, and the frame behind the last row."""
    *before, last = itertools.accumulate((row.pose() for row in rows), operator.matmul, initial=Poses.identity())
    pairs = zip(before, rows, strict=True)
    return [*(pose @ DhRow(row.theta, row.d, 0.0, 0.0).pose() for pose, row in pairs), last]


def _ur_arm_of(robot: Robot) -> str:
    """Return the name of the arm of Universal Robots that an arm is.

    Raises:
        UsageError: It is none of them.
    """
    frames = joint_frames(robot)
    fix = "the format ur-calibration is for arms of Universal Robots"
    is_revolute = all(joint.type == "revolute" for joint in robot.variables)
    refuse((len(frames) != len(UR_JOINTS) + 1 or not is_revolute, f"{fix}, which have six revolute joints"))
    rows = dh_table(frames, last_is_axis=True).rows
    lengths = []
    for first, second in itertools.pairwise(frames[1:4]):
        z, between = first.rotation[:, 2], second.translation - first.translation
        lengths.append(float(np.linalg.norm(between - z * (z @ between))))
    # d4 and the sign of a length depend on the frames that stand for the axes.
    known = np.abs(np.delete(list(_LENGTHS.values()), 3, axis=1))
    differences = np.abs(known - np.abs([rows[0].d, *lengths, rows[4].d, rows[5].d])).max(axis=1)
    arm, difference = UR_ARMS[int(differences.argmin())], differences.min()
    nearest = f"the nearest, {arm}, differs by {difference * 1e3:.1f} mm: name the arm if it is one"
    refuse((difference > _LARGEST_DIFFERENCE, f"{fix}; {nearest}"))
    return arm


def write(robot: Robot, *, arm: str | None = None, template: str | None = None) -> Written:
    """Return the calibration file of an arm of Universal Robots.

    Args:
        robot: Arm without effects.
        arm: Its name; None: recognised by its lengths.
        template: Text of the arm's own file, whose other lines are kept.

    Raises:
        UsageError: There is no such arm, or the robot is none of Universal Robots.
    """
    unknown = f"no arm {arm!r} of Universal Robots; robacc knows {', '.join(UR_ARMS)}"
    refuse((arm is not None and arm not in UR_ARMS, unknown))
    chosen = arm or _ur_arm_of(robot)
    rows = _ur_table(chosen)
    table = dh_table(joint_frames(robot), rows, last_is_axis=True)
    deltas = [DhRow(*map(operator.sub, *pair)) for pair in zip(table.rows, rows, strict=True)]
    tool = Frame.of(table.tool @ robot.tool.pose)
    described = _ur_robot(deltas, chosen)
    # The description's last frame stands at the flange of the table.
    last = Frame.of(described.tool.pose @ tool.pose)
    controller = dataclasses.replace(described, base=Frame.of(robot.base.pose @ table.base), tool=last)
    return Written(_deltas_text(deltas, template), controller=controller, tool=tool, arm=chosen)


def read(text: str, file: str, *, arm: str | None = None) -> Robot | None:
    """Return the arm of a calibration file; None for another text.

    Args:
        text: Content.
        file: Name for messages.
        arm: Arm that the file belongs to.

    Raises:
        InputError: The file has errors.
        UsageError: ``arm`` is missing or unknown.
    """
    if not _MARK.search(text):
        return None
    reason = "does not say which arm it belongs to" if arm is None else f"cannot belong to {arm!r}"
    refuse((arm not in UR_ARMS, f"{file} {reason}; name the arm, one of {', '.join(UR_ARMS)}"))
    return _ur_robot(_parse_deltas(text, file), arm or "")
