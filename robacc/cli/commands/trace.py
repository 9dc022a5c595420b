"""``robacc trace``: find the effects that explain the residual of measured poses."""

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


def trace(
    poses: PosesArgument,
    robot: NeededRobotOption,
    declared: Annotated[
        str | None,
        typer.Option(
            "--declared",
            metavar="EFFECT,…",
            help="Effects that the baseline has; none for no effect. Default: base_frame, "
            "tool_frame, joint_offset and link_geometry, as far as the poses support them.",
        ),
    ] = None,
    write_model: WriteModelOption = None,
    holdout: HoldoutOption = None,
    folds: FoldsOption = None,
    empirical: Annotated[
        bool,
        typer.Option(
            "--empirical/--named-only",
            help="Allow empirical corrections after the named effects, or named effects only.",
        ),
    ] = True,
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
    full: Annotated[
        bool,
        typer.Option("--full", help="Table with candidates, tests, coefficients, errors and detection limits."),
    ] = False,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Find the effects that explain the residual, and report the error before and after on held-out poses.

    Example: robacc trace poses.csv --robot robot.yaml --write-model better.yaml
    """
    from robacc.api.trace import trace as run_trace
    from robacc.cli.output import Outlets, deliver_fit, progress_bar
    from robacc.render.views.elements import draw
    from robacc.render.views.fit import short_trace_view, trace_view

    with progress_bar() as progress:
        result = run_trace(
            poses,
            robot=robot,
            declared=declared,
            holdout=holdout,
            folds=folds,
            empirical=empirical,
            ordered=ordered,
            ignore_limits=ignore_limits,
            campaign=campaign.value,
            strict_range=strict_range,
            base_link=base_link,
            tip_link=tip_link,
            seed=seed,
            progress=progress,
        )
    view = trace_view if full else short_trace_view
    deliver_fit(
        write_model,
        Outlets(form, output, gate, junit, report),
        result,
        lambda stream: draw(view(result.payload(), poses, robot), stream),
    )
