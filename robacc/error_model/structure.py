"""What remains beside a fit: scatter, errors that depend on the pose, wander and noise, and what they do to the fit.

The terms of the covariance V are chosen by evidence beside the fit's columns. Rows are weighted by noise, and by
scatter where repeated visits or several targets separate the two. The coefficients then have the covariance

    (X'W X + P)^-1 (X'W V W X + P) (X'W X + P)^-1,

W the weights and P the precision of the priors.
"""

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.periodic import PoseCorrection
from robacc.error_model.covariance import (
    MOST_COMPONENTS,
    TERMS,
    CovarianceParameters,
    ErrorPart,
    Linearised,
    Rows,
    estimated,
    left_by_fit,
    likelihood_derivatives,
    log_evidence,
    on_subset,
    usual_std,
    whitened,
    with_terms_that_gain,
)
from robacc.fitting.fit_result import Fit, Options, with_covariance
from robacc.fitting.levels import ACCEPTED, RESOLUTION, SAMPLE
from robacc.fitting.normal_equations import posterior
from robacc.fitting.outliers import noise_of
from robacc.fitting.visits import first_ranks, pose_ranks, visit_numbers
from robacc.geometry import Array, NDArray, rms_length
from robacc.measurements import Measurements, different

Source = Literal["repeated visits", "several targets", "residual"]


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Intrinsic repeatability of an arm, apart from the measurement noise."""

    joints: tuple[tuple[str, float | None], ...]
    """Standard deviation of each joint's scatter, rad or m; None where it is not identifiable."""
    position: float
    """Root mean square of the scatter's length at the target, m."""
    source: Source
    """Source that separates it from the noise; with ``residual``, an effect outside the catalogue looks the same."""
    pose_position: float
    """Root mean square of the error at the target that depends on the pose and that no effect explains, m."""


@dataclass(frozen=True, slots=True)
class DirectionalNoise:
    """Noise of different size along three axes."""

    axes: Array
    """``(3, 3)`` axes in the measuring frame, in rows."""
    std: Array
    """``(3,)`` standard deviations along them, m."""

    @property
    def beyond_least(self) -> Array:
        """Return the covariance ``(3, 3)`` in the measuring frame beyond equal noise of the least size, m²."""
        excess = np.square(self.std) - np.square(self.std.min())
        return np.asarray(self.axes.T @ (excess[:, None] * self.axes))

    @property
    def text(self) -> str:
        """Return the direction that differs from the two others, and by how much."""
        small, middle, large = np.sort(self.std)
        is_smaller = middle / small > large / middle
        k = int(np.argmin(self.std) if is_smaller else np.argmax(self.std))
        across = float(np.sqrt(np.mean(np.square(np.delete(self.std, k)))))
        axis = self.axes[k] * np.sign(self.axes[k][np.argmax(np.abs(self.axes[k]))])
        direction = f"the direction ({', '.join(f'{value:.2f}' for value in axis + 0.0)}) of the measuring frame"
        return "the error that remains is " + (
            f"{across / self.std[k]:.2g} times as large across {direction} as along it"
            if is_smaller
            else f"{self.std[k] / across:.2g} times as large along {direction} as across it"
        )


@dataclass(frozen=True)
class ErrorStructure:
    """A fit that allows for the structure of its errors, and that structure."""

    fit: Fit
    options: Options
    """Options of the fit, with the scatter of the joints."""
    parts: Mapping[ErrorPart, float]
    """Root mean square of each part of the remaining error at the target, m."""
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not there."""
    directional: DirectionalNoise | None
    """Noise that is much larger along one direction than along others; None if it is not."""
    warnings: tuple[str, ...]


def with_error_structure(
    fitted: Fit,
    data: Measurements,
    options: Options,
    refitted: Callable[[Options], Fit],
    names: Collection[str] = tuple(TERMS),
) -> ErrorStructure:
    """Return the fit with weights and standard errors that allow for the structure of its errors.

    ``refitted`` fits again with given options. The terms ``names`` are tried, unless an effect of the fit stands for
    them.
    """
    linear, rows = beside(fitted, data)
    log_std = np.log(np.maximum(fitted.misfit[: linear.y.shape[1] // 3], RESOLUTION))
    start = estimated(CovarianceParameters(log_std, np.ones(rows.size)), linear)
    present = {effect.form.covariance_term for effect in fitted.model.free}
    noise = with_terms_that_gain(start, linear, [name for name in names if name not in present])
    noise = estimated(noise, linear)
    if data.position_variance is not None:
        alone = dataclasses.replace(
            noise, log_std=np.where(np.arange(noise.log_std.size) == 0, math.log(RESOLUTION), noise.log_std)
        )
        if log_evidence(alone, linear) >= log_evidence(noise, linear) - 0.5 * math.log(rows.size):
            noise = alone  # The noise is what the file states.
    directional = _directional(start, noise, linear) if data.position_variance is None and data.kind is None else None
    noise = noise if directional is None else start
    visits = different(visit_numbers(data))
    source: Source = "residual"
    if visits > different(data.groups()):
        source = "repeated visits"
    elif visits < data.n:
        source = "several targets"
    is_weighted = "scatter" in noise.terms and source != "residual"
    misfit = (float(noise.std[0]), float(np.append(noise.std, 0.0)[1]))
    if is_weighted:
        # Other terms are an error of each row, too: beside them, the misfit is what remains of the residual.
        is_weighted = not any(TERMS[name].is_correlated for name in noise.terms)
        weights = estimated(noise, linear, off_zero="scatter")
        options = dataclasses.replace(
            options, scatter=np.exp(weights.terms["scatter"]), misfit=misfit if is_weighted else options.misfit
        )
        fitted = refitted(options)
        linear, rows = beside(fitted, data)
        noise = dataclasses.replace(noise, factor=np.ones(rows.size))
    if "scatter" in noise.terms:
        fitted = dataclasses.replace(fitted, noise=noise_of(data, misfit, False))
    # The fit has weights of its own misfit, which the terms share.
    left = left_by_fit(
        CovarianceParameters(
            np.log(np.maximum(fitted.misfit[: log_std.size], RESOLUTION)),
            noise.factor,
            {name: noise.terms[name] for name in noise.terms if name == "scatter" and source != "residual"},
        ),
        linear,
    )
    sizes = {name: TERMS[name].size(values, linear, left) for name, values in noise.terms.items()}
    # Of a variance that few visits show, the estimate may be larger than their error.
    share = min(1.0, rms_length(fitted.residual[:3, rows]) / max(math.hypot(*sizes.values()), RESOLUTION))
    independent = np.sum(np.square(noise.independent(linear.rows.stated) * linear.rows.shown)[:, :3], axis=1)
    parts: dict[ErrorPart, float] = {"noise": float(np.sqrt(np.median(independent)))}
    for name, size in sizes.items():
        parts[TERMS[name].part] = math.hypot(share * size, parts.get(TERMS[name].part, 0.0))
    # Poses that are visited again are a part of the design: standard errors that leave out what they may share are too
    # small where it is there (random effects of a design stay in the model; Barr et al. 2013).
    starts = [] if "place" in noise.terms else TERMS["place"].starts(linear, usual_std(noise, linear))
    with_places = estimated(noise.with_term("place", starts[0]), linear) if starts else noise
    return ErrorStructure(
        _with_covariance(fitted, with_places, linear, rows, data.groups()[rows], is_weighted),
        options,
        parts,
        _repeatability(fitted, noise, linear, parts, source) if "scatter" in parts else None,
        directional,
        tuple(TERMS[name].warning(share * sizes[name]) for name in noise.terms if TERMS[name].is_correlated),
    )


def beside(fitted: Fit, data: Measurements, most_visits: int | None = None) -> tuple[Linearised, NDArray[np.int64]]:
    """Return a fit linearised at inliers of random poses, and the numbers of these rows: one of each visit, or all."""
    inliers = np.flatnonzero(data.first_measured(fitted.inliers))
    if most_visits is not None:
        inliers = inliers[np.unique(visit_numbers(data)[inliers], return_index=True)[1]]
    draw = pose_ranks(data)[inliers]
    first = first_ranks(draw, most_visits or max(2 * MOST_COMPONENTS // fitted.residual.shape[0], 1))
    rows = inliers[first]
    part, columns = data.subset(rows), fitted.identifiability.columns
    bound = fitted.model.bind(part)
    variance = np.diag(posterior(fitted.gram, fitted.precision))
    # A thousand standard errors are in effect no prior.
    least = np.square(fitted.theta[columns] / 1e3)  # Without noise, standard errors are smaller than rounding.
    prior = np.where(fitted.precision > 0.0, fitted.precision, 1.0 / (1e3**2 * np.maximum(variance + least, 1e-300)))
    whole = Linearised.at(bound, fitted.theta, np.ones(len(bound.terms)), Rows.of(bound.arm, part, draw[first]), part)
    linear = dataclasses.replace(whole, columns=whole.columns[:, :, columns], prior_std=1.0 / np.sqrt(prior))
    return linear, rows


def _with_covariance(
    fitted: Fit,
    noise: CovarianceParameters,
    linear: Linearised,
    rows: NDArray[np.int64],
    poses: NDArray[np.int64],
    is_weighted: bool,
) -> Fit:
    """Return the fit with the covariance of its coefficients under all terms.

    ``linear`` is the fit at ``rows``, those of random poses, whose numbers are ``poses``. Pairs of rows count as often
    as all rows have them (Horvitz and Thompson 1952). ``is_weighted`` says that scatter and noise alone are the fit's
    weights.
    """
    terms = [name for name in noise.terms if TERMS[name].is_correlated or not is_weighted]
    if not terms or not len(linear.prior_std):
        return fitted
    share = np.count_nonzero(fitted.inliers) / rows.size
    pairs = np.where(poses[:, None] == poses, share, share**2)
    white = fitted.whitening.subset(rows)
    columns = np.moveaxis(linear.columns, 0, -1).swapaxes(0, 1)
    by_column = np.moveaxis(white.apply_transposed(white.apply(columns)), -1, 0)  # (n, K, M)
    variance = np.square(noise.independent(linear.rows.stated))
    meat = (
        fitted.gram.copy()
        if is_weighted
        else share * np.einsum("nkm,nlm->kl", by_column * variance[:, None], by_column, optimize=True)
        + share * np.einsum("nka,nab,nlb->kl", by_column, linear.rows.between, by_column, optimize=True)
    )
    shared = np.zeros_like(meat)
    for name in terms:
        term = TERMS[name]
        for number, kernel in enumerate(term.kernels(noise.terms[name], linear.rows)):
            carried = (
                np.einsum("nkm,mn->nk", by_column, linear.joints[number]) if term.of_joints else by_column[..., number]
            )
            shared += carried.T @ ((pairs * kernel) @ carried)
    # It is a covariance, but its estimate by a part of the rows may have negative eigenvalues.
    scale = np.sqrt(np.diag(fitted.gram) + fitted.precision)
    values, vectors = np.linalg.eigh(shared / scale / scale[:, None])
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    inverse = posterior(fitted.gram, fitted.precision)
    return with_covariance(fitted, inverse @ (meat + root @ root.T + np.diag(fitted.precision)) @ inverse)


def _repeatability(
    fitted: Fit,
    noise: CovarianceParameters,
    linear: Linearised,
    parts: Mapping[ErrorPart, float],
    source: Source,
) -> Repeatability:
    """Return the scatter of the joints, each where its standard deviation is two standard errors from zero."""
    stds = np.exp(noise.terms["scatter"])
    part_noise, part = on_subset(noise, linear)
    ordered = {"scatter": part_noise.terms["scatter"], **part_noise.terms}
    information = likelihood_derivatives(dataclasses.replace(part_noise, terms=ordered), part)[2]
    # A standard deviation at its bound has only the information of the prior of its logarithm, which has a standard
    # deviation of 2.
    variance = np.diag(np.linalg.inv(information + 0.25 * np.eye(len(information))))[len(noise.log_std) :]
    relative = np.sqrt(variance[: stds.size] * len(part.y) / np.count_nonzero(fitted.inliers))
    joints = zip(fitted.model.arm.names, stds.tolist(), relative <= 0.5, strict=True)
    return Repeatability(
        tuple((name, std if is_resolved else None) for name, std, is_resolved in joints),
        float(np.linalg.norm(TERMS["scatter"].at_target(noise.terms["scatter"], linear))),
        source,
        parts.get("pose", 0.0),
    )


def _directional(
    start: CovarianceParameters, noise: CovarianceParameters, linear: Linearised
) -> DirectionalNoise | None:
    """Return noise of its own size along three axes, if it is more likely than the chosen terms beside equal noise.

    The axes are those of the measuring frame, or those of the residual's covariance where they are more likely. A ratio
    of the standard deviations below 2 costs the coefficients less than a fifth of their accuracy.
    """
    white = whitened(start, linear)
    left = linear.y - linear.columns @ (white.coefficients * linear.prior_std)
    squares, vectors = np.linalg.eigh(left[:, :3].T @ left[:, :3])
    if squares[2] <= 2.0 * max(squares[0], 1e-300):
        return None
    best, most = None, log_evidence(noise, linear) + ACCEPTED
    for axes, cost in ((np.eye(3), 0.0), (vectors.T, 1.5 * math.log(len(linear.y)))):
        log_std = np.concatenate((np.repeat(start.log_std[:1], 3), start.log_std[1:]))
        along = linear.turned(axes)
        estimate = estimated(CovarianceParameters(log_std, start.factor), along)
        if (total := log_evidence(estimate, along) - cost) > most:
            best, most = DirectionalNoise(axes, estimate.std[:3]), total
    return best if best is not None and best.std.max() >= 2.0 * best.std.min() else None


# What a fit lacks of the position, as one process over the joints along the axes of the measuring frame. The time of
# its estimate grows with the cube of the visits.


def correction_of_position(
    fitted: Fit, data: Measurements, noise: CovarianceParameters
) -> tuple[Effect, float, float] | None:
    """Return the correction of the position by a process over the joints, with its evidence and what that costs.

    None if the evidence is not worth its cost: half the log of the visits for the variance and each length, and the
    odds of acceptance. Visits of a place may share a further error, and errors wander if the search found that
    (``noise``).
    """
    linear, index = beside(fitted, data, SAMPLE)
    linear = linear.of_position
    rows, arm = linear.rows, fitted.model.arm
    moving = np.flatnonzero(rows.moves)
    if not moving.size or data.kind is not None:
        return None
    std = math.log(max(0.7 * float(np.sqrt(np.mean(np.square(fitted.residual[:3, index])))), RESOLUTION))
    alone = CovarianceParameters(np.array([std]), np.ones(index.size))
    if np.unique(rows.place).size < index.size:
        alone = alone.with_term("place", np.array([std]))
    if (wander := noise.terms.get("wander")) is not None:
        alone = alone.with_term("wander", np.array([std, wander[-1]]))
    start = np.append(std, np.zeros(rows.moves.size))
    with_field = estimated(alone.with_term("field", start), linear, on_all=True)
    alone = estimated(alone, linear, on_all=True)
    evidence = whitened(with_field, linear).log_likelihood - whitened(alone, linear).log_likelihood
    cost = 0.5 * math.log(index.size) * TERMS["field"].variances(start, linear, with_field.std)
    if evidence - cost <= ACCEPTED:
        return None
    std, lengths = with_field.terms["field"][0], np.exp(with_field.terms["field"][1:]) / rows.scale
    joints = [arm.names[j] for j in moving]
    ratio = math.exp(2.0 * (with_field.log_std[0] - std))
    correction = PoseCorrection.over(arm, data.subset(index), joints, lengths[moving].tolist(), "position", ratio)
    return correction, evidence, cost
