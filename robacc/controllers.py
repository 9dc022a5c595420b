"""Models in the formats of controllers, drivers and simulators, written with what each leaves out, and read back.

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
import math
import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import yaml

from robacc.accuracy.estimation import pose_metrics
from robacc.effects.base import Effect
from robacc.effects.frames import JointOffset, LinkGeometry
from robacc.errors import InputError, Problem, RobaccError, UsageError, refuse
from robacc.fitting.fit_result import Options
from robacc.fitting.parameters import absorb_constants, apply_fit
from robacc.fitting.solver import fit
from robacc.geometry import Array, Poses, exp_so3, log_between, rotation_about
from robacc.io.yaml_nodes import Source, compose, top_section
from robacc.modelling.model import Model, predict
from robacc.plug_ins import plug_in
from robacc.robots.arm import Arm
from robacc.robots.description import ORIGIN_PARAMETERS, Frame, Joint, JointType, Robot
from robacc.robots.urdf import robot_to_urdf
from robacc.robots.yaml_robot import Kind, read_fields, read_list, read_section, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
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


def _steps(frames: Sequence[Poses]) -> list[Frame]:
    """Return each frame in the one before it, the first as it is."""
    return [Frame.of(before.inverse() @ after) for before, after in itertools.pairwise([Poses.identity(), *frames])]


FULL_TURN = (-2 * np.pi, 2 * np.pi)
"""Limits of the joints of files that state none, rad."""


def _joint_at(
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
        x = _across(np.array([1.0, 0.0, 0.0]), z)
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


def _across(vector: Array, axis: Array) -> Array:
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
        x = across / a if a > 1e-12 else _across((place or current).rotation[:, 0], z)
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
    kept, excluded = [], []
    for entry in whole.effects:
        try:
            simulate(_single_target(dataclasses.replace(whole, effects=(entry,))), Plan(2, seed=_SEEDS[0]))
            kept.append(entry)
        except RobaccError:
            excluded.append(entry)
    complete = dataclasses.replace(whole, effects=tuple(kept))
    if nominal is not None or kept:
        data = simulate(_single_target(complete), Plan(FIT_POSES, seed=_SEEDS[0])).data
        model = Model.of(_single_target(start))
        free: list[Effect] = [JointOffset(model.arm.names)]
        free += [LinkGeometry(model.arm.names)] if nominal is None else []
        fitted = apply_fit(fit(model.with_free(*free), data, Options(robust=False)))
        start = dataclasses.replace(fitted, tool=start.tool, targets=start.targets)
    names, left_out = (tuple(str(entry.get("effect", "?")) for entry in entries) for entries in (kept, excluded))
    return start, complete, names, left_out


def remaining_error(complete: Robot, controller: Robot) -> RemainingError:
    """Return the difference of the poses of two arms within the joint limits of the first."""
    data = simulate(_single_target(complete), Plan(CHECK_POSES, seed=_SEEDS[1])).data
    attained = predict(_single_target(controller), dataclasses.replace(data, target=None))
    assert data.rotation is not None
    turned = log_between(attained.rotation, data.rotation)
    errors = pose_metrics(np.vstack((attained.translation - data.position, turned)))
    assert errors.orientation is not None
    return RemainingError(
        data.n, errors.position.rms, errors.position.max, errors.orientation.rms, errors.orientation.max
    )


def _single_target(robot: Robot) -> Robot:
    """Return the robot with its flange as the only target, where it has several."""
    return dataclasses.replace(robot, targets={}, tool=Frame()) if robot.targets else robot


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
        form: ``urdf``; ``mdh``, a robot file with a modified Denavit-Hartenberg table (Craig); ``json``, joint origins
            with both tables; ``ur-calibration``, ``calibration.conf`` of a controller of Universal Robots;
            ``ur-kinematics`` and ``xarm``, kinematics files of ur_description and xarm_description (ROS);
            ``joint-offsets``, for controllers that take nothing but a mastering; or the name of an entry point of the
            group ``robacc.exporters``.
        nominal: Nominal arm of the controller, for ``joint-offsets`` alone.
        arm: Arm of Universal Robots, for ``ur-calibration``; default: recognised by its lengths.
        template: Text of the arm's own file, whose other lines are kept (``ur-calibration``, ``ur-kinematics``).

    Raises:
        UsageError: The arm does not fit the format, or an argument is missing.
    """
    is_of_offsets = form == "joint-offsets"
    others = is_of_offsets and nominal is not None and nominal.variable_names != robot.variable_names
    no_nominal = "the format joint-offsets needs the nominal model, which the controller has"
    refuse(
        (is_of_offsets and nominal is None, no_nominal),
        (others, "the model and the nominal model have different joints"),
    )
    chosen: str | None = None
    losses: tuple[str, ...] = ()
    controller, complete, refitted, excluded = restricted(robot, nominal)
    tool = controller.tool
    if nominal is not None:
        text, losses = _offsets_text(controller, nominal), ("link geometry",)
    elif form == "mdh":
        controller = _modified_robot(controller)
        text, tool = robot_to_yaml(controller), controller.tool
    elif form == "json":
        text = json.dumps(_document(controller), indent=2) + "\n"
    elif form == "ur-calibration":
        unknown = f"no arm {arm!r} of Universal Robots; robacc knows {', '.join(UR_ARMS)}"
        refuse((arm is not None and arm not in UR_ARMS, unknown))
        chosen = arm or _ur_arm_of(controller)
        rows = _ur_table(chosen)
        table = dh_table(joint_frames(controller), rows, last_is_axis=True)
        deltas = [DhRow(*map(operator.sub, *pair)) for pair in zip(table.rows, rows, strict=True)]
        text, tool = _deltas_text(deltas, template), Frame.of(table.tool @ robot.tool.pose)
        written = _ur_robot(deltas, chosen)
        # The description's last frame stands at the flange of the table.
        last = Frame.of(written.tool.pose @ tool.pose)
        controller = dataclasses.replace(written, base=Frame.of(robot.base.pose @ table.base), tool=last)
    elif form in ("ur-kinematics", "xarm"):
        text, flange = _links_text(controller, form, robot.name, template or "")
        tool = Frame.of(flange.pose @ robot.tool.pose)
    else:
        write = robot_to_urdf if form == "urdf" else plug_in("robacc.exporters", form)
        text, losses = write(controller)
    remaining = remaining_error(complete, controller)
    effects = [f"effect {name}" for name in (*refitted, *excluded)]
    not_carried = (*effects, *(loss for loss in losses if not loss.startswith("effect ")))
    if nominal is not None and max(remaining.position_max, remaining.orientation_max) < _EXACT:
        not_carried = ()
    return ExportedModel(text, controller, tool, not_carried, refitted, remaining, chosen)


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


def _modified_robot(robot: Robot) -> Robot:
    """Return an arm as a robot file with a modified table."""
    table = dh_table(joint_frames(robot), hayati=True)
    rows, flange = modified_rows(table)
    joints = tuple(
        Joint(joint.name, joint.type, row._asdict(), limits=joint.limits, gear_ratio=joint.gear_ratio)
        for joint, row in zip(robot.variables, rows, strict=True)
    )
    base, tool = Frame.of(robot.base.pose @ table.base), Frame.of(flange @ robot.tool.pose)
    return Robot(robot.name, "modified", joints, base=base, tool=tool, gravity=robot.gravity)


# JSON document of an arm: joint origins, standard and modified table.

KINEMATICS_SCHEMA = "robacc.kinematics/1"
"""Value of ``schema`` in a file of the format json."""


def _document(robot: Robot) -> dict[str, Any]:
    """Return the JSON document of an arm: m and rad."""
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
        for joint, step, row, other in zip(robot.variables, _steps(frames), table.rows, modified, strict=False)
    ]
    return {
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


def _parse_json(text: str, file: str) -> Robot:
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
        _joint_at(joint["origin"], joint["name"], joint["type"], joint.get("limits")) for joint in values.pop("joints")
    )
    return Robot(convention="urdf", joints=joints, **{"name": "arm", **values})


# Kinematics files of ROS drivers: one origin (x, y, z, roll, pitch, yaw) for each joint.
#
# ``ur_description`` reads such a file for an arm of Universal Robots (``default_kinematics.yaml``, or the file that
# ``ur_calibration`` extracts), ``xarm_description`` one for an arm of UFACTORY. The numbers are the origins of URDF
# joints that turn about z: R = Rz(yaw) Ry(pitch) Rx(roll).

UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


def _parse_links(text: str, file: str) -> Robot:
    """Return the arm of a kinematics file.

    Raises:
        InputError: The file has no ``kinematics``, its joints are neither UR's nor joint1 to jointN, or a number is
            missing.
    """
    source = Source(file)
    root = compose(text, file)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    nodes = [value for key, value in pairs if key.value == "kinematics" and isinstance(value, yaml.MappingNode)]
    fix = "give default_kinematics.yaml, the file of ur_calibration, or a kinematics file of xarm_description"
    refuse((not nodes, Problem("has no key kinematics with an origin for each joint", file, fix=fix)))
    origins: dict[str, dict[str, float]] = {}
    for name, _, value in source.entries(nodes[0], "kinematics"):
        if name != "hash" and (section := source.section(value, f"kinematics.{name}", _KEYS)):
            origins[name] = read_fields(section, dict.fromkeys(_KEYS, Source.number), _KEYS)
    source.raise_if_any()
    numbered = [f"joint{i + 1}" for i in range(len(origins))]
    # The joint of each link, in the order of the arm.
    is_ur = set(origins) == set(UR_LINKS)
    names = dict(zip(UR_LINKS, UR_JOINTS, strict=True)) if is_ur else {name: name for name in numbered}
    message, fix = (
        f"the joints are {', '.join(origins) or 'missing'}",
        f"expected {', '.join(UR_LINKS)}, or joint1, joint2 …",
    )
    refuse((not origins or set(names) != set(origins), Problem(message, file, column="kinematics", fix=fix)))
    joints = [
        Joint(name, "revolute", {**origins[link], "offset": 0.0}, limits=FULL_TURN) for link, name in names.items()
    ]
    return Robot("Universal Robots arm" if is_ur else f"{len(joints)}-axis arm", "urdf", tuple(joints))


def _links_text(robot: Robot, form: str, name: str, template: str) -> tuple[str, Frame]:
    """Return the kinematics file of an arm, and the flange in the last joint's frame, which the file cannot hold.

    ``name`` is for the comment at the top. Of ``template``, the arm's own file, the line ``hash: …`` is kept: the
    driver knows the arm by it.

    Raises:
        UsageError: The arm has a prismatic joint, or for ``ur-kinematics`` other than six joints.
    """
    *steps, flange = _steps(joint_frames(robot))
    names = UR_LINKS if form != "xarm" else tuple(f"joint{i + 1}" for i in range(len(steps)))
    is_revolute = all(joint.type == "revolute" for joint in robot.variables)
    refuse(
        (not is_revolute, f"the format {form} has revolute joints only"),
        (len(steps) != len(names), f"the format {form} is for arms with six joints; this one has {len(steps)}"),
    )
    lines = [f"# written by robacc {__version__} from {name}", "kinematics:"]
    for link, step in zip(names, steps, strict=True):
        numbers = zip(_KEYS, (*step.xyz, *step.rpy), strict=True)
        lines += [f"  {link}:", *(f"    {key}: {float(value)!r}" for key, value in numbers)]
    lines += [f"  {line.strip()}" for line in template.splitlines() if line.strip().startswith("hash:")][:1]
    return "\n".join([*lines, ""]), flange


# Calibration files of Universal Robots' controllers (``calibration.conf``): differences from the nominal table.
#
# The controller adds ``delta_theta``, ``delta_a``, ``delta_d`` and ``delta_alpha`` to its nominal Denavit-Hartenberg
# rows. The other lines of the file (joint checksums, raw offsets) belong to one arm; they are kept from its own file.
#
# Layout: files of public backups, and UR's forum, thread "Calibrated kinematics info" (18921). Nominal parameters:
# Universal Robots, "DH parameters for calculations of kinematics and dynamics", support article 45257.

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
        x = _across(near.rotation[:, 0], z)
        origin = frames[i].translation + z * (z @ (near.translation - frames[i].translation))
        frames[i] = Poses(np.stack((x, np.cross(z, x), z), axis=1), origin)
    *steps, tool = _steps(frames)
    joints = tuple(map(_joint_at, steps, UR_JOINTS))
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


def known_ur_arm(robot: Robot) -> str | None:
    """Return the name of the arm of Universal Robots that a robot is; None if it is none."""
    try:
        return _ur_arm_of(restricted(robot)[0])
    except UsageError:
        return None


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
        reason = "does not say which arm it belongs to" if arm is None else f"cannot belong to {arm!r}"
        refuse((arm not in UR_ARMS, f"{file} {reason}; name the arm, one of {', '.join(UR_ARMS)}"))
        return _ur_robot(_parse_deltas(text, file), arm or "")
    robot = _parse_json(text, file) if text.lstrip().startswith("{") else _parse_links(text, file)
    refuse((arm is not None, f"only a calibration.conf needs the name of its arm; {file} has all lengths"))
    return robot
