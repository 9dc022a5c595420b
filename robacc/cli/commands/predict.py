"""``robacc predict``: tolerances in, the accuracy to be expected out; and held against measured poses."""

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
    ScaleOption,
    SeedOption,
    TipLinkOption,
)
from robacc.prediction import DEFAULT_SAMPLES


def predict(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML) or URDF.")],
    poses: Annotated[
        str | None, typer.Option("--poses", metavar="FILE", help="CSV of poses whose joints to predict at.")
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            "--samples", metavar="N", help=f"Configurations over the joint ranges; default {DEFAULT_SAMPLES}."
        ),
    ] = None,
    target: Annotated[
        str | None, typer.Option("--target", metavar="NAME", help="Of several targets, the one that samples are of.")
    ] = None,
    tolerances: Annotated[
        str | None, typer.Option("--tolerances", metavar="FILE", help="Tolerances (YAML) that go before the robot's.")
    ] = None,
    scale: ScaleOption = None,
    allocate: Annotated[
        str | None, typer.Option("--allocate", metavar="GRADE", help="Find tolerances that would reach this grade.")
    ] = None,
    against: Annotated[
        str | None,
        typer.Option("--against", metavar="FILE", help="CSV of measured poses to hold the prediction against."),
    ] = None,
    align: Annotated[
        str | None,
        typer.Option("--align", metavar="EFFECT,…", help="Fit base_frame, tool_frame or both to --against first."),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option("--noise", metavar="P[,R]", help="Measuring noise along, and about, an axis, as 0.02mm,0.01deg."),
    ] = None,
    confidence: ConfidenceOption = 0.95,
    per_pose: Annotated[
        str | None, typer.Option("--per-pose", metavar="FILE", help="Write each pose's prediction there, as CSV.")
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
    """Covariances, error budget and grade to be expected from parameter tolerances.

    At the poses of --poses, else at those of --against, else at configurations spread over the joint ranges.

    Example: robacc predict robot.yaml --tolerances tolerances.yaml --allocate C
    """
    from robacc.api.predict import predict as predicted
    from robacc.cli.output import Outlets, deliver

    found = predicted(
        robot,
        poses=poses,
        samples=samples,
        target=target,
        tolerances=tolerances,
        scale=scale,
        allocate=allocate,
        against=against,
        align=align or (),
        noise=noise,
        confidence=confidence,
        ordered=ordered,
        base_link=base_link,
        tip_link=tip_link,
        seed=seed,
    )

    def table(stream: TextIO) -> None:
        from robacc.render.text.predict import draw_prediction

        draw_prediction(found.robot, found, found.allocation, found.comparison, stream)

    if per_pose is not None:
        from robacc.io.files import write_text

        write_text(per_pose, found.per_pose_csv())
    deliver(Outlets(form, output, gate, junit, report), found, table)
