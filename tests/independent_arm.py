"""An arm simulated without the package: matrices of its own, torques as differences of potential energy.

Tests of effects use it so that an error of the package's kinematics or gravity cannot hide on both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robacc.measurements import Measurements
from robacc.robots.description import Robot
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


def link_frames(q: Matrix) -> list[Matrix]:
    """Frames (4, 4) of the links at one pose."""
    frame, frames = np.eye(4), []
    for (theta, d, a, alpha, _, _), angle in zip(DH, q, strict=True):
        ct, st, ca, sa = np.cos(theta + angle), np.sin(theta + angle), np.cos(alpha), np.sin(alpha)
        frame = frame @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
        frames.append(frame)
    return frames


def target(q: Matrix, tool: Matrix = TOOL) -> Matrix:
    """Position of the target at one pose."""
    return (link_frames(q)[-1] @ np.append(tool, 1.0))[:3]


def torques(q: Matrix, extra: Callable[[list[Matrix]], float] | None = None) -> Matrix:
    """Torques of gravity about the joints at one pose, positive along gravity: minus the slope of the energy."""

    def energy(at: Matrix) -> float:
        frames = link_frames(at)
        masses = sum(
            mass * GRAVITY * (frame @ np.append(com, 1.0))[2] for frame, (*_, mass, com) in zip(frames, DH, strict=True)
        )
        return float(masses) + (0.0 if extra is None else extra(frames))

    step = 1e-5
    return np.array([(energy(q - e) - energy(q + e)) / (2 * step) for e in step * np.eye(6)])


def targets(q: Matrix) -> Matrix:
    """Positions (3, N) of the target at joints (6, N)."""
    return np.array([target(angles) for angles in q.T]).T


def load_torques(q: Matrix, mass: float, com: Matrix = TOOL, link: int = -1) -> Matrix:
    """Torques about the joints at one pose by the links and by a mass in the frame of a link."""
    weight, place = mass * GRAVITY, np.append(com, 1.0)
    return torques(q, lambda frames: weight * float((frames[link] @ place)[2]))


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
