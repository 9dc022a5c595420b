"""``robacc predict``: accuracy predicted from parameter tolerances, and compared with measured poses."""

from __future__ import annotations

from typing import Annotated, TextIO

import typer

from robacc.cli.options import (
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
    ScaleOption,
    SeedOption,
    StrictRangeOption,
    TipLinkOption,
)
from robacc.prediction import DEFAULT_SAMPLES


def predict(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML), URDF, or name of an arm.")],
    poses: Annotated[
        str | None, typer.Option("--poses", metavar="FILE", help="CSV of poses; the prediction is for their joints.")
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            "--samples",
            metavar="N",
            help=f"Number of configurations over the joint ranges; default: {DEFAULT_SAMPLES}.",
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--target", metavar="NAME", help="Target of the sampled configurations, for a robot with several."
        ),
    ] = None,
    tolerances: Annotated[
        str | None,
        typer.Option(
            "--tolerances", metavar="FILE", help="Tolerance file (YAML); overrides the tolerances of the robot file."
        ),
    ] = None,
    scale: ScaleOption = None,
    allocate: Annotated[
        str | None, typer.Option("--allocate", metavar="GRADE", help="Grade to find tolerances for.")
    ] = None,
    against: Annotated[
        str | None,
        typer.Option("--against", metavar="FILE", help="CSV of measured poses to compare the prediction with."),
    ] = None,
    align: Annotated[
        str | None,
        typer.Option(
            "--align",
            metavar="FRAME,…",
            help="Frames to fit to the poses of --against first: base_frame, tool_frame or both.",
        ),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            "--noise",
            metavar="P[,R]",
            help="Standard deviation of the measurement noise along and about an axis, such as 0.02mm,0.01deg.",
        ),
    ] = None,
    confidence: ConfidenceOption = 0.95,
    per_pose: Annotated[
        str | None, typer.Option("--per-pose", metavar="FILE", help="CSV to write with the prediction at each pose.")
    ] = None,
    warranty_map: Annotated[
        str | None,
        typer.Option("--warranty-map", metavar="FILE", help="CSV to write with the errors and the grade by voxel."),
    ] = None,
    voxel: Annotated[
        str, typer.Option("--voxel", metavar="SIZE", help="Edge of a voxel of --warranty-map, such as 50mm.")
    ] = "100mm",
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
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Predict covariances, error budget and grade from parameter tolerances or the fit of a model file.

    The prediction is for the joints of --poses, else of --against, else for configurations over the joint ranges. With
    a model that --write-model wrote, it is for the calibrated arm; with --tolerances, it is for arms made with these
    tolerances.

    Example: robacc predict robot.yaml --tolerances tolerances.yaml --allocate C
    """
    from robacc.api.predict import predict as run_predict
    from robacc.cli.output import Outlets, deliver

    result = run_predict(
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
        ignore_limits=ignore_limits,
        campaign=campaign.value,
        strict_range=strict_range,
        base_link=base_link,
        tip_link=tip_link,
        seed=seed,
    )

    def table(stream: TextIO) -> None:
        from robacc.render.views.elements import draw
        from robacc.render.views.predict import prediction_view

        source = "" if result.comparison is None else result.comparison.source
        draw(prediction_view(result.payload(), source), stream)

    if warranty_map is not None:
        from robacc.io.files import write_text

        write_text(warranty_map, result.map_csv(voxel))
    if per_pose is not None:
        from robacc.io.files import write_text

        write_text(per_pose, result.per_pose_csv())
    deliver(Outlets(form, output, gate, junit, report), result, table)
