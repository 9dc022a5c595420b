"""Errors that poses with similar joint angles share, because the model lacks an effect.

An effect that the model lacks is not noise: where a joint is at a similar angle, the error is similar. Poses are then
fewer independent observations than they appear, and coefficients are known less well than their covariance says. The
visits are divided into blocks by the position of one joint, for each joint in turn. With the whitened columns X_b and
errors e_b of block b, s_b = X_b^T e_b, H = (X^T X + P)^-1, P the precision of priors, and M the inverse of the part of
H that belongs to coefficients without a common prior,

    kappa = sum_b |H s_b|_M^2 / sum_b E |H s_b|_M^2,   E s_b s_b^T = G_b - G_b H G_b,   G_b = X_b^T X_b,

is 1 for independent errors, whatever the model (blocks as in K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986) 13-22).
Where it is significant, the likelihood counts 1 / kappa as much for the largest kappa of a joint (the magnitude
adjustment of M. Ribatet, D. Cooley, A. C. Davison, Statistica Sinica 22 (2012) 813-845): the fit is repeated with a
covariance R of the errors that is larger by

    (kappa - 1) (1 - a) R + (kappa - 1) a (mean variance of R) 1,   a = 1/4.

Noise and scatter of the joints explain the size of the errors, but not where they come from. The second part keeps
directions in which they leave hardly any variance from deciding the fit. Errors that belong to several joints add: the
variances of the coefficients are those for 1 + sum (kappa_j - 1) over the joints (clusters in several ways: A. C.
Cameron, J. B. Gelbach, D. L. Miller, J. Bus. Econ. Stat. 29 (2011) 238-249).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.coefficient_covariance import with_factors
from robacc.fitting.fit_result import AddedVariance, Fit, Options
from robacc.fitting.linear_algebra import inverted, posterior
from robacc.fitting.solver import fit
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitened_rows import whitened_rows
from robacc.geometry import Array
from robacc.measurements import Measurements

_BLOCKS = 12
"""Most blocks of visits."""
_OF_BLOCK = 5
"""Fewest visits of a block on average."""
_FEWEST = 20
"""Visits from which errors can be said to be shared."""
_SIGNIFICANT = 4.0
"""Standard deviations by which kappa must exceed 1. Of 480 simulated sets of independent errors 3 exceeded it by more,
the largest 4.5; models of a measured arm exceed it by 12 to 60."""
_EVIDENT = 8.0
"""Standard deviations from which a warning is given. Errors that are independent, but unequal, reached 6.8."""
_STANDS_STILL = 1e-3
"""Range of a joint, rad or m, below which it divides no poses."""
_MOST_VISITS = 3000
"""Visits from which kappa is estimated; with more, it is larger in proportion."""
_UNSTRUCTURED = 0.25
"""Share a of the added variance that is independent of the joints. Models of 16 parts of a measured arm had 0.92 to
0.95 times the error elsewhere with 0 to 1. With 0, the worst of them gained least (0.97 to 0.63 mm, with 0.25 to
0.37 mm); with 1, others lost most (1.23 times, with 0.25 1.13 times)."""


@dataclass(frozen=True, slots=True)
class SharedErrors:
    """Errors that poses share where a joint is at a similar position."""

    joint: str
    ratio: float
    """Variance of the coefficients over that for independent errors: kappa."""
    excess: float
    """Standard deviations by which the ratio exceeds 1."""


@dataclass(frozen=True, slots=True)
class FitBesideSharedErrors:
    """Fit that allows for errors which poses share."""

    fit: Fit
    added: AddedVariance
    joints: tuple[SharedErrors, ...]
    """Joints whose errors are significant, the largest ratio first."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return a sentence for readers of the result where the errors are evident; else empty."""
        evident = [errors.joint for errors in self.joints if errors.excess > _EVIDENT]
        if not evident:
            return ()
        where = ", ".join(evident) + (" is at a similar position" if len(evident) == 1 else " are at similar positions")
        larger = f"{np.sqrt(_total(self.joints)):.2g} times"
        return (
            f"the remaining errors are similar where {where}, so an effect remains that the model lacks; standard "
            f"errors of coefficients (about {larger} as large) and p-values of findings allow for it",
        )


def with_shared_errors(fitted: Fit, data: Measurements, priors: Array | None = None) -> FitBesideSharedErrors | None:
    """Return the fit that allows for errors which poses share.

    None if they are not significant, or the fit does not converge. Scatter, noise, inliers and the given ``priors``
    ``(P,)`` stay as they are.
    """
    joints = shared_errors(fitted, data)
    if not joints:
        return None
    added = _added_variance(fitted, joints[0].ratio)
    options = Options(
        robust=False,
        priors=priors,
        misfit=fitted.misfit,
        start=fitted.theta,
        inliers=fitted.inliers,
        group_stds=fitted.group_stds,
        prior_stds=fitted.prior_stds,
        scatter=fitted.scatter,
        added=added,
    )
    refit = dataclasses.replace(fit(fitted.model, data, options), noise=fitted.noise)
    if not refit.converged:
        return None
    factor = np.where(_without_common_prior(refit), np.sqrt(_total(joints) / joints[0].ratio), 1.0)
    return FitBesideSharedErrors(with_factors(refit, factor), added, joints)


def shared_errors(fitted: Fit, data: Measurements) -> tuple[SharedErrors, ...]:
    """Return the joints at similar positions of which errors are significantly similar, the largest ratio first."""
    significant = [errors for errors in all_ratios(fitted, data) if errors.excess > _SIGNIFICANT]
    return tuple(sorted(significant, key=lambda errors: -errors.ratio))


def _total(joints: Sequence[SharedErrors]) -> float:
    """Return the variance of the coefficients over that for independent errors, by the errors of all joints."""
    return 1.0 + sum(errors.ratio - 1.0 for errors in joints)


def _without_common_prior(fitted: Fit) -> NDArray[np.bool_]:
    """Return ``(K,)`` which identifiable coefficients have no common prior."""
    return np.array([fitted.terms[i].group is None for i in fitted.identifiability.columns], dtype=bool)


def _added_variance(fitted: Fit, ratio: float) -> AddedVariance:
    variance = np.square(1.0 / fitted.weight[:, fitted.inliers]).reshape(-1, 3, np.count_nonzero(fitted.inliers))
    further = np.sqrt((ratio - 1.0) * _UNSTRUCTURED * variance.mean(axis=(1, 2)))
    orientation = float(further[1]) if further.size > 1 else 0.0
    return AddedVariance(1.0 + (ratio - 1.0) * (1.0 - _UNSTRUCTURED), float(further[0]), orientation)


def all_ratios(fitted: Fit, data: Measurements) -> list[SharedErrors]:
    """Return the ratio of each joint that moves; empty with too few visits."""
    own = _without_common_prior(fitted)
    rows, visits, thinning = _thinned(fitted, data)
    if data.q is None or not own.any() or np.unique(visits).size < _FEWEST:
        return []
    design, error = whitened_rows(fitted, data, rows)
    inverse = posterior(fitted.gram / thinning, fitted.precision / thinning)
    scale = 1.0 / np.sqrt(np.diag(inverse)[own])
    metric = inverted(inverse[np.ix_(own, own)] * scale[:, None] * scale) * scale[:, None] * scale
    moved = np.einsum("mkn,ks->msn", design, inverse[:, own], optimize=True)
    result = []
    for name, q in zip(fitted.model.arm.names, data.q[:, rows], strict=True):
        if np.ptp(q) < _STANDS_STILL:
            continue
        observed = expected = variance = 0.0
        for block in _blocks(q, visits):
            x, y = design[:, :, block], moved[:, :, block]
            score = np.einsum("msn,mn->s", y, error[:, block])
            cross = np.einsum("mkn,msn->ks", x, y, optimize=True)
            product = metric @ (np.einsum("msn,mtn->st", y, y, optimize=True) - cross.T @ inverse @ cross)
            observed += float(score @ metric @ score)
            expected += float(np.trace(product))
            variance += 2.0 * float(np.sum(product * product.T))
        if expected > 0.0:
            ratio = 1.0 + thinning * (observed / expected - 1.0)
            result.append(SharedErrors(name, ratio, (observed - expected) / float(np.sqrt(variance))))
    return result


def _thinned(fitted: Fit, data: Measurements) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """Return rows ``(n,)`` of at most :data:`_MOST_VISITS` visits, their visits, and all inliers over these rows.

    Visits are numbered by their joint variables, then by the sums of their positions, so that the order of the rows
    does not matter.
    """
    inliers = np.flatnonzero(data.first_measured(fitted.inliers))
    _, first, number = np.unique(visit_numbers(data)[inliers], return_index=True, return_inverse=True)
    sums = [np.bincount(number, weights=axis) for axis in data.position[:, inliers]]
    rank = np.empty(first.size, dtype=np.int64)
    rank[np.lexsort((*sums, *(() if data.q is None else data.q[:, inliers[first]])))] = np.arange(first.size)
    visits = rank[number]
    kept = visits % -(-first.size // _MOST_VISITS or 1) == 0
    return inliers[kept], visits[kept], inliers.size / max(float(np.count_nonzero(kept)), 1.0)


def _blocks(q: Array, visits: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield the rows of each block: visits divided evenly by the position of the joint, then by their number."""
    _, first, number = np.unique(visits, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(q[first], kind="stable"), kind="stable")
    count = min(_BLOCKS, first.size // _OF_BLOCK)
    block = (rank * count // first.size)[number]
    for i in range(count):
        yield np.flatnonzero(block == i)
