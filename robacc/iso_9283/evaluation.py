"""The pose criteria of ISO 9283:1998 that measured poses can support, and how far they follow its protocol."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robacc.accuracy.estimation import check_call
from robacc.accuracy.pose_errors import Commanded, commanded_poses
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
from robacc.robots.description import Robot
from robacc.statistics.multivariate import assumption_tests

_HEAVY_TAILS = 0.01
"""p-value below which the scatter is said to be no Gaussian's."""
_MOST_POSES = 300
"""Commanded poses of a file: sixty times the standard's five."""


def iso9283(
    files: Sequence[Measurements],
    robot: Robot | None = None,
    *,
    what: Sequence[str] = (),
    confidence: float = 0.95,
    seed: int = 0,
    windows: int | None = None,
    rated_load: float | None = None,
) -> Iso9283Result:
    """The pose criteria of one robot a file.

    Args:
        files: Measured poses, at least one file of them. Without a robot, and without commanded poses in a file, there
            is no accuracy, but repeatability.
        robot: Commands the poses of every file at its q, its effects included; goes before commanded poses in the file.
        what: Of :data:`robacc.fitting.registration.ALIGNABLE`: what is fitted to each file's poses first.
        confidence: Of every interval.
        seed: Of the bootstrap.
        windows: Parts that each pose's visits are cut into for the drift; None: as many as have ten visits.
        rated_load: kg; None: not known.

    Raises:
        UsageError: the call does not fit itself or the data.
        InputError: the data lack what the call needs.
    """
    check_call(robot, what, confidence)
    _check(files, windows, rated_load)
    sources = _names(files)
    commands = [_commanded(data, robot) for data in files]
    nominal = [visits_of(data, commands[i], sources[i], i) for i, data in enumerate(files)]
    _check_count(nominal)
    alignments = _alignments(files, robot, what)
    robots = nominal
    if alignments:
        moved = [commanded_poses(data, one.robot) for data, one in zip(files, alignments, strict=True)]
        robots = [visits_of(data, moved[i], sources[i], i) for i, data in enumerate(files)]
    poses = tuple(pose for own in robots for pose in own)
    repeated = repeatability(poses, confidence, seed)
    drifts = drift(poses, confidence, seed, windows)
    exchanged = exchangeability(nominal, _in_one_frame(nominal, robot, alignments), confidence)
    if robot is not None and alignments:
        robot = alignments[0].robot
    return Iso9283Result(
        n_poses=sum(data.n for data in files),
        sources=tuple(sources),
        commanded=next((command.source for command in commands if command is not None), None),
        poses=poses,
        characteristics=(
            accuracy(poses, confidence),
            repeated,
            multidirectional(poses, confidence),
            *distance_criteria(poses, confidence),
            *drifts,
            exchanged,
        ),
        protocol=protocol(files, poses, robot, repeated, drifts[2], rated_load),
        alignments=tuple(alignments),
        unaligned=np.array([_greatest_accuracy(own) for own in nominal]) if alignments else None,
        confidence=confidence,
        notes=_notes(poses, alignments, robot, files, drifts[2]),
        warnings=_warnings(files, poses),
    )


def _check(files: Sequence[Measurements], windows: int | None, rated_load: float | None) -> None:
    if not files:
        raise UsageError("at least one file of measured poses is needed")
    if windows is not None and windows < 2:
        raise UsageError(f"drift is a change between windows: at least 2 are needed, not {windows}")
    if rated_load is not None and not 0.0 < rated_load < np.inf:
        raise UsageError(f"the rated load is a weight above 0 kg, not {rated_load:g}")


def _names(files: Sequence[Measurements]) -> list[str]:
    """A name for each file, told apart where two have the same."""
    plain = [(data.source or f"file {i + 1}").replace("\\", "/").rpartition("/")[2] for i, data in enumerate(files)]
    return [f"{name} ({i + 1})" if plain.count(name) > 1 else name for i, name in enumerate(plain)]


def _commanded(data: Measurements, robot: Robot | None) -> Commanded | None:
    """What says where the targets were to be; None where nothing does, which leaves repeatability."""
    if robot is None and data.commanded_position is None:
        return None
    return commanded_poses(data, robot)


def _check_count(robots: Sequence[Sequence[CommandedPose]]) -> None:
    """Refuse files in which hardly any pose is visited again.

    Raises:
        InputError: there are too many commanded poses.
    """
    problems = [
        Problem(
            f"has {len(poses)} commanded poses; the standard's criteria are of a few, at most {_MOST_POSES} are taken",
            poses[0].source,
            fix="name the commanded poses in a column pose; robacc estimate takes poses that are visited once",
        )
        for poses in robots
        if len(poses) > _MOST_POSES
    ]
    if problems:
        raise InputError(problems)


def _alignments(files: Sequence[Measurements], robot: Robot | None, what: Sequence[str]) -> list[Alignment]:
    """The alignment of each file; none where nothing is to be aligned."""
    if robot is None or not what:
        return []
    from robacc.fitting.registration import align

    return [align(robot, data, what) for data in files]


def _greatest_accuracy(poses: Sequence[CommandedPose]) -> float:
    """The largest AP_p, m."""
    return max(position_accuracy(pose.deviation).value for pose in poses if pose.deviation is not None)


def _in_one_frame(
    robots: Sequence[Sequence[CommandedPose]], robot: Robot | None, alignments: Sequence[Alignment]
) -> list[list[Array]]:
    """Attained positions of each file in the frame that the robots share: with alignment, that of the robot file.

    An aligned robot was measured in a frame of its own: its positions are carried from the base found to the nominal.
    """
    if robot is None or not alignments:
        return [[pose.attained for pose in poses] for poses in robots]
    nominal = _base(robot)
    result = []
    for poses, alignment in zip(robots, alignments, strict=True):
        turn = nominal.rotation @ _base(alignment.robot).rotation.T
        found = _base(alignment.robot)
        result.append(
            [turn @ (pose.attained - found.translation[:, None]) + nominal.translation[:, None] for pose in poses]
        )
    return result


def _base(robot: Robot) -> Poses:
    return Poses.from_xyz_rpy(np.array(robot.base.xyz), np.array(robot.base.rpy))


def _notes(
    poses: Sequence[CommandedPose],
    alignments: Sequence[Alignment],
    robot: Robot | None,
    files: Sequence[Measurements],
    shift: Characteristic,
) -> tuple[str, ...]:
    notes = [
        "RP says how closely visits of a pose agree with each other, and nothing of how near they are to it: that is AP"
    ]
    if any(sum(pose.number == number for pose in poses) > 1 for number in range(len(files))):
        notes.append(
            "every criterion is the largest over all poses, or pairs of poses, that were measured; where the standard "
            "prescribes fewer (for distances P2 to P4, for drift P1), the JSON result has their values, pose by pose"
        )
    if robot is not None and any(data.commanded_position is not None for data in files):
        notes.append("commanded poses are the robot's; the files' cmd_ columns were not used")
    if robot is not None and robot.effects:
        names = dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects)
        notes.append(f"the robot file's effects are applied to the command: {', '.join(names)}")
    for alignment in alignments:
        count = alignment.n_parameters
        notes.append(f"AP and dAP are after an alignment fitted to these same poses, with {count} parameters")
        notes.extend(alignment.notes)
    if any(pose.at_pole for pose in poses):
        notes.append(
            "a, b, c are turns about x, y, z of the measuring frame where pitch is within 10° of 90°, and roll and yaw "
            "are not defined"
        )
    if shift.position.interval.lower:
        notes.append("the robot drifted during the run, more than the scatter explains: AP and RP contain the drift")
    if (tails := _heavy_tails(poses)) is not None:
        notes.append(tails)
    return tuple(dict.fromkeys(notes))


def _heavy_tails(poses: Sequence[CommandedPose]) -> str | None:
    """Whether the visits scatter as a Gaussian, which the intervals of RP assume: each pose's sphered, all together."""
    sphered = []
    for pose in poses:
        values, axes = np.linalg.eigh(np.cov(pose.attained)) if pose.n > 9 else (np.zeros(3), np.eye(3))
        if values[0] > 1e-12 * values[-1]:
            sphered.append((axes / np.sqrt(values)).T @ pose.residuals)
    if not sphered:
        return None
    test = assumption_tests(np.concatenate(sphered, axis=1)).kurtosis
    if test.p_value is None or test.statistic is None or test.p_value > _HEAVY_TAILS or test.statistic < 0.0:
        return None
    return (
        f"the visits scatter with longer tails than a Gaussian's (Mardia's kurtosis, p = {test.p_value:.1g}): the "
        "intervals of RP, which assume one, are too narrow"
    )


def _warnings(files: Sequence[Measurements], poses: Sequence[CommandedPose]) -> tuple[str, ...]:
    warnings = [warning for data in files for warning in data.warnings]
    if (shifting := shifting_commands(poses)) is not None:
        warnings.append(shifting)
    return tuple(dict.fromkeys(warnings))
