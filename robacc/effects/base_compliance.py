"""A pedestal that tilts under the torque of the arm's weight."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from robacc.chain import BASE
from robacc.effects.base import About, Effect, Part, Term, Traits, commanded, register, setting, weight_needed
from robacc.effects.elastic import DEFLECTIONS, OwnWeight, base_regressors
from robacc.geometry import Poses
from robacc.gravity.loads import unit_loads
from robacc.gravity.torques import moments
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class BaseCompliance(OwnWeight):
    """The base tilted by c times the torque of the arm's weight, the same in both directions.

    With ``below`` it tilts about a point on its axis at an unknown distance below: the base also shifts by the tilt
    times that distance. The shift follows the torque at the nominal pose. With masses ``unknown`` the torque's base
    regressors are fitted, as those of ``joint_compliance`` are.
    """

    below: bool = setting(False)

    name = "base_compliance"
    traits = Traits(
        per_joint=False,
        extrapolates="Hooke's law: tilt in proportion to the torque of the arm's weight",
        is_nonnegative=True,
    )
    about = About(
        summary="the pedestal or floor deflects: the base tilts under the torque of the arm's weight",
        equation="rotations of the base about x and y + c (m_x, m_y), the torque of the arm's weight about them at the "
        f"deflected pose; with below: true base x, y + c h (m_y, -m_x) too, h the height of the base over the "
        f"point of the tilt; {DEFLECTIONS}",
        unit="rad/(N m); masses unknown: the same times kg or kg m",
        usual_size="1e-9 to 1e-6 rad/(N m)",
        usual_range=(1e-09, 1e-06),
        needs="mass and com of the links; without them the base regressors of the torque are fitted",
        confused_with="lateral_compliance of the first joint, joint_compliance of the second",
        source="a parameter times a regressor, as every effect here",
        example="{effect: base_compliance, values: {value: 5e-7}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield a tilt about the base's origin, and where masses are known a tilt about a point below it."""
        yield cls.usual(arm, data, ())
        if arm.chain.bodies:
            yield cls(below=True)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the tilt, and with ``below`` the shift; with unknown masses a tilt for each base regressor."""
        turns = tuple(arm.chain.index(BASE, label) for label in ("turn_x", "turn_y"))
        if self.masses == "unknown":
            tilt = partial(self.parts, turns)
            return tuple(base_regressors(self.name, "rad/(N m)", 1e-6, unit_loads(arm, 0), tilt))
        loads = weight_needed(arm, data, self.name)
        parts = self.parts(turns, loads)
        if not self.below:
            return (Term(self.name, "rad/(N m)", 1e-6, parts),)
        moment_x, moment_y = moments(arm, commanded(data, self.name), turns, loads)
        # Turns are about the base's own axes, translations along those of the measuring frame.
        axes = Poses.from_xyz_rpy(np.zeros(3), np.array(arm.robot.base.rpy)).rotation.reshape(3, 3)
        moved = axes[:, :1] * moment_y - axes[:, 1:2] * moment_x
        shift = tuple(Part(arm.chain.index(BASE, label), moved[i]) for i, label in enumerate("xyz"))
        return (
            Term(f"{self.name}.tilt", "rad/(N m)", 1e-6, parts),
            Term(f"{self.name}.shift", "m/(N m)", 1e-6, shift),
        )

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the height of the base over the point about which it tilts."""
        tilt, shift = values.get(f"{self.name}.tilt", 0.0), values.get(f"{self.name}.shift", 0.0)
        if not tilt:
            return None
        height = shift / tilt
        return f"the base tilts about a point {abs(height):.2g} m {'below' if height >= 0 else 'above'} its origin"

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if the tilt about a point below has unknown masses."""
        return "below: true needs masses: known" if self.below and self.masses == "unknown" else None
