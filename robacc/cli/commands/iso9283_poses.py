"""``robacc iso9283-poses``: the cube of ISO 9283 and its five poses for an arm, as a CSV."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from robacc.api.parameters import BaseLink, Help, TipLink
from robacc.cli.options import CsvOutlets

if TYPE_CHECKING:
    from robacc.iso_9283.cube import Proposal
    from robacc.robots.description import Robot


def iso9283_poses(
    robot: Annotated[str, Help("Robot file (YAML), URDF, or name of an arm.", "ROBOT")],
    *,
    edge: Annotated[
        str | None,
        Help("Edge of the cube, such as 400mm; default: the largest preferred edge that fits.", "SIZE"),
    ] = None,
    plane: Annotated[
        Literal["x+", "x-", "y+", "y-"] | None,
        Help("Direction in which the plane rises; default: farthest from joint limits."),
    ] = None,
    orientation: Annotated[
        Literal["down", "forward", "own", "free"] | None,
        Help("Tool: down, forward, own (as at the centre) or free; default: the first that fits."),
    ] = None,
    cycles: Annotated[int, Help("Number of cycles through P1 to P5.", "N", least=1, most=10_000)] = 30,
    payload: Annotated[float | None, Help("Payload to write as payload_kg.", "KG", least=0.0)] = None,
    target: Annotated[str | None, Help("Target, for a robot with several.", "NAME")] = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    outlets: CsvOutlets,
) -> None:
    """Plan the cube of ISO 9283 and its five poses for an arm, and write them as a CSV.

    The CSV has pose, cycle, joints and commanded pose. Add the measured x, y, z and orientation, and robacc iso9283
    reads it. With --output, a summary of the plan is written to standard output.

    Example: robacc iso9283-poses robot.yaml --payload 6 --output plan.csv
    """
    from robacc.cli.output import write
    from robacc.iso_9283.cube import planned_poses, propose
    from robacc.modelling.robot_file import read_robot
    from robacc.poses.csv_file import format_poses
    from robacc.quantities import size
    from robacc.render.views.iso9283 import proposal_comments

    outlets.check()
    arm = read_robot(robot, base_link=base_link, tip_link=tip_link)
    proposal = propose(
        arm,
        edge=None if edge is None else size(edge, "length", "--edge"),
        plane=plane,
        orientation=orientation,
        target=target,
    )
    head = "".join(f"# {line}\n" for line in proposal_comments(proposal, arm.name))
    text = head + format_poses(planned_poses(proposal, cycles, payload), attained=False)
    write(outlets.output, (text,))
    if outlets.output == "-":
        return
    options = {"edge": edge, "plane": plane, "orientation": orientation, "target": target}
    _write_summary(proposal, arm, robot, outlets, {**options, "cycles": cycles, "payload": payload})


def _write_summary(proposal: Proposal, arm: Robot, robot: str, outlets: CsvOutlets, options: Mapping[str, Any]) -> None:
    """Write a summary of the plan to standard output."""
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.iso9283 import ISO9283_POSES
    from robacc.io.files import sha256_of
    from robacc.modelling.robot_file import robot_path
    from robacc.render.views.elements import draw
    from robacc.render.views.iso9283 import proposal_view

    inputs = (results.InputFile.at(robot, sha256_of(robot_path(robot)), "robot"),)
    payload = ISO9283_POSES.write(proposal, file_sha256=sha256_of(outlets.output))
    emit(
        outlets.format,
        "-",
        table=lambda stream: draw(proposal_view(proposal, arm), stream),
        document=lambda: results.envelope("iso9283-poses", payload, options=options, inputs=inputs, seed=None),
    )
