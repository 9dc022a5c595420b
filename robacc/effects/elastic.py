"""Base classes of effects that gravity drives: the deflection model, the torque as driver, and unknown masses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal

from robacc.effects.base import Driver, Effect, Part, Term, setting, torque_driver, torques_needed
from robacc.geometry import Array
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


# Base class of effects that are functions of gravity's torque on the joint at the commanded pose.


@dataclass(frozen=True)
class TorqueDriven(Effect):
    """An effect of each joint's own torque, which is that of the file's masses and of no deflection.

    It adds to ``joint_compliance``, the part in proportion to the torque.
    """

    missing_reasons = ("no masses in the robot file",)

    @property
    def uses_masses(self) -> bool:
        """Return True: the torque is that of the file's masses."""
        return True

    @classmethod
    def missing(cls, arm: Arm, data: Measurements) -> str | None:
        """Return the reason if there are no masses."""
        return None if arm.chain.bodies else cls.missing_reasons[0]

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return gravity's torque on the joint."""
        return None if joint is None else torque_driver(arm, data, joint)

    def torques(self, arm: Arm, data: Measurements) -> Array:
        """Return ``(J, N)`` gravity's torque (N m) or force (N) on each joint."""
        return torques_needed(arm, data, self.name)
