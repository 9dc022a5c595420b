"""Weakly identifiable constants of the arm: poses are few, or all have one orientation.

Without a prior, noise moves such a constant by centimetres along a direction that has no effect on these poses but does
on others.
"""

from __future__ import annotations

import numpy as np

from robacc.fitting.gauss_newton import posterior
from robacc.fitting.normal_equations import PoseEquations
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array
from robacc.modelling.model import Model

PRIOR_SIZES = 3.0
"""Deviation of a constant of a badly made arm, over its usual size: 3 mm or 3 mrad."""
WEAK = 0.3
"""Share of that deviation above which a standard error makes a constant weakly identifiable."""


def prior_std(equations: PoseEquations, model: Model) -> Array:
    """Return ``(K,)`` the deviation of each sought coefficient on a badly made arm (m or rad); inf of no constant."""
    constant = [effect.is_constant and not effect.is_frame for effect in model.free]
    return np.array(
        [
            PRIOR_SIZES * equations.terms[i].typical if constant[equations.owners[i]] else np.inf
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
