"""Choice of the deflection model: gravity torques in equilibrium, or at the undeflected pose.

A real arm is in equilibrium. Poses that a program made, or that a controller corrected, may follow the first-order form
instead; on an arm that sags by millimetres the two differ by micrometres. They have the same coefficients, so the
larger likelihood decides, and equilibrium stands unless the other form is significantly better.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.elastic import Deflection, Elastic
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.parsimony import without_idle_rotations
from robacc.fitting.solver import fit
from robacc.geometry import rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals

_DISTINGUISHABLE = 1.0
"""Length of the whitened difference between the forms, over all rows, below which no data of such noise distinguish
them: twice the log-likelihood gains about its square where the rigid form is the true one."""
BETTER = 10.83
"""Twice the log-likelihood by which the rigid form has to be better: chi-square of one degree at 0.001."""


@dataclass(frozen=True, slots=True)
class DeflectionChoice:
    """The chosen form, and the figures behind the choice."""

    form: Deflection
    difference: float
    """Root mean square of the predicted positions' difference between the forms, the coefficients the same, m."""
    separation: float
    """Length of the whitened difference over all rows."""
    gain: float | None
    """Twice the log-likelihood of the rigid form less that of the equilibrium; None if the forms are not
    distinguishable."""


def choose_form(
    fitted: Fit, original: Model, data: Measurements, options: Options
) -> tuple[Fit, DeflectionChoice | None]:
    """Return ``fitted``, the fit of ``original``, or the fit with the chosen deflection and geometry; and the choice.

    First the deflection model is chosen, then idle rotations of the geometry are left out.
    """
    fitted, model, choice = choose_deflection(fitted, original, data, options)
    return without_idle_rotations(fitted, model, data, options), choice


def choose_deflection(
    equilibrium_fit: Fit, original: Model, data: Measurements, options: Options
) -> tuple[Fit, Model, DeflectionChoice | None]:
    """Return the fit in the chosen form, ``original`` in that form, and the choice.

    ``equilibrium_fit`` is the fit of ``original``, whose free elastic effects are in equilibrium. The rigid form is
    fitted only if the two predictions are distinguishable. The choice is None if no such effect is free.
    """
    if not any(isinstance(effect, Elastic) and effect.deflection == "equilibrium" for effect in original.free):
        return equilibrium_fit, original, None
    inliers = equilibrium_fit.inliers
    rigid_model = dataclasses.replace(equilibrium_fit.model, free=with_deflection(equilibrium_fit.model.free, "rigid"))
    poses = rigid_model.bind(data).poses(equilibrium_fit.theta)
    moved = (residuals(data, poses) - equilibrium_fit.residual) * inliers
    difference = rms_length(moved[:3, inliers])
    separation = float(np.linalg.norm(equilibrium_fit.whitening.apply(moved)))
    if separation < _DISTINGUISHABLE:
        return equilibrium_fit, original, DeflectionChoice("equilibrium", difference, separation, None)
    start = dataclasses.replace(
        options,
        start=equilibrium_fit.theta,
        group_stds=equilibrium_fit.group_stds,
        prior_stds=equilibrium_fit.prior_stds,
    )
    rigid_fit = fit(rigid_model, data, start)
    if rigid_fit.prior_stds.keys() - equilibrium_fit.prior_stds.keys():
        # Both fits need the same priors, or their likelihoods cannot be compared.
        start = dataclasses.replace(start, prior_stds=rigid_fit.prior_stds)
        equilibrium_fit = fit(equilibrium_fit.model, data, start)
    rows = equilibrium_fit.inliers & rigid_fit.inliers
    gain = 2.0 * (_log_likelihood(rigid_fit, rows) - _log_likelihood(equilibrium_fit, rows))
    if gain <= BETTER:
        return equilibrium_fit, original, DeflectionChoice("equilibrium", difference, separation, gain)
    model = dataclasses.replace(original, free=with_deflection(original.free, "rigid"))
    return rigid_fit, model, DeflectionChoice("rigid", difference, separation, gain)


def with_deflection(effects: Sequence[Effect], form: Deflection) -> tuple[Effect, ...]:
    """Return the effects, elastic effects in the form."""
    return tuple(dataclasses.replace(e, deflection=form) if isinstance(e, Elastic) else e for e in effects)


def _log_likelihood(fitted: Fit, rows: NDArray[np.bool_]) -> float:
    """Return the log-likelihood of the rows and of the priors, up to a constant that both forms share."""
    weight = fitted.weight[:, rows]
    with_prior = fitted.precision > 0
    precision = fitted.precision[with_prior]
    theta = fitted.theta[fitted.identifiability.columns][with_prior]
    cost = float(np.square(fitted.whitening.apply(fitted.residual * rows)).sum()) + float(precision @ np.square(theta))
    return float(np.log(weight).sum()) + 0.5 * (float(np.log(precision).sum()) - cost)
