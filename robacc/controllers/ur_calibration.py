"""Calibration files of Universal Robots' controllers (``calibration.conf``): differences from the nominal table.

The controller adds ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha`` to its nominal Denavit-Hartenberg
rows.
The other lines of the file (joint checksums, raw offsets) belong to one arm; they are kept from its own file.

Layout: files of public backups, and UR's forum, thread "Calibrated kinematics info" (18921).
"""

from __future__ import annotations

import re

import numpy as np

from robacc.controllers.dh_table import DhRow, DhTable, dh_table
from robacc.controllers.joint_frames import JointFrames, joint_frames, robot_of
from robacc.controllers.ur_models import UR_JOINTS, nearest_ur_arm, ur_table
from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Poses
from robacc.robots.description import Joint, Robot

KEYS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")
_FIELDS = ("theta", "a", "d", "alpha")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LINE = re.compile(r"^[ \t]*(delta_(?:theta|a|d|alpha))[ \t]*=[ \t]*\[([^\]\r\n]*)\]", re.M)
_LARGEST_DIFFERENCE = 5e-3
"""m: an arm that differs more from every arm of Universal Robots is none of them."""
_MARK = re.compile(r"^[ \t]*delta_(?:theta|a|d|alpha)[ \t]*=", re.M)


def is_ur_calibration(text: str) -> bool:
    """Return whether a text is a calibration file of Universal Robots."""
    return _MARK.search(text) is not None


def parse_deltas(text: str, file: str) -> tuple[DhRow, ...]:
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
    missing = [key for key in KEYS if key not in columns]
    if missing and not problems:
        fix = "give calibration.conf from the folder .urcontrol of the controller"
        problems.append(Problem(f"{', '.join(missing)} is missing", file, fix=fix))
    if problems:
        raise InputError(problems)
    theta, a, d, alpha = (columns[key] for key in KEYS)
    return tuple(DhRow(*row) for row in zip(theta, d, a, alpha, strict=True))


def ur_robot(deltas: tuple[DhRow, ...], arm: str) -> Robot:
    """Return the calibrated arm, its joint frames on the axes where the nominal arm has them."""
    nominal = _frames(ur_table(arm))
    rows = [
        DhRow(n.theta + c.theta, n.d + c.d, n.a + c.a, n.alpha + c.alpha)
        for n, c in zip(ur_table(arm), deltas, strict=True)
    ]
    exact = _frames(tuple(rows))
    pairs = zip(exact.frames[:-1], nominal.frames[:-1], strict=True)
    moved = (*(_beside(frame, near) for frame, near in pairs), exact.frames[-1])
    frames = JointFrames(exact.joints, moved, exact.flange)
    return robot_of(frames, Robot(f"Universal Robots {arm.upper()}, calibrated", "urdf", ()))


def _frames(rows: tuple[DhRow, ...]) -> JointFrames:
    """Return the joint frames of a table; each stands behind theta and d of its row."""
    current = Poses.identity()
    frames = []
    for row in rows:
        frames.append(current @ DhRow(row.theta, row.d, 0.0, 0.0).pose())
        current = current @ row.pose()
    turn = 2 * np.pi
    joints = tuple(Joint(name, "revolute", {}, limits=(-turn, turn)) for name in UR_JOINTS)
    return JointFrames(joints, tuple(frames), current)


def _beside(frame: Poses, near: Poses) -> Poses:
    """Return a frame on the same axis whose origin and x axis are nearest to those of another."""
    z = frame.rotation[:, 2]
    origin = frame.translation + z * (z @ (near.translation - frame.translation))
    x = near.rotation[:, 0] - z * (z @ near.rotation[:, 0])
    x = x / np.linalg.norm(x)
    return Poses(np.stack((x, np.cross(z, x), z), axis=1), origin)


def ur_arm_of(frames: JointFrames) -> str:
    """Return the name of the arm of Universal Robots that an arm is.

    Raises:
        UsageError: It is none of them.
    """
    fix = "the format ur-calibration is for arms of Universal Robots"
    if len(frames.frames) != len(UR_JOINTS) or any(joint.type != "revolute" for joint in frames.joints):
        raise UsageError(f"{fix}, which have six revolute joints")
    table = dh_table(frames, last_is_axis=True)
    lengths = [_distance(frames.frames[i], frames.frames[i + 1]) for i in (1, 2)]
    measures = [abs(table.rows[0].d), *lengths, abs(table.rows[4].d), abs(table.rows[5].d)]
    arm, difference = nearest_ur_arm(measures)
    if difference > _LARGEST_DIFFERENCE:
        raise UsageError(f"{fix}; the nearest, {arm}, differs by {difference * 1e3:.1f} mm: name the arm if it is one")
    return arm


def _distance(first: Poses, second: Poses) -> float:
    """Return the distance of a frame's origin from the z axis of another."""
    between = second.translation - first.translation
    z = first.rotation[:, 2]
    return float(np.linalg.norm(between - z * (z @ between)))


def ur_deltas_text(robot: Robot, arm: str, template: str | None = None) -> tuple[str, DhTable]:
    """Return the calibration file of an arm, and the table that it describes.

    Args:
        robot: Arm, without effects.
        arm: Its name in :data:`robacc.controllers.ur_models.UR_ARMS`.
        template: The arm's own calibration file, whose other lines are kept.
    """
    nominal = ur_table(arm)
    table = dh_table(joint_frames(robot), nominal, last_is_axis=True)
    columns = {
        key: [getattr(row, field) - getattr(base, field) for row, base in zip(table.rows, nominal, strict=True)]
        for key, field in zip(KEYS, _FIELDS, strict=True)
    }
    lines = {key: f"{key} = [ {', '.join(f'{value:.18g}' for value in values)}]" for key, values in columns.items()}
    if template is None:
        return "\n".join(["[mounting]", *(lines[key] for key in KEYS), ""]), table
    return _LINE.sub(lambda match: lines[match[1]], template), table
