"""Simulate measured poses: a robot with its effects, commanded through its joint ranges, with measurement noise.

Poses are the exact nonlinear prediction of the model, including elastic equilibrium. All random numbers come from one
seed, with a stream for each purpose, so that adding noise does not change the poses.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from robacc.errors import RobaccError, given, refuse
from robacc.geometry import Array, NDArray, Poses, compose, exp_so3
from robacc.measurements import Measurements, motion_between_rows
from robacc.modelling.model import predict
from robacc.robots.arm import BLOCK, Arm, joint_ranges, low_discrepancy
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import robot_to_yaml

_MAX_ROWS = 2_000_000
"""Rows of a simulation: some GB of arrays and text; a larger number is likely a typing error."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Poses, circumstances and measurement noise of a simulation. SI units."""

    poses: int
    """Number of commanded poses."""
    seed: int = 0
    cycles: int = 1
    """Number of times that all commanded poses are visited, in the same order."""
    sampling: Literal["even", "random"] = "even"
    """Low-discrepancy or independent uniform joint variables, within the limits."""
    noise_position: float = 0.0
    """Standard deviation along each axis, m."""
    noise_orientation: float = 0.0
    """Standard deviation about each axis, rad."""
    sigma: bool = False
    """Add columns with the measuring uncertainty."""
    outliers: int = 0
    """Number of rows whose position is wrong by ``outlier_size`` in a random direction."""
    outlier_size: float = 0.01
    orientation: bool = True
    commanded: bool = False
    """Add columns with the commanded poses, those of the robot without its effects."""
    motion: bool = True
    """Add columns with direction and speed of approach, from the order of the poses."""
    time_step: float | None = None
    """s from one pose to the next; None: no column of time."""
    temperature: tuple[float, float] | None = None
    """Degrees Celsius at the start and at the end of a warm-up; equal: constant."""
    payloads: tuple[float, ...] = ()
    """kg; each commanded pose has one of these payloads, at random."""


@dataclass(frozen=True, slots=True)
class Simulation:
    """Simulated poses and their known outliers."""

    data: Measurements
    outliers: NDArray[np.int64]
    """Rows that are outliers, ascending, from 0."""


def simulate(robot: Robot, plan: Plan, planned: Measurements | None = None) -> Simulation:
    """Return simulated poses of ``robot`` and the effects of its file, measured according to ``plan``.

    With several targets each is measured at every pose, one row for each target. ``planned`` poses, in the order
    visited, replace sampled ones; their joint variables, ids, cycles and commanded poses are used.

    Raises:
        InputError: A prismatic joint has no limits, or the robot's effects cannot be read.
        UsageError: The plan lacks a circumstance that an effect depends on, has more outliers than rows or too many
            rows, or repeats cycles.
    """
    data = _visited_poses(robot, plan, planned)
    poses = _predicted(robot, data)
    position, rotation = poses.translation.copy(), poses.rotation
    if plan.noise_position > 0:
        position += _stream(plan, "position").normal(scale=plan.noise_position, size=position.shape)
    if plan.noise_orientation > 0:
        turns = _stream(plan, "orientation").normal(scale=plan.noise_orientation, size=position.shape)
        rotation = compose(exp_so3(turns), rotation)
    refuse((plan.outliers > data.n, f"{plan.outliers} outliers are more than the {data.n} rows"))
    rng = _stream(plan, "outliers")
    outliers = np.sort(rng.choice(data.n, size=plan.outliers, replace=False)).astype(np.int64)
    direction = rng.normal(size=(3, plan.outliers))
    position[:, outliers] += plan.outlier_size * direction / np.sqrt(np.sum(np.square(direction), axis=0))
    if plan.commanded:
        nominal = _predicted(replace(robot, effects=()), data)
        data = replace(data, commanded_position=nominal.translation, commanded_rotation=nominal.rotation)
    return Simulation(
        replace(
            data,
            position=position,
            rotation=rotation if plan.orientation else None,
            commanded_rotation=data.commanded_rotation if plan.orientation else None,
            sigma_position=np.full(position.shape, plan.noise_position) if plan.sigma else None,
            sigma_rotation=np.full(data.n, plan.noise_orientation) if plan.sigma and plan.orientation else None,
            direction=data.direction if plan.motion else None,
            speed=data.speed if plan.motion else None,
        ),
        outliers,
    )


def _predicted(robot: Robot, data: Measurements) -> Poses:
    """Return the predicted poses, a part of the rows at a time: an elastic equilibrium takes some kB a row."""
    rows = 16 * BLOCK
    parts = [predict(robot, data.subset(slice(start, start + rows))) for start in range(0, max(data.n, 1), rows)]
    return Poses(
        np.concatenate([part.rotation for part in parts], axis=2),
        np.concatenate([part.translation for part in parts], axis=1),
    )


def even_joints(
    robot: Robot, count: int, rng: np.random.Generator, purpose: str, fix: str, *, margin: float = 0.0, skip: int = 0
) -> Array:
    """Return joint variables ``(J, count)`` spread evenly within the limits; one turn for a revolute joint without.

    A low-discrepancy sequence after its first ``skip`` entries, shifted by a random vector modulo the unit cube, so
    that each seed has other poses that are still even: R. Cranley and T. N. L. Patterson, "Randomization of number
    theoretic methods for multiple integration", SIAM J. Numer. Anal. 13 (1976) 904-914.

    Args:
        robot: The arm.
        count: Number of poses.
        rng: Generator of the shift.
        purpose: What the limits are for, and ``fix`` how to do without, for the message.
        fix: See ``purpose``.
        margin: Share of each range to keep from its ends.
        skip: Entries of the sequence that are left out.

    Raises:
        InputError: A prismatic joint has no limits.
    """
    low, high = (limit[:, None] for limit in joint_ranges(Arm.of(robot), np.pi, purpose, fix))
    unit = (low_discrepancy(len(low), skip + count)[:, skip:] + rng.uniform(size=(len(low), 1))) % 1.0
    keep = margin * (high - low)
    return np.asarray(low + keep + (high - low - 2 * keep) * unit)


def joint_samples(robot: Robot, plan: Plan) -> Array:
    """Return commanded joint variables ``(J, poses)`` within the limits; one turn for a revolute joint without limits.

    Raises:
        InputError: Prismatic joints have no limits.
    """
    demand, rng = ("to sample within", "give it limits"), _stream(plan, "poses")
    low, high = (limit[:, None] for limit in joint_ranges(Arm.of(robot), np.pi, *demand))
    if plan.sampling == "random":
        q = low + (high - low) * rng.uniform(size=(len(low), plan.poses))
    else:
        q = even_joints(robot, plan.poses, rng, *demand)
        if plan.time_step is not None:
            # The sequence runs evenly through each joint's range, so in its order a drift over time would look like a
            # periodic error of a joint.
            q = q[:, _stream(plan, "order").permutation(plan.poses)]
    # A microradian or micrometre, about the resolution of a controller.
    return np.clip(np.round(q, 6), low, high)


def _visited_poses(robot: Robot, plan: Plan, planned: Measurements | None) -> Measurements:
    """Return all columns but the measured pose: poses in order, cycle after cycle, with every target at each visit."""
    targets = tuple(robot.targets) if len(robot.targets) > 1 else (None,)
    visits = (plan.poses if planned is None else planned.n) * plan.cycles
    rows = visits * len(targets)
    refuse((rows > _MAX_ROWS, f"{rows} rows are more than the limit of {_MAX_ROWS}"))
    if planned is None:
        ids, n = _pose_ids(np.arange(plan.poses)), plan.poses
        planned = Measurements(position=np.zeros((3, n)), q=joint_samples(robot, plan), pose=ids)
    q = given(planned.q, "the poses to visit have no joint columns")
    pose_of_visit, visit = np.tile(np.arange(planned.n), plan.cycles), np.arange(visits).repeat(len(targets))
    ids = _pose_ids(planned.groups()) if planned.pose is None else planned.pose
    direction, speed = motion_between_rows(q[:, pose_of_visit])
    cycle, payload, temperature = planned.cycle, planned.payload, None
    if plan.cycles > 1:
        refuse((cycle is not None, "the poses to visit have cycles already: leave out `cycles`, or their column cycle"))
        cycle = np.repeat(np.arange(1, plan.cycles + 1), planned.n).astype(str)
    if plan.payloads:
        groups = planned.groups()
        payload = _stream(plan, "payload").choice(np.array(plan.payloads), size=int(groups.max()) + 1)[groups]
    if plan.temperature is not None:
        # A first-order rise, evenly spaced in time, over three time constants: it reaches 95 %.
        start, end = plan.temperature
        temperature = end + (start - end) * np.exp(-3.0 * visit / max(visits - 1, 1))
    pose = pose_of_visit[visit]
    # Wanted poses are those of one target.
    wanted = (planned.commanded_position, planned.commanded_rotation) if targets == (None,) else (None, None)
    position, rotation = (None if column is None else column[..., pose] for column in wanted)
    return Measurements(
        position=np.zeros((3, visit.size)),
        q=q[:, pose],
        commanded_position=position,
        commanded_rotation=rotation,
        pose=ids[pose],
        cycle=None if cycle is None else cycle[visit],
        target=None if targets == (None,) else np.tile(np.array(targets), visits),
        time=None if plan.time_step is None else plan.time_step * visit.astype(float),
        temperature=temperature,
        payload=None if payload is None else payload[pose],
        payload_group=None if planned.payload_group is None else planned.payload_group[pose],
        direction=direction[:, visit],
        speed=speed[:, visit],
        branches=None if planned.branches is None else planned.branches[:, pose],
        branch_names=planned.branch_names,
        # Lines of a file with a header.
        rows=np.arange(2, 2 + visit.size),
        warnings=planned.warnings,
    )


def _pose_ids(poses: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return ids P1, P2 … of numbers from 0, all of equal length."""
    digits = len(str(int(poses.max()) + 1))
    return np.char.add("P", np.char.zfill((poses + 1).astype(f"U{digits}"), digits))


def _stream(plan: Plan, purpose: str) -> np.random.Generator:
    return np.random.default_rng(
        [plan.seed, {"poses": 0, "payload": 1, "position": 2, "orientation": 3, "outliers": 4, "order": 5}[purpose]]
    )


# Template files: a robot file with a comment at every field, and a CSV of poses, both valid without changes.

MAX_JOINTS = 30


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
    refuse((not 1 <= count <= MAX_JOINTS, f"expected 1 to {MAX_JOINTS} joints, found {count}"))
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
    if i:
        return text
    return "".join(f"{line:<38}# {comment}\n" for line, comment in zip(text.splitlines(), _COMMENTS, strict=True))


def urdf_template(robot: Robot, urdf: str, file: str, poses: str) -> str:
    """Return the robot file of an arm that was read from ``urdf``, with comments on its fields at the top."""
    return robot_to_yaml(
        robot,
        (
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
        ),
    )


def poses_template(robot: Robot, file: str, name: str) -> tuple[str, int]:
    """Return a CSV ``name`` for measured poses of ``robot``, whose file is ``file``, and its number of rows.

    The rows are simulated, so that every command runs at once; there are none where a prismatic joint has no limits.
    """
    names = [f"q{i + 1}_{'deg' if joint.type == 'revolute' else 'mm'}" for i, joint in enumerate(robot.variables)]
    legend, rows = (
        "; ".join(f"q{i + 1} is {joint.name}" for i, joint in enumerate(robot.variables)),
        _example_rows(robot),
    )
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
    return "\n".join([*lines, ",".join(("pose", *names, "x_mm", "y_mm", "z_mm")), *rows]) + "\n", len(rows)


def _example_rows(robot: Robot) -> list[str]:
    try:
        # m; noise of the example rows, about that of a good camera.
        data = simulate(robot, Plan(8, noise_position=1e-4, orientation=False, motion=False)).data
    except RobaccError:  # a prismatic joint without limits cannot be sampled
        return []
    if data.q is None or data.target is not None:
        return []
    factors = np.array([180.0 / np.pi if joint.type == "revolute" else 1e3 for joint in robot.variables])
    columns = np.vstack((data.q * factors[:, None], data.position * 1e3)).T
    return [",".join([f"P{i + 1}", *(f"{value:.4f}" for value in row)]) for i, row in enumerate(columns)]
