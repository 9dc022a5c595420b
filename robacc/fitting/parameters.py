"""Fitted coefficients: as a result reports them, written into a robot, and the leverage of rows on them."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.drivers import united
from robacc.effects.specification import Known, absorbed, entry_of, known_effects
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import posterior
from robacc.geometry import Array
from robacc.robots.arm import BLOCK
from robacc.robots.description import FRAME_PARAMETERS, Frame, Robot

# Write a fit into a robot: constants into its own numbers, other effects into its list of effects.


def apply_fit(fit: Fit) -> Robot:
    """Return the robot that predicts the same as the fit, to rounding.

    Coefficients that are not identifiable on the poses stay at their nominal value.
    """
    values: list[dict[str, float]] = [{} for _ in fit.model.free]
    for name, owner, value in zip(fit.names, fit.owners, fit.theta, strict=True):
        values[owner][name] = float(value)
    fitted = [Known(*effect) for effect in zip(fit.model.free, values, fit.validity, strict=True)]
    classes = {type(known.effect) for known in fitted if known.effect.traits.is_constant}
    # Listed constants that add to fitted ones are absorbed with them: turns of one frame do not commute.
    constants = [known for known in (*fitted, *fit.model.known) if type(known.effect) in classes]
    listed = [known for known in fit.model.known if type(known.effect) not in classes]
    keys = [known.effect.key() for known in listed]
    for known in fitted:
        changes = {name: value for name, value in known.values.items() if value != 0}
        if known.effect.traits.is_constant:
            continue
        if known.effect.key() in keys:
            at = keys.index(known.effect.key())
            sums = {
                name: listed[at].values.get(name, 0.0) + changes.get(name, 0.0)
                for name in {**listed[at].values, **changes}
            }
            listed[at] = Known(known.effect, sums, united(listed[at].validity, known.validity))
        elif changes:
            listed.append(dataclasses.replace(known, values=changes))
    return _written(fit.model.arm.robot, constants, listed)


def absorb_constants(robot: Robot) -> Robot:
    """Return the robot with the constant effects of its file in its own numbers; other effects stay listed, in SI.

    Raises:
        InputError: the file's ``effects:`` cannot be read.
    """
    known = known_effects(robot)
    constants = [each for each in known if each.effect.traits.is_constant]
    return _written(robot, constants, [each for each in known if not each.effect.traits.is_constant])


def _written(robot: Robot, constants: Sequence[Known], listed: Sequence[Known]) -> Robot:
    """Return the robot with constants written into its numbers, and the list of its other effects."""
    sums: dict[str, float] = {}
    for known in constants:
        for name, value in known.values.items():
            sums[name] = sums.get(name, 0.0) + value
    entries = tuple(entry_of(known.effect, known.values, known.validity) for known in listed)
    robot = absorbed(robot, [known.effect for known in constants], sums)
    return dataclasses.replace(robot, effects=entries, effect_units=(1.0, 1.0))


# Leverage: the share of a row in its own prediction.


def high_leverage(fit: Fit) -> tuple[tuple[int, float], ...]:
    """Return the rows that decide half of their own prediction: index and mean diagonal of the hat matrix."""
    inverse, share = posterior(fit.gram, fit.precision), np.empty(fit.data.n)
    for start in range(0, fit.data.n, BLOCK):
        block = np.arange(start, min(start + BLOCK, fit.data.n))
        columns = fit.jacobian(block, len(fit.residual)) * fit.weight[:, None, block]
        share[block] = np.einsum("mpn,mpn->n", inverse @ columns, columns) / len(fit.residual)
    high = np.flatnonzero((share > 0.5) & fit.inliers)
    return tuple((int(row), float(share[row])) for row in high[np.argsort(-share[high])])


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
    frames = _frames(fit)
    # Numbers in place of coefficients by their names, which only steps and drifts share.
    values = {f"base_frame.{name}.radius": each.radius for name, each in apply_fit(fit).fixtures.items()}
    why = dict.fromkeys(fit.names, "not identifiable")
    for prefix, frame in frames.items():
        names = [f"{prefix}.{label}" for label in FRAME_PARAMETERS]
        values |= dict(zip(names, (*frame.xyz, *frame.rpy), strict=True))
        if _is_at_pole(frame):
            reason = "the pitch is 90 degrees, where roll and yaw turn about the same axis"
            why |= {names[3]: reason, names[5]: reason}
    why |= {missing.name: missing.why for missing in fit.identifiability.dropped}
    stds = _stds(_coordinate_covariance(fit, frames)).tolist()
    return tuple(
        FittedParameter(term.name, values.get(term.name, own), std, term.unit)
        if math.isfinite(std)
        else FittedParameter(term.name, values.get(term.name, own), None, term.unit, why[term.name])
        for term, own, std in zip(fit.terms, fit.theta.tolist(), stds, strict=True)
    )


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
    return np.asarray(np.sqrt(np.where(variance >= 0.0, variance, np.nan)))


def _coordinate_covariance(fit: Fit, frames: Mapping[str, Frame]) -> Array:
    """Return ``(P, P)`` the covariance with roll, pitch and yaw of frames in place of the turns about their own axes.

    A frame's turns w are the rates of its angles times a matrix of roll and pitch, which is the identity only where
    these are zero. A turn that is not identifiable stands still. At a pitch of 90 degrees roll and yaw have no
    variance of their own.
    """
    known = np.isfinite(np.diag(fit.covariance))
    rates = np.eye(known.size)
    for prefix, frame in frames.items():
        if f"{prefix}.roll" not in fit.names:
            continue
        angles = [fit.names.index(f"{prefix}.{label}") for label in FRAME_PARAMETERS[3:]]
        # The matrix from turns about a frame's axes to rates of its angles; at a pole the pitch's.
        (sr, sp, _), (cr, cp, _) = np.sin(frame.rpy), np.cos(frame.rpy)
        if _is_at_pole(frame):
            known[angles] = [False, known[angles].all(), False]
            rates[np.ix_(angles, angles)] = [[0.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, 0.0, 0.0]]
        else:
            turns = [[1.0, 0.0, -sp], [0.0, cr, cp * sr], [0.0, -sr, cp * cr]]
            rates[np.ix_(angles, angles)] = np.linalg.inv(turns)
    result: Array = rates @ np.nan_to_num(fit.covariance) @ rates.T
    result[~known] = result[:, ~known] = np.nan
    return result


def _is_at_pole(frame: Frame) -> bool:
    return abs(float(np.cos(frame.rpy[1]))) < _POLE


def _frames(fit: Fit) -> dict[str, Frame]:
    """Return the fitted base and tool frames, by the prefix of their coefficients' names."""
    free = {effect.name for effect in fit.model.free}
    if not free & {"base_frame", "tool_frame"}:
        return {}
    robot = apply_fit(fit)
    bases = {"base_frame": robot.base} | {f"base_frame.{name}": each.base for name, each in robot.fixtures.items()}
    frames = bases if "base_frame" in free else {}
    if "tool_frame" in free:
        targets = {f"tool_frame.{name}": frame for name, frame in robot.targets.items()}
        frames |= targets or {"tool_frame": robot.tool}
    return frames
