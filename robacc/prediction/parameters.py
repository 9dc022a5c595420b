"""The parameters whose errors count, each with its standard deviation: from the robot file, from a tolerance file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from robacc.chain import BASE, TOOL
from robacc.errors import InputError, Problem
from robacc.robots.arm import Arm
from robacc.robots.description import DH_PARAMETERS, LENGTH_PARAMETERS, ORIGIN_PARAMETERS, Joint, Robot

Distribution = Literal["normal", "uniform", "limits"]

FRAME_PARAMETERS = ("x", "y", "z", "roll", "pitch", "yaw")

_COMPONENTS = {
    **{"theta": "theta", "d": "d", "a": "a", "alpha": "alpha", "beta": "alpha", "offset": "offset"},
    **dict.fromkeys(("x", "y", "z"), "origin_length"),
    **dict.fromkeys(("roll", "pitch", "yaw"), "origin_angle"),
}
"""Which variance component a joint's parameter belongs to; beta tilts an axis as alpha does."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """What a tolerance file says, as standard deviations in m and rad; it goes before what the robot file says."""

    distribution: Distribution
    coverage: float
    """For ``limits``: how many standard deviations a limit stands for."""
    every: Mapping[str, float] = field(default_factory=dict)
    """Of every moving joint."""
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    base: Mapping[str, float] = field(default_factory=dict)
    tool: Mapping[str, float] = field(default_factory=dict)

    @property
    def meaning(self) -> str:
        """How a tolerance became a variance."""
        if self.distribution == "uniform":
            return "uniform: a tolerance t is the half width, variance t²/3"
        if self.distribution == "limits":
            c = f"{self.coverage:g}"
            return f"limits: a tolerance t is {c} standard deviations, variance (t/{c})²"
        return NORMAL


NORMAL = "normal: a tolerance t is one standard deviation, variance t²"


@dataclass(frozen=True, slots=True)
class ToleranceParameter:
    """One parameter of the arm that is not known exactly."""

    name: str
    """``j1.theta``, ``base.x`` …; unique."""
    joint: str | None
    """Name of the joint; None for the base and the tool."""
    kind: str
    """``theta``, ``d`` …; one of a URDF joint's origin; a coordinate of base or tool."""
    component: str
    """The variance component that it belongs to."""
    motion: int
    """Index of the chain's motion."""
    unit: str
    sd: float
    """Standard deviation, m or rad; above zero."""


def uncertain_parameters(robot: Robot, tolerances: Tolerances | None = None) -> tuple[ToleranceParameter, ...]:
    """Every parameter with a standard deviation above zero: base, joints in order, tool.

    Args:
        robot: Its own tolerances are standard deviations.
        tolerances: Go before the robot's, parameter by parameter: ``joints``, then ``every``, then the robot file.

    Raises:
        InputError: nothing has a tolerance.
    """
    given = tolerances or Tolerances("normal", 1.0)
    arm = Arm.of(robot)
    base = {**robot.base_tolerance, **given.base}
    tool = {**robot.tool_tolerance, **given.tool}
    found = _of_frame(arm, "base", BASE, base)
    for owner, joint in enumerate(robot.joints):
        found += _of_joint(arm, joint, owner, given)
    found += _of_frame(arm, "tool", TOOL, tool)
    if not found:
        fix = (
            "give --tolerances FILE (for example units: {length: mm, angle: deg} and "
            f"all: {'{x: 0.1, y: 0.1, z: 0.1, offset: 0.01}' if robot.convention == 'urdf' else _EXAMPLE})"
        )
        if robot.convention != "urdf":
            fix += ", or each joint in the robot file a tolerance"
        raise InputError(
            Problem(f"no parameter of {robot.name} has a tolerance, so no error can be predicted", fix=fix)
        )
    return tuple(found)


_EXAMPLE = "{theta: 0.006, d: 0.1, a: 0.1, alpha: 0.006}"


def _of_frame(arm: Arm, frame: str, owner: int, sds: Mapping[str, float]) -> list[ToleranceParameter]:
    return [
        ToleranceParameter(
            f"{frame}.{kind}", None, kind, frame, arm.chain.index(owner, kind), _unit(arm, owner, kind), sds[kind]
        )
        for kind in FRAME_PARAMETERS
        if sds.get(kind, 0.0) > 0.0
    ]


def _of_joint(arm: Arm, joint: Joint, owner: int, given: Tolerances) -> list[ToleranceParameter]:
    every = given.every if joint.type != "fixed" else {}
    sds = {**joint.tolerance, **every, **given.joints.get(joint.name, {})}
    return [
        ToleranceParameter(
            f"{joint.name}.{kind}",
            joint.name,
            kind,
            _COMPONENTS[kind],
            arm.chain.index(owner, kind),
            _unit(arm, owner, kind),
            sds[kind],
        )
        for kind in (*DH_PARAMETERS, *ORIGIN_PARAMETERS)
        if sds.get(kind, 0.0) > 0.0
    ]


def _unit(arm: Arm, owner: int, kind: str) -> str:
    return arm.chain.motions[arm.chain.index(owner, kind)].unit


def lengths_of(joint: Joint, convention: str) -> frozenset[str]:
    """Which of a joint's parameters are lengths."""
    extra = {"offset"} if convention == "urdf" and joint.type == "prismatic" else set()
    return LENGTH_PARAMETERS | extra
