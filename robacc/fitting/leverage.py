"""Leverage: the share of a row in its own prediction, and predictions without that share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BLOCK
from robacc.errors import InputError, Problem
from robacc.fitting.fit_result import Fit
from robacc.fitting.linear_algebra import posterior
from robacc.fitting.whitening import whole_groups
from robacc.geometry import Array, Poses, compose, exp_so3
from robacc.measurements import Measurements
from robacc.modelling.observation import observed_jacobian

_HIGH_LEVERAGE = 0.5
"""Share of a row in its own prediction above which the row is reported."""
_ALONE = 1.0 - 1e-6
"""Leverage of a commanded pose, of any combination of its components, above which the others do not determine it."""


def high_leverage(fit: Fit, data: Measurements) -> tuple[tuple[int, float], ...]:
    """Return the rows with high leverage: index and mean diagonal of the hat matrix over the components."""
    identifiable = fit.identifiability.columns
    if identifiable.size == 0:
        return ()
    inverse = posterior(fit.gram, fit.precision)
    share = np.empty(data.n)
    for start in range(0, data.n, BLOCK):
        block = slice(start, start + BLOCK)
        _, jacobian = fit.model.bind(data.subset(block)).linearise(fit.theta, identifiable, fit.residual.shape[0])
        columns = jacobian * fit.weight[:, None, block]
        share[block] = np.einsum("mpn,pq,mqn->n", columns, inverse, columns) / fit.residual.shape[0]
    high = np.flatnonzero((share > _HIGH_LEVERAGE) & fit.inliers)
    return tuple((int(row), float(share[row])) for row in high[np.argsort(-share[high])])


def held_out_poses(fit: Fit, data: Measurements) -> Poses:
    """Predict each row ``(N)`` with the coefficients of a fit without the row's commanded pose, to first order.

    With A_g the whitened Jacobian of the rows g of a pose, N = A^T A and r the whitened residual, the coefficients
    without these rows differ by -(N - A_g^T A_g)^-1 A_g^T r_g. The residuals become (I - H_gg)^-1 r_g, H = A N^-1 A^T.

    Source: R. D. Cook, S. Weisberg, Residuals and Influence in Regression (1982), 2.2 and appendix A.2.

    Raises:
        InputError: The other poses do not determine a coefficient.
    """
    columns = fit.identifiability.columns
    repetitions = data.repetitions()
    groups = np.arange(data.n) if repetitions is None else repetitions.numbers
    blocks = list(whole_groups(groups, BLOCK))

    def linearised(rows: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the Jacobian of the poses ``(6, K, n)`` and the whitened one of the inliers ``(n, K, M)``."""
        _, jacobian = fit.model.bind(data.subset(rows)).linearise(fit.theta, columns)
        observed = observed_jacobian(jacobian, fit.residual[:, rows]).swapaxes(0, 1)
        whitened = fit.whitening.subset(rows).apply(observed) * fit.inliers[rows]
        return jacobian, np.moveaxis(whitened, 2, 0)

    normal = np.diag(fit.precision)
    for rows in blocks:
        whitened = np.moveaxis(linearised(rows)[1], 1, 0).reshape(columns.size, -1)
        normal = normal + whitened @ whitened.T
    scale = 1.0 / np.sqrt(np.diag(normal))
    root = np.linalg.inv(np.linalg.cholesky(scale[:, None] * normal * scale)) * scale
    position, rotation = fit.poses.translation.copy(), fit.poses.rotation.copy()
    for rows in blocks:
        jacobian, whitened = linearised(rows)
        # Coefficients are scaled so that the normal matrix is I: that of the rows of a pose has its leverages.
        scaled = root @ whitened
        residual = fit.whitening.subset(rows).apply(fit.residual[:, rows]).T
        first, pose = np.unique(groups[rows], return_index=True, return_inverse=True)[1:]
        own = np.add.reduceat(scaled @ scaled.swapaxes(1, 2), first)
        rhs = np.add.reduceat(scaled @ residual[..., None], first)
        high = np.flatnonzero(np.trace(own, axis1=1, axis2=2) > _ALONE)
        for group in high[np.linalg.eigvalsh(own[high])[:, -1] > _ALONE]:
            place = data.place(int(rows[first[group]]))
            message = f"the other poses do not determine the fitted frames without the pose of {place}"
            fix = "measure more poses, turned about more axes, or fit fewer frames"
            raise InputError(Problem(message, data.source, fix=fix))
        change = -np.linalg.solve(np.eye(columns.size) - own, rhs)[..., 0] @ root
        moved = np.einsum("ckn,nk->cn", jacobian, change[pose])
        position[:, rows] += moved[:3]
        rotation[..., rows] = compose(exp_so3(moved[3:]), rotation[..., rows])
    return Poses(rotation, position)
