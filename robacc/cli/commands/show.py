"""``robacc show``: a robot file or URDF, in mm and degrees."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.options import BaseLinkOption, OutputOption, PlainFormat, PlainFormatOption, TipLinkOption


def show(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML), URDF, or name of an arm.")],
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    form: PlainFormatOption = PlainFormat.table,
    output: OutputOption = "-",
) -> None:
    """Show the chain, joints, limits, reach and masses of a robot file or URDF.

    Example: robacc show robot.yaml
    """
    from robacc.api.inputs import load_robot
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.descriptions import SHOW
    from robacc.effects.specification import coefficients
    from robacc.render.text.console import console_for
    from robacc.render.text.robot import render_robot
    from robacc.robots.library import summarise

    arm, record = load_robot(robot, base_link, tip_link)
    summary = summarise(arm, coefficients(arm))
    options = {"base_link": base_link, "tip_link": tip_link}
    emit(
        form,
        output,
        table=lambda stream: console_for(stream).print(render_robot(summary)),
        document=lambda: results.envelope("show", SHOW.write(summary), options=options, inputs=(record,), seed=None),
    )
