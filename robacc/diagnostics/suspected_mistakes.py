"""Suspected mistakes after a fit: corrections that no arm has, and frames that moved before the validation poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robacc.fitting.fit_result import Fit
from robacc.geometry import Array, cross, exp_so3, log_so3, rms_length, rotate
from robacc.measurements import Measurements
from robacc.robots.description import LENGTH_PARAMETERS, Robot

# Validation poses whose base or target does not stand where it stood for the calibration poses.
#
# An instrument that was set up anew, a base that was moved or a reflector that was mounted again moves all predicted
# positions by one rigid motion, or by one vector in the target's frame. Held-out errors are then those of the setup.
#
# Source of the rotation in closed form: W. Kabsch, "A solution for the best rotation to relate two sets of vectors",
# Acta Crystallographica A32 (1976) 922.

_FEWEST = 10
"""Smallest number of poses that are judged."""
_LEAST_GAIN = 3.0
"""Factor by which registration lowers the median error. Chance gives 1.2 on ten poses, with nine coefficients."""
_LARGE = 4.0
"""Ratio of the error to that of the calibration poses from which the setup is suspected …"""
_ALIKE = 2.0
"""… if registration leaves at most this ratio: what remains is the arm's."""
_PASSES = 4
"""Fits, each with the rows weighted by their errors in the one before."""
_CAUCHY = 3.0
"""Median errors at which a row has half its weight."""
_ELSEWHERE = 2.0
"""Ratio of the errors of validation and calibration poses above which a warning is given."""


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


@dataclass(frozen=True, slots=True)
class HeldOutFrames:
    """Registration of predicted positions to validation poses."""

    measured: Array
    """``(3, N)`` measured positions, m."""
    rotation: Array | None
    """``(3, 3, N)`` predicted orientations of the target; None to register the base alone."""

    def residual(self, residual: Array) -> Array:
        """Return residuals ``(3, N)`` of position with the frames registered, from any ``(M, N)`` of the same poses."""
        return self._registered(residual)[0]

    def motion(self, residual: Array) -> tuple[float, float]:
        """Return the displacement (m) of the poses' centre and the angle (rad) of the registration."""
        _, rotation, shift = self._registered(residual)
        return float(np.linalg.norm(shift)), float(np.linalg.norm(log_so3(rotation)))

    def _registered(self, residual: Array) -> tuple[Array, Array, Array]:
        predicted = self.measured - residual[:3]
        weight = np.ones(predicted.shape[1])
        offset = np.zeros_like(predicted)
        rotation, moved = np.eye(3), predicted
        for _ in range(_PASSES):
            rotation = _rotation(predicted + offset, self.measured, weight)
            moved = rotate(rotation, predicted + offset)
            moved = moved + np.average(self.measured - moved, axis=1, weights=weight)[:, None]
            if self.rotation is not None:
                turned = np.einsum("ij,jkn->ikn", rotation, self.rotation)
                step, mount = _with_target(self.measured - moved, moved, turned, weight)
                moved, rotation = moved + step, exp_so3(mount[:3]) @ rotation
                offset = offset + np.einsum("ijn,j->in", self.rotation, mount[6:])
            errors = np.linalg.norm(self.measured - moved, axis=0)
            weight = 1.0 / (1.0 + np.square(errors / (_CAUCHY * max(float(np.median(errors)), 1e-12))))
        return self.measured - moved, rotation, np.mean(moved - predicted, axis=1)


def _rotation(points: Array, measured: Array, weight: Array) -> Array:
    """Return the rotation ``(3, 3)`` that best turns points ``(3, N)`` about their centre onto the measured ones."""
    centred = [item - np.average(item, axis=1, weights=weight)[:, None] for item in (points, measured)]
    left, _, right = np.linalg.svd((centred[1] * weight) @ centred[0].T)
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    result: Array = (left * flip) @ right
    return result


def _with_target(error: Array, moved: Array, turned: Array, weight: Array) -> tuple[Array, Array]:
    """Return the motion ``(3, N)`` by a turn, a shift and a shift of the target, and these nine numbers."""
    n = error.shape[1]
    centre = moved - moved.mean(axis=1, keepdims=True)
    turns = np.stack([cross(np.repeat(axis[:, None], n, axis=1), centre) for axis in np.eye(3)], axis=1)
    shifts = np.repeat(np.eye(3)[:, :, None], n, axis=2)
    columns = np.concatenate((turns, shifts, turned), axis=1)
    root = np.sqrt(weight)
    matrix = np.moveaxis(columns * root, 1, 2).reshape(-1, 9)
    numbers = np.asarray(np.linalg.lstsq(matrix, (error * root).ravel(), rcond=1e-6)[0], dtype=float)
    return np.einsum("ipn,p->in", columns, numbers), numbers


def moved_frames(fit: Fit, holdout: Measurements) -> MovedFrames | None:
    """Return how the frames of the validation poses differ from those of a fit; None if they agree."""
    if holdout.n < _FEWEST:
        return None
    predicted = fit.predict(holdout)
    residual = holdout.position - predicted.translation
    of_fit = rms_length(fit.residual[:3, fit.inliers])
    error = rms_length(residual)
    if error < _LARGE * of_fit:
        return None
    for by_target in (False, True):
        frames = HeldOutFrames(holdout.position, predicted.rotation if by_target else None)
        remaining = frames.residual(residual)
        registered = rms_length(remaining)
        if _LEAST_GAIN * _median(remaining) <= _median(residual) and registered <= _ALIKE * of_fit:
            return MovedFrames(*frames.motion(residual), by_target, error, registered)
    return None


def larger_error_warning(fitted: float, held_out: float) -> str | None:
    """Return a warning of validation poses whose rms error is much larger than that of the calibration poses, m."""
    if held_out <= _ELSEWHERE * fitted:
        return None
    return (
        f"the error of the validation poses is {held_out / max(fitted, 1e-300):.2g} times that of the calibration "
        "poses: the arm, its load, its zeros or the setup changed between the files, the poses are in another region, "
        "or the fit has too many effects for its poses"
    )


def _median(residual: Array) -> float:
    return float(np.median(np.linalg.norm(residual, axis=0)))


_LENGTH = 0.05
"""Share of the reach that the correction of a length exceeds."""
_ANGLE = {"link_geometry": math.radians(5.0), "joint_offset": math.radians(10.0)}
"""rad; corrections of angles that no assembled arm needs."""
_RATIO = {"gear_ratio": 0.05, "joint_coupling": 0.5}
"""Corrections of ratios: of a gear that is known, and of a coupling that is an interaction."""
_ORIENTATION = math.radians(3.0)
"""rad; remaining orientation error that no instrument leaves."""
_SURE = 3.0
"""Standard errors by which a correction exceeds its limit."""
_LISTED = 4


def suspected_mistakes(fit: Fit) -> tuple[str, ...]:
    """Return what in a fit comes from a mistake in the data or the robot file rather than from the arm; else empty."""
    length = reach(fit.model.arm.robot)
    std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    corrections = []
    for term, value, error in zip(fit.terms, fit.theta, std, strict=True):
        effect = term.name.partition(".")[0]
        limit = _RATIO.get(effect)
        if effect in _ANGLE:
            limit = _ANGLE[effect] if term.unit == "rad" else _LENGTH * length
        if limit is None or not np.isfinite(error) or abs(value) - _SURE * error <= limit:
            continue
        if effect in _RATIO:
            corrections.append(f"{term.name} is {value:.3g}")
        elif term.unit == "rad":
            corrections.append(f"{term.name} is corrected by {math.degrees(value):.3g} degrees")
        else:
            share = 100 * abs(value) / length
            corrections.append(f"{term.name} is corrected by {1e3 * value:.4g} mm ({share:.0f} % of the reach)")
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
    total = 0.0
    for joint in robot.joints:
        total += math.sqrt(sum(value**2 for name, value in joint.parameters.items() if name in LENGTH_PARAMETERS))
    return max(total, 1e-3)
