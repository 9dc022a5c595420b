"""``robacc export``: a robot model as URDF."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.options import BaseLinkOption, PlainFormat, PlainFormatOption, TipLinkOption


def export(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Robot file (YAML) or URDF.")],
    urdf: Annotated[
        str,
        typer.Option("--urdf", metavar="FILE", help="URDF to write; - is standard output."),
    ],
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    form: PlainFormatOption = PlainFormat.table,
) -> None:
    """Write a robot model as URDF, with a warning for every part that a URDF cannot represent.

    Example: robacc export robot.yaml --urdf arm.urdf
    """
    import sys

    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.errors import UsageError
    from robacc.fitting.apply_fit import absorb_constants
    from robacc.io.files import sha256_of, write_text
    from robacc.modelling.robot_file import read_robot, robot_path
    from robacc.render.text.console import say_warnings
    from robacc.robots.urdf import robot_to_urdf

    if form is PlainFormat.json and urdf == "-":
        raise UsageError("--format json and --urdf - both write to standard output; name a file for --urdf")
    robot = read_robot(model, base_link=base_link, tip_link=tip_link)
    text, losses = robot_to_urdf(absorb_constants(robot))
    if urdf == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        write_text(urdf, text)
    say_warnings(f"a URDF cannot represent {loss}" for loss in losses)
    if form is PlainFormat.json:
        payload = {"urdf_sha256": sha256_of(urdf), "not_carried": list(losses)}
        inputs = (results.InputFile.at(model, sha256_of(robot_path(model)), "robot"),)
        options = {"base_link": base_link, "tip_link": tip_link}
        emit(
            form,
            "-",
            table=lambda stream: None,
            document=lambda: results.envelope("export", payload, options=options, inputs=inputs, seed=None),
        )
