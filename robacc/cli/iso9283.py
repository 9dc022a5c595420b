"""``robacc iso9283``: cycles of commanded poses in, the pose criteria of ISO 9283 out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from robacc.cli.options import (
    BaseLinkOption,
    ConfidenceOption,
    Format,
    FormatOption,
    GateOption,
    JunitOption,
    OrderedOption,
    OutputOption,
    ReportOption,
    RobotOption,
    SeedOption,
    TipLinkOption,
    split_list,
)
from robacc.results import InputFile

if TYPE_CHECKING:
    from robacc.measurements import Measurements
    from robacc.robots.description import Robot


def iso9283(
    poses: Annotated[
        list[str],
        typer.Argument(
            metavar="POSES [POSES …]", help="CSV of measured poses, one file a robot; - reads standard input."
        ),
    ],
    robot: RobotOption = None,
    align: Annotated[
        str | None,
        typer.Option(
            "--align", metavar="EFFECT,…", help="Fit base_frame, tool_frame or both to each file's poses first."
        ),
    ] = None,
    rated_load: Annotated[
        float | None, typer.Option("--rated-load", metavar="KG", help="What payload_kg is held against.")
    ] = None,
    drift_windows: Annotated[
        int | None,
        typer.Option(
            "--drift-windows", metavar="N", help="Parts of the run that are compared; default: of ten visits."
        ),
    ] = None,
    confidence: ConfidenceOption = 0.95,
    ordered: OrderedOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    seed: SeedOption = 0,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
) -> None:
    """The pose criteria of ISO 9283 that cycles of commanded poses can support, and which of its conditions they meet.

    The commanded pose is the robot's own at the commanded joints where --robot is given, else the file's cmd_ columns;
    with neither there is repeatability, and no accuracy. Several files are several robots.
    """
    from robacc.cli.output import Outlets, deliver
    from robacc.iso_9283.evaluation import iso9283 as evaluated

    arm, files, inputs = _load(poses, robot, base_link, tip_link, ordered)
    found = evaluated(
        files,
        arm,
        what=split_list(align),
        confidence=confidence,
        seed=seed,
        windows=drift_windows,
        rated_load=rated_load,
    )

    def table(stream: TextIO) -> None:
        from robacc.report.iso9283 import draw_iso9283

        draw_iso9283(found, robot, stream)

    def payload() -> dict[str, Any]:
        from robacc.io.iso9283_json import payload as document

        return document(found)

    deliver(
        Outlets(form, output, gate, junit, report),
        "iso9283",
        payload=payload,
        table=table,
        options={
            "align": list(split_list(align)),
            "rated_load": rated_load,
            "drift_windows": drift_windows,
            "confidence": confidence,
            "ordered": ordered,
            "base_link": base_link,
            "tip_link": tip_link,
        },
        inputs=inputs,
        seed=seed,
        warnings=found.warnings,
    )


def _load(
    paths: list[str], robot: str | None, base_link: str | None, tip_link: str | None, ordered: bool
) -> tuple[Robot | None, list[Measurements], tuple[InputFile, ...]]:
    """The robot, where one is named, every file read for it, and the records of all."""
    from robacc.errors import UsageError
    from robacc.io.files import sha256_of
    from robacc.io.poses_csv import read_poses

    if robot is None and (base_link or tip_link):
        raise UsageError("--base-link and --tip-link choose a chain of the URDF that --robot names")
    if paths.count("-") > 1:
        raise UsageError("standard input can be read once: - is given more than once")
    if robot is None:
        files = [read_poses(path, ordered=ordered) for path in paths]
        return None, files, tuple(_records(paths, files))
    from robacc.io.robot_file import read_robot

    arm = read_robot(robot, base_link=base_link, tip_link=tip_link)
    files = [
        read_poses(
            path,
            joint_names=arm.variable_names,
            joint_types=[joint.type for joint in arm.variables],
            limits=[joint.limits for joint in arm.variables],
            target_names=tuple(arm.targets),
            ordered=ordered,
        )
        for path in paths
    ]
    return arm, files, (*_records(paths, files), InputFile.at(robot, sha256_of(robot), "robot"))


def _records(paths: Sequence[str], files: Sequence[Measurements]) -> list[InputFile]:
    return [InputFile.at(path, data.sha256 or "", "poses") for path, data in zip(paths, files, strict=True)]
