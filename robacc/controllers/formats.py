"""Models in the formats of controllers, drivers and simulators, written with what each leaves out, and read back."""

from __future__ import annotations

import dataclasses
import json
import math
import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import yaml

from robacc.accuracy.estimation import pose_metrics
from robacc.controllers.dh_table import (
    FULL_TURN,
    DhRow,
    JointFrames,
    dh_table,
    joint_at,
    joint_frames,
    modified_rows,
    robot_of,
)
from robacc.effects.base import Effect
from robacc.effects.joint_offset import JointOffset
from robacc.effects.link_geometry import LinkGeometry
from robacc.errors import InputError, Problem, RobaccError, UsageError
from robacc.fitting.fit_result import Options
from robacc.fitting.parameters import absorb_constants, apply_fit
from robacc.fitting.solver import fit
from robacc.geometry import Poses, log_between
from robacc.io.yaml_nodes import Source, compose
from robacc.modelling.model import Model, predict
from robacc.plug_ins import plug_in
from robacc.robots.description import Frame, Joint, Robot
from robacc.robots.urdf_writer import robot_to_urdf
from robacc.robots.yaml_writer import robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.version import __version__

# Best model that a controller can take, and the error that remains because it cannot take everything.
#
# The parameters that the format has are fitted again to poses of the complete model, so that they take up what they can
# of the effects that the format lacks; those effects are not just cut off.

FIT_POSES = 400
CHECK_POSES = 1000
_SEEDS = (11, 12)
"""Seeds of the poses for the fit and of those for the remaining error."""


@dataclass(frozen=True, slots=True)
class RemainingError:
    """Difference between a complete model and what the controller takes, over poses within the joint limits."""

    poses: int
    position_rms: float
    """m"""
    position_max: float
    orientation_rms: float
    """rad"""
    orientation_max: float


def restricted(robot: Robot, nominal: Robot | None = None) -> tuple[Robot, Robot, tuple[str, ...], tuple[str, ...]]:
    """Return the arm with all geometry free, fitted to the robot's effects; exact where there are only constants.

    With ``nominal``, return this arm with joint offsets fitted to the robot, base and tool as in the robot. Beside it
    are the complete arm that it was fitted to, with constants in its numbers, the names of its effects, which the
    parameters take up as far as they can, and those of effects that depend on circumstances, which are left out.

    Raises:
        UsageError: The two have different joints.
    """
    whole = absorb_constants(robot)
    start = dataclasses.replace(whole if nominal is None else absorb_constants(nominal), effects=())
    if nominal is not None:
        start = dataclasses.replace(start, base=robot.base, tool=robot.tool, targets=robot.targets)
    kept, names, excluded = [], [], []
    for entry in whole.effects:
        name = str(entry.get("effect", "?"))
        try:
            simulate(_single_target(dataclasses.replace(whole, effects=(entry,))), Plan(2, seed=_SEEDS[0]))
        except RobaccError:
            excluded.append(name)
        else:
            kept.append(entry)
            names.append(name)
    complete = dataclasses.replace(whole, effects=tuple(kept))
    if nominal is not None or kept:
        data = simulate(_single_target(complete), Plan(FIT_POSES, seed=_SEEDS[0])).data
        model = Model.of(_single_target(start))
        joints = model.arm.names
        free: list[Effect] = [JointOffset(joints)]
        free += [LinkGeometry(joints)] if nominal is None else []
        fitted = apply_fit(fit(model.with_free(*free), data, Options(robust=False)))
        start = dataclasses.replace(fitted, tool=start.tool, targets=start.targets)
    return start, complete, tuple(names), tuple(excluded)


def remaining_error(complete: Robot, controller: Robot) -> RemainingError:
    """Return the difference of the poses of two arms within the joint limits of the first."""
    data = simulate(_single_target(complete), Plan(CHECK_POSES, seed=_SEEDS[1])).data
    attained = predict(_single_target(controller), dataclasses.replace(data, target=None))
    rotation = data.rotation
    assert rotation is not None
    errors = pose_metrics(np.vstack((attained.translation - data.position, log_between(attained.rotation, rotation))))
    assert errors.orientation is not None
    return RemainingError(
        data.n, errors.position.rms, errors.position.max, errors.orientation.rms, errors.orientation.max
    )


def _single_target(robot: Robot) -> Robot:
    """Return the robot with its flange as the only target, where it has several."""
    return dataclasses.replace(robot, targets={}, tool=Frame()) if robot.targets else robot


# Nominal Denavit-Hartenberg parameters of the arms of Universal Robots.
#
# Source: Universal Robots, "DH parameters for calculations of kinematics and dynamics", support article 45257.

_HALF = math.pi / 2
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


def ur_table(arm: str) -> tuple[DhRow, ...]:
    """Return the nominal standard table of an arm of :data:`UR_ARMS`."""
    d1, a2, a3, d4, d5, d6 = _LENGTHS[arm]
    return (
        DhRow(0.0, d1, 0.0, _HALF),
        DhRow(0.0, 0.0, a2, 0.0),
        DhRow(0.0, 0.0, a3, 0.0),
        DhRow(0.0, d4, 0.0, _HALF),
        DhRow(0.0, d5, 0.0, -_HALF),
        DhRow(0.0, d6, 0.0, 0.0),
    )


# Kinematics files of ROS drivers: one origin (x, y, z, roll, pitch, yaw) for each joint.
#
# ``ur_description`` reads such a file for an arm of Universal Robots (``default_kinematics.yaml``, or the file that
# ``ur_calibration`` extracts), ``xarm_description`` one for an arm of UFACTORY. The numbers are the origins of URDF
# joints that turn about z: R = Rz(yaw) Ry(pitch) Rx(roll).

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


def parse_links(text: str, file: str) -> Robot:
    """Return the arm of a kinematics file.

    Raises:
        InputError: The file has no ``kinematics``, its joints are neither UR's nor joint1 to jointN, or a number is
            missing.
    """
    source = Source(file)
    root = compose(text, file)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    nodes = [value for key, value in pairs if key.value == "kinematics" and isinstance(value, yaml.MappingNode)]
    if not nodes:
        fix = "give default_kinematics.yaml, the file of ur_calibration, or a kinematics file of xarm_description"
        raise InputError(Problem("has no key kinematics with an origin for each joint", file, fix=fix))
    origins: dict[str, list[float]] = {}
    for name, _, value in source.entries(nodes[0], "kinematics"):
        if name != "hash" and (section := source.section(value, f"kinematics.{name}", _KEYS)):
            items = [(section.require(key), section.at(key)) for key in _KEYS]
            origins[name] = [source.number(item, path) or 0.0 if item else 0.0 for item, path in items]
    source.finish()
    names = _names(tuple(origins), file)
    joints = [
        joint_at(_frame({"xyz": origins[link][:3], "rpy": origins[link][3:]}), name) for link, name in names.items()
    ]
    is_ur = tuple(names.values()) == UR_JOINTS
    return Robot("Universal Robots arm" if is_ur else f"{len(joints)}-axis arm", "urdf", tuple(joints))


def links_text(frames: JointFrames, form: str, name: str, template: str) -> tuple[str, Frame]:
    """Return the kinematics file of an arm, and the flange in the last joint's frame, which the file cannot hold.

    Args:
        frames: The arm.
        form: ``ur-kinematics`` or ``xarm``.
        name: Name of the arm, for the comment at the top.
        template: The arm's own file, whose line ``hash: …`` is kept: the driver knows the arm by it.

    Raises:
        UsageError: The arm has a prismatic joint, or for ``ur-kinematics`` other than six joints.
    """
    if any(joint.type != "revolute" for joint in frames.joints):
        raise UsageError(f"the format {form} has revolute joints only")
    names = UR_LINKS if form != "xarm" else tuple(f"joint{i + 1}" for i in range(len(frames.joints)))
    if len(frames.joints) != len(names):
        raise UsageError(f"the format {form} is for arms with six joints; this one has {len(frames.joints)}")
    *steps, flange = map(Frame.of, frames.steps())
    lines = [f"# written by robacc {__version__} from {name}", "kinematics:"]
    for link, step in zip(names, steps, strict=True):
        numbers = zip(_KEYS, (*step.xyz, *step.rpy), strict=True)
        lines += [f"  {link}:", *(f"    {key}: {float(value)!r}" for key, value in numbers)]
    lines += [f"  {line.strip()}" for line in template.splitlines() if line.strip().startswith("hash:")][:1]
    return "\n".join([*lines, ""]), flange


def _names(links: tuple[str, ...], file: str) -> dict[str, str]:
    """Return the joint of each link, in the order of the arm."""
    if set(links) == set(UR_LINKS):
        return dict(zip(UR_LINKS, UR_JOINTS, strict=True))
    numbered = [f"joint{i + 1}" for i in range(len(links))]
    if links and set(links) == set(numbered):
        return {name: name for name in numbered}
    fix = f"expected {', '.join(UR_LINKS)}, or joint1, joint2 …"
    raise InputError(Problem(f"the joints are {', '.join(links) or 'missing'}", file, column="kinematics", fix=fix))


# Calibration files of Universal Robots' controllers (``calibration.conf``): differences from the nominal table.
#
# The controller adds ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha`` to its nominal Denavit-Hartenberg
# rows.
# The other lines of the file (joint checksums, raw offsets) belong to one arm; they are kept from its own file.
#
# Layout: files of public backups, and UR's forum, thread "Calibrated kinematics info" (18921).

KEYS = ("delta_theta", "delta_a", "delta_d", "delta_alpha")
_FIELDS = ("theta", "a", "d", "alpha")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_LINE = re.compile(r"^[ \t]*(delta_(?:theta|a|d|alpha))[ \t]*=[ \t]*\[([^\]\r\n]*)\]", re.M)
_LARGEST_DIFFERENCE = 5e-3
"""m: an arm that differs more from every arm of Universal Robots is none of them."""
_MARK = re.compile(r"^[ \t]*delta_(?:theta|a|d|alpha)[ \t]*=", re.M)


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
    table = ur_table(arm)
    nominal = _frames(table)
    exact = _frames([DhRow(*map(operator.add, *rows)) for rows in zip(table, deltas, strict=True)])
    pairs = zip(exact.frames[:-1], nominal.frames[:-1], strict=True)
    moved = (*(_beside(frame, near) for frame, near in pairs), exact.frames[-1])
    frames = JointFrames(exact.joints, moved, exact.flange)
    return robot_of(frames, Robot(f"Universal Robots {arm.upper()}, calibrated", "urdf", ()))


def _frames(rows: Sequence[DhRow]) -> JointFrames:
    """Return the joint frames of a table; each stands behind theta and d of its row."""
    current = Poses.identity()
    frames = []
    for row in rows:
        frames.append(current @ DhRow(row.theta, row.d, 0.0, 0.0).pose())
        current = current @ row.pose()
    joints = tuple(Joint(name, "revolute", {}, limits=FULL_TURN) for name in UR_JOINTS)
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
    measures = np.abs([table.rows[0].d, *lengths, table.rows[4].d, table.rows[5].d])
    # d4 and the sign of a length depend on the frames that stand for the axes.
    known = np.abs(np.delete(list(_LENGTHS.values()), 3, axis=1))
    differences = np.abs(known - measures).max(axis=1)
    arm, difference = UR_ARMS[int(differences.argmin())], differences.min()
    if difference > _LARGEST_DIFFERENCE:
        raise UsageError(f"{fix}; the nearest, {arm}, differs by {difference * 1e3:.1f} mm: name the arm if it is one")
    return arm


def known_ur_arm(robot: Robot) -> str | None:
    """Return the name of the arm of Universal Robots that a robot is; None if it is none."""
    try:
        return ur_arm_of(joint_frames(restricted(robot)[0]))
    except UsageError:
        return None


def _distance(first: Poses, second: Poses) -> float:
    """Return the distance of a frame's origin from the z axis of another."""
    between = second.translation - first.translation
    z = first.rotation[:, 2]
    return float(np.linalg.norm(between - z * (z @ between)))


def _deltas_text(deltas: Sequence[DhRow], template: str | None = None) -> str:
    """Return the calibration file of an arm; with a ``template``, its own file, whose other lines are kept."""
    lines = {
        key: f"{key} = [ {', '.join(f'{getattr(row, field):.18g}' for row in deltas)}]"
        for key, field in zip(KEYS, _FIELDS, strict=True)
    }
    if template is None:
        return "\n".join(["[mounting]", *(lines[key] for key in KEYS), ""])
    return _LINE.sub(lambda match: lines[match[1]], template)


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
    form: str,
    *,
    nominal: Robot | None = None,
    arm: str | None = None,
    template: str | None = None,
) -> ExportedModel:
    """Return a model in a format, its parameters fitted again to what the format cannot hold.

    Args:
        robot: Model, with the effects of its file.
        form: Format, of :class:`ControllerFormat` or the name of an entry point of the group ``robacc.exporters``.
        nominal: Nominal arm of the controller, for ``joint-offsets``.
        arm: Arm of Universal Robots, for ``ur-calibration``; default: recognised by its lengths.
        template: Text of the arm's own file, whose other lines are kept (``ur-calibration``, ``ur-kinematics``).

    Raises:
        UsageError: The arm does not fit the format, or an argument is missing.
    """
    chosen: str | None = None
    losses: tuple[str, ...] = ()
    if form == ControllerFormat.joint_offsets:
        if nominal is None:
            raise UsageError("the format joint-offsets needs the nominal model, which the controller has")
        if nominal.variable_names != robot.variable_names:
            raise UsageError("the model and the nominal model have different joints")
    only_offsets = nominal if form == ControllerFormat.joint_offsets else None
    controller, complete, refitted, excluded = restricted(robot, only_offsets)
    tool = controller.tool
    if only_offsets is not None:
        text, losses = _offsets_text(controller, only_offsets), ("link geometry",)
    elif form == ControllerFormat.urdf or form not in tuple(ControllerFormat):
        write = robot_to_urdf if form == ControllerFormat.urdf else plug_in("robacc.exporters", form)
        text, losses = write(controller)
    elif form == ControllerFormat.mdh:
        controller = _modified_robot(controller)
        text, tool = robot_to_yaml(controller), controller.tool
    elif form == ControllerFormat.json:
        text = json.dumps(_document(controller), indent=2) + "\n"
    elif form == ControllerFormat.ur_calibration:
        if arm is not None and arm not in UR_ARMS:
            raise UsageError(f"no arm {arm!r} of Universal Robots; robacc knows {', '.join(UR_ARMS)}")
        chosen = arm or ur_arm_of(joint_frames(controller))
        nominal_rows = ur_table(chosen)
        table = dh_table(joint_frames(controller), nominal_rows, last_is_axis=True)
        deltas = tuple(DhRow(*map(operator.sub, *rows)) for rows in zip(table.rows, nominal_rows, strict=True))
        text = _deltas_text(deltas, template)
        written, tool = ur_robot(deltas, chosen), Frame.of(table.tool @ robot.tool.pose)
        # The description's last frame stands at the flange of the table.
        last = Frame.of(written.tool.pose @ tool.pose)
        controller = dataclasses.replace(written, base=Frame.of(robot.base.pose @ table.base), tool=last)
    else:
        text, flange = links_text(joint_frames(controller), str(form), robot.name, template or "")
        tool = Frame.of(flange.pose @ robot.tool.pose)
    remaining = remaining_error(complete, controller)
    effects = [f"effect {name}" for name in (*refitted, *excluded)]
    not_carried = (*effects, *(loss for loss in losses if not loss.startswith("effect ")))
    if only_offsets is not None and max(remaining.position_max, remaining.orientation_max) < _EXACT:
        not_carried = ()
    return ExportedModel(text, controller, tool, not_carried, refitted, remaining, chosen)


def _modified_robot(robot: Robot) -> Robot:
    """Return an arm as a robot file with a modified table."""
    table = dh_table(joint_frames(robot), hayati=True)
    rows, flange = modified_rows(table)
    joints = tuple(
        Joint(
            joint.name,
            joint.type,
            row._asdict(),
            limits=joint.limits,
            gear_ratio=joint.gear_ratio,
        )
        for joint, row in zip(robot.variables, rows, strict=True)
    )
    base = Frame.of(robot.base.pose @ table.base)
    tool = Frame.of(flange @ robot.tool.pose)
    return Robot(robot.name, "modified", joints, base=base, tool=tool, gravity=robot.gravity)


def _document(robot: Robot) -> dict[str, Any]:
    """Return the JSON document of an arm: m and rad."""
    frames = joint_frames(robot)
    steps = frames.steps()
    table = dh_table(frames)
    modified, flange = modified_rows(table)
    joints = [
        {
            "name": joint.name,
            "type": joint.type,
            "limits": None if joint.limits is None else list(joint.limits),
            "origin": _plain(Frame.of(step)),
            "dh": {"theta": row.theta, "d": row.d, "a": row.a, "alpha": row.alpha},
            "modified_dh": {"alpha": other.alpha, "a": other.a, "theta": other.theta, "d": other.d},
        }
        for joint, step, row, other in zip(frames.joints, steps, table.rows, modified, strict=False)
    ]
    return {
        "schema": KINEMATICS_SCHEMA,
        "robacc": __version__,
        "name": robot.name,
        "units": {"length": "m", "angle": "rad"},
        "gravity": list(robot.gravity),
        "base": _plain(robot.base),
        "joints": joints,
        "tool": _plain(Frame.of(steps[-1] @ robot.tool.pose)),
        "dh_base": _plain(Frame.of(robot.base.pose @ table.base)),
        "dh_tool": _plain(Frame.of(table.tool @ robot.tool.pose)),
        "modified_dh_tool": _plain(Frame.of(flange @ robot.tool.pose)),
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


# Arms from the files of controllers and of their ROS drivers.


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
    if _MARK.search(text):
        if arm not in UR_ARMS:
            reason = "does not say which arm it belongs to" if arm is None else f"cannot belong to {arm!r}"
            raise UsageError(f"{file} {reason}; name the arm, one of {', '.join(UR_ARMS)}")
        return ur_robot(parse_deltas(text, file), arm)
    robot = _parse_json(text, file) if text.lstrip().startswith("{") else parse_links(text, file)
    if arm is not None:
        raise UsageError(f"only a calibration.conf needs the name of its arm; {file} has all lengths")
    return robot


def _parse_json(text: str, file: str) -> Robot:
    def no_number(name: str) -> float:
        raise ValueError(f"{name} is not a finite number")

    try:
        document: Any = json.loads(text, parse_constant=no_number)
    except json.JSONDecodeError as error:
        raise InputError(Problem(f"is not JSON: {error.msg}", file, error.lineno)) from None
    except ValueError as error:
        raise InputError(Problem(str(error), file)) from None
    if not isinstance(document, dict) or document.get("schema") != KINEMATICS_SCHEMA:
        raise InputError(Problem(f"is not a kinematics file of robacc ({KINEMATICS_SCHEMA})", file))
    try:
        joints = []
        for entry in document["joints"]:
            limits = entry.get("limits")
            if entry["type"] not in ("revolute", "prismatic"):
                raise ValueError(f"type {entry['type']!r}")
            limits = None if limits is None else (float(limits[0]), float(limits[1]))
            joints.append(joint_at(_frame(entry["origin"]), str(entry["name"]), entry["type"], limits))
        x, y, z = map(float, document["gravity"])
        base, tool = _frame(document["base"]), _frame(document["tool"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        message = f"a key is missing or has an unexpected value: {error}"
        raise InputError(Problem(message, file, fix="export the model again")) from None
    return Robot(str(document.get("name", "arm")), "urdf", tuple(joints), base=base, tool=tool, gravity=(x, y, z))


def _frame(value: Any) -> Frame:
    (x, y, z), (roll, pitch, yaw) = map(float, value["xyz"]), map(float, value["rpy"])
    return Frame((x, y, z), (roll, pitch, yaw))
