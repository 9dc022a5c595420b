"""Effects that stand in a model file for processes over the joints: errors without a cause."""

from __future__ import annotations

from collections.abc import Sequence

from robacc.effects.base import Effect
from robacc.effects.pose_correction import PoseCorrection
from robacc.effects.transmission_error import TransmissionError
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


def profile(joint: str, orders: tuple[float, ...]) -> Effect:
    """Return the periodic error of ``joint`` of all ``orders``, shrunk by a common prior."""
    return TransmissionError((joint,), orders, True)


def pose_correction(arm: Arm, data: Measurements, joints: Sequence[str], lengths: Sequence[float]) -> Effect:
    """Return the correction of ``joints`` by a process with a length (rad or m) for each, centred among the poses."""
    return PoseCorrection.over(arm, data, joints, lengths)
