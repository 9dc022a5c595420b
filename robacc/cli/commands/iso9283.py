"""``robacc iso9283``: cycles of commanded poses in, the pose criteria of ISO 9283 out."""

from __future__ import annotations

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
    SeedOption,
    TipLinkOption,
)


def iso9283(
    poses: Annotated[
        list[str],
        typer.Argument(
            metavar="POSES [POSES …]",
            help="CSV or Parquet of measured poses, one file a robot; - reads standard input.",
        ),
    ],
    robot: RobotOption = None,
    align: Annotated[
        str | None,
        typer.Option(
            "--align", metavar="EFFECT,…", help="Fit base_frame, tool_frame or both to each file's poses first."
        ),
    ] = None,
    rated_load: Annotated[
        float | None, typer.Option("--rated-load", metavar="KG", help="What payload_kg is held against.")
    ] = None,
    drift_windows: Annotated[
        int | None,
        typer.Option(
            "--drift-windows", metavar="N", help="Parts of the run that are compared; default: of ten visits."
        ),
    ] = None,
    confidence: ConfidenceOption = 0.95,
    ordered: OrderedOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    seed: SeedOption = 0,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
) -> None:
    """The pose criteria of ISO 9283 that cycles of commanded poses support, and which conditions they meet.

    The commanded pose is the robot's own at the commanded joints where --robot is given, else the file's cmd_ columns;
    with neither there is repeatability, and no accuracy. Several files are several robots.

    Example: robacc iso9283 cycles.csv --robot robot.yaml
    """
    from robacc.api.iso9283 import iso9283 as evaluated
    from robacc.cli.output import Outlets, deliver

    found = evaluated(
        *poses,
        robot=robot,
        align=align or (),
        rated_load=rated_load,
        drift_windows=drift_windows,
        confidence=confidence,
        ordered=ordered,
        base_link=base_link,
        tip_link=tip_link,
        seed=seed,
    )

    def table(stream: TextIO) -> None:
        from robacc.render.text.iso9283 import draw_iso9283

        draw_iso9283(found, robot, stream)

    deliver(Outlets(form, output, gate, junit, report), found, table)
