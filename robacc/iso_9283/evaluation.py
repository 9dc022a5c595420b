"""Evaluation of measured poses after ISO 9283:1998: the criteria they support, and the protocol's conditions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robacc.accuracy.estimation import check_confidence
from robacc.accuracy.pose_errors import Commanded, commanded_poses, registered_poses
from robacc.accuracy.registering import register, too_far, unregistered_warning
from robacc.errors import InputError, Problem, UsageError
from robacc.fitting.registration import Alignment
from robacc.geometry import Array, Poses
from robacc.iso_9283.distance_criteria import distance_criteria
from robacc.iso_9283.drift import drift
from robacc.iso_9283.pose_criteria import accuracy, exchangeability, multidirectional, position_accuracy, repeatability
from robacc.iso_9283.protocol import protocol
from robacc.iso_9283.records import Characteristic, Iso9283Result
from robacc.iso_9283.visits import CommandedPose, shifting_commands, visits_of
from robacc.measurements import Measurements
from robacc.robots.description import Frame, Robot
from robacc.statistics.multivariate import assumption_tests

_HEAVY_TAIL_P_VALUE = 0.01
"""p-value below which a note says that the scatter is not Gaussian."""
_MAX_POSES = 300
"""Largest number of commanded poses in a file: sixty times the standard's five."""


def iso9283(
    files: Sequence[Measurements],
    robot: Robot | None = None,
    *,
    align: Sequence[str] = (),
    confidence: float = 0.95,
    seed: int = 0,
    windows: int | None = None,
    rated_load: float | None = None,
) -> Iso9283Result:
    """Evaluate the pose criteria of ISO 9283 for one robot per file.

    Args:
        files: Measured poses of at least one file. Without ``robot`` and without commanded poses in a file there is
            repeatability but no accuracy.
        robot: Gives the commanded pose of every row at its q, effects included; replaces commanded poses in the file.
        align: Frames of :data:`robacc.fitting.registration.ALIGNABLE` that are fitted to each file's poses.
        confidence: Confidence of every interval.
        seed: Seed of the bootstrap.
        windows: Number of windows that each pose's visits are divided into for the drift; None: ten visits each.
        rated_load: Rated load in kg; None: not known.

    Raises:
        UsageError: The arguments contradict each other or the data.
        InputError: The data lack something that the call needs.
    """
    check_confidence(confidence)
    _check_arguments(files, windows, rated_load)
    sources = _file_names(files)
    commands = [_commanded_of(data, robot) for data in files]
    nominal_poses = [visits_of(data, commands[i], sources[i], i) for i, data in enumerate(files)]
    _check_count(nominal_poses)
    alignments = _alignments(files, robot, align)
    poses_by_file = nominal_poses
    if alignments:
        registered_commands = [
            registered_poses(data, robot, alignment) for data, alignment in zip(files, alignments, strict=True)
        ]
        poses_by_file = [visits_of(data, registered_commands[i], sources[i], i) for i, data in enumerate(files)]
    poses = tuple(pose for file_poses in poses_by_file for pose in file_poses)
    repeatability_characteristic = repeatability(poses, confidence, seed)
    accuracy_drift, repeatability_drift, shift = drift(poses, confidence, seed, windows)
    exchanged = exchangeability(nominal_poses, _positions_in_shared_frame(nominal_poses, robot, alignments), confidence)
    if robot is not None and alignments:
        robot = alignments[0].robot
    return Iso9283Result(
        n_poses=sum(data.n for data in files),
        sources=tuple(sources),
        commanded=next((command.source for command in commands if command is not None), None),
        poses=poses,
        characteristics=(
            accuracy(poses, confidence),
            repeatability_characteristic,
            multidirectional(poses, confidence),
            *distance_criteria(poses, confidence),
            accuracy_drift,
            repeatability_drift,
            shift,
            exchanged,
        ),
        protocol=protocol(files, poses, robot, repeatability_characteristic, shift, rated_load),
        alignments=tuple(alignments),
        unaligned=np.array([_largest_accuracy(file_poses) for file_poses in nominal_poses]) if alignments else None,
        confidence=confidence,
        notes=_notes(poses, alignments, robot, files, shift),
        warnings=_warnings(files, poses_by_file, bool(alignments)),
    )


def _check_arguments(files: Sequence[Measurements], windows: int | None, rated_load: float | None) -> None:
    if not files:
        raise UsageError("no file of measured poses is given; give at least one")
    if windows is not None and windows < 2:
        raise UsageError(f"drift is a change between windows: `drift_windows` is at least 2, not {windows}")
    if rated_load is not None and not 0.0 < rated_load < np.inf:
        raise UsageError(f"`rated_load` is above 0 kg, not {rated_load:g}")


def _file_names(files: Sequence[Measurements]) -> list[str]:
    """Return a unique name for each file."""
    names = [(data.source or f"file {i + 1}").replace("\\", "/").rpartition("/")[2] for i, data in enumerate(files)]
    return [f"{name} ({i + 1})" if names.count(name) > 1 else name for i, name in enumerate(names)]


def _commanded_of(data: Measurements, robot: Robot | None) -> Commanded | None:
    """Return the commanded poses of a file; None if neither the robot nor the file gives them."""
    if robot is None and data.commanded_position is None:
        return None
    return commanded_poses(data, robot)


def _check_count(poses_by_file: Sequence[Sequence[CommandedPose]]) -> None:
    """Reject files with too many commanded poses, in which few poses are visited again.

    Raises:
        InputError: A file has too many commanded poses.
    """
    problems = [
        Problem(
            f"has {len(poses)} commanded poses; the standard's criteria need a few poses, at most {_MAX_POSES}",
            poses[0].source,
            fix="name the commanded poses in a column pose; the command estimate takes poses that are visited once",
        )
        for poses in poses_by_file
        if len(poses) > _MAX_POSES
    ]
    if problems:
        raise InputError(problems)


def _alignments(files: Sequence[Measurements], robot: Robot | None, align: Sequence[str]) -> list[Alignment]:
    """Return the registration of each file, or an empty list if no frame is fitted."""
    if not align:
        return []
    if robot is None and any(data.commanded_position is None for data in files):
        raise UsageError(
            "`align` registers commanded poses, and there are none: give `robot`, or columns cmd_x, cmd_y, cmd_z"
        )
    return [register(data, robot, align) for data in files]


def _largest_accuracy(poses: Sequence[CommandedPose]) -> float:
    """Return the largest AP_p, m."""
    return max(position_accuracy(pose.deviation).value for pose in poses if pose.deviation is not None)


def _positions_in_shared_frame(
    poses_by_file: Sequence[Sequence[CommandedPose]], robot: Robot | None, alignments: Sequence[Alignment]
) -> list[list[Array]]:
    """Return attained positions of each file in a frame that the robots share: if registered, the robot file's.

    Registered robots were measured in different frames, so positions move from the registered to the nominal base.
    """
    if not alignments:
        return [[pose.attained for pose in poses] for poses in poses_by_file]
    nominal = _base_pose(robot.base if robot is not None else Frame())
    positions = []
    for poses, alignment in zip(poses_by_file, alignments, strict=True):
        rotation = nominal.rotation @ _base_pose(alignment.robot.base).rotation.T
        registered_base = _base_pose(alignment.robot.base)
        positions.append(
            [
                rotation @ (pose.attained - registered_base.translation[:, None]) + nominal.translation[:, None]
                for pose in poses
            ]
        )
    return positions


def _base_pose(base: Frame) -> Poses:
    return Poses.from_xyz_rpy(np.array(base.xyz), np.array(base.rpy))


def _notes(
    poses: Sequence[CommandedPose],
    alignments: Sequence[Alignment],
    robot: Robot | None,
    files: Sequence[Measurements],
    shift: Characteristic,
) -> tuple[str, ...]:
    notes = [
        "RP is how closely the visits of a pose agree with each other; their distance from the commanded pose is AP"
    ]
    if any(sum(pose.number == number for pose in poses) > 1 for number in range(len(files))):
        notes.append(
            "every criterion is the largest over all measured poses or pairs of poses; where the standard prescribes "
            "fewer (for distances P2 to P4, for drift P1), the JSON result has the value of each pose"
        )
    if robot is not None and any(data.commanded_position is not None for data in files):
        notes.append("commanded poses are from the robot; the files' cmd_ columns were not used")
    if robot is not None and robot.effects:
        names = dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects)
        notes.append(f"the robot file's effects are applied to the command: {', '.join(names)}")
    for alignment in alignments:
        count = alignment.n_parameters
        notes.append(f"AP and dAP are after registration with {count} parameters, fitted to the same poses")
        notes.extend(alignment.notes)
    if any(pose.at_pole for pose in poses):
        notes.append(
            "a, b, c are rotations about x, y, z of the measuring frame where pitch is within 10° of 90°: roll and yaw "
            "are not defined there"
        )
    if shift.position.interval.lower:
        notes.append("the robot drifted during the run by more than the scatter explains: AP and RP include the drift")
    if (tails := _heavy_tails(poses)) is not None:
        notes.append(tails)
    return tuple(dict.fromkeys(notes))


def _heavy_tails(poses: Sequence[CommandedPose]) -> str | None:
    """Return a note if the scatter of the visits, sphered for each pose, has longer tails than a Gaussian."""
    sphered = []
    for pose in poses:
        values, axes = np.linalg.eigh(np.cov(pose.attained)) if pose.n > 9 else (np.zeros(3), np.eye(3))
        if values[0] > 1e-12 * values[-1]:
            sphered.append((axes / np.sqrt(values)).T @ pose.residuals)
    if not sphered:
        return None
    test = assumption_tests(np.concatenate(sphered, axis=1)).kurtosis
    if test.p_value is None or test.statistic is None or test.p_value > _HEAVY_TAIL_P_VALUE or test.statistic < 0.0:
        return None
    return (
        f"the scatter of the visits has longer tails than a Gaussian (Mardia's kurtosis, p = {test.p_value:.1g}): the "
        "intervals of RP assume a Gaussian and are too narrow"
    )


def _warnings(
    files: Sequence[Measurements], poses_by_file: Sequence[Sequence[CommandedPose]], registered: bool
) -> tuple[str, ...]:
    warnings = [warning for data in files for warning in data.warnings]
    poses = [pose for file_poses in poses_by_file for pose in file_poses]
    if (shifting := shifting_commands(poses)) is not None:
        warnings.append(shifting)
    if any(_too_far(file_poses) for file_poses in poses_by_file):
        warnings.append(unregistered_warning(registered))
    return tuple(dict.fromkeys(warnings))


def _too_far(poses: Sequence[CommandedPose]) -> bool:
    """Return whether the accuracy of one robot is too bad for an arm; a single pose does not show it."""
    if len(poses) < 2 or any(pose.deviation is None for pose in poses):
        return False
    return too_far(_largest_accuracy(poses), np.column_stack([pose.attained.mean(axis=1) for pose in poses]))
