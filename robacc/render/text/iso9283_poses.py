"""The cube of ISO 9283 and its five poses, as comments of their CSV and as a table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TextIO

from robacc.iso_9283.proposal import Proposal
from robacc.render.text.console import width_of, write_lines
from robacc.render.text.layout import BLANK, TextLine, columns, heading, items
from robacc.render.text.numbers import fixed
from robacc.render.text.units import IN_DEGREES, IN_MM
from robacc.robots.description import Robot


def proposal_comments(proposal: Proposal, robot: str) -> list[str]:
    """Return the comment lines above the columns: cube, plane and tool orientation."""
    return [
        f"Test poses of ISO 9283:1998, 6.8, for {robot}: planned poses, not measured.",
        *_facts(proposal),
        *proposal.notes,
    ]


def draw_proposal(proposal: Proposal, robot: Robot, stream: TextIO) -> None:
    """Write the tables of the five poses to ``stream``."""
    write_lines(proposal_lines(proposal, robot, width_of(stream)), stream)


def proposal_lines(proposal: Proposal, robot: Robot, width: int) -> Iterator[TextLine]:
    """Return the cube, the commanded poses in the measuring frame and the joints, in mm and degrees."""
    yield heading(f"Test poses of ISO 9283:1998 for {robot.name}")
    yield from items(_facts(proposal), width)
    units = ["°" if joint.type == "revolute" else "mm" for joint in robot.variables]
    factors = [IN_DEGREES if unit == "°" else IN_MM for unit in units]
    places = proposal.poses.translation * IN_MM
    rows = [(f"P{i + 1}", *(fixed(float(value), 2) for value in places[:, i])) for i in range(5)]
    yield from (BLANK, *columns(("commanded, mm", "x", "y", "z"), rows), BLANK)
    names = [f"{name}, {unit}" for name, unit in zip(robot.variable_names, units, strict=True)]
    joints = [
        (f"P{i + 1}", *(fixed(float(q) * factor, 3) for q, factor in zip(proposal.q[:, i], factors, strict=True)))
        for i in range(5)
    ]
    yield from columns(("joints", *names), joints)
    if proposal.notes:
        yield from (BLANK, heading("Limitations"), *items(proposal.notes, width))


def _facts(proposal: Proposal) -> list[str]:
    x, y, z = (float(value) * IN_MM for value in proposal.centre)
    edge = proposal.edge * IN_MM
    return [
        f"cube with an edge of {edge:g} mm and its centre P1 at x {x:.0f}, y {y:.0f}, z {z:.0f} mm in the base frame",
        f"P2 to P5 at 10 % of the diagonal from the corners, in the plane inclined at 45° towards {proposal.plane}",
        f"{proposal.orientation_text}; every joint keeps at least {100.0 * proposal.margin:.0f} % of its range to "
        "each limit",
    ]
