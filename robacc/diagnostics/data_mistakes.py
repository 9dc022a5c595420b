"""Mistakes in the data or the robot file, detected before any effect is fitted.

Mistakes are tried alone and in sets: every set of joint signs, signs with an interaction of two joints, and then the
best sets with further changes. Each hypothesis is judged by all rows of a sample, with base and target registered.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from robacc.diagnostics.changes import (
    JointChange,
    MeasuredPoses,
    axis_change,
    inner_zeros,
    interactions,
    joint_changes,
    measured_changes,
    orientation_changes,
    permutations,
    sign_sets,
)
from robacc.diagnostics.mistakes import (
    Hypothesis,
    Mistake,
    Sample,
    arm_poses,
    hypothesis,
    most_likely,
    orientation_errors,
    screen,
    simplest,
)
from robacc.diagnostics.row_mistakes import find_part_mistake, find_row_mistakes
from robacc.errors import InputError, RobaccError
from robacc.fitting.closed_form import register_frames
from robacc.geometry import Array, Poses, log_between
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Robot

GROSS = 0.01
"""Registered error, as a share of the standard deviation of the positions (or in rad), above which it may come from a
mistake."""
_IMPROVEMENT = 8.0
"""Factor by which a correction has to reduce the error for its mistake to be reported."""
_ENOUGH = 0.02
"""Registered error of an arm without a mistake, at which the search ends."""
_WRONG_ORIENTATION = 0.05
"""rad; orientation error from which other readings of the orientations are tried."""
_MOST_ORIENTATION = 0.5
"""rad; orientation error up to which the orientations show the axes of the positions."""
_LEAST_POSES = 8
"""Poses that the check needs at least: registration of base and tool fits fewer poses in spite of a mistake."""
_REGISTERED = 400
"""Rows on which base and target are registered at most."""
_PLAUSIBLE = 0.1
"""Share of the standard deviation of the positions up to which the orientations and axes are examined."""
_USUAL_ERROR = 3e-3
"""m; registered error up to which an arm is taken for the one that was measured."""
_LISTED = 40
"""Hypotheses of each group that are judged by all rows of the sample."""
_COMPLETED = 6
"""Hypotheses of each group whose orientations and axes are examined."""
_BEAM = 10
"""Sets of mistakes that are extended."""
_EXTENSIONS = 2
"""Changes that a set is extended by at most."""


def find_mistake(robot: Robot, data: Measurements) -> Mistake | None:
    """Return the mistake, or the set of mistakes, that explains a gross misfit; None if there is none."""
    if data.n < _LEAST_POSES or data.q is None or not _is_gross(data, _registered_poses(robot, data)):
        return None
    search = _MistakeSearch(robot, Sample.of(robot, data))
    return None if search.null.total <= GROSS else search.run()


def other_arm(robot: Robot, data: Measurements) -> tuple[str, ...]:
    """Return a warning that names the arm of the package that fits the poses, where the robot does not."""
    from robacc.modelling.robot_file import read_robot
    from robacc.robots.library import library

    def error(arm: Robot) -> float:
        try:
            return float(np.median(np.linalg.norm(data.position - _registered_poses(arm, data).translation, axis=0)))
        except RobaccError:
            return np.inf

    data = data.subset(np.unique(np.linspace(0, data.n - 1, min(data.n, _REGISTERED)).astype(int)))
    if data.n < _LEAST_POSES or data.q is None or (own := error(robot)) <= _USUAL_ERROR:
        return ()
    fits = {
        arm.key: error(dataclasses.replace(read_robot(arm.path), targets=robot.targets))
        for arm in library()
        if arm.axes == len(robot.variables)
    }
    best = min(fits, key=fits.__getitem__, default="")
    if fits.get(best, np.inf) * _IMPROVEMENT > own:
        return ()
    return (
        f"{robot.name} leaves a median error of {1e3 * own:.3g} mm with base and tool registered, the package's {best} "
        f"{1e3 * fits[best]:.2g} mm: check that `robot` is the arm that was measured",
    )


def check_data(robot: Robot, data: Measurements) -> tuple[str, ...]:
    """Raise an error if the data contain a mistake; return warnings of mistakes in a few rows.

    Raises:
        InputError: the mistake, its errors and the fix.
    """
    if data.n < _LEAST_POSES or data.q is None:
        return ()
    file = f"{data.source}: " if data.source else ""
    poses = _registered_poses(robot, data)
    rows = find_row_mistakes(robot, data, poses.translation)
    if rows is not None and rows.refused:
        raise InputError(f"{file}{rows.text}")
    if _is_gross(data, poses):
        mistake = find_mistake(robot, data)
        if mistake is not None:
            raise InputError(f"{file}{mistake.text}")
        part = find_part_mistake(robot, data, find_mistake)
        if part is not None and part.mistake is not None:
            raise InputError(f"{file}{part.text}")
        if part is not None:
            return (f"{file}{part.text}",)
    return (*other_arm(robot, data), *(() if rows is None else (f"{file}{rows.text}",)))


def _registered_poses(robot: Robot, data: Measurements) -> Poses:
    """Return the poses of the nominal model with base and targets registered."""
    rows = np.unique(np.linspace(0, data.n - 1, min(data.n, _REGISTERED)).astype(int))
    return predict(register_frames(robot, data.subset(rows), True, True), data)


def _is_gross(data: Measurements, poses: Poses) -> bool:
    """Return whether the registered error may come from a mistake."""
    spread = float(np.sqrt(np.var(data.position, axis=1).sum()))
    error = float(np.median(np.linalg.norm(data.position - poses.translation, axis=0)))
    if error > GROSS * spread:
        return True
    if data.rotation is None:
        return False
    turn = np.linalg.norm(log_between(poses.rotation, data.rotation), axis=0)
    return float(np.median(turn)) > GROSS


class _MistakeSearch:
    """Search for the simplest set of mistakes whose correction leaves the error of an arm."""

    def __init__(self, robot: Robot, sample: Sample) -> None:
        """Judge the data as they are."""
        self._robot = robot
        self._sample = sample
        data = sample.data
        self._as_measured = MeasuredPoses(data.position, data.rotation)
        self._pool: list[Hypothesis] = []
        (self.null,) = self._judged(robot, self._as_measured, [()])[:1]
        self._pool.append(self.null)

    def run(self) -> Mistake | None:
        """Return the mistake, or None if no set of mistakes explains the error."""
        robot, data = self._robot, self._sample.data
        assert data.q is not None
        _, arm_position = arm_poses(robot, data, data.q[None])
        spread = max(float(np.sqrt(np.var(arm_position[0], axis=0).sum())), 1e-12)
        as_measured, *variants = measured_changes(data.position, data.rotation, spread)
        for variant in (as_measured, *variants):
            self._try(robot, variant, [()])
        for other in self._other_conventions():
            self._try(other, as_measured, [()])
        self._try(robot, as_measured, [(change,) for change in joint_changes(robot)])
        signs = [(change,) for change in sign_sets(robot)]
        self._try(robot, as_measured, signs)
        if not self._explained():
            self._try_sets(variants, [(), *signs])
        return simplest(self._pool, self.null, _IMPROVEMENT)

    def _try_sets(self, variants: Iterable[MeasuredPoses], signs: Sequence[tuple[JointChange, ...]]) -> None:
        """Try sets of different mistakes until one explains the error."""
        for variant in variants:
            self._try(self._robot, variant, signs)
        common = [change for change in interactions(self._robot) if change.of_neighbours]
        common.extend(change for change in joint_changes(self._robot) if change.of_all)
        self._try(self._robot, self._as_measured, [(*some, change) for some in signs for change in common])
        if self._explained():
            return
        zeros = inner_zeros(self._robot)
        self._try(self._robot, self._as_measured, list(itertools.combinations(zeros, 2)))
        self._try(self._robot, self._as_measured, [(*some, change) for some in signs for change in zeros])
        for other in self._other_conventions():
            self._try(other, self._as_measured, signs)
        self._try(self._robot, self._as_measured, [(change,) for change in permutations(self._robot)])
        for _ in range(_EXTENSIONS):
            if self._explained():
                return
            self._extend()

    def _other_conventions(self) -> list[Robot]:
        if self._robot.convention not in ("standard", "modified"):
            return []
        other = "modified" if self._robot.convention == "standard" else "standard"
        return [dataclasses.replace(self._robot, convention=other)]  # type: ignore[arg-type]

    def _explained(self) -> bool:
        best = min(item.total for item in self._pool)
        return best < _ENOUGH and best * _IMPROVEMENT < self.null.total

    def _extend(self) -> None:
        """Add each elementary change to the best sets so far."""
        best = sorted(self._pool, key=lambda item: (item.rank, item.complexity))[:_BEAM]
        for item in best:
            self._try(item.robot, item.measured, [(*item.changes, change) for change in joint_changes(self._robot)])

    def _try(self, robot: Robot, measured: MeasuredPoses, sets: Sequence[tuple[JointChange, ...]]) -> None:
        if sets:
            self._pool.extend(self._judged(robot, measured, sets))

    def _judged(
        self, robot: Robot, measured: MeasuredPoses, sets: Sequence[tuple[JointChange, ...]]
    ) -> list[Hypothesis]:
        """Return the best of the sets with their errors, some completed by changes of orientations and axes."""
        q = [self._corrected(changes) for changes in sets]
        try:
            if len(sets) > _LISTED:
                likely = most_likely(robot, self._sample, q, measured.position, _LISTED)
                sets, q = [sets[i] for i in likely], [q[i] for i in likely]
            result = screen(robot, self._sample, q, measured.position, measured.rotation)
        except (RobaccError, np.linalg.LinAlgError):
            return []
        order = np.argsort(result.rank, kind="stable")
        judged = [hypothesis(robot, measured, sets[i], result, int(i), robot is not self._robot) for i in order]
        for item, i in list(zip(judged, order, strict=True))[:_COMPLETED]:
            if item.orientation is None or result.position[i] > _PLAUSIBLE * result.spread:
                continue
            rotations = result.rotations(int(i))
            for changed in self._completions(robot, measured, q[i], item.orientation, rotations):
                again = screen(robot, self._sample, [q[i]], changed.position, changed.rotation)
                judged.append(hypothesis(robot, changed, sets[i], again, 0, robot is not self._robot))
        return judged

    def _corrected(self, changes: Sequence[JointChange]) -> Array:
        q = self._sample.data.q
        assert q is not None
        for change in changes:
            q = change.apply(q)
        return q

    def _completions(
        self, robot: Robot, measured: MeasuredPoses, q: Array, error: float, rotations: tuple[Array, Array] | None
    ) -> list[MeasuredPoses]:
        """Return the measured poses with another reading of the orientations, or other axes of the positions."""
        if measured.rotation is None or rotations is None:
            return []
        changed = []
        if error > _WRONG_ORIENTATION:
            readings = list(orientation_changes(measured.rotation))
            turned = np.stack([np.moveaxis(rotation, 2, 0) for _, _, rotation in readings])
            arm_rotation = np.broadcast_to(arm_poses(robot, self._sample.data, q[None])[0], turned.shape)
            base = np.broadcast_to(rotations[0], (len(readings), 3, 3))
            best = int(np.argmin(orientation_errors(arm_rotation, turned, base)))
            changed = [measured.with_rotation(*readings[best])]
        axes = axis_change(*rotations, measured.mirrored) if error < _MOST_ORIENTATION else None
        return changed if axes is None else [*changed, measured.with_axes(*axes)]
