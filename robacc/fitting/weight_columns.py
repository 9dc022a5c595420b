"""What the weights of an arm's links do to its measured poses, through the joints that deflect under them.

To first order the whitened residual without the springs is

    y = sum_j c_j (b_j0 + sum_k p_k b_jk) + noise,

c_j the compliance of joint j, b_j0 the column of the weights in the robot file, b_jk that of a unit mass or of a unit
first moment of one link, p_k how far that mass or moment is from the file's. Columns of all other coefficients are
projected out.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Term
from robacc.effects.joint_compliance import JointCompliance
from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.gravity.loads import own_weight, unit_loads
from robacc.measurements import Measurements
from robacc.modelling.observation import observed_jacobian, residuals


@dataclass(frozen=True, eq=False)
class WeightColumns:
    """Products of the columns of weights with one another and with the residual."""

    joints: tuple[str, ...]
    """J joints that deflect."""
    labels: tuple[str, ...]
    """K unit masses and first moments, as :func:`robacc.gravity.loads.unit_loads` names them."""
    gram: Array
    """``(J (1 + K), J (1 + K))``: of each joint the file's weights first."""
    rhs: Array
    """``(J (1 + K),)``"""
    cost: float
    """Whitened sum of squares of the residual."""


def springs_of(fit: Fit) -> tuple[JointCompliance, ...]:
    """Return the free springs of the fit whose torques start from the masses of the robot file."""
    return tuple(e for e in fit.model.free if isinstance(e, JointCompliance) and e.masses != "unknown")


def weight_columns(fit: Fit, data: Measurements) -> WeightColumns:
    """Return the columns of the springs' joints, on the inliers of the fit."""
    arm, springs = fit.model.arm, springs_of(fit)
    rows = np.flatnonzero(fit.inliers)
    data, whitening = data.subset(rows), fit.whitening.subset(rows)
    joints = tuple(dict.fromkeys(joint for effect in springs for joint in effect.joints))
    units = unit_loads(arm, min(arm.owners[arm.number(joint)] for joint in joints))
    loads = (own_weight(arm, data), *units.values())
    form = {joint: effect for effect in springs for joint in effect.joints}
    added = [Term("", "", 1.0, (form[joint].part(arm.axis_motion(joint), load),)) for joint in joints for load in loads]
    bound = fit.model.bind(data)
    count = len(bound.terms)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *added))
    poses, jacobian = extended.linearise(np.concatenate((fit.theta, np.zeros(len(added)))), rows=len(fit.residual))
    residual = residuals(data, poses)
    columns = np.moveaxis(whitening.apply(np.moveaxis(observed_jacobian(jacobian, residual), 1, 0)), 0, 1)
    is_spring = np.array([fit.model.free[owner] in springs for owner in fit.owners])
    put_back = np.einsum("mpn,p->mn", columns[:, :count][:, is_spring], fit.theta[is_spring])
    identified = fit.identifiability.columns
    others = identified[~is_spring[identified]]
    target = np.concatenate((columns[:, count:], (whitening.apply(residual) + put_back)[:, None]), axis=1)
    new = _without(_long(columns[:, others]), fit.precision[~is_spring[identified]], _long(target))
    products = new.T @ new
    return WeightColumns(joints, tuple(units), products[:-1, :-1], products[:-1, -1], float(products[-1, -1]))


def _long(columns: Array) -> Array:
    """Return columns ``(M, C, N)`` as ``(M N, C)``."""
    return columns.transpose(0, 2, 1).reshape(-1, columns.shape[1])


def _without(others: Array, precision: Array, columns: Array) -> Array:
    """Return columns ``(R, C)`` without what the other coefficients ``(R, P)`` and their priors reproduce."""
    lengths = np.linalg.norm(others, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    complete = np.vstack((others / lengths, np.diag(np.sqrt(precision) / lengths)))
    padded = np.vstack((columns, np.zeros((len(precision), columns.shape[1]))))
    # Identified columns are independent, and so are columns with a prior.
    directions = np.linalg.qr(complete)[0]
    return np.asarray(padded - directions @ (directions.T @ padded))
