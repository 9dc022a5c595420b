"""Coefficients of a fit to some poses of a large file, fitted to all of them by the normal equations of its parts."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial, reduce
from operator import add

import numpy as np

from robacc.errors import InputError
from robacc.fitting.fit_result import Fit
from robacc.fitting.levels import NEGLIGIBLE, ROUNDS
from robacc.fitting.normal_equations import Whitening, posterior, whitening
from robacc.fitting.outliers import inlier_limit, row_weights
from robacc.geometry import Array, NDArray
from robacc.measurements import Measurements
from robacc.modelling.model import Model, residuals
from robacc.robots.arm import BLOCK
from robacc.workers import Workers, single_threaded

_GROUPS = 1024
"""Groups of commands: a standard error from them has a relative standard error of 1 / sqrt(2 * 1024), two per cent."""


def _whitened(data: Measurements, residual: Array, misfit: tuple[float, float]) -> tuple[Whitening, Array]:
    """Return the whitening of rows, and the mean whitened squares ``(N,)``."""
    white = whitening(row_weights(data, misfit), noise=data.correlated_noise)
    return white, np.asarray(np.square(white.apply(residual)).mean(axis=0))


@single_threaded
def sums_of_part(
    read: Callable[[], Measurements],
    model: Model,
    names: tuple[str, ...],
    theta: Array,
    columns: NDArray[np.int64],
    misfit: tuple[float, float],
    limit: float,
) -> Array:
    """Return the Gram matrix ``(K, K)`` of the poses of a part, above the gradients ``(G, K)`` of groups of commands.

    Args:
        read: Function that reads the part.
        model: Model of the fit.
        names: Names of all coefficients, which the poses of every part must have.
        theta: Coefficients at which the equations are linearised.
        columns: Numbers of the sought coefficients.
        misfit: Misfit of positions and orientations, for the weights of rows.
        limit: Mean whitened square above which a row is an outlier and does not count.

    Raises:
        InputError: A row is wrong, or has what the fit does not know, such as another target.
    """
    data = read()
    result = np.zeros((columns.size + _GROUPS, columns.size))
    groups = (data.hashed_commands() % np.uint64(_GROUPS)).astype(np.int64)
    for start in range(0, data.n, BLOCK):
        rows = slice(start, start + BLOCK)
        some = data.subset(rows)
        bound = model.bind(some)
        if tuple(term.name for term in bound.terms) != names:
            raise InputError(f"{data.source}: {data.place(start)} and below have targets or loads that others lack")
        poses, jacobian = bound.linearise(theta, columns, 3 if some.rotation is None else 6)
        residual = residuals(some, poses)
        map_of_rows, square = _whitened(some, residual, misfit)
        rows_of = map_of_rows.rows(jacobian, residual) * (square <= limit)
        white = rows_of[:, :-1]
        slopes = np.einsum("mkn,mn->kn", white, rows_of[:, -1])
        gram = sum(component @ component.T for component in white)
        of_groups = np.stack([np.bincount(groups[rows], slope, _GROUPS).astype(float) for slope in slopes], axis=1)
        result += np.vstack((gram, of_groups))
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
    covariance, own = fit.covariance.copy(), np.ix_(columns, columns)
    independent = posterior(fit.gram, precision) * (fit.chi_square / max(fit.degrees_of_freedom, 1.0))
    values, vectors = np.linalg.eigh(np.nan_to_num(covariance[own] - independent))
    shared = (vectors * np.maximum(values, 0.0)) @ vectors.T
    for _ in range(ROUNDS):
        work = partial(
            sums_of_part,
            model=fit.model,
            names=fit.names,
            theta=theta,
            columns=columns,
            misfit=fit.misfit,
            limit=limit,
        )
        total: Array = reduce(add, workers.in_order(work, reads, partial(progress, "fitting all rows")))
        gram, of_groups = np.split(total, [columns.size])
        inverse = posterior(gram, precision)
        step = inverse @ (of_groups.sum(axis=0) - precision * theta[columns])
        theta[columns] += step
        count = int(np.count_nonzero(of_groups.any(axis=1)))
        if count > columns.size:
            spread = of_groups.T @ of_groups * (count / (count - columns.size))
            covariance[own] = inverse @ (spread + np.diag(precision)) @ inverse + shared
        if np.all(np.abs(step) <= NEGLIGIBLE * np.sqrt(np.diag(covariance)[columns])):
            break
    moved = residuals(fit.data, fit.model.bind(fit.data).poses(theta))
    rhs = (fit.gram + np.diag(precision)) @ theta[columns]
    return dataclasses.replace(fit, theta=theta, covariance=covariance, residual=moved, rhs=rhs)
