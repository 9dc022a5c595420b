"""A load on one link that the robot file does not state, against errors of the file's masses.

Both change the torques on all joints below. Masses and first moments of the file have errors of independent prior
distributions, in proportion to each link's mass; their relative size is unknown, near the file's `mass_uncertainty`. A
load on a link adds a mass, and a first moment within a share of the arm's length. Each hypothesis has a marginal
likelihood: compliances are free (uniform in their logarithm), masses and moments are integrated out by Laplace's
method, the relative error and the load's mass on grids. A load is named only if its marginal likelihood is far above
that of errors of the masses alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robacc.effects.joint_compliance import regressor_stds
from robacc.fitting.fit_result import Fit
from robacc.fitting.mass_uncertainty import relative_std
from robacc.fitting.weight_columns import WeightColumns, springs_of, weight_columns
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

NAMED = 5.0
"""Log Bayes factor from which a load is named, and within which other links are alternatives (odds of 150 to 1)."""
_ERRORS = np.array([1.0, 1.6, 2.5, 4.0])
"""Relative errors of the masses, in units of the stated or default one …"""
_ERRORS_STD = math.log(2.0)
"""… and standard deviation of their logarithm."""
_LEAST_ERROR = 0.01
"""Least relative standard deviation of the masses: a first moment is not known better than that."""
_LOADS = np.geomspace(0.005, 0.5, 15)
"""Loads as shares of the mass that the joints carry."""
_OFFSETS = np.array([0.02, 0.06, 0.15])
"""Distances of a load from its link's frame (standard deviation along each axis), as shares of the arm's length."""
_LEAST_REACH = 0.1
"""Least distance (m) that the error of a link's centre of mass is in proportion to."""
_STEPS = 25
_LEAST_DAMPING = 1e-9
_CONVERGED = 1e-3
_LEAST_START = 0.05
"""Least compliance to start from, as a share of the largest: with the masses of the prior it may seem negative."""
_LEAST_CURVATURE = 1.0
"""Least curvature in a compliance's logarithm: with less, the joint does not deflect at all."""
_INTERVAL = (0.025, 0.5, 0.975)


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
    springs = springs_of(fit)
    if not any(effect.masses == "uncertain" for effect in springs):
        return None
    arm = fit.model.arm
    columns = weight_columns(fit, data)
    usual = _usual_stds(arm, columns)
    error = max(relative_std(fit), _LEAST_ERROR)
    log_prior = -0.5 * np.square(np.log(_ERRORS) / _ERRORS_STD)
    log_prior -= math.log(np.sum(np.exp(log_prior)))
    none = _log_evidence(columns, np.zeros((_ERRORS.size, usual.size)), error * _ERRORS[:, None] * usual) + log_prior
    evidence_of_none = float(np.logaddexp.reduce(none))
    if not math.isfinite(evidence_of_none):
        return None
    places = []
    for link, masses in _hypotheses(arm, columns):
        mean, std = _prior(arm, columns, link, masses, error * _ERRORS[:, None] * usual)
        evidence = _log_evidence(columns, mean, std).reshape(masses.size, -1, _ERRORS.size) + log_prior
        by_mass = np.logaddexp.reduce(evidence.reshape(masses.size, -1), axis=1) - math.log(_OFFSETS.size)
        places.append(_place(arm.robot.joints[link].name, masses, by_mass - evidence_of_none))
    places = sorted((p for p in places if math.isfinite(p.log_bayes_factor)), key=lambda p: -p.log_bayes_factor)
    if not places:
        return None
    best = places[0].log_bayes_factor
    # Each hypothesis is as likely as the others before the poses are seen.
    is_named = best - math.log(len(places)) > NAMED
    near = [place for place in places if place.log_bayes_factor > best - NAMED] if is_named else places[:1]
    return UndeclaredLoad(columns.joints, tuple(near), is_named, error * float(_ERRORS[int(np.argmax(none))]))


def _usual_stds(arm: Arm, columns: WeightColumns) -> Array:
    """Return ``(K,)`` standard deviations of the masses and first moments at a relative error of 1."""
    stds = regressor_stds(arm, 1.0)
    for body in arm.chain.bodies:
        least = _LEAST_REACH * body.mass
        stds |= {f"{axis}{body.owner + 1}": max(stds[f"{axis}{body.owner + 1}"], least) for axis in ("hx", "hy", "hz")}
    return np.array([stds[label] for label in columns.labels])


def _hypotheses(arm: Arm, columns: WeightColumns) -> Iterator[tuple[int, Array]]:
    """Yield links (numbers of their joints in the robot) with masses to try: more than the file's, and less."""
    carried = {link: sum(body.mass for body in arm.chain.bodies if body.owner == link) for link in arm.owners}
    links = [link for link in arm.owners if f"m{link + 1}" in columns.labels]
    total = sum(carried[link] for link in links)
    for link in links:
        yield link, total * _LOADS
        if (lacking := total * _LOADS[total * _LOADS < 0.9 * carried[link]]).size:
            yield link, -lacking


def _prior(arm: Arm, columns: WeightColumns, link: int, masses: Array, stds: Array) -> tuple[Array, Array]:
    """Return mean and std ``(Q, K)`` of the masses and first moments.

    Q counts masses, then offsets of the load, then relative errors of the masses, of which ``stds`` ``(E, K)`` are the
    standard deviations.
    """
    offsets = _OFFSETS * sum(abs(arm.chain.motions[k].value) for k in arm.lengths)
    mean = np.zeros((masses.size, offsets.size, len(stds), stds.shape[1]))
    std = np.broadcast_to(stds, mean.shape).copy()
    for k, label in enumerate(columns.labels):
        if label == f"m{link + 1}":
            mean[..., k] = masses[:, None, None]
        elif label[0] == "h" and label[2:] == str(link + 1):
            std[..., k] = np.hypot(std[..., k], np.abs(np.multiply.outer(masses, offsets))[:, :, None])
    return mean.reshape(-1, stds.shape[1]), std.reshape(-1, stds.shape[1])


def _place(link: str, masses: Array, by_mass: Array) -> LoadPlace:
    """Return a hypothesis from the log evidence ``(S,)`` of each mass; the prior of the mass is even in its log."""
    weights = np.exp(by_mass - max(float(by_mass.max()), -1e300))
    if not weights.any():
        return LoadPlace(link, 0.0, 0.0, 0.0, -math.inf)
    cumulative = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    low, middle, high = np.exp(np.interp(_INTERVAL, cumulative, np.log(np.abs(masses))))
    sign = float(np.sign(masses[0]))
    ends = sorted((sign * float(low), sign * float(high)))
    return LoadPlace(
        link, sign * float(middle), ends[0], ends[1], float(np.logaddexp.reduce(by_mass)) - math.log(masses.size)
    )


def _log_evidence(columns: WeightColumns, mean: Array, std: Array) -> Array:
    """Return the log marginal likelihood ``(Q,)`` of priors ``(Q, K)`` of the masses and first moments.

    It is Laplace's: the mode over the logarithms of the compliances and the masses, and the curvature there. Where a
    joint would rise with the weight, there is none, and the likelihood is zero.
    """
    n = len(columns.joints)
    state = np.concatenate((np.log(_start(columns, mean)), np.zeros_like(mean)), axis=1)
    squares, gradient, hessian = _objective(columns, mean, std, state)
    damping = np.full(len(mean), _LEAST_DAMPING)
    for _ in range(_STEPS):
        damped = hessian + damping[:, None, None] * np.eye(state.shape[1]) * np.einsum("qii->qi", hessian)[:, None]
        step = np.linalg.solve(damped, gradient[..., None])[..., 0]
        step[:, :n] = np.clip(step[:, :n], -1.0, 1.0)
        tried = _objective(columns, mean, std, state + step)
        better = tried[0] <= squares
        state = np.where(better[:, None], state + step, state)
        squares = np.where(better, tried[0], squares)
        gradient = np.where(better[:, None], tried[1], gradient)
        hessian = np.where(better[:, None, None], tried[2], hessian)
        damping = np.maximum(damping * np.where(better, 0.1, 10.0), _LEAST_DAMPING)
        if float(np.max(np.abs(step), initial=0.0)) < _CONVERGED:
            break
    possible = np.all(hessian[:, range(n), range(n)] > _LEAST_CURVATURE, axis=1)
    return np.where(possible, -0.5 * squares - 0.5 * np.linalg.slogdet(hessian)[1], -np.inf)


def _start(columns: WeightColumns, changes: Array) -> Array:
    """Return ``(Q, J)`` compliances by least squares at given masses, all of them positive."""
    n, size = len(columns.joints), len(columns.labels) + 1
    weights = np.concatenate((np.ones((len(changes), 1)), changes), axis=1)
    gram = np.einsum("jakb,qa,qb->qjk", columns.gram.reshape(n, size, n, size), weights, weights)
    rhs = weights @ columns.rhs.reshape(n, size).T
    compliance = np.linalg.solve(gram, rhs[..., None])[..., 0]
    return np.asarray(np.maximum(compliance, _LEAST_START * np.abs(compliance).max()))


def _objective(columns: WeightColumns, mean: Array, std: Array, state: Array) -> tuple[Array, Array, Array]:
    """Return squares of residual and prior ``(Q,)``, half their slope downwards and their Gauss-Newton curvature.

    ``state`` ``(Q, J + K)`` holds the logarithms of the compliances, and the masses over ``std`` from ``mean``.
    """
    n = len(columns.joints)
    compliance, values = np.exp(state[:, :n]), state[:, n:]
    coefficients = _coefficients(compliance, mean + std * values)
    slope = _slope(compliance, mean + std * values, std)
    product = coefficients @ columns.gram
    squares = columns.cost - 2.0 * coefficients @ columns.rhs + np.einsum("qw,qw->q", product, coefficients)
    gradient = np.einsum("qwi,qw->qi", slope, columns.rhs - product)
    gradient[:, n:] -= values
    hessian = np.swapaxes(slope, 1, 2) @ (columns.gram @ slope)
    masses = range(n, state.shape[1])
    hessian[:, masses, masses] += 1.0
    return squares + np.sum(np.square(values), axis=1), gradient, hessian


def _coefficients(compliance: Array, changes: Array) -> Array:
    """Return ``(Q, J (1 + K))`` coefficients of the columns."""
    weights = np.concatenate((np.ones((len(changes), 1)), changes), axis=1)
    return (compliance[:, :, None] * weights[:, None]).reshape(len(changes), -1)


def _slope(compliance: Array, changes: Array, std: Array) -> Array:
    """Return the coefficients' derivative ``(Q, J (1 + K), J + K)`` to log compliances and to masses over stds."""
    count, n = compliance.shape
    size = changes.shape[1]
    slope = np.zeros((count, n, size + 1, n + size))
    weights = np.concatenate((np.ones((count, 1)), changes), axis=1)
    for joint in range(n):
        slope[:, joint, :, joint] = compliance[:, joint, None] * weights
    each = np.arange(size)
    slope[:, :, 1 + each, n + each] = compliance[:, :, None] * std[:, None]
    return slope.reshape(count, n * (size + 1), n + size)
