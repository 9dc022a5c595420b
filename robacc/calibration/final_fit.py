"""Final fit of a calibration: structure of the errors, then shrinkage to the nominal values."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.calibration.plan import CalibrationPlan
from robacc.effects.base import Effect
from robacc.error_model.structure import ErrorStructure, with_error_structure
from robacc.fitting.deflection_model import DeflectionChoice
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.measurements import Measurements


@dataclass(frozen=True, slots=True)
class FinalFit:
    """Fit of all effects to all calibration poses, and further results."""

    fit: Fit
    structure: ErrorStructure
    shrunk: tuple[ShrunkKind, ...]
    """Constants with shrinkage to the nominal values, by kind."""
    deflection: DeflectionChoice | None
    """Model of the torques behind elastic effects; None if no elastic effect is fitted."""


def final_fit(plan: CalibrationPlan, effects: tuple[Effect, ...], data: Measurements, options: Options) -> FinalFit:
    """Return the fit of ``effects`` whose standard errors allow for the structure of the errors.

    Raises:
        InputError: There are too few poses.
    """
    unshrunk, deflection = plan.unshrunk(effects, data, options)

    def refitted(scattered: Options) -> Fit:
        nonlocal deflection
        again, deflection = plan.unshrunk(effects, data, scattered, unshrunk)
        return again

    structure = with_error_structure(unshrunk, data, options, refitted)
    chosen, shrunk = plan.shrunk(structure.fit, data, structure.options)
    return FinalFit(chosen, structure, shrunk, deflection)
