"""Fitted coefficients: as a result reports them, written into a robot, and the leverage of rows on them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robacc.chain import BLOCK
from robacc.effects.drivers import Validity, united
from robacc.effects.specification import Known, absorbed, entry_of, known_effects
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import posterior
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Frame, Robot

# Write a fit into a robot: constants into its own numbers, other effects into its list of effects.


def apply_fit(fit: Fit) -> Robot:
    """Return the robot that predicts the same as the fit, to rounding.

    Coefficients that are not identifiable on the poses stay at their nominal value.
    """
    values: list[dict[str, float]] = [{} for _ in fit.model.free]
    for name, owner, value in zip(fit.names, fit.owners, fit.theta, strict=True):
        values[owner][name] = float(value)
    return apply_values(fit.model, values, fit.validity)


def apply_values(
    model: Model, values: Sequence[Mapping[str, float]], validity: Sequence[Validity] | None = None
) -> Robot:
    """Return the robot with coefficients given by name, for each of the model's free effects.

    ``validity`` holds the ranges that each effect was fitted on, if known.
    """
    limits = validity if validity is not None else ({},) * len(model.free)
    constant = [Known(effect, v) for effect, v in zip(model.free, values, strict=True) if effect.traits.is_constant]
    classes = {type(known.effect) for known in constant}
    # Listed constants that add to fitted ones are absorbed with them: turns of one frame do not commute.
    constant += [known for known in model.known if type(known.effect) in classes]
    robot = _with_constants(model.arm.robot, constant)
    listed = [known for known in model.known if type(known.effect) not in classes]
    for effect, coefficients, limit in zip(model.free, values, limits, strict=True):
        if effect.traits.is_constant:
            continue
        nonzero = {name: value for name, value in coefficients.items() if value != 0}
        place = next((i for i, known in enumerate(listed) if known.effect.key() == effect.key()), None)
        if place is not None:
            before = listed[place].values
            sums = {name: before.get(name, 0.0) + nonzero.get(name, 0.0) for name in {**before, **nonzero}}
            listed[place] = Known(effect, sums, united(listed[place].validity, limit))
        elif nonzero:
            listed.append(Known(effect, nonzero, limit))
    entries: list[Mapping[str, Any]] = [entry_of(known.effect, known.values, known.validity) for known in listed]
    return dataclasses.replace(robot, effects=tuple(entries), effect_units=(1.0, 1.0))


def absorb_constants(robot: Robot) -> Robot:
    """Return the robot with the constant effects of its file in its own numbers; other effects stay listed, in SI.

    Raises:
        InputError: the file's ``effects:`` cannot be read.
    """
    known = known_effects(robot)
    entries = [entry_of(k.effect, k.values, k.validity) for k in known if not k.effect.traits.is_constant]
    robot = _with_constants(robot, [k for k in known if k.effect.traits.is_constant])
    return dataclasses.replace(robot, effects=tuple(entries), effect_units=(1.0, 1.0))


def _with_constants(robot: Robot, constants: Sequence[Known]) -> Robot:
    """Return the robot with constants written into its numbers."""
    sums: dict[str, float] = {}
    for known in constants:
        for name, value in known.values.items():
            sums[name] = sums.get(name, 0.0) + value
    return absorbed(robot, [known.effect for known in constants], sums)


# Leverage: the share of a row in its own prediction.

_HIGH_LEVERAGE = 0.5
"""Share of a row in its own prediction above which the row is reported."""


def high_leverage(fit: Fit, data: Measurements) -> tuple[tuple[int, float], ...]:
    """Return the rows with high leverage: index and mean diagonal of the hat matrix over the components."""
    identifiable = fit.identifiability.columns
    if identifiable.size == 0:
        return ()
    inverse = posterior(fit.gram, fit.precision)
    share = np.empty(data.n)
    for start in range(0, data.n, BLOCK):
        block = slice(start, start + BLOCK)
        _, jacobian = fit.model.bind(data.subset(block)).linearise(fit.theta, identifiable, fit.residual.shape[0])
        columns = jacobian * fit.weight[:, None, block]
        share[block] = np.einsum("mpn,mpn->n", inverse @ columns, columns) / fit.residual.shape[0]
    high = np.flatnonzero((share > _HIGH_LEVERAGE) & fit.inliers)
    return tuple((int(row), float(share[row])) for row in high[np.argsort(-share[high])])


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


def correlations(names: Sequence[str], covariance: Array) -> tuple[Correlation, ...]:
    """Return pairs of coefficients correlated by more than :data:`CORRELATED`, strongest first."""
    scale = _stds(covariance)
    with np.errstate(divide="ignore", invalid="ignore"):  # without noise, standard errors are zero
        # Where only a weak prior separates two coefficients, rounding takes their correlation beyond one.
        matrix = np.clip(covariance / scale[:, None] / scale, -1.0, 1.0)
    pairs = [
        Correlation(names[i], names[j], float(matrix[i, j]))
        for i, j in np.argwhere(np.triu(np.abs(matrix) > CORRELATED, 1)).tolist()
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
