"""``robacc calibrate``: fit the effects that are named, and say how much better the robot is predicted."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.fitting import FoldsOption, HoldoutOption, NeededRobotOption, WriteModelOption
from robacc.cli.options import (
    BaseLinkOption,
    Format,
    FormatOption,
    GateOption,
    JunitOption,
    OrderedOption,
    OutputOption,
    PosesArgument,
    ReportOption,
    SeedOption,
    TipLinkOption,
)


def calibrate(
    poses: PosesArgument,
    robot: NeededRobotOption,
    fit: Annotated[
        str,
        typer.Option(
            "--fit",
            metavar="EFFECT,…",
            help="Effects to fit, as in base_frame,joint_offset[j2,j3],gear_ratio[all]; see robacc effects.",
        ),
    ],
    write_model: WriteModelOption = None,
    prior: Annotated[
        bool, typer.Option("--prior/--no-prior", help="Use the robot file's tolerances as priors of its geometry.")
    ] = False,
    shrink: Annotated[
        bool,
        typer.Option(
            "--shrink/--no-shrink",
            help="Draw joint_offset and link_geometry, asked for without brackets, to the robot file's values where "
            "most of them do not differ.",
        ),
    ] = True,
    robust: Annotated[
        bool, typer.Option("--robust/--all-rows", help="Leave out rows that are no part of the rest, naming them.")
    ] = True,
    holdout: HoldoutOption = None,
    folds: FoldsOption = 5,
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
    """Fit the named effects to measured poses and report the error before and after, fitted and held out.

    An effect of joints named without brackets is fitted on the joints where the data show it; with brackets, exactly
    there.

    Example: robacc calibrate poses.csv --robot robot.yaml --fit base_frame,tool_frame --write-model better.yaml
    """
    from robacc.api.calibrate import calibrate as calibrated
    from robacc.cli.output import Outlets, deliver
    from robacc.cli.progress import progress_bar
    from robacc.render.text.calibrate import draw_calibration

    with progress_bar() as progress:
        found = calibrated(
            poses,
            robot=robot,
            fit=fit,
            prior=prior,
            shrink=shrink,
            robust=robust,
            holdout=holdout,
            folds=folds,
            ordered=ordered,
            base_link=base_link,
            tip_link=tip_link,
            seed=seed,
            progress=progress,
        )
    if write_model is not None:
        found.write_model(write_model)
    deliver(
        Outlets(form, output, gate, junit, report),
        found,
        lambda stream: draw_calibration(found, found.fit_inputs.data, poses, robot, fit, stream),
    )
