"""``robacc import``: a controller's kinematics as a robot file."""

from __future__ import annotations

from typing import Annotated

import typer


def import_(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE", help="calibration.conf of Universal Robots, a ROS kinematics file, or a JSON export."
        ),
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FILE", help="Robot file to write; - is standard output.")
    ],
    arm: Annotated[
        str | None, typer.Option("--arm", metavar="NAME", help="Arm that a calibration.conf belongs to, such as ur10e.")
    ] = None,
) -> None:
    """Write a robot file from the kinematics of a controller or of its ROS driver.

    Example: robacc import calibration.conf --arm ur10e --output my-ur10e.yaml
    """
    from robacc.api.import_ import import_ as run_import
    from robacc.io.files import write_text
    from robacc.robots.yaml_writer import robot_to_yaml
    from robacc.version import __version__

    robot = run_import(file, arm=arm)
    write_text(output, robot_to_yaml(robot, [f"Written by robacc {__version__} import."]))
