"""Fitted coefficients as a result reports them: value, standard error, unit, and the reason if there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.robots.description import Frame, Robot

_COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
_POLE = 1e-3
"""Cosine of the pitch below which roll and yaw turn about the same axis: the poses determine their sum alone."""
CORRELATED = 0.9
"""Correlation above which two coefficients are listed."""


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """One coefficient and its standard error."""

    name: str
    value: float
    std: float | None
    unit: str
    why: str | None = None
    """Reason if ``std`` is None."""


@dataclass(frozen=True, slots=True)
class ParameterCovariance:
    """Covariance of the coefficients that have a standard error, in the units of the coefficients."""

    names: tuple[str, ...]
    matrix: Array
    """``(K, K)``; the roots of its diagonal are the standard errors."""


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two coefficients whose estimates are strongly correlated."""

    first: str
    second: str
    value: float


def parameters(fit: Fit) -> tuple[FittedParameter, ...]:
    """Return every coefficient: frames in the measuring frame, other coefficients as differences from nominal."""
    fitted = _frames(fit)
    frames = {
        f"{prefix}.{label}": value
        for prefix, frame in fitted.items()
        for label, value in zip(_COORDINATES, (*frame.xyz, *frame.rpy), strict=True)
    }
    dropped = {missing.name: missing.why for missing in fit.dropped}
    stds = _stds(_coordinate_covariance(fit, fitted))
    at_pole = {
        f"{prefix}.{label}": "the pitch is 90 degrees, where roll and yaw turn about the same axis"
        for prefix, frame in fitted.items()
        if _is_at_pole(frame)
        for label in ("roll", "yaw")
    }
    result = []
    for i, (name, term) in enumerate(zip(fit.names, fit.terms, strict=True)):
        value = frames.get(name, float(fit.theta[i]))
        known = bool(np.isfinite(stds[i]))
        why = None if known else dropped.get(name, at_pole.get(name, "not identifiable"))
        result.append(FittedParameter(name, value, float(stds[i]) if known else None, term.unit, why))
    return tuple(result)


def parameter_covariance(fit: Fit) -> ParameterCovariance:
    """Return the covariance of the coefficients as :func:`parameters` reports them, without those of no error."""
    covariance = _coordinate_covariance(fit, _frames(fit))
    known = np.flatnonzero(np.isfinite(_stds(covariance)))
    return ParameterCovariance(tuple(fit.names[i] for i in known), covariance[np.ix_(known, known)])


def correlations(fit: Fit) -> tuple[Correlation, ...]:
    """Return pairs of coefficients correlated by more than :data:`CORRELATED`, strongest first."""
    columns = fit.identifiability.columns
    if columns.size < 2:
        return ()
    matrix = fit.covariance[np.ix_(columns, columns)]
    scale = _stds(matrix)
    with np.errstate(divide="ignore", invalid="ignore"):  # without noise, standard errors are zero
        matrix = matrix / scale[:, None] / scale
    first, second = np.nonzero(np.triu(np.abs(matrix) > CORRELATED, 1))
    pairs = [
        Correlation(fit.names[columns[i]], fit.names[columns[j]], float(matrix[i, j]))
        for i, j in zip(first, second, strict=True)
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.value)))


def _stds(covariance: Array) -> Array:
    """Return the roots of the diagonal; NaN if rounding made a variance negative."""
    variance = np.diag(covariance)
    result: Array = np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    return result


def _coordinate_covariance(fit: Fit, frames: Mapping[str, Frame]) -> Array:
    """Return ``(P, P)`` the covariance with roll, pitch and yaw of frames in place of the turns about their own axes.

    A frame's turns w are the rates of its angles times a matrix of roll and pitch, which is the identity only where
    these are zero. A turn that is not identifiable stands still. At a pitch of 90 degrees roll and yaw have no
    variance of their own.
    """
    known = np.isfinite(np.diag(fit.covariance))
    rates = np.eye(known.size)
    for prefix, frame in frames.items():
        angles = [fit.names.index(f"{prefix}.{label}") for label in _COORDINATES[3:]]
        if _is_at_pole(frame):
            known[angles] = [False, known[angles].all(), False]
        rates[np.ix_(angles, angles)] = _rates(frame)
    result: Array = rates @ np.nan_to_num(fit.covariance) @ rates.T
    result[~known] = result[:, ~known] = np.nan
    return result


def _is_at_pole(frame: Frame) -> bool:
    return abs(float(np.cos(frame.rpy[1]))) < _POLE


def _rates(frame: Frame) -> Array:
    """Return the matrix ``(3, 3)`` from turns about a frame's axes to rates of its angles; at a pole the pitch's."""
    (sr, sp, _), (cr, cp, _) = np.sin(frame.rpy), np.cos(frame.rpy)
    if _is_at_pole(frame):
        return np.array([[0.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, 0.0, 0.0]])
    return np.asarray(np.linalg.inv([[1.0, 0.0, -sp], [0.0, cr, cp * sr], [0.0, -sr, cp * cr]]), dtype=np.float64)


def _frames(fit: Fit) -> dict[str, Frame]:
    """Return the fitted base and tool frames, by the prefix of their coefficients' names."""
    free = {effect.name for effect in fit.model.free}
    if not free & {"base_frame", "tool_frame"}:
        return {}
    robot: Robot = apply_fit(fit)
    frames: dict[str, Frame] = {}
    if "base_frame" in free:
        frames["base_frame"] = robot.base
    if "tool_frame" in free:
        if robot.targets:
            frames |= {f"tool_frame.{name}": frame for name, frame in robot.targets.items()}
        else:
            frames["tool_frame"] = robot.tool
    return frames
