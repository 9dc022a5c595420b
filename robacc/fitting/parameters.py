"""Fitted coefficients as a result reports them: value, standard error, unit, and why there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.robots.description import Frame, Robot

_COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
CORRELATED = 0.9
"""Correlation beyond which two coefficients are named as hardly told apart."""


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """One coefficient."""

    name: str
    value: float
    std: float | None
    unit: str
    why: str | None = None
    """Where ``std`` is None: why there is no number."""


@dataclass(frozen=True, slots=True)
class Correlation:
    """Two coefficients that the poses hardly tell apart."""

    first: str
    second: str
    value: float


def parameters(found: Fit) -> tuple[FittedParameter, ...]:
    """Every coefficient. Frames are where they are in the measuring frame; the rest are differences from the file."""
    fitted = _frames(found)
    frames = {
        f"{prefix}.{label}": value
        for prefix, frame in fitted.items()
        for label, value in zip(_COORDINATES, (*frame.xyz, *frame.rpy), strict=True)
    }
    dropped = {one.name: one.why for one in found.dropped}
    deviation = _deviations(_of_coordinates(found, fitted))
    result = []
    for i, (name, term) in enumerate(zip(found.names, found.terms, strict=True)):
        value = frames.get(name, float(found.theta[i]))
        known = bool(np.isfinite(deviation[i]))
        why = None if known else dropped.get(name, "not identifiable")
        result.append(FittedParameter(name, value, float(deviation[i]) if known else None, term.unit, why))
    return tuple(result)


def correlations(found: Fit) -> tuple[Correlation, ...]:
    """Pairs of coefficients correlated by more than :data:`CORRELATED`, strongest first."""
    kept = found.identifiability.kept
    if kept.size < 2:
        return ()
    matrix = found.covariance[np.ix_(kept, kept)]
    scale = _deviations(matrix)
    with np.errstate(divide="ignore", invalid="ignore"):  # of a deviation of zero, without noise, nothing is told
        matrix = matrix / scale[:, None] / scale
    rows, columns = np.nonzero(np.triu(np.abs(matrix) > CORRELATED, 1))
    pairs = [
        Correlation(found.names[kept[i]], found.names[kept[j]], float(matrix[i, j]))
        for i, j in zip(rows, columns, strict=True)
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.value)))


def _deviations(covariance: Array) -> Array:
    """Roots of the diagonal; NaN where poses too much alike left rounding of either sign there."""
    variance = np.diag(covariance)
    result: Array = np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    return result


def _of_coordinates(found: Fit, frames: Mapping[str, Frame]) -> Array:
    """``(P, P)`` covariance with roll, pitch and yaw of frames in place of the turns about their own axes.

    A frame's turns w are the rates of its angles times a matrix of roll and pitch, which is the identity only where
    these are zero. A turn that the poses do not show stands still.
    """
    covariance = found.covariance.copy()
    for prefix, frame in frames.items():
        own = [found.names.index(f"{prefix}.{label}") for label in _COORDINATES[3:]]
        block = np.nan_to_num(covariance[np.ix_(own, own)])
        (sr, sp, _), (cr, cp, _) = np.sin(frame.rpy), np.cos(frame.rpy)
        rates = np.linalg.inv([[1.0, 0.0, -sp], [0.0, cr, cp * sr], [0.0, -sr, cp * cr]])
        covariance[own, own] = np.diag(rates @ block @ rates.T) + 0.0 * covariance[own, own]  # NaN stays
    return covariance


def _frames(found: Fit) -> dict[str, Frame]:
    """Base and tool where they were fitted, by the beginning of their coefficients' names."""
    free = {effect.name for effect in found.model.free}
    if not free & {"base_frame", "tool_frame"}:
        return {}
    robot: Robot = apply_fit(found)
    frames: dict[str, Frame] = {}
    if "base_frame" in free:
        frames["base_frame"] = robot.base
    if "tool_frame" in free:
        if robot.targets:
            frames |= {f"tool_frame.{name}": frame for name, frame in robot.targets.items()}
        else:
            frames["tool_frame"] = robot.tool
    return frames
