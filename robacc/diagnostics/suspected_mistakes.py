"""Suspected mistakes after a fit: corrections that no arm has, and frames that moved before the validation poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robacc.fitting.closed_form import register_positions
from robacc.fitting.fit_result import Fit
from robacc.geometry import log_so3, rms_length, rotate_back
from robacc.measurements import Measurements
from robacc.robots.description import LENGTH_PARAMETERS, Robot

# Validation poses whose base or target does not stand where it stood for the calibration poses.
#
# An instrument that was set up anew, a base that was moved or a reflector that was mounted again moves all predicted
# positions by one rigid motion, or by one vector in the target's frame. Held-out errors are then those of the setup.

_FEWEST = 10
"""Smallest number of poses that are judged."""
_LEAST_GAIN = 3.0
"""Factor by which registration lowers the median error. Chance gives 1.2 on ten poses, with nine coefficients."""
_ALIKE = 2.0
"""Ratio of the errors of validation and calibration poses up to which what remains is the arm's. Above it a warning is
given, and from twice as much the setup is suspected."""


@dataclass(frozen=True, slots=True)
class MovedFrames:
    """Motion of the validation poses against the model, and their error with and without it."""

    shift: float
    """Displacement of the poses' centre, m."""
    turn: float
    """Angle of the rotation, rad."""
    by_target: bool
    """True if a shift of the target in its own frame is needed too."""
    error: float
    """RMS position error, m."""
    registered: float
    """The same with base, and with ``by_target`` the target, registered on these poses, m."""

    @property
    def warning(self) -> str:
        """Return what moved, how far, and what to do."""
        what = "base and target" if self.by_target else "base"
        cause = ", or the target was mounted again" if self.by_target else ""
        return (
            f"the validation poses lie {1e3 * self.shift:.3g} mm and {np.degrees(self.turn):.2g}° from where the model "
            f"has them: the instrument or the robot base moved between the files{cause}; with {what} registered on "
            f"them, their error is {1e3 * self.registered:.3g} mm rms in place of {1e3 * self.error:.3g} mm; transform "
            "both files into one frame (common reference points), or leave out `holdout`, write the model, and use "
            'estimate with `align="base_frame,tool_frame"` on the validation poses'
        )


def moved_frames(fit: Fit, holdout: Measurements) -> MovedFrames | None:
    """Return how the frames of the validation poses differ from those of a fit; None if they agree."""
    if holdout.n < _FEWEST:
        return None
    predicted = fit.predict(holdout)
    residual = holdout.position - predicted.translation
    of_fit, error = rms_length(fit.residual[:3, fit.inliers]), rms_length(residual)
    if error < 2.0 * _ALIKE * of_fit:
        return None
    rotation, translation = np.moveaxis(predicted.rotation, 2, 0)[None], predicted.translation.T[None]
    for by_target in (False, True):
        rows = np.ones((int(by_target), holdout.n))
        found = register_positions(rotation, translation, holdout.position.T[None], rows)
        registered = rms_length(found.vectors[0].T)
        gain = float(np.median(np.linalg.norm(residual, axis=0))) / max(float(found.median[0]), 1e-300)
        if gain >= _LEAST_GAIN and registered <= _ALIKE * of_fit:
            # The residual in the measuring frame is R^T times that in the base.
            shift = residual - rotate_back(found.rotation[0], found.vectors[0].T)
            turn = float(np.linalg.norm(log_so3(found.rotation[0])))
            return MovedFrames(float(np.linalg.norm(shift.mean(axis=1))), turn, by_target, error, registered)
    return None


def larger_error_warning(fitted: float, held_out: float) -> str | None:
    """Return a warning of validation poses whose rms error is much larger than that of the calibration poses, m."""
    if held_out <= _ALIKE * fitted:
        return None
    return (
        f"the error of the validation poses is {held_out / max(fitted, 1e-300):.2g} times that of the calibration "
        "poses: the arm, its load, its zeros or the setup changed between the files, the poses are in another region, "
        "or the fit has too many effects for its poses"
    )


# Corrections that no arm has, and a remaining error that no instrument has.

_LARGEST = {
    "link_geometry": math.radians(5.0),
    "joint_offset": math.radians(10.0),
    "gear_ratio": 0.05,
    "joint_coupling": 0.5,
}
"""Corrections of angles (rad) that no assembled arm needs, and of ratios: a gear's is known, and a coupling of one half
is an interaction."""
_LONGEST = 0.05
"""Correction of a length that no assembled arm needs, as a share of the reach."""
_ORIENTATION = math.radians(3.0)
"""Remaining orientation error that no instrument leaves, rad."""
_LISTED = 4


def suspected_mistakes(fit: Fit) -> tuple[str, ...]:
    """Return what in a fit comes from a mistake in the data or the robot file rather than from the arm; else empty."""
    length = reach(fit.model.arm.robot)
    std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    corrections = []
    for term, value, error in zip(fit.terms, fit.theta, std, strict=True):
        limit, text = _LARGEST.get(term.name.partition(".")[0], np.inf), f"is {value:.3g}"
        if term.unit == "rad":
            text = f"is corrected by {math.degrees(value):.3g} degrees"
        elif term.unit == "m":
            limit = _LONGEST * length if limit < np.inf else limit
            text = f"is corrected by {1e3 * value:.4g} mm ({100 * abs(value) / length:.0f} % of the reach)"
        # Three standard errors leave no doubt.
        if abs(value) - 3.0 * error > limit:
            corrections.append(f"{term.name} {text}")
    texts = []
    if corrections:
        more = "" if len(corrections) <= _LISTED else f", and {len(corrections) - _LISTED} more"
        texts.append(
            f"suspected data mistake: {', '.join(corrections[:_LISTED])}{more}; no assembled arm deviates this far; "
            "check the table's convention and lengths, the signs and zeros of the joints, and interactions of joints"
        )
    if fit.residual.shape[0] == 6:
        error = float(np.median(np.linalg.norm(fit.residual[3:, fit.inliers], axis=0)))
        if error > _ORIENTATION:
            texts.append(
                f"suspected data mistake: a median orientation error of {math.degrees(error):.3g} degrees remains; "
                "check the convention of the orientation columns (order of a quaternion, angles, unit)"
            )
    return tuple(texts)


def reach(robot: Robot) -> float:
    """Return the sum of the lengths of the arm's links, base and tool excluded, m."""
    links = [[joint.parameters.get(name, 0.0) for name in LENGTH_PARAMETERS] for joint in robot.joints]
    return max(sum(math.hypot(*lengths) for lengths in links), 1e-3)
