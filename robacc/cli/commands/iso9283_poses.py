"""``robacc plan --for iso9283``: the cube of ISO 9283 and its five poses for an arm."""

from __future__ import annotations

from robacc.cli.options import Call, CsvOutlets


def iso9283_poses(call: Call, *, outlets: CsvOutlets) -> None:
    """Plan the cube of ISO 9283 and its five poses for an arm.

    The CSV of --output has pose, cycle, joints and commanded pose. Add the measured x, y, z and orientation, and
    robacc iso9283 reads it.

    Example: robacc plan robot.yaml --for iso9283 --payload 6 --output plan.csv
    """
    from robacc.cli.output import write_plan

    outlets.check()
    result = call()
    write_plan(outlets, result.csv(), result.draw, result.document)
