"""A mistake in the data or the robot file, as it is reported."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Mistake:
    """Mistake, or several together, in the data or the robot file, and the error with and without it."""

    name: str
    fix: str
    before: float
    """Median position error of the registered nominal model, m."""
    after: float
    """The same with the mistake corrected, m."""
    orientation_before: float | None = None
    """Median orientation error of the registered nominal model, rad."""
    orientation_after: float | None = None
    alternatives: tuple[str, ...] = ()
    """Other mistakes that explain these poses as well."""
    unseen: tuple[str, ...] = ()
    """Joints whose sign these poses do not show."""

    @property
    def text(self) -> str:
        """Return the message."""
        errors = f"the median error is {self.before * 1e3:.3g} mm, and {self.after * 1e3:.3g} mm after this correction"
        if self.orientation_before is not None and self.orientation_after is not None:
            before, after = math.degrees(self.orientation_before), math.degrees(self.orientation_after)
            if self.after > self.before / 2:
                errors = f"the median orientation error is {before:.3g} degrees, and {after:.2g} after this correction"
        text = f"{self.name}: with base and tool registered, {errors}; {self.fix}"
        if self.alternatives:
            text += f". Not distinguishable on these poses: {'; or '.join(self.alternatives)}"
        if self.unseen:
            text += f". These poses do not show the sign of {', '.join(self.unseen)}"
        return text
