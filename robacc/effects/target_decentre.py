"""A reflector whose optical centre is not the centre of its sphere, turned to the instrument at each pose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import About, Traits, register, setting
from robacc.effects.instrument_place import LineOfSight, beams, perpendicular
from robacc.geometry import Array
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class TargetDecentre(LineOfSight):
    """Target shifted by a constant in the frame of the line of sight.

    A reflector that is turned to the instrument at each pose turns in its nest. Its decentring is constant along the
    line of sight and across it; the roll about the line of sight is that of an axis of the tool.
    """

    axis: Literal["x", "y", "z"] = setting("x", written=True)
    """Axis of the tool that decides the reflector's roll about the line of sight."""

    name = "target_decentre"
    traits = Traits(
        per_joint=False,
        is_searched=True,
        drivers=(),
        extrapolates="the decentring is a constant of the reflector",
        is_of_measurement=True,
    )
    about = About(
        summary="the reflector's optical centre is not the centre of its sphere, and it is turned to the instrument at "
        "each pose; or its nest holds it off centre along the line of sight",
        equation="p measured = p + c_along u + c_across v + c_beyond u x v, u the line of sight, v the part of the "
        "tool's axis perpendicular to it",
        unit="m",
        usual_size="3e-6 to 1e-5 m for a good reflector, up to 5e-4 m after a fall",
        usual_range=(3e-6, 5e-4),
        needs="a tool that turns against the line of sight",
        confused_with="tool_frame where the tool keeps its direction to the instrument",
        source="ASME B89.4.19-2006: optical and mechanical centre of a spherically mounted retroreflector",
        example="{effect: target_decentre, axis: x, instrument: [3, -2, 1], values: {across: 1e-4, beyond: 5e-5}}",
    )

    def forms(self) -> Iterator[LineOfSight]:
        """Yield a form for each axis of the tool."""
        yield from (TargetDecentre(self.joints, self.place, axis) for axis in ("x", "y", "z"))

    @property
    def labels(self) -> tuple[tuple[str, str, float], ...]:
        """Return the shift along the line of sight, and two across it."""
        return (("along", "m", 1e-5), ("across", "m", 1e-5), ("beyond", "m", 1e-5))

    def shifts(self, position: Array, rotation: Array, places: Array) -> Array:
        """Return the line of sight, the tool's axis across it, and their product."""
        along, _ = beams(position, places)
        across = perpendicular(rotation[:, "xyz".index(self.axis)], along)
        beyond = np.cross(along, across, axis=1)
        return np.stack((along, across, beyond), axis=1)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return how far the centre is off, and what to do."""
        sizes = [values.get(f"{self.name}.{label}", 0.0) for label, *_ in self.labels]
        off = 1e3 * float(np.sqrt(np.sum(np.square(sizes))))
        place = ", ".join(f"{value:.2g}" for value in self.place)
        return (
            f"the reflector's optical centre is {off:.2g} mm from the centre of its sphere, for an instrument near "
            f"{place} m: turn it in its nest and watch the reading; replace it, or keep the same side "
            "towards the instrument"
        )
