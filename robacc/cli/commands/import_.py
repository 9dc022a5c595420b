"""``robacc init --from``: a controller's kinematics as a robot file."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call


def import_(
    call: Call,
    *,
    output: Annotated[
        str, Help("Robot file to write; - is standard output.", "FILE", names=("output", "o"), holds="output")
    ],
) -> None:
    """Write a robot file from the kinematics of a controller or of its ROS driver.

    Example: robacc init --from calibration.conf --arm ur10e --output ur10e.yaml
    """
    from robacc.io.files import write_text
    from robacc.robots.yaml_robot import robot_to_yaml
    from robacc.version import __version__

    write_text(output, robot_to_yaml(call(), [f"Written by robacc {__version__} import."]))
