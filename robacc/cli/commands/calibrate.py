"""``robacc calibrate``: fit named effects to measured poses."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.options import (
    BaseLinkOption,
    CampaignOption,
    CampaignUseName,
    FoldsOption,
    Format,
    FormatOption,
    GateOption,
    HoldoutOption,
    IgnoreLimitsOption,
    JunitOption,
    NeededRobotOption,
    OrderedOption,
    OutputOption,
    PosesArgument,
    ReportOption,
    SeedOption,
    StrictRangeOption,
    TipLinkOption,
    WriteModelOption,
)


def calibrate(
    poses: PosesArgument,
    robot: NeededRobotOption,
    fit: Annotated[
        str,
        typer.Option(
            "--fit",
            metavar="EFFECT,…",
            help="Effects to fit, such as base_frame,joint_offset[j2,j3]; robacc effects lists them.",
        ),
    ],
    write_model: WriteModelOption = None,
    prior: Annotated[
        bool, typer.Option("--prior/--no-prior", help="Use the tolerances of the robot file as priors of its geometry.")
    ] = False,
    shrink: Annotated[
        bool,
        typer.Option(
            "--shrink/--no-shrink",
            help="Shrink joint_offset and link_geometry, if named without brackets, to nominal values where the data "
            "show no difference.",
        ),
    ] = True,
    robust: Annotated[
        bool, typer.Option("--robust/--all-rows", help="Leave out outliers and list them, or fit all rows.")
    ] = True,
    holdout: HoldoutOption = None,
    folds: FoldsOption = None,
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
    """Fit named effects to measured poses, and report fitted and held-out errors before and after.

    An effect with joints in brackets is fitted to these joints. Without brackets it is fitted to the joints where the
    data show it.

    Example: robacc calibrate poses.csv --robot robot.yaml --fit base_frame,tool_frame --write-model better.yaml
    """
    from robacc.api.calibrate import calibrate as run_calibrate
    from robacc.cli.output import Outlets, deliver_fit, progress_bar
    from robacc.render.views.elements import draw
    from robacc.render.views.fit import calibration_view

    with progress_bar() as progress:
        result = run_calibrate(
            poses,
            robot=robot,
            fit=fit,
            prior=prior,
            shrink=shrink,
            robust=robust,
            holdout=holdout,
            folds=folds,
            ordered=ordered,
            ignore_limits=ignore_limits,
            campaign=campaign.value,
            strict_range=strict_range,
            base_link=base_link,
            tip_link=tip_link,
            seed=seed,
            progress=progress,
        )
    deliver_fit(
        write_model,
        Outlets(form, output, gate, junit, report),
        result,
        lambda stream: draw(calibration_view(result.payload(), poses, robot, fit), stream),
    )
