"""Weakly identifiable constants of the arm: poses are few, or all have one orientation.

Without a prior, noise moves such a constant by centimetres along a direction that has no effect on these poses but does
on others. The constants of its kind then share a Gaussian prior about nominal, whose standard deviation is estimated
from the data (:mod:`robacc.fitting.shrinkage`): zeros that are wrong by degrees widen their own prior, and leave that
of the lengths narrow. Given priors take precedence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.fitting.linear_algebra import posterior
from robacc.fitting.normal_equations import PoseEquations
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array
from robacc.modelling.model import Model

BADLY_MADE = 3.0
"""Deviation of a constant of a badly made arm, over its usual size: 3 mm or 3 mrad."""
WEAK = 0.3
"""Share of that deviation above which a standard error makes a constant weakly identifiable."""


@dataclass(frozen=True, slots=True)
class ConstantKind:
    """Constants that share a prior: joint zeros, link lengths or link angles."""

    name: str
    members: tuple[int, ...]
    """Numbers of the coefficients."""
    usual: float
    """Usual size, m or rad."""


def constant_kinds(equations: PoseEquations, model: Model) -> tuple[ConstantKind, ...]:
    """Return the kinds of constants among the sought coefficients; frames belong to none."""
    members: dict[str, list[int]] = {}
    for i in equations.columns.tolist():
        effect, term = model.free[equations.owners[i]], equations.terms[i]
        if effect.is_constant and not effect.is_frame and term.group is None:
            members.setdefault(f"{effect.name} ({term.unit})", []).append(i)
    return tuple(
        ConstantKind(name, tuple(columns), max(equations.terms[i].typical for i in columns))
        for name, columns in members.items()
    )


def badly_made(equations: PoseEquations, model: Model) -> Array:
    """Return ``(K,)`` the deviation of each sought coefficient on a badly made arm (m or rad); inf of no constant."""
    constant = [effect.is_constant and not effect.is_frame for effect in model.free]
    return np.array(
        [
            BADLY_MADE * equations.terms[i].typical if constant[equations.owners[i]] else np.inf
            for i in equations.columns
        ]
    )


def std_at_nominal(equations: PoseEquations, white: Whitening, precision: Array) -> Array:
    """Return ``(K,)`` standard errors of the sought coefficients at the nominal robot.

    A coefficient that drifts goes to where it appears well identifiable; the nominal robot shows its real standard
    error. ``white`` has weight zero for rows left out, ``precision`` ``(P,)`` is of the priors.
    """
    _, normal = equations.linearise(np.zeros(len(equations.terms)), white)
    std: Array = np.sqrt(np.diag(posterior(normal.gram, precision[equations.columns])))
    return std
