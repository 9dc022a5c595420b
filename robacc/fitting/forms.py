"""The form of a model that the data show: of its elastic effects, then of its geometry."""

from __future__ import annotations

from robacc.fitting.deflection_model import DeflectionChoice, choose_deflection
from robacc.fitting.parsimony import without_idle_rotations
from robacc.fitting.solver import Fit, Options
from robacc.measurements import Measurements
from robacc.modelling.model import Model


def choose_form(
    found: Fit, original: Model, data: Measurements, options: Options
) -> tuple[Fit, DeflectionChoice | None]:
    """``found``, the fit of ``original``, or the fit in the form that ``data`` show; and the choice of it."""
    found, model, choice = choose_deflection(found, original, data, options)
    return without_idle_rotations(found, model, data, options), choice
