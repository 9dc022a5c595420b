"""Pose of the robot's base in the measuring frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE
from robacc.effects.base import LEAST_OF_CONSTANT, About, Effect, Part, Term, Traits, register
from robacc.geometry import Array, Poses, rotation_about, rpy_from_rotation
from robacc.measurements import Measurements
from robacc.robots.arm import TURN_OF_ANGLE, Arm
from robacc.robots.description import Frame, Robot

FRAME_LABELS = {"x": "x", "y": "y", "z": "z", **TURN_OF_ANGLE}
"""Term to motion. Roll, pitch and yaw here are turns about the frame's own x, y, z: no gimbal lock anywhere."""


def frame_terms(
    arm: Arm,
    owner: int,
    prefix: str,
    regressor: Array | float = 1.0,
    *,
    turning: bool = True,
    suffix: str = "",
    typical: float = 1e-4,
    least_part: float = 0.0,
) -> tuple[Term, ...]:
    """Return the terms that move a frame along x, y, z and, where it is ``turning``, about its own axes."""
    return tuple(
        Term(
            f"{prefix}.{label}{suffix}",
            "m" if label in "xyz" else "rad",
            typical,
            (Part(arm.chain.index(owner, motion), regressor),),
            least_part=least_part,
        )
        for label, motion in FRAME_LABELS.items()
        if turning or label in "xyz"
    )


def moved_frame(frame: Frame, values: Mapping[str, float], prefix: str) -> Frame:
    """Return the frame with fitted terms added: the product of the chain's motions; unturned, its angles stay."""
    x, y, z = (value + values.get(f"{prefix}.{label}", 0.0) for value, label in zip(frame.xyz, "xyz", strict=True))
    turns = [values.get(f"{prefix}.{label}", 0.0) for label in TURN_OF_ANGLE]
    if not any(turns):
        return Frame((x, y, z), frame.rpy)
    rotation = Poses.from_xyz_rpy(np.zeros(3), np.array(frame.rpy)).rotation
    for axis, turn in enumerate(turns):
        rotation = rotation @ rotation_about(axis, turn)
    roll, pitch, yaw = (float(angle) for angle in rpy_from_rotation(rotation))
    return Frame((x, y, z), (roll, pitch, yaw))


@register
@dataclass(frozen=True)
class BaseFrame(Effect):
    """Six coordinates of the base."""

    name = "base_frame"
    traits = Traits(per_joint=False, is_constant=True, is_frame=True)
    about = About(
        summary="where the robot stands in the measuring frame",
        equation="base x, y, z + dx, dy, dz; then rotated about its own x, y, z by roll, pitch, yaw",
        unit="m, rad",
        usual_size="any: the instrument may stand anywhere",
        usual_range=(0.001, 1),
        needs="nothing",
        confused_with="joint_offset of the first joint (yaw), its d (z)",
        source="Wu and Lee 1984, eq. (3), with the base as one more link",
        example="{effect: base_frame, values: {x: 1e-3, yaw: 2e-4}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return six terms."""
        return frame_terms(arm, BASE, self.name, typical=1e-3, least_part=LEAST_OF_CONSTANT)

    def apply(self, arm: Arm, values: Mapping[str, float]) -> Robot:
        """Return the robot with its base moved."""
        return dataclasses.replace(arm.robot, base=moved_frame(arm.robot.base, values, self.name))
