"""``robacc show``: a robot file or URDF, in mm and degrees."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import BaseLink, Help, TipLink
from robacc.cli.options import PlainOutlets


def show(
    robot: Annotated[str, Help("Robot file (YAML), URDF, or name of an arm.", "ROBOT")],
    *,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    outlets: PlainOutlets,
) -> None:
    """Show a robot file or URDF; or the arms, effects and result schemas that robacc knows.

    In place of a file, robots lists the arms that come with the package, effects the effects or what their names ask
    for, schema NAME the keys of a command's result; robacc show effects --help has their options.

    Example: robacc show robot.yaml
    """
    from robacc.api.inputs import load_robot
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.descriptions import SHOW
    from robacc.effects.specification import coefficients
    from robacc.render.views.elements import draw
    from robacc.render.views.robot import robot_view
    from robacc.robots.library import summarise

    arm, record = load_robot(robot, base_link, tip_link)
    summary = summarise(arm, coefficients(arm))
    emit(
        outlets.form,
        outlets.output,
        table=lambda stream: draw(robot_view(summary), stream),
        document=lambda: results.envelope(
            "show",
            SHOW.write(summary),
            options={"base_link": base_link, "tip_link": tip_link},
            inputs=(record,),
            seed=None,
        ),
    )
