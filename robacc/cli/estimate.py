"""``robacc estimate``: measured poses in, their errors and what they say of the arm out."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from robacc.cli.options import (
    BaseLinkOption,
    ConfidenceOption,
    Format,
    FormatOption,
    GateOption,
    JunitOption,
    OrderedOption,
    OutputOption,
    PosesArgument,
    ReportOption,
    RobotOption,
    SeedOption,
    TipLinkOption,
    split_list,
)
from robacc.results import InputFile

if TYPE_CHECKING:
    from robacc.estimation import EstimateResult
    from robacc.grade_scale import Scale
    from robacc.measurements import Measurements
    from robacc.robots.description import Robot


class FrameName(StrEnum):
    """The axes that errors are written in."""

    tool = "tool"
    base = "base"


def estimate(
    poses: PosesArgument,
    robot: RobotOption = None,
    align: Annotated[
        str | None,
        typer.Option("--align", metavar="EFFECT,…", help="Fit base_frame, tool_frame or both to the poses first."),
    ] = None,
    frame: Annotated[
        FrameName | None,
        typer.Option("--frame", help="Axes of the errors: the commanded target's, or the measuring frame's."),
    ] = None,
    scale: Annotated[
        str | None, typer.Option("--scale", metavar="FILE", help="Grade scale (YAML); default is the package's own.")
    ] = None,
    confidence: ConfidenceOption = 0.95,
    per_pose: Annotated[
        str | None, typer.Option("--per-pose", metavar="FILE", help="Write each pose's error there, as CSV.")
    ] = None,
    ordered: OrderedOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    seed: SeedOption = 0,
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Cartesian error at each measured pose, its covariances, and an accuracy grade.

    The commanded pose is the robot's own at the commanded joints where --robot is given, else the file's cmd_ columns.
    """
    from robacc.cli.output import Outlets, deliver
    from robacc.estimation import estimate as estimated

    arm, data, inputs = _load(poses, robot, base_link, tip_link, ordered)
    found = estimated(
        data,
        arm,
        frame=frame.value if frame is not None else None,
        what=split_list(align),
        scale=_scale(scale),
        confidence=confidence,
        seed=seed,
    )
    options = {
        "align": list(split_list(align)),
        "frame": found.errors.frame,
        "confidence": confidence,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }

    def table(stream: TextIO) -> None:
        from robacc.report.estimate import draw_estimate

        draw_estimate(found, poses, robot, stream)

    def keys() -> dict[str, Any]:
        from robacc.error_frames import position_moments
        from robacc.io.estimate_json import payload, pose_payload
        from robacc.pose_errors import commanded_poses

        aligned = arm if found.alignment is None else found.alignment.robot
        moments = position_moments(data, commanded_poses(data, aligned))
        return {**payload(found), **pose_payload(data, arm, moments)}

    if per_pose is not None:
        _write_per_pose(per_pose, found, data)
    deliver(
        Outlets(form, output, gate, junit, report),
        "estimate",
        payload=keys,
        table=table,
        options=options,
        inputs=_records(inputs, scale),
        seed=seed,
        warnings=found.warnings,
    )


def _load(
    poses: str, robot: str | None, base_link: str | None, tip_link: str | None, ordered: bool
) -> tuple[Robot | None, Measurements, tuple[InputFile, ...]]:
    """The robot, where one is named, the poses read for it, and the record of both files."""
    from robacc.errors import UsageError

    if robot is None:
        from robacc.io.poses_csv import read_poses

        if base_link or tip_link:
            raise UsageError("--base-link and --tip-link choose a chain of the URDF that --robot names")
        data = read_poses(poses, ordered=ordered)
        return None, data, (InputFile.at(poses, data.sha256 or "", "poses"),)
    from robacc.io.files import sha256_of
    from robacc.io.robot_file import read_robot
    from robacc.io.robot_poses import read_robot_poses

    arm = read_robot(robot, base_link=base_link, tip_link=tip_link)
    data = read_robot_poses(poses, arm, ordered=ordered)
    record = InputFile.at(robot, sha256_of(robot), "robot")
    return arm, data, (InputFile.at(poses, data.sha256 or "", "poses"), record)


def _scale(path: str | None) -> Scale | None:
    if path is None:
        return None
    from robacc.grade_scale import load_scale
    from robacc.io.files import read_text

    return load_scale(read_text(path), path)


def _records(inputs: tuple[InputFile, ...], scale: str | None) -> tuple[InputFile, ...]:
    """The inputs' records with the grade scale's, where one was given."""
    from robacc.io.files import sha256_of

    return inputs if scale is None else (*inputs, InputFile.at(scale, sha256_of(scale), "scale"))


def _write_per_pose(path: str, found: EstimateResult, data: Measurements) -> None:
    from robacc.io.estimate_json import per_pose_csv
    from robacc.io.files import write_text

    write_text(path, per_pose_csv(found, data))
