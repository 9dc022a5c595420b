"""Parameters with errors and their standard deviations, from the robot file and from a tolerance file."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, cast

import yaml

from robacc.chain import BASE, TOOL
from robacc.errors import InputError, Problem
from robacc.io.yaml_nodes import Source, YamlSection, compose, describe, nearest
from robacc.robots.arm import TURN_OF_ANGLE, Arm
from robacc.robots.description import DH_PARAMETERS, LENGTH_PARAMETERS, ORIGIN_PARAMETERS, Robot
from robacc.robots.yaml_robot import read_units

# Parameters with errors and their standard deviations, from the robot file and from a tolerance file.

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
    stated, arm = tolerances or Tolerances("normal", 1.0), Arm.of(robot)
    kinds = (*DH_PARAMETERS, *ORIGIN_PARAMETERS)
    owners: list[tuple[int, str | None, Sequence[str], Mapping[str, float]]] = [
        (BASE, None, FRAME_PARAMETERS, {**robot.base_tolerance, **stated.base})
    ]
    for owner, joint in enumerate(robot.joints):
        common = stated.moving_joints if joint.type != "fixed" else {}
        owners.append((owner, joint.name, kinds, {**joint.tolerance, **common, **stated.joints.get(joint.name, {})}))
    owners.append((TOOL, None, FRAME_PARAMETERS, {**robot.tool_tolerance, **stated.tool}))
    parameters = []
    for owner, name, own_kinds, sds in owners:
        frame = "base" if owner == BASE else "tool"
        for kind in (kind for kind in own_kinds if sds.get(kind, 0.0) > 0.0):
            # An angle of a frame turns it about its own axis, at any pitch.
            motion = arm.chain.index(owner, TURN_OF_ANGLE.get(kind, kind))
            parameters.append(
                ToleranceParameter(
                    f"{name or frame}.{kind}",
                    name,
                    kind,
                    frame if name is None else _COMPONENTS[kind],
                    motion,
                    arm.chain.motions[motion].unit,
                    sds[kind],
                )
            )
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


# Tolerance file of ``robacc predict --tolerances``: YAML, every problem with its line and key.
#
# units: {length: mm, angle: deg}
# distribution: limits            # normal (default) | uniform | limits
# coverage: 3                     # limits only: number of standard deviations of a limit
# all: {theta: 0.01, d: 0.2, a: 0.2, alpha: 0.01}   # every moving joint
# joints:
#   j2: {a: 0.5}                  # replaces all
# base: {x: 0.5, yaw: 0.05}
# tool: {z: 0.1}

DEFAULT_COVERAGE = 3.0
"""Default number of standard deviations of a drawing's limit."""

_KEYS = ("units", "distribution", "coverage", "all", "joints", "base", "tool")
_DISTRIBUTIONS = ("normal", "uniform", "limits")
_MAX_COVERAGE = 10.0


def parse_tolerances(text: str, file: str, robot: Robot) -> Tolerances:
    """Return the tolerances of a file for ``robot``, as standard deviations in m and rad.

    Raises:
        InputError: The file has problems; all of them are listed with line and dotted key.
    """
    source = Source(file)
    top = source.section(compose(text, file), "", _KEYS)
    units = None if top is None else read_units(top)
    meaning: tuple[Distribution, float] = ("normal", DEFAULT_COVERAGE) if top is None else _read_distribution(top)
    if top is None or units is None:
        # Nothing else can be checked without units.
        source.finish()
        raise AssertionError("finish() raises where there are no units")
    divisor = {"normal": 1.0, "uniform": math.sqrt(3.0), "limits": meaning[1]}[meaning[0]]
    joint_kinds = ORIGIN_PARAMETERS if robot.convention == "urdf" else DH_PARAMETERS

    def read(node: yaml.Node, path: str, kinds: Sequence[str], lengths: Collection[str]) -> dict[str, float]:
        section = source.section(node, path, kinds)
        result = {}
        for name, item in (section.values if section else {}).items():
            value = units.parameter(source, item, f"{path}.{name}", is_length=name in lengths)
            if value is not None and value < 0:
                source.report(item, f"{path}.{name}", f"a tolerance cannot be negative, found {describe(item)}")
            elif value is not None:
                result[name] = value / divisor
        return result

    moving: dict[str, float] = {}
    if (node := top.get("all")) is not None:
        types = {joint.type for joint in robot.joints if joint.type != "fixed"}
        moving = read(node, "all", joint_kinds, LENGTH_PARAMETERS | ({"offset"} if types == {"prismatic"} else set()))
        if "offset" in moving and len(types) > 1:
            message = "offset is an angle of revolute joints and a length of prismatic joints"
            source.report(node, "all.offset", message, "give it under joints, for each joint by name")
    by_joint: dict[str, dict[str, float]] = {}
    joints_by_name = {joint.name: joint for joint in robot.joints}
    node = top.get("joints")
    if isinstance(node, yaml.MappingNode):
        for name, key_node, value in source.entries(node, "joints"):
            if (joint := joints_by_name.get(name)) is None:
                fix = nearest(name, tuple(joints_by_name)) or f"the joints are {', '.join(joints_by_name)}"
                source.report(key_node, f"joints.{name}", "the robot has no such joint", fix)
                continue
            kinds = FRAME_PARAMETERS if joint.type == "fixed" else joint_kinds
            is_slide = robot.convention == "urdf" and joint.type == "prismatic"
            lengths = LENGTH_PARAMETERS | ({"offset"} if is_slide else set())
            by_joint[name] = read(value, f"joints.{name}", kinds, lengths)
    elif node is not None:
        source.report(node, "joints", f"expected names of joints with tolerances, found {describe(node)}")
    base, tool = (
        {} if node is None else read(node, key, FRAME_PARAMETERS, LENGTH_PARAMETERS)
        for key, node in ((key, top.get(key)) for key in ("base", "tool"))
    )
    if not any((moving, by_joint, base, tool)) and not source.problems:
        source.report(None, "", "no tolerance is given", "add all, joints, base or tool")
    source.finish()
    return Tolerances(*meaning, moving, by_joint, base, tool)


def _read_distribution(top: YamlSection) -> tuple[Distribution, float]:
    """Return the distribution of the tolerances, and the number of standard deviations of a limit."""
    node = top.get("distribution")
    distribution = cast(
        Distribution, (top.source.choice(node, "distribution", _DISTRIBUTIONS) if node else "") or "normal"
    )
    if (node := top.get("coverage")) is None:
        return distribution, DEFAULT_COVERAGE
    value = top.source.number(node, "coverage")
    if distribution != "limits":
        top.source.report(node, "coverage", "applies only to limits", "write distribution: limits")
    elif value is not None and not 0 < value <= _MAX_COVERAGE:
        top.source.report(node, "coverage", f"expected standard deviations, above 0 and at most 10, found {value:g}")
    return distribution, value if value and value > 0 else DEFAULT_COVERAGE
