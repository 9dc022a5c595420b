"""Call of the command ``robacc plan --for iso9283``."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Annotated, Any, ClassVar, Literal, TextIO

from robacc.api.inputs import load_robot
from robacc.api.parameters import BaseLink, Help, RobotArgument, TipLink, call
from robacc.api.result import Provenance, Result, options_of
from robacc.iso_9283.cube import Proposal, planned_poses, propose
from robacc.poses.csv_file import format_poses
from robacc.quantities import optional_size
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283Poses(Result):
    """Cube and five poses of ISO 9283 for an arm, and the cycles to drive."""

    command: ClassVar[str] = "iso9283-poses"
    proposal: Proposal
    robot: Robot
    cycles: int
    payload_kg: float | None
    made: Provenance
    warnings: tuple[str, ...] = ()

    def csv(self) -> str:
        """Return the CSV of the visits: pose, cycle, joints and commanded pose, without measured columns."""
        from robacc.render.views.robot import proposal_comments

        head = "".join(f"# {line}\n" for line in proposal_comments(self.proposal, self.robot.name))
        return head + format_poses(planned_poses(self.proposal, self.cycles, self.payload_kg), attained=False)

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.accuracy import ISO9283_POSES

        return ISO9283_POSES.write(self.proposal, file_sha256=sha256(self.csv().encode()).hexdigest())

    def draw(self, stream: TextIO) -> None:
        """Write the cube, the commanded poses and the joints."""
        from robacc.render.views.elements import draw
        from robacc.render.views.robot import proposal_view

        draw(proposal_view(self.proposal, self.robot), stream)


@call
def iso9283_poses(
    robot: RobotArgument,
    *,
    edge: Annotated[
        float | str | None,
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
) -> Iso9283Poses:
    """Plan the cube of ISO 9283 and its five poses for an arm.

    Returns:
        The cube, the commanded poses and joints, and the CSV of the cycles to drive.

    Raises:
        InputError: The robot cannot be used, or no cube fits.
        UsageError: The robot has no such target, or the edge is not a length above zero.

    Example:
        >>> import robacc
        >>> plan = robacc.iso9283_poses("sample_data/iso9283/robot.yaml", edge="400mm")
        >>> f"{plan.proposal.edge * 1e3:.0f} mm, {plan.csv().count('P1,')} visits of P1"
        '400 mm, 30 visits of P1'
    """
    arguments = locals()
    arm, record = load_robot(robot, base_link, tip_link)
    length = optional_size(edge, "length", "`edge`")
    proposal = propose(arm, edge=length, plane=plane, orientation=orientation, target=target)
    made = Provenance(options_of(iso9283_poses, arguments), (record,), None)
    return Iso9283Poses(proposal=proposal, robot=arm, cycles=cycles, payload_kg=payload, made=made)
