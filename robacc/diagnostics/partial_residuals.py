"""What a picture of an effect needs: the residual of each pose along it, without it and with it, over what drives it.

This is the partial residual (component plus residual) plot of regression (W. A. Larsen and S. J. McCleary, "The use of
partial residual plots in regression analysis", Technometrics 14 (1972) 781-790): everything else in the model stays as
fitted, only the effect's own coefficients are set to zero, so that

    residual without it  =  what it explains  +  residual with it

holds at every pose. For an effect that turns (or slides) one joint all three are told as the joint's own error: the
least-squares fit of the pose's residual r by the joint's column c of the Jacobian, weighted as the model was fitted,

    y = (c' W c)^-1 c' W r,    standard deviation (c' W c)^-1/2.

Any other effect is told as the component along the way it moves the target at that pose, in m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BLOCK
from robacc.effects.base import Driver, Effect, Term
from robacc.effects.joint_offset import JointOffset
from robacc.effects.orders import supported_orders
from robacc.effects.periodic import orders_of
from robacc.errors import RobaccError
from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import observed_jacobian, residuals

_GRID = 400
_ORDERS_AT_ONCE = 16


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
    """rad, root mean square amplitude that noise alone would show at any order."""


@dataclass(frozen=True, slots=True)
class PartialResidual:
    """One effect on one joint (or on the target) over its driver."""

    joint: str | None
    """Whose error is told; None: the component along the effect's own displacement of the target."""
    driver: str
    driver_unit: str
    unit: str
    """Of what follows: rad or m."""
    x: Array
    """``(N,)`` the driver at each pose."""
    effect: Array
    """``(N,)`` what the effect explains."""
    before: Array
    """``(N,)`` residual without it."""
    after: Array
    """``(N,)`` residual with it."""
    sd: Array
    """``(N,)`` standard deviation that noise gives each; large where the joint hardly moves what was measured."""
    grid: Array | None
    """``(G,)`` values of the driver, ascending, where the effect is a function of it alone."""
    value: Array | None
    """``(G,)`` the effect there."""
    spectrum: Spectrum | None = None


def partial_residuals(effect: Effect, found: Fit, data: Measurements) -> tuple[PartialResidual, ...]:
    """The curves of one of the free effects of a fit: one a joint, or one of the target where it is no joint's own.

    Empty where the arm has no equilibrium without the effect.
    """
    number = found.model.free.index(effect)
    own = [i for i, owner in enumerate(found.owners) if owner == number]
    joints = [
        (joint, mine)
        for joint in effect.joints
        if (mine := [i for i in own if _turns(found.terms[i], found.model.arm.axis_motion(joint))])
    ]
    try:
        if joints and sum(len(mine) for _, mine in joints) == len(own):
            return tuple(_of_joint(effect, joint, mine, found, data) for joint, mine in joints)
        return (_of_target(effect, own, found, data),)
    except RobaccError:
        return ()


def _turns(term: Term, motion: int) -> bool:
    return all(part.motion == motion for part in term.parts)


def _of_joint(effect: Effect, joint: str, own: Sequence[int], found: Fit, data: Measurements) -> PartialResidual:
    lacking = _lacking(own, found, data)
    column = _column(joint, found, data)
    before, after, sd = _along(column, lacking, found)
    driver = effect.driver(found.model.arm, data, joint)
    grid, value = None, None
    if driver is None:
        driver = _predicted(before - after)
    if driver.is_only:
        grid, value = _function(effect, own, found, driver, before - after)
    unit = "rad" if found.model.arm.is_revolute(joint) else "m"
    spectrum = None
    if orders_of(effect):
        spectrum = _spectrum(
            driver.values[found.inliers], before[found.inliers], after[found.inliers], sd[found.inliers]
        )
    return PartialResidual(
        joint, driver.name, driver.unit, unit, driver.values, before - after, before, after, sd, grid, value, spectrum
    )


def _of_target(effect: Effect, own: Sequence[int], found: Fit, data: Measurements) -> PartialResidual:
    lacking = _lacking(own, found, data)
    moved = lacking[:3] - found.residual[:3]
    length = np.sqrt(np.sum(np.square(moved), axis=0))
    way = np.zeros_like(lacking)
    way[:3] = moved / np.where(length > 0, length, 1.0) * _sign([found.terms[i] for i in own], found.theta[own[0]])
    before, after, sd = _along(way, lacking, found)
    driver = effect.driver(found.model.arm, data, None)
    grid, value = None, None
    if driver is None:
        driver = _predicted(before - after)
    if driver.is_only:
        grid, value = _sorted(driver.values, before - after)
    return PartialResidual(
        None, driver.name, driver.unit, "m", driver.values, before - after, before, after, sd, grid, value
    )


def _lacking(own: Sequence[int], found: Fit, data: Measurements) -> Array:
    """``(M, N)`` residuals with the coefficients ``own`` at zero and all others as fitted."""
    theta = found.theta.copy()
    theta[list(own)] = 0.0
    return residuals(data, found.model.bind(data).poses(theta))


def _column(joint: str, found: Fit, data: Measurements) -> Array:
    """``(M, N)`` what a unit error of the joint does to the residual; of the model without what is free, which moves
    the arm by too little to matter.
    """  # noqa: D205
    model = Model(found.model.arm, found.model.known, (JointOffset((joint,)),))
    column = np.empty(found.residual.shape)
    for start in range(0, data.n, BLOCK):
        rows = np.arange(start, min(start + BLOCK, data.n))
        _, jacobian = model.bind(data.subset(rows)).linearise(np.zeros(1))
        column[:, rows] = observed_jacobian(jacobian, found.residual[:, rows])[:, 0]
    return column


def _along(way: Array, lacking: Array, found: Fit) -> tuple[Array, Array, Array]:
    """Both residuals along a direction ``(M, N)`` of each pose, and their standard deviation; NaN where it is zero."""
    weighted = way * np.square(found.weight)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = weighted / np.sum(weighted * way, axis=0)
    share[~np.isfinite(share)] = np.nan
    sd = np.sqrt(np.sum(np.square(share / found.weight), axis=0))
    return np.sum(share * lacking, axis=0), np.sum(share * found.residual, axis=0), sd


def _sign(terms: Sequence[Term], first: float) -> Array | float:
    """Counted along the regressor where all terms have the same, so that a drift is seen to pass through zero."""
    parts = [term.parts[0] for term in terms]
    signs = [np.where(np.asarray(part.factor) < 0, -1.0, 1.0) for part in parts]
    if any(part.loads is not None for part in parts) or not all(np.array_equal(signs[0], one) for one in signs):
        return 1.0
    return signs[0] * (-1.0 if first < 0 else 1.0)


def _predicted(explained: Array) -> Driver:
    """What the effect itself predicts, where nothing simpler drives it: poses then lie along the diagonal."""
    return Driver("predicted", "", explained, True)


def _function(
    effect: Effect, own: Sequence[int], found: Fit, driver: Driver, explained: Array
) -> tuple[Array | None, Array | None]:
    """The effect over its driver: evaluated between the poses where that can be done, else as the poses have it."""
    if driver.swept is None:
        return _sorted(driver.values, explained)
    low, high = float(driver.values.min()), float(driver.values.max())
    grid = np.linspace(low, high, _GRID)
    names = {found.names[i]: float(found.theta[i]) for i in own}
    value = np.zeros(_GRID)
    for term in effect.terms(found.model.arm, driver.swept(grid)):
        for part in term.parts:
            value += names.get(term.name, 0.0) * part.factor
    return grid, value


def _sorted(x: Array, y: Array) -> tuple[Array | None, Array | None]:
    """At most :data:`_GRID` of the poses by rank of ``x``, each value of it once."""
    good = np.isfinite(y)
    if not good.any():
        return None, None
    values, first = np.unique(x[good], return_index=True)
    pick: NDArray[np.int64] = np.unique(np.linspace(0, values.size - 1, min(values.size, _GRID)).round().astype(int))
    return values[pick], y[good][first[pick]]


def _spectrum(angle: Array, before: Array, after: Array, sd: Array) -> Spectrum | None:
    """Weighted least-squares spectrum (Lomb 1976) about a constant, at every order that the poses support."""
    orders = supported_orders(angle)
    good = np.isfinite(sd) & np.isfinite(before)
    if orders.size == 0 or not good.any():
        return None
    weight = 1.0 / np.square(sd[good])
    both = np.stack((before[good], after[good]), axis=1)
    sizes = []
    for start in range(0, orders.size, _ORDERS_AT_ONCE):
        phase = orders[start : start + _ORDERS_AT_ONCE, None] * angle[good]
        basis = np.stack((np.cos(phase), np.sin(phase), np.ones_like(phase)), axis=1)
        gram = np.einsum("kin,n,kjn->kij", basis, weight, basis)
        target = np.einsum("kin,n,nb->kib", basis, weight, both)
        solved = np.einsum("kij,kjb->kib", np.linalg.pinv(gram, hermitian=True), target)
        sizes.append(np.sqrt(np.square(solved[:, 0]) + np.square(solved[:, 1])))
    amplitude = np.concatenate(sizes)
    return Spectrum(orders, amplitude[:, 0], amplitude[:, 1], float(2.0 / np.sqrt(weight.sum())))
