"""A fitted model: the record of its fit, its uncertainty at given poses, the accuracy it predicts, and its coverage.

The error of the calibrated arm against its model has the covariance

    V = J C J^T + J_q S J_q^T + R U R^T + X,

a sum of outer products of columns, with J the Jacobian of the pose to the fitted coefficients and C their covariance,
J_q that to the joints and S the variances of their scatter, U the covariance of the unexplained error in the target's
frame and R its orientation. X is what effects add beyond the ranges that they were fitted on.

Effects of the measurement (a scale of the instrument, a drift of its frame) move measured poses, not the arm. On
measured poses their columns cancel errors of the arm's coefficients, so J has none of them where the arm's pose counts.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.accuracy.grade import Scale
from robacc.effects.base import Effect, Part, Term, effect_class
from robacc.effects.drivers import MARGIN, Validity, driver_values, is_outside, nearest_image, range_excess
from robacc.effects.specification import Known, faded
from robacc.errors import InputError, Problem, RobaccError, applying, refuse
from robacc.fitting.fit_result import Fit
from robacc.fitting.parameters import absorb_constants, apply_fit
from robacc.fitting.registration import registration_fit
from robacc.fitting.visits import random_rows
from robacc.geometry import Array, Poses, log_between, rotate_back
from robacc.measurements import Measurements, different, numbered
from robacc.modelling.model import Model, joint_columns, predict, residuals
from robacc.prediction.predicting import (
    RADIUS_PROBABILITY,
    Configurations,
    Prediction,
    in_tool_frame,
    largest_first,
    outer_sums,
    predicted,
    with_shares,
)
from robacc.robots.arm import BLOCK
from robacc.robots.description import Robot
from robacc.statistics.intervals import normal_quantile
from robacc.statistics.lengths import length_quantiles, principal_variances

if TYPE_CHECKING:
    from robacc.error_model.structure import Repeatability


@dataclass(frozen=True)
class ModelFit:
    """What a model file knows of its own fit."""

    effects: tuple[Effect, ...]
    """Effects that were fitted."""
    coefficients: tuple[str, ...]
    """Names of the identifiable coefficients, P of them."""
    covariance: Array
    """``(P, P)`` of the coefficients, SI."""
    nominal: Mapping[str, Mapping[str, float]]
    """Numbers of the joints before the fit, where they differ, by joint; m and rad."""
    repeatability: Mapping[str, float]
    """Standard deviation of the scatter of each joint, rad or m, as far as it is identifiable."""
    unexplained: Array
    """``(M, M)`` covariance of the unexplained error in the target's frame; M is 3 for positions alone, else 6."""
    noise: tuple[float, float | None]
    """Standard deviation of the measurement noise, m and rad; where it is not separate, of all that is unexplained."""
    noise_is_separate: bool
    """``unexplained`` has no measurement noise: the poses of the fit state it, or it was separated from the scatter."""
    bound_factor: tuple[float, float]
    """Factor of the bounds of position and orientation errors that gives them their coverage on held-out poses."""
    largest_correction: tuple[float, float]
    """Largest difference between model and nominal robot on the poses of the fit, m and rad."""
    ranges: Mapping[str, tuple[float, float]]
    """Lowest and highest value over the poses of the fit, by joint and by column of circumstances."""
    n_poses: int
    suspicions: tuple[str, ...] = ()
    """Data mistakes that the fit made likely, in words."""

    def entry(self) -> dict[str, Any]:
        """Return the part of the robot file as plain values."""
        return {
            "effects": [
                {
                    "effect": effect.name,
                    **({"joints": list(effect.joints)} if effect.joints else {}),
                    **effect.settings(),
                }
                for effect in self.effects
            ],
            "coefficients": list(self.coefficients),
            "covariance": [_text(row[: i + 1]) for i, row in enumerate(self.covariance)],
            "nominal": {joint: dict(numbers) for joint, numbers in self.nominal.items()},
            "repeatability": dict(self.repeatability),
            "unexplained": [_text(row[: i + 1]) for i, row in enumerate(self.unexplained)],
            "noise": {
                "position": self.noise[0],
                "orientation": self.noise[1],
                "separate": self.noise_is_separate,
            },
            "bound_factor": {"position": self.bound_factor[0], "orientation": self.bound_factor[1]},
            "largest_correction": {
                "position": self.largest_correction[0],
                "orientation": self.largest_correction[1],
            },
            "ranges": {name: [float(low), float(high)] for name, (low, high) in self.ranges.items()},
            "n_poses": self.n_poses,
            **({"suspected_mistakes": list(self.suspicions)} if self.suspicions else {}),
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return a warning for users of the model whose fit made a data mistake likely."""
        return tuple(f"doubtful model: {text}" for text in self.suspicions)


def model_fit(robot: Robot) -> ModelFit | None:
    """Return the record of a robot's fit; None for a robot without one.

    Raises:
        InputError: The part cannot be read.
    """
    if robot.fit is None:
        return None
    try:
        return _read(robot.fit)
    except (KeyError, TypeError, ValueError, RobaccError) as error:
        message = f"cannot be read: {error}" if not isinstance(error, KeyError) else f"the key {error} is missing"
        fix = "`write_model` of a trace or a calibration writes it; do not change it, or remove this part completely"
        raise InputError(Problem(message, robot.name, column="fit", fix=fix)) from None


def _read(entry: Mapping[str, Any]) -> ModelFit:
    noise, factor, largest = entry["noise"], entry["bound_factor"], entry["largest_correction"]
    names = tuple(str(name) for name in entry["coefficients"])
    covariance = _symmetric(entry["covariance"])
    refuse(
        (covariance.shape[0] != len(names), f"{len(names)} coefficients, but a covariance of {covariance.shape[0]}"),
        error=ValueError,
    )
    orientation = noise["orientation"]
    return ModelFit(
        effects=tuple(
            effect_class(str(item["effect"])).from_settings(
                tuple(item.get("joints", ())), {key: item[key] for key in item if key not in ("effect", "joints")}
            )
            for item in entry["effects"]
        ),
        coefficients=names,
        covariance=covariance,
        nominal={joint: {k: float(v) for k, v in numbers.items()} for joint, numbers in entry["nominal"].items()},
        repeatability={joint: float(std) for joint, std in entry["repeatability"].items()},
        unexplained=_symmetric(entry["unexplained"]),
        noise=(float(noise["position"]), None if orientation is None else float(orientation)),
        noise_is_separate=bool(noise.get("separate", False)),
        bound_factor=(float(factor["position"]), float(factor["orientation"])),
        largest_correction=(float(largest["position"]), float(largest["orientation"])),
        ranges={name: (float(low), float(high)) for name, (low, high) in entry["ranges"].items()},
        n_poses=int(entry["n_poses"]),
        suspicions=tuple(str(text) for text in entry.get("suspected_mistakes", ())),
    )


def _text(row: Array) -> str:
    """Return numbers as one text: a list of each would make the file long and slow to read."""
    return " ".join(f"{value:.12g}" for value in row.tolist())


def _symmetric(rows: Sequence[Any]) -> Array:
    """Return the symmetric matrix whose lower triangle is written row by row."""
    result = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        values = [float(number) for number in str(row).split()]
        refuse(
            (
                len(values) != i + 1 or not np.all(np.isfinite(values)),
                f"row {i + 1} of a covariance has {len(values)} numbers, expected {i + 1} finite ones",
            ),
            error=ValueError,
        )
        result[i, : i + 1] = result[: i + 1, i] = values
    return result


# Covariances of the model's error at given poses.

SOURCES = ("coefficients", "repeatability", "unexplained", "extrapolation")


def model_uncertainty(robot: Robot, fit: ModelFit, data: Measurements, *, measured: bool) -> tuple[Array, Array, Array]:
    """Return the uncertainty of the model ``robot`` at the joints and circumstances of ``data``.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        data: Poses with their circumstances.
        measured: The poses are those that the instrument of the fit measures; else those of the arm itself.

    Returns:
        Covariances ``(2, 3, 3, N)`` of position (m²) and orientation (rad²) in the measuring frame, the latter without
        the unexplained error where the fit had no measured orientations; the predicted orientation ``(3, 3, N)`` of the
        target; and the mean trace ``(4, 2)`` of each of :data:`SOURCES`.

    Raises:
        UsageError: The poses lack what an effect of the model depends on.
    """
    robot = absorb_constants(robot)
    covariances, rotation = np.empty((2, 3, 3, data.n)), np.empty((3, 3, data.n))
    traces = np.zeros((len(SOURCES), 2))
    for start in range(0, data.n, BLOCK):
        block = slice(start, start + BLOCK)
        sources, rotation[..., block] = error_columns(robot, fit, data.subset(block), measured)
        for part, factor in enumerate(fit.bound_factor):
            *within, beyond = (columns[3 * part : 3 * part + 3] for columns in sources)
            # The factors were found within the ranges of the fit.
            covariances[part, ..., block] = factor**2 * outer_sums(np.concatenate(within, axis=1)) + outer_sums(beyond)
            traces[:, part] += [np.sum(np.square(columns)) for columns in (*within, beyond)]
    return covariances, rotation, traces / max(data.n, 1)


def error_columns(
    robot: Robot, fit: ModelFit, data: Measurements, measured: bool, sample: Measurements | None = None
) -> tuple[tuple[Array, ...], Array]:
    """Return columns ``(6, K, n)`` of each of :data:`SOURCES`, and the predicted rotations ``(3, 3, n)``.

    The sum over the columns of their outer products is the covariance of the error from a source. With ``sample``, all
    poses, of which ``data`` are some, products of the columns of coefficients and extrapolation at two poses are the
    covariance of these too; see :func:`beyond_columns`.
    """
    model = Model.of(robot, tuple(effect for effect in fit.effects if measured or not effect.traits.is_of_measurement))
    if not measured:
        model = replace(model, known=tuple(k for k in model.known if not k.effect.traits.is_of_measurement))
    poses, jacobian, covariance = fitted_jacobian(model, fit, data)
    coefficients = _root(covariance).T @ jacobian
    stds = np.array([fit.repeatability.get(name, 0.0) for name in model.arm.names])
    scatter = joint_columns(model, data) * stds[:, None] if stds.any() else np.zeros((6, 0, data.n))
    root = np.zeros((6, len(fit.unexplained)))
    root[: len(fit.unexplained)] = _root(fit.unexplained)
    unexplained = np.einsum("ian,bak->bikn", poses.rotation, root.reshape(2, 3, -1)).reshape(6, -1, data.n)
    return (coefficients, scatter, unexplained, beyond_columns(model, data, sample)), poses.rotation


def _root(covariance: Array, scale: Array | None = None) -> Array:
    """Return ``L`` with ``L L^T`` the covariance, or the nearest positive semidefinite matrix.

    The rows, whose units may differ, are in units of ``scale``, else of their standard deviations.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0)) if scale is None else scale
    over = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / over[:, None] / over)
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def fitted_jacobian(model: Model, fit: ModelFit, data: Measurements) -> tuple[Poses, Array, Array]:
    """Return poses, their Jacobian ``(6, P, N)`` to the fitted coefficients, and the covariance ``(P, P)`` of these.

    Coefficients of the fit that the poses do not have, such as those of a target that was not measured, are left out.

    Args:
        model: The fitted robot, with the effects of the fit, or some of them, as free effects.
        fit: Record of the fit.
        data: Poses with their circumstances.
    """
    ranges = {known.effect.key(): known.validity for known in model.known}
    bound = model.bind(data, [ranges.get(effect.key(), {}) for effect in model.free], fades=False)
    numbers = {entry: i for i, entry in enumerate(_occurrences(bound.names))}
    pairs = [(i, numbers[entry]) for i, entry in enumerate(_occurrences(fit.coefficients)) if entry in numbers]
    known, columns = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    poses, jacobian = bound.linearise(np.zeros(len(bound.names)), columns)
    return poses, jacobian, fit.covariance[np.ix_(known, known)]


def _occurrences(names: Sequence[str]) -> list[tuple[str, int]]:
    """Return each name with the number of its earlier occurrences: two steps of the base share the names of theirs."""
    return [(name, names[:place].count(name)) for place, name in enumerate(names)]


# Uncertainty of effects and profiles beyond the ranges that they were fitted on.
#
# Beyond its range a held effect keeps its value at the end, and the truth goes on. The squared difference of two
# distant values of a stationary function is twice its mean square, on average. So the scalar that the effect moves has
# this variance from a tenth of the range beyond its end. From a whole range on the standard deviation grows in
# proportion, unless the effect is periodic, which bounds it. Effects with a physical reason to go on (compliance, gear
# ratio) have none of it.
#
# Beyond its range a profile fades to its level at the end of the range, while the variance of its coefficients grows
# to that of the prior. What fading takes from the profile also counts as a standard deviation: near the range the
# poses still say something of it.

_SAMPLES = 200
_SHARE = 0.1
"""Share of a range beyond its end at which nothing of the effect is known any more."""
_COLUMNS = {"time_s": "time", "temperature_c": "temperature", "payload_kg": "payload"}


def beyond_columns(model: Model, data: Measurements, sample: Measurements | None = None) -> Array:
    """Return columns ``(6, K, n)`` of the errors beyond the ranges of effects; their outer products are covariances.

    The error of a held effect is the same function of its drivers at every pose: a stationary Gaussian process of the
    drivers, less its value at the end of the range, with a correlation length of half of :data:`_SHARE` of the range.
    Source of the columns: A. Rahimi and B. Recht, "Random features for large-scale kernel machines", NIPS (2007), here
    at the points of an additive recurrence.

    Args:
        model: Model with its known effects.
        data: Poses with their circumstances.
        sample: All poses, of which ``data`` are some: they decide the size of an effect. Products of the columns at
            two poses are covariances too. With None, only those at one pose are, which takes fewer columns.
    """
    columns = [np.zeros((6, 0, data.n))]
    for known in model.known:
        columns += _held_columns(known, model, data, sample), _faded_column(known, model, data, sample or data)
    return np.concatenate(columns, axis=1)


def _held_columns(known: Known, model: Model, data: Measurements, sample: Measurements | None) -> Array:
    """Return the columns ``(6, K, n)`` of a held effect; none if no pose is beyond its ranges."""
    arm, (limits, periods) = model.arm, known.effect.limits(model.arm, known.validity)
    growth, places = np.zeros(data.n), []
    for name, (low, high) in limits.items():
        if (values := driver_values(arm, data, name)) is not None:
            length = max(high - low, 1e-12)
            excess = range_excess(values, low, high, periods.get(name)) / length
            growth = np.maximum(growth, np.where(excess > MARGIN, excess, 0.0))
            image = nearest_image(values, low, high, periods.get(name))
            places.append(np.stack((image, np.clip(image, low, high))) / length)
    # The standard deviation over the size of the effect.
    growth = np.maximum(np.minimum(growth / _SHARE, 1.0), 0.0 if known.effect.traits.is_bounded else growth)
    # With ``sample``, poses are a block of many, which all have the columns of every held effect.
    if not limits or not (places if sample is not None else growth.any()):
        return np.zeros((6, 0, data.n))
    waves = np.ones((1, data.n)) if sample is None else _difference_waves(np.array(places))
    inside = _within(model, data if sample is None else sample, limits)
    scalars: dict[int, Array] = {}
    for term in known.effect.terms(arm, inside):
        for part in (part for part in term.parts if part.loads is None and part.motion >= 0):
            before = scalars.get(part.motion, np.zeros(inside.n))
            scalars[part.motion] = before + known.values.get(term.name, 0.0) * part.factor
    sizes = np.sqrt(2.0 * np.mean(np.square([*scalars.values()]).reshape(len(scalars), inside.n), axis=1))
    columns = _motion_columns(model, data, tuple(scalars))[:, :, None] * (sizes[:, None, None] * growth * waves)
    return np.asarray(columns.reshape(6, -1, data.n))


def _motion_columns(model: Model, data: Measurements, motions: tuple[int, ...]) -> Array:
    """Return the derivative ``(6, len(motions), n)`` of the poses to the scalars of some motions."""
    terms = tuple(Term(f"motion{motion}", "", 1.0, (Part(motion),)) for motion in motions)
    return replace(replace(model, free=()).bind(data), terms=terms).linearise(np.zeros(len(terms)))[1]


def _difference_waves(places: Array) -> Array:
    """Return ``(K, n)`` the process at the poses less its value at the end of the range, of unit size.

    ``places`` ``(D, 2, n)`` are the drivers at both, in units of their ranges.
    """
    # The generalised golden ratio g with g^(D + 1) = g + 1 spreads points evenly in any number of dimensions.
    ratio, count = 2.0, len(places)
    for _ in range(50):
        ratio = (1.0 + ratio) ** (1.0 / (count + 1))
    # Pairs of waves that make up a process.
    points = np.clip(np.modf(0.5 + np.outer(np.arange(64), ratio ** -np.arange(1.0, count + 1)))[0], 1e-6, 1.0 - 1e-6)
    frequencies = np.array([[normal_quantile(value) for value in row] for row in points.tolist()])
    phase = np.tensordot(frequencies, places / (0.5 * _SHARE), axes=1)
    waves = np.concatenate([wave(phase[:, 0]) - wave(phase[:, 1]) for wave in (np.cos, np.sin)])
    length = np.linalg.norm(waves, axis=0)
    return np.asarray(waves / np.where(length > 0.0, length, 1.0))


def _within(model: Model, data: Measurements, limits: Validity) -> Measurements:
    """Return poses whose drivers are spread evenly over their ranges; all else is as in ``data``."""
    sample, rng = data.subset(np.arange(_SAMPLES) % data.n), np.random.default_rng(0)
    assert sample.q is not None
    changes: dict[str, Any] = {"q": sample.q.copy()}
    for name, (low, high) in limits.items():
        values = rng.permutation(np.linspace(low, high, _SAMPLES))
        if name in model.arm.names:
            changes["q"][model.arm.number(name)] = values
        elif name in _COLUMNS:
            changes[_COLUMNS[name]] = values
    return replace(sample, **changes)


def _faded_column(known: Known, model: Model, data: Measurements, sample: Measurements) -> Array:
    """Return what fading takes from an effect ``(6, 1, n)``; no column if no pose of ``sample`` is beyond its range."""
    limits, periods = known.effect.limits(model.arm, known.validity, fading=True)
    if not limits or not is_outside(model.arm, sample, limits, periods).any():
        return np.zeros((6, 0, data.n))
    lost: dict[int, Array] = {}
    for whole, rest in zip(
        known.effect.terms(model.arm, data), faded(known.effect, model.arm, data, known.validity), strict=True
    ):
        before, after = whole.parts[0], rest.parts[0]
        own = known.values.get(whole.name, 0.0) * (before.factor - after.factor)
        lost[before.motion] = lost.get(before.motion, np.zeros(data.n)) + own
    columns = _motion_columns(model, data, tuple(lost)) * np.array([*lost.values()])
    return np.asarray(columns.sum(axis=1, keepdims=True))


# Uncertainty of a model at measured poses whose base or tool was fitted to other measured poses.
#
# A registration spreads the errors of the model at its poses over all poses, and takes part of them away. With W the
# weights of the registration, A the columns of the frames, and e the errors at its poses, the error at another pose is
#
#     e_i - A_i N^-1 A^T W e,    N = A^T W A.
#
# Errors of the coefficients, and of effects beyond their ranges, are the same functions of the joints at all poses.
# Their columns G change to G_i - A_i N^-1 A^T W G. Scatter of the joints, unexplained error and noise are independent
# from pose to pose.


def registered_uncertainty(
    robot: Robot, fit: ModelFit, data: Measurements, registration: Fit, used: Measurements
) -> Array:
    """Return covariances ``(2, 3, 3, N)`` of position (m²) and orientation (rad²), measuring frame, noise included.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        data: Poses to judge, with their circumstances.
        registration: Fit of the frames.
        used: Poses of the registration.
    """
    frames = Model.of(absorb_constants(apply_fit(registration)), registration.model.free)
    robot = absorb_constants(robot)
    weight = np.where(registration.inliers, registration.weight, 0.0)
    size, rows = len(registration.names), weight.shape[0]
    normal, scatter, crossed = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, 1))
    for block, columns, correlated, independent in blocks_with_frames(robot, fit, used, data, frames):
        weighed = np.square(weight[:, block])[:, None] * columns[:rows]
        normal += np.einsum("ipn,iqn->pq", weighed, columns[:rows])
        scatter += np.einsum("ipn,ijn,jqn->pq", weighed, independent[:rows, :rows], weighed, optimize=True)
        crossed = crossed + np.einsum("ipn,ikn->pk", weighed, correlated[:rows], optimize=True)
    inverse = scaled_inverse(normal)
    moved, spread = inverse @ crossed, inverse @ scatter @ inverse
    covariances = np.empty((2, 3, 3, data.n))
    for block, columns, correlated, independent in blocks_with_frames(robot, fit, data, data, frames):
        changed = correlated - np.einsum("ipn,pk->ikn", columns, moved, optimize=True)
        for result, part in zip(covariances, (slice(0, 3), slice(3, 6)), strict=True):
            result[..., block] = outer_sums(changed[part]) + independent[part, part]
            result[..., block] += np.einsum("ipn,pq,jqn->ijn", columns[part], spread, columns[part], optimize=True)
    return covariances


def blocks_with_frames(
    robot: Robot, fit: ModelFit, data: Measurements, sample: Measurements, frames: Model
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield blocks of poses: columns of the frames and of correlated errors, and the covariance of the others."""
    factor = np.repeat(fit.bound_factor, 3)[:, None, None]
    for block in frames.arm.chain.blocks(data.n):
        part = data.subset(block)
        bound = frames.bind(part)
        (coefficients, *scatter, beyond), _ = error_columns(robot, fit, part, True, sample)
        correlated = np.concatenate((factor * coefficients, beyond), axis=1)
        independent = outer_sums(factor * np.concatenate(scatter, axis=1))
        for rows, covariance in zip((slice(0, 3), slice(3, 6)), _noise_covariances(fit, part), strict=True):
            independent[rows, rows] += covariance
        yield block, bound.linearise(np.zeros(len(bound.names)))[1], correlated, independent


def _noise_covariances(fit: ModelFit, data: Measurements) -> tuple[Array | float, Array | float]:
    """Return covariances ``(3, 3, N)`` of the noise of position and orientation that bounds of the model lack."""
    position, orientation = (
        0.0 if sigma is None or not fit.noise_is_separate else np.eye(3)[:, :, None] * np.square(sigma)
        for sigma in (data.sigma_position, data.sigma_rotation)
    )
    correlated = data.correlated_noise if fit.noise_is_separate else None
    return position if correlated is None else position + correlated, orientation


def scaled_inverse(normal: Array) -> Array:
    """Return the inverse of a normal matrix without its undetermined directions."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    # Eigenvalue of the scaled normal matrix, over the largest, below which a direction of the frames is not fitted.
    kept = values > 1e-12 * values[-1]
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T * scale[:, None] * scale)


# Predicted accuracy of a calibrated arm: what its model file knows of the fit, over poses or the workspace.


def calibrated_accuracy(
    robot: Robot, fit: ModelFit, configurations: Configurations, poses: Measurements | None, scale: Scale, seed: int
) -> Prediction:
    """Predict covariances and grade of a calibrated arm that is commanded through its model.

    Args:
        robot: The fitted robot.
        fit: Record of its fit.
        configurations: Configurations of equal weight.
        poses: Poses with circumstances at these configurations; None for configurations alone, which get directions
            of approach at random and other circumstances from the middle of the ranges of the fit.
        scale: Scale of the grade.
        seed: Seed of the directions.
    """
    if poses is None:
        names = np.repeat([*robot.targets][:1], configurations.n) if robot.targets else None
        poses = Measurements(position=np.zeros((3, configurations.n)), q=configurations.q, target=names)
    data = completed(fit, poses, seed)
    covariances, rotation, traces = model_uncertainty(robot, fit, data, measured=False)
    sources = [{"parameter": name, "joint": None, "kind": name, "sd": None, "unit": None} for name in SOURCES]
    low, high = np.array([fit.ranges.get(name, (-np.inf, np.inf)) for name in robot.variable_names]).T[..., None]
    outside = np.any((configurations.q < low) | (configurations.q > high), axis=0)
    notes = applying(
        (True, f"the model was fitted to {fit.n_poses} poses"),
        (
            outside.any(),
            f"{np.count_nonzero(outside)} of {data.n} configurations lie outside the joint ranges of the fit, where "
            "the unexplained error may be larger",
        ),
        (
            fit.unexplained.shape[0] < 6,
            "the fit had no measured orientations, so that of the prediction lacks the unexplained error",
        ),
    )
    return predicted(
        configurations,
        [in_tool_frame(part, rotation) for part in covariances],
        scale,
        parameters=(),
        budget=sorted(with_shares(sources, traces.T), key=largest_first),
        by_joint=(),
        by_kind=(),
        meaning="errors of the calibrated arm: coefficients of the fit, repeatability, and unexplained error",
        notes=(*configurations.notes, *notes),
    )


def completed(fit: ModelFit, poses: Measurements, seed: int) -> Measurements:
    """Return poses with every circumstance that an effect may depend on."""
    assert poses.q is not None
    drawn = np.random.default_rng([seed, poses.n]).choice(np.array([-1.0, 1.0]), poses.q.shape)
    direction = drawn if poses.direction is None else poses.direction
    middle: dict[str, Any] = {
        column: np.full(poses.n, 0.5 * sum(fit.ranges[name]))
        for name, column in _COLUMNS.items()
        if name in fit.ranges and getattr(poses, column) is None
    }
    return replace(poses, direction=direction, speed=direction if poses.speed is None else poses.speed, **middle)


# Coverage of a model's bounds: how many measured poses lie within the 95 % bound of their error.


def coverage(
    robot: Robot,
    fit: ModelFit,
    measured: Measurements,
    seed: int,
    aligned: Sequence[str] = (),
    noise: tuple[float | None, float | None] = (None, None),
) -> Mapping[str, Any]:
    """Return the coverage of position, and of orientation where poses and fit have it, with the keys of the result.

    The source of the measurement noise in the bounds is given, columns of the poses, or the fit of the model.

    Frames in ``aligned`` are facts of one campaign. They are fitted to every second measured pose for the errors of the
    others, and the other way round, so that no error is one of the fit. The bounds contain the measurement noise:
    ``noise`` (m, rad), else that of the poses, else that of the fit.

    Raises:
        InputError: There are too few commanded poses to fit frames to a half of them.
        MissingColumnError: The poses lack a circumstance that an effect of the model needs, such as the approach.
    """
    # Circumstances drawn in place of missing ones would be held against the measurements.
    Model.of(absorb_constants(robot)).bind(measured)
    data, stated = completed(fit, measured, seed), (measured.sigma_position, measured.sigma_rotation)
    position, angle = (
        of_fit if given is None and column is None else given
        for given, column, of_fit in zip(noise, stated, fit.noise, strict=True)
    )
    data = replace(
        data,
        sigma_position=data.sigma_position if position is None else np.full((3, data.n), position),
        sigma_rotation=data.sigma_rotation if angle is None else np.full(data.n, angle),
        noise_covariance=data.noise_covariance if position is None else None,
    )
    half = data.groups() % 2 if aligned else np.zeros(data.n, dtype=np.int64)
    refuse(
        (
            aligned and np.all(half == half[0]),
            Problem(
                f"{' and '.join(aligned)} cannot be fitted to one half of the poses: all are the same commanded pose",
                data.source,
                fix="measure at more than one commanded pose, or leave out `align`",
            ),
        )
    )
    error, covariances = np.empty((3 if data.rotation is None else 6, data.n)), np.empty((2, 3, 3, data.n))
    for part in np.unique(half):
        rows = np.flatnonzero(half == part)
        judged, arm = data.subset(rows), robot
        if aligned:
            used = data.subset(np.flatnonzero(half != part))
            registration = registration_fit(robot, used, aligned)
            arm = apply_fit(registration)
            covariances[..., rows] = registered_uncertainty(robot, fit, judged, registration, used)
        else:
            covariances = model_uncertainty(robot, fit, judged, measured=True)[0]
            for covariance, noise_of_rows in zip(covariances, _noise_covariances(fit, judged), strict=True):
                covariance += noise_of_rows
        error[:, rows] = residuals(judged, predict(absorb_constants(arm), judged))
    result: dict[str, Any] = {"probability": RADIUS_PROBABILITY, "registered": aligned, "orientation": None}
    for i in range(min(error.shape[0], fit.unexplained.shape[0]) // 3):
        source = "fit"
        if fit.noise_is_separate and (noise[i] is not None or stated[i] is not None):
            source = "file" if noise[i] is None else "given"
        bound = length_quantiles(RADIUS_PROBABILITY, principal_variances(covariances[i]))
        inside = int(np.count_nonzero(np.linalg.norm(error[3 * i : 3 * i + 3], axis=0) <= bound))
        result[("position", "orientation")[i]] = {
            "n_poses": measured.n,
            "n_inside": inside,
            "share": inside / measured.n,
            "noise_source": source,
        }
    return result


# Record of a fit for its model file, from the fit and its held-out residuals.

_GROSS = 11.34
"""Square of a residual over its covariance that 99 % of Gaussian residuals along three axes do not exceed."""
_FEWEST = 20
"""Smallest number of held-out poses from which a factor of the bounds is taken."""


def fit_record(
    fit: Fit,
    robot: Robot,
    nominal: Robot,
    data: Measurements,
    held_out: tuple[Measurements, Array] | None,
    repeatability: "Repeatability | None",
    n_folds: int = 0,
) -> ModelFit:
    """Return the record of a fit.

    Args:
        fit: The final fit.
        robot: The fitted robot.
        nominal: The robot that the fit started from.
        data: Poses of the fit.
        held_out: Poses that were held out and their residuals ``(M, N)``; None without any.
        repeatability: Scatter of the joints, if it is significant.
        n_folds: Number of groups that are held out in turn, if ``held_out`` are the poses ``data``; else 0.
    """
    assert data.q is not None
    columns: dict[str, Array | None] = dict(zip(robot.variable_names, data.q, strict=True))
    columns |= {"payload_kg": data.payload, "temperature_c": data.temperature, "time_s": data.time}
    known = fit.identifiability.columns
    known = known[np.all(np.isfinite(fit.covariance[np.ix_(known, known)]), axis=1)]
    changed = {
        before.name: {
            name: float(before.parameters.get(name, 0.0))
            for name in sorted({*fitted.parameters, *before.parameters})
            if before.parameters.get(name, 0.0) != fitted.parameters.get(name, 0.0)
        }
        for fitted, before in zip(absorb_constants(robot).joints, nominal.joints, strict=True)
    }
    record = ModelFit(
        effects=fit.model.free,
        coefficients=tuple(fit.names[i] for i in known),
        covariance=fit.covariance[np.ix_(known, known)],
        nominal={name: numbers for name, numbers in changed.items() if numbers},
        repeatability={}
        if repeatability is None
        else {name: std for name, std in repeatability.joints if std is not None},
        unexplained=np.zeros((fit.residual.shape[0],) * 2),
        noise=(fit.noise.position, fit.noise.orientation),
        noise_is_separate=False,
        bound_factor=(1.0, 1.0),
        largest_correction=_largest_correction(robot, nominal, data),
        ranges={
            name: (float(np.min(values)), float(np.max(values)))
            for name, values in columns.items()
            if values is not None
        },
        n_poses=data.n,
    )
    residual, poses, sign = fit.residual[:, fit.inliers], data.subset(fit.inliers), 1.0
    if held_out is not None:
        finite = np.all(np.isfinite(held_out[1]), axis=0) & (fit.inliers if held_out[0] is data else True)
        residual, poses, sign = held_out[1][:, finite], held_out[0].subset(finite), -1.0
    # Held-out residuals have the errors of fits to fewer poses.
    fewer = _inflation(fit, data, n_folds) if held_out is not None and held_out[0] is data else 1.0
    compared = replace(record, covariance=fewer * record.covariance)
    # Variances of the measurement noise that is known apart from the arm's errors, m² and rad²: of the uncertainties in
    # the file, or of visits with several rows, which separate noise and scatter. Repeats alone hold both, so all of it
    # counts as the arm's.
    noise = (0.0, 0.0)
    if repeatability is not None and repeatability.source != "residual":
        noise = fit.misfit[0] ** 2, fit.misfit[1] ** 2
    if poses.sigma_position is not None:
        turn = 0.0 if poses.sigma_rotation is None else float(np.mean(np.square(poses.sigma_rotation)))
        noise = float(np.mean(np.square(poses.sigma_position))), turn
    # So many poses know a 95 % bound to 0.3 %.
    judged = random_rows(poses, 20_000)
    residual, poses = residual[:, judged], poses.subset(judged)
    # A residual of the fit's own poses lacks the error of the coefficients, a held-out residual contains it.
    unexplained = _unexplained(residual, *model_uncertainty(robot, compared, poses, measured=True), sign, noise)
    record = replace(record, unexplained=unexplained)
    if noise[0] > 0.0:
        angle = math.sqrt(noise[1]) if noise[1] > 0.0 else fit.noise.orientation
        record = replace(record, noise_is_separate=True, noise=(math.sqrt(noise[0]), angle))
    if held_out is None or poses.n < _FEWEST:
        return record
    covariances, *_ = model_uncertainty(robot, replace(compared, unexplained=unexplained), poses, measured=True)
    return replace(record, bound_factor=_bound_factors(residual, covariances, noise))


def _inflation(fit: Fit, data: Measurements, n_folds: int) -> float:
    """Return the mean variance of predictions of held-out poses over that of predictions by the fit to all poses.

    With p coefficients, n measured values and the share s = 1 - 1/K of them in the fit without a group, random poses
    are predicted with p / (s n - p) of the noise variance, and poses of the fit with p / n (for random regressors,
    L. Breiman and D. Freedman, JASA 78, 1983). Repeats of a pose are in the same group and count once.
    """
    if n_folds < 2:
        return 1.0
    rows = fit.residual.shape[0]
    visited = data.groups() if data.target is None else numbered(data.groups(), data.target)
    coefficients = np.count_nonzero(fit.inliers) * rows - fit.degrees_of_freedom
    effective = float(coefficients) / (different(visited[fit.inliers]) * rows)
    # Least surplus of measured values over coefficients without a group, as a share of all values.
    return float(1.0 / max(1.0 - 1.0 / n_folds - effective, 0.2))


def nominal_robot(robot: Robot, record: ModelFit | None) -> Robot:
    """Return the robot that a model was fitted from, in the model's frames and without effects.

    Without a record, its joints keep the fitted numbers, but for the constants.
    """
    robot = absorb_constants(robot)
    before = {} if record is None else record.nominal
    return replace(
        robot,
        joints=tuple(
            replace(joint, parameters={**joint.parameters, **before.get(joint.name, {})}) for joint in robot.joints
        ),
        effects=(),
    )


def _largest_correction(robot: Robot, nominal: Robot, data: Measurements) -> tuple[float, float]:
    """Return the largest difference of the model from the nominal robot in the model's frames, m and rad."""
    robot = absorb_constants(robot)
    rigid = replace(
        nominal, base=robot.base, tool=robot.tool, targets=robot.targets, effects=(), effect_units=(1.0, 1.0)
    )
    full, largest = Model.of(robot), np.zeros(2)
    arm_only = replace(full, known=tuple(k for k in full.known if not k.effect.traits.is_of_measurement))
    for block in full.arm.chain.blocks(data.n):
        part = data.subset(block)
        real, wanted = arm_only.bind(part).poses(np.zeros(0)), predict(rigid, part)
        moved = real.translation - wanted.translation, log_between(real.rotation, wanted.rotation)
        largest = np.maximum(largest, [np.max(np.linalg.norm(vectors, axis=0)) for vectors in moved])
    return float(largest[0]), float(largest[1])


def _unexplained(
    residual: Array, covariances: Array, rotation: Array, traces: Array, sign: float, noise: tuple[float, float]
) -> Array:
    """Return the covariance ``(M, M)`` of the residual beyond the known sources, in the target's frame.

    Where position or orientation shows no more than the known sources, its part is zero.
    """
    rows, n = residual.shape
    remaining = _scatter(np.concatenate([rotate_back(rotation, residual[i : i + 3]) for i in range(0, rows, 3)]))
    for i, (part, variance, of_coefficients, of_scatter) in enumerate(
        zip(covariances[: rows // 3], noise, *traces[:2], strict=False)
    ):
        block, known = slice(3 * i, 3 * i + 3), of_coefficients + of_scatter
        scale = (of_scatter - sign * of_coefficients) / known if known > 0 else 0.0
        explained = variance * np.eye(3) + scale * np.mean(in_tool_frame(part, rotation), axis=2)
        remaining[block, block] -= explained
        chance = 2.0 * math.sqrt(2.0 / (3.0 * n)) * max(float(np.trace(explained)), 0.0)
        if float(np.trace(remaining[block, block])) <= chance:
            remaining[block, :] = remaining[:, block] = 0.0
    root = _root(remaining, np.repeat(np.sqrt(np.maximum(np.diag(remaining).reshape(-1, 3).sum(axis=1), 0.0)), 3))
    return np.asarray(root @ root.T)


def _scatter(residual: Array) -> Array:
    """Return the second moments ``(M, M)`` of residuals ``(M, N)``; a gross row counts as one at 99 % of a Gaussian.

    A bound of 95 % of the errors must not grow with the size of the worst one. Source: P. J. Huber, Robust Statistics
    (1981), chapter 8; the limit takes 0.5 % from the variance of Gaussian residuals.
    """
    rows, n = residual.shape
    weight = np.ones(n)
    for _ in range(20):
        total, square = (residual * weight) @ residual.T / n, np.zeros(n)
        for i in range(0, rows, 3):
            part = residual[i : i + 3]
            spread = total[i : i + 3, i : i + 3] + 1e-12 * np.trace(total[i : i + 3, i : i + 3]) * np.eye(3) / 3.0
            if np.trace(spread) > 0.0:
                square = np.maximum(square, np.einsum("in,in->n", part, np.linalg.solve(spread, part)))
        weight = np.minimum(1.0, _GROSS / np.maximum(square, _GROSS))
    return np.asarray((residual * weight) @ residual.T / n)


def _bound_factors(residual: Array, covariances: Array, noise: tuple[float, float]) -> tuple[float, float]:
    """Return the factors that put 95 % of the held-out residuals within their bounds; 1 where they do by chance.

    A factor multiplies the model's standard deviations, not those of the measurement noise.
    """
    factors = [1.0, 1.0]
    for i, (covariance, variance) in enumerate(zip(covariances[: residual.shape[0] // 3], noise, strict=False)):
        length = np.linalg.norm(residual[3 * i : 3 * i + 3], axis=0)
        # Updates of a factor: its bounds contain the noise, which it does not multiply.
        for _ in range(4):
            variances = principal_variances(factors[i] ** 2 * covariance) + variance
            radius = length_quantiles(RADIUS_PROBABILITY, variances)
            ratio = np.sort(length[radius > 0] / radius[radius > 0])
            n = ratio.size
            chance = math.sqrt(RADIUS_PROBABILITY * (1.0 - RADIUS_PROBABILITY) / max(n, 1))
            surplus = abs(np.count_nonzero(ratio > 1.0) / max(n, 1) - (1.0 - RADIUS_PROBABILITY))
            # By chance (p = 0.01) the number of poses outside their bound differs from 5 % by 2.6 standard deviations.
            # From 200 poses on, the share that a factor puts inside is exact to 1.5 %.
            if n < _FEWEST or (n < 200 and surplus <= 2.6 * chance):
                break
            factors[i] *= float(ratio[min(math.ceil((n + 1) * RADIUS_PROBABILITY), n) - 1])
    return factors[0], factors[1]
