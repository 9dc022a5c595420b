"""Uncertainty of the links' masses in the standard errors of a fit.

Compliances are fitted to torques of the masses in the robot file. An error of a mass is no noise of the measurements:
every pose has the same one. To first order a relative error of mass i moves the coefficients by

    -(J^T W J + P)^-1 J^T W (dy / d ln m_i),

with J the Jacobian, W the weights and P the priors' precision, so independent errors add a covariance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robacc.chain import BLOCK
from robacc.effects.base import Effect
from robacc.errors import EquilibriumError
from robacc.fitting.coefficient_covariance import with_added_covariance
from robacc.fitting.fit_result import Fit
from robacc.fitting.linear_algebra import solved
from robacc.fitting.visits import random_rows
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals
from robacc.robots.arm import Arm
from robacc.robots.description import Joint

DEFAULT = 0.1
"""Relative standard deviation of a link's mass where the robot file states none."""
_MOST_ROWS = 4096
"""Rows that the sensitivity to a mass is taken from: a mean over random poses, known to some per cent."""
_STEP = 1e-3
"""Relative change of a mass for the central difference; the prediction is almost linear in a mass."""


def relative_std(fit: Fit) -> float:
    """Return the relative standard deviation of the masses: the robot file's, else :data:`DEFAULT`."""
    stated = fit.model.arm.robot.mass_uncertainty
    return DEFAULT if stated is None else stated


def depends_on_masses(effects: Sequence[Effect]) -> bool:
    """Return whether coefficients are fitted to torques of the masses as the file states them."""
    return any(effect.uses_masses for effect in effects)


def mass_warning(fit: Fit) -> tuple[str, ...]:
    """Return a sentence about the default uncertainty if compliances depend on it; else empty."""
    if fit.model.arm.robot.mass_uncertainty is not None or not depends_on_masses(fit.model.free):
        return ()
    return (
        f"standard errors of compliances include an uncertainty of {100 * DEFAULT:.0f} % of each link's mass; state "
        "mass_uncertainty in the robot file if the masses are better or worse known",
    )


def with_mass_uncertainty(fit: Fit, data: Measurements) -> Fit:
    """Return the fit with the uncertainty of the masses in its covariance; unchanged without elastic effects."""
    std = relative_std(fit)
    if std == 0.0 or not fit.identifiability.columns.size or not depends_on_masses(fit.model.free):
        return fit
    try:
        sensitivity = _sensitivity(fit, data)
    except EquilibriumError:
        return fit
    return with_added_covariance(fit, std**2 * sensitivity @ sensitivity.T)


def _sensitivity(fit: Fit, data: Measurements) -> Array:
    """Return ``(K, B)`` the change of each identifiable coefficient per relative change of each of B masses."""
    inliers = np.flatnonzero(fit.inliers)
    rows = inliers[random_rows(data.subset(inliers), _MOST_ROWS)]
    names = _names_with_mass(fit.model.arm)
    rhs = np.zeros((fit.identifiability.columns.size, len(names)))
    for start in range(0, rows.size, BLOCK):
        block = rows[start : start + BLOCK]
        subset = data.subset(block)
        count = fit.residual.shape[0]
        _, jacobian = fit.model.bind(subset).linearise(fit.theta, fit.identifiability.columns, count)
        weighted = jacobian * np.square(fit.weight[:, block])[:, None, :]
        for column, name in enumerate(names):
            higher, lower = (_residuals_with_mass(fit, subset, name, 1.0 + sign * _STEP) for sign in (1, -1))
            # A residual is measured minus predicted.
            rhs[:, column] += np.einsum("mkn,mn->k", weighted, (higher - lower) / (2.0 * _STEP))
    rhs *= inliers.size / max(rows.size, 1)
    matrix = fit.gram + np.diag(fit.precision)
    scale = 1.0 / np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
    result: Array = scale[:, None] * solved(matrix * scale[:, None] * scale, scale[:, None] * rhs)
    return result


def _names_with_mass(arm: Arm) -> list[str]:
    """Return the joints of the chain, and of branches, whose link has a mass."""
    joints = [arm.robot.joints[owner] for owner in dict.fromkeys(body.owner for body in arm.chain.bodies)]
    joints += [branch.joint for branch in arm.robot.branches if branch.joint.mass]
    return [joint.name for joint in joints]


def _residuals_with_mass(fit: Fit, data: Measurements, name: str, factor: float) -> Array:
    """Return the residuals ``(M, N)`` of the fitted model with the mass of a joint's link times ``factor``."""
    robot = fit.model.arm.robot

    def changed(joint: Joint) -> Joint:
        return dataclasses.replace(joint, mass=(joint.mass or 0.0) * factor) if joint.name == name else joint

    joints = tuple(map(changed, robot.joints))
    branches = tuple(dataclasses.replace(branch, joint=changed(branch.joint)) for branch in robot.branches)
    arm = Arm.of(dataclasses.replace(robot, joints=joints, branches=branches))
    model = Model(arm, fit.model.known, fit.model.free)
    return residuals(data, model.bind(data).poses(fit.theta))
