"""Joint columns as recorded: read back or commanded, rounded, and errors that remember the last approach."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import effect_class
from robacc.effects.campaign import FOLLOWED_SHARE
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.fitting.solver import fit
from robacc.fitting.visits import random_rows
from robacc.geometry import Array, rms_length
from robacc.gravity import weight_torques
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Robot
from robacc.statistics.distributions import normal_cdf

# Choice between joints read back and commanded joints: which of them the measured positions follow.

READ_BACK = "read_back"
"""Effect whose coefficient is the share."""
_UNDECIDED = 0.25
"""Standard error of the share above which the poses do not decide."""


def read_back_warning(final: Fit, data: Measurements) -> tuple[str, ...]:
    """Return which joints the measured positions follow, if the file has both; empty if the model has `read_back`."""
    model, cls = final.model, effect_class(READ_BACK)
    if cls.missing(model.arm, data) is not None or any(effect.name == READ_BACK for effect in model.free):
        return ()
    assert data.read_back is not None
    assert data.q is not None
    shift = np.einsum("mjn,jn->mn", joint_columns(model, data)[:3], data.read_back - data.q)
    fitted = fit(model.with_free(cls.default(model.arm, data)), data)
    number = fitted.names.index(READ_BACK)
    share, std = float(fitted.theta[number]), float(np.sqrt(fitted.covariance[number, number]))
    start = (
        f"the joints read back differ from the commanded joints by {1e3 * rms_length(shift):.3g} mm rms at the target"
    )
    if not np.isfinite(std) or std > _UNDECIDED:
        return (f"{start}; the poses do not decide which of them the arm stood at; the commanded joints are used",)
    follow = f"{start}; the measured positions follow a share of {share:.2f} ± {std:.2f} of this difference"
    # Beyond three standard errors, and a tenth for what the model lacks, a share is impossible.
    if abs(share - 0.5) > 0.6 + 3.0 * std:
        return (
            f"{follow}, but only 0 to 1 is possible: the model lacks an effect that resembles it; the commanded joints "
            "are used",
        )
    cause = "the joints were read before the arm had settled"
    if share >= FOLLOWED_SHARE:
        cause = (
            "the arm was measured before it had settled, or its controller leaves a constant error; give the "
            "joints read back as q1 … qN"
        )
    return (
        f"{follow} (0: the arm stood at the commanded joints, 1: at those read back); the commanded joints are used; "
        f"{cause}",
    )


# Joint variables that were recorded with few digits: rounding as scatter of the joints.
#
# A variable rounded to a step s has an error of variance s^2 / 12 (B. Widrow, I. Kollár, Quantization Noise, 2008). A
# command in whole steps has none, so the step alone decides nothing: the residual must scatter as rounding would make
# it. With C_i the Jacobian of the joint variables at row i, the Gaussian log-likelihoods of the covariances v I and v
# I + C_i diag(s^2 / 12) C_i^T, each at its best v, are compared.

_DIGITS = range(5)
"""Decimals of degrees, mm, rad and m that a step may have."""
_UNITS = {"revolute": (("degrees", math.pi / 180), ("rad", 1.0)), "prismatic": (("mm", 1e-3), ("m", 1.0))}
_WHOLE_TOLERANCE = 1e-4
"""Largest deviation from whole steps, in steps: the rounding of a file that has the variables in another unit."""
_FEWEST_VALUES = 12
"""Different values of a joint from which whole steps are no accident."""
_EVIDENT = 5.0
"""Gain in log-likelihood from which the residual shows the rounding (odds of 150 to 1)."""
_AS_SMALL = 1.5
"""Errors over the rounding of the numbers up to which the rounding explains them: twice its variance and a quarter."""
_MOST_ROWS = 20_000
"""Poses that decide: random ones show the rounding as well as all."""
_SHARES = np.geomspace(1e-3, 1.2, 24)
"""Noise that is tried, over the root mean square of the residual. A residual smaller than the least of them over the
size of the rounding cannot show it; exact data make the covariances singular."""


@dataclass(frozen=True, slots=True)
class Rounding:
    """Steps of the recorded joint variables, which the residual shows."""

    step: str
    """Largest step, with its unit."""
    std: Array
    """``(J,)`` standard deviation of each joint, rad or m."""
    position: float
    """RMS displacement of the target that the rounding causes, m."""

    @property
    def size(self) -> str:
        """Return the step and its size at the target."""
        moved = f"{1e3 * self.position:.2g} mm rms"
        return f"the joint variables are rounded to {self.step}, which moves the target by {moved}"

    @property
    def warning(self) -> str:
        """Return the warning of a fit: the step, its size at the target, and what to do."""
        return f"{self.size}; it counts as scatter of the joints; record more digits"


def joint_step(values: Array, kind: str) -> tuple[float, str] | None:
    """Return the coarsest step of values ``(N,)``, rad or m, and its text; None without one, or with few values."""
    if np.unique(values).size < _FEWEST_VALUES:
        return None
    steps = [(size / 10**digits, digits, unit) for unit, size in _UNITS[kind] for digits in _DIGITS]
    for step, digits, unit in sorted(steps, reverse=True):
        multiples = values / step
        if np.all(np.abs(multiples - np.round(multiples)) <= _WHOLE_TOLERANCE):
            return step, f"{10.0**-digits:g} {unit}"
    return None


def evident_rounding(fit: Fit, data: Measurements) -> Rounding | None:
    """Return the rounding of the joint variables; None if there is none, or if the residual does not show it."""
    return _evident_rounding(fit.model, data.subset(fit.inliers), fit.residual[:3, fit.inliers])


def rounding_in_errors(robot: Robot, data: Measurements, errors: Array) -> tuple[str, ...]:
    """Return the warning of numbers with few digits that position errors show; empty without one.

    Errors no larger than the rounding of joints and positions are those of a controller's own positions, which it
    computes from the joints.

    Args:
        robot: The robot of the commanded poses, registered.
        data: The measured poses.
        errors: ``(3, N)`` attained minus commanded positions in the measuring frame, m.
    """
    rounding = _evident_rounding(Model.of(robot), data, errors)
    steps = [joint_step(row, "prismatic") or (0.0, "") for row in data.position]
    parts = [] if rounding is None else [rounding.position]
    is_small = rms_length(errors) <= _AS_SMALL * math.hypot(*parts, *(step / math.sqrt(12.0) for step, _ in steps))
    computed = "the positions look computed from the joints, not measured"
    if rounding is not None:
        text = f"{rounding.size}{', as much as the errors' * is_small}; record more digits"
        return (f"{text}{f', or {computed}' * is_small}",)
    size = f"{1e3 * rms_length(errors):.2g} mm rms"
    return (f"the errors ({size}) are the rounding of the file: {computed}",) if is_small else ()


def _evident_rounding(model: Model, data: Measurements, residual: Array) -> Rounding | None:
    if data.q is None:
        return None
    rows = random_rows(data, _MOST_ROWS)
    q, data, residual = data.q[:, rows], data.subset(rows), residual[:, rows]
    kinds = ["revolute" if model.arm.is_revolute(name) else "prismatic" for name in model.arm.names]
    steps = [joint_step(row, kind) or (0.0, "") for kind, row in zip(kinds, q, strict=True)]
    std = np.array([step for step, _ in steps]) / math.sqrt(12.0)
    columns = joint_columns(model, data)[:3] * std[:, None]
    covariance = np.einsum("ajn,bjn->nab", columns, columns)
    position = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))
    if position == 0.0 or rms_length(residual) <= _SHARES[0] * position:
        return None
    if _likelihood(residual, covariance) - _likelihood(residual, np.zeros_like(covariance)) < _EVIDENT:
        return None
    return Rounding(max(steps)[1], std, position)


def _likelihood(residual: Array, covariance: Array) -> float:
    """Return the largest log-likelihood of ``(3, N)`` for covariances ``(N, 3, 3)`` plus white noise, in m and m²."""
    noise = np.square(_SHARES) * np.mean(np.square(residual))
    values, vectors = np.linalg.eigh(covariance)
    along = np.square(np.einsum("nij,in->nj", vectors, residual))
    total = np.maximum(values, 0.0) + noise[:, None, None]
    return float(np.max(-0.5 * np.sum(along / total + np.log(total), axis=(1, 2))))


# Memory of a joint's play: errors that depend on how its torque changed since the previous visit.
#
# Play without memory has two values, given by the approach. Where friction and springs act together (hysteresis), the
# joint also remembers the load of the previous visit: the error follows the sign of the change of gravity's torque.
# That sign depends on the present pose too, so its least-squares fit by polynomials of the ranks of torque and joint
# is subtracted. The difference is independent of the residual of a complete model. The sum of their products, over
# the root of the sum of the squared products, is then a standard Gaussian to good accuracy (a self-normalised sum; V.
# H. de la Peña, T. L. Lai, Q.-M. Shao, Self-Normalized Processes, 2009).
#
# Source of the mechanism: M. Ruderman, F. Hoffmann, T. Bertram, "Modeling and identification of elastic robot joints
# with hysteresis and backlash", IEEE Trans. Industrial Electronics 56 (2009) 3840-3847.

_FEWEST_VISITS = 30
"""Visits from which the sum is close to Gaussian."""


def memory_of_play(fit: Fit, data: Measurements, joints: Sequence[str]) -> dict[str, float]:
    """Return, for each joint with play, the p-value of a memory in the residual.

    Outliers count with a bounded size, since a memory may be what makes them. The result is empty without masses,
    without joint variables, or with fewer than 30 visits that follow another visit.
    """
    if not joints or data.q is None or not fit.model.arm.chain.bodies:
        return {}
    # In order of time; in order of the file without times.
    order = np.arange(data.n) if data.time is None or data.ordered else np.argsort(data.time, kind="stable")
    before = previous_visit(data.q[:, order])
    follows = before >= 0
    if np.count_nonzero(follows) < _FEWEST_VISITS:
        return {}
    present, previous = order[follows], order[before[follows]]
    torque = weight_torques(fit.model.arm, data)
    columns = joint_columns(fit.model, data.subset(present))[:3]
    result = {}
    for joint in joints:
        number = fit.model.arm.number(joint)
        column = columns[:, number]
        error = np.einsum("mn,mn->n", column, fit.residual[:3, present])
        error = error / np.maximum(np.linalg.norm(column, axis=0), 1e-12)
        # An accident of the instrument counts as seven times the median.
        limit = 7.0 * float(np.median(np.abs(error)))
        change = np.sign(torque[number, present] - torque[number, previous])
        regressors = [_polynomials(torque[number, present]), _polynomials(data.q[number, present])]
        if data.direction is not None:
            regressors.append(data.direction[number, present, None])
        matrix = np.concatenate(regressors, axis=1)
        change -= matrix @ np.linalg.lstsq(matrix, change, rcond=None)[0]
        products = change * np.clip(error, -limit, limit)
        size = float(np.linalg.norm(products))
        result[joint] = 2.0 * normal_cdf(-abs(float(products.sum())) / size) if size > 0.0 else 1.0
    return result


def previous_visit(q: Array) -> NDArray[np.int64]:
    """Return for each column of ``(J, N)`` the number ``(N,)`` of the last earlier column that differs from it.

    It is -1 for the first column and its repeats.
    """
    changed = np.zeros(q.shape[1], dtype=bool)
    changed[1:] = np.any(q[:, 1:] != q[:, :-1], axis=0)
    start = np.maximum.accumulate(np.where(changed, np.arange(q.shape[1]), 0))
    return np.asarray(start - 1, dtype=np.int64)


def _polynomials(values: Array) -> Array:
    """Return ``(N, 5)`` Chebyshev polynomials up to degree 4 of the ranks of ``(N,)``."""
    ranks = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    scaled = 2.0 * ranks / max(values.size - 1, 1) - 1.0
    return np.asarray(np.polynomial.chebyshev.chebvander(scaled, 4), dtype=np.float64)
