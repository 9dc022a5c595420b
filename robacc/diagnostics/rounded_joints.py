"""Joint variables that were recorded with few digits: rounding as scatter of the joints.

A variable rounded to a step s has an error of variance s^2 / 12 (B. Widrow, I. Kollár, Quantization Noise, 2008). A
command in whole steps has none, so the step alone decides nothing: the residual must scatter as rounding would make it.
With C_i the Jacobian of the joint variables at row i, the Gaussian log-likelihoods of the covariances v I and
v I + C_i diag(s^2 / 12) C_i^T, each at its best v, are compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Robot

_DIGITS = range(5)
"""Decimals of degrees, mm, rad and m that a step may have."""
_UNITS = {"revolute": (("degrees", math.pi / 180), ("rad", 1.0)), "prismatic": (("mm", 1e-3), ("m", 1.0))}
_WHOLE_TOLERANCE = 1e-4
"""Largest deviation from whole steps, in steps: the rounding of a file that has the variables in another unit."""
_FEWEST = 12
"""Different values of a joint from which whole steps are no accident."""
_EVIDENT = 5.0
"""Gain in log-likelihood from which the residual shows the rounding (odds of 150 to 1)."""
_LEAST_RESIDUAL = 1e-3
"""Least residual, over the size of the rounding, that can show it; exact data make the covariances singular."""
_SHARES = np.geomspace(1e-3, 1.2, 24)
"""Noise that is tried, over the root mean square of the residual."""


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
    if np.unique(values).size < _FEWEST:
        return None
    steps = [(size / 10**digits, digits, unit) for unit, size in _UNITS[kind] for digits in _DIGITS]
    for step, digits, unit in sorted(steps, reverse=True):
        multiples = values / step
        if np.all(np.abs(multiples - np.round(multiples)) <= _WHOLE_TOLERANCE):
            return step, f"{10.0**-digits:g} {unit}"
    return None


def evident_rounding(fit: Fit, data: Measurements) -> Rounding | None:
    """Return the rounding of the joint variables; None if there is none, or if the residual does not show it."""
    rows = np.flatnonzero(fit.inliers)
    return _evident_rounding(fit.model, data.subset(rows), fit.residual[:3, rows])


def rounding_in_errors(robot: Robot, data: Measurements, errors: Array) -> tuple[str, ...]:
    """Return the warning of a rounding of the joint variables that position errors show; empty without one.

    Args:
        robot: The robot of the commanded poses, registered.
        data: The measured poses.
        errors: ``(3, N)`` attained minus commanded positions in the measuring frame, m.
    """
    rounding = _evident_rounding(Model.of(robot), data, errors)
    return () if rounding is None else (f"{rounding.size}; record more digits",)


def _evident_rounding(model: Model, data: Measurements, residual: Array) -> Rounding | None:
    if data.q is None:
        return None
    arm = model.arm
    steps = [
        joint_step(row, "revolute" if arm.is_revolute(name) else "prismatic")
        for name, row in zip(arm.names, data.q, strict=True)
    ]
    present = [step for step in steps if step is not None]
    if not present:
        return None
    std = np.array([0.0 if step is None else step[0] for step in steps]) / math.sqrt(12.0)
    columns = joint_columns(model, data)[:3] * std[:, None]
    covariance = np.einsum("ajn,bjn->nab", columns, columns)
    position = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))
    if rms_length(residual) <= _LEAST_RESIDUAL * position:
        return None
    if _likelihood(residual, covariance) - _likelihood(residual, np.zeros_like(covariance)) < _EVIDENT:
        return None
    return Rounding(max(present)[1], std, position)


def _likelihood(residual: Array, covariance: Array) -> float:
    """Return the largest log-likelihood of ``(3, N)`` for covariances ``(N, 3, 3)`` plus white noise, in m and m²."""
    size = float(np.sqrt(np.mean(np.square(residual))))
    best = -np.inf
    for share in _SHARES:
        full = covariance + (share * size) ** 2 * np.eye(3)
        solved = np.linalg.solve(full, residual.T[:, :, None])[:, :, 0]
        squares = float(np.sum(solved * residual.T))
        best = max(best, -0.5 * (squares + float(np.sum(np.linalg.slogdet(full)[1]))))
    return best
