"""``robacc estimate``: measured poses in, their errors and what they say of the arm out."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, TextIO

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
    ReportOption,
    RobotOption,
    ScaleOption,
    SeedOption,
    TipLinkOption,
)


class FrameName(StrEnum):
    """The axes that errors are written in."""

    tool = "tool"
    base = "base"


def estimate(
    poses: Annotated[
        list[str],
        typer.Argument(metavar="POSES [POSES …]", help="CSV or Parquet of measured poses; - reads standard input."),
    ],
    robot: RobotOption = None,
    align: Annotated[
        str | None,
        typer.Option("--align", metavar="EFFECT,…", help="Fit base_frame, tool_frame or both to the poses first."),
    ] = None,
    frame: Annotated[
        FrameName | None,
        typer.Option("--frame", help="Axes of the errors: the commanded target's, or the measuring frame's."),
    ] = None,
    scale: ScaleOption = None,
    confidence: ConfidenceOption = 0.95,
    per_pose: Annotated[
        str | None, typer.Option("--per-pose", metavar="FILE", help="Write each pose's error there, as CSV.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", metavar="N", min=1, help="Several files: so many at once; default is a core each."),
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
    Several files, as in DIR/*.csv, are estimated each by itself and make one table; one that fails does not end the
    rest. With --output DIR/ each result becomes a file there.

    Example: robacc estimate poses.csv --robot robot.yaml --align base_frame,tool_frame
    """
    from robacc.api.estimate import estimate as estimated
    from robacc.api.result import effect_names
    from robacc.cli.many_work import Asked
    from robacc.cli.output import Outlets, deliver

    asked = Asked(
        robot,
        effect_names(align),
        None if frame is None else frame.value,
        scale,
        confidence,
        ordered,
        base_link,
        tip_link,
        seed,
    )
    outlets = Outlets(form, output, gate, junit, report)
    if len(poses) > 1:
        from robacc.cli.many import estimate_each

        estimate_each(poses, asked, outlets, per_pose, jobs)
        return
    found = estimated(poses[0], **asked._asdict())

    def table(stream: TextIO) -> None:
        from robacc.render.text.estimate import draw_estimate

        draw_estimate(found, poses[0], robot, stream)

    if per_pose is not None:
        from robacc.io.files import write_text

        write_text(per_pose, found.per_pose_csv())
    deliver(outlets, found, table)
