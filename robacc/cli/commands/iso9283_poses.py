"""``robacc plan --for iso9283``: the cube of ISO 9283 and its five poses for an arm."""

from __future__ import annotations

from typing import Annotated, Literal

from robacc.api.parameters import BaseLink, Help, TipLink
from robacc.cli.options import CsvOutlets


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
    """Plan the cube of ISO 9283 and its five poses for an arm.

    The CSV of --output has pose, cycle, joints and commanded pose. Add the measured x, y, z and orientation, and
    robacc iso9283 reads it.

    Example: robacc plan robot.yaml --for iso9283 --payload 6 --output plan.csv
    """
    from hashlib import sha256

    from robacc.api.inputs import load_robot
    from robacc.cli.output import write_plan
    from robacc.documents.envelope import envelope
    from robacc.documents.iso9283 import ISO9283_POSES
    from robacc.iso_9283.cube import planned_poses, propose
    from robacc.poses.csv_file import format_poses
    from robacc.quantities import optional_size
    from robacc.render.views.elements import draw
    from robacc.render.views.iso9283 import proposal_comments, proposal_view

    outlets.check()
    options = {
        "edge": edge,
        "plane": plane,
        "orientation": orientation,
        "target": target,
        "cycles": cycles,
        "payload": payload,
    }
    arm, record = load_robot(robot, base_link, tip_link)
    proposal = propose(
        arm, edge=optional_size(edge, "length", "--edge"), plane=plane, orientation=orientation, target=target
    )
    head = "".join(f"# {line}\n" for line in proposal_comments(proposal, arm.name))
    text = head + format_poses(planned_poses(proposal, cycles, payload), attained=False)
    keys = ISO9283_POSES.write(proposal, file_sha256=sha256(text.encode()).hexdigest())
    write_plan(
        outlets,
        text,
        lambda stream: draw(proposal_view(proposal, arm), stream),
        lambda: envelope("iso9283-poses", keys, options=options, inputs=(record,), seed=None),
    )
