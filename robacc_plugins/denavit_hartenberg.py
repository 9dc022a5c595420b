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
from collections.abc import Mapping, Sequence
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

_COLUMN = re.compile(
    r"(theta|θ|off(?:set)?|alpha|[α⍺]|beta|β|a|d|sigma|sign|direction|(?:joint|axis)?[ _]?type)"
    r"(?:[ijn]|_[ij]|[ⱼᵢ])?(?![a-z])(.*)",
    re.DOTALL,
)
_ROLES = {"θ": "theta", "α": "alpha", "⍺": "alpha", "β": "beta", "off": "offset", "direction": "sign"}
_ASIDE = re.compile(
    r"\W*|.*(?:min|max|low|upp|lim|range|std|tol|unnamed).*|[ijkn]"
    r"|(?:joint|link|axis|frame|name|row|index|id|no|num|mass|com|speed|vel|unit|comment|desc|关节|连杆|轴)(?!.*type).*",
    re.DOTALL,
)
"""Names of columns that do not change the arm."""
_VARIABLE = re.compile(r"(?:q|theta|θ|d)_?\d*\*?\s*(?=[+-]|$)|(?<=\d)\s*\+\s*(?:q|theta|θ|d)_?\d*\*?$", re.IGNORECASE)
"""Name of the joint's variable in the cell of its offset, as in ``q2 - 90``."""
_PI = re.compile(r"([+-]?)(\d*\.?\d*)\*?(?:pi|π)(?:/(\d+))?", re.IGNORECASE)
_PREVIOUS = re.compile(r"[-−]\s*1|prev", re.IGNORECASE)
"""Sign of Craig's form in the name of a column: the twist and length of the link before."""
_MARKUP = re.compile(r"[\\{}$]|</?su[bp]>")
"""Signs of TeX and of HTML in a name, as in ``\\alpha_{i-1}``."""
_RULE = re.compile(r"[-+=|:\s\u2500-\u257f]*")
"""Line of a drawn table without words."""
_ANGLES = {"deg": np.pi / 180, "°": np.pi / 180, "rad": 1.0}
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_LARGEST = {"deg": 2 * np.pi + 1e-3, "mm": 20.0}
"""Values above are in this unit, where no unit is stated; those below are in rad and m."""
_SUM_OF_LENGTHS = (0.15, 10.0)
"""m: smallest and largest sum of an arm's lengths for which a unit is believed that nobody stated."""


class _Cell(NamedTuple):
    """Number in a cell of a table."""

    value: float
    has_variable: bool = False
    unit: str | None = None
    """Unit of an angle that the cell itself states."""


class _Table(NamedTuple):
    """Columns of a table by their roles: theta, d, a, alpha, and offset, beta, sign, type, sigma where it has them."""

    head: Problem
    """Place of the head, for messages."""
    names: dict[str, str]
    """Rest of each column's name, behind the word for its role."""
    rows: list[Problem]
    """Place of each row, for messages."""
    cells: dict[str, list[str]]


def read_table(text: str, file: str) -> Robot | None:
    """Return the arm of a Denavit-Hartenberg table with columns theta, d, a, alpha; None for another text.

    A column ``offset`` counts as theta, and is added to it. Units are those in the names of the columns or in cells,
    else degrees and millimetres where the values are too large for rad and m. Craig's (modified) form is told by
    columns such as ``alpha_i-1``, by ``modDH`` in a listing, or by the first row, which has no twist and length then;
    the last row of a standard table has none. A joint is linear by its ``type``, by a ``sigma`` of 1, or by a variable
    in d.

    Raises:
        InputError: A cell is no number, a column changes the arm in an unknown way, or the form, a unit or an offset's
            joint is not told.
    """
    table = _table(text, file)
    if table is None:
        return None
    numbers = {
        role: [_number(cell, role, row) for cell, row in zip(cells, table.rows, strict=True)]
        for role, cells in table.cells.items()
        if role not in ("type", "sigma")
    }
    kinds = [_joint_type(table, numbers, k) for k in range(len(table.rows))]
    values = {name: [cell.value for cell in cells] for name, cells in numbers.items()}
    for units, names in ((_ANGLES, ("theta", "alpha", "offset", "beta")), (_LENGTHS, ("d", "a"))):
        values |= _in_si(table, {name: numbers[name] for name in names if name in numbers}, units)
    zeros = [0.0] * len(kinds)
    offset, angle, beta = (values.get(name, zeros) for name in ("offset", "theta", "beta"))
    signs = values.get("sign", [1.0] * len(kinds))
    values |= {"theta": [sum(pair) for pair in zip(angle, offset, strict=True)], "beta": beta}
    is_bare = [values["a"][k] == values["alpha"][k] == 0.0 for k in (0, -1)]
    is_craig = "modDH" in text or any(_PREVIOUS.search(table.names[name]) for name in ("a", "alpha"))
    is_standard = "stdDH" in text and not is_craig
    fix = "name the columns alpha_i-1 and a_i-1 for the modified (Craig's) form, or write a robot file"
    _refuse(
        table.head,
        (
            not (is_craig or is_standard) and is_bare[0] == is_bare[1],
            "does not tell whether the table is standard or modified",
            fix,
        ),
        (
            any(
                of_q and (kind == "prismatic" or theta) for of_q, kind, theta in zip(offset, kinds, angle, strict=True)
            ),
            "has an offset of a linear joint, or of one with an angle in theta, which may or may not have it",
            "add it to d or theta, or leave it out",
        ),
        (
            any(abs(sign) != 1 or (sign < 0 and of_q) for sign, of_q in zip(signs, offset, strict=True)),
            "has a sign other than 1 and -1, or one of -1 beside an offset, which may count before or after it",
            "write the offset as theta, the angle of the table where the joint reads zero",
        ),
    )
    joints = tuple(
        Joint(
            f"j{k + 1}",
            kind,
            {name: values[name][k] for name in DhRow._fields},
            limits=FULL_TURN if kind == "revolute" else None,
            sign=1 if signs[k] > 0 else -1,
        )
        for k, kind in enumerate(kinds)
    )
    is_modified = is_craig or (is_bare[0] and not is_standard)
    return Robot(PurePath(file).stem, "modified" if is_modified else "standard", joints)


def _refuse(place: Problem, *cases: tuple[object, str, str]) -> None:
    """Raise InputError of the first case that holds, with its message and its fix at a place."""
    refuse(*((holds, dataclasses.replace(place, message=text, fix=fix)) for holds, text, fix in cases))


def _table(text: str, file: str) -> _Table | None:
    """Return the table in a text, None where it has no head of one.

    Raises:
        InputError: It has no rows, or columns that are not clear.
    """
    lines = [(number, line.strip("% \r").replace("│", "|")) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line[:1] != "#" and not _RULE.fullmatch(line)]
    for start, (number, line) in enumerate(lines[:10]):
        mark = next((mark for mark in "|,;\t" if mark in line), None)
        titles = [title.lower() for title in _split(line, mark)]
        found = {_role(match) for title in titles if (match := _COLUMN.fullmatch(title))}
        if {"d", "a", "alpha"} <= found and {"theta", "offset"} & found:
            # Empty rows of a sheet are none, nor is the text below a drawn table.
            rows = [(below, _split(row, mark)) for below, row in lines[start + 1 :] if mark != "|" or mark in row]
            return _columns(titles, [row for row in rows if any(row[1])], Problem("", file, number))
    return None


def _split(line: str, mark: str | None) -> list[str]:
    """Return the cells of a line; blanks part those of a line without the mark."""
    plain = _MARKUP.sub("", line)
    cells = plain.strip("|") if mark == "|" else plain
    return [cell.strip() for cell in cells.split(mark if mark and mark in cells else None)]


def _role(match: re.Match[str]) -> str:
    """Return the role of a column of this name."""
    return "type" if match[1].endswith("type") else _ROLES.get(match[1], match[1])


def _columns(titles: Sequence[str], rows: Sequence[tuple[int, list[str]]], head: Problem) -> _Table:
    """Return the table with these titles of its columns, and these rows by their lines."""
    table = _Table(head, {}, [dataclasses.replace(head, line=number) for number, _ in rows], {})
    matches = {
        place: None if _ASIDE.fullmatch(title) else _COLUMN.fullmatch(title) for place, title in enumerate(titles)
    }
    of_theta = [place for place, match in matches.items() if match and _role(match) == "theta"]
    for place, match in matches.items():
        if match is None:
            unknown = f"the column {titles[place]!r} may change the arm in a way that robacc does not know"
            _refuse(head, (not _ASIDE.fullmatch(titles[place]), unknown, "leave it out if it does not"))
            continue
        role = "offset" if len(of_theta) > 1 and place in of_theta and "off" in match[2] else _role(match)
        _refuse(head, (role in table.names, f"two columns say {role}", "leave one of them out"))
        table.names[role] = match[2]
        table.cells[role] = [row[place] if place < len(row) else "" for _, row in rows]
    _refuse(head, (not rows, "has a head and no rows", "add a row for each joint"))
    return table


def _number(cell: str, role: str, where: Problem) -> _Cell:
    """Return the number in a cell, without the joint's variable; a blank one is none but in an optional column."""
    plain = re.sub(r"[\s°]", "", cell.replace("−", "-"))
    rest = _VARIABLE.sub("", plain) if role in ("theta", "offset", "d") else plain
    has_variable = rest != plain
    if (match := _PI.fullmatch(rest)) is not None:
        return _Cell(float(f"{match[1]}{match[2] or 1}") * np.pi / float(match[3] or 1), has_variable, "rad")
    is_optional = has_variable or role in ("theta", "offset", "beta", "sign")
    blank = ("1" if role == "sign" else "0") if is_optional else ""
    try:
        return _Cell(float(rest or blank), has_variable, "°" if "°" in cell else None)
    except ValueError:
        fix = "give numbers, and offsets of the joint's variable such as q2 - 90"
        problem = dataclasses.replace(where, message=f"found {cell!r} in place of a number", fix=fix)
        raise InputError(problem) from None


def _joint_type(table: _Table, numbers: Mapping[str, Sequence[_Cell]], k: int) -> JointType:
    """Return the type of the joint of a row: by its column, or by the place of its variable.

    Raises:
        InputError: It is not clear.
    """
    of_theta = [cell.has_variable for cell in numbers.get("theta", ())]
    has_theta, has_d = bool(of_theta and of_theta[k]), numbers["d"][k].has_variable
    column = next((name for name in ("type", "sigma") if name in table.cells), None)
    types = {"type": ("ptls", "rc"), "sigma": ("1", "0")}
    # Letters q are of variables; d may be a length whose number stands elsewhere.
    is_slide, is_turn = has_d and (any(of_theta) or table.cells["d"][k][:1] == "q"), not has_d
    if column is not None:
        first = table.cells[column][k][:1].lower() or "?"
        is_slide, is_turn = (first in letters for letters in types[column])
    fix = "write the number; only d of a linear joint and theta of another one have a variable"
    _refuse(
        table.rows[k],
        (column and not (is_slide or is_turn), "is neither revolute nor prismatic", "a fixed row belongs to the tool"),
        ((has_theta if is_slide else has_d), "has a symbol in place of a number in d or theta", fix),
        (
            column is None and any(of_theta) and not (has_theta or has_d),
            "has no variable, unlike other rows",
            "a fixed row belongs to the tool or the base of a robot file",
        ),
    )
    return "prismatic" if is_slide else "revolute"


def _in_si(table: _Table, numbers: Mapping[str, Sequence[_Cell]], units: Mapping[str, float]) -> dict[str, list[float]]:
    """Return the columns of angles, or of lengths, in SI units.

    Raises:
        InputError: A unit is not clear.
    """
    likely, is_angle = next(iter(units)), units is _ANGLES
    marks = {name: {cell.unit for cell in cells if cell.unit} for name, cells in numbers.items()}
    stated = {
        name: next((unit for unit in units if unit in table.names[name] or unit in marks[name]), None)
        for name in numbers
    }
    values = {name: np.array([cell.value for cell in cells]) for name, cells in numbers.items()}
    largest = max(float(np.abs(column).max()) for column in values.values())
    guess = likely if largest > _LARGEST[likely] else list(units)[-1]
    scaled = {name: column * units[stated[name] or guess] for name, column in values.items()}
    is_free = [name for name, unit in stated.items() if unit is None and np.any(values[name])]
    total = sum(float(np.abs(column).sum()) for column in scaled.values())
    low, high = _SUM_OF_LENGTHS
    fix = (
        f"check the order of the columns, and write units in their names, as in {'alpha' if is_angle else 'd'}_{likely}"
    )
    for name, column in scaled.items():
        turns = values[name] / (np.pi / 2)
        is_rad = name in is_free and guess == likely and np.allclose(turns, np.round(turns), atol=1e-3)
        _refuse(
            table.head,
            (is_angle and len(marks[name]) > 1, f"{name} has several units", fix),
            (is_angle and is_rad, f"{name} is in quarter turns of rad, but another angle is too large for rad", fix),
            (is_angle and np.abs(column).max() > _LARGEST["deg"], f"{name} is more than a turn", fix),
            (
                not is_angle and is_free and not (low if guess == likely else 0.0) <= total <= high,
                f"does not tell the unit of the lengths: in {guess} they sum to {total:g} m",
                fix,
            ),
        )
    return {name: [float(value) for value in column] for name, column in scaled.items()}
