"""``robacc simulate``: simulated measurements of a robot with the effects of its file."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, CsvOutlets, Output, PlainFormat


def simulate(
    call: Call, *, format: Annotated[PlainFormat, Help("Form of the output.")] = "table", output: Output = "-"
) -> None:
    """Simulate measured poses of a robot with the effects of its file, and write them as a CSV.

    The simulation uses the exact nonlinear model.

    Example: robacc simulate robot.yaml --poses 60 --seed 1 --noise 0.03mm --output simulated.csv
    """
    from robacc.cli.output import emit, write
    from robacc.render.text import say_warnings

    CsvOutlets(format, output).check()
    result = call()
    say_warnings(result.data.warnings)
    write(output, result.csv_pieces())
    if format == "json":
        emit("json", "-", table=lambda stream: None, document=result.document)
