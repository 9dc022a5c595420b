"""Evaluation of measured poses after ISO 9283:1998, and the conditions of the standard's protocol."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from robacc.accuracy.error_statistics import assumption_tests
from robacc.accuracy.estimation import (
    TOO_LARGE,
    UNREGISTERED,
    check_confidence,
    commanded_poses,
    register,
    too_far,
)
from robacc.errors import Problem, refuse
from robacc.fitting.registration import Alignment
from robacc.geometry import Array
from robacc.iso_9283.criteria import (
    SAME_COMMAND,
    Characteristic,
    CommandedPose,
    Iso9283Result,
    accuracy,
    distance_criteria,
    drift,
    exchangeability,
    multidirectional,
    repeatability,
    visits_of,
)
from robacc.iso_9283.cube import PREFERRED_EDGES, PREFERRED_SIZES, fit_cube
from robacc.measurements import Measurements
from robacc.poses.motion import motion_between_visits, numbered_visits
from robacc.robots.description import Frame, Robot

# Conditions of the standard's protocol, and whether the data meet them, violate them or do not record them.
#
# Clauses of ISO 9283:1998: 6.2 (conditions prior to testing), 6.3 (environment), 6.5 (instrumentation), 6.6 (load),
# 6.7 (velocity), 6.8 (poses), 6.9 (cycles), 7.2 (approaches), 7.4 (stabilisation).

CYCLES = 30
_POSE_COUNT = 5
_AMBIENT, _AMBIENT_TOLERANCE = 20.0, 2.0
_STEP_TOLERANCE = 0.02
"""Relative tolerance within which a load or velocity counts as a rated step."""
_LOADS = (1.0, 0.1)

Finding = tuple[Literal["met", "not_met", "unknown"], str]
"""Whether a condition is met, and the reason."""


def protocol(
    files: Sequence[Measurements],
    poses: Sequence[CommandedPose],
    robot: Robot | None,
    repeatability: Characteristic,
    shift: Characteristic,
    rated_load: float | None,
) -> Sequence[Mapping[str, str]]:
    """Return every condition, in the order of the clauses, with the keys of the result."""

    def logged(column: str, missing: str, judge: Callable[[list[Any]], Finding]) -> Finding:
        """Judge the values of a column, one array for each file; unknown where a file lacks it."""
        values = [getattr(data, column) for data in files]
        return ("unknown", missing) if any(value is None for value in values) else judge(values)

    warm_up = "the warm-up is not recorded"
    if shift.position.interval.lower and shift.position.value is not None:
        moved = f"the barycentre of {shift.position_at} moved {shift.position.value * 1e3:.2g} mm during the run"
        warm_up = f"{warm_up}, but {moved}"
    n_poses = sorted({sum(pose.number == number for pose in poses) for number in range(len(files))})
    n_visits = sorted({pose.n for pose in poses})
    five_poses = f"{' and '.join(map(str, n_poses))} commanded pose{'s' * (n_poses != [1])}"
    cycles = (
        f"{n_visits[0]} visit{'s' * (n_visits[0] > 1)} of each commanded pose"
        if len(n_visits) == 1
        else f"{n_visits[0]} to {n_visits[-1]} visits of a commanded pose"
    )
    diagonal, corner_distance = _cube([pose for pose in poses if pose.number == 0], robot)
    no_sigma = "no columns sigma_x, sigma_y, sigma_z"
    findings: tuple[tuple[str, str, Finding], ...] = (
        ("warm-up", "6.2", ("unknown", warm_up)),
        ("temperature", "6.3", logged("temperature", "no column temperature_c", _temperature)),
        ("measuring uncertainty", "6.5", logged("sigma_position", no_sigma, lambda v: _instrument(v, repeatability))),
        ("rated load", "6.6", logged("payload", "no column payload_kg", lambda loads: _load(loads, rated_load))),
        ("rated velocity", "6.7", logged("speed", "no speed columns", lambda speeds: _velocity(files, speeds))),
        ("five poses", "6.8", ("met" if n_poses == [_POSE_COUNT] else "not_met", five_poses)),
        ("diagonal plane", "6.8", diagonal),
        ("10 % from the corners", "6.8", corner_distance),
        ("30 cycles", "6.9", ("met" if n_visits[0] >= CYCLES else "not_met", cycles)),
        (
            "one approach",
            "7.2",
            logged(
                "direction",
                "approach directions are not known; `ordered` derives them from the rows",
                lambda _: _one_approach(poses),
            ),
        ),
        ("stabilisation", "7.4", ("unknown", "the time between arrival and measurement is not recorded")),
    )
    return [
        {"condition": name, "clause": clause, "status": status, "why": why} for name, clause, (status, why) in findings
    ]


def _temperature(logged: list[Array]) -> Finding:
    low, high = min(float(values.min()) for values in logged), max(float(values.max()) for values in logged)
    range_text = f"{low:.1f} °C to {high:.1f} °C"
    if high - low > 2.0 * _AMBIENT_TOLERANCE:
        return "not_met", f"{range_text}: varies by more than ± {_AMBIENT_TOLERANCE:.0f} °C"
    if max(abs(low - _AMBIENT), abs(high - _AMBIENT)) <= _AMBIENT_TOLERANCE:
        return "met", f"{range_text}, within 20 °C ± {_AMBIENT_TOLERANCE:.0f} °C"
    return "met", f"{range_text}: constant within ± 2 °C but not at 20 °C; state it with the result"


def _instrument(sigmas: list[Array], repeatability: Characteristic) -> Finding:
    values = [place.position.value for place in repeatability.places if place.position.value is not None]
    if not values:
        return "unknown", "there is no RP to compare it with"
    expanded = 2.0 * max(float(np.max(sigma)) for sigma in sigmas)
    share = expanded / min(values) if min(values) > 0.0 else np.inf
    reason = (
        f"expanded (k = 2) {expanded * 1e3:.2g} mm is {100 * share:.0f} % of the smallest RP; at most 25 % is allowed"
    )
    # Largest measuring uncertainty as a fraction of the criterion.
    return "met" if share <= 0.25 else "not_met", reason


def _load(loads: list[Array], rated: float | None) -> Finding:
    low, high = min(float(load.min()) for load in loads), max(float(load.max()) for load in loads)
    if high - low > _STEP_TOLERANCE * max(high, 1e-9):
        return "not_met", f"the load varies from {low:g} kg to {high:g} kg"
    if rated is None:
        return "unknown", f"{high:g} kg throughout; give `rated_load` to compare"
    return _rated_share(high / rated, _LOADS, f"{high:g} kg of {rated:g} kg", "load")


def _velocity(files: Sequence[Measurements], speeds: list[Array]) -> Finding:
    for data, speed in zip(files, speeds, strict=True):
        if data.q is not None:
            visits = numbered_visits(data.groups(), data.visit, data.cycle, data.target)
            if np.allclose(speed, motion_between_visits(data.q, visits)[1], atol=1e-9):
                return "unknown", "speeds are derived from the order of rows: they are relative, not absolute"
    fastest = np.concatenate([np.max(np.abs(speed), axis=0) for speed in speeds])
    fastest = fastest[fastest > 0.0]
    if fastest.size == 0:
        return "unknown", "every speed is 0"
    if np.ptp(fastest) > _STEP_TOLERANCE:
        extent = f"from {100 * fastest.min():.0f} % to {100 * fastest.max():.0f} %"
        return "not_met", f"the fastest joint's speed varies {extent}"
    return _rated_share(float(fastest.mean()), (1.0, 0.5, 0.1), "the fastest joint's last motion", "velocity")


def _rated_share(share: float, steps: tuple[float, ...], description: str, quantity: str) -> Finding:
    """Return the status of a share of the rated value and the reason, which names the standard's optional steps."""
    step = next((step for step in steps if abs(share - step) <= _STEP_TOLERANCE * max(step, 0.1)), None)
    if step is None:
        optional = ", ".join(f"{100 * optional_step:.0f} %" for optional_step in steps[1:])
        required = f"the standard requires 100 %; optional steps are {optional}"
        return "not_met", f"{description}: {100 * share:.0f} %; {required}"
    also = "" if step == 1.0 else f", an optional step; a test at 100 % {quantity} is needed too"
    return "met", f"{description}: {100 * step:.0f} %{also}"


def _cube(poses: Sequence[CommandedPose], robot: Robot | None) -> tuple[Finding, Finding]:
    """Return the conditions on the diagonal plane and on the distance from the corners."""
    points = [pose.commanded for pose in poses if pose.commanded is not None]
    if len(points) < len(poses):
        return (("unknown", "the commanded positions are not known"),) * 2
    if len(points) != _POSE_COUNT:
        return (("not_met", "needs five commanded poses"),) * 2
    base = Frame().pose if robot is None else robot.base.pose
    fit = fit_cube(base.rotation.T @ (np.stack(points, axis=1) - base.translation[:, None]))
    if isinstance(fit, str):
        return (("not_met", fit),) * 2
    plane: Finding = ("not_met", "the diagonal plane is upright; the standard's planes rise at 45°")
    if fit.plane is not None:
        plane = ("met", f"{poses[fit.centre].label} is the centre, and the plane rises at 45° towards {fit.plane}")
    edge = f"a cube of {fit.edge * 1e3:.0f} mm"
    if any(abs(fit.edge - preferred) < 1e-9 for preferred in PREFERRED_EDGES):
        return plane, ("met", f"{100 * fit.from_corner:.1f} % in {edge}")
    return plane, ("unknown", f"10 % in {edge}, not a preferred size; the preferred edges are {PREFERRED_SIZES} mm")


def _one_approach(poses: Sequence[CommandedPose]) -> Finding:
    directions = [(pose.label, pose.direction) for pose in poses if pose.direction is not None]
    moving = [(label, direction[:, np.any(direction != 0, axis=0)]) for label, direction in directions]
    labels = [label for label, direction in moving if np.unique(direction, axis=1).shape[1] > 1]
    if not labels:
        return "met", "every visit of a pose has the same approach direction"
    names = f"{', '.join(labels[:3])}{' …' * (len(labels) > 3)}"
    return "not_met", f"{names} approached from several directions: AP and RP include vAP"


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
    refuse(
        (not files, "no file of measured poses is given; give at least one"),
        (
            windows is not None and windows < 2,
            f"drift is a change between windows: `drift_windows` is at least 2, not {windows}",
        ),
        (
            rated_load is not None and not 0.0 < rated_load < np.inf,
            f"`rated_load` is above 0 kg, not {rated_load or 0:g}",
        ),
        (
            bool(align) and robot is None and any(data.commanded_position is None for data in files),
            "`align` registers commanded poses, and there are none: give `robot`, or columns cmd_x, cmd_y, cmd_z",
        ),
    )
    names = [(data.source or f"file {i + 1}").replace("\\", "/").rpartition("/")[2] for i, data in enumerate(files)]
    sources = [f"{name} ({i + 1})" if names.count(name) > 1 else name for i, name in enumerate(names)]
    # Without a robot and without commands in a file, the commanded poses are not known.
    commands = [
        (None, None) if robot is None and data.commanded_position is None else commanded_poses(data, robot)
        for data in files
    ]
    nominal_poses = [visits_of(data, commands[i], sources[i], i) for i, data in enumerate(files)]
    problems = [
        Problem(
            f"has {len(poses)} commanded poses; the standard's criteria need a few poses, at most {_MAX_POSES}",
            poses[0].source,
            fix="name the commanded poses in a column pose; the command estimate takes poses that are visited once",
        )
        for poses in nominal_poses
        if len(poses) > _MAX_POSES
    ]
    refuse((problems, problems))
    alignments = [register(data, robot, align) for data in files] if align else []
    poses_by_file = nominal_poses
    # Registered robots were measured in different frames: positions move from the registered to the nominal base.
    attained = [[pose.attained for pose in file_poses] for file_poses in nominal_poses]
    if alignments:
        poses_by_file = [
            visits_of(data, commanded_poses(data, robot, alignments[i]), sources[i], i) for i, data in enumerate(files)
        ]
        nominal = Frame().pose if robot is None else robot.base.pose
        to_nominal = [nominal @ alignment.robot.base.pose.inverse() for alignment in alignments]
        attained = [
            [move.rotation @ positions + move.translation[:, None] for positions in file_positions]
            for move, file_positions in zip(to_nominal, attained, strict=True)
        ]
    poses = tuple(pose for file_poses in poses_by_file for pose in file_poses)
    repeatability_characteristic = repeatability(poses, confidence, seed)
    accuracy_drift, repeatability_drift, shift = drift(poses, confidence, seed, windows)
    exchanged = exchangeability(nominal_poses, attained, confidence)
    if robot is not None and alignments:
        robot = alignments[0].robot
    return Iso9283Result(
        n_poses=sum(data.n for data in files),
        sources=tuple(sources),
        commanded=None if all(position is None for position, _ in commands) else "file" if robot is None else "robot",
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


def _largest_accuracy(poses: Sequence[CommandedPose]) -> float:
    """Return the largest AP_p, m."""
    return max(float(np.linalg.norm(pose.deviation.mean(axis=1))) for pose in poses if pose.deviation is not None)


def _notes(
    poses: Sequence[CommandedPose],
    alignments: Sequence[Alignment],
    robot: Robot | None,
    files: Sequence[Measurements],
    shift: Characteristic,
) -> tuple[str, ...]:
    effects = dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects) if robot is not None else ()
    tails = _heavy_tails(poses)
    notes: tuple[tuple[bool, str], ...] = (
        (
            True,
            "RP is how closely the visits of a pose agree with each other; their distance from the commanded pose is "
            "AP",
        ),
        (
            any(sum(pose.number == number for pose in poses) > 1 for number in range(len(files))),
            "every criterion is the largest over all measured poses or pairs of poses; where the standard prescribes "
            "fewer (for distances P2 to P4, for drift P1), the JSON result has the value of each pose",
        ),
        (
            robot is not None and any(data.commanded_position is not None for data in files),
            "commanded poses are from the robot; the files' cmd_ columns were not used",
        ),
        (bool(effects), f"the robot file's effects are applied to the command: {', '.join(effects)}"),
        *(
            (True, note)
            for alignment in alignments
            for note in (
                f"AP and dAP are after registration with {alignment.n_parameters} parameters, fitted to the same poses",
                *alignment.notes,
            )
        ),
        (
            any(pose.at_pole for pose in poses),
            "a, b, c are rotations about x, y, z of the measuring frame where pitch is within 10° of 90°: roll and yaw "
            "are not defined there",
        ),
        (
            bool(shift.position.interval.lower),
            "the robot drifted during the run by more than the scatter explains: AP and RP include the drift",
        ),
        (bool(tails), tails),
    )
    return tuple(dict.fromkeys(note for applies, note in notes if applies))


def _heavy_tails(poses: Sequence[CommandedPose]) -> str:
    """Return a note if the scatter of the visits, sphered for each pose, has longer tails than a Gaussian."""
    sphered = []
    for pose in poses:
        values, axes = np.linalg.eigh(np.cov(pose.attained)) if pose.n > 9 else (np.zeros(3), np.eye(3))
        if values[0] > 1e-12 * values[-1]:
            sphered.append((axes / np.sqrt(values)).T @ (pose.attained - pose.attained.mean(axis=1, keepdims=True)))
    test = assumption_tests(np.concatenate(sphered, axis=1)).kurtosis if sphered else None
    # p-value below which a note says that the scatter is not Gaussian.
    if test is None or test.p_value is None or test.p_value > 0.01:
        return ""
    return (
        f"the scatter of the visits has longer tails than a Gaussian (Mardia's kurtosis, p = {test.p_value:.1g}): the "
        "intervals of RP assume a Gaussian and are too narrow"
    )


def _warnings(
    files: Sequence[Measurements], poses_by_file: Sequence[Sequence[CommandedPose]], registered: bool
) -> tuple[str, ...]:
    warnings = [warning for data in files for warning in data.warnings]
    moves = [
        (float(np.max(np.abs(pose.attained - pose.deviation - pose.commanded[:, None]))), pose.label)
        for poses in poses_by_file
        for pose in poses
        if pose.deviation is not None and pose.commanded is not None
    ]
    move, label = max(moves, key=lambda entry: entry[0], default=(0.0, ""))
    if move > SAME_COMMAND:
        warnings.append(
            f"the command of {label} differs by {move * 1e3:.2g} mm between its visits, but cycles repeat one "
            "commanded pose; put commanded joint values into the q columns, not encoder readings"
        )
    for poses in poses_by_file:
        # A single pose does not show whether the accuracy of a robot is too bad for an arm.
        if len(poses) > 1 and all(pose.deviation is not None for pose in poses):
            barycentres = np.column_stack([pose.attained.mean(axis=1) for pose in poses])
            if too_far(_largest_accuracy(poses), barycentres):
                warnings.append(TOO_LARGE if registered else UNREGISTERED)
    return tuple(dict.fromkeys(warnings))
