"""Errors of held-out poses in closed form: each place in turn is predicted by the fit to all other places.

With A_g the whitened Jacobian of the rows g, N = A'A + P (P the precision of the priors) and r_g the whitened residual
of the fit to all rows, the coefficients without these rows differ, to first order, by

    -(N - A_g'A_g)^-1 A_g'r_g = -N^-1 A_g'(I - H_gg)^-1 r_g,    H_gg = A_g N^-1 A_g'.

Source: R. D. Cook, S. Weisberg, Residuals and Influence in Regression (1982), 2.2 and appendix A.2. Weights, outliers
and the variances of priors are those of the fit to all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.errors import RobaccError
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import blocks_of, whole_groups
from robacc.fitting.visits import places
from robacc.geometry import Array, Poses, compose, exp_so3
from robacc.measurements import Measurements, different
from robacc.modelling.observation import observed_jacobian, residuals

LEAST_GROUPS = 6
"""Places that held-out errors need at least."""
_ALONE = 1.0 - 1e-6
"""Leverage of a place, of any combination of its components, above which the others do not determine it."""
_LARGE = 0.1
"""Leverage of a place up to which the normal matrix of the fit's last step, exact to 1e-6, is enough."""
_MOST_NUMBERS = 2**21
"""Numbers of a Jacobian that are held at a time; of more, blocks of an eighth stay in the cache."""

Undetermined = Callable[[NDArray[np.int64]], None]
"""Called with the rows of a group without which the others do not determine a coefficient."""


@dataclass(frozen=True)
class HoldOut:
    """Poses that fits to ``data`` are judged on: validation poses, or places of its own poses in turn."""

    data: Measurements
    validation: Measurements | None
    groups: NDArray[np.int64]
    """``(N,)`` number of the places that are held out together."""

    @classmethod
    def of(cls, data: Measurements, validation: Measurements | None, count: int | None, seed: int) -> HoldOut:
        """Hold out ``validation``, or each place of ``data`` in turn, or ``count`` parts of the places.

        A place's part depends on the place and the seed, not on the order of rows.
        """
        groups = places(data)
        total = int(groups.max(initial=-1)) + 1
        if count is not None and total:
            groups = (np.random.default_rng(seed).permutation(total) % min(count, total)).astype(np.int64)[groups]
        return cls(data, validation, groups)

    @cached_property
    def folds(self) -> int:
        """Number of groups that are held out in turn; 0 with validation poses, or where places are too few."""
        if self.validation is not None or different(places(self.data)) < LEAST_GROUPS:
            return 0
        return different(self.groups)

    def residuals(self, fit: Fit, lacking: Sequence[Collection[int]] = ((),)) -> list[Array | None]:
        """Return ``(M, N)`` residuals of the held-out poses by ``fit``, and by models that lack some of its effects.

        None where nothing can be held out, or the arm without the effects cannot be evaluated.

        Args:
            fit: Fit to ``data``.
            lacking: Numbers of the absent effects of each model, among the free ones; the rest is fitted again.
        """
        if self.validation is not None:
            poses = [_poses(fit, self.validation, _without(fit, absent)) for absent in lacking]
            return [None if one is None else residuals(self.validation, one) for one in poses]
        if not self.folds:
            return [None for _ in lacking]
        return [
            None if one is None else residuals(self.data, one)
            for one in held_out_poses(fit, self.data, self.groups, lacking, components=fit.residual.shape[0])
        ]


def _without(fit: Fit, absent: Collection[int]) -> Array:
    """Return ``(P,)`` the coefficients of a fit without some effects, the rest fitted again."""
    return fit.without(set(absent)) if absent else fit.theta


def _positions(fit: Fit) -> Poses:
    """Return the positions that a fit predicts of its own poses, without orientations."""
    return Poses(np.empty((3, 3, 0)), fit.data.position - fit.residual[:3])


def _poses(fit: Fit, data: Measurements, theta: Array) -> Poses | None:
    """Return the poses that a fit predicts with other coefficients; None if the arm has no equilibrium with them."""
    try:
        return fit.predict(data, theta)
    except RobaccError:
        return None


def held_out_poses(
    fit: Fit,
    data: Measurements,
    groups: NDArray[np.int64],
    lacking: Sequence[Collection[int]] = ((),),
    undetermined: Undetermined = lambda rows: None,
    components: int = 6,
    exact: bool = False,
) -> list[Poses | None]:
    """Predict each row ``(N)`` with the coefficients of the fit to the rows of the other groups, to first order.

    A combination of coefficients that the other groups do not determine keeps its nominal value.

    Args:
        fit: Fit to ``data``.
        data: Poses of the fit.
        groups: ``(N,)`` number of each row's group.
        lacking: Numbers of the absent effects of each model, among the free ones.
        undetermined: Called with the rows of a group that alone determines a coefficient.
        components: 6 for poses, 3 for positions alone.
        exact: Form the normal matrix again at the solution; of many rows it is that of the fit's last step, which is
            enough unless a group determines a coefficient nearly alone.

    Returns:
        The poses by each model; None where the arm without its absent effects has no equilibrium.
    """
    columns = fit.identifiability.columns
    size = columns.size
    most = _MOST_NUMBERS // (fit.residual.shape[0] * max(size, 1))
    blocks = list(whole_groups(groups, max(data.n if data.n <= most else most // 8, 1)))
    kept = [np.array([fit.owners[i] not in absent for i in columns], dtype=bool) for absent in lacking]
    thetas = [_without(fit, absent) for absent in lacking]
    poses = [
        (fit.poses if components == 6 else _positions(fit)) if t is fit.theta else _poses(fit, data, t) for t in thetas
    ]
    if not size:
        return poses

    def linearised(rows: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the Jacobian of the poses ``(3 or 6, K, n)``, and the whitened one of the inliers ``(K, M, n)``."""
        _, jacobian = fit.model.bind(data.subset(rows)).linearise(fit.theta, columns, components)
        observed = observed_jacobian(jacobian, fit.residual[:, rows]).swapaxes(0, 1)
        return jacobian, fit.whitening.subset(rows).apply(observed) * fit.inliers[rows]

    exact = exact or len(blocks) == 1
    normal, latest = np.diag(fit.precision) + (0.0 if exact else fit.gram), None
    for rows in blocks if exact else ():
        latest = linearised(rows)
        flat = latest[1].reshape(size, -1)
        normal = normal + flat @ flat.T
    scale = 1.0 / np.sqrt(np.diag(normal))
    root = np.linalg.inv(np.linalg.cholesky(scale[:, None] * normal * scale)) * scale
    models = [
        None if start is None or not mask.any() else _Reduced.of(fit, data, start, theta, mask, root)
        for start, theta, mask in zip(poses, thetas, kept, strict=True)
    ]
    for rows in blocks:
        jacobian, whitened = latest if len(blocks) == 1 and latest is not None else linearised(rows)
        ahead, scaled = root @ jacobian, (root @ whitened.reshape(size, -1)).reshape(whitened.shape)
        share = np.bincount(groups[rows] - groups[rows].min(), np.einsum("kmn,kmn->n", scaled, scaled))
        if not exact and share.max() > _LARGE:
            return held_out_poses(fit, data, groups, lacking, undetermined, components, exact=True)
        scaled = np.ascontiguousarray(scaled.transpose(2, 1, 0))
        for model in filter(None, models):
            for inside in model.move(fit, rows, ahead, scaled, groups[rows]):
                undetermined(rows[inside])
    return [
        start if model is None else Poses(model.rotation, model.position)
        for start, model in zip(poses, models, strict=True)
    ]


@dataclass(frozen=True)
class _Reduced:
    """A fit that may lack some effects, in scaled coefficients, for which the normal matrix of the whole fit is I.

    Without effects, the scaled coefficients are orthogonal to a few directions.
    """

    absent: Array
    """``(K, A)`` orthonormal directions of the absent effects."""
    whole: Array
    """``(K,)`` its scaled coefficients."""
    residual: Array
    """``(M, N)``"""
    position: Array
    rotation: Array
    """Predicted poses; rows are held out in place."""

    @classmethod
    def of(
        cls, fit: Fit, data: Measurements, poses: Poses, theta: Array, kept: NDArray[np.bool_], root: Array
    ) -> _Reduced:
        """Reduce a fit to the coefficients ``kept`` ``(K,)`` of ``theta`` ``(P,)``; ``root`` ``(K, K)`` scales them."""
        absent = np.linalg.qr(root[:, ~kept])[0]
        whole: Array = np.asarray(np.linalg.solve(root.T, np.where(kept, theta[fit.identifiability.columns], 0.0)))
        error = fit.residual if kept.all() else residuals(data, poses)
        return cls(absent, whole, error, poses.translation, poses.rotation)

    def move(
        self, fit: Fit, rows: NDArray[np.int64], ahead: Array, scaled: Array, groups: NDArray[np.int64]
    ) -> list[NDArray[np.int64]]:
        """Hold out ``rows``; return the places among them of groups that alone determine a coefficient.

        ``ahead`` ``(3 or 6, K, n)`` is the Jacobian of their poses, ``scaled`` ``(n, M, K)`` the whitened one.
        """
        if self.absent.size:
            scaled = scaled - (scaled @ self.absent) @ self.absent.T
        white = (fit.whitening.subset(rows).apply(self.residual[:, rows]) * fit.inliers[rows]).T
        change, alone = np.empty((rows.size, len(self.whole))), []
        for inside in blocks_of(groups):
            change[inside], high = _changes(scaled, white, inside, self.whole)
            alone += [inside[group] for group in high]
        moved = np.einsum("ikn,nk->in", ahead, change)
        self.position[:, rows] += moved[:3]
        if len(moved) == 6:
            self.rotation[..., rows] = compose(exp_so3(moved[3:]), self.rotation[..., rows])
        return alone


def _changes(scaled: Array, white: Array, inside: NDArray[np.int64], whole: Array) -> tuple[Array, list[int]]:
    """Return the change of the scaled coefficients without each group, and the groups that alone determine one.

    Args:
        scaled: ``(n, M, K)`` whitened Jacobian, in coefficients whose normal matrix is I.
        white: ``(n, M)`` whitened residuals.
        inside: ``(G, m)`` rows of each group.
        whole: ``(K,)`` scaled coefficients of the fit to all rows.

    Returns:
        ``(G, 1, K)`` changes, and numbers of groups.
    """
    count, size = inside.shape[0], scaled.shape[2]
    jacobian, residual = scaled[inside].reshape(count, -1, size), white[inside].reshape(count, -1)
    is_short = jacobian.shape[1] < size
    left, right = jacobian, jacobian.swapaxes(1, 2)
    leverage = left @ right if is_short else right @ left
    high = np.flatnonzero(np.trace(leverage, axis1=1, axis2=2) > _ALONE)
    high = high[np.linalg.eigvalsh(leverage[high])[:, -1] > _ALONE] if high.size else high
    leverage[high] = 0.0
    remaining = np.eye(leverage.shape[1]) - leverage
    if is_short:
        change = -(right @ np.linalg.solve(remaining, residual[..., None]))[..., 0]
    else:
        change = -np.linalg.solve(remaining, right @ residual[..., None])[..., 0]
    for group in high.tolist():
        share, vectors = np.linalg.eigh(right[group] @ left[group])
        along = vectors.T @ (right[group] @ residual[group])
        alone = share > _ALONE
        change[group] = -vectors @ np.where(alone, vectors.T @ whole, along / np.where(alone, 1.0, 1.0 - share))
    return change[:, None], high.tolist()
