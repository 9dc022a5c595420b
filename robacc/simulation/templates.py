"""Files to begin with: a robot file with a comment at every field, and a CSV of poses, both valid as they are."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robacc.errors import RobaccError, UsageError
from robacc.geometry import Array
from robacc.robots.description import Robot
from robacc.robots.yaml_writer import robot_to_yaml
from robacc.simulation.simulate import Plan, simulate

MOST_JOINTS = 30
EXAMPLE_ROWS = 8
_NOISE = 1e-4
"""m; of the example rows, about a good camera's."""


class _Row(NamedTuple):
    """One joint of an arm: a DH row and limits, mm and degrees."""

    theta: float
    d: float
    a: float
    alpha: float
    reach: float


_SIX = (
    _Row(0, 450, 150, -90, 170),
    _Row(-90, 0, 600, 0, 100),
    _Row(0, 0, 100, -90, 70),
    _Row(0, 620, 0, 90, 180),
    _Row(0, 0, 0, -90, 120),
    _Row(180, 100, 0, 0, 180),
)
"""A made-up arm with a spherical wrist, as most arms of six axes are."""
_FURTHER = (_Row(0, 350, 0, -90, 160), _Row(0, 0, 0, 90, 110))
"""What an arm of another number of joints is made of, by turns: shoulder, elbow and wrist at right angles."""

_HEAD = """\
# Robot file of robacc, an example of an arm with {count}: put your own arm's numbers in the place of these.
# Then: robacc show {robot}             is it the arm that you have?
#       robacc estimate {poses} --robot {robot} --align base_frame,tool_frame

robacc: 1                             # version of this format
name: my arm                          # for titles
convention: standard                  # standard (each row Rz(theta) Tz(d) Tx(a) Rx(alpha)) or
                                      # modified (Craig's: Rx(alpha) Tx(a) Rz(theta) Tz(d))
units: {{length: mm, angle: deg}}       # of every number below: m or mm, rad or deg; masses are in kg, gravity in m/s^2
gravity: [0, 0, -9.81]                # in the measuring frame; of use where links have masses
base: {{xyz: [0, 0, 0], rpy: [0, 0, 0]}} # where the arm's base is in the measuring frame; rpy about fixed axes x, y, z
tool: {{xyz: [0, 0, 100], rpy: [0, 0, 0]}} # where the measured target is in the last link's frame
# Base and tool need not be known well: --align base_frame,tool_frame fits them to the poses.
# Several targets, named in a column "target", stand in the tool's place:
#   targets: {{t1: {{xyz: [60, 0, 100]}}, t2: {{xyz: [-30, 52, 100]}}, t3: {{xyz: [-30, -52, 100]}}}}

# From the base outwards. To a revolute joint's theta (a prismatic one's d) its variable q1, q2, … is added.
joints:
"""
_OPTIONAL = """\
    # Each joint may have these too:
    # sign: -1                        # the joint counts the other way round than the table
    # gear_ratio: 100                 # motor turns per turn of the joint: its gear's periodic errors are looked for
    # mass: 40                        # kg, of the link that this joint moves; compliance needs those of all links
    # com: [-100, 0, 50]              # its centre of mass, in that link's frame
    # tolerance: {theta: 0.01, d: 0.1, a: 0.1, alpha: 0.01}   # one standard deviation each, for robacc predict
"""
_TAIL = """
# What is known of this arm beyond its table, such as what robacc trace has found (robacc effects lists all there is):
# effects:
#   - {effect: joint_compliance, joints: [j2], values: {j2: 5e-5}}
"""


def robot_template(count: int, robot: str, poses: str) -> str:
    """A robot file of an example arm of ``count`` joints; ``robot`` and ``poses`` are the names of both files.

    Raises:
        UsageError: An arm does not have so many joints, or none.
    """
    if not 1 <= count <= MOST_JOINTS:
        raise UsageError(f"an arm has 1 to {MOST_JOINTS} joints, not {count}")
    rows = _SIX if count == len(_SIX) else [_FURTHER[i % len(_FURTHER)] for i in range(count)]
    joints = "".join(_joint(i, row) + (_OPTIONAL if i == 0 else "") for i, row in enumerate(rows))
    return _HEAD.format(count=f"{count} joint{'s' * (count > 1)}", robot=robot, poses=poses) + joints + _TAIL


_COMMENTS = {
    "name": "any name; columns of poses may be named so",
    "type": "or prismatic",
    "theta": "turn about z, to which a revolute joint's variable is added",
    "d": "shift along z, to which a prismatic joint's variable is added",
    "a": "shift along x",
    "alpha": "turn about x",
    "limits": "optional; poses outside are refused",
}
_COLUMN = 38
"""Where comments stand."""


def _joint(i: int, row: _Row) -> str:
    """The first joint has a comment at every field."""
    fields = {
        "name": f"j{i + 1}",
        "type": "revolute",
        "theta": row.theta,
        "d": row.d,
        "a": row.a,
        "alpha": row.alpha,
        "limits": [-row.reach, row.reach],
    }
    lines = [f"  {'-' if key == 'name' else ' '} {key}: {value}" for key, value in fields.items()]
    if i == 0:
        lines = [f"{line:<{_COLUMN}}# {_COMMENTS[key]}" for key, line in zip(fields, lines, strict=True)]
    return "".join(f"{line}\n" for line in lines)


def urdf_template(robot: Robot, urdf: str, file: str, poses: str) -> str:
    """The robot file of an arm that was read from ``urdf``, with what its fields mean at its head."""
    comments = (
        f"Robot file of robacc, made from {urdf}. Then: robacc show {file}",
        f"robacc estimate {poses} --robot {file} --align base_frame,tool_frame",
        "",
        "units     of every number: m or mm, rad or deg; masses are in kg, gravity in m/s^2 in the measuring frame",
        "base      where the arm's base is in the measuring frame; rpy about fixed axes x, y, z",
        "tool      where the measured target is in the last link's frame: put yours there, as well as it is known",
        "          (--align base_frame,tool_frame fits both to the poses)",
        "joints    from the base outwards: origin from the joint before, axis in the joint's own frame; offset is",
        "          added to its variable q1, q2, …; limits are optional, mass and com are of the link that it moves",
        "A joint may also have sign: -1 (counts the other way), gear_ratio (motor turns per turn),",
        "tolerance: {x: 1e-4, …, yaw: 1e-4, offset: 1e-4} (one standard deviation each, for robacc predict).",
        "Keys that may be added: payload, targets (in the tool's place), effects (see robacc effects).",
    )
    return robot_to_yaml(robot, comments)


def poses_template(robot: Robot, file: str, name: str) -> tuple[str, int]:
    """A CSV named ``name`` for poses measured of ``robot``, whose file is ``file``; and how many rows it has.

    The rows are made up, so that every command runs at once; there are none where a slide has no limits to keep.
    """
    names = [f"q{i + 1}_{'deg' if joint.type == 'revolute' else 'mm'}" for i, joint in enumerate(robot.variables)]
    header = ["pose", *names, "x_mm", "y_mm", "z_mm"]
    rows = _example_rows(robot)
    spelt = "; ".join(f"q{i + 1} is {joint.name}" for i, joint in enumerate(robot.variables))
    lines = [
        f"# Poses measured of the arm in {file}: one row a pose. Lines that begin with # are skipped.",
        f"# Joint variables as commanded: {spelt}.",
        "# x, y, z: position of the target as measured, in the measuring frame.",
        "# A unit stands behind a name: _mm, _m, _um, _deg, _rad, _mrad. pose is the commanded pose's name; repeat it",
        "# for every visit. Columns may be added:",
        "#   qw, qx, qy, qz or rx_deg, ry_deg, rz_deg (rotation vector) or roll_deg, pitch_deg, yaw_deg: orientation",
        "#   sigma_x_mm, sigma_y_mm, sigma_z_mm: the instrument's uncertainty, one standard deviation",
        "#   cycle, target, time_s, temperature_c, payload_kg; dir_q1 … (-1, 0, 1: the way it came), speed_q1 …",
    ]
    if rows:
        lines.append(
            f"# The {len(rows)} rows below are made up, so that commands run at once: put yours in their place."
        )
        lines.append(f"# Then: robacc estimate {name} --robot {file} --align base_frame,tool_frame")
    return "\n".join([*lines, ",".join(header), *rows]) + "\n", len(rows)


def _example_rows(robot: Robot) -> list[str]:
    try:
        data = simulate(robot, Plan(EXAMPLE_ROWS, noise_position=_NOISE, orientation=False, motion=False)).data
    except RobaccError:  # a slide without limits has no place to be sampled from
        return []
    if data.q is None or data.target is not None:
        return []
    turns = np.array([joint.type == "revolute" for joint in robot.variables])
    joints: Array = data.q * np.where(turns, 180.0 / math.pi, 1e3)[:, None]
    columns = np.vstack((joints, data.position * 1e3)).T
    return [",".join([f"P{i + 1}", *(f"{value:.4f}" for value in row)]) for i, row in enumerate(columns)]
