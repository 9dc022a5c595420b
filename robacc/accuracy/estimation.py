"""How far the arm was from where it was to be, and what the errors together say: equations (3)-(5), (13) and (14).

The error of each pose is :mod:`robacc.accuracy.pose_errors`', the statistics are
:mod:`robacc.accuracy.error_statistics`'s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import error_statistics
from robacc.accuracy.grade import Grade
from robacc.accuracy.grade_scale import Scale, default_scale
from robacc.accuracy.grading import grade
from robacc.accuracy.pose_errors import (
    Commanded,
    CommandSource,
    ErrorFrame,
    PoseErrors,
    commanded_poses,
    lengths,
    pose_errors,
    rms_length,
)
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.statistics.records import ErrorStatistics, Unit

if TYPE_CHECKING:
    from robacc.accuracy.metrics import ErrorMetrics, PoseMetrics
    from robacc.fitting.registration import Alignment
    from robacc.robots.description import Robot

N_WORST = 5
"""Poses listed by row: enough to look at, few enough to read."""

_FAR = 0.05
"""An error of more than this fraction of the poses' own spread is no arm's (some mm on a reach of a metre): frames that
were not registered, or units, are."""
_STILL = 1e-6
"""rad or m; commanded poses that differ by less are one."""
_TURNED = np.deg2rad(5.0)
"""The same for orientation: an uncalibrated arm's is a fraction of a degree."""


@dataclass(frozen=True, slots=True)
class WorstPose:
    """A pose to look at."""

    line: int
    """1-based line of the file."""
    place: str
    """The same in words, or its row where the file has no lines."""
    pose: str | None
    """Its id, where the file has one."""
    target: str | None
    position: float
    """Length of its error, m."""
    orientation: float | None
    """rad"""


@dataclass(frozen=True, slots=True)
class TargetErrors:
    """The position errors of one of several targets."""

    name: str
    n_poses: int
    position: ErrorMetrics


@dataclass(frozen=True, slots=True)
class EstimateResult:
    """How far the arm was from where it was to be."""

    n_poses: int
    commanded: CommandSource
    errors: PoseErrors
    position: ErrorStatistics
    orientation: ErrorStatistics | None
    grade: Grade
    alignment: Alignment | None
    unaligned: PoseMetrics | None
    """Before the alignment, where there was one."""
    worst_position: tuple[WorstPose, ...]
    """The :data:`N_WORST` poses with the largest position errors, the largest first."""
    worst_orientation: tuple[WorstPose, ...]
    targets: tuple[TargetErrors, ...]
    """One for each, where more than one was measured."""
    notes: tuple[str, ...]
    """What a reader must know to read the figures."""
    warnings: tuple[str, ...]
    """What looks wrong."""


def estimate(
    data: Measurements,
    robot: Robot | None = None,
    *,
    frame: ErrorFrame | None = None,
    what: Sequence[str] = (),
    scale: Scale | None = None,
    confidence: float = 0.95,
    seed: int = 0,
) -> EstimateResult:
    """The errors of measured poses against their commands, and their statistics.

    Args:
        data: The measured poses; with no robot they must carry their commanded poses.
        robot: Commands the poses at ``data.q``, its effects included; goes before commanded poses in ``data``.
        frame: Axes of the errors; None is "tool" where the commanded orientation is known, else "base".
        what: Of :data:`robacc.fitting.registration.ALIGNABLE`: what is fitted to the poses first.
        scale: Grade scale; None is the package's own.
        confidence: Of every interval.
        seed: Of the bootstrap.

    Raises:
        UsageError: the call does not fit the data, or itself.
        InputError: the data lack what the call needs.
    """
    check_call(robot, what, confidence)
    commanded = commanded_poses(data, robot)
    chosen = _choose_frame(frame, commanded)
    alignment, unaligned = None, None
    if robot is not None and what:
        from robacc.fitting.registration import align

        alignment = align(robot, data, what)
        unaligned = pose_errors(data, commanded, chosen).figures()
        commanded = commanded_poses(data, alignment.robot)
    errors = pose_errors(data, commanded, chosen)
    repetitions = data.repetitions()
    groups = None if repetitions is None else repetitions.repeated
    aligned = () if alignment is None else alignment.effects
    position, orientation = _statistics(groups, errors, aligned, confidence, seed)
    scale = scale or default_scale()
    graded = position, orientation
    if scale.confidence != confidence:
        # A scale states the confidence it demonstrates at; the figures keep the one that was asked for.
        graded = _statistics(groups, errors, aligned, scale.confidence, seed)
    return EstimateResult(
        n_poses=data.n,
        commanded=commanded.source,
        errors=errors,
        position=position,
        orientation=orientation,
        grade=grade(*graded, scale),
        alignment=alignment,
        unaligned=unaligned,
        worst_position=_worst(data, errors, errors.position),
        worst_orientation=() if errors.rotation is None else _worst(data, errors, errors.rotation),
        targets=_by_target(data, errors),
        notes=_notes(data, robot, frame, chosen, commanded, alignment),
        warnings=(
            *data.warnings,
            *data.contradicted_ids(repetitions),
            *_warnings(data, errors, alignment),
            *_beyond_learnt(data, robot),
        ),
    )


def _statistics(
    groups: NDArray[np.int64] | None, errors: PoseErrors, aligned: Sequence[str], confidence: float, seed: int
) -> tuple[ErrorStatistics, ErrorStatistics | None]:
    def found(of: Array, unit: Unit, centred: bool) -> ErrorStatistics:
        return error_statistics(of, unit, groups=groups, aligned=centred, confidence=confidence, seed=seed)

    # Moving a frame along its axes takes out the mean along them. Turning the target takes out that of its rotations;
    # turning the base moves the target too, and leaves some of theirs.
    own = "tool_frame" if errors.frame == "tool" else "base_frame"
    position = found(errors.position, "m", own in aligned)
    if errors.rotation is None:
        return position, None
    return position, found(errors.rotation, "rad", own == "tool_frame" and own in aligned)


def check_call(robot: Robot | None, what: Sequence[str], confidence: float) -> None:
    """Raise UsageError where an alignment has no robot to move, or the confidence is no probability of use."""
    if what and robot is None:
        raise UsageError("an alignment moves the robot's base or tool, so it needs --robot")
    if not 0.5 <= confidence < 1.0:
        raise UsageError(f"the confidence is a probability of at least 0.5 and below 1, not {confidence:g}")


def _choose_frame(frame: ErrorFrame | None, commanded: Commanded) -> ErrorFrame:
    if frame is not None:
        return frame
    return "tool" if commanded.oriented else "base"


def _worst(data: Measurements, errors: PoseErrors, by: Array) -> tuple[WorstPose, ...]:
    """The poses with the largest of the errors ``by`` ``(3, N)``, the largest first; of equal ones the earlier row."""
    size = lengths(by)
    candidates = np.arange(size.size)
    if size.size > N_WORST:
        # All that reach the last place's size, so that which of equal ones are listed does not hang on the sort.
        candidates = np.flatnonzero(size >= np.partition(size, -N_WORST)[-N_WORST])
    order = candidates[np.argsort(-size[candidates], kind="stable")][:N_WORST]
    position = lengths(errors.position[:, order])
    orientation = [None] * order.size if errors.rotation is None else lengths(errors.rotation[:, order]).tolist()
    return tuple(
        WorstPose(
            data.line(int(i)),
            data.place(int(i)),
            None if data.pose is None else str(data.pose[i]),
            None if data.target is None else str(data.target[i]),
            float(position[rank]),
            orientation[rank],
        )
        for rank, i in enumerate(order)
    )


def _by_target(data: Measurements, errors: PoseErrors) -> tuple[TargetErrors, ...]:
    if data.target is None:
        return ()
    names, index = np.unique(data.target, return_inverse=True)
    if names.size < 2:
        return ()
    from robacc.accuracy.metrics import pose_metrics

    return tuple(
        TargetErrors(str(name), int(np.sum(index == i)), pose_metrics(errors.position[:, index == i]).position)
        for i, name in enumerate(names)
    )


def _notes(
    data: Measurements,
    robot: Robot | None,
    asked: ErrorFrame | None,
    frame: ErrorFrame,
    commanded: Commanded,
    alignment: Alignment | None,
) -> tuple[str, ...]:
    notes = []
    if robot is not None and data.commanded_position is not None:
        notes.append("commanded poses are the robot's; the file's cmd_ columns were not used")
    if asked is None and frame == "base":
        notes.append("no commanded orientation, so the errors are in the measuring frame")
    if data.rotation is None:
        notes.append("no orientation was measured, so there is no orientation error")
    elif not commanded.oriented:
        notes.append("no orientation was commanded, so there is no orientation error")
    if robot is not None and robot.effects:
        names = dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects)
        notes.append(f"the robot file's effects are applied: {', '.join(names)}")
    if alignment is not None:
        notes.append(f"the alignment was fitted to these same poses, with {alignment.n_parameters} parameters")
        notes.extend(alignment.notes)
    if data.sigma_position is not None:
        sigma = rms_length(data.sigma_position) * 1e3
        notes.append(f"the measuring uncertainty, {sigma:.2g} mm rms, is contained in the position figures")
    return tuple(notes)


def _moves(data: Measurements) -> bool:
    """Whether the robot was sent to more than one place; the scatter at one says nothing of frames."""
    sent = data.q if data.q is not None else data.commanded_position
    return sent is not None and float(np.max(np.ptp(sent, axis=1), initial=0.0)) > _STILL


def _beyond_learnt(data: Measurements, robot: Robot | None) -> tuple[str, ...]:
    """Which corrections of the robot file are used outside the range that they were learnt in."""
    if robot is None or not robot.effects:
        return ()
    from robacc.effects.specification import known_effects
    from robacc.robots.arm import Arm

    arm, found = Arm.of(robot), []
    for known in known_effects(robot):
        count = int(np.count_nonzero(known.effect.outside_range(arm, data)))
        if count:
            found.append(
                f"{count} of {data.n} poses are outside the range in which {known.effect} of the robot file was "
                "learnt: it is held there as it is at the range's end, and says little of them"
            )
    return tuple(found)


def _warnings(data: Measurements, errors: PoseErrors, alignment: Alignment | None) -> tuple[str, ...]:
    """What errors too large for an arm suggest."""
    spread = rms_length(data.position - data.position.mean(axis=1, keepdims=True))
    far = _moves(data) and rms_length(errors.position) > _FAR * spread
    turned = errors.rotation is not None and rms_length(errors.rotation) > _TURNED
    if not (far or turned):
        return ()
    cause = "units, joint signs or the order of the joints" if alignment is not None else "frames that do not agree"
    advice = "" if alignment is not None else "; try --align base_frame,tool_frame"
    return (f"errors this large come from {cause} rather than from the arm{advice}",)
