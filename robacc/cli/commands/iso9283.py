"""``robacc iso9283``: pose criteria of ISO 9283 from cycles of commanded poses."""

from __future__ import annotations

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
    SeedOption,
    StrictRangeOption,
    TipLinkOption,
)


def iso9283(
    poses: Annotated[
        list[str],
        typer.Argument(
            metavar="POSES [POSES …]",
            help="Measured poses: CSV, export, workbook, Parquet or ROS bag, one per robot; - reads standard input.",
        ),
    ],
    robot: RobotOption = None,
    align: AlignOption = None,
    rated_load: Annotated[
        float | None,
        typer.Option("--rated-load", metavar="KG", help="Rated load of the robot, compared with payload_kg."),
    ] = None,
    drift_windows: Annotated[
        int | None,
        typer.Option(
            "--drift-windows",
            metavar="N",
            help="Number of windows of the run for drift; default: windows of ten visits.",
        ),
    ] = None,
    confidence: ConfidenceOption = 0.95,
    ordered: OrderedOption = False,
    ignore_limits: IgnoreLimitsOption = False,
    campaign: CampaignOption = CampaignUseName.auto,
    strict_range: StrictRangeOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    seed: SeedOption = 0,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
) -> None:
    """Compute the pose criteria of ISO 9283 from cycles of commanded poses.

    The result also lists which conditions of the standard the measurement meets.

    With --robot, the commanded pose is the robot's pose at the commanded joints; without, it is read from the cmd_
    columns. If neither is known, the result has repeatability but no accuracy.

    Example: robacc iso9283 cycles.csv --robot robot.yaml
    """
    from robacc.api.iso9283 import iso9283 as run_iso9283
    from robacc.cli.output import Outlets, deliver

    result = run_iso9283(
        *poses,
        robot=robot,
        align=align or (),
        rated_load=rated_load,
        drift_windows=drift_windows,
        confidence=confidence,
        ordered=ordered,
        ignore_limits=ignore_limits,
        campaign=campaign.value,
        strict_range=strict_range,
        base_link=base_link,
        tip_link=tip_link,
        seed=seed,
    )

    def table(stream: TextIO) -> None:
        from robacc.render.views.elements import draw
        from robacc.render.views.iso9283 import iso9283_view

        draw(iso9283_view(result.payload(), robot), stream)

    deliver(Outlets(form, output, gate, junit, report), result, table)
