"""Coupling of joints: one joint turns another, as a wrist's gears or a parallelogram do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robacc.effects.base import About, Driver, Effect, Part, Term, commanded, joint_driver, register, setting
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class JointCoupling(Effect):
    """Joint j turned by k times joint i's variable, for each driver i."""

    drivers: tuple[str, ...] = setting(())

    name = "joint_coupling"
    extrapolates = "a coupling acts in proportion to the driving joint's angle"
    about = About(
        summary="one joint turns another: wrist gears, a parallelogram, a belt over an axis",
        equation="theta_j + k q_i, i not j",
        unit="1 (rad/m, m/rad between unlike joints)",
        usual_size="1e-4 to 1e-2",
        usual_range=(0.0001, 0.01),
        needs="q1 … qN that vary independently",
        confused_with="gear_ratio of the driving joint where both axes are parallel",
        source="a parameter times a regressor, as every effect here; Whitney, Lozinski, Rourke 1986",
        example="{effect: joint_coupling, joints: [j6], drivers: [j5], values: {j6.j5: 1e-3}}",
    )

    def validity_drivers(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints that turn others."""
        return tuple(dict.fromkeys(name for joint in self.joints for name in self.drivers or neighbours(arm, joint)))

    def driver(self, arm: Arm, data: Measurements, joint: str | None) -> Driver | None:
        """Return the joint that turns this joint, if there is a single one."""
        return joint_driver(arm, data, self.drivers[0]) if len(self.drivers) == 1 else None

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per pair of joints."""
        q = commanded(data, self.name)
        return tuple(
            Term(
                f"{self.name}.{joint}.{driver}",
                _unit(arm, joint, driver),
                1e-3,
                (Part(arm.axis_motion(joint), q[arm.number(driver)]),),
            )
            for joint in self.joints
            for driver in (self.drivers or neighbours(arm, joint))
            if driver != joint
        )

    @classmethod
    def default(cls, arm: Arm, data: Measurements, joints: Sequence[str] | None = None) -> Effect:
        """Return every pair of neighbours."""
        return cls(joints=tuple(joints) if joints is not None else arm.names)

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield every ordered pair of joints, neighbours first."""
        pairs = [(j, i) for j in range(len(arm.names)) for i in range(len(arm.names)) if i != j]
        for j, i in sorted(pairs, key=lambda pair: abs(pair[0] - pair[1])):
            yield cls(joints=(arm.names[j],), drivers=(arm.names[i],))

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the effect of the ``drivers``, a name or a list of names."""
        listed = {key: [value] if isinstance(value, str) else value for key, value in settings.items()}
        return super().from_settings(joints, listed)


def neighbours(arm: Arm, joint: str) -> tuple[str, ...]:
    """Return the joints next to a joint in the chain."""
    i = arm.number(joint)
    return tuple(arm.names[k] for k in (i - 1, i + 1) if 0 <= k < len(arm.names))


def _unit(arm: Arm, joint: str, driver: str) -> str:
    if arm.is_revolute(joint) == arm.is_revolute(driver):
        return "1"
    return "rad/m" if arm.is_revolute(joint) else "m/rad"
