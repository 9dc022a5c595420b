"""``robacc plan``: the poses worth measuring, in an order to drive, and the expected result."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from robacc.cli.options import (
    BaseLinkOption,
    OrderedOption,
    OutputOption,
    PlainFormat,
    PlainSummaryFormatOption,
    ReportOption,
    ScaleOption,
    SeedOption,
    TipLinkOption,
)

if TYPE_CHECKING:
    from robacc.api.plan import Planned


class PurposeName(StrEnum):
    """Purposes of a measurement."""

    calibrate = "calibrate"
    trace = "trace"
    acceptance = "acceptance"
    health = "health"


class CriterionName(StrEnum):
    """Criteria of the choice."""

    I = "I"  # noqa: E741
    G = "G"
    D = "D"
    A = "A"


def plan(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML), URDF, or name of an arm.")],
    purpose: Annotated[PurposeName, typer.Option("--for", help="Purpose of the measurement.")] = PurposeName.calibrate,
    poses: Annotated[
        int | None,
        typer.Option("--poses", metavar="N", min=1, max=2000, help="Number of different poses; default: by purpose."),
    ] = None,
    criterion: Annotated[
        CriterionName,
        typer.Option("--criterion", help="Mean (I) or worst (G) predicted error; D, A: of the coefficients."),
    ] = CriterionName.I,
    fit: Annotated[
        str | None, typer.Option("--fit", metavar="EFFECT,…", help="Effects that the fit leaves free.")
    ] = None,
    candidates: Annotated[
        str | None,
        typer.Option("--candidates", metavar="FILE|N", help="CSV of poses to choose from, or number of samples."),
    ] = None,
    task: Annotated[
        str | None, typer.Option("--task", metavar="FILE", help="CSV of poses where the accuracy matters.")
    ] = None,
    region: Annotated[
        str | None,
        typer.Option("--region", metavar="BOX", help="Box where the accuracy matters, such as x=0.4:0.9,z=0:0.6."),
    ] = None,
    inside: Annotated[str | None, typer.Option("--inside", metavar="BOX", help="Box that the target stays in.")] = None,
    outside: Annotated[
        list[str] | None,
        typer.Option("--outside", metavar="BOX", help="Box that the arm stays out of; may be repeated."),
    ] = None,
    half_space: Annotated[
        list[str] | None,
        typer.Option(
            "--half-space", metavar="SIDE", help="Side that the arm stays on, such as y>=-0.4; may be repeated."
        ),
    ] = None,
    min_height: Annotated[
        str | None, typer.Option("--min-height", metavar="SIZE", help="Least height of the arm above its base.")
    ] = None,
    margin: Annotated[
        float, typer.Option("--margin", metavar="SHARE", help="Share of each joint's range to keep from its limits.")
    ] = 0.02,
    max_condition: Annotated[
        float | None,
        typer.Option("--max-condition", metavar="C", help="Largest condition number of the joints' Jacobian."),
    ] = None,
    collisions: Annotated[
        bool, typer.Option("--collisions", help="Check the links' shapes of the URDF for collisions.")
    ] = False,
    instrument: Annotated[
        str | None, typer.Option("--instrument", metavar="X,Y,Z", help="Position of the instrument in the base frame.")
    ] = None,
    reflector: Annotated[
        str | None,
        typer.Option("--reflector", metavar="X,Y,Z", help="Direction in the target's frame that the reflector faces."),
    ] = None,
    cone: Annotated[
        str, typer.Option("--cone", metavar="ANGLE", help="Half angle that the reflector accepts.")
    ] = "30deg",
    distance: Annotated[
        str | None,
        typer.Option("--distance", metavar="NEAR:FAR", help="Nearest and farthest distance of the instrument, m."),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            "--noise", metavar="SIZE", help="Measurement noise along each axis (standard deviation); default: typical."
        ),
    ] = None,
    noise_orientation: Annotated[
        str | None,
        typer.Option("--noise-orientation", metavar="SIZE", help="The same about each axis, if it is measured."),
    ] = None,
    repeatability: Annotated[
        str | None,
        typer.Option(
            "--repeatability",
            metavar="SIZE",
            help="Arm's scatter along each axis (standard deviation); default: typical.",
        ),
    ] = None,
    unexplained: Annotated[
        str,
        typer.Option(
            "--unexplained", metavar="SIZE", help="Error of the model that repeats at a pose (standard deviation)."
        ),
    ] = "0",
    model: Annotated[
        str | None, typer.Option("--model", metavar="FILE", help="Calibrated robot file to start from.")
    ] = None,
    already: Annotated[
        str | None, typer.Option("--already", metavar="FILE", help="CSV of poses measured already.")
    ] = None,
    target_error: Annotated[
        str | None, typer.Option("--target-error", metavar="SIZE", help="Predicted error that is good enough.")
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option(
            "--payload", metavar="KG,…", help="Payloads, each mounted once; the plan chooses the poses of each."
        ),
    ] = None,
    check_every: Annotated[
        int, typer.Option("--check-every", metavar="K", min=0, help="Visits between drift checks; 0 for none.")
    ] = 10,
    repeats: Annotated[
        int | None,
        typer.Option("--repeats", metavar="N", min=0, help="Poses visited a second time; default: a tenth."),
    ] = None,
    validation: Annotated[
        int, typer.Option("--validation", metavar="N", min=0, max=2000, help="Number of validation poses.")
    ] = 0,
    validation_output: Annotated[
        str | None, typer.Option("--validation-output", metavar="FILE", help="File for the validation poses.")
    ] = None,
    program: Annotated[
        str | None,
        typer.Option("--program", metavar="FILE", help="File for a robot program: .src, .mod, .ls or .script."),
    ] = None,
    gate: Annotated[
        str | None, typer.Option("--gate", metavar="FILE", help="Gate that an acceptance measurement is to decide.")
    ] = None,
    grade: Annotated[
        str | None, typer.Option("--grade", metavar="NAME", help="Grade that an acceptance measurement is to confirm.")
    ] = None,
    scale: ScaleOption = None,
    expected: Annotated[
        str | None, typer.Option("--expected", metavar="SIZE", help="Expected true value for the gate or grade.")
    ] = None,
    ordered: OrderedOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    seed: SeedOption = 0,
    form: PlainSummaryFormatOption = PlainFormat.table,
    output: OutputOption = "-",
    report: ReportOption = None,
) -> None:
    """Plan a measurement: choose the poses worth measuring, order them, and predict the result.

    The CSV lists the visits in order. With --output, a summary is written to standard output.

    Example: robacc plan robot.yaml --for calibrate --poses 30 --output plan.csv
    """
    from robacc.api.plan import plan as run_plan
    from robacc.cli.call_checks import refuse_json_beside_csv
    from robacc.cli.options import numbers_of
    from robacc.errors import UsageError

    refuse_json_beside_csv(form, output)
    if (validation_output is None) != (validation == 0):
        raise UsageError("--validation N and --validation-output FILE belong together")
    result = run_plan(
        robot,
        purpose=purpose.value,
        poses=poses,
        criterion=criterion.value,
        fit=fit or "",
        candidates=int(candidates) if candidates is not None and candidates.isdecimal() else candidates,
        task=task,
        region=region,
        inside=inside,
        outside=tuple(outside or ()),
        half_space=tuple(half_space or ()),
        min_height=min_height,
        margin=margin,
        max_condition=max_condition,
        collisions=collisions,
        instrument=instrument,
        reflector=reflector,
        cone=cone,
        distance=distance,
        noise=noise,
        noise_orientation=noise_orientation,
        repeatability=repeatability,
        unexplained=unexplained,
        model=model,
        already=already,
        target_error=target_error,
        payload=() if payload is None else numbers_of(payload, ",", "--payload"),
        check_every=check_every,
        repeats=repeats,
        validation=validation,
        gate=gate,
        grade=grade,
        scale=scale,
        expected=expected,
        ordered=ordered,
        seed=seed,
        base_link=base_link,
        tip_link=tip_link,
    )
    _write(result, form, output, validation_output, program, report)


def _write(
    result: Planned,
    form: PlainFormat,
    output: str,
    validation_output: str | None,
    program: str | None,
    report: str | None,
) -> None:
    """Write the files, then the summary on standard output; without a file, the CSV alone."""
    import sys

    from robacc.cli.output import emit
    from robacc.io.files import write_text
    from robacc.render.text.console import warnings_below
    from robacc.render.views.elements import draw
    from robacc.render.views.plan import plan_view

    with warnings_below(result.warnings):
        programs = {} if program is None else result.programs(program)
        if validation_output is not None:
            write_text(validation_output, result.validation_csv())
        for path, text in programs.items():
            write_text(path, text)
        if report is not None:
            from robacc.cli.output import page_of_document

            write_text(report, page_of_document(result.document()))
        if output == "-":
            sys.stdout.write(result.csv())
            sys.stdout.flush()
            return
        result.write(output)
        emit(form, "-", table=lambda stream: draw(plan_view(result.document()), stream), document=result.document)
