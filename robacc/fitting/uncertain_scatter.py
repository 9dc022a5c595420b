"""Standard errors of coefficients that allow for the joints' scatter being estimated, not known.

Where visits of a commanded pose share an error, the poses are the independent observations, and few poses show its
variances v_j roughly, however often each is visited. With estimated variances in place of the true ones, weighted
least squares is a little worse than its covariance Phi = (X^T R^-1 X + prior)^-1 says, and its errors over the standard
errors follow Student's distribution, not the normal one. With W the covariance of the estimated v_j,

    W^-1 = tr(P V_i P V_j) / 2,   V_j = dR / dv_j = B_j B_j^T,   P = R^-1 - R^-1 X Phi X^T R^-1,

the variance of coefficient k grows by (M. G. Kenward, J. H. Roger, Biometrics 53 (1997) 983-997)

    2 sum_ij W_ij [Phi X^T R^-1 V_i P V_j R^-1 X Phi]_kk,

and its degrees of freedom are 2 Phi_kk^2 / (h^T W h), h_j = [Phi X^T R^-1 V_j R^-1 X Phi]_kk (F. E. Satterthwaite,
Biometrics Bull. 2 (1946) 110-114). A variance that is estimated to be zero is as uncertain as any: all joints count.
The standard error is stated so that the estimate ± 1.96 standard errors is the 95 % interval. The scatter from visit to
visit and the noise show in many more values than errors that visits share, and compared with these they count as known;
without these, visits are the groups, and their scatter counts.
"""

from __future__ import annotations

import math

import numpy as np

from robacc.fitting.coefficient_covariance import with_factors
from robacc.fitting.fit_repeatability import mixed_model
from robacc.fitting.fit_result import Fit
from robacc.fitting.restricted_likelihood import MixedModel, RestrictedLikelihood, RowGroups, Variances
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.statistics.distributions import normal_quantile, student_quantile

_TAIL = 0.975
_LARGEST_GROWTH = 2.0
"""Largest growth of a variance, as a share: the expansion in W is for small ones."""
_LEAST_DOF = 2.0
"""Least degrees of freedom of a standard error: of fewer, the poses determine no interval."""


def with_uncertain_scatter(fit: Fit, data: Measurements) -> Fit:
    """Return the fit with standard errors that allow for the estimated scatter; unchanged without scatter.

    Correlations of the coefficients stay as they are.
    """
    columns = fit.identifiability.columns
    if fit.scatter is None or fit.scatter.is_none or not columns.size:
        return fit
    estimated, model = mixed_model(fit, data)
    factor = np.ones(columns.size)
    factor[np.searchsorted(columns, estimated)] = interval_factors(model, Variances(fit.scatter, fit.misfit))
    return with_factors(fit, factor)


def interval_factors(model: MixedModel, variances: Variances) -> Array:
    """Return ``(K,)`` factors of the coefficients' standard errors for variances that ``model`` gave an estimate of."""
    at = RestrictedLikelihood.at(model, variances)
    groups = RowGroups.of(model.poses if variances.scatter.pose_std.any() else model.visits)
    joints = np.moveaxis(model.columns, 1, 0)
    white = at.white.apply(joints)
    # In the products of groups g: S = B_i^T R^-1 B_j, M = X^T R^-1 B_j, and Phi M.
    among = groups.sums(np.einsum("imn,jmn->ijn", white, white, optimize=True))
    with_model = groups.sums(np.einsum("jmn,mkn->jkn", joints, at.solved, optimize=True))
    moved = at.covariance @ with_model
    projected, change = moved @ np.swapaxes(with_model, 1, 2), moved @ np.swapaxes(moved, 1, 2)
    leverage = np.einsum("ikg,jkg->ijg", with_model, moved, optimize=True)
    information = 0.5 * np.sum(among * (among - 2.0 * leverage), axis=2)
    information += 0.5 * np.einsum("ikl,jlk->ij", projected, projected, optimize=True)
    variance_cov = _inverse(information)
    variance = np.diag(at.covariance)
    slopes = np.diagonal(change, axis1=1, axis2=2)
    spread = np.einsum("ik,ij,jk->k", slopes, variance_cov, slopes)
    growth = np.einsum("ij,ikg,ijg,jkg->k", variance_cov, moved, among, moved, optimize=True)
    growth -= np.einsum("ij,ikl,jlk->k", variance_cov, projected, change, optimize=True)
    share = np.clip(2.0 * growth / variance, 0.0, _LARGEST_GROWTH)
    dof = 2.0 * np.square(variance) / np.maximum(spread, 1e-300 + 1e-12 * np.square(variance))
    return np.asarray(np.sqrt(1.0 + share) * _widening(np.maximum(dof, _LEAST_DOF)), dtype=np.float64)


def _widening(dof: Array) -> Array:
    """Return Student's quantile at whole degrees of freedom over the normal one."""
    quantiles = [student_quantile(_TAIL, math.floor(value)) for value in dof.tolist()]
    return np.array(quantiles) / normal_quantile(_TAIL)


def _inverse(information: Array) -> Array:
    """Return the inverse, zero for variances that the rows do not show."""
    diagonal = np.diag(information)
    scale = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    inverse = np.linalg.pinv(information * scale[:, None] * scale, rcond=1e-10, hermitian=True)
    return np.asarray(inverse * scale[:, None] * scale, dtype=np.float64)
