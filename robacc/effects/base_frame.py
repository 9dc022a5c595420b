"""Pose of the robot's base in the measuring frame."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.chain import BASE
from robacc.effects.base import LEAST_OF_CONSTANT, About, Effect, Part, Term, Traits, register
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import TURN_OF_ANGLE, Arm

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
