"""Whether the moments that deflect an arm are those in equilibrium or those at the undeflected pose, by the data.

A real arm is in equilibrium. Poses that a program made, or that a controller corrected, may follow the first-order form
instead; on an arm that sags by millimetres the two differ by micrometres. They have the same coefficients, so the
larger likelihood decides, and equilibrium stands unless the other form is better by more than chance would make it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.elastic import Deflection, Elastic
from robacc.fitting.solver import Fit, Options, fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals

_TOLD_APART = 1.0
"""Length of the whitened difference between the forms, over all rows, below which no data of such noise tell them
apart: twice the log-likelihood gains about its square where the rigid form is the true one."""
BETTER = 10.83
"""Twice the log-likelihood by which the rigid form has to be better: chi-square of one degree at 0.001."""


@dataclass(frozen=True, slots=True)
class DeflectionChoice:
    """The form taken, and why."""

    form: Deflection
    difference: float
    """Root mean square of the predicted positions' difference between the forms, the coefficients the same, m."""
    separation: float
    """Length of the whitened difference over all rows."""
    gain: float | None
    """Twice the log-likelihood of the rigid form less that of the equilibrium; None where they were not told apart."""


def choose_deflection(
    found: Fit, original: Model, data: Measurements, options: Options
) -> tuple[Fit, Model, DeflectionChoice | None]:
    """The fit of ``original`` in the form that the data show, that model in it, and why.

    ``found`` is the fit of ``original``, whose free elastic effects are in equilibrium. The other form is fitted only
    where its prediction differs enough to be told apart. None where no such effect is free.
    """
    if not any(isinstance(effect, Elastic) and effect.deflection == "equilibrium" for effect in original.free):
        return found, original, None
    rigid = dataclasses.replace(found.model, free=with_deflection(found.model.free, "rigid"))
    poses = rigid.bind(data).poses(found.theta)
    moved = (residuals(data, poses) - found.residual) * found.kept
    difference = float(np.sqrt(np.mean(np.sum(np.square(moved[:3, found.kept]), axis=0))))
    separation = float(np.linalg.norm(found.whitening.apply(moved)))
    if separation < _TOLD_APART:
        return found, original, DeflectionChoice("equilibrium", difference, separation, None)
    start = dataclasses.replace(options, start=found.theta, widths=found.widths, held=found.held)
    other = fit(rigid, data, start)
    if other.held.keys() - found.held.keys():
        # What one holds near its nominal value the other must hold too, or they are not of the same likelihood.
        found = fit(found.model, data, dataclasses.replace(start, held=other.held))
    rows = found.kept & other.kept
    gain = 2.0 * (_log_likelihood(other, rows) - _log_likelihood(found, rows))
    if gain <= BETTER:
        return found, original, DeflectionChoice("equilibrium", difference, separation, gain)
    model = dataclasses.replace(original, free=with_deflection(original.free, "rigid"))
    return other, model, DeflectionChoice("rigid", difference, separation, gain)


def with_deflection(effects: Sequence[Effect], form: Deflection) -> tuple[Effect, ...]:
    """The effects, elastic ones in the form."""
    return tuple(dataclasses.replace(e, deflection=form) if isinstance(e, Elastic) else e for e in effects)


def _log_likelihood(found: Fit, rows: NDArray[np.bool_]) -> float:
    """Of the rows, with the density of what has a prior; up to a constant that both forms have."""
    weight = found.weight[:, rows]
    prior = found.precision[found.precision > 0]
    drawn = found.theta[found.identifiability.kept][found.precision > 0]
    missed = float(np.square(found.whitening.apply(found.residual * rows)).sum()) + float(prior @ np.square(drawn))
    return float(np.log(weight).sum()) + 0.5 * (float(np.log(prior).sum()) - missed)
