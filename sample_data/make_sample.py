"""Make ``poses.csv`` beside this file: 60 simulated poses of ``robot.yaml`` with errors of known size.

    python sample_data/make_sample.py

The arm that is "measured" differs from its file: joint zeros by some 0.02 degree, link lengths by some 0.2 mm, the
instrument's frame by a millimetre and a milliradian; the instrument adds 0.03 mm and 0.02 mrad of noise (one standard
deviation along and about each axis). Nothing here was measured on a real robot.
"""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np

from robacc.geometry import Poses, compose, exp_so3, quaternion_from_rotation
from robacc.io.robot_file import read_robot
from robacc.robots.assembly import build_chain
from robacc.robots.description import Frame, Robot

HERE = Path(__file__).parent
N_POSES = 60
SEED = 1984
JOINT_ZERO = np.deg2rad(0.02)
LENGTH = 0.2e-3
NOISE_POSITION = 0.03e-3
NOISE_ROTATION = 0.02e-3


def real_arm(nominal: Robot, rng: np.random.Generator) -> Robot:
    """The nominal arm with errors in its joint zeros, its link lengths and where it stands."""
    joints = []
    for joint in nominal.joints:
        changed = dict(joint.parameters)
        changed["theta"] += rng.normal(scale=JOINT_ZERO)
        changed["a"] += rng.normal(scale=LENGTH)
        changed["d"] += rng.normal(scale=LENGTH)
        joints.append(dataclasses.replace(joint, parameters=changed))
    base = Frame(xyz=(0.0011, -0.0007, 0.0004), rpy=(0.0006, -0.0004, 0.0010))
    return dataclasses.replace(nominal, joints=tuple(joints), base=base)


def measured(arm: Robot, q: np.ndarray, rng: np.random.Generator) -> Poses:
    """What the instrument reads of the arm at joints ``q`` (J, N)."""
    poses = build_chain(arm).forward(q)
    shift = rng.normal(scale=NOISE_POSITION, size=(3, q.shape[1]))
    turn = rng.normal(scale=NOISE_ROTATION, size=(3, q.shape[1]))
    return Poses(compose(poses.rotation, exp_so3(turn)), poses.translation + shift)


def main() -> None:
    """Write the file."""
    rng = np.random.default_rng(SEED)
    nominal = read_robot(HERE / "robot.yaml")
    limits = np.array([joint.limits for joint in nominal.variables])
    # What is commanded is what the file says, so the joints are rounded before the arm moves.
    degrees = np.rad2deg(rng.uniform(limits[:, :1], limits[:, 1:], size=(len(limits), N_POSES))).round(4)
    poses = measured(real_arm(nominal, rng), np.deg2rad(degrees), rng)
    header = ["pose", *(f"q{i + 1}_deg" for i in range(len(degrees))), "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"]
    with (HERE / "poses.csv").open("w", encoding="utf-8", newline="") as stream:
        stream.write("# Simulated by sample_data/make_sample.py; not a real robot.\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        quaternions = quaternion_from_rotation(poses.rotation)
        for i in range(N_POSES):
            joints = [f"{value:.4f}" for value in degrees[:, i]]
            position = [f"{value:.4f}" for value in poses.translation[:, i] * 1e3]
            writer.writerow([f"P{i + 1:02d}", *joints, *position, *(f"{value:.7f}" for value in quaternions[:, i])])


if __name__ == "__main__":
    main()
