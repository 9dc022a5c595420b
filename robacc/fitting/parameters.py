"""Fitted coefficients as a result reports them: value, standard error, unit, and why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robacc.fitting.folding import fold
from robacc.fitting.registration import frame_parameters
from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.robots.description import Frame, Robot

CORRELATED = 0.9
"""Correlation beyond which two coefficients are named as hardly told apart."""


@dataclass(frozen=True, slots=True)
class Parameter:
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


def parameters(found: Fit) -> tuple[Parameter, ...]:
    """Every coefficient. Frames are where they are in the measuring frame; the rest are differences from the file."""
    frames = _frame_values(found)
    dropped = {one.name: one.why for one in found.dropped}
    deviation = _deviations(found.covariance)
    result = []
    for i, (name, term) in enumerate(zip(found.names, found.terms, strict=True)):
        value = frames.get(name, float(found.theta[i]))
        known = bool(np.isfinite(deviation[i]))
        why = None if known else dropped.get(name, "not identifiable")
        result.append(Parameter(name, value, float(deviation[i]) if known else None, term.unit, why))
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


def _frame_values(found: Fit) -> dict[str, float]:
    """Coordinates of base and tool where they were fitted."""
    free = {effect.name for effect in found.model.free}
    if not free & {"base_frame", "tool_frame"}:
        return {}
    robot: Robot = fold(found)
    frames: dict[str, Frame] = {}
    if "base_frame" in free:
        frames["base_frame"] = robot.base
    if "tool_frame" in free:
        if robot.targets:
            frames |= {f"tool_frame.{name}": frame for name, frame in robot.targets.items()}
        else:
            frames["tool_frame"] = robot.tool
    return {name: value for prefix, frame in frames.items() for name, value, _ in frame_parameters(prefix, frame)}
