"""Call of the command ``robacc estimate``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TextIO

from robacc.accuracy.estimation import EstimateResult
from robacc.accuracy.estimation import estimate as estimate_errors
from robacc.accuracy.pose_errors import ErrorFrame
from robacc.api.inputs import (
    PosesSource,
    StrPath,
    fitted_pose_warnings,
    load_grade_scale,
    load_optional_robot,
    load_poses,
    stated,
    with_measured_targets,
)
from robacc.api.result import (
    CampaignUse,
    Provenance,
    Result,
    check_choice,
    check_range,
    effect_names,
    fields_of,
    options_of,
    use_model,
)
from robacc.measurements import Measurements
from robacc.threads import single_threaded

if TYPE_CHECKING:
    from robacc.robots.description import Robot

_MOST_ROWS = 5000
"""Rows that show a step and a rounding well enough."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Estimate(Result, EstimateResult):
    """Errors of the measured poses, their statistics and the grade, with the inputs."""

    command: ClassVar[str] = "estimate"
    robot: Robot | None
    """Robot as its file describes it, before any alignment."""
    data: Measurements
    """The measured poses."""
    made: Provenance

    @classmethod
    def of(cls, body: EstimateResult, robot: Robot | None, data: Measurements, made: Provenance) -> Estimate:
        """Return ``body`` with its inputs."""
        return cls(**fields_of(body), robot=robot, data=data, made=made)

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.accuracy.pose_errors import position_statistics, registered_poses
        from robacc.documents.estimate import payload, pose_payload

        statistics = position_statistics(self.data, registered_poses(self.data, self.robot, self.alignment))
        registered = None if self.alignment is None else self.alignment.robot
        return {**payload(self), **pose_payload(self.data, self.robot, registered, statistics)}

    def draw(self, stream: TextIO) -> None:
        """Write the short report."""
        from robacc.documents.estimate import payload
        from robacc.render.views.elements import draw
        from robacc.render.views.estimate import short_estimate_view

        draw(short_estimate_view(payload(self), self.named("poses"), self.named("robot")), stream)

    def per_pose_csv(self) -> str:
        """Return a CSV with one row for each pose: line, ids, error vector and its length, in m and rad."""
        from robacc.documents.estimate import per_pose_csv

        return per_pose_csv(self, self.data)


@single_threaded
def estimate(
    poses: PosesSource,
    *,
    robot: StrPath | Robot | None = None,
    align: str | Sequence[str] | None = None,
    frame: ErrorFrame | None = None,
    scale: StrPath | None = None,
    confidence: float = 0.95,
    ordered: bool = False,
    ignore_limits: bool = False,
    angles: str | None = None,
    units: str | None = None,
    columns: StrPath | Mapping[str, str | None] | None = None,
    skip_gaps: bool = False,
    coverage: float | None = None,
    sheet: str | None = None,
    commanded: StrPath | None = None,
    bag: str | None = None,
    campaign: CampaignUse = "auto",
    strict_range: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
) -> Estimate:
    """Compute the Cartesian error at each measured pose, its covariances, and an accuracy grade.

    With ``robot``, the commanded pose is the robot's pose at the commanded joints; without, the commanded pose of the
    file or the arrays.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses read before or made of arrays.
        robot: Robot file (YAML), URDF, or a robot read before.
        align: Frames that are fitted to the poses first: ``base_frame``, ``tool_frame`` or both; of the robot, or
            without ``robot`` of the commanded poses. None fits them where the errors without it are too large for an
            arm and those with it are not; ``"none"`` never does.
        frame: Axes of the errors: ``tool`` of the commanded target, ``base`` of the measuring frame. None is ``tool``
            if the commanded orientation is known, else ``base``.
        scale: Grade scale (YAML); None for the scale of the package.
        confidence: Confidence level of every interval.
        ordered: The rows of the file are in the order measured; directions and speeds are derived from it.
        ignore_limits: Joint values outside the limits are a warning; by default they are an error where they exceed a
            limit by more than 0.05 degree or 0.5 mm.
        angles: Convention of three angles that form an orientation, such as ``fixed-xyz``.
        units: Units of columns whose names have none, such as ``mm,deg``.
        columns: Column map (YAML), or documented names by the names in the file.
        skip_gaps: Leave out rows with a missing value, with a warning.
        coverage: Coverage factor of uncertainties that the file calls U.
        sheet: Sheet of a workbook.
        commanded: Robot program, or table of joints or commanded poses, whose rows were measured.
        bag: Topics and samples of a recording.
        campaign: Use of the facts of the campaign that a model was fitted in, such as a drift: ``keep``, ``drop``, or
            ``auto`` for its own poses and for measured poses that agree better with them.
        strict_range: Refuse poses outside the validity range of the model.
        base_link: First link of the chain in a URDF.
        tip_link: Last link of the chain in a URDF.
        seed: Seed of the random numbers, bootstrap included.

    Returns:
        Position and orientation statistics (m, rad), the errors themselves, and the grade.

    Raises:
        InputError: A file or array cannot be used; with every problem.
        UsageError: The arguments contradict each other or do not fit the data.

    Example:
        >>> import robacc
        >>> result = robacc.estimate(
        ...     "sample_data/poses.csv", robot="sample_data/robot.yaml", align=("base_frame", "tool_frame")
        ... )
        >>> print(f"{result.position.rms * 1e3:.2f} mm rms at {result.n_poses} poses, grade {result.grade.grade}")
        0.49 mm rms at 60 poses, grade D
        >>> result.errors.position.shape
        (3, 60)
    """
    arguments = locals()
    check_range("seed", seed, 0)
    check_choice("frame", frame, ("tool", "base", None))
    poses = stated(
        poses, angles=angles, units=units, columns=columns, skip_gaps=skip_gaps, coverage=coverage, sheet=sheet,
        commanded=commanded, bag=bag,
    )  # fmt: skip
    arm, arm_record = load_optional_robot(robot, base_link, tip_link, poses)
    aligned = None if align is None else effect_names(align)
    # Only a fit of the tool finds the place of a target that the robot file lacks.
    any_target = arm is not None and "tool_frame" in (aligned or ())
    data, record = load_poses(poses, arm, ordered=ordered, ignore_limits=ignore_limits, any_target=any_target)
    if arm is not None and any_target:
        arm, data = with_measured_targets(arm, data)
    use = use_model(arm, data, (record,), campaign=campaign, strict_range=strict_range)
    arm = use.robot
    grades, scale_record = load_grade_scale(scale)
    body = estimate_errors(data, arm, frame=frame, align=aligned, scale=grades, confidence=confidence, seed=seed)
    if warnings := fitted_pose_warnings(arm, (record,)):
        notes = (*body.notes, "the robot file was fitted to these same poses")
        body = dataclasses.replace(body, notes=notes, warnings=(*body.warnings, *warnings))
    body = dataclasses.replace(body, warnings=(*body.warnings, *_doubts(body, arm, data), *use.warnings))
    fitted = body.alignment.effects if body.alignment else ()
    options = options_of(estimate, arguments, align=list(fitted), frame=body.errors.frame)
    made = Provenance(options, (record, *arm_record, *scale_record), seed, use)
    return Estimate.of(body, arm, data, made)


def _doubts(body: EstimateResult, robot: Robot | None, data: Measurements) -> tuple[str, ...]:
    """Return warnings of a step between two rows, of another arm, and of joint variables with few digits."""
    from robacc.accuracy.estimation import moved_warning
    from robacc.accuracy.pose_errors import commanded_poses
    from robacc.diagnostics.data_mistakes import other_arm
    from robacc.diagnostics.joint_readings import rounding_in_errors
    from robacc.diagnostics.mistakes import even_rows

    rows = even_rows(data.n, _MOST_ROWS)
    some, fitted = data.subset(rows), body.alignment
    commanded = fitted.commanded.translation[:, rows] if fitted else commanded_poses(some, robot).block(slice(None))[0]
    error = some.position - commanded
    if robot is None or data.q is None:
        return moved_warning(some, error)
    return (
        *other_arm(robot, some, commanded),
        *moved_warning(some, error),
        *rounding_in_errors(fitted.robot if fitted else robot, some, error),
    )
