"""``robacc calibrate``: fit the effects that are named, and say how much better the robot is predicted."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.fitting import FoldsOption, HoldoutOption, NeededRobotOption, WriteModelOption, load, model_text
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
    there. Example: robacc calibrate poses.csv --robot arm.yaml --fit base_frame,tool_frame,joint_offset,link_geometry
    """
    from robacc.calibration import calibrate as fit_effects
    from robacc.calibration import tolerance_priors
    from robacc.cli.output import Outlets, deliver
    from robacc.effects.request import parse_requests
    from robacc.errors import UsageError
    from robacc.fitting import Options
    from robacc.io.files import write_text
    from robacc.io.fit_json import calibration_payload
    from robacc.report.calibrate import draw_calibration

    arm, data, apart, inputs = load(poses, robot, holdout, ordered, base_link, tip_link)
    requests = parse_requests(fit)
    if not requests:
        raise UsageError("--fit names no effect; try base_frame,tool_frame,joint_offset,link_geometry")
    priors = tolerance_priors(arm) if prior else {}
    if prior and not priors:
        raise UsageError(f"--prior: {robot} has no tolerance on any joint")
    found = fit_effects(
        arm,
        data,
        requests,
        options=Options(robust=robust),
        priors=priors,
        shrink=shrink,
        n_folds=folds,
        seed=seed,
        holdout=apart,
    )
    if write_model is not None:
        write_text(write_model, model_text(found.robot, "calibrate", poses))
    options = {
        "poses": poses,
        "robot": robot,
        "fit": fit,
        "prior": prior,
        "shrink": shrink,
        "robust": robust,
        "folds": folds,
        "holdout": holdout,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }
    deliver(
        Outlets(form, output, gate, junit, report),
        "calibrate",
        payload=lambda: calibration_payload(found, data, arm, apart, seed),
        table=lambda stream: draw_calibration(found, data, poses, robot, fit, stream),
        options=options,
        inputs=inputs,
        seed=seed,
        warnings=found.warnings,
    )
