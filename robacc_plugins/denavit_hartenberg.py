"""Formats with an arm's geometry: Denavit-Hartenberg tables, and robacc's JSON document.

Every format is written from the frames on the arm's joint axes, or from the Denavit-Hartenberg table that they give.
Two axes that are not exactly parallel have one common normal, and with it one row. For nearly parallel axes the normal
lies far away: d is then hundreds of metres, as in the calibration files of Universal Robots. The poses are the same.

Source: J. Denavit and R. S. Hartenberg, "A kinematic notation for lower-pair mechanisms based on matrices", J. Applied
Mechanics 22, 1955; J. J. Craig, Introduction to Robotics (1986), for the modified form.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
from collections.abc import Sequence
from functools import partial
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
import yaml

from robacc.errors import InputError, Problem, refuse
from robacc.exporters import Written
from robacc.geometry import Array, Poses, exp_so3, rotation_about
from robacc.io.yaml_nodes import Source, top_section
from robacc.robots.arm import Arm
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, JointType, Robot
from robacc.robots.yaml_robot import Kind, read_fields, read_list, read_section, robot_to_yaml
from robacc.version import __version__

# Arm as frames on its joint axes, whatever the convention of its description.


def joint_frames(robot: Robot) -> list[Poses]:
    """Return the frame of each joint variable, all at zero, then that of the last link, in the robot's base frame.

    The z axis of a frame is that of its joint, in the positive direction. The effects of the robot do not count.

    Raises:
        UsageError: A joint follows others, which controllers' parameters cannot describe.
    """
    arm = Arm.of(robot)
    chain = arm.chain
    own = set(enumerate(chain.joint_axis))
    motions = [chain.motions[drive.motion] for drive in chain.drives if (drive.joint, drive.motion) not in own]
    names = ", ".join(sorted({robot.joints[motion.owner].name for motion in motions}))
    refuse((names, f"{names} follows other joints; the format has no joint that does"))
    # A DH row's d lies on the axis too: the frame behind it is the one that drawings show.
    counts = [k + 1 + (chain.motions[k + 1].label == "d") for k in chain.joint_axis]
    wanted = sorted({*counts, arm.flange})
    stored = chain.sweep(chain.scalars(np.zeros((chain.n_joints, 1))), 1, (), wanted).frames
    poses = (Poses(pose.rotation[..., 0], pose.translation[..., 0]) for pose in stored)
    at = {count: robot.base.pose.inverse() @ pose for count, pose in zip(wanted, poses, strict=True)}
    turned = Poses(exp_so3(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    pairs = zip(robot.variables, counts, strict=True)
    return [*(at[count] @ turned if joint.sign < 0 else at[count] for joint, count in pairs), at[arm.flange]]


def steps(frames: Sequence[Poses]) -> list[Frame]:
    """Return each frame in the one before it, the first as it is."""
    return [Frame.of(before.inverse() @ after) for before, after in itertools.pairwise([Poses.identity(), *frames])]


FULL_TURN = (-2 * np.pi, 2 * np.pi)
"""Limits of the joints of files that state none, rad."""


def joint_at(
    origin: Frame, name: str, kind: JointType = "revolute", limits: tuple[float, float] | None = FULL_TURN
) -> Joint:
    """Return a joint in the URDF convention that turns about, or moves along, the z axis of its origin."""
    parameters = dict(zip(ORIGIN_PARAMETERS, (*origin.xyz, *origin.rpy, 0.0), strict=True))
    return Joint(name, kind, parameters, limits=limits)


# The same poses with four numbers a joint.

_NEARLY_PARALLEL = 0.03
"""Sine of the angle between axes below which Hayati's parameter describes them better."""
_PARALLEL = 1e-8
"""Sine of the angle between axes, rad, below which they count as parallel."""


class DhRow(NamedTuple):
    """Row of a standard table: Rz(theta + q) Tz(d) Tx(a) Rx(alpha) Ry(beta); q is added to d in a prismatic joint."""

    theta: float
    d: float
    a: float
    alpha: float
    beta: float = 0.0
    """Hayati's rotation, zero in a plain table."""

    def pose(self) -> Poses:
        """Return the transform of the row with the joint variable at zero."""
        turn = rotation_about(2, self.theta)
        offset = turn[:, 0] * self.a + np.array([0.0, 0.0, self.d])
        return Poses(turn @ rotation_about(0, self.alpha) @ rotation_about(1, self.beta), offset)


class DhTable(NamedTuple):
    """Table of an arm: ``base Row_1 … Row_n tool`` is the flange's pose in the robot's base frame."""

    rows: tuple[DhRow, ...]
    base: Poses
    tool: Poses
    """Flange in the last row's frame."""


def dh_table(
    frames: Sequence[Poses], hints: Sequence[DhRow] | None = None, *, last_is_axis: bool = False, hayati: bool = False
) -> DhTable:
    """Return the standard table of an arm.

    Args:
        frames: From :func:`joint_frames`.
        hints: Table that the result resembles where the arm leaves a choice: the sign of a normal, d of parallel axes.
        last_is_axis: Keep a and alpha of the last row at zero; what differs is in ``tool``.
        hayati: Describe nearly parallel axes by beta instead of a distant common normal.
    """
    *axes, flange = frames
    z, point = axes[0].rotation[:, 2], axes[0].translation
    base = Poses.identity()
    if not (np.hypot(z[0], z[1]) < 1e-12 and z[2] > 0 and np.hypot(point[0], point[1]) < 1e-12):
        # The first axis is not the z axis of the robot's base: the table begins on the axis.
        x = unit_across(np.array([1.0, 0.0, 0.0]), z)
        base = Poses(np.stack((x, np.cross(z, x), z), axis=1), point - z * (z @ point))
    # A flange that is meant to stand on the last axis has no common normal with it that is worth a row.
    end = axes[-1] if last_is_axis or _is_nearly_parallel(axes[-1], flange) else flange
    current, rows = base, []
    for i, following in enumerate([*axes[1:], end]):
        hint = None if hints is None else hints[i]
        # The last frame is free about and along its axis: it stands at the flange.
        row = _row(current, following, hint, hayati) if i < len(axes) - 1 else _row(current, end, hint, place=flange)
        rows.append(row)
        current = current @ row.pose()
    return DhTable(tuple(rows), base, current.inverse() @ flange)


def modified_rows(table: DhTable) -> tuple[list[DhRow], Poses]:
    """Return Craig's rows, Rx(alpha) Tx(a) Ry(beta) Rz(theta) Tz(d), and the flange behind the last."""
    pairs = itertools.pairwise([DhRow(0.0, 0.0, 0.0, 0.0), *table.rows])
    rows = [DhRow(row.theta, row.d, previous.a, previous.alpha, previous.beta) for previous, row in pairs]
    return rows, table.rows[-1]._replace(theta=0.0, d=0.0).pose() @ table.tool


def unit_across(vector: Array, axis: Array) -> Array:
    """Return the unit vector across ``axis`` nearest to ``vector``, or nearest to y where ``vector`` lies along it."""
    candidates = (vector, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    across = (candidate - axis * (axis @ candidate) for candidate in candidates)
    # One of two axes lies across any third.
    longest: Array = next(part for part in across if float(np.linalg.norm(part)) > 1e-6)
    return np.asarray(longest / np.linalg.norm(longest))


def _is_nearly_parallel(current: Poses, following: Poses) -> bool:
    sine = float(np.linalg.norm(np.cross(current.rotation[:, 2], following.rotation[:, 2])))
    return _PARALLEL < sine < _NEARLY_PARALLEL


def _row(
    current: Poses, following: Poses, hint: DhRow | None, hayati: bool = False, place: Poses | None = None
) -> DhRow:
    """Return the row from a frame to the next, whose z axis is that of ``following``.

    With ``hayati``, the x axis between nearly parallel axes meets the next axis in the plane across the current one.
    Source: S. Hayati, "Robot arm geometric link parameter estimation", 22nd IEEE Conf. Decision and Control, 1983. With
    ``place``, the row is the last, and its frame stands there.
    """
    z, direction = current.rotation[:, 2], following.rotation[:, 2]
    between = following.translation - current.translation
    normal = np.cross(z, direction)
    sine, beta = float(np.linalg.norm(normal)), 0.0
    if hayati and _is_nearly_parallel(current, following):
        across = between - direction * (between @ z) / (direction @ z)
        d, a = 0.0, float(np.linalg.norm(across))
        x = across / a if a > 1e-12 else current.rotation[:, 0]
        # The z axis behind the row is (sin beta, -sin alpha cos beta, cos alpha cos beta).
        u = np.array([x @ direction, np.cross(z, x) @ direction, z @ direction])
        alpha, beta = float(np.arctan2(-u[1], u[2])), float(np.arcsin(np.clip(u[0], -1.0, 1.0)))
    elif sine > _PARALLEL:
        x = normal / sine
        # Feet of the common normal: origin + d z and point + t direction.
        d = float(np.cross(between, direction) @ normal) / sine**2
        along = float(np.cross(between, z) @ normal) / sine**2
        a = float((between + along * direction - d * z) @ x)
        alpha = float(np.arctan2(sine, z @ direction))
    else:
        across = between - z * (z @ between)
        a = float(np.linalg.norm(across))
        x = across / a if a > 1e-12 else unit_across((place or current).rotation[:, 0], z)
        a = a if a > 1e-12 else 0.0
        d = float(((place or following).translation - current.translation) @ z)
        d = hint.d if hint is not None and place is None else d
        alpha = 0.0 if z @ direction > 0 else np.pi
    theta = float(np.arctan2(x @ current.rotation[:, 1], x @ current.rotation[:, 0]))
    # The other direction of the normal is taken where its theta is nearer to the hint's, or to zero.
    aim = 0.0 if hint is None else hint.theta
    if abs(_wrapped(theta - aim)) > abs(_wrapped(theta + np.pi - aim)):
        theta, a, alpha, beta = theta + np.pi, -a, -alpha, -beta
    alpha = alpha if hint is None else hint.alpha + _wrapped(alpha - hint.alpha)
    return DhRow(aim + _wrapped(theta - aim), d, a, alpha, beta)


def _wrapped(angle: float) -> float:
    """Return the angle within half a turn of zero."""
    return float(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))


def write_table(robot: Robot) -> Written:
    """Return the text of an arm as a robot file with a modified table."""
    table = dh_table(joint_frames(robot), hayati=True)
    rows, flange = modified_rows(table)
    joints = tuple(
        Joint(joint.name, joint.type, row._asdict(), limits=joint.limits, gear_ratio=joint.gear_ratio)
        for joint, row in zip(robot.variables, rows, strict=True)
    )
    base, tool = Frame.of(robot.base.pose @ table.base), Frame.of(flange @ robot.tool.pose)
    modified = Robot(robot.name, "modified", joints, base=base, tool=tool, gravity=robot.gravity)
    return Written(robot_to_yaml(modified), controller=modified)


# JSON document of an arm: joint origins, standard and modified table.

KINEMATICS_SCHEMA = "robacc.kinematics/1"
"""Value of ``schema`` in a file of the format json."""


def write_json(robot: Robot) -> Written:
    """Return the JSON document of an arm, with standard and modified table: m and rad."""
    frames = joint_frames(robot)
    table = dh_table(frames)
    modified, flange = modified_rows(table)
    joints = [
        {
            "name": joint.name,
            "type": joint.type,
            "limits": None if joint.limits is None else list(joint.limits),
            "origin": dataclasses.asdict(step),
            "dh": {"theta": row.theta, "d": row.d, "a": row.a, "alpha": row.alpha},
            "modified_dh": {"alpha": other.alpha, "a": other.a, "theta": other.theta, "d": other.d},
        }
        for joint, step, row, other in zip(robot.variables, steps(frames), table.rows, modified, strict=False)
    ]
    document = {
        "schema": KINEMATICS_SCHEMA,
        "robacc": __version__,
        "name": robot.name,
        "units": {"length": "m", "angle": "rad"},
        "gravity": list(robot.gravity),
        "base": dataclasses.asdict(robot.base),
        "joints": joints,
        "tool": dataclasses.asdict(Frame.of(frames[-2].inverse() @ frames[-1] @ robot.tool.pose)),
        "dh_base": dataclasses.asdict(Frame.of(robot.base.pose @ table.base)),
        "dh_tool": dataclasses.asdict(Frame.of(table.tool @ robot.tool.pose)),
        "modified_dh_tool": dataclasses.asdict(Frame.of(flange @ robot.tool.pose)),
    }
    return Written(json.dumps(document, indent=2) + "\n")


def _unread(source: Source, node: yaml.Node, path: str) -> None:
    """Take a key for granted that is only for other programs."""


_JSON_FRAME = partial(
    read_section,
    kinds=dict.fromkeys(("xyz", "rpy"), partial(Source.numbers, count=3)),
    required=("xyz", "rpy"),
    into=Frame,
)
_JSON_JOINT: dict[str, Kind] = {
    "origin": _JSON_FRAME,
    "name": Source.text,
    "type": partial(Source.choice, options=("revolute", "prismatic")),
    "limits": partial(Source.numbers, count=2),
    **dict.fromkeys(("dh", "modified_dh"), _unread),
}
_JSON: dict[str, Kind] = {
    "name": Source.text,
    "gravity": partial(Source.numbers, count=3),
    "base": _JSON_FRAME,
    "tool": _JSON_FRAME,
    "joints": partial(
        read_list,
        kind=partial(read_section, kinds=_JSON_JOINT, required=("origin", "name", "type")),
        item_name="joints",
    ),
}


def read_json(text: str, file: str) -> Robot | None:
    """Return the arm of a JSON document; None for another text.

    Raises:
        InputError: The document has errors.
    """
    if KINEMATICS_SCHEMA.partition("/")[0] not in text:
        return None
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(Problem(f"is not JSON: {error.msg}", file, error.lineno)) from None
    other = Problem(f"is not a kinematics file of robacc ({KINEMATICS_SCHEMA})", file)
    refuse((document.get("schema") != KINEMATICS_SCHEMA, other))
    top = top_section(text.replace("\t", " "), file, tuple(document))
    values = read_fields(top, _JSON, ("gravity", "base", "tool", "joints"))
    top.source.raise_if_any()
    joints = tuple(
        joint_at(joint["origin"], joint["name"], joint["type"], joint.get("limits")) for joint in values.pop("joints")
    )
    return Robot(convention="urdf", joints=joints, **{"name": "arm", **values})


# Table as text, as papers and spreadsheets have it: a row a joint, columns theta, d, a, alpha in any order.

_COLUMN = re.compile(r"(theta|θ|offset|alpha|α|a|d|type)(?![a-z])(.*)", re.IGNORECASE | re.DOTALL)
_GREEK = {"θ": "theta", "α": "alpha"}
_VARIABLE = re.compile(r"(?:q|theta|θ|d)_?\d*\s*(?=[+-]|$)|(?<=\d)\s*\+\s*(?:q|theta|θ|d)_?\d*$", re.IGNORECASE)
"""Name of the joint's variable in the cell of its offset, as in ``q2 - 90``."""
_PREVIOUS = re.compile(r"[-−]\s*1|prev", re.IGNORECASE)
"""Sign of Craig's form in the name of a column: the twist and length of the link before."""


def read_table(text: str, file: str) -> Robot | None:
    """Return the arm of a Denavit-Hartenberg table with columns theta, d, a, alpha; None for another text.

    A column ``offset`` counts as theta, and is added to it. Units are those in the names of the columns, else degrees
    and millimetres where the values are too large for rad and m. Craig's (modified) form is told by columns such as
    ``alpha_i-1``, or by the first row, which has no twist and length then; the last row of a standard table has none.

    Raises:
        InputError: A cell is no number, or the form or an offset's joint is not told.
    """
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    delimiter = next((mark for mark in ",;\t" if lines and mark in lines[0][1]), None)
    cells = [
        (number, [cell.strip() for cell in line.split(delimiter if delimiter and delimiter in line else None)])
        for number, line in lines
    ]
    found = [_COLUMN.fullmatch(name) for name in (cells[0][1] if cells else ())]
    columns = {_GREEK.get(m[1].lower(), m[1].lower()): (place, m[2].lower()) for place, m in enumerate(found) if m}
    if not {"d", "a", "alpha"} <= columns.keys() or not {"theta", "offset"} & columns.keys():
        return None
    values = {
        name: [_number(row, columns[name][0], number, file) for number, row in cells[1:]]
        for name in (*DhRow._fields[:4], "offset")
        if name in columns
    }
    angles = [name for name in ("theta", "alpha", "offset") if name in columns]
    for names, units, likely, most in (
        (angles, {"deg": np.pi / 180, "°": np.pi / 180, "rad": 1.0}, "deg", 2 * np.pi + 1e-3),
        (["d", "a"], {"mm": 1e-3, "cm": 1e-2, "m": 1.0}, "mm", 20.0),
    ):
        largest = max((abs(value) for name in names for value in values[name]), default=0.0)
        for name in names:
            stated = next((size for unit, size in units.items() if unit in columns[name][1]), None)
            size = stated or (units[likely] if largest > most else 1.0)
            values[name] = [value * size for value in values[name]]
    place = columns["type"][0] if "type" in columns else None
    is_slide = [place is not None and row[place][:1].lower() in ("p", "t", "l") for _, row in cells[1:]]
    offset, angle = (values.get(name, [0.0] * len(is_slide)) for name in ("offset", "theta"))
    values["theta"] = [sum(pair) for pair in zip(angle, offset, strict=True)]
    rows = [DhRow(*row) for row in zip(*(values[name] for name in DhRow._fields[:4]), strict=True)]
    is_bare = [row.a == row.alpha == 0.0 for row in (rows[0], rows[-1])] if rows else [True, True]
    is_modified = any(_PREVIOUS.search(columns[name][1]) for name in ("a", "alpha"))
    fix = "name the columns alpha_i-1 and a_i-1 for the modified (Craig's) form, or write a robot file"
    refuse(
        (not rows, Problem("has a head and no rows", file, cells[0][0], fix="add a row for each joint")),
        (
            not is_modified and is_bare[0] == is_bare[1],
            Problem("does not tell whether the table is standard or modified", file, cells[0][0], fix=fix),
        ),
        (
            any(of_q and (slides or theta) for of_q, slides, theta in zip(offset, is_slide, angle, strict=True)),
            Problem(
                "has an offset of a linear joint, or of one with an angle in theta, which may or may not have it",
                file,
                cells[0][0],
                fix="add it to d or theta, or leave it out",
            ),
        ),
    )
    kinds: list[JointType] = ["prismatic" if slides else "revolute" for slides in is_slide]
    joints = tuple(
        Joint(f"j{number}", kind, row._asdict(), limits=FULL_TURN if kind == "revolute" else None)
        for number, (kind, row) in enumerate(zip(kinds, rows, strict=True), 1)
    )
    return Robot(PurePath(file).stem, "modified" if is_modified or is_bare[0] else "standard", joints)


def _number(row: Sequence[str], place: int, line: int, file: str) -> float:
    """Return the number in a cell, without the joint's variable."""
    cell = row[place] if place < len(row) else ""
    try:
        return float(_VARIABLE.sub("", cell).replace(" ", "").replace("−", "-") or "0")
    except ValueError:
        fix = "give numbers, and offsets of the joint's variable such as q2 - 90"
        raise InputError(Problem(f"found {cell!r} in place of a number", file, line, fix=fix)) from None
