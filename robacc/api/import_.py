"""Call of ``robacc init --from``."""

from __future__ import annotations

import os
from typing import Annotated

from robacc.api.parameters import Help, StrPath, call
from robacc.robots.description import Robot


@call
def import_(
    file: Annotated[
        StrPath,
        Help("calibration.conf of Universal Robots, a ROS kinematics file, or a JSON export.", "FILE"),
    ],
    *,
    arm: Annotated[str | None, Help("Arm that a calibration.conf belongs to, such as ur10e.", "NAME")] = None,
) -> Robot:
    """Read a robot from the kinematics file of a controller or of its ROS driver.

    Returns:
        The robot; :func:`robacc.write_robot` writes it as a robot file.

    Raises:
        InputError: The file cannot be read, or is none of these formats.
        UsageError: The arm is unknown.

    Example:
        >>> import pathlib, tempfile
        >>> import robacc
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "model.json"
        >>> robacc.export("sample_data/robot.yaml", format="json").write(path)
        >>> robacc.import_(path).variable_names == robacc.read_robot("sample_data/robot.yaml").variable_names
        True
    """
    from robacc.controllers import parse_controller_file
    from robacc.io.files import read_text

    path = os.fspath(file)
    return parse_controller_file(read_text(path), "<stdin>" if path == "-" else path, arm)
