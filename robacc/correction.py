"""Correction of targets: commands that make the real arm reach them, refused targets, and expected errors.

Equation: with F the nominal kinematics, G the model of the real arm and x the wanted pose, the joint command q' solves
G(q') = x, and the Cartesian command is F(q'). Without a correction the arm reaches G(F^-1(x)).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import compress
from typing import Literal, NamedTuple, get_args

import numpy as np

from robacc.accuracy.estimation import ErrorMetrics, PoseMetrics, length_metrics, pose_metrics
from robacc.accuracy.grade import Quantity, Scale
from robacc.effects.base import Effect, Part, Term
from robacc.effects.drivers import is_outside, range_excess
from robacc.errors import Problem, applying, refuse
from robacc.fitting.parameters import absorb_constants
from robacc.geometry import Array, NDArray, Poses
from robacc.measurements import Measurements, motion_between_visits, numbered_visits
from robacc.modelling.model import Model
from robacc.prediction.model_uncertainty import ModelFit, completed, model_uncertainty
from robacc.prediction.predicting import RADIUS_PROBABILITY, steps_met
from robacc.robots.arm import (
    Arm,
    Evaluate,
    JointSolution,
    JointSpace,
    inverse_kinematics,
    joint_ranges,
    part_of,
    pose_error,
    pose_jacobian,
    reach,
    solve,
)
from robacc.robots.description import Robot
from robacc.statistics.intervals import normal_quantile

# Circumstances of targets other than the joints, and the two arms of a correction in common frames.


def circumstances(
    data: Measurements, payload: float | None = None, temperature: float | None = None, time: float | None = None
) -> Measurements:
    """Return the targets without their joints; a column of the file has precedence over a constant."""

    def filled(column: Array | None, value: float | None) -> Array | None:
        return column if column is not None or value is None else np.full(data.n, float(value))

    return Measurements(
        position=np.zeros((3, data.n)),
        target=data.target,
        payload_group=data.payload_group,
        branches=data.branches,
        branch_names=data.branch_names,
        direction=data.direction,
        speed=data.speed,
        rows=data.rows,
        payload=filled(data.payload, payload),
        temperature=filled(data.temperature, temperature),
        time=filled(data.time, time),
    )


FrameName = Literal["measuring", "base"]
Motion = tuple[Array | None, Array | None]
"""Direction and speed of approach ``(J, N)``; None where unknown."""


class CorrectionSetting(NamedTuple):
    """Real arm as the model describes it, the arm that the controller computes with, and the targets' circumstances.

    Both arms are in the same frames.
    """

    model: Model
    """Effects of the arm; those of the measurement are left out."""
    nominal: Arm
    frame: FrameName
    left_out: tuple[Effect, ...]
    """Effects of the measurement in the model file, which no command can correct."""
    columns: Measurements
    """Targets; time, temperature and payload are complete as far as they are known."""
    follows_order: bool
    """Direction and speed of approach follow from the moves between the targets, in their order."""
    visits: NDArray[np.int64]
    """``(N,)`` number of the arrival that each row belongs to: rows of several measured targets share one."""

    def from_measuring(self, poses: Poses) -> Poses:
        """Return poses of the measuring frame in the frame of the Cartesian targets."""
        return poses if self.frame == "measuring" else self.nominal.robot.base.pose.inverse() @ poses

    def motion(self, q: Array) -> Motion:
        """Return direction and speed of approach of commands ``q`` ``(J, N)`` in their order."""
        given = (self.columns.direction, self.columns.speed)
        if not self.follows_order:
            return given
        direction, speed = (
            derived if column is None else column
            for column, derived in zip(given, motion_between_visits(q, self.visits), strict=True)
        )
        return direction, speed

    def at(self, q: Array, motion: Motion = (None, None), index: NDArray[np.int64] | None = None) -> Measurements:
        """Return the poses of all targets, or of those ``index``, at commands ``q`` ``(J, M)``."""
        index = np.arange(q.shape[1]) if index is None else index
        direction, speed = (None if part is None else part[:, index] for part in motion)
        return replace(
            self.columns.subset(index), position=np.zeros((3, index.size)), q=q, direction=direction, speed=speed
        )

    def nominal_poses(self, q: Array) -> Poses:
        """Return poses of the target, measuring frame, that the controller computes for joints ``q`` ``(J, N)``."""
        return Model(self.nominal).bind(self.at(q)).poses(np.zeros(0))

    def errors(self, wanted: Poses, q: Array, motion: Motion) -> Array:
        """Return the errors ``(6, N)`` of the real arm's poses at ``q`` against the wanted ones: m and rad."""
        return -pose_error(wanted, self.model.bind(self.at(q, motion)).poses(np.zeros(0)), True)

    def joint_space(self, q: Array, oriented: bool, weight: float | None = None) -> JointSpace:
        """Return limits, scales and weights near joints ``q`` ``(J, N)``.

        An arm with six axes or more reaches position and orientation, so the weight of orientation is only a scale: the
        arm's length. For an arm with fewer axes ``weight`` (m per rad) decides what it corrects.
        """
        arm, length = self.model.arm, max(reach(self.nominal, q), 1e-3)
        return JointSpace.of(arm, length, length if weight is None or len(arm.names) >= 6 else weight, oriented)


def setting_of(
    model: Robot, nominal: Robot, columns: Measurements, data: Measurements, frame: FrameName, ordered: bool
) -> CorrectionSetting:
    """Return model and nominal robot in common frames, with the circumstances ``columns`` of the targets ``data``.

    The nominal robot stands where the model stands, because a controller knows no measuring frame. With ``frame``
    ``measuring``, both carry the model's tool, the measured target; with ``base``, both carry the nominal tool, with
    which the controller works.

    Raises:
        InputError: Their effects cannot be read.
    """
    model = absorb_constants(model)
    nominal = replace(nominal, effects=(), effect_units=(1.0, 1.0))
    if frame == "base":
        model = replace(model, tool=nominal.tool, targets=nominal.targets, payload_com=Arm.of(model).payload_com)
    nominal = replace(nominal, base=model.base, tool=model.tool, targets=model.targets)
    full = Model.of(model)
    known = tuple(entry for entry in full.known if not entry.effect.traits.is_of_measurement)
    left_out = tuple(entry.effect for entry in full.known if entry.effect.traits.is_of_measurement)
    visits = numbered_visits(data.groups(), data.visit, data.cycle, data.target)
    return CorrectionSetting(replace(full, known=known), Arm.of(nominal), frame, left_out, columns, ordered, visits)


def check_same_joints(model: Robot, nominal: Robot) -> None:
    """Raise InputError unless both robots have the same joint variables."""
    types = [[joint.type for joint in robot.variables] for robot in (model, nominal)]
    texts = [", ".join(f"{joint.name} ({joint.type})" for joint in robot.variables) for robot in (model, nominal)]
    message = f"the model has the joints {texts[0]}, the nominal robot has {texts[1]}"
    fix = "give the robot file that the model was fitted from"
    refuse((types[0] != types[1], Problem(message, nominal.name, fix=fix)))


_BLOCK = 256
"""Cartesian targets without joints whose configurations are searched at a time."""


class WantedPoses(NamedTuple):
    """Wanted poses, and nominal joints that keep the commanded configuration."""

    given: Literal["joints", "poses", "poses and joints"]
    poses: Poses
    """``(N)`` wanted poses of the target in the measuring frame; rotations are nominal if none were given."""
    oriented: bool
    """The orientation is wanted too, not only the position."""
    q: Array
    """``(J, N)`` nominal joints, rad or m."""
    reached: NDArray[np.bool_]
    """``(N,)`` whether the nominal robot reaches the wanted pose."""


def wanted_poses(data: Measurements, setting: CorrectionSetting) -> WantedPoses:
    """Return the wanted poses of targets.

    Joints mean the pose that the nominal robot has there. Commanded poses (``cmd_`` columns) are wanted as they are,
    and joints beside them only choose the configuration. Without either, ``x, y, z`` are the wanted poses.

    Raises:
        InputError: The targets have neither joints nor poses.
    """
    if data.commanded_position is None and data.q is not None:
        return WantedPoses("joints", setting.nominal_poses(data.q), True, data.q, np.ones(data.n, dtype=bool))
    position, rotation = (
        (data.position, data.rotation)
        if data.commanded_position is None
        else (data.commanded_position, data.commanded_rotation)
    )
    fix = "add joints q1, q2, …, or wanted poses cmd_x, cmd_y, cmd_z with cmd_qw …"
    nothing = Problem("the targets have neither joints nor poses", data.source, fix=fix)
    refuse((data.n and data.q is None and not np.any(position), nothing))
    oriented = rotation is not None
    wanted = Poses(np.repeat(np.eye(3)[:, :, None], data.n, axis=2) if rotation is None else rotation, position)
    wanted = wanted if setting.frame == "measuring" else setting.nominal.robot.base.pose @ wanted
    start = _searched_joints(setting.nominal, wanted, oriented) if data.q is None else data.q
    evaluate = pose_evaluator(setting, Model(setting.nominal), wanted, oriented, (None, None), np.arange(data.n))
    solution = solve(evaluate, start, setting.joint_space(start, oriented))
    reached = np.max(np.abs(solution.error), axis=0, initial=0.0) < 1e-7  # m and rad
    reached |= (oriented and start.shape[0] < 6) & solution.converged
    wanted = wanted if oriented else Poses(setting.nominal_poses(solution.q).rotation, wanted.translation)
    return WantedPoses("poses" if data.q is None else "poses and joints", wanted, oriented, solution.q, reached)


def _searched_joints(arm: Arm, wanted: Poses, oriented: bool) -> Array:
    """Return joints ``(J, N)`` for targets without joints: each the solution nearest to that of the target before."""
    several = Problem("targets without joints need a robot with one tool", fix="add joints q1, q2, …")
    refuse((arm.robot.targets, several))
    low, high = joint_ranges(arm)
    # The first is nearest to the middle of the ranges.
    previous = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * (low + high), 0.0)
    result = np.empty((low.size, wanted.translation.shape[1]))
    for start in range(0, result.shape[1], _BLOCK):
        index = np.arange(start, min(start + _BLOCK, result.shape[1]))
        solutions = inverse_kinematics(arm, part_of(wanted, index), oriented=oriented)
        for column, number in enumerate(index):
            distance = np.sum(np.square(solutions.q[:, column] - previous[:, None]), axis=0)
            cost = np.where(solutions.converged[column], distance, np.inf)
            best = int(np.argmin(cost if np.isfinite(cost).any() else solutions.error[column]))
            previous = result[:, number] = solutions.q[:, column, best]
    return result


def pose_evaluator(
    setting: CorrectionSetting, model: Model, wanted: Poses, oriented: bool, motion: Motion, targets: NDArray[np.int64]
) -> Evaluate:
    """Return errors ``(R, K)`` of a model's poses against wanted poses, and ``(R, J, K)`` to the joints, as a function.

    The Jacobian is that of the model's geometry, without how its effects change with the joints, which are some
    thousandths of it. The errors are exact, so this costs a step at most.

    Args:
        setting: Circumstances of all targets.
        model: Without free effects.
        wanted: ``(M)`` wanted poses.
        oriented: Whether their orientation is wanted too.
        motion: Direction and speed of approach ``(J, N)`` of all targets.
        targets: ``(M,)`` numbers of the targets whose poses are wanted.
    """
    # A joint variable turns its joint with the joint's sign, and those that mimic it.
    drives = model.arm.chain.drives
    terms = tuple(
        Term(name, "", 1.0, tuple(Part(drive.motion, drive.coefficient) for drive in drives if drive.joint == j))
        for j, name in enumerate(model.arm.names)
    )

    def evaluate(q: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
        data = setting.at(q, motion, targets[index])
        rigid = replace(Model(model.arm).bind(data), terms=terms)
        poses, jacobian = rigid.linearise(np.zeros(len(terms)))
        if model.known:
            poses = model.bind(data).poses(np.zeros(0))
        error = pose_error(part_of(wanted, index), poses, oriented)
        return error, jacobian[: error.shape[0]]

    return evaluate


# Limits of a correction.


class Limits(NamedTuple):
    """Limits beyond which a target is refused, and the weight for arms with fewer than six axes."""

    position: float | None = None
    """m: largest correction; None for no limit."""
    orientation: float | None = None
    """rad"""
    weight: float = 0.01
    """m per rad: weight of orientation for arms with fewer than six axes."""
    beyond_range: bool = False
    """Correct targets outside the validity range of the model too."""
    ranges: Mapping[str, tuple[float, float]] | None = None
    """Lowest and highest value that the model was fitted on, by joint or column; None if unknown."""


# Reasons for which a target is not corrected.

_DEGREES = 180.0 / np.pi


Cause = Literal["unreached", "limit", "approach", "singular", "configuration", "too_large", "out_of_range"]
"""Cause of a refusal."""


class Refusal(NamedTuple):
    """Cause of the refusal of a target, and the reason as a sentence."""

    cause: Cause
    reason: str


def refusals(
    setting: CorrectionSetting, wanted: WantedPoses, solution: JointSolution, joints: JointSpace, limits: Limits
) -> list[Refusal | None]:
    """Return the reason of each target that is refused, the first that applies; None for the others."""
    names, n_joints = setting.model.arm.names, solution.q.shape[0]
    configuration = "" if wanted.given == "poses" else " in the configuration of its joints"
    outside = () if limits.beyond_range else _out_of_range(setting, wanted, limits)
    rules: list[tuple[NDArray[np.bool_], Cause, str | Callable[[int], str]]] = [
        (~wanted.reached, "unreached", f"the nominal robot does not reach the wanted pose{configuration}"),
        *((targets, "out_of_range", reason) for targets, reason in outside),
    ]

    # Targets that the model does not reach, because of a limit, the approach, or a singular pose. Arms with fewer axes
    # never reach every pose: what counts is whether a limit takes part.
    at_limit = (solution.q <= joints.low[:, None]) | (solution.q >= joints.high[:, None])
    failed = (
        np.max(np.abs(solution.error), axis=0, initial=0.0) > 1e-6  # m and rad
        if not wanted.oriented or n_joints >= 6
        else ~solution.converged | np.any(at_limit, axis=0)
    )
    remaining = _amounts(solution.error)
    # Near a singular pose joints turn far or change the configuration.
    correction = _amounts(pose_error(setting.nominal_poses(solution.q), wanted.poses, True))
    move = np.abs(solution.q - wanted.q) / joints.scale[:, None]
    largest, joint = np.max(move, axis=0), np.argmax(move, axis=0)
    amplified = largest / np.maximum(correction[0] / joints.length + correction[1], 1e-9)

    def limited(i: int) -> str:
        return f"the correction would take {' and '.join(compress(names, at_limit[:, i]))} beyond the joint limit"

    def moves(i: int) -> str:
        turn = f"{names[joint[i]]} would move by {float(largest[i]) * _DEGREES:.2g}°"
        return f"near a singular pose: {turn} for {_sizes(*correction[:, i])}"

    approach = "a joint moves less than its play since the previous target, so its direction of approach is unknown"
    converges = "near a singular pose the correction does not converge"
    rules += [
        (failed & np.any(at_limit, axis=0), "limit", limited),
        (failed & setting.follows_order & solution.converged, "approach", approach),
        (failed, "singular", lambda i: f"{converges}: {_sizes(*remaining[:, i])} remain"),
        # Away from singular poses a joint turns by 1 to 5 times the angle of the correction.
        ((amplified > 30.0) & (largest > np.radians(0.5)), "singular", moves),
    ]
    if wanted.oriented and n_joints == 6:
        before, after = (
            np.linalg.det(np.moveaxis(pose_jacobian(setting.nominal, q)[1], 2, 0)) for q in (wanted.q, solution.q)
        )
        passes = "the correction would pass a singular pose into another configuration"
        rules.append((before * after < 0.0, "configuration", passes))
    most = (limits.position, limits.orientation if wanted.oriented else None)
    far = np.any(correction > [[np.inf if limit is None else limit] for limit in most], axis=0)
    allowed = f"is larger than {_sizes(limits.position, limits.orientation)}, see `most`"
    rules.append((far, "too_large", lambda i: f"the correction of {_sizes(*correction[:, i])} {allowed}"))
    first = [next((rule for rule in rules if rule[0][i]), None) for i in range(solution.q.shape[1])]
    return [
        rule and Refusal(rule[1], rule[2] if isinstance(rule[2], str) else rule[2](i)) for i, rule in enumerate(first)
    ]


def _out_of_range(
    setting: CorrectionSetting, wanted: WantedPoses, limits: Limits
) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Yield the targets ``(N,)`` outside each range that the model holds in, and the reason."""
    arm, data = setting.model.arm, setting.at(wanted.q, setting.motion(wanted.q))
    for known in setting.model.known:
        outside = is_outside(arm, data, *known.effect.limits(arm, known.validity))
        yield outside, f"outside the validity range of {known.effect}"
    columns: dict[str, Array | None] = {**dict(zip(arm.names, wanted.q, strict=True)), "payload_kg": data.payload}
    # A temperature that no effect depends on refuses no target.
    if any("temperature_c" in known.effect.validity_drivers(arm) for known in setting.model.known):
        columns["temperature_c"] = data.temperature
    for name, (low, high) in (limits.ranges or {}).items():
        if (values := columns.get(name)) is not None:
            # Share of a range by which a target may exceed it.
            outside = range_excess(values, low, high) > 0.05 * (high - low)
            yield outside, f"{name} is outside the range that the model was fitted on"


def _amounts(error: Array) -> Array:
    """Return the lengths ``(2, N)`` of the first three components and of the others; zero without others."""
    return np.stack((np.linalg.norm(error[:3], axis=0), np.linalg.norm(error[3:], axis=0)))


def _sizes(position: float | None, angle: float | None) -> str:
    """Return lengths in mm and angles in degrees as text."""
    length = "" if position is None else f"{1e3 * float(position):.3g} mm"
    return " and ".join(filter(None, (length, "" if angle is None else f"{float(angle) * _DEGREES:.2g}°")))


_ROUNDS = 5
"""Rounds over all targets until directions and speeds of approach agree with the corrected commands."""


def _solved(
    setting: CorrectionSetting, wanted: WantedPoses, joints: JointSpace, beside: tuple[JointSolution, list[bool]] | None
) -> JointSolution:
    """Return the solution of all targets, each near its nominal joints.

    It is repeated for targets whose pose changes with the approach that the commands of others lead to. With a solution
    ``beside`` and whether each target was refused in it, return the one where these stay at their nominal joints.
    """
    nominal, n = wanted.q, wanted.q.shape[1]
    q, error, settled = nominal.copy(), np.zeros((joints.weights.size, n)), np.zeros(n, dtype=bool)
    chosen, index, motion = np.ones(n, dtype=bool), np.arange(n), setting.motion(nominal)
    if beside is not None:
        before, chosen = beside[0], ~np.array(beside[1])
        motion = setting.motion(before.q)
        q, error, settled = np.where(chosen, before.q, nominal), before.error.copy(), before.converged.copy()
    for number in range(_ROUNDS + 1):
        previous, motion = motion, setting.motion(q)
        if number or beside is not None:
            now, then = (setting.errors(wanted.poses, q.copy(), approach) for approach in (motion, previous))
            # m and rad: change of a pose with its approach that is not worth another solution.
            index = np.flatnonzero(np.any(np.abs(now - then) > 1e-10, axis=0) & chosen)
        if index.size == 0:
            break
        evaluate = pose_evaluator(setting, setting.model, part_of(wanted.poses, index), wanted.oriented, motion, index)
        if number == _ROUNDS:
            # The approach does not agree with the commands: the error shows it, and the target is refused.
            error[:, index] = evaluate(q[:, index], np.arange(index.size))[0]
        else:
            part = solve(evaluate, nominal[:, index], joints, q[:, index])
            q[:, index], error[:, index], settled[index] = part.q, part.error, part.converged
    return JointSolution(q, error, settled)


# Expected errors of targets before and after the correction: their length, its 95 % bound, and the grade.
#
# A predicted error e with covariance V of what the model does not know has a length below the bound with probability
# 0.95. Its square is a weighted sum of noncentral chi-squares, here by Pearson's approximation with three cumulants,
# within 2 % of the exact radius. Source: E. S. Pearson, "Note on an approximation to the distribution of non-central
# chi-square", Biometrika 46 (1959); for quadratic forms J. P. Imhof, Biometrika 48 (1961), eq. 4.2.


class ExpectedErrors(NamedTuple):
    """Expected errors of N targets, at their nominal or at their corrected commands."""

    position: Array
    """``(N,)`` length of the predicted error, m."""
    orientation: Array
    """``(N,)`` angle of the predicted error, rad."""
    position_rms: Array
    """``(N,)`` root mean square of the error's length: predicted error and uncertainty of the model, m."""
    orientation_rms: Array | None
    """``(N,)`` rad; None where the model has an uncertainty, but not of orientation: a fit to positions alone."""
    position_bound: Array | None
    """``(N,)`` bound of 95 % of the errors, m; None where the model has no uncertainty."""
    orientation_bound: Array | None
    """``(N,)`` rad; None where the model has no uncertainty of orientation."""
    grades: tuple[str, ...] | None
    """``(N,)`` grade of each bound; None without bounds."""


def expected_errors(
    error: Array, position: Array | None, orientation: Array | None, scale: Scale, oriented: bool
) -> ExpectedErrors:
    """Return lengths, bounds and grades of predicted errors ``(6, N)``.

    Args:
        error: Predicted position errors, m, and orientation errors, rad.
        position: ``(3, 3, N)`` covariance of the unpredicted position error, m²; None if unknown.
        orientation: ``(3, 3, N)`` rad²; None if unknown.
        scale: Scale of the grades.
        oriented: Whether orientation counts.
    """
    parts = ((error[:3], position), (error[3:], orientation))
    lengths = _amounts(error)
    bounds = [None if own is None else length_bound(RADIUS_PROBABILITY, part, own) for part, own in parts]
    added = [0.0 if own is None else np.einsum("iin->n", own) for _, own in parts]
    rms = [np.sqrt(np.square(length) + power) for length, power in zip(lengths, added, strict=True)]
    counted: tuple[tuple[Quantity, Array | None], ...] = (("position", bounds[0]), ("orientation", bounds[1]))
    sizes = {name: bound for name, bound in counted[: 1 + oriented] if bound is not None}
    # The best grade whose limits the bounds meet.
    best = np.argmax(steps_met(scale, sizes), axis=0).tolist() if "position" in sizes else None
    grades = None if best is None else tuple(map(scale.name_of, best))
    turn_rms = rms[1] if position is None or orientation is not None else None
    return ExpectedErrors(lengths[0], lengths[1], rms[0], turn_rms, bounds[0], bounds[1], grades)


def length_bound(probability: float, mean: Array, covariance: Array) -> Array:
    """Return radii ``(N,)`` about zero that contain ``probability`` of N(mean, covariance).

    Args:
        probability: Above 0.5.
        mean: ``(3, N)``.
        covariance: ``(3, 3, N)``.
    """
    variances, axes = np.linalg.eigh(np.moveaxis(covariance, 2, 0))
    squares = np.square(np.einsum("nij,in->nj", axes, mean))
    # Cumulants of the squared length, over 1, 2 and 8.
    first, second, third = (np.sum(variances**k + k * variances ** (k - 1) * squares, axis=1) for k in (1, 2, 3))
    scatter = second > 1e-28 * np.square(first)
    dof = np.where(scatter, second**3 / np.where(scatter, third, 1.0) ** 2, 1.0)
    # Wilson and Hilferty's cube root; at one degree of freedom, exactly.
    part = 2.0 / (9.0 * dof)
    quantile = dof * (1.0 - part + normal_quantile(probability) * np.sqrt(part)) ** 3
    quantile = np.where(dof <= 1.0, normal_quantile(0.5 * (1.0 + probability)) ** 2, quantile)
    beyond = np.where(scatter, (quantile - dof) * np.sqrt(np.maximum(second, 0.0) / dof), 0.0)
    return np.asarray(np.sqrt(np.maximum(first + beyond, 0.0)))


@dataclass(frozen=True, slots=True)
class Correction:
    """Corrected targets with their expected errors; a refused target keeps its nominal command."""

    setting: CorrectionSetting
    wanted: WantedPoses
    q: Array
    """``(J, N)`` corrected joint commands, rad or m."""
    commanded: Poses
    """``(N)`` poses that the controller computes for ``q``, measuring frame."""
    data: Measurements
    """Targets at their corrected commands, with their circumstances."""
    correction: Array
    """``(6, N)`` command less wanted pose: m, and a rotation vector in rad, measuring frame."""
    error_before: Array
    """``(6, N)`` predicted pose at the nominal command less wanted pose."""
    error_after: Array
    """``(6, N)`` predicted pose at the corrected command less wanted pose; for a refused target as before."""
    refusals: tuple[Refusal | None, ...]
    """``(N)`` reason of each refused target; None for a corrected target."""
    limits: Limits
    limits_source: Literal["option", "model", "none"]
    before: ExpectedErrors
    """At the nominal commands."""
    after: ExpectedErrors
    """At the corrected commands."""
    scale: Scale
    notes: tuple[str, ...]
    """Assumptions and limitations."""

    @property
    def is_corrected(self) -> NDArray[np.bool_]:
        """``(N,)`` targets with a correction."""
        return np.array([refusal is None for refusal in self.refusals], dtype=bool)

    @property
    def n_targets(self) -> int:
        """Number of targets."""
        return len(self.refusals)

    @property
    def n_corrected(self) -> int:
        """Number of corrected targets."""
        return int(np.count_nonzero(self.is_corrected))

    @property
    def correction_metrics(self) -> PoseMetrics:
        """Metrics of the corrected targets' corrections, m and rad."""
        return pose_metrics(self.correction[:, self.is_corrected])

    def metrics(self, sizes: Array) -> ErrorMetrics:
        """Return the metrics over the corrected targets of sizes ``(N,)`` of all targets, m or rad."""
        return length_metrics(sizes[self.is_corrected])

    @property
    def causes(self) -> dict[Cause, int]:
        """Number of refused targets by cause, the causes in their order."""
        causes = [refusal.cause for refusal in self.refusals if refusal is not None]
        return {cause: causes.count(cause) for cause in get_args(Cause) if cause in causes}


def correction(
    data: Measurements,
    model: Robot,
    nominal: Robot,
    columns: Measurements,
    fit: ModelFit | None,
    *,
    ordered: bool,
    frame: FrameName,
    limits: Limits,
    limits_source: Literal["option", "model", "none"],
    scale: Scale,
) -> Correction:
    """Correct targets and compute their expected errors.

    Raises:
        InputError: The robots have different joints, the targets have neither joints nor poses, or the arm has no
            elastic equilibrium.
        MissingColumnError: The targets lack what an effect of the model depends on.
    """
    setting = setting_of(model, nominal, columns, data, frame, ordered)
    wanted = wanted_poses(data, setting)
    joints = setting.joint_space(wanted.q, wanted.oriented, limits.weight)
    solution = _solved(setting, wanted, joints, None)
    refused = refusals(setting, wanted, solution, joints, limits)
    if any(refused):
        # Refused targets keep their nominal command, which changes the approach to the targets after them.
        solution = _solved(setting, wanted, joints, (solution, list(map(bool, refused))))
        again = refusals(setting, wanted, solution, joints, limits)
        refused = [first or second for first, second in zip(refused, again, strict=True)]
    q = np.where(np.array(list(map(bool, refused)), dtype=bool), wanted.q, solution.q)
    errors = [setting.errors(wanted.poses, each, setting.motion(each)) for each in (wanted.q, q)]
    corrected, command = setting.at(q, setting.motion(q)), setting.nominal_poses(q)
    position, orientation = (
        (None, None) if fit is None else model_uncertainty(model, fit, completed(fit, corrected, 0), measured=False)[0]
    )
    orientation = orientation if fit is not None and fit.unexplained.shape[0] == 6 else None
    before, after = (expected_errors(each, position, orientation, scale, wanted.oriented) for each in errors)
    listed = ", ".join(map(str, setting.left_out))
    notes = applying(
        (wanted.given == "joints", "a joint target is taken as the pose that the nominal robot has there"),
        (listed, f"{listed}: an effect of the measurement, not of the arm, is not corrected"),
        (
            ordered and columns.direction is None and columns.speed is None,
            "assumed: the arm drives to the targets in their order; the approach to the first is unknown",
        ),
        (
            wanted.oriented and q.shape[0] < 6,
            f"{q.shape[0]} axes do not reach every pose: the correction has the least error, where 1° of "
            f"orientation counts as {1e3 * limits.weight / _DEGREES:.3g} mm",
        ),
    )
    to_command = -pose_error(wanted.poses, command, True)
    return Correction(
        *(setting, wanted, q, command, corrected, to_command, errors[0], errors[1], tuple(refused)),
        *(limits, limits_source, before, after, scale, notes),
    )
