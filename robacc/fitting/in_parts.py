"""Coefficients of a fit to some poses of a large file, fitted to all of them by the normal equations of its parts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError
from robacc.fitting.fit_result import Fit
from robacc.fitting.levels import NEGLIGIBLE, ROUNDS
from robacc.fitting.normal_equations import posterior
from robacc.fitting.outliers import inlier_limit, row_weights
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model, residuals
from robacc.robots.arm import BLOCK
from robacc.threads import single_threaded
from robacc.workers import Workers

_GROUPS = 1024
"""Groups of commands: a standard error from them has a relative standard error of 1 / sqrt(2 * 1024), two per cent."""


class FitPart(NamedTuple):
    """Part of the poses, and the point at which their equations are linearised."""

    read: Callable[[], Measurements]
    model: Model
    names: tuple[str, ...]
    """Names of all coefficients, which the poses of every part must have."""
    theta: Array
    columns: NDArray[np.int64]
    """Numbers of the sought coefficients."""
    misfit: tuple[float, float]
    limit: float
    """Mean whitened square above which a row is an outlier."""


class FitSums(NamedTuple):
    """Sums over the inliers of parts."""

    n: int
    gram: Array
    """``(K, K)``"""
    of_groups: Array
    """``(G, K)`` gradient of each group of commands."""

    def plus(self, other: FitSums) -> FitSums:
        """Return the sums over the poses of both."""
        return FitSums(self.n + other.n, self.gram + other.gram, self.of_groups + other.of_groups)


def _whitened(data: Measurements, residual: Array, misfit: tuple[float, float]) -> tuple[Array, Array]:
    """Return the weights ``(M, N)`` of rows, and the mean whitened squares ``(N,)``."""
    weight = row_weights(data, misfit)
    return weight, np.asarray(np.square(residual * weight).mean(axis=0))


@single_threaded
def sums_of_part(part: FitPart) -> FitSums:
    """Return the sums over the poses of a part.

    Raises:
        InputError: A row is wrong, or has what the fit does not know, such as another target.
    """
    data, size = part.read(), part.columns.size
    result = FitSums(0, np.zeros((size, size)), np.zeros((_GROUPS, size)))
    groups = (data.hashed_commands() % np.uint64(_GROUPS)).astype(np.int64)
    for start in range(0, data.n, BLOCK):
        rows = slice(start, start + BLOCK)
        some = data.subset(rows)
        bound = part.model.bind(some)
        if tuple(term.name for term in bound.terms) != part.names:
            raise InputError(f"{data.source}: {data.place(start)} and below have targets or loads that others lack")
        poses, jacobian = bound.linearise(part.theta, part.columns, 3 if some.rotation is None else 6)
        residual = residuals(some, poses)
        weight, square = _whitened(some, residual, part.misfit)
        weight = weight * (square <= part.limit)
        white = jacobian * weight[:, None]
        slopes = np.einsum("mkn,mn->kn", white, residual * weight)
        gram = sum(component @ component.T for component in white)
        own = np.stack([np.bincount(groups[rows], slope, _GROUPS).astype(float) for slope in slopes], axis=1)
        result = result.plus(FitSums(int(np.count_nonzero(weight[0])), gram, own))
    return result


def fitted_in_parts(
    reads: Sequence[Callable[[], Measurements]],
    workers: Workers,
    progress: Callable[[str, int, int], None],
    fit: Fit,
) -> Fit:
    """Return a fit to some poses with coefficients fitted to all, by Gauss-Newton steps with weights as they are.

    Standard errors come from the gradients of groups of commands, whatever the errors of a group have in common
    (K.-Y. Liang, S. L. Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73, 1986). What
    the fit allows for beyond independent noise, such as an error that depends on the pose, more rows do not average
    out: it is added. Residuals, and the equations by which poses are held out, are those of the poses of the fit.

    Args:
        reads: Functions that read the parts, in their order.
        workers: What does the work.
        progress: Called with a label of the work, the number of parts done, and the number of all parts.
        fit: The fit to some of the poses.

    Raises:
        InputError: A row is wrong; with every problem of its part.
        UsageError: The workers cannot be reached.
    """
    columns, theta, precision = fit.identifiability.columns, fit.theta.copy(), fit.precision
    _, square = _whitened(fit.data, fit.residual, fit.misfit)
    limit = float(inlier_limit(square, np.array(len(fit.residual)), fit.data.n * len(reads)))
    start = FitPart(reads[0], fit.model, fit.names, theta, columns, fit.misfit, limit)
    covariance, own = fit.covariance.copy(), np.ix_(columns, columns)
    independent = posterior(fit.gram, precision) * (fit.chi_square / max(fit.degrees_of_freedom, 1.0))
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance[own] - independent))
    shared = (vectors * np.maximum(values, 0.0)) @ vectors.T
    for _ in range(ROUNDS):
        total: FitSums | None = None
        tasks = [start._replace(read=read, theta=theta.copy()) for read in reads]
        for number, one in enumerate(workers.in_order(sums_of_part, tasks)):
            total = one if total is None else total.plus(one)
            progress("fitting all rows", number + 1, len(reads))
        assert total is not None
        inverse = posterior(total.gram, precision)
        step = inverse @ (total.of_groups.sum(axis=0) - precision * theta[columns])
        theta[columns] += step
        count = int(np.count_nonzero(total.of_groups.any(axis=1)))
        if count > columns.size:
            spread = total.of_groups.T @ total.of_groups * (count / (count - columns.size))
            covariance[own] = inverse @ (spread + np.diag(precision)) @ inverse + shared
        std = np.sqrt(np.diag(covariance)[columns])
        if np.all(np.abs(step) <= NEGLIGIBLE * std):
            break
    moved = residuals(fit.data, fit.model.bind(fit.data).poses(theta))
    rhs = (fit.gram + np.diag(precision)) @ theta[columns]
    return dataclasses.replace(fit, theta=theta, covariance=covariance, residual=moved, rhs=rhs)
