"""``robacc correct``: commands that make the real arm reach its targets, from a model of the arm."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robacc.cli.options import (
    BaseLinkOption,
    CampaignUseName,
    Format,
    GateOption,
    JunitOption,
    OutputOption,
    ReportOption,
    ScaleOption,
    SummaryFormatOption,
    TipLinkOption,
)

if TYPE_CHECKING:
    from robacc.api.correct import Corrected
    from robacc.cli.output import Outlets


class TargetFrame(StrEnum):
    """Frame of Cartesian targets."""

    measuring = "measuring"
    base = "base"


def correct(
    targets: Annotated[
        str,
        typer.Argument(
            metavar="TARGETS", help="CSV of targets: joints, or wanted poses as cmd_ columns; or a robot program."
        ),
    ],
    model: Annotated[
        str, typer.Option("--model", metavar="FILE", help="Robot file of the real arm, as --write-model writes it.")
    ],
    nominal: Annotated[
        str | None,
        typer.Option(
            "--nominal",
            metavar="FILE",
            help="Robot file that the controller computes with; default: the robot that the model was fitted from.",
        ),
    ] = None,
    frame: Annotated[
        TargetFrame,
        typer.Option("--frame", help="Frame of Cartesian targets: measuring frame, or the robot's base."),
    ] = TargetFrame.measuring,
    ordered: Annotated[
        bool,
        typer.Option("--ordered/--unordered", help="The arm drives from target to target in their order."),
    ] = True,
    payload: Annotated[
        float | None, typer.Option("--payload", metavar="KG", min=0.0, help="Payload of all targets.")
    ] = None,
    temperature: Annotated[
        float | None, typer.Option("--temperature", metavar="C", help="Temperature of all targets.")
    ] = None,
    time: Annotated[float | None, typer.Option("--time", metavar="S", help="Time of all targets.")] = None,
    most: Annotated[
        str | None,
        typer.Option(
            "--most",
            metavar="SIZE[,ANGLE]",
            help="Largest correction, such as 3mm,0.5deg; default: twice the largest on the poses of the fit.",
        ),
    ] = None,
    weight: Annotated[
        str,
        typer.Option(
            "--weight", metavar="SIZE", help="Length that counts as much as 1 rad for arms with fewer than six axes."
        ),
    ] = "10mm",
    beyond_range: Annotated[
        bool,
        typer.Option("--beyond-range", help="Also correct targets outside the ranges that the model was fitted on."),
    ] = False,
    campaign: Annotated[
        CampaignUseName,
        typer.Option(
            "--campaign",
            help="Effects of the campaign of the fit: auto applies its steps, keep its warm-up too, drop neither.",
        ),
    ] = CampaignUseName.auto,
    strict_range: Annotated[
        bool,
        typer.Option("--strict-range", help="Refuse all targets if one is outside the range of the model (exit 3)."),
    ] = False,
    scale: ScaleOption = None,
    per_target: Annotated[
        str | None,
        typer.Option("--per-target", metavar="FILE", help="CSV of commands, corrections and expected errors."),
    ] = None,
    frames: Annotated[
        list[str] | None,
        typer.Option("--frames", metavar="FILE", help="Tools and bases that a program only names; may be repeated."),
    ] = None,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
    form: SummaryFormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Compute the commands that make the real arm reach its targets, from a model of the arm.

    A robot program (KUKA .src, .dat, ABB .mod, FANUC .ls, URScript .script, Staubli .dtx) becomes the same program with
    other numbers in its targets, in the frames of the program. The CSV has the joints to command, and the wanted poses
    as cmd_ columns. With --output, the corrections and the expected errors are written to standard output. A target
    that cannot be corrected keeps its nominal command.

    Example: robacc correct targets.csv --model model.yaml --nominal robot.yaml --output corrected.csv
    """
    from robacc.api.correct import correct as run_correct
    from robacc.cli.output import Outlets
    from robacc.errors import UsageError
    from robacc.io.files import write_text
    from robacc.poses.reading import AS_NAMED, reading_of
    from robacc.programs.reading import is_program

    options: dict[str, Any] = {
        "ordered": ordered,
        "payload": payload,
        "temperature": temperature,
        "time": time,
        "most": most,
        "weight": weight,
        "beyond_range": beyond_range,
        "campaign": campaign.value,
        "strict_range": strict_range,
        "scale": scale,
    }
    outlets = Outlets(form, "-", gate, junit, report)
    if is_program(targets):
        if output == "-" or outlets != Outlets(Format.table, "-") or per_target or frame is TargetFrame.base:
            raise UsageError(
                "a program needs --output, and takes no --format, --gate, --report, --per-target and --frame"
            )
        if reading_of(targets) != AS_NAMED:
            raise UsageError(
                "a program states its own units and angles; leave out --angles, --units, --columns, --skip-gaps and "
                "--sheet"
            )
        _correct_program(targets, model, nominal, frames or [], output, options)
        return
    if frames:
        raise UsageError("--frames belongs to a robot program")
    if output == "-" and outlets != Outlets(Format.table, "-"):
        raise UsageError("--format json, --gate, --junit and --report need --output, the CSV that they describe")
    result = run_correct(
        targets,
        model=model,
        nominal=nominal,
        frame=frame.value,
        base_link=base_link,
        tip_link=tip_link,
        **options,
    )
    if per_target is not None:
        write_text(per_target, result.per_target_csv())
    _deliver(result, (targets, model), output, outlets)


def _deliver(result: Corrected, names: tuple[str, str], output: str, outlets: Outlets) -> None:
    """Write the corrected targets, and the result unless the targets go to standard output."""
    import sys

    from robacc.cli.output import deliver
    from robacc.render.text.console import warnings_below
    from robacc.render.views.correct import correction_view
    from robacc.render.views.elements import draw

    if output == "-":
        with warnings_below(result.warnings):
            sys.stdout.writelines(result.csv_pieces())
            sys.stdout.flush()
        return
    result.write(output)
    deliver(outlets, result, lambda stream: draw(correction_view(result.payload(), names), stream))


def _correct_program(
    path: str, model: str, nominal: str | None, frames: list[str], output: str, options: dict[str, Any]
) -> None:
    """Write a program with corrected targets, and one line for what was corrected."""
    from robacc.api.correct import correct_program
    from robacc.io.files import write_bytes
    from robacc.render.text.console import warnings_below

    result = correct_program(path, model=model, nominal=nominal, frames=frames, **options)
    with warnings_below(result.warnings):
        write_bytes(output, result.data)
        print(f"{result.n_corrected} of {len(result.program.targets)} targets corrected in {output}", flush=True)
