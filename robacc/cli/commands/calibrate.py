"""``robacc calibrate``: fit named effects to measured poses."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets, WriteModel


def calibrate(
    call: Call,
    *,
    write_model: WriteModel = None,
    full: Annotated[bool, Help("Table with coefficients, errors before and after, and quality of the fit.")] = False,
    outlets: Outlets,
) -> None:
    """Fit named effects to measured poses, and report fitted and held-out errors before and after.

    An effect with joints in brackets is fitted to these joints. Without brackets it is fitted to the joints where the
    data show it.

    Example: robacc calibrate poses.csv --robot robot.yaml --fit base_frame,tool_frame --write-model better.yaml
    """
    from robacc.cli.output import deliver_fit

    deliver_fit(call, write_model, outlets, full)
