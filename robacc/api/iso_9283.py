"""Calls of ``robacc iso9283`` and ``robacc plan --for iso9283``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from robacc.api.inputs import STDIN, Inputs, fitted_pose_warnings, path_of
from robacc.api.parameters import (
    BaseLink,
    Campaign,
    Confidence,
    Help,
    IgnoreLimits,
    OptionalRobot,
    Ordered,
    PosesSource,
    RobotArgument,
    Seed,
    StrictRange,
    TipLink,
    call,
)
from robacc.api.result import CsvResult, Result, effect_names, fields_of
from robacc.errors import refuse
from robacc.iso_9283.criteria import Iso9283Result
from robacc.iso_9283.evaluation import Proposal, iso9283 as evaluate_criteria, planned_poses, propose
from robacc.measurements import Measurements
from robacc.poses.csv_file import pose_pieces
from robacc.quantities import optional_size
from robacc.render.text import Section
from robacc.render.views.accuracy import proposal_comments, proposal_view
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283(Result, Iso9283Result, command="iso9283"):
    """Pose criteria of ISO 9283, with the inputs."""


@call
def iso9283(
    *poses: Annotated[
        PosesSource,
        Help(
            "Measured poses: CSV, export, workbook, Parquet, ROS bag or folder of photos, one per robot; - reads "
            "standard input.",
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
    file or the arrays. If neither is known, the result has repeatability but no accuracy.

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


# Call of ``robacc plan --for iso9283``.


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283Poses(CsvResult, command="iso9283-poses"):
    """Cube and five poses of ISO 9283 for an arm, and the cycles to drive."""

    proposal: Proposal
    robot: Robot
    cycles: int
    payload_kg: float | None
    warnings: tuple[str, ...] = ()

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
