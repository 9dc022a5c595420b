"""Masses in a fit with elastic joints: their uncertainty, and a load that nobody declared."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Term
from robacc.effects.elastic import JointCompliance, regressor_stds
from robacc.errors import EquilibriumError
from robacc.fitting.fit_result import Fit, with_covariance
from robacc.fitting.levels import DECISIVE, FEW, MANY, SETTLED, STEPS
from robacc.fitting.normal_equations import solved
from robacc.fitting.visits import random_rows
from robacc.geometry import Array
from robacc.gravity import own_weight, unit_loads
from robacc.measurements import Measurements
from robacc.modelling.model import observed_jacobian, residuals
from robacc.robots.arm import Arm
from robacc.robots.description import Joint

# What the weights of an arm's links do to its measured poses, through the joints that deflect under them.
#
# To first order the whitened residual without the springs is
#
#     y = sum_j c_j (b_j0 + sum_k p_k b_jk) + noise,
#
# c_j the compliance of joint j, b_j0 the column of the weights in the robot file, b_jk that of a unit mass or of a
# unit first moment of one link, p_k how far that mass or moment is from the file's. Columns of all other coefficients
# are projected out.


def weight_products(
    fit: Fit, data: Measurements, springs: Sequence[JointCompliance]
) -> tuple[tuple[str, ...], list[str], Array]:
    """Return the products of the columns of weights and of the residual with one another, on the fit's inliers.

    Returns:
        The J joints of ``springs``, which are free in the fit; the K unit masses and first moments, as
        :func:`robacc.gravity.unit_loads` names them; and the products ``(J (1 + K) + 1,) * 2``, of each joint the
        file's weights first, the residual without the springs last.
    """
    arm, rows = fit.model.arm, np.flatnonzero(fit.inliers)
    data, whitening = data.subset(rows), fit.whitening.subset(rows)
    form = {joint: effect for effect in springs for joint in effect.joints}
    units = unit_loads(arm, min(arm.owners[arm.number(joint)] for joint in form))
    loads = (own_weight(arm, data), *units.values())
    added = [Term("", "", 1.0, e.parts((arm.axis_motion(joint),), load)) for joint, e in form.items() for load in loads]
    bound = fit.model.bind(data)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *added))
    poses, jacobian = extended.linearise(np.concatenate((fit.theta, np.zeros(len(added)))), rows=len(fit.residual))
    residual = residuals(data, poses)
    white = whitening.rows(observed_jacobian(jacobian, residual), residual)
    is_spring = np.array([fit.model.free[owner] in springs for owner in fit.owners])
    white[:, -1] += np.einsum("mpn,p->mn", white[:, : is_spring.size][:, is_spring], fit.theta[is_spring])
    gram = sum((component @ component.T for component in white), start=np.zeros((white.shape[1],) * 2))
    identified = fit.identifiability.columns
    kept = ~is_spring[identified]
    others, own = identified[kept], np.arange(is_spring.size, len(gram))
    cross = gram[np.ix_(others, own)]
    eliminated = cross.T @ solved(gram[np.ix_(others, others)] + np.diag(fit.precision[kept]), cross)
    return tuple(form), list(units), gram[np.ix_(own, own)] - eliminated


# Uncertainty of the links' masses in the standard errors of a fit.
#
# Compliances are fitted to torques of the masses in the robot file. An error of a mass is no noise of the
# measurements: every pose has the same one. To first order a relative error of mass i moves the coefficients by
#
#     -(J^T W J + P)^-1 J^T W (dy / d ln m_i),
#
# with J the Jacobian, W the weights and P the priors' precision, so independent errors add a covariance.

DEFAULT = 0.1
"""Relative standard deviation of a link's mass where the robot file states none."""
_STEP = 1e-3
"""Relative change of a mass for the central difference; the prediction is almost linear in a mass."""


def relative_std(fit: Fit) -> float:
    """Return the relative standard deviation of the masses: the robot file's, else :data:`DEFAULT`."""
    stated = fit.model.arm.robot.mass_uncertainty
    return DEFAULT if stated is None else stated


def with_mass_uncertainty(fit: Fit, data: Measurements) -> Fit:
    """Return the fit with the uncertainty of the masses in its covariance; unchanged without elastic effects."""
    std, columns, arm = relative_std(fit), fit.identifiability.columns, fit.model.arm
    if std == 0.0 or not columns.size or not any(effect.uses_masses for effect in fit.model.free):
        return fit
    inliers = np.flatnonzero(fit.inliers)
    rows = inliers[random_rows(data.subset(inliers), MANY)]
    part = data.subset(rows)
    weighted = fit.jacobian(rows, len(fit.residual)) * np.square(fit.weight[:, rows])[:, None, :]
    joints = [arm.robot.joints[owner] for owner in dict.fromkeys(body.owner for body in arm.chain.bodies)]
    joints += [branch.joint for branch in arm.robot.branches if branch.joint.mass]
    rhs = np.zeros((columns.size, len(joints)))
    try:
        for column, joint in enumerate(joints):
            higher, lower = (_residuals_with_mass(fit, part, joint.name, 1.0 + sign * _STEP) for sign in (1, -1))
            # A residual is measured minus predicted.
            rhs[:, column] = np.einsum("mkn,mn->k", weighted, (higher - lower) / (2.0 * _STEP))
    except EquilibriumError:
        return fit
    # The change of each identifiable coefficient per relative change of each mass.
    sensitivity = solved(fit.gram + np.diag(fit.precision), rhs * (inliers.size / max(rows.size, 1)))
    covariance = fit.covariance[np.ix_(columns, columns)]
    return with_covariance(fit, covariance + std**2 * sensitivity @ sensitivity.T)


def _residuals_with_mass(fit: Fit, data: Measurements, name: str, factor: float) -> Array:
    """Return the residuals ``(M, N)`` of the fitted model with the mass of a joint's link times ``factor``."""
    robot = fit.model.arm.robot

    def changed(joint: Joint) -> Joint:
        return dataclasses.replace(joint, mass=(joint.mass or 0.0) * factor) if joint.name == name else joint

    joints = tuple(map(changed, robot.joints))
    branches = tuple(branch._replace(joint=changed(branch.joint)) for branch in robot.branches)
    arm = Arm.of(dataclasses.replace(robot, joints=joints, branches=branches))
    return residuals(data, dataclasses.replace(fit.model, arm=arm).bind(data).poses(fit.theta))


# A load on one link that the robot file does not state, against errors of the file's masses.
#
# Both change the torques on all joints below. Masses and first moments of the file have errors of independent prior
# distributions, in proportion to each link's mass; their relative size is unknown, near the file's
# `mass_uncertainty`. A load on a link adds a mass, and a first moment within a share of the arm's length. Each
# hypothesis has a marginal likelihood: compliances are free (uniform in their logarithm), masses and moments are
# integrated out by Laplace's method, the relative error and the load's mass on grids. A load is named only if its
# marginal likelihood is far above that of errors of the masses alone.

_ERRORS = 2.0 ** np.array([0.0, 2.0 / 3.0, 4.0 / 3.0, 2.0])
"""Relative errors of the masses, in units of the stated or default one, whose logarithm has a standard deviation of
log 2."""
_LOADS = np.geomspace(0.005, 0.5, 15)
"""Loads as shares of the mass that the joints carry."""
_OFFSETS = np.array([0.02, 0.06, 0.15])
"""Distances of a load from its link's frame (standard deviation along each axis), as shares of the arm's length."""


@dataclass(frozen=True, slots=True)
class LoadPlace:
    """One hypothesis: the weight of one link is not the file's."""

    link: str
    """Joint that moves the link."""
    mass: float
    """Median of the load, kg; negative if the link is lighter than the file states."""
    low: float
    """Ends of the 95 % credible interval, kg."""
    high: float
    log_bayes_factor: float
    """Marginal likelihood against errors of the file's masses alone."""


@dataclass(frozen=True, slots=True)
class UndeclaredLoad:
    """Whether the torques point to a load on one link."""

    joints: tuple[str, ...]
    """Joints whose deflections show it."""
    places: tuple[LoadPlace, ...]
    """Links that the poses do not distinguish from the best, best first; if no load is named, the best alone."""
    is_named: bool
    """True if the best is far more likely than errors of the file's masses alone."""
    mass_error: float
    """Relative error of the file's masses that explains the torques best without a load."""

    @property
    def statement(self) -> str:
        """Return what the torques point to, in one sentence."""
        joints = ", ".join(self.joints)
        if not self.is_named:
            return (
                f"by the torques of {joints}, a load on one link is not distinguishable from errors of about "
                f"{100 * self.mass_error:.0f} % of the masses in the robot file"
            )
        texts = [
            f"{_kg(place.mass)} kg {'more' if place.mass > 0 else 'less'} on the link of {place.link} "
            f"(95 %: {' to '.join(map(_kg, sorted((place.low, place.high), key=abs)))} kg)"
            for place in self.places
        ]
        return f"the torques of {joints} point to {', or '.join(texts)} than the robot file states"


def _kg(mass: float) -> str:
    return f"{abs(mass):.2g}" if abs(mass) < 100 else f"{abs(mass):.0f}"


def undeclared_load(fit: Fit, data: Measurements) -> UndeclaredLoad | None:
    """Return which load the springs of a fit point to; None unless one of them has uncertain masses."""
    springs = [e for e in fit.model.free if isinstance(e, JointCompliance) and e.masses != "unknown"]
    if not any(effect.masses == "uncertain" for effect in springs):
        return None
    arm, (joints, labels, products) = fit.model.arm, weight_products(fit, data, springs)
    error, usual = relative_std(fit), regressor_stds(arm, 1.0)
    for body in arm.chain.bodies:
        for label in (f"{axis}{body.owner + 1}" for axis in ("hx", "hy", "hz")):
            # Least distance (m) that the error of a link's centre of mass is in proportion to: with half of it, 2 of 40
            # simulated arms without a load have one named.
            usual[label] = max(usual[label], 0.1 * body.mass)
    stds = error * _ERRORS[:, None] * np.array([usual[label] for label in labels])
    log_prior = -0.5 * np.square(np.log2(_ERRORS))
    log_prior -= math.log(np.sum(np.exp(log_prior)))
    none = _log_evidence(products, len(joints), np.zeros_like(stds), stds) + log_prior
    evidence_of_none = float(np.logaddexp.reduce(none))
    if not math.isfinite(evidence_of_none):
        return None
    carried = {link: sum(body.mass for body in arm.chain.bodies if body.owner == link) for link in arm.owners}
    links = [link for link in arm.owners if f"m{link + 1}" in labels]
    more = sum(carried[link] for link in links) * _LOADS
    # More than the file's mass on each link, and less.
    tried = [(link, masses) for link in links for masses in (more, -more[more < 0.9 * carried[link]])]
    offsets = _OFFSETS * sum(abs(arm.chain.motions[k].value) for k in arm.lengths)
    places = []
    for link, masses in tried:
        if not masses.size:
            continue
        # Masses and first moments by mass, offset of the load, and relative error of the masses.
        mean = np.zeros((masses.size, offsets.size, *stds.shape))
        std = np.broadcast_to(stds, mean.shape).copy()
        mean[..., labels.index(f"m{link + 1}")] = masses[:, None, None]
        moments = [k for k, label in enumerate(labels) if label[0] == "h" and label[2:] == str(link + 1)]
        std[..., moments] = np.hypot(std[..., moments], np.abs(np.multiply.outer(masses, offsets))[:, :, None, None])
        evidence = _log_evidence(products, len(joints), mean.reshape(-1, stds.shape[1]), std.reshape(-1, stds.shape[1]))
        by_mass = np.logaddexp.reduce((evidence.reshape(mean.shape[:3]) + log_prior).reshape(masses.size, -1), axis=1)
        by_mass -= math.log(_OFFSETS.size)
        weights = np.exp(by_mass - max(float(by_mass.max()), -1e300))
        if not weights.any():
            continue
        # The prior of the mass is even in its logarithm.
        cumulative = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
        sizes = np.sign(masses[0]) * np.exp(np.interp((0.025, 0.5, 0.975), cumulative, np.log(np.abs(masses))))
        likely = float(np.logaddexp.reduce(by_mass)) - math.log(masses.size) - evidence_of_none
        name = arm.robot.joints[link].name
        places.append(LoadPlace(name, float(sizes[1]), float(sizes.min()), float(sizes.max()), likely))
    places.sort(key=lambda place: -place.log_bayes_factor)
    if not places:
        return None
    best = places[0].log_bayes_factor
    # Each hypothesis is as likely as the others before the poses are seen.
    is_named = best - math.log(len(places)) > DECISIVE
    near = [place for place in places if place.log_bayes_factor > best - DECISIVE] if is_named else places[:1]
    return UndeclaredLoad(joints, tuple(near), is_named, error * float(_ERRORS[int(np.argmax(none))]))


def _log_evidence(products: Array, n: int, mean: Array, std: Array) -> Array:
    """Return the log marginal likelihood ``(Q,)`` of priors ``(Q, K)`` of the masses and first moments.

    It is that of the linear Gaussian model of the columns, whose ``products`` these are, at the most probable
    logarithms of ``n`` compliances and masses, which Gauss-Newton steps find. Where a joint would rise with the weight,
    or hardly deflects (a curvature below 1), there is none, and the likelihood is zero. The compliances start from
    least squares at the prior's masses, all of them positive.
    """
    hypotheses, count = mean.shape
    shares, rhs = np.insert(mean, 0, 1.0, axis=1), products[:-1, -1].reshape(n, -1)
    normal = np.einsum("jakb,qa,qb->qjk", products[:-1, :-1].reshape(n, 1 + count, n, -1), shares, shares)
    compliance = np.linalg.solve(normal, (shares @ rhs.T)[..., None])[..., 0]
    compliance = np.maximum(compliance, FEW * np.abs(compliance).max())
    values, by_mass = np.zeros_like(mean), std[:, None, :] * np.eye(1 + count, count, -1)
    for _ in range(STEPS):
        # Of the file's weights once, then of the changes; -1 times the residual is beside them.
        shares = np.insert(mean + std * values, 0, 1.0, axis=1)
        coefficients = np.einsum("qj,qa->qja", compliance, shares)
        slope = np.concatenate(
            (np.einsum("qja,ji->qjai", coefficients, np.eye(n)), np.einsum("qj,qak->qjak", compliance, by_mass)), axis=3
        ).reshape(hypotheses, -1, n + count)
        left = np.insert(coefficients.reshape(hypotheses, -1), rhs.size, -1.0, axis=1)
        hessian = np.swapaxes(slope, 1, 2) @ (products[:-1, :-1] @ slope)
        hessian[:, range(n, n + count), range(n, n + count)] += 1.0
        downhill = -np.einsum("qwi,qw->qi", slope, (left @ products)[:, :-1])
        downhill[:, n:] -= values
        step = np.linalg.solve(hessian, downhill[..., None])[..., 0]
        compliance, values = compliance * np.exp(np.clip(step[:, :n], -1.0, 1.0)), values + step[:, n:]
        if float(np.max(np.abs(step))) < SETTLED:
            break
    squares = np.einsum("qw,qw->q", left, left @ products) + np.sum(np.square(values), axis=1)
    possible = np.all(hessian[:, range(n), range(n)] > 1.0, axis=1)
    return np.where(possible, -0.5 * squares - 0.5 * np.linalg.slogdet(hessian)[1], -np.inf)
