"""Accuracy of measured poses: errors by (3)-(5) of Wu and Lee, their metrics and axes, registration, and the estimate.

Source: C. H. Wu and C. C. Lee, "Estimation of the Accuracy of a Robot Manipulator" (IEEE TAC, 1985). Their attained
pose is T + dT = T (I + δT) with δT built of the translation d and the rotation δ in the target's frame, to first order.
Here, with T_c = [R_c p_c] commanded and T_a = [R_a p_a] attained in the measuring frame,

    frame "tool":  d = R_c^T (p_a - p_c),  δ = log(R_c^T R_a)
    frame "base":  d = p_a - p_c,          δ = log(R_a R_c^T)

and log is the exact rotation vector, so that large errors are exact too. "tool" gives both in the axes of the
commanded target, "base" in those of the measuring frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial, reduce
from operator import add
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from robacc.accuracy.error_statistics import ErrorStatistics, error_statistics, statistics_of_sums
from robacc.accuracy.error_sums import ErrorSums, count_commands, smallest_hashes
from robacc.accuracy.grade import Grade, Scale, default_scale, grade
from robacc.errors import MAX_PROBLEMS, InputError, Note, Problem, RobaccError, applying, given, refuse
from robacc.fitting.outliers import inlier_limit, inlier_mask
from robacc.geometry import Array, NDArray, log_between, rms_length, rotate_back, transpose, vector_lengths
from robacc.measurements import MOVES_UNUSED, STILL, Measurements, even_rows, too_far
from robacc.robots.description import Robot
from robacc.statistics.intervals import quantiles
from robacc.workers import single_threaded

if TYPE_CHECKING:
    from robacc.fitting.registration import Alignment
    from robacc.workers import Workers


# RMS, mean, 95th percentile and maximum of the error's length: the metrics that every comparison uses.


class ErrorMetrics(NamedTuple):
    """Metrics of the error's length over poses, m or rad."""

    rms: float
    mean: float
    p95: float
    """Interpolated linearly between order statistics."""
    max: float


class PoseMetrics(NamedTuple):
    """Metrics of position and, where it was measured, of orientation."""

    position: ErrorMetrics
    orientation: ErrorMetrics | None


def pose_metrics(residual: Array) -> PoseMetrics:
    """Return the metrics of residuals ``(3 or 6, N)`` in m and rad."""
    orientation = length_metrics(vector_lengths(residual[3:])) if residual.shape[0] == 6 else None
    return PoseMetrics(length_metrics(vector_lengths(residual[:3])), orientation)


def length_metrics(length: Array) -> ErrorMetrics:
    """Return the metrics of lengths ``(N,)``, m or rad; NaN without any."""
    own = length if length.size else np.full(1, np.nan)
    figures = np.sqrt(np.mean(np.square(own))), np.mean(own), *quantiles(own, [0.95]), np.max(own)
    return ErrorMetrics(*map(float, figures))


ErrorFrame = Literal["tool", "base"]


class PoseErrors(NamedTuple):
    """Error vectors of all poses."""

    frame: ErrorFrame
    position: Array
    """``(3, N)`` d, m."""
    rotation: Array | None
    """``(3, N)`` δ, a rotation vector in rad; None where the attained or the commanded orientation is unknown."""


def commanded_poses(
    data: Measurements, robot: Robot | None, alignment: Alignment | None = None
) -> tuple[Array, Array | None]:
    """Return the commanded poses after an ``alignment``, or predicted by ``robot`` if given, or else from the file.

    They are positions ``(3, N)`` in the measuring frame, m, and rotations ``(3, 3, N)``, None where only positions
    were commanded.

    Raises:
        UsageError: There are neither a robot nor commanded poses.
        InputError: There is a robot, but the data have no joint variables.
    """
    position, rotation, q = data.commanded_position, data.commanded_rotation, data.q
    if alignment is not None:
        poses = alignment.commanded
        return poses.translation, None if robot is None and rotation is None else poses.rotation
    if robot is not None:
        without = ", or omit `robot` to use the cmd_ columns of the file"
        fix = "add the commanded joints q1, q2, …" + without * (position is not None)
        q = given(q, Problem("has no columns of commanded joints for the robot", data.source, fix=fix))
        if robot.effects or robot.targets or len(q) != len(robot.variables):
            from robacc.modelling.model import predict

            poses = predict(robot, data)
        else:
            # An arm without effects is its chain, bit for bit; loading all effects takes longer than 10,000 poses.
            from robacc.robots.arm import build_chain

            poses = build_chain(robot).forward(q)
        return poses.translation, poses.rotation
    ways = "`robot`" if q is not None else "`commanded`, a robot program or a table of joints or poses"
    missing = f"the poses have no commanded positions: give {ways}, or columns cmd_x, cmd_y, cmd_z"
    return given(position, missing), rotation


def pose_errors(data: Measurements, commanded: Array, turns: Array | None, frame: ErrorFrame) -> PoseErrors:
    """Compute equations (3)-(5) in ``frame``, as written at the top of this module, from the commanded poses.

    Raises:
        UsageError: The frame is "tool", but no orientation was commanded.
    """
    missing = "frame tool needs the commanded orientation: add columns cmd_qw …, give `robot`, or use frame base"
    refuse((frame == "tool" and turns is None, missing))
    difference, rotation = data.position - commanded, None
    position = rotate_back(turns, difference) if frame == "tool" and turns is not None else difference
    if data.rotation is not None and turns is not None:
        pair = (transpose(turns), transpose(data.rotation)) if frame == "tool" else (data.rotation, turns)
        rotation = log_between(*pair)
    return PoseErrors(frame, position, rotation)


def position_errors(data: Measurements, commanded: Array, turns: Array | None) -> dict[ErrorFrame, PoseErrors]:
    """Return the position errors in the measuring frame, and in the tool's where a commanded orientation is known.

    A cloud that is round in one frame may be long in the other: errors of the tool turn with the tool, errors of the
    base stay fixed in the room.
    """
    frames: tuple[ErrorFrame, ...] = ("base",) if turns is None else ("tool", "base")
    return {frame: pose_errors(replace(data, rotation=None), commanded, turns, frame) for frame in frames}


# Registration of the commanded poses before errors are judged, and the sign that it is missing.

_FEWEST_ROWS, _FEWEST_AT_END = 20, 3
"""Rows that a step is looked for in, and rows before and after it, at least."""


def register(data: Measurements, robot: Robot | None, frames: Sequence[str], *, held_out: bool = False) -> Alignment:
    """Fit ``frames`` of the robot, or without a robot of the commanded poses, to the measured poses.

    See :func:`robacc.fitting.registration.align`.
    """
    from robacc.fitting import registration

    if robot is None:
        # A measured orientation says nothing of the frames where none was commanded.
        rotation = None if data.commanded_rotation is None else data.rotation
        return registration.align_commands(replace(data, rotation=rotation), frames, held_out=held_out)
    return registration.align(robot, data, frames, held_out=held_out)


def _far_errors(errors: Array) -> tuple[float, int]:
    """Return the rms length of errors ``(3, N)`` without those far beyond the others, and how many are, m or rad."""
    near = inlier_mask(errors, errors, np.ones(errors.shape[1], dtype=np.bool_), 0)
    return rms_length(errors[:, near]), int(np.count_nonzero(~near))


def frames_to_register(data: Measurements, robot: Robot | None, error: float) -> tuple[str, ...]:
    """Return frames to register where a position error in m is one that no arm has: those that leave what an arm has.

    If none do, what registration leaves tells the mistake better than the frames as they are: then base and tool, as
    far as the poses determine them.

    Raises:
        InputError: The error is one that no arm has, and the positions are too few to register frames.
    """
    if not too_far(error, data.position):
        return ()
    few = (
        f"{data.n} positions whose errors, {1e3 * error:.3g} mm rms, are too large for an arm: the frames do not "
        'agree, and registration needs more positions; measure at least 4, or keep the errors with `align="none"`'
    )
    refuse((data.n < 3 and data.rotation is None, few), error=InputError)
    possible: list[tuple[str, ...]] = []
    for frames in (("base_frame", "tool_frame"), ("base_frame",)):
        with suppress(RobaccError):
            registered, _ = _far_errors(data.position - register(data, robot, frames).commanded.translation)
            if not too_far(registered, data.position):
                return frames
            register(data, robot, frames, held_out=True)
            possible.append(frames)
    return next(iter(possible), ())


UNREGISTERED = (
    "the errors are too large for an arm and suggest frames that are not registered; register the frames with "
    '`align="base_frame,tool_frame"`'
)
TOO_LARGE = (
    "the errors are too large for an arm: check the units, the joint signs, the order of the joints, that each row has "
    "its own command, that the axes are right-handed, and whether a camera is on the hand or beside the arm"
)
"""Warnings of errors that are too large for an arm, before a registration and after it."""


def moved_warning(data: Measurements, error: Array) -> tuple[str, ...]:
    """Return a warning of position errors ``(3, N)`` that are mostly one step between two rows.

    The step is where the means of the rows before and after it differ most, as their number allows.
    """
    if (n := data.n) < _FEWEST_ROWS:
        return ()
    before = np.arange(_FEWEST_AT_END, n - _FEWEST_AT_END + 1)
    centred = error - error.mean(axis=1, keepdims=True)
    explained = np.square(np.cumsum(centred, axis=1)[:, before - 1]).sum(axis=0) * n / (before * (n - before))
    first = int(before[np.argmax(explained)])
    # Share of the errors' squares from which a step explains them.
    if explained.max() <= 0.6 * np.sum(np.square(centred)):
        return ()
    step = np.linalg.norm(centred[:, first:].mean(axis=1) - centred[:, :first].mean(axis=1))
    return (
        f"the errors change by {1e3 * step:.3g} mm at {data.place(first)}, as if the instrument or the robot base had "
        "moved there: estimate the rows before and after it apart, or let a trace test it",
    )


_NOT_USED = "errors are against the model at the commanded joints; the cmd_ columns count only without `robot`"
N_WORST = 5
"""Number of the worst poses that are listed."""


class WorstPose(NamedTuple):
    """Pose with a large error."""

    line: int
    """1-based line in the file."""
    place: str
    """Line as text, or the row where the file has no lines."""
    pose: str | None
    """Id of the pose, where the file has ids."""
    target: str | None
    position: float
    """Length of the position error, m."""
    orientation: float | None
    """rad"""


class TargetErrors(NamedTuple):
    """Position errors of one of several targets."""

    name: str
    n_poses: int
    position: ErrorMetrics


# Errors of the distances between poses, which no registration of the base changes.
#
# What an arm is told as offsets from a point that it has found, and a ball bar or a scale bar measures, are distances.
# The largest error of many is the length measuring error of an instrument's acceptance (ISO 10360-2, VDI/VDE 2634-1),
# which is stated as a constant plus a share of the length: hence the share, and the errors of short and long distances.


@dataclass(frozen=True, slots=True)
class EstimateResult:
    """Errors, statistics and grade of measured poses."""

    n_poses: int
    commanded: Literal["robot", "file"]
    errors: PoseErrors
    position: ErrorStatistics
    orientation: ErrorStatistics | None
    grade: Grade
    alignment: Alignment | None
    unaligned: PoseMetrics | None
    """Metrics before the alignment; None without alignment."""
    worst_position: tuple[WorstPose, ...]
    """The :data:`N_WORST` poses with the largest position errors, descending."""
    worst_orientation: tuple[WorstPose, ...]
    targets: tuple[TargetErrors, ...]
    """Errors of each target, where several targets were measured."""
    distances: Mapping[str, Any] | None
    """Errors of the distances between poses, with the keys of the result; None where positions are not measured."""
    too_large: tuple[str, ...]
    """Advice on errors that, but for those far beyond the others, are too large for an arm; empty for others."""
    notes: tuple[str, ...]
    """Information that is needed to read the result."""
    warnings: tuple[str, ...]
    """Signs of mistakes in the data or the call."""


@dataclass(frozen=True)
class Totals:
    """What is counted over many poses."""

    position: ErrorSums
    orientation: ErrorSums | None
    commands: NDArray[np.uint64]
    """Hashes of different commands, the smallest."""
    of_targets: dict[str, ErrorSums]
    """Position errors of each target, where targets are named."""
    worst: Sequence[tuple[WorstPose, ...]]
    """Largest errors of position and of orientation."""
    warnings: tuple[str, ...]
    """The first warnings of rows and of how the file was read."""

    def __add__(self, other: Totals) -> Totals:
        """Return what is counted over the poses of both; those of the other come later in the file."""
        both = (self.of_targets, other.of_targets)
        names = dict.fromkeys((*self.of_targets, *other.of_targets))
        longest = (lambda pose: -pose.position, lambda pose: -(pose.orientation or 0.0))
        worst = zip(self.worst, other.worst, longest, strict=True)
        return Totals(
            self.position + other.position,
            self.orientation and other.orientation and self.orientation + other.orientation,
            smallest_hashes(self.commands, other.commands),
            {name: reduce(add, (sums[name] for sums in both if name in sums)) for name in names},
            [tuple(sorted((*own, *its), key=length)[:N_WORST]) for own, its, length in worst],
            tuple(dict.fromkeys((*self.warnings, *other.warnings)))[:MAX_PROBLEMS],
        )

    def statistics(self, confidence: float) -> tuple[ErrorStatistics, ErrorStatistics | None]:
        """Return the statistics of position and, where it was measured, of orientation."""
        count, turned = count_commands(self.commands, self.position.n), self.orientation
        return (
            statistics_of_sums(self.position, count, "m", confidence),
            None if turned is None else statistics_of_sums(turned, count, "rad", confidence),
        )

    @property
    def targets(self) -> tuple[TargetErrors, ...]:
        """Metrics of each target."""
        return tuple(
            TargetErrors(name, sums.n, length_metrics(sums.lengths)._replace(mean=float(sums.products[0, -1]) / sums.n))
            for name, sums in sorted(self.of_targets.items())
        )

    @property
    def far(self) -> tuple[float, int]:
        """Rms length of the errors without those far beyond the others, m, and how many are, as :func:`_far_errors`."""
        lengths = self.position.lengths
        limit = float(np.sqrt(3.0 * inlier_limit(np.square(lengths) / 3.0, np.array(3), self.position.n)))
        near = lengths[lengths <= limit] if limit > 0.0 else lengths
        return rms_length(near[None]), self.position.above(limit) if limit > 0.0 else 0


# Errors of the poses of a large file, counted part by part, by one process or by many, with the same result.


class PredictedBy(NamedTuple):
    """What predicts the commanded poses of every part, and the axes of the errors."""

    robot: Robot | None
    """Registered, if frames were fitted; None for the commanded poses of the file."""
    is_gantry: bool
    """The robot's joint variables are the coordinates of the file's commanded poses."""
    frame: ErrorFrame

    @classmethod
    def of(cls, robot: Robot | None, alignment: Alignment | None, frame: ErrorFrame) -> PredictedBy:
        """Return the robot, or without one the commanded poses of the file, with the frames that were fitted."""
        return cls(robot if alignment is None else alignment.robot, robot is None and alignment is not None, frame)

    def errors(self, data: Measurements) -> PoseErrors:
        """Return the errors of a part."""
        if self.is_gantry:
            from robacc.fitting.registration import as_gantry

            data = as_gantry(data)
        position, turns = commanded_poses(data, self.robot)
        turns = None if self.is_gantry and data.commanded_rotation is None else turns
        return pose_errors(data, position, turns, self.frame)


@single_threaded
def totals_of_part(
    read: Callable[[], Measurements], predicted: PredictedBy, origins: tuple[Array, Array | None]
) -> Totals:
    """Return what is counted over the poses of a part.

    Args:
        read: Function that reads the part.
        predicted: What predicts the commanded poses.
        origins: ``(3,)`` mean position error, m, and orientation error, rad, of some of the poses.

    Raises:
        InputError: A row is wrong; with every problem of the part.
    """
    data = read()
    errors = predicted.errors(data)
    hashes = data.hashed_commands()
    names = () if data.target is None else np.unique(data.target)
    own = {str(name): np.flatnonzero(data.target == name) for name in names}
    turned, (origin, turned_origin) = errors.rotation, origins
    return Totals(
        ErrorSums.of(errors.position, origin, hashes),
        None if turned is None or turned_origin is None else ErrorSums.of(turned, turned_origin, hashes),
        smallest_hashes(hashes),
        {name: ErrorSums.of(errors.position[:, rows], origin, hashes[rows]) for name, rows in own.items()},
        worst_poses(data, errors),
        data.warnings,
    )


def totals_of_parts(
    reads: Sequence[Callable[[], Measurements]],
    robot: Robot | None,
    workers: Workers,
    progress: Callable[[str, int, int], None],
    alignment: Alignment | None,
    errors: PoseErrors,
) -> Totals:
    """Return what is counted over all poses.

    Args:
        reads: Functions that read the parts, in their order.
        robot: Robot that predicts the commanded poses; None for those of the file.
        workers: What does the work.
        progress: Called with a label of the work, the number of parts done, and the number of all parts.
        alignment: Frames that were fitted to some of the poses; None without.
        errors: Errors of these poses.

    Raises:
        InputError: A row is wrong; with every problem of its part.
        UsageError: The workers cannot be reached.
    """
    work = partial(
        totals_of_part,
        predicted=PredictedBy.of(robot, alignment, errors.frame),
        origins=(errors.position.mean(axis=1), None if errors.rotation is None else errors.rotation.mean(axis=1)),
    )
    return reduce(add, workers.in_order(work, reads, partial(progress, "reading")))


def distance_errors(data: Measurements, predicted: PredictedBy) -> Mapping[str, Any] | None:
    """Return the errors of distances between poses, measured minus commanded, with the keys of the result.

    None where positions are not measured, or all poses are one. Frames in ``predicted`` are fitted to all poses: those
    of held-out poses differ from pose to pose.
    """
    if data.kind is not None:
        return None
    data = data.subset(even_rows(data.n, 300))  # whose pairs are 44,850 distances
    commanded = data.position - predicted._replace(frame="base").errors(data).position
    ends = np.stack(np.triu_indices(data.n, 1))
    measured, wanted = (vector_lengths(np.subtract(*p[:, ends].swapaxes(0, 1))) for p in (data.position, commanded))
    moved = wanted > STILL
    if not moved.any():
        return None
    wanted, error = wanted[moved], (measured - wanted)[moved]
    sizes, order = np.abs(error), np.argsort(wanted, kind="stable")
    largest, metrics = int(np.argmax(sizes)), length_metrics(sizes)
    return {
        "n_pairs": sizes.size,
        "rms_m": metrics.rms,
        "p95_m": metrics.p95,
        "max_m": metrics.max,
        # By least squares.
        "scale": float(error @ wanted / (wanted @ wanted)),
        "between": tuple(data.place(int(end)) for end in ends[:, moved][:, largest]),
        "distance_m": float(wanted[largest]),
        "bands": [
            {
                "up_to_m": float(wanted[part[-1]]),
                "n_pairs": part.size,
                "rms_m": float(rms_length(error[None, part])),
                "max_m": float(sizes[part].max()),
            }
            for part in np.array_split(order, 4)  # bands of distance, each of as many pairs
            if part.size
        ],
    }


def estimate(
    data: Measurements,
    robot: Robot | None = None,
    *,
    frame: ErrorFrame | None = None,
    align: Sequence[str] | None = None,
    scale: Scale | None = None,
    confidence: float = 0.95,
    seed: int = 0,
    totals: Callable[[Alignment | None, PoseErrors], Totals] | None = None,
) -> EstimateResult:
    """Compute the errors of measured poses against their commands, their statistics and the grade.

    Args:
        data: The measured poses; without a robot they need commanded poses.
        robot: Model that predicts the commanded poses at ``data.q``, effects included; it takes precedence over the
            commanded poses in ``data``.
        frame: Axes of the errors; None is "tool" where the commanded orientation is known, else "base".
        align: Frames to fit to the poses first, from :data:`robacc.fitting.registration.ALIGNABLE`; None fits base and
            tool where the errors without it are too large for an arm.
        scale: Grade scale; None is the built-in scale.
        confidence: Confidence of every interval.
        seed: Seed of the bootstrap.
        totals: Returns what is counted over all poses, where ``data`` are a sample of them. Frames are then fitted to
            the sample.

    Raises:
        UsageError: The arguments do not fit the data or each other.
        InputError: The data lack columns that the call needs.
    """
    check_confidence(confidence)
    commanded = commanded_poses(data, robot)
    oriented = commanded[1] is not None
    chosen = frame or ("tool" if oriented else "base")
    errors = pose_errors(data, *commanded, chosen)
    needed = frames_to_register(data, robot, _far_errors(errors.position)[0]) if align is None and _moves(data) else ()
    alignment, unaligned = None, None
    if frames := align or needed:
        turned = errors.position if errors.rotation is None else np.vstack((errors.position, errors.rotation))
        alignment, unaligned = register(data, robot, frames, held_out=True), pose_metrics(turned)
        commanded = commanded_poses(data, robot, alignment)
        errors = pose_errors(data, *commanded, chosen)
    share, everything = 1.0 if alignment is None else alignment.share, totals and totals(alignment, errors)
    groups = None if everything else data.repetitions()

    @cache
    def statistics(level: float) -> tuple[ErrorStatistics, ErrorStatistics | None]:
        if everything:
            return everything.statistics(level)
        of = partial(error_statistics, groups=groups, share=share, confidence=level, seed=seed)
        return of(errors.position, "m"), None if errors.rotation is None else of(errors.rotation, "rad")

    scale = scale or default_scale()
    # The scale has its own confidence; the reported statistics keep the requested confidence.
    (position, orientation), graded = statistics(confidence), statistics(scale.confidence)
    names = () if data.target is None or everything else np.unique(data.target)
    rows_of = {str(name): errors.position[:, data.target == name] for name in names}
    targets = tuple(TargetErrors(name, e.shape[1], pose_metrics(e).position) for name, e in rows_of.items())
    worst, targets, far = (
        (everything.worst, everything.targets, everything.far)
        if everything
        else (worst_poses(data, errors), targets, _far_errors(errors.position))
    )
    return EstimateResult(
        n_poses=position.n,
        commanded="file" if robot is None else "robot",
        errors=errors,
        position=position,
        orientation=orientation,
        grade=grade(*graded, scale),
        alignment=alignment,
        unaligned=unaligned,
        worst_position=worst[0],
        worst_orientation=worst[1],
        targets=targets if len(targets) > 1 else (),
        distances=distance_errors(data, PredictedBy.of(robot, alignment, chosen)),
        too_large=_too_large(data, errors, alignment, far[0]),
        notes=_notes(data, robot, frame, chosen, oriented, alignment),
        warnings=(
            *(everything.warnings if everything else data.warnings),
            *data.contradicted_ids(),
            *_far_rows(worst[0], *far),
            *([Note(_NOT_USED)] if robot is not None and data.commanded_position is not None else []),
        ),
    )


def check_confidence(confidence: float) -> None:
    """Raise UsageError if the confidence is not in [0.5, 1)."""
    refuse((not 0.5 <= confidence < 1.0, f"the confidence must be at least 0.5 and less than 1, not {confidence:g}"))


def worst_poses(data: Measurements, errors: PoseErrors) -> Sequence[tuple[WorstPose, ...]]:
    """Return the poses with the largest errors of position and of orientation, descending.

    Equal lengths are in the order of rows.
    """
    sizes = [vector_lengths(vectors) for vectors in (errors.position, errors.rotation) if vectors is not None]

    def pose(i: int) -> WorstPose:
        pose, target = (None if column is None else str(column[i]) for column in (data.pose, data.target))
        position, orientation = (*(float(size[i]) for size in sizes), None)[:2]
        return WorstPose(data.line(i), data.place(i), pose, target, position or 0.0, orientation)

    # A stable sort, so that the choice among ties does not depend on it.
    first = [tuple(map(pose, np.argsort(-size, kind="stable")[:N_WORST].tolist())) for size in sizes]
    return (*first, ())[:2]


def _notes(
    data: Measurements,
    robot: Robot | None,
    requested: ErrorFrame | None,
    frame: ErrorFrame,
    oriented: bool,
    alignment: Alignment | None,
) -> tuple[str, ...]:
    effects = dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects) if robot is not None else ()
    missing = "measured" if data.rotation is None else "commanded"
    n_parameters, of_fit = (0, ()) if alignment is None else (alignment.n_parameters, alignment.notes)
    sigma = 0.0 if data.sigma_position is None else rms_length(data.sigma_position) * 1e3
    return applying(
        (
            requested is None and frame == "base",
            "no orientation was commanded, so the errors are in the measuring frame",
        ),
        (
            data.rotation is None or not oriented,
            f"no orientation was {missing}, so there are no orientation errors",
        ),
        (bool(effects), f"effects of the robot file are applied: {', '.join(effects)}"),
        (
            alignment is not None,
            f"{n_parameters} parameters of the frames were fitted to these poses; the error of each pose is "
            "that with the frames registered to the other poses",
        ),
        *((True, note) for note in of_fit),
        (
            data.sigma_position is not None,
            f"the position errors include the measuring uncertainty, {sigma:.2g} mm rms",
        ),
    )


def _moves(data: Measurements) -> bool:
    """Return whether the robot was commanded to several places; scatter at a single place does not show frames."""
    commands = data.commanded_position if data.q is None else data.q
    return commands is not None and float(np.max(np.ptp(commands, axis=1), initial=0.0)) > STILL


def _relative_size(data: Measurements, alignment: Alignment) -> float:
    """Return how many times as far apart positions are as commanded, where they agree but for this; else 1."""
    from scipy.optimize import minimize_scalar

    def error(log_size: float) -> float:
        smaller = replace(data, position=data.position / np.exp(log_size))
        commanded = register(smaller, alignment.robot, alignment.effects).commanded
        return rms_length(smaller.position - commanded.translation)

    found = minimize_scalar(error, bounds=(-1.0, 1.0), method="bounded", options={"xatol": 1e-3})
    return float(np.exp(found.x)) if 2.0 * found.fun < error(0.0) else 1.0


def _far_rows(worst: Sequence[WorstPose], usual: float, n_far: int) -> tuple[str, ...]:
    """Warn of errors far beyond the others."""
    named = ", ".join(f"{pose.place} ({1e3 * pose.position:.3g} mm)" for pose in worst[:n_far])
    more = f" and {n_far - N_WORST} more" if n_far > N_WORST else ""
    return applying(
        (
            n_far > 0,
            f"far beyond the other errors ({1e3 * usual:.3g} mm rms without): {named}{more}; all figures include "
            "them: check these readings and their commands",
        )
    )


def _too_large(data: Measurements, errors: PoseErrors, alignment: Alignment | None, usual: float) -> tuple[str, ...]:
    """Return the advice on errors that are too large for an arm: of position, ``usual`` m rms, or of orientation."""
    far = _moves(data) and too_far(usual, data.position)
    # An arm as built is a fraction of a degree off.
    turned = errors.rotation is not None and _far_errors(errors.rotation)[0] > np.deg2rad(5.0)
    outside = "; ".join(text.rpartition(": ")[2] for text in data.warnings if text.endswith(MOVES_UNUSED))
    size = _relative_size(data, alignment) if far and alignment is not None and data.q is not None else 1.0
    advice = applying(
        (
            far and bool(outside),
            f"the errors are too large for an arm, and {outside}: an axis that carries the arm is one of its joints",
        ),
        (alignment is None, UNREGISTERED),
        (
            far and size != 1.0,
            f"the measured positions are {size:.3g} times as far apart as the arm's, and agree with them but for this: "
            "check the size of the squares of the board, the unit of length, and the robot",
        ),
        (far, TOO_LARGE),
        (
            True,
            "the positions agree, but the orientation errors are too large for an arm: check the order of the "
            "quaternion or the convention of the angles",
        ),
    )
    return advice[:1] if far or turned else ()
