"""Errors of held-out poses of a calibration, by cross-validation or on validation poses."""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.calibration.plan import CalibrationPlan
from robacc.effects.base import Effect
from robacc.errors import InputError
from robacc.fitting.cross_validation import HoldOut, held_out, parts
from robacc.fitting.deflection_model import with_deflection
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.tracing.cross_validation import Progress


def hold_out(
    plan: CalibrationPlan,
    options: Options,
    data: Measurements,
    how: HoldOut,
    effects: tuple[Effect, ...],
    progress: Progress,
) -> tuple[Array, Array] | None:
    """Return the residuals of held-out poses, with frames only and with all effects; None if there are too few poses.

    The joints of searched effects are those of all poses.
    """
    fold_options = dataclasses.replace(options, tolerance=1e-6)
    frames = tuple(effect for effect in effects if effect.is_frame)
    if how.validation is not None:
        baseline = fit(Model.of(plan.robot, frames), data, fold_options)
        extended = plan.fitted(effects, data, fold_options)
        return held_out(baseline, how.validation), held_out(extended, how.validation)
    assigned = how.folds(data)
    if assigned is None:
        return None
    components = 3 if data.rotation is None else 6
    before, after = np.empty((components, data.n)), np.empty((components, data.n))
    try:
        chosen = with_deflection(effects, "equilibrium")
        for number, (training, test) in enumerate(parts(assigned), 1):
            progress("cross-validation", number, how.n_folds + 1)
            train_data, test_data = data.subset(np.flatnonzero(training)), data.subset(np.flatnonzero(test))
            before[:, test] = held_out(fit(Model.of(plan.robot, frames), train_data, fold_options), test_data)
            after[:, test] = held_out(plan.fitted(chosen, train_data, fold_options), test_data)
    except InputError:
        # The poses outside a fold are too few for the fitted coefficients, or leave the arm no elastic equilibrium.
        return None
    return before, after
