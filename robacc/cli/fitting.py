"""What `calibrate` and `trace` have in common on the command line: loading, options, and the model they write."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from robacc.errors import UsageError

if TYPE_CHECKING:
    from robacc.measurements import Measurements
    from robacc.results import InputFile
    from robacc.robots.description import Robot

NeededRobotOption = Annotated[
    str, typer.Option("--robot", metavar="FILE", help="Robot file (YAML) or URDF that commanded the poses.")
]
WriteModelOption = Annotated[
    str | None,
    typer.Option("--write-model", metavar="FILE", help="Write the robot file that predicts what was fitted."),
]
HoldoutOption = Annotated[
    str | None, typer.Option("--holdout", metavar="FILE", help="Poses of their own to judge on, instead of folds.")
]
FoldsOption = Annotated[
    int, typer.Option("--folds", metavar="K", min=2, max=50, help="Folds of cross-fitting: poses held out in turn.")
]


def load(
    poses: str,
    robot: str,
    holdout: str | None,
    ordered: bool,
    base_link: str | None,
    tip_link: str | None,
) -> tuple[Robot, Measurements, Measurements | None, tuple[InputFile, ...]]:
    """The robot, the poses measured on it, those held out, and the record of the files."""
    from robacc.io.files import sha256_of
    from robacc.io.robot_file import read_robot
    from robacc.io.robot_poses import read_robot_poses
    from robacc.results import InputFile

    arm = read_robot(robot, base_link=base_link, tip_link=tip_link)

    def read(path: str) -> Measurements:
        data = read_robot_poses(path, arm, ordered=ordered)
        if data.q is None:
            raise UsageError(f"{path} has no joint columns q1 … q{len(arm.variables)}, which a fit needs")
        return data

    data = read(poses)
    apart = None if holdout is None else read(holdout)
    inputs = [
        InputFile.at(poses, data.sha256 or "", "poses"),
        InputFile.at(robot, sha256_of(robot), "robot"),
    ]
    if apart is not None and holdout is not None:
        inputs.append(InputFile.at(holdout, apart.sha256 or "", "holdout"))
    return arm, data, apart, tuple(inputs)


def model_text(robot: Robot, command: str, poses: str) -> str:
    """The written model: a robot file whose first lines say where it is from."""
    from pathlib import PurePath

    from robacc.version import __version__
    from robacc.robots.yamlspec import robot_to_yaml

    return robot_to_yaml(robot, (f"written by robacc {__version__} {command} from {PurePath(poses).name}",))
