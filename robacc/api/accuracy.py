"""Calls of ``robacc estimate``, ``robacc iso9283`` and ``robacc plan --for iso9283``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from shlex import quote
from typing import Annotated, Any, Literal

from robacc.accuracy.estimation import (
    EstimateResult,
    PredictedBy,
    commanded_poses,
    estimate as estimate_errors,
    moved_warning,
    totals_of_parts,
)
from robacc.api.inputs import STDIN, Inputs, fitted_pose_warnings, path_of, with_measured_targets
from robacc.api.parameters import (
    Angles,
    Bag,
    BaseLink,
    BoardFile,
    CameraFile,
    Campaign,
    Cluster,
    Columns,
    Commanded,
    Confidence,
    ContactSheet,
    Coverage,
    Help,
    IgnoreLimits,
    Jobs,
    OptionalRobot,
    Ordered,
    Poses,
    PosesSource,
    Progress,
    RobotArgument,
    Scale,
    Seed,
    Sheet,
    SkipGaps,
    StrictRange,
    TipLink,
    Units,
    call,
)
from robacc.api.result import CsvResult, Result, effect_names, fields_of
from robacc.diagnostics.data_mistakes import check_data, other_arm
from robacc.diagnostics.recorded import rounding_in_errors
from robacc.documents.accuracy import ESTIMATE_ITSELF, SUMMARY
from robacc.documents.envelope import csv_text
from robacc.errors import InputError, Note, applying, refuse
from robacc.geometry import vector_lengths
from robacc.iso_9283.criteria import Iso9283Result
from robacc.iso_9283.evaluation import Proposal, iso9283 as evaluate_criteria, planned_poses, propose
from robacc.measurements import Measurements, even_rows
from robacc.poses.csv_file import pose_pieces
from robacc.poses.reading import PoseFile, reading_of
from robacc.quantities import optional_size
from robacc.render.text import Section
from robacc.render.views.accuracy import estimate_view, proposal_comments, proposal_view
from robacc.robots.description import Robot
from robacc.workers import Workers


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Estimate(Result, EstimateResult, command="estimate"):
    """Errors of the measured poses, their statistics and the grade, with the inputs."""

    robot: Robot | None
    """Robot as its file describes it, before any alignment."""
    data: Measurements
    """The measured poses; of a large file some, evenly spread."""
    parts: tuple[Callable[[], Measurements], ...] = ()
    """Functions that read the parts of a large file; none for any other file."""

    def view(self, full: bool = False, poses: str | None = None, robot: str | None = None) -> Iterable[Section]:
        """Return one screen, or with ``full`` all of the report; ``poses`` and ``robot`` are the paths of the files."""
        names = poses or self.named("poses"), robot or self.named("robot")
        recorded = next((file.reading for file in self.made.inputs if file.reading), {})
        # A path states where the file of the commands is; the record has its name alone.
        reading = {**recorded, **reading_of(poses or "").document()}
        flags = ((name, f" --{name.replace('_', '-')}") for name in reading if name != "commanded_sha256")
        texts = {**reading, "columns": "MAP"}
        stated = [flag if reading[name] is True else f"{flag} {quote(str(texts[name]))}" for name, flag in flags]
        return estimate_view(ESTIMATE_ITSELF.write(self), *names, "full" if full else "short", "".join(stated))

    def summary(self) -> dict[str, Any]:
        """Return the main figures, for a table of several files."""
        return SUMMARY.write(self)

    def per_pose_csv(self) -> str:
        """Return a CSV with one row for each pose: line, ids, error vector and its length, in m and rad."""
        return "".join(self.per_pose_pieces())

    def per_pose_pieces(self) -> Iterator[str]:
        """Yield the text of :meth:`per_pose_csv` in pieces, for which a large file is read again."""
        predicted = PredictedBy.of(self.robot, self.alignment, self.errors.frame)
        of_parts = ((data := read(), predicted.errors(data)) for read in self.parts)
        for number, (data, errors) in enumerate(of_parts if self.parts else [(self.data, self.errors)]):
            columns: dict[str, Iterable[Any] | None] = {"line": map(data.line, range(data.n))}
            columns |= {name: getattr(data, name) for name in ("pose", "cycle", "visit", "target")}
            for prefix, unit, vectors in (("d", "m", errors.position), ("r", "rad", errors.rotation)):
                if vectors is not None:
                    columns |= {f"{prefix}{axis}_{unit}": row for axis, row in zip("xyz", vectors, strict=True)}
                    columns[f"error_{unit}"] = vector_lengths(vectors)
            text = csv_text(columns)
            yield text.partition("\n")[2] if number else text


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
            "without it are too large for an arm.",
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
    camera: CameraFile = None,
    board: BoardFile = None,
    bag: Bag = None,
    contact_sheet: ContactSheet = None,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: Cluster = None,
    progress: Progress = None,
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
    inputs = Inputs(locals(), "poses")
    poses = inputs.stated(poses)
    arm = inputs.optional_robot(poses)
    aligned = None if align is None else effect_names(align)
    if align is None and arm is not None and isinstance(poses, PoseFile) and poses.reading.camera is not None:
        aligned = ("base_frame", "tool_frame")  # Nobody knows where the camera and the board are.
    # Only a fit of the tool finds the place of a target that the robot file lacks.
    any_target = arm is not None and "tool_frame" in (aligned or ())
    data, parts = inputs.measured(poses, arm, any_target=any_target)
    if arm is not None and any_target:
        arm, data = with_measured_targets(arm, data)
    if arm is not None and data.q is None and data.commanded_position is not None:
        text = f"{data.source}: has commanded poses and no joint variables, so the errors are against these commands"
        arm, data = None, replace(data, warnings=(*data.warnings, Note(f"{text}, not against the robot")))
    arm = None if arm is None else inputs.campaign(arm, data)
    fitted = fitted_pose_warnings(arm, inputs.records)
    grades, totals = inputs.scale(), None
    if parts:
        workers, shown = Workers(jobs, cluster), progress or (lambda label, done, total: None)
        totals = partial(totals_of_parts, parts, arm, workers, shown)
    body = estimate_errors(
        data, arm, frame=frame, align=aligned, scale=grades, confidence=confidence, seed=seed, totals=totals
    )
    in_parts = (
        f"the file was read in {len(parts)} parts: statistics, grade and worst poses are of all rows; frames were "
        f"fitted to {data.n} rows, evenly spread, and the errors that a result lists pose by pose are theirs"
    )
    notes = applying((fitted, "the robot file was fitted to these same poses"), (parts, in_parts))
    body = replace(
        body,
        notes=(*body.notes, *notes),
        warnings=(*body.warnings, *fitted, *_doubts(body, arm, data), *inputs.warnings),
    )
    made = inputs.made(align=list(body.alignment.effects if body.alignment else ()), frame=body.errors.frame)
    return Estimate(**fields_of(body), robot=arm, data=data, parts=parts, made=made)


def _doubts(body: EstimateResult, robot: Robot | None, data: Measurements) -> tuple[str, ...]:
    """Return warnings of a mistake in the data, a step between two rows, another arm, and joints with few digits."""
    rows = even_rows(data.n, 5000)  # rows that show a step and a rounding well enough
    some, fitted = data.subset(rows), body.alignment
    commanded = fitted.commanded.translation[:, rows] if fitted else commanded_poses(some, robot)[0]
    error = some.position - commanded
    moved = moved_warning(some, error)
    if robot is None or data.q is None:
        return (*body.too_large, *moved)
    roundings = rounding_in_errors(fitted.robot if fitted else robot, some, error)
    try:
        mistakes = check_data(robot, some) if body.too_large and fitted else other_arm(robot, some, commanded)
    except InputError as mistake:
        mistakes = (str(mistake),)
    return (*(mistakes or body.too_large), *moved, *roundings)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283(Result, Iso9283Result, command="iso9283"):
    """Pose criteria of ISO 9283, with the inputs."""


@call
def iso9283(
    *poses: Annotated[
        PosesSource,
        Help(
            "Measured poses: CSV, export, workbook, Parquet, ROS bag, folder of photos or Parquet, one per robot; - "
            "reads standard input.",
            "POSES [POSES …]",
            "Or poses read before.",
            holds="measured poses",
        ),
    ],
    robot: OptionalRobot = None,
    align: Annotated[
        str | Sequence[str],
        Help(
            "Frames to fit to the poses of each file first: base_frame, tool_frame, both, or none.",
            "FRAME,…",
            "They are frames of `robot`, or without `robot` of the commanded poses.",
        ),
    ] = (),
    rated_load: Annotated[float | None, Help("Rated load of the robot, compared with payload_kg.", "KG")] = None,
    drift_windows: Annotated[
        int | None, Help("Number of windows of the run for drift; default: windows of ten visits.", "N")
    ] = None,
    confidence: Confidence = 0.95,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
) -> Iso9283:
    """Compute the pose criteria of ISO 9283 from cycles of commanded poses, and check the standard's conditions.

    With ``robot``, the commanded pose is the robot's pose at the commanded joints; without, the commanded pose of the
    file or the arrays. If neither is known, a column pose says which visits are of one pose, and the result has
    repeatability but no accuracy.

    Returns:
        Every criterion (m, rad) with its interval, or the reason for its absence, and the conditions of the protocol.

    Raises:
        InputError: A file or array cannot be used; with every problem.
        UsageError: The arguments contradict each other or do not fit the data.

    Example:
        >>> import robacc
        >>> result = robacc.iso9283("sample_data/iso9283/poses.csv", robot="sample_data/iso9283/robot.yaml")
        >>> print(f"RP {result.characteristic('RP').position.value * 1e6:.0f} um")
        RP 74 um
    """
    inputs = Inputs(locals(), "poses")
    refuse(
        (
            [path_of(source) for source in poses].count(STDIN) > 1,
            "standard input can be read only once, but - is given more than once",
        )
    )
    described = inputs.optional_robot(next(iter(poses), None))
    loaded: list[Measurements] = []
    arms: list[Robot] = []
    for source in poses:
        loaded.append(inputs.poses(source, described))
        if described is not None:
            arms.append(inputs.campaign(described, loaded[-1]))
    arm = next(iter(arms), None)
    aligned = effect_names(align)
    body = evaluate_criteria(
        loaded,
        arm,
        align=aligned,
        confidence=confidence,
        seed=seed,
        windows=drift_windows,
        rated_load=rated_load,
    )
    warnings = (*body.warnings, *fitted_pose_warnings(arm, inputs.records), *inputs.warnings)
    return Iso9283(**{**fields_of(body), "warnings": warnings}, made=inputs.made(align=list(aligned)))


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283Poses(CsvResult, command="iso9283-poses"):
    """Cube and five poses of ISO 9283 for an arm, and the cycles to drive."""

    proposal: Proposal
    robot: Robot
    cycles: int
    payload_kg: float | None

    def csv_pieces(self) -> Iterator[str]:
        """Yield the CSV of the visits: pose, cycle, joints and commanded pose, without measured columns."""
        yield from (f"# {line}\n" for line in proposal_comments(self.proposal, self.robot.name))
        yield from pose_pieces(planned_poses(self.proposal, self.cycles, self.payload_kg), attained=False)

    def view(self) -> Iterable[Section]:
        """Return the cube, the commanded poses and the joints."""
        return proposal_view(self.proposal, self.robot)


@call
def iso9283_poses(
    robot: RobotArgument,
    *,
    edge: Annotated[
        float | str | None,
        Help("Edge of the cube, such as 400mm; default: the largest preferred edge that fits.", "SIZE"),
    ] = None,
    plane: Annotated[
        Literal["x+", "x-", "y+", "y-"] | None,
        Help("Direction in which the plane rises; default: farthest from joint limits."),
    ] = None,
    orientation: Annotated[
        Literal["down", "forward", "own", "free"] | None,
        Help("Tool: down, forward, own (as at the centre) or free; default: the first that fits."),
    ] = None,
    cycles: Annotated[int, Help("Number of cycles through P1 to P5.", "N", least=1, most=10_000)] = 30,
    payload: Annotated[float | None, Help("Payload to write as payload_kg.", "KG", least=0.0)] = None,
    target: Annotated[str | None, Help("Target, for a robot with several.", "NAME")] = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> Iso9283Poses:
    """Plan the cube of ISO 9283 and its five poses for an arm.

    Returns:
        The cube, the commanded poses and joints, and the CSV of the cycles to drive.

    Raises:
        InputError: The robot cannot be used, or no cube fits.
        UsageError: The robot has no such target, or the edge is not a length above zero.

    Example:
        >>> import robacc
        >>> plan = robacc.iso9283_poses("sample_data/iso9283/robot.yaml", edge="400mm")
        >>> f"{plan.proposal.edge * 1e3:.0f} mm, {plan.csv().count('P1,')} visits of P1"
        '400 mm, 30 visits of P1'
    """
    inputs = Inputs(locals())
    arm = inputs.robot(robot)
    length = optional_size(edge, "length", "`edge`")
    proposal = propose(arm, edge=length, plane=plane, orientation=orientation, target=target)
    return Iso9283Poses(proposal=proposal, robot=arm, cycles=cycles, payload_kg=payload, made=inputs.made())
