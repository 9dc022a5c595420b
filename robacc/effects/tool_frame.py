"""Pose of the measured target on the last link."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.chain import TOOL
from robacc.effects.base import LEAST_OF_CONSTANT, About, Effect, Term, Traits, register
from robacc.effects.base_frame import frame_terms
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


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
        names = [*arm.robot.targets]
        regressors: dict[str, Array | float] = {f"{self.name}.{names[0]}" if names else self.name: 1.0}
        if names and data.target is not None:
            regressors = {f"{self.name}.{name}": (data.target == name).astype(float) for name in names}
        return tuple(
            term
            for prefix, regressor in regressors.items()
            for term in frame_terms(arm, TOOL, prefix, regressor, typical=1e-3, least_part=LEAST_OF_CONSTANT)
        )
