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
from robacc.fitting.levels import BLOCK_NUMBERS, NEW
from robacc.fitting.normal_equations import blocks_of
from robacc.fitting.visits import LEAST_PLACES, places
from robacc.geometry import Array, Poses, compose, exp_so3
from robacc.measurements import Measurements, different
from robacc.modelling.model import observed_jacobian, residuals


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
        if self.validation is not None or different(places(self.data)) < LEAST_PLACES:
            return 0
        return different(self.groups)

    def residuals(self, fit: Fit, lacking: Sequence[Collection[int]] = ((),)) -> list[Array | None]:
        """Return ``(M, N)`` residuals of the held-out poses by ``fit``, and by models that lack some of its effects.

        None where nothing can be held out, or the arm without the effects cannot be evaluated.

        Args:
            fit: Fit to ``data``.
            lacking: Numbers of the absent effects of each model, among the free ones; the rest is fitted again.
        """
        poses: list[Poses | None] = [None for _ in lacking]
        if self.validation is not None:
            poses = [_poses(fit, self.validation, fit.without(absent)) for absent in lacking]
        elif self.folds:
            poses = held_out_poses(fit, self.data, self.groups, lacking, components=fit.residual.shape[0])
        data = self.data if self.validation is None else self.validation
        return [None if predicted is None else residuals(data, predicted) for predicted in poses]


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
    undetermined: Callable[[NDArray[np.int64]], None] = lambda rows: None,
    components: int = 6,
) -> list[Poses | None]:
    """Predict each row ``(N)`` with the coefficients of the fit to the rows of the other groups, to first order.

    A combination of coefficients that the other groups do not determine keeps its nominal value. A model without
    effects is the fit in scaled coefficients, of normal matrix I, that are orthogonal to a few directions.

    Args:
        fit: Fit to ``data``.
        data: Poses of the fit.
        groups: ``(N,)`` number of each row's group.
        lacking: Numbers of the absent effects of each model, among the free ones.
        undetermined: Called with the rows of a group that alone determines a coefficient.
        components: 6 for poses, 3 for positions alone.

    Returns:
        The poses by each model; None where the arm without its absent effects has no equilibrium.
    """
    columns = fit.identifiability.columns
    size, rows_of = columns.size, fit.residual.shape[0]
    if components == 6:
        poses = [fit.poses if not absent else _poses(fit, data, fit.without(absent)) for absent in lacking]
    else:
        own = Poses(np.empty((3, 3, 0)), data.position - fit.residual[:3])
        poses = [own if not absent else _poses(fit, data, fit.without(absent)) for absent in lacking]
    if not size:
        return poses
    most = 4 * BLOCK_NUMBERS // (rows_of * size)
    blocks = _whole_groups(groups, max(data.n if data.n <= most else most // 32, 1))

    def linearised(rows: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the Jacobian of the poses ``(3 or 6, K, n)``, and the whitened one of the inliers ``(K, M n)``."""
        jacobian = fit.jacobian(rows, components)
        observed = observed_jacobian(jacobian, fit.residual[:, rows]).swapaxes(0, 1)
        return jacobian, (fit.whitening.subset(rows).apply(observed) * fit.inliers[rows]).reshape(size, -1)

    # The fit's own normal matrix is that of the step before the last.
    normal, latest = np.diag(fit.precision), None
    for rows in blocks:
        latest = linearised(rows)
        normal = normal + latest[1] @ latest[1].T
    scale = 1.0 / np.sqrt(np.diag(normal))
    lower = np.linalg.cholesky(scale[:, None] * normal * scale)
    root = np.linalg.inv(lower) * scale
    models = []
    for absent, start in zip(lacking, poses, strict=True):
        kept = np.array([fit.owners[i] not in absent for i in columns], dtype=bool)
        if start is None or not kept.any():
            continue
        whole = lower.T @ np.where(kept, fit.without(absent)[columns] / scale, 0.0)
        models.append(
            (start, np.linalg.qr(root[:, ~kept])[0], whole, residuals(data, start) if absent else fit.residual)
        )
    for rows in blocks:
        jacobian, white = latest if len(blocks) == 1 and latest is not None else linearised(rows)
        scaled = np.ascontiguousarray((root @ white).reshape(size, -1, rows.size).transpose(2, 1, 0))
        of_block, inside_groups = fit.whitening.subset(rows), blocks_of(groups[rows])
        for predicted, directions, whole, error in models:
            part = scaled - (scaled @ directions) @ directions.T if directions.size else scaled
            left = (of_block.apply(error[:, rows]) * fit.inliers[rows]).T
            change = np.empty((rows.size, size))
            for inside in inside_groups:
                change[inside], alone = _changes(part[inside], left[inside], whole)
                for group in alone:
                    undetermined(rows[inside[group]])
            moved = np.einsum("ikn,kn->in", jacobian, root.T @ change.T)
            predicted.translation[:, rows] += moved[:3]
            if components == 6:
                predicted.rotation[..., rows] = compose(exp_so3(moved[3:]), predicted.rotation[..., rows])
    return poses


def _whole_groups(numbers: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """Return the rows in blocks of about ``size`` rows that leave rows with equal numbers together.

    Numbers come in the order of their first rows, so that a block's rows lie close together.
    """
    first = np.empty(int(numbers.max(initial=-1)) + 1, dtype=np.int64)
    first[numbers[::-1]] = np.arange(numbers.size)[::-1]
    order = np.argsort(first[numbers], kind="stable")
    last = np.flatnonzero(np.diff(numbers[order], append=-1)) + 1
    ends = np.minimum(np.arange(size, numbers.size + size, size), numbers.size)
    return np.split(order, np.unique(last[np.searchsorted(last, ends)])[:-1])


def _changes(columns: Array, white: Array, whole: Array) -> tuple[Array, list[int]]:
    """Return the change of the scaled coefficients without each group, and the groups that alone determine one.

    Args:
        columns: ``(G, m, M, K)`` whitened Jacobian of the m rows of each group, in coefficients whose normal matrix is
            I.
        white: ``(G, m, M)`` whitened residuals.
        whole: ``(K,)`` scaled coefficients of the fit to all rows.

    Returns:
        ``(G, 1, K)`` changes, and numbers of groups.
    """
    jacobian, residual = columns.reshape(len(columns), -1, whole.size), white.reshape(len(white), -1, 1)
    across = jacobian.swapaxes(1, 2)
    # Right singular vectors, or those times the singular values, by the smaller of the two products.
    if jacobian.shape[1] < whole.size:
        share, vectors = np.linalg.eigh(jacobian @ across)
        basis, along = across @ vectors, vectors.swapaxes(1, 2) @ residual
    else:
        share, basis = np.linalg.eigh(across @ jacobian)
        along = basis.swapaxes(1, 2) @ (across @ residual)
    alone = (1.0 - share < NEW)[:, :, None]
    left = along / np.where(alone, 1.0, 1.0 - share[:, :, None])
    change = -basis @ np.where(alone, basis.swapaxes(1, 2) @ whole[:, None], left)
    return change.swapaxes(1, 2), np.flatnonzero(alone.any(axis=1)).tolist()
