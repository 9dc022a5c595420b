"""``robacc init``: a commented robot file and a CSV of poses to start from."""

from __future__ import annotations

import os
from pathlib import PurePath
from typing import Annotated

from robacc.api.parameters import BaseLink, Help, TipLink

_TABLES = frozenset(
    {".csv", ".txt", ".tsv", ".dat", ".asc", ".log", ".json", ".jsonl", ".xlsx", ".xls", ".ods", ".parquet"}
)
"""Ends of names of exports."""


def init(
    source: Annotated[
        str | None,
        Help("URDF, name of an arm, or export of poses; without it, give --joints.", "[FILE]"),
    ] = None,
    *,
    joints: Annotated[int | None, Help("Number of joints of the example arm, without a URDF.", "N")] = None,
    robot: Annotated[str, Help("Robot file to write.", "FILE")] = "robot.yaml",
    poses: Annotated[str, Help("CSV to write.", "FILE")] = "poses.csv",
    columns: Annotated[str, Help("Column map to write for an export of poses.", "FILE")] = "columns.yaml",
    folder: Annotated[str, Help("Folder of the files; created if it does not exist.", "DIR")] = ".",
    force: Annotated[bool, Help("Overwrite existing files.")] = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> None:
    """Write files to start from: a commented robot file and a CSV of poses, or the map of an export.

    The files for an arm or a number of joints are valid. The rows of the CSV are simulated; replace them with your
    measurements.

    For an export of an instrument or robot (CSV, text, workbook), init writes a column map instead: the meaning of each
    column. Correct it, and give it to other commands with --columns.

    --from FILE writes a robot file from the kinematics of a controller, with options of its own: robacc init --from
    --help.

    Example: robacc init --joints 6 --folder my-arm
    """
    from robacc.errors import UsageError
    from robacc.io.files import make_folder, read_text, write_text
    from robacc.modelling.robot_file import read_robot, robot_path
    from robacc.robots.yaml_robot import parse_robot
    from robacc.simulation.templates import poses_template, robot_template, urdf_template

    if (source is None) == (joints is None):
        raise UsageError("give either a file or --joints, the number of joints")
    if source is not None and PurePath(source).suffix.lower() in _TABLES:
        _write_columns(source, os.path.normpath(os.path.join(folder, columns)), folder, force)
        return
    files = os.path.normpath(os.path.join(folder, robot)), os.path.normpath(os.path.join(folder, poses))
    _check_free(files, source, force)
    names = PurePath(files[0]).name, PurePath(files[1]).name
    if source is None:
        if base_link or tip_link:
            raise UsageError("--base-link and --tip-link choose a chain of a URDF, so they need a URDF")
        text = robot_template(joints or 0, *names)
    else:
        model = read_robot(source, base_link=base_link, tip_link=tip_link)
        if (path := robot_path(source)) != source:
            text = read_text(path)
        elif model.convention != "urdf":
            raise UsageError(f"{source} is a robot file already; robacc init needs a URDF")
        else:
            text = urdf_template(model, PurePath(source).name, *names)
    arm = parse_robot(text, files[0])
    table, rows = poses_template(arm, *names)
    make_folder(folder)
    write_text(files[0], text)
    write_text(files[1], table)
    count = len(arm.variables)
    print(
        f"wrote {files[0]} ({count} joint{'s' * (count > 1)}) and {files[1]} ({rows} simulated rows)",
        "next:",
        *([f"  enter the dimensions of your arm in {files[0]}"] if source is None else []),
        f"  robacc show {files[0]}",
        f"  replace the rows of {files[1]} with your measurements",
        f"  robacc estimate {files[1]} --robot {files[0]} --align base_frame,tool_frame",
        sep="\n",
    )


def _write_columns(export: str, path: str, folder: str, force: bool) -> None:
    """Write the column map of an export and print the next steps."""
    from robacc.errors import UsageError
    from robacc.io.files import make_folder, write_text
    from robacc.poses.column_proposal import propose_columns

    proposal = propose_columns(export, PurePath(path).name)
    if os.path.exists(path) and not force:
        raise UsageError(f"{path} exists already; overwrite with --force, or name another file with --columns")
    make_folder(folder)
    write_text(path, proposal.text)
    commands = "" if proposal.has_commands else " --commanded PROGRAM_OR_TABLE"
    print(
        f"wrote {path} (reads {proposal.n_columns} of {proposal.n_named} columns of {export})",
        "next:",
        *([f"  fill in {' and '.join(proposal.open_statements)} in {path}"] if proposal.open_statements else []),
        *(f"  decide in {path}: {question}" for question in proposal.open_columns),
        f"  robacc estimate {export} --columns {path} --robot robot.yaml{commands}",
        sep="\n",
    )


def _check_free(files: tuple[str, str], urdf: str | None, force: bool) -> None:
    from robacc.errors import UsageError

    if os.path.realpath(files[0]) == os.path.realpath(files[1]):
        raise UsageError(f"--robot and --poses both name {files[0]}; name two files")
    for path in files:
        if urdf is not None and os.path.realpath(path) == os.path.realpath(urdf):
            raise UsageError(f"{path} is the URDF and would be overwritten; name another file")
    existing = [path for path in files if os.path.exists(path)]
    if existing and not force:
        verb = "exists" if len(existing) == 1 else "exist"
        raise UsageError(f"{' and '.join(existing)} {verb} already; overwrite with --force, or name another --folder")
