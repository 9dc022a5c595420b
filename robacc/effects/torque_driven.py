"""Base class of effects that are functions of gravity's torque on the joint at the commanded pose."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.effects.base import Driver, Effect
from robacc.effects.driver import torque_driver
from robacc.effects.requirements import torques_needed
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


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
