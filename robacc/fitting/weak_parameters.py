"""Constants of the arm that poses hardly show: where they are few, or all of one orientation.

Left free, noise moves such a constant by centimetres along a direction that these poses do not see and others do.
"""

from __future__ import annotations

import numpy as np

from robacc.fitting.gauss_newton import posterior
from robacc.fitting.normal_equations import PoseEquations
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array
from robacc.modelling.model import Model

PRIOR_SIZES = 3.0
"""Times its usual size that a constant of a badly made arm is off: 3 mm or 3 mrad."""
WEAK = 0.3
"""A constant whose standard error is more than this part of that is hardly shown."""


def prior_std(equations: PoseEquations, model: Model) -> Array:
    """``(K,)`` by how much each coefficient kept is off on a badly made arm (m or rad); inf of what is no constant."""
    constant = [effect.is_constant and not effect.is_frame for effect in model.free]
    return np.array(
        [
            PRIOR_SIZES * equations.terms[i].typical if constant[equations.owners[i]] else np.inf
            for i in equations.columns
        ]
    )


def std_at_nominal(equations: PoseEquations, white: Whitening, precision: Array) -> Array:
    """``(K,)`` standard errors of the coefficients kept, were the robot its file's.

    What is free to drift goes to where it seems to be known; here it is seen for what it is. ``white`` has weight
    zero for rows left out, ``precision`` ``(P,)`` that of the priors.
    """
    _, normal = equations.linearise(np.zeros(len(equations.terms)), white)
    spread: Array = np.sqrt(np.diag(posterior(normal.gram, precision[equations.columns])))
    return spread
