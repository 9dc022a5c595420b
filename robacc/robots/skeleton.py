"""The arm as a line through space: what a picture of its poses shows for scale."""

from __future__ import annotations

import numpy as np

from robacc.geometry import Array
from robacc.robots.arm import Arm


def skeleton(arm: Arm, q: Array) -> Array:
    """``(3, P)`` corners of the line from the base to the tool at joint variables ``q`` ``(J,)``, measuring frame, m.

    Every translation of the chain is one straight piece, so the shoulder and elbow of a DH table are seen where the
    table has them.
    """
    counts = list(range(len(arm.chain.motions) + 1))
    frames = arm.chain.sweep(arm.chain.scalars(q[:, None]), 1, (), counts).frames
    points = np.concatenate([frame.translation for frame in frames], axis=1)
    moved = np.any(np.abs(np.diff(points, axis=1)) > 1e-9, axis=0)
    return points[:, np.concatenate(([True], moved))]


def typical_pose(q: Array) -> int:
    """The pose nearest to the middle of all poses ``(J, N)``, each joint counted by its own spread."""
    middle = np.median(q, axis=1, keepdims=True)
    spread = np.ptp(q, axis=1, keepdims=True)
    spread[spread == 0] = 1.0
    return int(np.argmin(np.sum(np.square((q - middle) / spread), axis=0)))
