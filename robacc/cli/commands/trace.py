"""``robacc trace``: find the residual, trace it to the effect the model lacks, add it, and report before and after."""

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


def trace(
    poses: PosesArgument,
    robot: NeededRobotOption,
    declared: Annotated[
        str,
        typer.Option(
            "--declared", metavar="EFFECT,…", help="Effects known to be there: fitted on both sides, before and after."
        ),
    ] = "",
    write_model: WriteModelOption = None,
    holdout: HoldoutOption = None,
    folds: FoldsOption = 5,
    empirical: Annotated[
        bool,
        typer.Option("--empirical/--named-only", help="Whether corrections without a name may compete at the end."),
    ] = True,
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
    """Close the loop: residual, cause, correction, and the error before and after on poses that had no part in it.

    Example: robacc trace poses.csv --robot robot.yaml --declared base_frame,tool_frame --write-model better.yaml
    """
    from robacc.api.trace import trace as traced
    from robacc.cli.output import Outlets, deliver
    from robacc.cli.progress import progress_bar
    from robacc.render.text.trace import draw_trace

    with progress_bar() as progress:
        found = traced(
            poses,
            robot=robot,
            declared=declared,
            holdout=holdout,
            folds=folds,
            empirical=empirical,
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
        lambda stream: draw_trace(found, poses, robot, declared, stream),
    )
