"""``robacc init``: a robot file and a CSV of poses to begin with, commented, and valid as they are."""

from __future__ import annotations

import os
from pathlib import PurePath
from typing import Annotated

import typer

from robacc.cli.options import BaseLinkOption, TipLinkOption


def init(
    source: Annotated[
        str | None, typer.Argument(metavar="[URDF]", help="The arm's URDF; without one say how many --joints.")
    ] = None,
    joints: Annotated[
        int | None, typer.Option("--joints", metavar="N", help="Joints of an example arm to put your numbers into.")
    ] = None,
    robot: Annotated[str, typer.Option("--robot", metavar="FILE", help="The robot file to write.")] = "robot.yaml",
    poses: Annotated[str, typer.Option("--poses", metavar="FILE", help="The CSV to write.")] = "poses.csv",
    folder: Annotated[
        str, typer.Option("--folder", metavar="DIR", help="Folder for both, made where there is none.")
    ] = ".",
    force: Annotated[bool, typer.Option("--force", help="Write over files that are there.")] = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
) -> None:
    """A robot file and a CSV of measured poses to begin with, commented, from a URDF or a number of joints.

    Both are valid as they are; the CSV's rows are made up, for yours to take their place.

    Example: robacc init --joints 6 --folder my-arm
    """
    from robacc.errors import UsageError
    from robacc.io.files import make_folder, write_text
    from robacc.modelling.robot_file import read_robot
    from robacc.robots.yaml_robot import parse_robot
    from robacc.simulation.templates import poses_template, robot_template, urdf_template

    if (source is None) == (joints is None):
        raise UsageError("give either a URDF or --joints, how many joints the arm has")
    files = os.path.normpath(os.path.join(folder, robot)), os.path.normpath(os.path.join(folder, poses))
    _check_free(files, source, force)
    names = PurePath(files[0]).name, PurePath(files[1]).name
    if source is None:
        if base_link or tip_link:
            raise UsageError("--base-link and --tip-link choose a chain of a URDF")
        text = robot_template(joints or 0, *names)
    else:
        arm = read_robot(source, base_link=base_link, tip_link=tip_link)
        if arm.convention != "urdf":
            raise UsageError(f"{source} is a robot file already; init makes one from a URDF")
        text = urdf_template(arm, PurePath(source).name, *names)
    described = parse_robot(text, files[0])
    table, rows = poses_template(described, *names)
    make_folder(folder)
    write_text(files[0], text)
    write_text(files[1], table)
    count = len(described.variables)
    print(f"wrote {files[0]} ({count} joint{'s' * (count > 1)}) and {files[1]} ({rows} rows, made up)")
    print("next:")
    if source is None:
        print(f"  put your arm's numbers into {files[0]}")
    print(f"  robacc show {files[0]}")
    print(f"  put what you measured into {files[1]}, in the place of its rows")
    print(f"  robacc estimate {files[1]} --robot {files[0]} --align base_frame,tool_frame")


def _check_free(files: tuple[str, str], urdf: str | None, force: bool) -> None:
    from robacc.errors import UsageError

    if os.path.realpath(files[0]) == os.path.realpath(files[1]):
        raise UsageError(f"--robot and --poses both name {files[0]}; name two files")
    for path in files:
        if urdf is not None and os.path.realpath(path) == os.path.realpath(urdf):
            raise UsageError(f"{path} is the URDF, and would be overwritten; name another file")
    there = [path for path in files if os.path.exists(path)]
    if there and not force:
        verb = "exists" if len(there) == 1 else "exist"
        raise UsageError(f"{' and '.join(there)} {verb} already; --force writes over, --folder names another place")
