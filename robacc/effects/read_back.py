"""Joints read back: the arm stood where its encoders said, not where it was commanded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import About, Effect, Need, Part, Term, Traits, commanded, needed, register
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

FOLLOWED_SHARE = 0.5
"""Share from which the joints read back describe the arm better than those commanded."""


def _differs(arm: Arm, data: Measurements) -> bool:
    """Return whether a joint was read back elsewhere than commanded."""
    return data.read_back is not None and data.q is not None and not np.array_equal(data.read_back, data.q)


@register
@dataclass(frozen=True)
class ReadBack(Effect):
    """Joint variables shifted by a share of the difference between the joints read back and those commanded.

    A share of 1 means that the arm stood at the joints read back when it was measured, a share of 0 that it stood at
    its command, whatever was read before.
    """

    name = "read_back"
    traits = Traits(
        per_joint=False,
        needs=(Need("no read_q columns that differ from the commanded joints", _differs),),
        drivers=(),
        extrapolates="the difference is that of each pose",
        is_of_measurement=True,
        is_nonnegative=True,
        implausible_factor=1.5,
    )
    about = About(
        summary="the arm stood at the joints read back, not at those commanded: it had not settled, or its "
        "controller leaves a constant error",
        equation="theta_j + c (q_read_j - q_j), the same c for all joints",
        unit="1",
        usual_size="0.5 to 1: 1 where the arm stood at the joints read back",
        usual_range=(0.5, 1.0),
        needs="q1 … qN as commanded and read_q1 … read_qN as read back",
        confused_with="approach_lag and backlash where the difference follows the last motion",
        source="a parameter times a regressor, as every effect here",
        example="{effect: read_back, values: {value: 1}}",
    )

    @property
    def rejects_implausible(self) -> bool:
        """Return True: an arm stands between its command and the joints read back, so no share is far above 1."""
        return True

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the share, common to all joints."""
        difference = needed(data.read_back, "read_q1 … read_qN", self.name) - commanded(data, self.name)
        parts = tuple(Part(arm.axis_motion(joint), difference[arm.number(joint)]) for joint in arm.names)
        return (Term(self.name, "1", 1.0, parts),)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return which joints the measured positions follow, and what to do."""
        share = values.get(self.name, 0.0)
        if share < FOLLOWED_SHARE:
            return (
                f"the measured positions follow only a share of {share:.2g} of the difference between the joints read "
                "back and those commanded: the joints were read before the arm had settled; read and measure at the "
                "same time"
            )
        return (
            f"the measured positions follow the joints read back, not those commanded (share {share:.2g}): the arm was "
            "measured before it had settled, or its controller leaves a constant error; wait longer before "
            "a measurement, or give the joints read back as q1 … qN"
        )
