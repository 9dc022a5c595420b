"""Coefficients of effects, and the scalars of the chain that they move."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.geometry import Array
from robacc.gravity.loads import Load

SCALE_OF_INSTRUMENT = -1
"""Pseudo-motion: the measured position itself, multiplied by 1 + scalar."""


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

    @property
    def label(self) -> str:
        """Return the last part of the name: the constant, coordinate or polynomial."""
        return self.name.rpartition(".")[2]
