"""Warnings of a calibration about its poses, its fit and the effects that were requested."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from robacc.accuracy.stages import Stage
from robacc.calibration.plan import is_searched
from robacc.diagnostics.moved_frames import larger_error_warning, moved_frames
from robacc.diagnostics.read_back_share import read_back_warning
from robacc.diagnostics.rounded_joints import rounding_warning
from robacc.diagnostics.suspected_mistakes import suspected_mistakes
from robacc.effects.request import Request
from robacc.fitting.fit_result import Fit
from robacc.fitting.mass_uncertainty import mass_warning
from robacc.fitting.noise import LackOfFit
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.warnings import (
    condition_warning,
    convergence_warning,
    frames_warning,
    no_held_out_warning,
    outliers_warning,
    sigma_warning,
    weak_parameters_warning,
)
from robacc.measurements import Measurements

_OVERFIT_RATIO = 1.5
"""Ratio of the held-out RMS error to the fitted RMS error above which a warning is given."""


def request_warnings(requests: Sequence[Request], final_fit: Fit, registered: Stage, after: Stage) -> Iterator[str]:
    """Return a warning about requested effects that no joint shows, and about frames that were not fitted."""
    names = {effect.name for effect in final_fit.model.free}
    unsupported = [request.name for request in requests if is_searched(request) and request.name not in names]
    if unsupported:
        yield (
            f"no joint shows {' or '.join(unsupported)} on these poses, so it is not fitted; joints in brackets, as "
            f"in {unsupported[0]}[{final_fit.model.arm.names[0]}], fit it all the same"
        )
    frames = [name for name in ALIGNABLE if name not in names]
    if frames and after.fitted.position.rms > registered.fitted.position.rms:
        yield (
            f"the calibrated model is worse ({1e3 * after.fitted.position.rms:.3g} mm rms) than the nominal model with "
            f"base and tool registered ({1e3 * registered.fitted.position.rms:.3g} mm): add {','.join(frames)} to `fit`"
        )


def fit_warnings(
    final_fit: Fit, data: Measurements, after: Stage, noise: LackOfFit, holdout: Measurements | None
) -> tuple[str, ...]:
    """Return what limits the figures: convergence, poses, outliers, noise, weakly identifiable coefficients."""
    warnings = [
        *convergence_warning(final_fit),
        *mass_warning(final_fit),
        *data.warnings,
        *data.contradicted_ids(),
        *outliers_warning(final_fit, data),
        *rounding_warning(final_fit, data),
        *read_back_warning(final_fit, data),
        *suspected_mistakes(final_fit),
        *frames_warning(final_fit, data),
    ]
    warnings.extend((*sigma_warning(noise), *weak_parameters_warning(final_fit)))
    n_coefficients = int(final_fit.identifiability.columns.size)
    surplus = int(np.count_nonzero(final_fit.inliers)) * final_fit.residual.shape[0] - n_coefficients
    if surplus < n_coefficients:
        warnings.append(f"only {surplus} more measured values than fitted coefficients: measure more poses")
    warnings.extend(condition_warning(final_fit))
    warnings.extend(_held_out_warnings(final_fit, after, holdout))
    if after.held_out is None:
        warnings.append(no_held_out_warning(data))
    return tuple(warnings)


def _held_out_warnings(final_fit: Fit, after: Stage, holdout: Measurements | None) -> Iterator[str]:
    """Return why held-out errors are much larger than those of the calibration poses."""
    if after.held_out is None:
        return
    fitted, held_out = after.fitted.position.rms, after.held_out.position.rms
    if holdout is None:
        if held_out > _OVERFIT_RATIO * fitted:
            yield (
                "error on held-out poses is much larger than on calibration poses: fit fewer effects or measure more "
                "poses"
            )
    elif (moved := moved_frames(final_fit, holdout)) is not None:
        yield moved.warning
    elif (warning := larger_error_warning(fitted, held_out)) is not None:
        yield warning
