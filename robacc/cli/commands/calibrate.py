"""``robacc calibrate``: fit named effects to measured poses."""

from __future__ import annotations

from robacc.cli.options import Call, Outlets, WriteModel


def calibrate(call: Call, *, write_model: WriteModel = None, outlets: Outlets) -> None:
    """Fit named effects to measured poses, and report fitted and held-out errors before and after.

    An effect with joints in brackets is fitted to these joints. Without brackets it is fitted to the joints where the
    data show it.

    Example: robacc calibrate poses.csv --robot robot.yaml --fit base_frame,tool_frame --write-model better.yaml
    """
    from robacc.cli.output import deliver_fit, progress_bar
    from robacc.render.views.elements import draw
    from robacc.render.views.fit import calibration_view

    given = call.keywords
    with progress_bar() as progress:
        result = call(progress=progress)
    deliver_fit(
        write_model,
        outlets,
        result,
        lambda stream: draw(
            calibration_view(result.payload(), given["poses"], given["robot"], given["fit"], "full"), stream
        ),
    )
