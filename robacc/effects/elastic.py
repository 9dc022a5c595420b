"""What effects that gravity drives share: at which pose the moment that deflects the arm is taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from robacc.effects.base import Effect, Part
from robacc.gravity.loads import Load

Deflection = Literal["equilibrium", "rigid"]

DEFLECTIONS = (
    "deflection: rigid takes it at the undeflected pose, the first-order form that controllers and most of the "
    "literature use"
)
"""What a catalogue says of the setting."""


@dataclass(frozen=True)
class Elastic(Effect):
    """An effect of c times gravity's moment, in equilibrium: at the pose that all deflections together lead to.

    With ``deflection: rigid`` the moment is that at the pose without any deflection, the first-order form. The two
    differ by the square of the deflection over the lever: nanometres on a stiff arm, micrometres on one that sags by
    millimetres.
    """

    deflection: Deflection = field(default="equilibrium", kw_only=True)

    def part(self, motion: int, loads: tuple[Load, ...]) -> Part:
        """The motion that gives way, under ``loads``."""
        return Part(motion, 1.0, loads, deflected=self.deflection == "equilibrium")

    def settings(self) -> dict[str, Any]:
        """The form, where it is not the equilibrium."""
        return {} if self.deflection == "equilibrium" else {"deflection": self.deflection}

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """``deflection: equilibrium`` or ``rigid``."""
        form, rest = deflection_setting(cls.name, settings)
        if rest:
            raise ValueError(f"{cls.name} has no setting {', '.join(map(repr, rest))}")
        return cls(joints, deflection=form)


def deflection_setting(name: str, settings: Mapping[str, Any]) -> tuple[Deflection, dict[str, Any]]:
    """The setting ``deflection``, and the other settings.

    Raises:
        ValueError: it is neither of its two values.
    """
    rest = dict(settings)
    form = rest.pop("deflection", "equilibrium")
    if form not in ("equilibrium", "rigid"):
        raise ValueError(f"{name}: deflection must be equilibrium or rigid, found {form!r}")
    return form, rest
