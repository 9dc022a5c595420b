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
    from robacc.cli.output import deliver_fit

    deliver_fit(call, write_model, outlets, full)
