"""``robacc estimate``: errors of measured poses, their statistics and the grade."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets


def estimate(
    call: Call,
    poses: Annotated[
        list[str],
        Help(
            "Measured poses: CSV, export, workbook, Parquet or ROS bag; - reads standard input.",
            "POSES [POSES …]",
            holds="measured poses",
        ),
    ],
    *,
    per_pose: Annotated[str | None, Help("CSV to write with the error of each pose.", "FILE", holds="output")] = None,
    jobs: Annotated[
        int | None, Help("Number of files processed at the same time; default: number of cores.", "N", least=1)
    ] = None,
    full: Annotated[bool, Help("Table with covariances, principal axes, tests, worst poses and limitations.")] = False,
    outlets: Outlets,
) -> None:
    """Compute the Cartesian error of measured poses, its covariances and the accuracy grade.

    With --robot, the commanded pose is the robot's pose at the commanded joints; without, it is read from the cmd_
    columns. Several files, such as DIR/*.csv, are estimated one by one and shown in one table; an error in one file
    does not stop the others. With --output DIR/ each result becomes a file in that folder.

    Example: robacc estimate poses.csv --robot robot.yaml --align base_frame,tool_frame
    """
    from robacc.api.result import effect_names
    from robacc.cli.output import deliver, table_of

    options = call.keywords
    if options["align"] is not None:
        options["align"] = effect_names(options["align"])
    if len(poses) > 1:
        from robacc.cli.many import estimate_each

        estimate_each(poses, options, outlets, per_pose, jobs, full=full)
        return
    result = call(poses[0])

    if per_pose is not None:
        from robacc.io.files import write_text

        write_text(per_pose, result.per_pose_csv())
    deliver(outlets, result, table_of(result, poses[0], options["robot"], full))
