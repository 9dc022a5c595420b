"""``robacc trace``: find the residual, trace it to the effect the model lacks, add it, and report before and after."""

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

    Example: robacc trace poses.csv --robot arm.yaml --declared base_frame,tool_frame --write-model better.yaml
    """
    from robacc.cli.output import Outlets, deliver
    from robacc.cli.progress import progress_bar
    from robacc.effects.request import build, parse_requests
    from robacc.io.files import write_text
    from robacc.io.fit_json import trace_payload
    from robacc.model import Model
    from robacc.report.trace import draw_trace
    from robacc.robots.arm import Arm
    from robacc.tracing.trace import trace as close_the_loop

    arm, data, apart, inputs = load(poses, robot, holdout, ordered, base_link, tip_link)
    effects = build(parse_requests(declared), Arm.of(arm), data)
    with progress_bar() as progress:
        found = close_the_loop(
            Model.of(arm, effects),
            data,
            n_folds=folds,
            seed=seed,
            holdout=apart,
            empirical=empirical,
            progress=progress,
        )
    if write_model is not None:
        write_text(write_model, model_text(found.robot, "trace", poses))
    options = {
        "poses": poses,
        "robot": robot,
        "declared": declared,
        "folds": folds,
        "holdout": holdout,
        "empirical": empirical,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }
    deliver(
        Outlets(form, output, gate, junit, report),
        "trace",
        payload=lambda: trace_payload(found, data, arm, apart, seed),
        table=lambda stream: draw_trace(found, poses, robot, declared, stream),
        options=options,
        inputs=inputs,
        seed=seed,
        warnings=found.warnings,
    )
