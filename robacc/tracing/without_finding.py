"""Held-out residuals of a model without one of its findings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robacc.effects.base import Effect
from robacc.errors import EquilibriumError, InputError
from robacc.fitting.cross_validation import held_out
from robacc.fitting.deflection_model import with_deflection
from robacc.fitting.fit_result import Fit, Options
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.bound import BoundModel
from robacc.modelling.observation import residuals
from robacc.tracing.refitting import SEARCH, refit

_NONLINEAR = 0.02
"""Relative deviation of the cost from its linearisation, above which a model without an effect is fitted anew."""


def fold_options(fit: Fit) -> Options:
    """Return the options of a fold.

    Row weights and widths of profiles are those of the fit to all rows, which has left outliers out already.
    """
    return dataclasses.replace(SEARCH, robust=False, misfit=fit.misfit, scatter=fit.scatter, hold_groups=True)


class ReducedFits:
    """Models that lack findings of a complete fit to ``train``, on the rows ``test``."""

    def __init__(self, complete: Fit, train: Measurements, test: Measurements, options: Options) -> None:
        """Bind the complete model once; all reduced models use it."""
        self._complete, self._train, self._test, self._options = complete, train, test, options

    @cached_property
    def _at_train(self) -> BoundModel:
        return self._complete.model.bind(self._train)

    @cached_property
    def _at_test(self) -> BoundModel:
        return self._complete.model.bind(self._test, self._complete.validity)

    def residuals(self, absent: Sequence[Effect], instead: Sequence[Effect] = ()) -> Array | None:
        """Return residuals of ``test`` with the effects ``absent`` removed and the rest fitted again to ``train``.

        Effects ``instead`` come in their place: other findings that the absent ones stood for as well.

        A step to first order is enough where the model is nearly linear; otherwise the model is fitted. Return None for
        a frame, without which the model cannot be compared, and if the remaining compliances have no equilibrium.
        """
        if any(effect.is_frame for effect in absent):
            return None
        free = self._complete.model.free
        numbers = {i for i, effect in enumerate(with_deflection(free, "equilibrium")) if effect in absent}
        theta = self._complete.without(numbers)
        try:
            if not instead and self._is_linear(theta):
                return residuals(self._test, self._at_test.poses(theta))
            remaining = [*(effect for i, effect in enumerate(free) if i not in numbers), *instead]
            return held_out(refit(self._complete, remaining, self._train, self._options), self._test)
        except (EquilibriumError, InputError):
            return None

    def _is_linear(self, theta: Array) -> bool:
        """Return whether the cost at ``theta`` is what the linearisation at the fit predicts."""
        complete = self._complete
        columns = complete.identifiability.columns
        step = theta[columns] - complete.theta[columns]
        before = float(np.sum(np.square(complete.whitening.apply(complete.residual * complete.inliers))))
        pull = complete.precision * complete.theta[columns]  # the gradient that the priors balance
        expected = before - 2.0 * float(step @ pull) + float(step @ complete.gram @ step)
        try:
            actual_residual = residuals(self._train, self._at_train.poses(theta)) * complete.inliers
        except EquilibriumError:
            return False
        actual = float(np.sum(np.square(complete.whitening.apply(actual_residual))))
        return abs(actual - expected) <= _NONLINEAR * max(expected, 1.0)
