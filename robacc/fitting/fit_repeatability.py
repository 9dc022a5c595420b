"""Repeatability of a fitted arm: variance components of a fit's residual, and options to fit again with them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.normal_equations import joint_columns
from robacc.fitting.places import places
from robacc.fitting.repeatability import MANY_COEFFICIENTS, MOST_ROWS, Components, estimate
from robacc.fitting.restricted_likelihood import MixedModel
from robacc.fitting.visits import visit_numbers
from robacc.measurements import Measurements

SIGNIFICANT = 12.0
"""Smallest gain of twice the restricted log-likelihood for which the joints' scatter is used. By chance, a given joint
gains as much in 1 of about 4,000 data sets, any of six joints in 1 of about 500 (chi-square mixture of 0 and 1)."""
_RESOLVED = 0.5
"""Largest relative standard error for which a joint's scatter is reported."""
_LARGEST = 0.05
"""Largest scatter (rad or m) that is reported as a joint's: 3 degrees or 50 mm. If it is larger, the joint hardly moves
the target, and its scatter stands for another error."""
_FEWEST = 20
"""Smallest number of visits for which scatter is estimated."""
_ROUNDS = 3
"""Largest number of estimates of the scatter."""
_KEPT_VISITS = 3
"""Visits of each commanded pose that are kept before poses are left out: they give half as many values for the errors
that visits share as for the scatter from visit to visit."""
_SAME = 0.1
"""Largest relative difference of two estimates that count as equal."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Intrinsic repeatability of an arm, apart from the measurement noise."""

    joints: tuple[tuple[str, float | None], ...]
    """Standard deviation of each joint's scatter, rad or m; None where it is not identifiable."""
    position: float
    """Root mean square of the scatter's length at the target, m."""
    source: Literal["repeated visits", "several targets", "residual"]
    """Source that separates it from the noise; with ``residual``, an effect outside the catalogue looks the same."""
    pose_position: float
    """Root mean square of the error that all visits of a commanded pose, or of poses that lie close together, share and
    no effect explains, m."""


def repeatability_of(fit: Fit, components: Components, data: Measurements) -> Repeatability:
    """Return the repeatability over the poses of ``data``, from ``components`` estimated at ``fit``."""
    arm = fit.model.arm
    rows = _thinned(data, np.flatnonzero(fit.inliers))
    columns = joint_columns(fit.model, data.subset(rows))
    lever = np.mean(np.sum(np.square(columns[:3]), axis=0), axis=1)
    stds = components.scatter.visit_std
    identifiable = (components.visit_std_error <= _RESOLVED * stds) & (stds <= _LARGEST)
    visits, poses = visit_numbers(data), data.groups()
    source: Literal["repeated visits", "several targets", "residual"] = "residual"
    if np.unique(visits).size > np.unique(poses).size:
        source = "repeated visits"
    elif np.unique(visits).size < data.n:
        source = "several targets"
    return Repeatability(
        tuple(
            (name, float(std) if reported else None)
            for name, std, reported in zip(arm.names, stds, identifiable, strict=True)
        ),
        float(np.sqrt(lever @ np.square(stds))),
        source,
        float(np.sqrt(lever @ np.square(components.scatter.pose_std))),
    )


def measured_alone(repeatability: Repeatability | None) -> Repeatability | None:
    """Return the repeatability that holds in spite of an error of the model: that of repeated visits, or None."""
    return repeatability if repeatability is not None and repeatability.source == "repeated visits" else None


def components_of(fit: Fit, data: Measurements) -> Components | None:
    """Estimate the joints' scatter and the noise from the residual of a fit; None if there are too few visits."""
    if data.q is None or np.unique(visit_numbers(data)[fit.inliers]).size < _FEWEST:
        return None
    return estimate(mixed_model(fit, data)[1], fit.scatter)


def mixed_model(fit: Fit, data: Measurements) -> tuple[NDArray[np.int64], MixedModel]:
    """Return the numbers of coefficients that are estimated with the scatter, and the residuals of a fit with them.

    Many rows are thinned.
    """
    columns, precision = fit.identifiability.columns, fit.precision
    if columns.size > MANY_COEFFICIENTS:
        # Profiles use few degrees of freedom, because their coefficients are shrunk; they stay as fitted.
        columns, precision = columns[precision == 0.0], precision[precision == 0.0]
    rows = _thinned(data, np.flatnonzero(data.first_measured(fit.inliers)))
    part = data.subset(rows)
    components = fit.residual.shape[0]
    _, jacobian = fit.model.bind(part).linearise(fit.theta, columns, components)
    return columns, MixedModel(
        residual=fit.residual[:, rows],
        design=jacobian,
        prior_precision=precision,
        columns=joint_columns(fit.model, part)[:components],
        known_var=known_variance(part, components),
        correlated_noise=part.correlated_noise,
        visits=visit_numbers(part),
        poses=places(part),
    )


def significant_components(fit: Fit, data: Measurements) -> Components | None:
    """Estimate as :func:`components_of`; None if the joints' scatter is not significant."""
    components = components_of(fit, data)
    return None if components is None or components.gain <= SIGNIFICANT else components


def settle_scatter(
    fitted: Fit, data: Measurements, options: Options, refit: Callable[[Options], Fit]
) -> tuple[Options, Components | None, Fit]:
    """Return options with the joints' scatter estimated with the fit, the scatter, and the fit with these options.

    ``refit`` fits again with given options: scatter and coefficients are estimated in turn until they agree. The
    scatter is None if it is not significant.
    """
    components = None
    for _ in range(_ROUNDS):
        estimated = significant_components(fitted, data)
        if estimated is None:
            return options, components, fitted
        components = estimated
        if is_same(options, components):
            return options, components, fitted
        options = with_scatter(options, components)
        fitted = refit(options)
    return options, components, fitted


def with_scatter(options: Options, components: Components) -> Options:
    """Return options that fit with the estimated scatter and noise."""
    return dataclasses.replace(options, scatter=components.scatter, misfit=components.noise)


def is_same(options: Options, components: Components) -> bool:
    """Return whether the estimate equals the scatter in ``options`` within the tolerance."""
    if options.scatter is None or options.misfit is None:
        return False
    old = np.concatenate((options.scatter.visit_std, options.scatter.pose_std, options.misfit[:1]))
    new = np.concatenate((components.scatter.visit_std, components.scatter.pose_std, components.noise[:1]))
    return bool(np.linalg.norm(new - old) <= _SAME * np.linalg.norm(old))


def _thinned(data: Measurements, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows, or about :data:`MOST_ROWS` of them: whole visits, of all commanded poses if they are few.

    Errors that visits of a pose share show in as many values as there are poses, however often each is visited. So
    visits of a pose are left out first, at random, down to :data:`_KEPT_VISITS`, and only then random poses.
    """
    if rows.size <= MOST_ROWS:
        return rows
    generator = np.random.default_rng(0)
    groups = data.groups()[rows]
    rank = generator.permutation(int(groups.max()) + 1)[groups]
    order = _visit_order(visit_numbers(data)[rows], groups, generator)
    sizes = np.bincount(order)
    enough = int(np.searchsorted(np.cumsum(sizes), MOST_ROWS, side="right"))
    rows, rank = (part[order < max(enough, _KEPT_VISITS)] for part in (rows, rank))
    if rows.size <= MOST_ROWS:
        return rows
    last = rank[np.argsort(rank, kind="stable")[MOST_ROWS - 1]]
    chosen: NDArray[np.int64] = rows[rank < last]
    return chosen if chosen.size else rows[rank <= last]


def _visit_order(
    visits: NDArray[np.int64], groups: NDArray[np.int64], generator: np.random.Generator
) -> NDArray[np.int64]:
    """Return ``(N,)`` the place of each row's visit in a random order of the visits of its commanded pose, from 0."""
    _, first, number = np.unique(visits, return_index=True, return_inverse=True)
    pose = groups[first]
    shuffled = generator.permutation(first.size)
    order = shuffled[np.argsort(pose[shuffled], kind="stable")]
    begins = np.flatnonzero(np.diff(pose[order], prepend=-1))
    place = np.empty(first.size, dtype=np.int64)
    place[order] = np.arange(first.size) - np.repeat(begins, np.diff(begins, append=first.size))
    result: NDArray[np.int64] = place[number]
    return result


def known_variance(data: Measurements, components: int) -> NDArray[np.float64]:
    """Return ``(components, N)`` variance of the known measurement uncertainty; zero where none is known.

    Correlated noise is not part of it.
    """
    variance = np.zeros((components, data.n))
    if data.position_variance is not None and data.correlated_noise is None:
        variance[:3] = data.position_variance
    if components == 6 and data.sigma_rotation is not None:
        variance[3:] = np.square(data.sigma_rotation)
    return variance
