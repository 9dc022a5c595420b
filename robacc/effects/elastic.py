"""Base classes of effects that gravity drives: the deflection model, the torque as driver, and unknown masses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal

from robacc.effects.base import Effect, Part, Term, setting
from robacc.gravity.loads import Load
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

# Forms of elastic effects whose masses are not those of the robot file: the setting, and the base regressors.

_MASS_STD = 5.0
"""Prior standard deviation of an unknown mass, kg."""
_FIRST_MOMENT_STD = 1.0
"""Prior standard deviation of an unknown first moment of mass, kg m."""


def base_regressors(
    prefix: str,
    unit: str,
    typical: float,
    loads: Mapping[str, tuple[Load, ...]],
    parts: Callable[[tuple[Load, ...]], tuple[Part, ...]],
    stds: Mapping[str, float] | None = None,
) -> Iterator[Term]:
    """Yield one term for each unit mass and unit first moment of mass, shrunk by a common prior.

    Args:
        prefix: Name of the effect, and of its joint; the terms share it as the name of their prior.
        unit: Unit of the compliance.
        typical: Usual size of the compliance.
        loads: Unit loads by label, as :func:`robacc.gravity.loads.unit_loads` returns them.
        parts: Function that returns what moves under a load.
        stds: Prior standard deviation of each label's mass (kg) or first moment (kg m), where it is not the usual.
    """
    for label, load in loads.items():
        is_mass = label.startswith("m")
        usual = _MASS_STD if is_mass else _FIRST_MOMENT_STD
        std = usual if stds is None else stds.get(label, usual)
        unit_of_term = f"{unit} {'kg' if is_mass else 'kg m'}"
        yield Term(f"{prefix}.{label}", unit_of_term, typical, parts(load), prefix, std)


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

    _: KW_ONLY
    deflection: Deflection = setting("equilibrium")

    def part(self, motion: int, loads: tuple[Load, ...]) -> Part:
        """Return the part of a motion that deflects under ``loads``."""
        return Part(motion, 1.0, loads, deflected=self.deflection == "equilibrium")

    def parts(self, motions: Sequence[int], loads: tuple[Load, ...]) -> tuple[Part, ...]:
        """Return the part of each of several motions."""
        return tuple(self.part(motion, loads) for motion in motions)


@dataclass(frozen=True)
class OwnWeight(Elastic):
    """An elastic effect of the arm's own weight, whose masses are those of the file, or are fitted too."""

    masses: Literal["known", "unknown"] = setting("known")

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the effect with the robot's masses, if it has any."""
        return cls(joints, "known" if arm.chain.bodies else "unknown")
