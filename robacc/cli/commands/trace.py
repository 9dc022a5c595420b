"""``robacc trace``: find the effects that explain the residual of measured poses."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets, WriteModel


def trace(
    call: Call,
    *,
    write_model: WriteModel = None,
    full: Annotated[bool, Help("Table with candidates, tests, coefficients, errors and detection limits.")] = False,
    outlets: Outlets,
) -> None:
    """Find the effects that explain the residual, and report the error before and after on held-out poses.

    Example: robacc trace poses.csv --robot robot.yaml --write-model better.yaml
    """
    from robacc.cli.output import deliver_fit, progress_bar
    from robacc.render.views.elements import Form, draw
    from robacc.render.views.fit import trace_view

    given = call.keywords
    form: Form = "full" if full else "short"
    with progress_bar() as progress:
        result = call(progress=progress)
    deliver_fit(
        write_model,
        outlets,
        result,
        lambda stream: draw(trace_view(result.payload(), given["poses"], given["robot"], form), stream),
    )
