"""Joints that deflect under the payload."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import About, Effect, Need, Over, Term, Traits, compliance_unit, needed, register, setting
from robacc.effects.elastic import DEFLECTIONS, Elastic
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.gravity.loads import Load, payload
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class PayloadCompliance(Elastic):
    """Each joint turned by c times the moment of the payload about its axis, in equilibrium.

    With ``groups``, names of the column payload_group, masses are unknown: the coefficients of each group are the
    compliance times its mass. Rows of a group called ``none`` or ``empty`` carry nothing.

    With the centre of mass ``uncertain``, the payload's first moments in the last link's frame, shrunk by a prior,
    correct it; their coefficients are the compliance times what the centre is off the file's.
    """

    com: Literal["known", "uncertain"] = setting("known")
    groups: tuple[str, ...] = setting(())
    """Names of loads of unknown mass; none where the masses are those of payload_kg."""

    name = "payload_compliance"
    traits = Traits(
        needs=(
            Need("no payload_kg column", lambda arm, data: data.payload is not None or data.payload_group is not None),
            Need("payload_kg is zero throughout", lambda arm, data: data.payload is None or bool(data.payload.any())),
            Need(
                "payload_group has one name only, or a name with fewer than 8 rows",
                lambda arm, data: data.payload is not None or bool(_groups(data)),
            ),
        ),
        extrapolates="Hooke's law: deflection in proportion to the payload's torque",
        is_nonnegative=True,
    )
    about = About(
        summary="the joint deflects under the payload, which was not the same at every pose",
        equation="theta_j + c_j tau_j, tau_j the torque of the payload's weight about the axis at the deflected pose; "
        f"{DEFLECTIONS}",
        unit="rad/(N m) (m/N for a prismatic joint); com uncertain: also the same times m; groups: the same times kg",
        usual_size="1e-7 to 1e-5 rad/(N m)",
        usual_range=(1e-07, 1e-05),
        needs="payload_kg that varies, or payload_group where masses are unknown; payload: com in the robot file "
        "(default: at the tool), or com: uncertain",
        confused_with="joint_compliance where the payload never changes",
        source="Khalil and Dombre 2002, ch. 9.5; Nubiola and Bonev 2013",
        example="{effect: payload_compliance, joints: [j2, j3], values: {j2: 2e-6, j3: 5e-6}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return the effect of the payload's masses, or of groups where these are unknown."""
        return cls(joints, groups=_groups(data))

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one joint at a time, with the file's centre of mass and with an uncertain one."""
        groups = _groups(data)
        for joint in arm.names:
            yield cls((joint,), groups=groups)
            yield cls((joint,), "uncertain", groups)

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the payload, where it is known."""
        return () if self.groups else ("payload_kg",)

    def chart(self) -> Over | None:
        """Return the payload's torque on the joint, where it is known."""
        return None if self.groups else Over("payload_torque_{joint}")

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term for each joint and load, and one for each first moment if the centre is uncertain."""
        terms = []
        for joint in self.joints:
            motion, name = arm.axis_motion(joint), f"{self.name}.{joint}"
            unit = compliance_unit(arm, joint)
            for label, mass in self._masses(data).items():
                of_load = f"{name}.{label}" if self.groups else name
                unit_of_load, typical = (f"{unit} kg", 5e-5) if self.groups else (unit, 1e-5)
                terms.append(Term(of_load, unit_of_load, typical, (self.part(motion, payload(arm, mass)),)))
                for axis, load in _first_moments(arm, mass).items() if self.com == "uncertain" else ():
                    part = self.part(motion, (load,))
                    terms.append(Term(f"{of_load}.{axis}", f"{unit_of_load} m", typical, (part,), of_load, _COM_STD))
        return tuple(terms)

    def _masses(self, data: Measurements) -> dict[str, Array]:
        """Return the mass ``(N,)`` of the load of each group, 1 kg in its rows; or that of all poses.

        Raises:
            UsageError: A row carries a load of another name.
        """
        if not self.groups:
            return {"": needed(data.payload, "payload_kg", self.name)}
        names = needed(data.payload_group, "payload_group", self.name)
        unknown = sorted(set(np.unique(names).tolist()) - {*self.groups, *_NOTHING})
        if unknown:
            raise UsageError(
                f"{self.name} was fitted with the loads {', '.join(self.groups)}, but a row carries {unknown[0]!r}; "
                "fit it with rows of this load, or write payload_kg"
            )
        return {group: (names == group).astype(float) for group in self.groups}

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the ratios of unknown loads."""
        if not self.groups:
            return None
        sizes = {group: values.get(f"{self.name}.{self.joints[0]}.{group}", 0.0) for group in self.groups}
        largest = max(sizes.values(), key=abs)
        if largest == 0.0:
            return None
        shares = ", ".join(f"{group} {size / largest:.2f}" for group, size in sizes.items())
        return (
            f"{', '.join(self.joints)} deflect under loads of unknown mass; relative to the largest, they are: {shares}"
        )


_NOTHING = ("none", "empty")
"""Names of a group of rows without a load."""
_FEWEST_ROWS = 8
"""Least rows of a group, so that the rest has some whichever is held out."""
_COM_STD = 0.2
"""Prior standard deviation of a coordinate of the centre of mass about the file's, m."""


def _groups(data: Measurements) -> tuple[str, ...]:
    """Return the names of loads whose masses are unknown; none where masses are known, or no two names have rows."""
    if data.payload_group is None or data.payload is not None:
        return ()
    names, counts = np.unique(data.payload_group, return_counts=True)
    if names.size < 2 or counts.min() < _FEWEST_ROWS:
        return ()
    return tuple(str(name) for name in names if name not in _NOTHING)


def _first_moments(arm: Arm, mass: Array) -> dict[str, Load]:
    """Return the payload's first moments of mass per metre along each axis of the last link's frame."""
    loads = {}
    for axis, label in enumerate(("hx", "hy", "hz")):
        x, y, z = (mass if i == axis else 0.0 for i in range(3))
        loads[label] = Load(arm.flange, 0.0, (x, y, z))
    return loads
