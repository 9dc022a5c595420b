"""Pose of the measured target on the last link."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from robacc.chain import TOOL
from robacc.effects.base import About, Effect, Term, Traits, register
from robacc.effects.base_frame import frame_terms, moved_frame
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


@register
@dataclass(frozen=True)
class ToolFrame(Effect):
    """Six coordinates of the tool, or of each of several targets."""

    name = "tool_frame"
    traits = Traits(per_joint=False, is_constant=True, is_frame=True)
    about = About(
        summary="where the measured target sits on the last link",
        equation="tool x, y, z + dx, dy, dz; then rotated about its own x, y, z; for each target its own",
        unit="m, rad",
        usual_size="1e-3 m, 1e-3 rad after mounting by hand",
        usual_range=(0.001, 0.01),
        needs="nothing; the rotations only where orientation was measured",
        confused_with="the last joint's theta, d, a, alpha",
        source="Wu and Lee 1984, eq. (3), with the tool as one more link",
        example="{effect: tool_frame, values: {z: 5e-4, pitch: 1e-3}}",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return six terms, or six for each target that was measured."""
        if not arm.robot.targets or data.target is None:
            prefix = f"{self.name}.{next(iter(arm.robot.targets))}" if arm.robot.targets else self.name
            return frame_terms(arm, TOOL, prefix)
        return tuple(
            term
            for target in arm.robot.targets
            for term in frame_terms(arm, TOOL, f"{self.name}.{target}", (data.target == target).astype(float))
        )

    def apply(self, arm: Arm, values: Mapping[str, float]) -> Robot:
        """Return the robot with its tool, or its targets, moved."""
        if not arm.robot.targets:
            return dataclasses.replace(arm.robot, tool=moved_frame(arm.robot.tool, values, self.name))
        targets = {
            target: moved_frame(frame, values, f"{self.name}.{target}") for target, frame in arm.robot.targets.items()
        }
        return dataclasses.replace(arm.robot, targets=targets)
