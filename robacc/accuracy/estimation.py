"""Accuracy of measured poses: registration, errors, statistics and grade.

:mod:`robacc.accuracy.pose_errors` computes the error of each pose, :mod:`robacc.accuracy.error_statistics` the
statistics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import ErrorStatistics, Unit, error_statistics
from robacc.accuracy.grade import Grade, Scale, default_scale, grade
from robacc.accuracy.pose_errors import (
    Commanded,
    CommandSource,
    ErrorFrame,
    PoseErrors,
    commanded_poses,
    lengths,
    pose_errors,
    pose_metrics,
    registered_poses,
)
from robacc.errors import InputError, Note, RobaccError, UsageError
from robacc.fitting.outliers import inlier_mask
from robacc.geometry import Array, rms_length
from robacc.measurements import MOVES_UNUSED, Measurements
from robacc.robots.description import Robot

if TYPE_CHECKING:
    from robacc.accuracy.pose_errors import ErrorMetrics, PoseMetrics
    from robacc.fitting.registration import Alignment


# Registration of the commanded poses before errors are judged, and the sign that it is missing.

_FAR = 0.05
"""Position error relative to the extent of the poses above which the cause is a frame or a unit, not the arm (whose
errors are some mm on a reach of a metre)."""
_MOSTLY = 0.6
"""Share of the errors' squares from which a step explains them."""
_FEWEST_ROWS, _FEWEST_AT_END = 20, 3
"""Rows that a step is looked for in, and rows before and after it, at least."""


def register(data: Measurements, robot: Robot | None, frames: Sequence[str], *, held_out: bool = False) -> Alignment:
    """Fit ``frames`` of the robot, or without a robot of the commanded poses, to the measured poses.

    See :func:`robacc.fitting.registration.align`.
    """
    from robacc.fitting import registration

    if robot is None:
        return registration.align_commands(data, frames, held_out=held_out)
    return registration.align(robot, data, frames, held_out=held_out)


def too_far(error: float, position: Array) -> bool:
    """Return whether an error in m is too large for an arm that moved between the positions ``(3, N)``."""
    return error > _FAR * rms_length(position - position.mean(axis=1, keepdims=True))


def _near(errors: Array) -> NDArray[np.bool_]:
    """Return ``(N,)`` the mask of position errors ``(3, N)`` that are not far beyond the others."""
    return inlier_mask(errors, np.ones((1, 1)), np.ones(errors.shape[1], dtype=np.bool_), 0)


def _usual(errors: Array) -> float:
    """Return the rms length of position errors ``(3, N)`` without those far beyond the others, m."""
    return rms_length(errors[:, _near(errors)])


def frames_to_register(data: Measurements, robot: Robot | None, error: float) -> tuple[str, ...]:
    """Return frames that take a position error in m that no arm has to one that an arm may have; none otherwise.

    Raises:
        InputError: The error is one that no arm has, and the positions are too few to register frames.
    """
    if not too_far(error, data.position):
        return ()
    if data.n < 3 and data.rotation is None:
        raise InputError(
            f"{data.n} positions whose errors, {1e3 * error:.3g} mm rms, are too large for an arm: the frames do not "
            'agree, and registration needs more positions; measure at least 4, or keep the errors with `align="none"`'
        )
    for frames in (("base_frame", "tool_frame"), ("base_frame",)):
        try:
            commanded = register(data, robot, frames).commanded
        except RobaccError:
            continue
        registered = _usual(data.position - commanded.translation)
        if registered < _FAR * error and not too_far(registered, data.position):
            return frames
    return ()


def unregistered_warning(registered: bool) -> str:
    """Return the warning of errors that are too large for an arm."""
    if registered:
        return (
            "the errors are too large for an arm: check the units, the joint signs, the order of the joints, that each "
            "row has its own command, and that the axes are right-handed"
        )
    return (
        "the errors are too large for an arm and suggest frames that are not registered; register the frames with "
        '`align="base_frame,tool_frame"`'
    )


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
    if explained.max() <= _MOSTLY * np.sum(np.square(centred)):
        return ()
    step = np.linalg.norm(centred[:, first:].mean(axis=1) - centred[:, :first].mean(axis=1))
    return (
        f"the errors change by {1e3 * step:.3g} mm at {data.place(first)}, as if the instrument or the robot base had "
        "moved there: estimate the rows before and after it apart, or let a trace test it",
    )


_NOT_USED = "errors are against the model at the commanded joints; the cmd_ columns count only without `robot`"
N_WORST = 5
"""Number of the worst poses that are listed."""

_STILL = 1e-6
"""rad or m; commanded poses that differ by less are equal."""
_TURNED = np.deg2rad(5.0)
"""Orientation error in rad above which the cause is not the arm: an uncalibrated arm has a fraction of a degree."""


@dataclass(frozen=True, slots=True)
class WorstPose:
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


@dataclass(frozen=True, slots=True)
class TargetErrors:
    """Position errors of one of several targets."""

    name: str
    n_poses: int
    position: ErrorMetrics


@dataclass(frozen=True, slots=True)
class EstimateResult:
    """Errors, statistics and grade of measured poses."""

    n_poses: int
    commanded: CommandSource
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
    notes: tuple[str, ...]
    """Information that is needed to read the result."""
    warnings: tuple[str, ...]
    """Signs of mistakes in the data or the call."""


def estimate(
    data: Measurements,
    robot: Robot | None = None,
    *,
    frame: ErrorFrame | None = None,
    align: Sequence[str] | None = None,
    scale: Scale | None = None,
    confidence: float = 0.95,
    seed: int = 0,
) -> EstimateResult:
    """Compute the errors of measured poses against their commands, their statistics and the grade.

    Args:
        data: The measured poses; without a robot they need commanded poses.
        robot: Model that predicts the commanded poses at ``data.q``, effects included; it takes precedence over the
            commanded poses in ``data``.
        frame: Axes of the errors; None is "tool" where the commanded orientation is known, else "base".
        align: Frames to fit to the poses first, from :data:`robacc.fitting.registration.ALIGNABLE`; None fits base and
            tool where the errors without it are too large for an arm and those with it are not.
        scale: Grade scale; None is the built-in scale.
        confidence: Confidence of every interval.
        seed: Seed of the bootstrap.

    Raises:
        UsageError: The arguments do not fit the data or each other.
        InputError: The data lack columns that the call needs.
    """
    check_confidence(confidence)
    commanded = commanded_poses(data, robot)
    chosen = frame or ("tool" if commanded.oriented else "base")
    errors = pose_errors(data, commanded, chosen)
    needed = frames_to_register(data, robot, _usual(errors.position)) if align is None and _moves(data) else ()
    alignment, unaligned = None, None
    if frames := align or needed:
        alignment, unaligned = register(data, robot, frames, held_out=True), errors.metrics()
        commanded = registered_poses(data, robot, alignment)
        errors = pose_errors(data, commanded, chosen)
    repetitions = data.repetitions()
    groups = None if repetitions is None else repetitions.repeated
    share = 1.0 if alignment is None else alignment.share
    position, orientation = _statistics(groups, errors, share, confidence, seed)
    scale = scale or default_scale()
    graded = position, orientation
    if scale.confidence != confidence:
        # The scale has its own confidence; the reported statistics keep the requested confidence.
        graded = _statistics(groups, errors, share, scale.confidence, seed)
    names = () if data.target is None else np.unique(data.target)
    rows_of = {str(name): errors.position[:, data.target == name] for name in names}
    targets = tuple(TargetErrors(name, e.shape[1], pose_metrics(e).position) for name, e in rows_of.items())
    return EstimateResult(
        n_poses=data.n,
        commanded=commanded.source,
        errors=errors,
        position=position,
        orientation=orientation,
        grade=grade(*graded, scale),
        alignment=alignment,
        unaligned=unaligned,
        worst_position=_worst_poses(data, errors, errors.position),
        worst_orientation=() if errors.rotation is None else _worst_poses(data, errors, errors.rotation),
        targets=targets if len(targets) > 1 else (),
        notes=_notes(data, robot, frame, chosen, commanded, alignment),
        warnings=(
            *data.warnings,
            *data.contradicted_ids(),
            *_warnings(data, errors, alignment),
            *([Note(_NOT_USED)] if robot is not None and data.commanded_position is not None else []),
        ),
    )


def _statistics(
    groups: NDArray[np.int64] | None, errors: PoseErrors, share: float, confidence: float, seed: int
) -> tuple[ErrorStatistics, ErrorStatistics | None]:
    def statistics(vectors: Array, unit: Unit) -> ErrorStatistics:
        return error_statistics(vectors, unit, groups=groups, share=share, confidence=confidence, seed=seed)

    return statistics(errors.position, "m"), None if errors.rotation is None else statistics(errors.rotation, "rad")


def check_confidence(confidence: float) -> None:
    """Raise UsageError if the confidence is not in [0.5, 1)."""
    if not 0.5 <= confidence < 1.0:
        raise UsageError(f"the confidence must be at least 0.5 and less than 1, not {confidence:g}")


def _worst_poses(data: Measurements, errors: PoseErrors, vectors: Array) -> tuple[WorstPose, ...]:
    """Return the poses with the longest ``vectors`` ``(3, N)``, descending; equal lengths in the order of rows."""
    size = lengths(vectors)
    candidates = np.arange(size.size)
    if size.size > N_WORST:
        # All poses that reach the last listed length, so that the choice among ties does not depend on the sort.
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


def _notes(
    data: Measurements,
    robot: Robot | None,
    requested: ErrorFrame | None,
    frame: ErrorFrame,
    commanded: Commanded,
    alignment: Alignment | None,
) -> tuple[str, ...]:
    notes = []
    if requested is None and frame == "base":
        notes.append("no orientation was commanded, so the errors are in the measuring frame")
    if data.rotation is None:
        notes.append("no orientation was measured, so there are no orientation errors")
    elif not commanded.oriented:
        notes.append("no orientation was commanded, so there are no orientation errors")
    if robot is not None and robot.effects:
        names = dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects)
        notes.append(f"effects of the robot file are applied: {', '.join(names)}")
    if alignment is not None:
        notes.append(
            f"{alignment.n_parameters} parameters of the frames were fitted to these poses; the error of each pose is "
            "that with the frames registered to the other poses"
        )
        notes.extend(alignment.notes)
    if data.sigma_position is not None:
        sigma = rms_length(data.sigma_position) * 1e3
        notes.append(f"the position errors include the measuring uncertainty, {sigma:.2g} mm rms")
    return tuple(notes)


def _moves(data: Measurements) -> bool:
    """Return whether the robot was commanded to several places; scatter at a single place does not show frames."""
    commands = data.commands
    return commands is not None and float(np.max(np.ptp(commands, axis=1), initial=0.0)) > _STILL


def _warnings(data: Measurements, errors: PoseErrors, alignment: Alignment | None) -> tuple[str, ...]:
    """Warn of errors far beyond the others, or else of errors that are too large for an arm."""
    near, size = _near(errors.position), lengths(errors.position)
    usual, beyond = rms_length(errors.position[:, near]), np.flatnonzero(~near)
    if beyond.size:
        largest = beyond[np.argsort(-size[beyond])][:N_WORST]
        named = ", ".join(f"{data.place(int(i))} ({1e3 * size[i]:.3g} mm)" for i in largest)
        more = f" and {beyond.size - N_WORST} more" if beyond.size > N_WORST else ""
        return (
            f"far beyond the other errors ({1e3 * usual:.3g} mm rms without): {named}{more}; all figures include "
            "them: check these readings and their commands",
        )
    far = _moves(data) and too_far(usual, data.position)
    turned = errors.rotation is not None and rms_length(errors.rotation) > _TURNED
    if not (far or turned):
        return ()
    outside = "; ".join(text.rpartition(": ")[2] for text in data.warnings if text.endswith(MOVES_UNUSED))
    if far and outside:
        return (
            f"the errors are too large for an arm, and {outside}: an axis that carries the arm is one of its joints",
        )
    if alignment is None:
        return (unregistered_warning(registered=False),)
    warning = unregistered_warning(registered=True)
    if not far:
        warning = (
            "the positions agree, but the orientation errors are too large for an arm: check the order of the "
            "quaternion or the convention of the angles"
        )
    return (f"{warning}{'' if data.q is None else '; a trace names the probable mistake'}",)
