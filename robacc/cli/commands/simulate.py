"""``robacc simulate``: simulated measurements of a robot with the effects of its file."""

from __future__ import annotations

from robacc.cli.options import Call, CsvOutlets


def simulate(call: Call, *, outlets: CsvOutlets) -> None:
    """Simulate measured poses of a robot with the effects of its file, and write them as a CSV.

    The simulation uses the exact nonlinear model.

    Example: robacc simulate robot.yaml --poses 60 --seed 1 --noise 0.03mm --output simulated.csv
    """
    from robacc.cli.output import emit, write
    from robacc.render.text.console import say_warnings

    outlets.check()
    result = call()
    say_warnings(result.data.warnings)
    write(outlets.output, result.csv_pieces())
    if outlets.format == "json":
        emit("json", "-", table=lambda stream: None, document=result.document)
