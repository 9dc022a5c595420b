"""Base class of effects that gravity drives: the deflection model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from robacc.effects.base import Effect, Part
from robacc.effects.settings import refuse_settings
from robacc.gravity.loads import Load

Deflection = Literal["equilibrium", "rigid"]

DEFLECTIONS = (
    "deflection: rigid takes it at the undeflected pose, the first-order form that controllers and most of the "
    "literature use"
)
"""Catalogue text of the setting."""


@dataclass(frozen=True)
class Elastic(Effect):
    """An effect of c times gravity's torque, in equilibrium: at the pose with all deflections.

    With ``deflection: rigid`` the torque is that at the pose without any deflection, the first-order form. The two
    differ by the square of the deflection over the lever: nanometres on a stiff arm, micrometres on one that sags by
    millimetres.
    """

    deflection: Deflection = field(default="equilibrium", kw_only=True)

    @property
    def uses_masses(self) -> bool:
        """Return True: the weights behind a joint are the file's."""
        return True

    def part(self, motion: int, loads: tuple[Load, ...]) -> Part:
        """Return the part of a motion that deflects under ``loads``."""
        return Part(motion, 1.0, loads, deflected=self.deflection == "equilibrium")

    def parts(self, motions: Sequence[int], loads: tuple[Load, ...]) -> tuple[Part, ...]:
        """Return the part of each of several motions."""
        return tuple(self.part(motion, loads) for motion in motions)

    def settings(self) -> dict[str, Any]:
        """Return the form, if it is not the equilibrium."""
        return {} if self.deflection == "equilibrium" else {"deflection": self.deflection}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Read ``deflection: equilibrium`` or ``rigid``."""
        return cls(joints, deflection=deflection_setting(cls.name, settings))


def deflection_setting(name: str, settings: Mapping[str, Any]) -> Deflection:
    """Return the setting ``deflection``, the only one that may be left.

    Raises:
        ValueError: it is neither of its two values, or there is another setting.
    """
    form: Deflection = settings.get("deflection", "equilibrium")
    if form not in ("equilibrium", "rigid"):
        raise ValueError(f"{name}: deflection must be equilibrium or rigid, found {form!r}")
    refuse_settings(name, [key for key in settings if key != "deflection"])
    return form
