"""Parameters with errors and their standard deviations, from the robot file and from a tolerance file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from robacc.chain import BASE, TOOL
from robacc.errors import InputError, Problem
from robacc.robots.arm import Arm
from robacc.robots.assembly import TURN_OF_ANGLE
from robacc.robots.description import DH_PARAMETERS, LENGTH_PARAMETERS, ORIGIN_PARAMETERS, Joint, Robot

Distribution = Literal["normal", "uniform", "limits"]

FRAME_PARAMETERS = ("x", "y", "z", "roll", "pitch", "yaw")

_COMPONENTS = {
    **{"theta": "theta", "d": "d", "a": "a", "alpha": "alpha", "beta": "alpha", "offset": "offset"},
    **dict.fromkeys(("x", "y", "z"), "origin_length"),
    **dict.fromkeys(("roll", "pitch", "yaw"), "origin_angle"),
}
"""Variance component of each parameter of a joint; beta tilts an axis as alpha does."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Tolerances of a tolerance file, as standard deviations in m and rad; they replace those of the robot file."""

    distribution: Distribution
    coverage: float
    """For ``limits``: number of standard deviations of a limit."""
    moving_joints: Mapping[str, float] = field(default_factory=dict)
    """Tolerances of every moving joint."""
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    base: Mapping[str, float] = field(default_factory=dict)
    tool: Mapping[str, float] = field(default_factory=dict)

    @property
    def meaning(self) -> str:
        """Conversion of a tolerance into a variance, as text."""
        if self.distribution == "uniform":
            return "uniform: a tolerance t is the half width, variance t²/3"
        if self.distribution == "limits":
            c = f"{self.coverage:g}"
            return f"limits: a tolerance t is {c} standard deviations, variance (t/{c})²"
        return NORMAL


NORMAL = "normal: a tolerance t is one standard deviation, variance t²"


@dataclass(frozen=True, slots=True)
class ToleranceParameter:
    """One parameter of the arm that has an error."""

    name: str
    """``j1.theta``, ``base.x`` …; unique."""
    joint: str | None
    """Name of the joint; None for the base and the tool."""
    kind: str
    """``theta``, ``d`` …; a coordinate of a URDF joint's origin; a coordinate of base or tool."""
    component: str
    """Variance component of the parameter."""
    motion: int
    """Index of the chain's motion."""
    unit: str
    sd: float
    """Standard deviation, m or rad; above zero."""


def uncertain_parameters(robot: Robot, tolerances: Tolerances | None = None) -> tuple[ToleranceParameter, ...]:
    """Return every parameter with a standard deviation above zero: base, joints in order, tool.

    Args:
        robot: The arm; its tolerances are standard deviations.
        tolerances: Replace the robot file, parameter by parameter: ``joints`` first, then ``moving_joints``.

    Raises:
        InputError: No parameter has a tolerance.
    """
    resolved = tolerances or Tolerances("normal", 1.0)
    arm = Arm.of(robot)
    base = {**robot.base_tolerance, **resolved.base}
    tool = {**robot.tool_tolerance, **resolved.tool}
    parameters = _frame_parameters(arm, "base", BASE, base)
    for owner, joint in enumerate(robot.joints):
        parameters += _joint_parameters(arm, joint, owner, resolved)
    parameters += _frame_parameters(arm, "tool", TOOL, tool)
    if not parameters:
        fix = (
            "give a tolerance file with `tolerances` (for example units: {length: mm, angle: deg} and "
            f"all: {'{x: 0.1, y: 0.1, z: 0.1, offset: 0.01}' if robot.convention == 'urdf' else _DH_EXAMPLE})"
        )
        if robot.convention != "urdf":
            fix += ", or add a tolerance to the joints of the robot file"
        raise InputError(
            Problem(f"no parameter of {robot.name} has a tolerance, so no error can be predicted", fix=fix)
        )
    return tuple(parameters)


_DH_EXAMPLE = "{theta: 0.006, d: 0.1, a: 0.1, alpha: 0.006}"


def _frame_parameters(arm: Arm, frame: str, owner: int, sds: Mapping[str, float]) -> list[ToleranceParameter]:
    return [
        ToleranceParameter(
            f"{frame}.{kind}", None, kind, frame, _motion(arm, owner, kind), _unit(arm, owner, kind), sds[kind]
        )
        for kind in FRAME_PARAMETERS
        if sds.get(kind, 0.0) > 0.0
    ]


def _joint_parameters(arm: Arm, joint: Joint, owner: int, tolerances: Tolerances) -> list[ToleranceParameter]:
    common = tolerances.moving_joints if joint.type != "fixed" else {}
    sds = {**joint.tolerance, **common, **tolerances.joints.get(joint.name, {})}
    return [
        ToleranceParameter(
            f"{joint.name}.{kind}",
            joint.name,
            kind,
            _COMPONENTS[kind],
            _motion(arm, owner, kind),
            _unit(arm, owner, kind),
            sds[kind],
        )
        for kind in (*DH_PARAMETERS, *ORIGIN_PARAMETERS)
        if sds.get(kind, 0.0) > 0.0
    ]


def _motion(arm: Arm, owner: int, kind: str) -> int:
    """Return the motion of an error: an angle of a frame turns it about its own axis, at any pitch."""
    return arm.chain.index(owner, TURN_OF_ANGLE.get(kind, kind))


def _unit(arm: Arm, owner: int, kind: str) -> str:
    return arm.chain.motions[_motion(arm, owner, kind)].unit


def lengths_of(joint: Joint, convention: str) -> frozenset[str]:
    """Return the parameters of a joint that are lengths."""
    offset = {"offset"} if convention == "urdf" and joint.type == "prismatic" else set()
    return LENGTH_PARAMETERS | offset
