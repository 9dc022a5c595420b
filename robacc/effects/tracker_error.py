"""Range offset and angle errors of a laser tracker at an unknown place."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import About, Term, Traits, register, setting
from robacc.effects.instrument_place import LineOfSight, beams
from robacc.geometry import Array
from robacc.robots.arm import Arm

_LARGEST_ANGLE = 3e-4
"""Largest plausible amplitude of an angle's error, rad: three times what a tracker in need of service has."""


@register
@dataclass(frozen=True)
class TrackerError(LineOfSight):
    """Measured point shifted along the line of sight, or turned about the instrument by its angle error.

    The instrument's standing axis is the measuring frame's z.
    """

    kind: Literal["range", "horizontal", "vertical"] = setting("range", written=True)

    name = "tracker_error"
    traits = Traits(
        per_joint=False,
        is_searched=True,
        drivers=(),
        extrapolates="the geometry of the instrument",
        is_of_measurement=True,
        implausible_factor=3.0,
    )
    about = About(
        summary="the tracker's own geometry: a wrong range offset (home point), an eccentric horizontal or vertical "
        "encoder",
        equation="p measured = p + c u; or + r_h (c cos A + s sin A) e_A; or + r (c cos E + s sin E) e_E; u the line "
        "of sight, A azimuth, E elevation",
        unit="m (rad for the angles)",
        usual_size="5e-6 to 5e-4 m; 2e-6 to 1e-4 rad",
        usual_range=(5e-6, 5e-4),
        needs="targets in several directions and at several distances from the instrument",
        confused_with="transmission_error of joint 1 where the instrument stands close to its axis, instrument_scale",
        source="Hughes, Forbes, Lewis, Sun, Veal, Nasr, Measurement Science and Technology 22 (2011) 045103",
        example="{effect: tracker_error, kind: range, instrument: [3, -2, 1], values: {offset: 5e-5}}",
    )

    def forms(self) -> Iterator[LineOfSight]:
        """Yield the error of the range and those of both angles."""
        yield from (TrackerError(self.joints, self.place, kind) for kind in ("range", "horizontal", "vertical"))

    @property
    def labels(self) -> tuple[tuple[str, str, float], ...]:
        """Return the offset of the range, or cosine and sine of an angle's error."""
        if self.kind == "range":
            return (("offset", "m", 1e-5),)
        return (("cos", "rad", 1e-5), ("sin", "rad", 1e-5))

    def shifts(self, position: Array, rotation: Array, places: Array) -> Array:
        """Return the line of sight, or the tangents times cosine and sine of the angle."""
        along, distance = beams(position, places)
        if self.kind == "range":
            return along[:, None]
        flat = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
        x, y, z = along[:, 0] / flat, along[:, 1] / flat, along[:, 2]
        if self.kind == "horizontal":
            tangent = np.stack((-y, x, np.zeros_like(x)), axis=1) * (flat * distance)[:, None]
            return np.stack((tangent * x[:, None], tangent * y[:, None]), axis=1)
        tangent = np.stack((-z * x, -z * y, flat), axis=1) * distance[:, None]
        return np.stack((tangent * flat[:, None], tangent * z[:, None]), axis=1)

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason if an offset, or an angle's error, is more than a tracker can have; else None."""
        if self.kind == "range":
            return super().implausible(terms, values)
        size = math.hypot(*values)
        if size <= _LARGEST_ANGLE:
            return None
        return (
            f"{self.name}: an error of {1e3 * size:.2g} mrad of the {self.kind} angle is implausible; usual "
            "amplitudes are 0.002 to 0.1 mrad"
        )

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the size of the error, and what to do."""
        size = float(np.sqrt(np.sum(np.square([values.get(f"{self.name}.{label}", 0.0) for label, *_ in self.labels]))))
        place = ", ".join(f"{value:.2g}" for value in self.place)
        amount = f"{1e3 * size:.2g} mm" if self.kind == "range" else f"{1e3 * size:.2g} mrad"
        return (
            f"the instrument near {place} m has an error of {amount} in its {self.kind} reading: run its compensation "
            "routine and a two-face check, and measure again"
        )
