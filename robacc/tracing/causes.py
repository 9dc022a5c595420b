"""Causes of the error: every effect in a fit, declared or found, with what it does at the target.

To first order, an effect with the coefficients c moves the target by J_c c. If it is left out and the rest fitted
again, the coefficients change by -C_:c C_cc^-1 c, C the inverse of the normal equations' matrix, and the error grows by
the part that nothing else in the model can describe.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from robacc.chain import BLOCK
from robacc.effects.base import Effect
from robacc.fitting.fit_result import Fit
from robacc.fitting.linear_algebra import posterior
from robacc.geometry import Array
from robacc.measurements import Measurements

_NORMAL_95 = 1.96


@dataclass(frozen=True, slots=True)
class ErrorCause:
    """An effect in the model, or the constants of one joint of it."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    declared: bool
    """Whether it was declared; else it was found."""
    size: float
    """Root mean square over the poses of the distance by which it alone moves the target, m."""
    interval: tuple[float, float]
    """95 % interval of :attr:`size`, m."""
    left: float
    """Root mean square of the error that its absence leaves, the rest of the model fitted again, m."""
    share: float | None
    """Mean square of that error over that of the nominal model, registered."""


def causes(fit: Fit, data: Measurements, nominal_rms: float, found: Collection[Effect] = ()) -> tuple[ErrorCause, ...]:
    """Return the effects of a fit other than base and tool, the largest share first.

    An effect whose size the poses do not distinguish from zero is no cause.

    Args:
        fit: The fit, with the covariance of its coefficients.
        data: Its poses.
        nominal_rms: Position error of the nominal model, registered, m rms.
        found: Effects that were not declared.
    """
    columns = fit.identifiability.columns
    moved = _position_gram(fit, data)
    inverse = posterior(fit.gram, fit.precision)
    covariance = fit.covariance[np.ix_(columns, columns)]
    listed = []
    for (number, joint), indices in _groups(fit).items():
        effect = fit.model.free[number]
        values = fit.theta[columns[indices]]
        own = np.ix_(indices, indices)
        square = float(values @ moved[own] @ values)
        noise = float(np.sum(moved[own] * covariance[own]))
        size = np.sqrt(max(square, 1e-300))
        std = np.sqrt(max(float(values @ moved[own] @ covariance[own] @ moved[own] @ values), 0.0)) / size
        low = float(np.sqrt(max(square - noise, 0.0)) - _NORMAL_95 * std)
        if not low > 0.0:
            continue
        change = inverse[:, indices] @ np.linalg.solve(inverse[own], values)
        left = float(change @ moved @ change)
        share = min(left / nominal_rms**2, 1.0) if nominal_rms > 0.0 else None
        joints = effect.joints if joint is None else (joint,)
        interval = (low, float(size + _NORMAL_95 * std))
        declared = effect not in found
        listed.append(
            ErrorCause(
                effect.name, joints, effect.settings(), declared, float(size), interval, max(left, 0.0) ** 0.5, share
            )
        )
    return tuple(sorted(listed, key=lambda cause: -cause.left))


def _groups(fit: Fit) -> dict[tuple[int, str | None], list[int]]:
    """Return the identifiable coefficients of each effect, those of a constant effect by joint."""
    groups: dict[tuple[int, str | None], list[int]] = {}
    for index, column in enumerate(fit.identifiability.columns.tolist()):
        number = fit.owners[column]
        effect = fit.model.free[number]
        if effect.is_frame:
            continue
        joint = next((name for name in effect.joints if name in fit.names[column].split(".")), None)
        groups.setdefault((number, joint if effect.is_constant else None), []).append(index)
    return groups


def _position_gram(fit: Fit, data: Measurements) -> Array:
    """Return ``(K, K)`` the mean over the inliers of J'J, J the derivative of the position."""
    rows, columns = np.flatnonzero(fit.inliers), fit.identifiability.columns
    total = np.zeros((columns.size, columns.size))
    for start in range(0, rows.size, BLOCK):
        _, jacobian = fit.model.bind(data.subset(rows[start : start + BLOCK])).linearise(fit.theta, columns, 3)
        for component in jacobian:
            total += component @ component.T
    result: Array = total / max(rows.size, 1)
    return result
