"""The call behind ``robacc estimate``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from robacc.accuracy.estimation import EstimateResult
from robacc.accuracy.estimation import estimate as estimated
from robacc.accuracy.pose_errors import ErrorFrame
from robacc.api.fitted_to import met_again
from robacc.api.inputs import StrPath, poses_of, robot_of, scale_of
from robacc.api.result import Made, Result, names, one_of, parts, within
from robacc.measurements import Measurements

if TYPE_CHECKING:
    from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Estimate(Result, EstimateResult):
    """How far the arm was from where it was to be, with what it was computed from."""

    command: ClassVar[str] = "estimate"
    robot: Robot | None
    """As its file describes it, before any alignment."""
    data: Measurements
    """The measured poses."""
    made: Made

    def payload(self) -> dict[str, Any]:
        """The result's own keys; arrays stay arrays."""
        from robacc.accuracy.error_frames import position_statistics
        from robacc.accuracy.pose_errors import commanded_poses
        from robacc.documents.estimate import payload, pose_payload

        aligned = self.robot if self.alignment is None else self.alignment.robot
        moments = position_statistics(self.data, commanded_poses(self.data, aligned))
        return {**payload(self), **pose_payload(self.data, self.robot, moments)}

    def per_pose_csv(self) -> str:
        """A row a pose: its line, its ids, the error vector and its length, in m and rad."""
        from robacc.documents.estimate import per_pose_csv

        return per_pose_csv(self, self.data)


def estimate(
    poses: StrPath | Measurements,
    *,
    robot: StrPath | Robot | None = None,
    align: str | Sequence[str] = (),
    frame: ErrorFrame | None = None,
    scale: StrPath | None = None,
    confidence: float = 0.95,
    ordered: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
) -> Estimate:
    """Cartesian error at each measured pose, its covariances, and an accuracy grade.

    The commanded pose is the robot's own at the commanded joints where ``robot`` is given, else the poses' own.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses that were read before or made of arrays.
        robot: Robot file (YAML), URDF, or a robot that was read before.
        align: ``base_frame``, ``tool_frame`` or both are fitted to the poses first.
        frame: Axes of the errors: the commanded target's, or the measuring frame's; None is ``tool`` where the
            commanded orientation is known, else ``base``.
        scale: Grade scale (YAML); None is the package's own.
        confidence: Of every interval.
        ordered: The rows of the file are in the order measured.
        base_link: URDF: the link that the chain starts at.
        tip_link: URDF: the link that it ends at.
        seed: Of everything drawn at random, bootstrap included.

    Returns:
        Position and orientation statistics (m, rad), the errors themselves, and the grade.

    Raises:
        InputError: A file or array cannot be used; with every problem found.
        UsageError: The call does not fit the data, or itself.

    Example:
        >>> import robacc
        >>> found = robacc.estimate(
        ...     "sample_data/poses.csv", robot="sample_data/robot.yaml", align=("base_frame", "tool_frame")
        ... )
        >>> print(f"{found.position.rms * 1e3:.2f} mm rms at {found.n_poses} poses, grade {found.grade.grade}")
        0.47 mm rms at 60 poses, grade D
        >>> found.errors.position.shape
        (3, 60)
    """
    within("seed", seed, 0)
    one_of("frame", frame, ("tool", "base", None))
    arm, arm_record = robot_of(robot, base_link, tip_link)
    data, record = poses_of(poses, arm, ordered=ordered)
    grades, scale_record = scale_of(scale)
    what = names(align)
    found = estimated(data, arm, frame=frame, align=what, scale=grades, confidence=confidence, seed=seed)
    seen = met_again(arm, (record,))
    notes = (*found.notes, *(["the robot file was fitted to these same poses"] if seen else []))
    found = dataclasses.replace(found, notes=notes, warnings=(*found.warnings, *seen))
    options = {
        "align": list(what),
        "frame": found.errors.frame,
        "confidence": confidence,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }
    made = Made(options, (record, *arm_record, *scale_record), seed)
    return Estimate(**parts(found), robot=arm, data=data, made=made)
