"""Warnings that every fit can give: its noise, its poses and coefficients, and mistakes that its figures suggest."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from robacc.fitting.closed_form import register_positions
from robacc.fitting.fit_result import Fit
from robacc.fitting.outliers import outlier_pattern
from robacc.fitting.priors import weak_kinds
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.visits import visit_numbers
from robacc.geometry import Array, log_so3, rms_length, rotate_back
from robacc.measurements import Measurements, different
from robacc.modelling.model import Noise, NoiseSource
from robacc.poses.motion import numbered
from robacc.robots.description import LENGTH_PARAMETERS, Robot
from robacc.statistics.distributions import chi2_sf, f_sf

# Measurement noise: known from the file, from repeats, or only from the residual itself.

_LEAST_REPEATS = 10
"""Degrees of freedom that an estimate of the noise from repeats needs at least."""
_NEGLIGIBLE = 0.1
"""Ratio of misfit to noise below which the noise is the file's."""


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Test of a residual against noise that is known independently of the model."""

    noise: Noise
    p_value: float | None
    """None if noise is known from the residual alone."""
    ratio: float
    """Root mean square of the residual over that of the noise."""
    axes: float = 3.0
    """Coordinates of a position that a row shows, on average."""

    @property
    def rms(self) -> float:
        """Root mean square length of the noise of a row's position, m."""
        return math.sqrt(self.axes) * self.noise.position


def lack_of_fit(fit: Fit, data: Measurements) -> LackOfFit:
    """Compare the residual of the inliers with the measurement noise."""
    residual, axes = fit.residual[:3, fit.inliers], 3.0 if data.shown is None else float(data.shown.sum(axis=0).mean())
    dof = fit.degrees_of_freedom * (0.5 if fit.residual.shape[0] == 6 else 1.0)
    squares, stated = float(np.sum(np.square(residual))), data.sigma_position
    rms = math.sqrt(squares / max(dof, 1.0))
    if fit.scatter is not None and fit.scatter.any():
        # Noise and scatter were estimated together from this residual, so it cannot be more than both.
        white = fit.whitening.apply(fit.residual * fit.inliers)[:3]
        noise = replace(fit.noise, source=_source_beside_scatter(fit, data))
        return LackOfFit(noise, None, float(np.sqrt(np.sum(np.square(white)) / max(dof, 1.0))), axes)
    variance, repeat_dof = _pure_error(fit, data)
    if variance > 0.0:
        remaining_dof = max(dof - repeat_dof, 1.0)
        between = max(squares - variance * repeat_dof, 0.0) / remaining_dof
        noise = Noise(math.sqrt(variance), fit.noise.orientation, "repeats")
        return LackOfFit(noise, f_sf(between / variance, remaining_dof, repeat_dof), rms / noise.position, axes)
    if stated is None:
        return LackOfFit(fit.noise, None, 1.0, axes)
    known = np.square(stated[:, fit.inliers])
    orientation = None
    if data.sigma_rotation is not None and data.rotation is not None:
        orientation = float(np.sqrt(np.mean(np.square(data.sigma_rotation[fit.inliers]))))
    p_value = chi2_sf(float(np.sum(np.square(residual) / known)), max(dof, 1.0))
    noise = Noise.of_variances(np.mean(known, axis=1), orientation, "file")
    return LackOfFit(noise, p_value, rms / float(np.sqrt(np.mean(known))), axes)


def _source_beside_scatter(fit: Fit, data: Measurements) -> NoiseSource:
    """Return where the noise comes from that was estimated together with the scatter of the joints."""
    if data.sigma_position is not None:
        return "file" if fit.misfit[0] <= _NEGLIGIBLE * fit.noise.position else "file and misfit"
    visits, poses = visit_numbers(data)[fit.inliers], data.groups()[fit.inliers]
    return "repeats" if different(visits) > different(poses) else "residual"


def _pure_error(fit: Fit, data: Measurements) -> tuple[float, float]:
    """Return the variance along an axis (m²) within repeats of a commanded pose, and its degrees of freedom.

    The variance is 0 if there are too few repeats.
    """
    rows = data.first_measured(fit.inliers)
    named = [column[rows] for column in (data.target, data.fixture) if column is not None]
    groups = numbered(data.groups()[rows], *named)
    counts, shown = np.bincount(groups), np.full(groups.size, 3.0) if data.shown is None else data.shown[:, rows].sum(0)
    dof = float(np.sum(shown * (1.0 - 1.0 / counts[groups])))
    if dof < _LEAST_REPEATS or data.seen is not None:  # Images of a pose show several points of the board.
        return 0.0, dof
    residual = fit.residual[:3, rows]
    means: Array = np.array([np.bincount(groups, weights=axis) / np.maximum(counts, 1) for axis in residual])
    return float(np.sum(np.square(residual - means[:, groups]))) / dof, dof


_MAX_NAMES = 10
"""Names or rows that a warning lists; the others are counted."""
_FAR = 0.05
"""Share of the spread of the poses above which a residual without fitted frames comes from the frames."""
_GROSS = 0.01
"""Share of the spread of the poses above which a residual with fitted frames comes from a mistake in the data."""
_LARGE_CONDITION = 1e3
"""Condition number of the scaled columns from which on a warning is given."""
_FEW_NAMES = 3
"""Coefficients that a warning of a large condition number names."""
_MILLI = {"m": "mm", "rad": "mrad"}


def outliers_warning(fit: Fit, data: Measurements) -> tuple[str, ...]:
    """Return a warning that lists the outliers; empty if there are none."""
    if not fit.outliers.size:
        return ()
    lines = ", ".join(str(data.line(int(i))) for i in fit.outliers[:_MAX_NAMES])
    pattern = outlier_pattern(data, ~fit.inliers, fit.model.arm.names)
    several, more = "s" * (fit.outliers.size > 1), " …" * (fit.outliers.size > _MAX_NAMES)
    counted = f"{fit.outliers.size} row{several}, on {data.counted}{several} {lines}{more}"
    return (f"outliers left out of the fit: {counted}", *filter(None, (pattern,)))


def frames_warning(declared: Fit, data: Measurements) -> tuple[str, ...]:
    """Return a warning with the probable cause if the residual is too large for an arm; else empty."""
    absent = [name for name in ALIGNABLE if name not in {effect.name for effect in declared.model.free}]
    spread = float(np.sum(np.var(data.position[:, declared.inliers], axis=1)))
    if (
        data.kind is not None
        or rms_length(declared.residual[:3, declared.inliers]) ** 2 <= (_FAR if absent else _GROSS) ** 2 * spread
    ):
        return ()
    cause = "units, joint signs, exchanged columns or an instrument that was moved"
    if absent:
        cause = "frames that do not agree"
    advice = f"; declare {','.join(absent)}" * bool(absent)
    return (f"errors this large come from {cause} rather than from the arm{advice}",)


def condition_warning(fit: Fit) -> tuple[str, ...]:
    """Return a warning that names the coefficients known least if the condition number is large; else empty."""
    condition = fit.identifiability.condition
    if condition <= _LARGE_CONDITION:
        return ()
    stds = np.sqrt(np.diag(fit.covariance))
    known_least = [i for i in np.argsort(-np.nan_to_num(stds))[:_FEW_NAMES] if fit.terms[i].unit in _MILLI]
    listed = ", ".join(f"{fit.names[i]} (± {1e3 * stds[i]:.2g} {_MILLI[fit.terms[i].unit]})" for i in known_least)
    return (
        f"condition number {condition:.3g}: some coefficients are weakly identifiable on these poses, most of all "
        f"{listed or 'combinations of them'}; measure more poses, with more varied joint angles and orientations",
    )


def weak_parameters_warning(fit: Fit) -> tuple[str, ...]:
    """Return a warning that lists the weakly identifiable constants; empty if there are none."""
    kinds = weak_kinds(fit)
    names = sorted(name for kind in kinds for name in kind.names)
    if not names:
        return ()
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    stds = " and ".join(dict.fromkeys(f"{1e3 * kind.std:.3g} {_MILLI[kind.unit]}" for kind in kinds))
    return (
        f"weakly identifiable on these poses: {', '.join(names[:_MAX_NAMES])}{more}; a prior about the nominal values "
        f"limits them (standard deviation {stds}, that of a badly made arm); measure poses with more different "
        "orientations",
    )


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


def moved_frames(fit: Fit, holdout: Measurements) -> str | None:
    """Return what moved between the poses of a fit and the validation poses, and how far; None if the frames agree."""
    if holdout.n < _FEWEST:
        return None
    predicted = fit.predict(holdout)
    residual = holdout.position - predicted.translation
    of_fit, error = rms_length(fit.residual[:3, fit.inliers]), rms_length(residual)
    if error < 2.0 * _ALIKE * of_fit:
        return None
    rotation, translation = np.moveaxis(predicted.rotation, 2, 0)[None], predicted.translation.T[None]
    causes = ("base", ""), ("base and target", ", or the target was mounted again")
    for targets, (what, cause) in enumerate(causes):
        found = register_positions(rotation, translation, holdout.position.T[None], np.ones((targets, holdout.n)))
        vectors, turn = found.vectors[0].T, found.rotation[0]
        gain = float(np.median(np.linalg.norm(residual, axis=0))) / max(float(found.median[0]), 1e-300)
        if gain >= _LEAST_GAIN and rms_length(vectors) <= _ALIKE * of_fit:
            # The residual in the measuring frame is R^T times that in the base.
            shift = (residual - rotate_back(turn, vectors)).mean(axis=1)
            return (
                f"the validation poses lie {1e3 * np.linalg.norm(shift):.3g} mm and "
                f"{np.degrees(np.linalg.norm(log_so3(turn))):.4g}° from where the model has them: the instrument or "
                f"the robot base moved between the files{cause}; with {what} registered on them, their error is "
                f"{1e3 * rms_length(vectors):.3g} mm rms in place of {1e3 * error:.3g} mm; transform both files into "
                "one frame (common reference points), or leave out `holdout`, write the model, and use estimate with "
                '`align="base_frame,tool_frame"` on the validation poses'
            )
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
_ORIENTATION = 3.0
"""Remaining orientation error that no instrument leaves, degrees."""
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
    error = math.degrees(float(np.median(np.linalg.norm(fit.residual[3:, fit.inliers], axis=0))))
    if error > _ORIENTATION:
        texts.append(
            f"suspected data mistake: a median orientation error of {error:.3g} degrees remains; "
            "check the convention of the orientation columns (order of a quaternion, angles, unit)"
        )
    return tuple(texts)


def reach(robot: Robot) -> float:
    """Return the sum of the lengths of the arm's links, base and tool excluded, m."""
    links = [[joint.parameters.get(name, 0.0) for name in LENGTH_PARAMETERS] for joint in robot.joints]
    return max(sum(math.hypot(*lengths) for lengths in links), 1e-3)
