"""``robacc export``: a robot model in the format of a controller, a driver or a simulator."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from robacc.cli.options import BaseLinkOption, TipLinkOption


class ExportFormat(StrEnum):
    """Format of the written model; table and json belong to ``--urdf``."""

    urdf = "urdf"
    mdh = "mdh"
    json = "json"
    ur_calibration = "ur-calibration"
    ur_kinematics = "ur-kinematics"
    xarm = "xarm"
    joint_offsets = "joint-offsets"
    table = "table"


def export(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Robot file (YAML), URDF, or name of an arm.")],
    form: Annotated[
        ExportFormat | None,
        typer.Option("--format", help="Format of the file; with --urdf: form of the summary, table or json."),
    ] = None,
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="FILE", help="File to write; - is standard output.")
    ] = None,
    urdf: Annotated[
        str | None,
        typer.Option(
            "--urdf",
            metavar="FILE",
            help="URDF to write from the numbers as they are, without a fit; - is standard output.",
        ),
    ] = None,
    nominal: Annotated[
        str | None,
        typer.Option("--nominal", metavar="ROBOT", help="joint-offsets: the model that the controller computes with."),
    ] = None,
    arm: Annotated[
        str | None, typer.Option("--arm", metavar="NAME", help="ur-calibration: the arm, such as ur10e.")
    ] = None,
    template: Annotated[
        str | None,
        typer.Option("--template", metavar="FILE", help="ur-…: the arm's own file, whose other lines are kept."),
    ] = None,
    document: Annotated[
        str | None, typer.Option("--document", metavar="FILE", help="JSON result to write, with the remaining error.")
    ] = None,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
) -> None:
    """Write a robot model for a controller, a driver or a simulator, with the error that remains there.

    Example: robacc export robot.yaml --format mdh --output modified.yaml
    """
    from robacc.errors import UsageError

    if urdf is not None:
        if output is not None or nominal or arm or template or document:
            raise UsageError("--urdf names the file to write; the other options belong to --format and --output")
        if form not in (None, ExportFormat.table, ExportFormat.json):
            raise UsageError(f"--urdf writes a URDF, --format {form.value} another file; use --output with --format")
        _write_urdf(model, urdf, form is ExportFormat.json, base_link, tip_link)
        return
    if form is None or form is ExportFormat.table:
        names = ", ".join(f.value for f in ExportFormat if f is not ExportFormat.table)
        raise UsageError(f"name the format of the file with --format: {names}")
    if output is None:
        raise UsageError("name the file to write with --output; - is standard output")
    _write_format(model, form, output, (nominal, arm, template, document), (base_link, tip_link))


def _write_format(
    model: str,
    form: ExportFormat,
    output: str,
    options: tuple[str | None, str | None, str | None, str | None],
    links: tuple[str | None, str | None],
) -> None:
    import sys

    from robacc.api.export import export as run_export
    from robacc.io.files import write_text
    from robacc.render.views.correct import write_export

    nominal, arm, template, document = options
    result = run_export(
        model,
        format=form.value,  # type: ignore[arg-type]
        nominal=nominal,
        arm=arm,
        template=template,
        base_link=links[0],
        tip_link=links[1],
    )
    write_text(output, result.text)
    if document is not None:
        write_text(document, result.to_json())
    write_export(sys.stderr if output == "-" else sys.stdout, result.payload())


def _write_urdf(model: str, urdf: str, is_json: bool, base_link: str | None, tip_link: str | None) -> None:
    """Write a URDF of the model as it stands, with a warning for every part that a URDF cannot represent."""
    import sys

    from robacc.cli.options import PlainFormat
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.export import urdf_payload
    from robacc.errors import UsageError
    from robacc.fitting.parameters import absorb_constants
    from robacc.io.files import sha256_of, write_text
    from robacc.modelling.robot_file import read_robot, robot_path
    from robacc.render.text.console import say_warnings
    from robacc.robots.urdf_writer import robot_to_urdf

    if is_json and urdf == "-":
        raise UsageError("--format json and --urdf - both write to standard output; name a file for --urdf")
    robot = read_robot(model, base_link=base_link, tip_link=tip_link)
    text, losses = robot_to_urdf(absorb_constants(robot))
    if urdf == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        write_text(urdf, text)
    say_warnings(f"a URDF cannot represent {loss}" for loss in losses)
    if is_json:
        payload = urdf_payload(sha256_of(urdf), losses)
        inputs = (results.InputFile.at(model, sha256_of(robot_path(model)), "robot"),)
        options = {"base_link": base_link, "tip_link": tip_link}
        emit(
            PlainFormat.json,
            "-",
            table=lambda stream: None,
            document=lambda: results.envelope("export", payload, options=options, inputs=inputs, seed=None),
        )
