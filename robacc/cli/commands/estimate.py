"""``robacc estimate``: errors of measured poses, their statistics and the grade."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, TextIO

import typer

from robacc.cli.options import (
    AlignOption,
    BaseLinkOption,
    CampaignOption,
    CampaignUseName,
    ConfidenceOption,
    Format,
    FormatOption,
    GateOption,
    IgnoreLimitsOption,
    JunitOption,
    OrderedOption,
    OutputOption,
    ReportOption,
    RobotOption,
    ScaleOption,
    SeedOption,
    StrictRangeOption,
    TipLinkOption,
)


class FrameName(StrEnum):
    """Axes of the errors."""

    tool = "tool"
    base = "base"


def estimate(
    poses: Annotated[
        list[str],
        typer.Argument(
            metavar="POSES [POSES …]",
            help="Measured poses: CSV, export, workbook, Parquet or ROS bag; - reads standard input.",
        ),
    ],
    robot: RobotOption = None,
    align: AlignOption = None,
    frame: Annotated[
        FrameName | None,
        typer.Option(
            "--frame", help="Axes of the errors: tool of the commanded target, or base of the measuring frame."
        ),
    ] = None,
    scale: ScaleOption = None,
    confidence: ConfidenceOption = 0.95,
    per_pose: Annotated[
        str | None, typer.Option("--per-pose", metavar="FILE", help="CSV to write with the error of each pose.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", metavar="N", min=1, help="Number of files processed at the same time; default: number of cores."
        ),
    ] = None,
    ordered: OrderedOption = False,
    ignore_limits: IgnoreLimitsOption = False,
    campaign: CampaignOption = CampaignUseName.auto,
    strict_range: StrictRangeOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    seed: SeedOption = 0,
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
    full: Annotated[
        bool,
        typer.Option("--full", help="Table with covariances, principal axes, tests, worst poses and limitations."),
    ] = False,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Compute the Cartesian error of measured poses, its covariances and the accuracy grade.

    With --robot, the commanded pose is the robot's pose at the commanded joints; without, it is read from the cmd_
    columns. Several files, such as DIR/*.csv, are estimated one by one and shown in one table; an error in one file
    does not stop the others. With --output DIR/ each result becomes a file in that folder.

    Example: robacc estimate poses.csv --robot robot.yaml --align base_frame,tool_frame
    """
    from robacc.api.estimate import estimate as run_estimate
    from robacc.api.result import effect_names
    from robacc.cli.many import EstimateOptions
    from robacc.cli.output import Outlets, deliver

    options = EstimateOptions(
        robot,
        None if align is None else effect_names(align),
        None if frame is None else frame.value,
        scale,
        confidence,
        ordered,
        ignore_limits,
        campaign.value,
        strict_range,
        base_link,
        tip_link,
        seed,
    )
    outlets = Outlets(form, output, gate, junit, report)
    if len(poses) > 1:
        from robacc.cli.many import estimate_each

        estimate_each(poses, options, outlets, per_pose, jobs, full=full)
        return
    result = run_estimate(poses[0], **options._asdict())

    def table(stream: TextIO) -> None:
        from robacc.documents.estimate import payload
        from robacc.render.views.elements import draw
        from robacc.render.views.estimate import estimate_view, short_estimate_view

        view = estimate_view if full else short_estimate_view
        draw(view(payload(result), poses[0], robot), stream)

    if per_pose is not None:
        from robacc.io.files import write_text

        write_text(per_pose, result.per_pose_csv())
    deliver(outlets, result, table)
