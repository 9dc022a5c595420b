"""Template files: a robot file with a comment at every field, and a CSV of poses, both valid without changes."""

from __future__ import annotations

import math

import numpy as np

from robacc.errors import RobaccError, UsageError
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import robot_to_yaml
from robacc.simulation.simulate import Plan, simulate

MAX_JOINTS = 30
EXAMPLE_ROWS = 8
_NOISE = 1e-4
"""m; noise of the example rows, about that of a good camera."""


_SIX = (
    (0, 450, 150, -90, 170),
    (-90, 0, 600, 0, 100),
    (0, 0, 100, -90, 70),
    (0, 620, 0, 90, 180),
    (0, 0, 0, -90, 120),
    (180, 100, 0, 0, 180),
)
"""Theta, d, a, alpha and limit of each joint, mm and degrees: a spherical wrist, as most arms with six axes have."""
_ALTERNATING = ((0, 350, 0, -90, 160), (0, 0, 0, 90, 110))
"""Alternating joints of an arm with another number of joints: shoulder, elbow and wrist at right angles."""

_HEAD = """\
# Robot file of robacc for an example arm with {count}: replace the numbers with those of your arm.
# Then: robacc show {robot}             check that this is your arm
#       robacc estimate {poses} --robot {robot} --align base_frame,tool_frame

robacc: 1                             # version of this format
name: my arm                          # for titles
convention: standard                  # standard (each row Rz(theta) Tz(d) Tx(a) Rx(alpha)) or
                                      # modified (Craig's: Rx(alpha) Tx(a) Rz(theta) Tz(d))
units: {{length: mm, angle: deg}}       # of all numbers below: m or mm, rad or deg; masses are in kg, gravity in m/s^2
gravity: [0, 0, -9.81]                # in the measuring frame; used where links have masses
base: {{xyz: [0, 0, 0], rpy: [0, 0, 0]}} # arm's base in the measuring frame; rpy about fixed axes x, y, z
tool: {{xyz: [0, 0, 100], rpy: [0, 0, 0]}} # measured target in the last link's frame
# Rough values of base and tool are enough: --align base_frame,tool_frame fits them to the poses.
# Several targets, named in a column "target", replace the tool:
#   targets: {{t1: {{xyz: [60, 0, 100]}}, t2: {{xyz: [-30, 52, 100]}}, t3: {{xyz: [-30, -52, 100]}}}}

# From the base outwards. A joint's variable q1, q2, … is added to theta (revolute) or d (prismatic).
joints:
"""
_OPTIONAL = """\
    # Optional keys of every joint:
    # sign: -1                        # the joint turns in the opposite direction of the table
    # gear_ratio: 100                 # motor turns per turn of the joint; robacc trace tests the gear's periodic errors
    # mass: 40                        # kg, of the link that this joint moves; compliance needs the masses of all links
    # com: [-100, 0, 50]              # centre of mass of that link, in its frame
    # tolerance: {theta: 0.01, d: 0.1, a: 0.1, alpha: 0.01}   # standard deviations, for robacc predict
"""
_TAIL = """
# Known effects of this arm, for example findings of robacc trace (robacc show effects lists all effects):
# effects:
#   - {effect: joint_compliance, joints: [j2], values: {j2: 5e-5}}
"""


def robot_template(count: int, robot: str, poses: str) -> str:
    """Return a robot file of an example arm with ``count`` joints; ``robot`` and ``poses`` name both files.

    Raises:
        UsageError: ``count`` is below 1 or too large.
    """
    if not 1 <= count <= MAX_JOINTS:
        raise UsageError(f"expected 1 to {MAX_JOINTS} joints, found {count}")
    rows = _SIX if count == len(_SIX) else [_ALTERNATING[i % len(_ALTERNATING)] for i in range(count)]
    joints = "".join(_joint(i, row) + (_OPTIONAL if i == 0 else "") for i, row in enumerate(rows))
    return _HEAD.format(count=f"{count} joint{'s' * (count > 1)}", robot=robot, poses=poses) + joints + _TAIL


_JOINT = """\
  - name: j{}
    type: revolute
    theta: {}
    d: {}
    a: {}
    alpha: {}
    limits: [-{limit}, {limit}]
"""
_COMMENTS = (
    "any name; columns of poses may have it",
    "or prismatic",
    "rotation about z; plus the variable of a revolute joint",
    "shift along z; plus the variable of a prismatic joint",
    "shift along x",
    "rotation about x",
    "optional; poses outside are errors",
)


def _joint(i: int, row: tuple[float, ...]) -> str:
    """Return the lines of a joint; the first joint has a comment at every field."""
    text = _JOINT.format(i + 1, *row[:4], limit=row[4])
    lines = zip(text.splitlines(), _COMMENTS, strict=True)
    return text if i else "".join(f"{line:<38}# {comment}\n" for line, comment in lines)


def urdf_template(robot: Robot, urdf: str, file: str, poses: str) -> str:
    """Return the robot file of an arm that was read from ``urdf``, with comments on its fields at the top."""
    comments = (
        f"Robot file of robacc, converted from {urdf}. Then: robacc show {file}",
        f"robacc estimate {poses} --robot {file} --align base_frame,tool_frame",
        "",
        "units     of all numbers: m or mm, rad or deg; masses are in kg, gravity in m/s^2 in the measuring frame",
        "base      arm's base in the measuring frame; rpy about fixed axes x, y, z",
        "tool      measured target in the last link's frame: enter yours; a rough value is enough",
        "          (--align base_frame,tool_frame fits both to the poses)",
        "joints    from the base outwards: origin from the previous joint, axis in the joint's frame; offset is",
        "          added to its variable q1, q2, …; limits are optional; mass and com are those of the moved link",
        "Optional keys of a joint: sign: -1 (opposite direction), gear_ratio (motor turns per turn),",
        "tolerance: {x: 1e-4, …, yaw: 1e-4, offset: 1e-4} (standard deviations, for robacc predict).",
        "Optional keys of the robot: payload, targets (instead of tool), effects (see robacc show effects).",
    )
    return robot_to_yaml(robot, comments)


def poses_template(robot: Robot, file: str, name: str) -> tuple[str, int]:
    """Return a CSV ``name`` for measured poses of ``robot``, whose file is ``file``, and its number of rows.

    The rows are simulated, so that every command runs at once; there are none where a prismatic joint has no limits.
    """
    names = [f"q{i + 1}_{'deg' if joint.type == 'revolute' else 'mm'}" for i, joint in enumerate(robot.variables)]
    header, rows = ["pose", *names, "x_mm", "y_mm", "z_mm"], _example_rows(robot)
    legend = "; ".join(f"q{i + 1} is {joint.name}" for i, joint in enumerate(robot.variables))
    lines = [
        f"# Measured poses of the arm in {file}: one row for each pose. Lines that begin with # are comments.",
        f"# Commanded joint variables: {legend}.",
        "# x, y, z: measured position of the target, in the measuring frame.",
        "# A name ends with its unit: _mm, _m, _um, _deg, _rad, _mrad. pose is the commanded pose's name; repeat it",
        "# for every visit. Optional columns:",
        "#   qw, qx, qy, qz or rx_deg, ry_deg, rz_deg (rotation vector) or roll_deg, pitch_deg, yaw_deg: orientation",
        "#   sigma_x_mm, sigma_y_mm, sigma_z_mm: the instrument's uncertainty, one standard deviation",
        "#   cycle, target, time_s, temperature_c, payload_kg; dir_q1 … (-1, 0, 1: direction of approach), speed_q1 …",
    ]
    if rows:
        lines += [
            f"# The {len(rows)} rows below are simulated, so that commands run at once: replace them with yours.",
            f"# Then: robacc estimate {name} --robot {file} --align base_frame,tool_frame",
        ]
    return "\n".join([*lines, ",".join(header), *rows]) + "\n", len(rows)


def _example_rows(robot: Robot) -> list[str]:
    try:
        data = simulate(robot, Plan(EXAMPLE_ROWS, noise_position=_NOISE, orientation=False, motion=False)).data
    except RobaccError:  # a prismatic joint without limits cannot be sampled
        return []
    if data.q is None or data.target is not None:
        return []
    revolute = np.array([joint.type == "revolute" for joint in robot.variables])
    columns = np.vstack((data.q * np.where(revolute, 180.0 / math.pi, 1e3)[:, None], data.position * 1e3)).T
    return [",".join([f"P{i + 1}", *(f"{value:.4f}" for value in row)]) for i, row in enumerate(columns)]
