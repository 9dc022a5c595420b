"""Partial residuals of an effect, for its chart: the residual of each pose without it and with it, over its driver.

This is the partial residual (component plus residual) plot of regression (W. A. Larsen and S. J. McCleary, "The use of
partial residual plots in regression analysis", Technometrics 14 (1972) 781-790): everything else in the model stays as
fitted, only the effect's own coefficients are set to zero, so that

    residual without it  =  contribution of the effect  +  residual with it

holds at every pose. For an effect that turns (or slides) one joint, all three are given as the joint's own error: the
least-squares fit of the pose's residual r by the joint's column c of the Jacobian, weighted as the model was fitted,

    y = (c' W c)^-1 c' W r,    standard deviation (c' W c)^-1/2.

Any other effect is given as the component along its displacement of the target at that pose, in m.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.drivers import Driver
from robacc.effects.periodic import orders_of, supported_orders
from robacc.errors import RobaccError
from robacc.fitting.fit_result import Fit
from robacc.fitting.levels import BLOCK_NUMBERS, SAMPLE
from robacc.geometry import Array
from robacc.measurements import Measurements, even_rows
from robacc.modelling.model import joint_columns, observed_jacobian, residuals


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Amplitude of the best cosine and sine of each order that the poses support."""

    orders: Array
    """``(K,)`` periods per turn."""
    before: Array
    """``(K,)`` rad, of the residual without the effect."""
    after: Array
    """``(K,)`` rad, with it."""
    noise: float
    """rad, root mean square amplitude of noise alone at any order."""


@dataclass(frozen=True, slots=True)
class PartialResidual:
    """One effect on one joint (or on the target) over its driver."""

    joint: str | None
    """Joint of the error; None for the component along the effect's displacement of the target."""
    driver: str
    driver_unit: str
    unit: str
    """Unit of the values: rad or m."""
    x: Array
    """``(N,)`` the driver at each pose."""
    effect: Array
    """``(N,)`` contribution of the effect."""
    before: Array
    """``(N,)`` residual without it."""
    after: Array
    """``(N,)`` residual with it."""
    sd: Array
    """``(N,)`` standard deviation of each from noise; large if the joint barely moves the target."""
    grid: Array | None
    """``(G,)`` values of the driver, ascending, if the effect is a function of it alone."""
    value: Array | None
    """``(G,)`` the effect at those values."""
    spectrum: Spectrum | None = None


def partial_residuals(effect: Effect, fit: Fit, data: Measurements) -> tuple[PartialResidual, ...]:
    """Return the curves of a free effect of a fit: one for each joint, or one of the target if no joint has it.

    Empty if the arm has no equilibrium without the effect.
    """
    indices = [i for i, owner in enumerate(fit.owners) if fit.model.free[owner] == effect]
    by_joint: list[tuple[str | None, list[int]]] = []
    for joint in effect.joints:
        motion = fit.model.arm.axis_motion(joint)
        of_joint = [i for i in indices if all(part.motion == motion for part in fit.terms[i].parts)]
        by_joint.extend([(joint, of_joint)] if of_joint else [])
    if not by_joint or sum(len(of_joint) for _, of_joint in by_joint) < len(indices):
        by_joint = [(None, indices)]
    try:
        return tuple(_curve(effect, joint, some, fit, data) for joint, some in by_joint)
    except RobaccError:
        return ()


def _curve(effect: Effect, joint: str | None, indices: Sequence[int], fit: Fit, data: Measurements) -> PartialResidual:
    """Return the curve of the coefficients ``indices``, which turn one joint; of the target if the joint is None."""
    arm = fit.model.arm
    theta = fit.theta.copy()
    theta[list(indices)] = 0.0
    without = residuals(data, fit.model.bind(data).poses(theta))
    if joint is None:
        direction = np.zeros_like(without)
        moved = without[:3] - fit.residual[:3]
        direction[:3] = moved / np.maximum(np.linalg.norm(moved, axis=0), 1e-300)
        direction *= _sign(effect, indices, fit, data)
    else:
        # The derivative of the residual by the joint, with all free coefficients at zero.
        direction = observed_jacobian(joint_columns(fit.model, data), fit.residual)[:, arm.number(joint)]
    # NaN where the effect does not move the target.
    weighted = direction * np.square(fit.weight)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = weighted / np.sum(weighted * direction, axis=0)
    share[~np.isfinite(share)] = np.nan
    sd = np.sqrt(np.sum(np.square(share / fit.weight), axis=0))
    before, after = np.sum(share * without, axis=0), np.sum(share * fit.residual, axis=0)
    explained = before - after
    # Without a simpler driver the effect is drawn over its own prediction: poses lie along the diagonal.
    driver = effect.driver(arm, data, joint) or Driver("predicted", "", explained, True)
    grid, value = None, None
    if driver.is_only and joint is not None and driver.swept is not None:
        grid = np.linspace(driver.values.min(), driver.values.max(), SAMPLE)
        coefficients = {fit.names[i]: float(fit.theta[i]) for i in indices}
        value = np.zeros(SAMPLE)
        for term in effect.terms(arm, driver.swept(grid)):
            for part in term.parts:
                value += coefficients.get(term.name, 0.0) * part.factor
    elif driver.is_only and np.isfinite(explained).any():
        is_finite = np.isfinite(explained)
        values, first = np.unique(driver.values[is_finite], return_index=True)
        rows = even_rows(values.size, SAMPLE)
        grid, value = values[rows], explained[is_finite][first[rows]]
    is_periodic = joint is not None and orders_of(effect) and driver.unit == "rad"
    inlying = (values[fit.inliers] for values in (driver.values, before, after, sd))
    return PartialResidual(
        joint,
        driver.name,
        driver.unit,
        "m" if joint is None else arm.unit(joint),
        driver.values,
        explained,
        before,
        after,
        sd,
        grid,
        value,
        _spectrum(*inlying) if is_periodic else None,
    )


def _sign(effect: Effect, indices: Sequence[int], fit: Fit, data: Measurements) -> Array | float:
    """Return the sign of the regressor if all terms share it, so that the chart of a drift passes through zero."""
    # The terms of the fit are of its first block of poses.
    parts = [term.parts[0] for term in effect.terms(fit.model.arm, data)]
    signs = [np.where(np.asarray(part.factor) < 0, -1.0, 1.0) for part in parts]
    if any(part.loads is not None for part in parts) or not all(np.array_equal(signs[0], other) for other in signs):
        return 1.0
    return signs[0] * (-1.0 if fit.theta[indices[0]] < 0 else 1.0)


def _spectrum(angle: Array, before: Array, after: Array, sd: Array) -> Spectrum | None:
    """Return the weighted least-squares spectrum (Lomb 1976) about a constant, at every supported order."""
    orders = supported_orders(angle)
    is_finite = np.isfinite(sd) & np.isfinite(before)
    if orders.size == 0 or not is_finite.any():
        return None
    weight = 1.0 / np.square(sd[is_finite])
    residual_pair = np.stack((before[is_finite], after[is_finite]), axis=1)
    amplitudes, step = [], max(BLOCK_NUMBERS // (3 * angle.size), 1)
    for start in range(0, orders.size, step):
        phase = orders[start : start + step, None] * angle[is_finite]
        basis = np.stack((np.cos(phase), np.sin(phase), np.ones_like(phase)), axis=1)
        gram = np.einsum("kin,n,kjn->kij", basis, weight, basis)
        target = np.einsum("kin,n,nb->kib", basis, weight, residual_pair)
        coefficients = np.einsum("kij,kjb->kib", np.linalg.pinv(gram, hermitian=True), target)
        amplitudes.append(np.sqrt(np.square(coefficients[:, 0]) + np.square(coefficients[:, 1])))
    amplitude = np.concatenate(amplitudes)
    return Spectrum(orders, amplitude[:, 0], amplitude[:, 1], float(2.0 / np.sqrt(weight.sum())))
