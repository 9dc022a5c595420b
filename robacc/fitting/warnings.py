"""Warnings that every fit can give: its noise, its poses and coefficients, and mistakes that its figures suggest."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from robacc.errors import LISTED, Note, listing
from robacc.fitting.closed_form import register_positions
from robacc.fitting.fit_result import Fit
from robacc.fitting.levels import ALIKE, ENOUGH, EXAMPLES, GROSS, NEGLIGIBLE, SIGNIFICANT
from robacc.fitting.masses import DEFAULT
from robacc.fitting.normal_equations import posterior
from robacc.fitting.outliers import outlier_pattern
from robacc.fitting.priors import weak_kinds
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.visits import places_warning, visit_numbers
from robacc.geometry import Array, log_so3, rms_length, rotate_back
from robacc.measurements import FAR, Measurements, different, too_far
from robacc.modelling.model import Noise, residuals
from robacc.robots.description import LENGTH_PARAMETERS, Robot
from robacc.statistics.intervals import chi2_sf, f_sf

# Measurement noise: known from the file, from repeats, or only from the residual itself.


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


NO_LENGTH = (
    "no row measures a length, so the longest link keeps its nominal length and all others are relative to it: "
    "add rows of kind distance, such as between two sockets, or positions"
)


def lack_of_fit(fit: Fit, data: Measurements) -> LackOfFit:
    """Compare the residual of the inliers with the measurement noise."""
    residual, axes = fit.residual[:3, fit.inliers], 3.0 if data.shown is None else float(data.shown.sum(axis=0).mean())
    dof = fit.degrees_of_freedom * (0.5 if fit.residual.shape[0] == 6 else 1.0)
    squares, stated = float(np.sum(np.square(residual))), data.sigma_position
    rms = math.sqrt(squares / max(dof, 1.0))
    if fit.scatter is not None and fit.scatter.any():
        # Noise and scatter were estimated together from this residual, so it cannot be more than both.
        white = fit.whitening.apply(fit.residual * fit.inliers)[:3]
        visits, poses = visit_numbers(data)[fit.inliers], data.groups()[fit.inliers]
        beside = replace(fit.noise, source="repeats" if different(visits) > different(poses) else "residual")
        if stated is not None:
            is_stated = fit.misfit[0] <= NEGLIGIBLE * fit.noise.position
            beside = replace(fit.noise, source="file" if is_stated else "file and misfit")
        return LackOfFit(beside, None, float(np.sqrt(np.sum(np.square(white)) / max(dof, 1.0))), axes)
    variance, repeat_dof = _pure_error(fit, data)
    if variance > 0.0:
        remaining_dof = max(dof - repeat_dof, 1.0)
        between = max(squares - variance * repeat_dof, 0.0) / remaining_dof
        noise = Noise(math.sqrt(variance), fit.noise.orientation, "repeats")
        return LackOfFit(noise, f_sf(between / variance, remaining_dof, repeat_dof), rms / noise.position, axes)
    if stated is None:
        return LackOfFit(fit.noise, None, 1.0, axes)
    along, known = data.subset(fit.inliers).along_noise(residual)
    sigma = None if data.rotation is None else data.sigma_rotation
    orientation = None if sigma is None else float(np.sqrt(np.mean(np.square(sigma[fit.inliers]))))
    p_value = chi2_sf(float(np.sum(np.square(along) / known)), max(dof, 1.0))
    noise = Noise.of_variances(np.mean(np.square(stated[:, fit.inliers]), axis=1), orientation, "file")
    return LackOfFit(noise, p_value, rms / float(np.sqrt(np.mean(known))), axes)


def _pure_error(fit: Fit, data: Measurements) -> tuple[float, float]:
    """Return the variance along an axis (m²) within repeats of a commanded pose, and its degrees of freedom.

    The variance is 0 if there are too few repeats.
    """
    rows = data.first_measured(fit.inliers)
    groups = data.points(data.groups())[rows]
    counts, shown = np.bincount(groups), np.full(groups.size, 3.0) if data.shown is None else data.shown[:, rows].sum(0)
    dof = float(np.sum(shown * (1.0 - 1.0 / counts[groups])))
    if dof < ENOUGH or data.seen is not None:  # Images of a pose show several points of the board.
        return 0.0, dof
    residual = fit.residual[:3, rows]
    means: Array = np.array([np.bincount(groups, weights=axis) / np.maximum(counts, 1) for axis in residual])
    return float(np.sum(np.square(residual - means[:, groups]))) / dof, dof


_MILLI = {"m": "mm", "rad": "mrad"}


def fit_warnings(
    fit: Fit,
    data: Measurements,
    noise: LackOfFit,
    without_findings: Fit,
    rms: tuple[float, float | None],
    validation: Measurements | None = None,
) -> Iterator[str]:
    """Yield what limits the figures: convergence, poses, outliers, noise, weak coefficients, errors held out.

    Args:
        fit: A fit to ``data``.
        data: Its poses.
        noise: Test of its residual.
        without_findings: The fit that has no effect which nobody declared.
        rms: Position error of the fit's poses, and of held-out poses; None without these.
        validation: The held-out poses, if they are others.
    """
    if not fit.converged:
        yield (
            f"the fit did not converge in {fit.steps} steps, so its figures are provisional and no model is written; "
            "check the units, the frames and the joint signs, fit fewer effects, or measure more poses"
        )
    if not data.has_length:
        yield NO_LENGTH
    free = {effect.name for effect in fit.model.free}
    if data.is_of_images and "link_geometry" in free and "instrument_scale" not in free:
        yield Note(
            "the size of the printed board is the scale of all lengths: a print that is 0.1 % too large makes the arm "
            "0.1 % too small, which photos do not show; measure its ruler"
        )
    if fit.model.arm.robot.mass_uncertainty is None and any(effect.uses_masses for effect in fit.model.free):
        yield (
            f"standard errors of compliances include an uncertainty of {100 * DEFAULT:.0f} % of each link's mass; "
            "state mass_uncertainty in the robot file if the masses are better or worse known"
        )
    yield from data.warnings
    yield from data.contradicted_ids()
    yield from places_warning(data)
    if count := fit.outliers.size:
        places = [*dict.fromkeys(map(data.label, fit.outliers.tolist()))]
        several, listed = "s" * (count > 1), ", ".join(places[:LISTED]) + " …" * (len(places) > LISTED)
        yield f"outliers left out of the fit: {count} row{several}, on {data.counted}{'s' * (len(places) > 1)} {listed}"
        yield from filter(None, (outlier_pattern(data, ~fit.inliers, fit.model.arm.names),))
    yield from suspected_mistakes(fit)
    absent = [name for name in ALIGNABLE if name not in {effect.name for effect in without_findings.model.free}]
    error, position = rms_length(fit.residual[:3, fit.inliers]), data.position[:, fit.inliers]
    if data.kind is None and too_far(error, position, FAR if absent else GROSS):
        cause = "units, joint signs, exchanged columns or an instrument that was moved"
        advice = f"; declare {','.join(absent)}" * bool(absent)
        cause = "frames that do not agree" if absent else cause
        yield f"errors this large come more often from {cause} than from the arm{advice}"
    is_small = (noise.p_value or 0.0) > 1.0 - SIGNIFICANT and noise.ratio * ALIKE < 1.0
    if is_small and noise.noise.source == "file" and data.seen is None:
        yield (
            f"the residual is only {noise.ratio:.2g} times the measurement noise of the file's sigma columns, so the "
            "sigma columns are too large (wrong unit, or k = 2), and so are the standard errors"
        )
    kinds = weak_kinds(fit)
    if names := sorted(name for kind in kinds for name in kind.names):
        stds = " and ".join(dict.fromkeys(f"{1e3 * kind.std:.3g} {_MILLI[kind.unit]}" for kind in kinds))
        yield (
            f"weakly identifiable on these poses: {listing(names, LISTED)}; a prior about the nominal values "
            f"limits them (standard deviation {stds}, that of a badly made arm); measure poses with more different "
            "orientations"
        )
    n_coefficients = int(fit.identifiability.columns.size)
    surplus = int(np.count_nonzero(fit.inliers)) * fit.residual.shape[0] - n_coefficients
    if surplus < n_coefficients and not fit.group_stds:
        yield f"only {surplus} more measured values than fitted coefficients: measure more poses"
    if (condition := without_findings.identifiability.condition) > 1e3:
        terms, errors = without_findings.terms, np.sqrt(np.diag(without_findings.covariance))
        worst = [i for i in np.argsort(-np.nan_to_num(errors))[:EXAMPLES] if terms[i].unit in _MILLI]
        listed = ", ".join(f"{terms[i].name} (± {1e3 * errors[i]:.2g} {_MILLI[terms[i].unit]})" for i in worst)
        yield (
            f"condition number {condition:.3g}: some coefficients are weakly identifiable on these poses, most of all "
            f"{listed or 'combinations of them'}; measure more poses, with more varied joint angles and orientations"
        )
    fitted, held_out = rms
    if held_out is None:
        poses = "1 pose is" if data.n == 1 else f"{data.n} poses are"
        yield f"{poses} too few to hold any out: all errors are of calibration poses"
    elif validation is None and held_out > ALIKE * fitted:
        yield (
            "error on held-out poses is much larger than on calibration poses: fit fewer effects or measure more poses"
        )
    elif validation is not None and (moved := moved_frames(without_findings, validation)) is not None:
        yield moved
    elif validation is not None and held_out > _ALIKE * fitted:
        yield (
            f"the error of the validation poses is {held_out / max(fitted, 1e-300):.2g} times that of the calibration "
            "poses: the arm, its load, its zeros or the setup changed between the files, the poses are in another "
            "region, or the fit has too many effects for its poses"
        )


# Validation poses whose base or target does not stand where it stood for the calibration poses.
#
# An instrument that was set up anew, a base that was moved or a reflector that was mounted again moves all predicted
# positions by one rigid motion, or by one vector in the target's frame. Held-out errors are then those of the setup.

_ALIKE = 2.0
"""Ratio of the errors of validation and calibration poses up to which what remains is the arm's. Above it a warning is
given, and from twice as much the setup is suspected. Registration by chance gains 1.2 on ten poses."""


def moved_frames(fit: Fit, holdout: Measurements) -> str | None:
    """Return what moved between the poses of a fit and the validation poses, and how far; None if the frames agree."""
    if holdout.n < ENOUGH:
        return None
    predicted = fit.predict(holdout)
    residual = holdout.position - predicted.translation
    of_fit, error = rms_length(fit.residual[:3, fit.inliers]), rms_length(residual)
    if error < 2.0 * _ALIKE * of_fit:
        return None
    rotation, translation = np.moveaxis(predicted.rotation, 2, 0)[None], predicted.translation.T[None]
    causes = ("base", ""), ("base and target", ", or the target was mounted again")
    for targets, (what, cause) in enumerate(causes):
        registered = register_positions(rotation, translation, holdout.position.T[None], np.ones((targets, holdout.n)))
        vectors, turn = registered.vectors[0].T, registered.rotation[0]
        if rms_length(vectors) <= _ALIKE * of_fit:
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


# Corrections that no arm has, and a remaining error that no instrument has.

_LARGEST = {
    "link_geometry": math.radians(5.0),
    "joint_offset": math.radians(10.0),
    "gear_ratio": 0.05,
    "joint_coupling": 0.5,
}
"""Corrections of angles (rad) that no assembled arm needs, and of ratios: a gear's is known, and a coupling of one half
is an interaction."""
_TOO_LARGE = 0.05
"""The same of a length, as a share of the reach; and a remaining orientation error that no instrument leaves, rad."""


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
            limit = _TOO_LARGE * length if limit < np.inf else limit
            text = f"is corrected by {1e3 * value:.4g} mm ({100 * abs(value) / length:.0f} % of the reach)"
        # Three standard errors leave no doubt.
        if abs(value) - 3.0 * error > limit:
            corrections.append(f"{term.name} {text}")
    texts = []
    if corrections:
        more = "" if len(corrections) <= EXAMPLES else f", and {len(corrections) - EXAMPLES} more"
        texts.append(
            f"suspected data mistake: {', '.join(corrections[:EXAMPLES])}{more}; no assembled arm deviates this far; "
            "check the table's convention and lengths, the signs and zeros of the joints, interactions of joints, and "
            "whether a camera is on the hand or beside the arm"
        )
    error = float(np.median(np.linalg.norm(fit.residual[3:, fit.inliers], axis=0)))
    if error > _TOO_LARGE:
        texts.append(
            f"suspected data mistake: a median orientation error of {math.degrees(error):.3g} degrees remains; "
            "check the convention of the orientation columns (order of a quaternion, angles, unit)"
        )
    return tuple(texts)


def reach(robot: Robot) -> float:
    """Return the sum of the lengths of the arm's links, base and tool excluded, m."""
    links = [[joint.parameters.get(name, 0.0) for name in LENGTH_PARAMETERS] for joint in robot.joints]
    return max(sum(math.hypot(*lengths) for lengths in links), 1e-3)


# Size of the printed board and focal length of the lens, which the lengths of the arm contradict.

_LEAST_SCALE = 0.005
"""Share below which prints, lenses and arms differ from what is stated of them."""
_REST = 0.1
"""Share of the squares of the fitted lengths, at most, that is no common scale."""
_CERTAIN = 4.0
"""Standard deviations beyond which a share is not by chance."""


def image_scales(fit: Fit) -> tuple[str, ...]:
    """Return a warning if the images fit a board or a lens of another size than the files state.

    A larger board, or a longer lens, is one more coefficient of the fit, to first order. Where the lengths of the links
    are fitted too, an arm of another size explains a larger board: its links are then larger in proportion.
    """
    data, tiny = fit.data, 1e-6
    if data.seen is None:
        return ()
    seen, position = data.seen.copy(), data.position.copy()
    seen[:3] *= 1.0 + tiny
    position[:2] = np.where(seen[3] > 0.0, position[:2] * (1.0 - tiny), position[:2])
    larger = residuals(replace(data, seen=seen), fit.model.bind(replace(data, seen=seen)).poses(fit.theta))
    longer = residuals(replace(data, position=position), fit.poses)
    start = residuals(data, fit.poses)
    columns = np.stack([(larger - start) / tiny, (longer - start) / tiny], axis=1)
    count = fit.identifiability.columns.size
    columns = np.concatenate([fit.jacobian(np.arange(data.n), len(fit.residual)), columns], axis=1)
    white = fit.whitening.rows(columns, fit.residual) * fit.inliers
    gram = np.einsum("mkn,mln->kl", white, white)
    inverse = posterior(gram[:count, :count], fit.precision)
    # What the fitted coefficients leave of both columns and of the residual.
    left = gram[count:, count:] - gram[count:, :count] @ inverse @ gram[:count, count:]
    variances = 1.0 / np.maximum(np.diag(left)[:2], tiny)
    sizes, stds = -left[:2, 2] * variances, np.sqrt(variances)
    lengths = [
        place
        for place, column in enumerate(fit.identifiability.columns)
        if fit.names[column].startswith("link_geometry.") and fit.terms[column].unit == "m"
        if fit.precision[place] * inverse[place, place] < 0.5  # A length that a prior holds follows no scale.
    ]
    # Of fewer lengths, some common scale is always near.
    if len(lengths) > 3:
        # Lengths that grow by their share of one common scale hide the board's.
        moves = (inverse @ gram[:count, count])[lengths]
        own = fit.theta[fit.identifiability.columns[lengths]]
        scale = float(moves @ own) / max(float(moves @ moves), 1e-30)
        rest = float(np.sum(np.square(own - scale * moves))) / max(float(own @ own), 1e-30)
        if rest < _REST:
            sizes[0], stds[0] = -scale, abs(scale) * math.sqrt(rest / len(lengths))
    best = int(np.argmax(np.abs(sizes) / stds))
    size, std = float(sizes[best]), float(stds[best])
    if abs(size) < max(_LEAST_SCALE, _CERTAIN * std):
        return ()
    amount = f"{100.0 * abs(size):.2g} ± {200.0 * std:.1g} %"
    if best:
        return (
            f"the images fit focal lengths {amount} {'longer' if size > 0.0 else 'shorter'} than those of the camera "
            "file: check fx and fy, and the size of the photos that they are of",
        )
    return (
        f"the images fit a board {amount} {'larger' if size > 0.0 else 'smaller'} than the stated one: measure the "
        "print, and check the size of its squares",
    )
