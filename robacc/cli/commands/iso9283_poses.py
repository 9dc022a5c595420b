"""``robacc iso9283-poses``: the cube of ISO 9283 and its five poses for an arm, as a CSV."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robacc.cli.options import BaseLinkOption, OutputOption, PlainFormat, PlainSummaryFormatOption, TipLinkOption

if TYPE_CHECKING:
    from robacc.iso_9283.cube import Proposal
    from robacc.robots.description import Robot


class PlaneName(StrEnum):
    """Planes of the cube, by the direction in which they rise."""

    x_up = "x+"
    x_down = "x-"
    y_up = "y+"
    y_down = "y-"


class OrientationName(StrEnum):
    """Orientation of the tool."""

    down = "down"
    forward = "forward"
    own = "own"
    free = "free"


def iso9283_poses(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML), URDF, or name of an arm.")],
    edge: Annotated[
        str | None,
        typer.Option(
            "--edge",
            metavar="SIZE",
            help="Edge of the cube, such as 400mm; default: the largest preferred edge that fits.",
        ),
    ] = None,
    plane: Annotated[
        PlaneName | None,
        typer.Option("--plane", help="Direction in which the plane rises; default: farthest from joint limits."),
    ] = None,
    orientation: Annotated[
        OrientationName | None,
        typer.Option(
            "--orientation",
            help="Tool: down, forward, own (as at the centre) or free; default: the first that fits.",
        ),
    ] = None,
    cycles: Annotated[
        int, typer.Option("--cycles", metavar="N", min=1, max=10_000, help="Number of cycles through P1 to P5.")
    ] = 30,
    payload: Annotated[
        float | None, typer.Option("--payload", metavar="KG", min=0.0, help="Payload to write as payload_kg.")
    ] = None,
    target: Annotated[
        str | None, typer.Option("--target", metavar="NAME", help="Target, for a robot with several.")
    ] = None,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    form: PlainSummaryFormatOption = PlainFormat.table,
    output: OutputOption = "-",
) -> None:
    """Plan the cube of ISO 9283 and its five poses for an arm, and write them as a CSV.

    The CSV has pose, cycle, joints and commanded pose. Add the measured x, y, z and orientation, and robacc iso9283
    reads it. With --output, a summary of the plan is written to standard output.

    Example: robacc iso9283-poses robot.yaml --payload 6 --output plan.csv
    """
    import sys

    from robacc.cli.call_checks import refuse_json_beside_csv
    from robacc.io.files import write_text
    from robacc.iso_9283.cube import planned_poses, propose
    from robacc.modelling.robot_file import read_robot
    from robacc.poses.csv_file import format_poses
    from robacc.quantities import size
    from robacc.render.views.iso9283 import proposal_comments

    refuse_json_beside_csv(form, output)
    arm = read_robot(robot, base_link=base_link, tip_link=tip_link)
    proposal = propose(
        arm,
        edge=None if edge is None else size(edge, "length", "--edge"),
        plane=None if plane is None else plane.value,
        orientation=None if orientation is None else orientation.value,
        target=target,
    )
    head = "".join(f"# {line}\n" for line in proposal_comments(proposal, arm.name))
    text = head + format_poses(planned_poses(proposal, cycles, payload), attained=False)
    if output == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    write_text(output, text)
    options = {"edge": edge, "plane": plane, "orientation": orientation, "target": target}
    _write_summary(proposal, arm, robot, output, form, {**options, "cycles": cycles, "payload": payload})


def _write_summary(
    proposal: Proposal, arm: Robot, robot: str, output: str, form: PlainFormat, options: Mapping[str, Any]
) -> None:
    """Write a summary of the plan to standard output."""
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.iso9283 import ISO9283_POSES
    from robacc.io.files import sha256_of
    from robacc.modelling.robot_file import robot_path
    from robacc.render.views.elements import draw
    from robacc.render.views.iso9283 import proposal_view

    inputs = (results.InputFile.at(robot, sha256_of(robot_path(robot)), "robot"),)
    payload = ISO9283_POSES.write(proposal, file_sha256=sha256_of(output))
    emit(
        form,
        "-",
        table=lambda stream: draw(proposal_view(proposal, arm), stream),
        document=lambda: results.envelope("iso9283-poses", payload, options=options, inputs=inputs, seed=None),
    )
