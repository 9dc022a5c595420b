"""Coupling of joints: one joint turns another, as a wrist's gears or a parallelogram do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from robacc.effects.base import About, Effect, Over, Term, Traits, driven_by, register, setting
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class JointCoupling(Effect):
    """Joint j turned by k times joint i's variable, for each driver i."""

    drivers: tuple[str, ...] = setting(())

    name = "joint_coupling"
    traits = Traits(extrapolates="a coupling acts in proportion to the driving joint's angle")
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

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints that turn others."""
        return tuple(driver for joint in self.joints for driver in self._drivers(arm, joint))

    def chart(self) -> Over | None:
        """Return the joint that turns this joint, if there is a single one."""
        return Over(self.drivers[0]) if len(self.drivers) == 1 else None

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per pair of joints."""
        return tuple(
            self.joint_term(
                arm, joint, driven_by(arm, data, driver, self.name), driver, 1e-3, unit=_unit(arm, joint, driver)
            )
            for joint in self.joints
            for driver in self._drivers(arm, joint)
            if driver != joint
        )

    def _drivers(self, arm: Arm, joint: str) -> tuple[str, ...]:
        """Return the joints that turn a joint: by default those next to it."""
        i = arm.number(joint)
        return self.drivers or tuple(arm.names[k] for k in (i - 1, i + 1) if 0 <= k < len(arm.names))

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


def _unit(arm: Arm, joint: str, driver: str) -> str:
    if arm.is_revolute(joint) == arm.is_revolute(driver):
        return "1"
    return "rad/m" if arm.is_revolute(joint) else "m/rad"
