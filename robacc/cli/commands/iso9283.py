"""``robacc iso9283``: pose criteria of ISO 9283 from cycles of commanded poses."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets


def iso9283(
    call: Call,
    *,
    full: Annotated[bool, Help("Table with criteria by pose, conditions, methods and limitations.")] = False,
    outlets: Outlets,
) -> None:
    """Compute the pose criteria of ISO 9283 from cycles of commanded poses.

    The result also lists which conditions of the standard the measurement meets.

    With --robot, the commanded pose is the robot's pose at the commanded joints; without, it is read from the cmd_
    columns. If neither is known, the result has repeatability but no accuracy.

    Example: robacc iso9283 cycles.csv --robot robot.yaml
    """
    from robacc.cli.output import deliver
    from robacc.render.views.accuracy import iso9283_view
    from robacc.render.views.elements import Form, draw

    result, robot = call(), call.keywords["robot"]
    form: Form = "full" if full else "short"
    deliver(outlets, result, lambda stream: draw(iso9283_view(result.payload(), robot, form), stream))
