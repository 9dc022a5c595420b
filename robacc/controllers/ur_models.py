"""Nominal Denavit-Hartenberg parameters of the arms of Universal Robots.

Source: Universal Robots, "DH parameters for calculations of kinematics and dynamics", support article 45257.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from robacc.controllers.dh_table import DhRow

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


def nearest_ur_arm(measures: Sequence[float]) -> tuple[str, float]:
    """Return the arm nearest to d1, a2, a3, d5, d6 (m, without signs), and the largest difference, m."""
    differences = {
        arm: max(
            abs(abs(nominal) - measure) for nominal, measure in zip((*lengths[:3], *lengths[4:]), measures, strict=True)
        )
        for arm, lengths in _LENGTHS.items()
    }
    best = min(differences, key=differences.__getitem__)
    return best, differences[best]
