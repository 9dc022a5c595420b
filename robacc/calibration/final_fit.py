"""Final fit of a calibration: scatter of the joints and standard errors, then shrinkage to the nominal values."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from robacc.calibration.plan import CalibrationPlan
from robacc.effects.base import Effect
from robacc.fitting.deflection_model import DeflectionChoice
from robacc.fitting.directional_noise import DirectionalNoise, noise_and_scatter
from robacc.fitting.error_structure import with_error_structure
from robacc.fitting.fit_repeatability import Repeatability, measured_alone, repeatability_of, settle_scatter
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.noise import LackOfFit
from robacc.fitting.scatter_check import NO_SCATTER, contradicts_scatter, with_scatter_covariance
from robacc.fitting.sparse_prior import ShrunkKind
from robacc.measurements import Measurements


@dataclass(frozen=True, slots=True)
class FinalFit:
    """Fit of all effects to all calibration poses, and further results."""

    fit: Fit
    predicting: Fit
    """The same fit with the covariance that predictions take."""
    noise: LackOfFit
    options: Options
    """Options of the fit, with the scatter of the joints and errors that poses share, where they are significant."""
    shrunk: tuple[ShrunkKind, ...]
    """Constants with shrinkage to the nominal values, by kind."""
    deflection: DeflectionChoice | None
    """Model of the torques behind elastic effects; None if no elastic effect is fitted."""
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant given the noise."""
    directional: DirectionalNoise | None
    """Noise that is larger along one direction than along others; None if it is not."""
    warnings: tuple[str, ...]


def final_fit(plan: CalibrationPlan, effects: tuple[Effect, ...], data: Measurements, options: Options) -> FinalFit:
    """Return the fit of ``effects`` whose standard errors allow for scatter of the joints and the structure of errors.

    Raises:
        InputError: There are too few poses.
    """
    unshrunk, deflection = plan.unshrunk(effects, data, options)
    weighted = unshrunk, deflection

    def refitted(scattered: Options) -> Fit:
        nonlocal weighted
        weighted = plan.unshrunk(effects, data, scattered, weighted[0])
        return weighted[0]

    scattered_options, components, _ = settle_scatter(unshrunk, data, options, refitted)
    warnings: list[str] = []
    if components is not None:
        if contradicts_scatter(unshrunk, weighted[0], components, data):
            unshrunk = with_scatter_covariance(unshrunk, components, data)
            warnings.append(NO_SCATTER)
        else:
            options, (unshrunk, deflection) = scattered_options, weighted
    structured = with_error_structure(unshrunk, data, plan.with_priors(options, unshrunk.model.free, data).priors)
    options = dataclasses.replace(options, added=structured.added)
    chosen, shrunk = plan.shrunk(structured.fit, data, options)
    predicting = dataclasses.replace(chosen, covariance=structured.predicting.covariance)
    repeatability = None if components is None else repeatability_of(chosen, components, data)
    if warnings:
        repeatability = measured_alone(repeatability)
    apart = noise_and_scatter(chosen if structured.added is None else unshrunk, repeatability, data)
    warnings += [*structured.warnings, *structured.shared, *apart.warnings_if(structured.shared)]
    return FinalFit(
        chosen,
        predicting,
        apart.noise,
        options,
        shrunk,
        deflection,
        apart.repeatability,
        apart.noise_unless(structured.shared),
        tuple(warnings),
    )
