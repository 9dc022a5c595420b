"""Coefficients of effects, and the scalars of the chain that they move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robacc.geometry import Array
from robacc.gravity.loads import Load
from robacc.robots.arm import Arm

SCALE_OF_INSTRUMENT = -1
"""Pseudo-motion: the measured position itself, multiplied by 1 + scalar."""
LEAST_OF_CONSTANT = 1e-3
"""Least independent part of the column of a length or angle of the arm. Its other lengths and angles are wrong by about
1 mm and 1 mrad, so that the column itself is known to this share only; a smaller independent part is an error of the
model. With a tool that stays vertical within 0.5 mrad, its height above the flange is such a length."""


@dataclass(frozen=True, slots=True)
class Part:
    """One scalar that a term moves: by coefficient x factor, times the load's generalised force where it has a load.

    The generalised force is what gravity does to the loads behind the motion along it: N m for a rotation (the load's
    torque about the axis), N for a translation. It is positive along gravity, so a positive compliance sags.
    """

    motion: int
    factor: float | Array = 1.0
    """``(N,)`` regressor, or a constant."""
    loads: tuple[Load, ...] | None = None
    deflected: bool = True
    """True if the force is that at the deflected pose, in equilibrium; False at the undeflected pose."""


@dataclass(frozen=True, slots=True)
class Term:
    """One coefficient of the model."""

    name: str
    """``effect.joint.term``, stable."""
    unit: str
    typical: float
    """A usual size of the coefficient on real arms."""
    parts: tuple[Part, ...]
    group: str | None = None
    """Terms of one group share a Gaussian prior of zero mean; its standard deviation is estimated from the data."""
    weight: float = 1.0
    """Prior standard deviation relative to the group's."""
    least_part: float = 0.0
    """Share of its column that must be independent of other columns for the coefficient to be identifiable."""

    @property
    def label(self) -> str:
        """Return the last part of the name: the constant, coordinate or polynomial."""
        return self.name.rpartition(".")[2]


def joint_terms(effect: str, arm: Arm, regressors: Mapping[str, Array]) -> tuple[Term, ...]:
    """Return one term a joint, which adds coefficient x regressor ``(N,)`` to its variable; of about 0.1 mrad or mm."""
    return tuple(
        Term(f"{effect}.{joint}", arm.unit(joint), 1e-4, (Part(arm.axis_motion(joint), regressor),))
        for joint, regressor in regressors.items()
    )
