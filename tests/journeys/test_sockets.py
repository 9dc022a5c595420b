"""A calibration without an instrument: the tip of the tool rests in sockets of a plate, arm simulated independently."""

from __future__ import annotations

import numpy as np
from independent_arm import DECLARED, LIMITS, robot, target

import robacc
from robacc.measurements import Measurements

ZEROS = np.array([0.0, 6e-3, -5e-3, 4e-3, 5e-3, 0.0])
"""Errors of the joint zeros, rad."""
PLATE = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.0]])
"""Sockets in the frame of the plate, m."""
CORNER, YAW = np.array([0.75, -0.15, 0.3]), 0.4
SCATTER = 3e-5
"""Repeatability of the joints, rad."""


def true_position(q: np.ndarray) -> np.ndarray:
    return target(q + ZEROS)


def in_plate(position: np.ndarray) -> np.ndarray:
    c, s = np.cos(YAW), np.sin(YAW)
    return (position - CORNER) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def reached(place: np.ndarray, start: np.ndarray) -> np.ndarray | None:
    """Joints near ``start`` at which the tip is in the socket at ``place`` in the plate; None if there are none."""
    q = start
    for _ in range(50):
        gap = place - in_plate(true_position(q))
        slope = np.array([(in_plate(true_position(q + e)) - in_plate(true_position(q - e))) for e in 1e-6 * np.eye(6)])
        q = q + np.clip(np.linalg.pinv(slope.T / 2e-6) @ gap, -0.2, 0.2)
    low, high = np.array(LIMITS).T
    is_reached = np.linalg.norm(gap) < 1e-9 and np.all(q > low) and np.all(q < high)
    return q if is_reached else None


def test_sockets_give_the_joint_zeros_and_positions_elsewhere() -> None:
    generator = np.random.default_rng(5)
    low, high = np.array(LIMITS).T
    joints, places = [], []
    while len(joints) < 36:
        place = PLATE[len(joints) % 3]
        if (q := reached(place, generator.uniform(0.6 * low, 0.6 * high))) is not None:
            joints.append(q + generator.normal(0.0, SCATTER, 6))
            places.append(place)
    result = robacc.calibrate(Measurements(np.array(places).T, q=np.array(joints).T), robot=robot(), fit=DECLARED)
    parameters = {parameter.name: parameter for parameter in result.parameters}
    for number, zero in enumerate(ZEROS[1:5], 2):
        found = parameters[f"joint_offset.j{number}"]
        assert found.std is not None
        assert abs(found.value - zero) < 3.0 * found.std
    q = generator.uniform(0.5 * low, 0.5 * high, (100, 6)).T
    elsewhere = Measurements(np.array([in_plate(true_position(angles)) for angles in q.T]).T, q=q)
    nominal, calibrated = (
        robacc.estimate(elsewhere, robot=arm, align=frames).position.mean_error
        for arm, frames in ((robot(), "base_frame,tool_frame"), (result.robot, "none"))
    )
    assert nominal > 1e-3
    assert calibrated < 0.25 * nominal
