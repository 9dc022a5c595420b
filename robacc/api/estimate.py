"""Call of the command ``robacc estimate``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, TextIO

from robacc.accuracy.estimation import (
    EstimateResult,
    commanded_poses,
    moved_warning,
    position_statistics,
    registered_poses,
)
from robacc.accuracy.estimation import estimate as estimate_errors
from robacc.api.inputs import (
    fitted_pose_warnings,
    load_grade_scale,
    load_optional_robot,
    load_poses,
    stated,
    with_measured_targets,
)
from robacc.api.parameters import (
    Angles,
    Bag,
    BaseLink,
    Campaign,
    Columns,
    Commanded,
    Confidence,
    Coverage,
    Help,
    IgnoreLimits,
    OptionalRobot,
    Ordered,
    Poses,
    Scale,
    Seed,
    Sheet,
    SkipGaps,
    StrictRange,
    TipLink,
    Units,
    call,
)
from robacc.api.result import Provenance, Result, effect_names, fields_of, options_of, use_model
from robacc.diagnostics.data_mistakes import other_arm
from robacc.diagnostics.recorded import rounding_in_errors
from robacc.documents.accuracy import ESTIMATE_ITSELF, estimate_poses, per_pose_csv
from robacc.errors import Note
from robacc.measurements import Measurements, even_rows
from robacc.render.views.accuracy import estimate_view
from robacc.render.views.elements import draw
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

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        statistics = position_statistics(self.data, registered_poses(self.data, self.robot, self.alignment))
        registered = None if self.alignment is None else self.alignment.robot
        return {**ESTIMATE_ITSELF.write(self), **estimate_poses(self.data, self.robot, registered, statistics)}

    def draw(self, stream: TextIO, full: bool = False, poses: str | None = None, robot: str | None = None) -> None:
        """Write one screen, or with ``full`` all of the report; ``poses`` and ``robot`` are the paths of the files."""
        names = poses or self.named("poses"), robot or self.named("robot")
        draw(estimate_view(ESTIMATE_ITSELF.write(self), *names, "full" if full else "short"), stream)

    def per_pose_csv(self) -> str:
        """Return a CSV with one row for each pose: line, ids, error vector and its length, in m and rad."""
        return per_pose_csv(self, self.data)


@call
def estimate(
    poses: Poses,
    *,
    robot: OptionalRobot = None,
    align: Annotated[
        str | Sequence[str] | None,
        Help(
            "Frames to fit to the poses of each file first: base_frame, tool_frame, both, or none.",
            "FRAME,…",
            "They are frames of `robot`, or without `robot` of the commanded poses. None fits them where the errors "
            "without it are too large for an arm and those with it are not.",
        ),
    ] = None,
    frame: Annotated[
        Literal["tool", "base"] | None,
        Help(
            "Axes of the errors: tool of the commanded target, or base of the measuring frame.",
            python="None is ``tool`` if the commanded orientation is known, else ``base``.",
        ),
    ] = None,
    scale: Scale = None,
    confidence: Confidence = 0.95,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    angles: Angles = None,
    units: Units = None,
    columns: Columns = None,
    skip_gaps: SkipGaps = False,
    coverage: Coverage = None,
    sheet: Sheet = None,
    commanded: Commanded = None,
    bag: Bag = None,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
) -> Estimate:
    """Compute the Cartesian error at each measured pose, its covariances, and an accuracy grade.

    With ``robot``, the commanded pose is the robot's pose at the commanded joints; without, the commanded pose of the
    file or the arrays.

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
    if arm is not None and data.q is None and data.commanded_position is not None:
        text = f"{data.source}: has commanded poses and no joint variables, so the errors are against these commands"
        arm, data = None, replace(data, warnings=(*data.warnings, Note(f"{text}, not against the robot")))
    use = use_model(arm, data, (record,), campaign=campaign, strict_range=strict_range)
    arm = use.robot
    grades, scale_record = load_grade_scale(scale)
    body = estimate_errors(data, arm, frame=frame, align=aligned, scale=grades, confidence=confidence, seed=seed)
    fitted = fitted_pose_warnings(arm, (record,))
    notes = (*body.notes, *(["the robot file was fitted to these same poses"] if fitted else []))
    warnings = (*body.warnings, *fitted, *_doubts(body, arm, data), *use.warnings)
    body = replace(body, notes=notes, warnings=warnings)
    effects = list(body.alignment.effects if body.alignment else ())
    options = options_of(estimate, arguments, align=effects, frame=body.errors.frame)
    made = Provenance(options, (record, *arm_record, *scale_record), seed, use)
    return Estimate(**fields_of(body), robot=arm, data=data, made=made)


def _doubts(body: EstimateResult, robot: Robot | None, data: Measurements) -> tuple[str, ...]:
    """Return warnings of a step between two rows, of another arm, and of joint variables with few digits."""
    rows = even_rows(data.n, _MOST_ROWS)
    some, fitted = data.subset(rows), body.alignment
    commanded = fitted.commanded.translation[:, rows] if fitted else commanded_poses(some, robot).block(slice(None))[0]
    error = some.position - commanded
    moved = moved_warning(some, error)
    if robot is None or data.q is None:
        return moved
    roundings = rounding_in_errors(fitted.robot if fitted else robot, some, error)
    return (*other_arm(robot, some, commanded), *moved, *roundings)
