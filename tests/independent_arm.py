"""An arm simulated without the package: matrices of its own, torques as differences of potential energy.

Tests of effects use it so that an error of the package's kinematics or gravity cannot hide on both sides.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from homogeneous import dh, shift, turn

from robacc.measurements import Measurements
from robacc.robots.description import Joint, Robot
from robacc.robots.yaml_robot import parse_robot

DH = (
    # theta, d, a, alpha (rad, m); mass (kg); centre of mass in the link's frame (m)
    (0.0, 0.45, 0.15, -np.pi / 2, 60.0, (-0.05, 0.1, 0.02)),
    (-np.pi / 2, 0.0, 0.6, 0.0, 45.0, (-0.3, 0.02, 0.05)),
    (0.0, 0.0, 0.12, -np.pi / 2, 30.0, (-0.04, 0.03, 0.05)),
    (0.0, 0.65, 0.0, np.pi / 2, 15.0, (0.01, 0.2, 0.0)),
    (0.0, 0.0, 0.0, -np.pi / 2, 8.0, (0.0, 0.02, 0.03)),
    (0.0, 0.1, 0.0, 0.0, 3.0, (0.0, 0.01, -0.02)),
)
LIMITS = ((-2.8, 2.8), (-1.0, 1.6), (-1.8, 1.0), (-2.9, 2.9), (-1.9, 1.9), (-3.0, 3.0))
TOOL = np.array([0.05, -0.03, 0.12])
GRAVITY = 9.81
DECLARED = "base_frame,tool_frame,joint_offset,link_geometry"

Matrix = np.ndarray


def robot(targets: dict[str, Matrix] | None = None) -> Robot:
    """The nominal model, as a robot file describes it; with ``targets`` in place of the tool."""
    at_flange = f"tool: {{xyz: {TOOL.tolist()}, rpy: [0, 0, 0]}}"
    if targets is not None:
        places = (f"{name}: {{xyz: {place.tolist()}}}" for name, place in targets.items())
        at_flange = f"targets: {{{', '.join(places)}}}"
    lines = ["robacc: 1", "name: independent", "convention: standard", "units: {length: m, angle: rad}"]
    lines += [f"gravity: [0, 0, {-GRAVITY}]", at_flange, "joints:"]
    for i, ((theta, d, a, alpha, mass, com), (low, high)) in enumerate(zip(DH, LIMITS, strict=True), 1):
        lines.append(
            f"  - {{name: j{i}, type: revolute, theta: {theta!r}, d: {d}, a: {a}, alpha: {alpha!r}, "
            f"limits: [{low}, {high}], mass: {mass}, com: {list(com)}}}"
        )
    return parse_robot("\n".join(lines) + "\n", "independent.yaml")


def link_frames(q: Matrix, geometry: Matrix | float = 0.0) -> list[Matrix]:
    """Frames (..., 4, 4) of the links at joints (6, ...); ``geometry`` (6, 4) are errors of the table."""
    table = np.array([row[:4] for row in DH]) + geometry
    theta, d, a, alpha = table.T.reshape(4, 6, *[1] * (q.ndim - 1))
    return list(accumulate(dh(theta + q, d, a, alpha), np.matmul))


def target(q: Matrix, tool: Matrix = TOOL) -> Matrix:
    """Positions (..., 3) of the target at joints (6, ...)."""
    return (link_frames(q)[-1] @ np.append(tool, 1.0))[..., :3]


def torques(q: Matrix, extra: Callable[[list[Matrix]], Matrix] | None = None, geometry: Matrix | float = 0.0) -> Matrix:
    """Torques of gravity about the joints (6, ...), positive along gravity: minus the slope of the energy."""

    def energy(at: Matrix) -> Matrix:
        frames = link_frames(at, geometry)
        own = sum(m * (frame @ np.append(com, 1.0))[..., 2] for frame, (*_, m, com) in zip(frames, DH, strict=True))
        return np.asarray(GRAVITY * own + (0.0 if extra is None else extra(frames)))

    step = 1e-5
    steps = step * np.eye(6).reshape(6, 6, *[1] * (q.ndim - 1))
    return np.array([(energy(q - e) - energy(q + e)) / (2 * step) for e in steps])


def targets(q: Matrix) -> Matrix:
    """Positions (3, N) of the target at joints (6, N)."""
    return target(q).T


def load_torques(q: Matrix, mass: float | Matrix, com: Matrix = TOOL, link: int = -1) -> Matrix:
    """Torques about the joints by the links and by a mass, or one for each pose, in the frame of a link."""
    weight, place = mass * GRAVITY, np.append(com, 1.0)
    return torques(q, lambda frames: weight * (frames[link] @ place)[..., 2])


@dataclass(frozen=True)
class Run:
    """Poses in the order of measurement."""

    q: Matrix
    """(6, N)"""
    direction: Matrix
    time: Matrix

    def turned(self, joint: int, turn: Matrix) -> Matrix:
        """Targets (3, N) with the joint of this number, from 0, turned by ``turn`` (N,) beyond the commanded."""
        q = self.q.copy()
        q[joint] += turn
        return targets(q)


def run(n: int, seed: int) -> Run:
    """Random poses; each joint comes from a random side."""
    rng = np.random.default_rng(seed)
    low, high = np.array(LIMITS).T[..., None]
    q = rng.uniform(low, high, (6, n))
    return Run(q, rng.choice([-1.0, 1.0], (6, n)), np.cumsum(rng.uniform(20, 40, n)))


def measured(
    poses: Run, position: Matrix, noise: float, seed: int, *, timed: bool = False, directed: bool = False
) -> Measurements:
    """The measurements of positions (3, N) with Gaussian noise; lines as in a file with a header."""
    rng = np.random.default_rng(1000 + seed)
    return Measurements(
        position=position + rng.normal(scale=noise, size=position.shape),
        q=poses.q,
        time=poses.time if timed else None,
        direction=poses.direction if directed else None,
        rows=np.arange(2, poses.q.shape[1] + 2),
        source="poses.csv",
    )


def on_a_pedestal(q: Matrix, compliance: float, height: float = 0.0) -> Matrix:
    """Targets (3, N) of an arm that tilts about a point ``height`` below its base by the moment of all links."""
    weights = [(mass, (f @ np.append(com, 1.0))[:, :3]) for f, (*_, mass, com) in zip(link_frames(q), DH, strict=True)]
    moment = compliance * sum(np.cross(point, [0.0, 0.0, -mass * GRAVITY]) for mass, point in weights)
    tilt = (turn(0, moment[:, 0]) @ turn(1, moment[:, 1]))[:, :3, :3]
    pivot = np.array([0.0, 0.0, -height])
    return (np.einsum("nij,nj->ni", tilt, target(q) - pivot) + pivot).T


RAIL = 3.0
"""Length of a rail, m."""


def robot_on_a_rail() -> Robot:
    """The arm on a slide along the measuring frame's z, as a table has it: a prismatic row first."""
    described = robot()
    parameters = dict.fromkeys(("theta", "d", "a", "alpha"), 0.0)
    slide = Joint("rail", "prismatic", parameters, limits=(0.0, RAIL), axis=(0.0, 0.0, 1.0))
    return dataclasses.replace(described, joints=(slide, *described.joints))


def measured_on_a_rail(n: int, seed: int, noise: float, size: float) -> Measurements:
    """Poses on a carriage that follows a rail, which is bent and twisted by ``size`` times a tenth of a millimetre."""
    poses = run(n, seed)
    travel = np.random.default_rng(seed).uniform(0, RAIL, n)
    u = travel / RAIL
    twist = turn(0, size * 1e-4 * np.sin(4 * u)) @ turn(2, size * 1.5e-4 * u**2)
    carriage = shift(size * 2e-4 * np.sin(np.pi * u), size * 1e-4 * np.cos(3 * u), travel) @ twist
    position = np.einsum("nij,jn->in", carriage, np.vstack((targets(poses.q), np.ones(n))))[:3]
    return measured(Run(np.vstack([travel, poses.q]), poses.direction, poses.time), position, noise, seed)


def measured_with_loads(
    n: int, seed: int, noise: float, compliance: float, mass: Matrix, com: Matrix = TOOL
) -> Measurements:
    """Poses of an arm whose joint 2 gives way to loads (N,) in the last link's frame, and to no other weight."""
    poses = run(n, seed)
    turns = (load_torques(poses.q, mass, com) - torques(poses.q))[1]
    return measured(poses, poses.turned(1, compliance * turns), noise, seed)
