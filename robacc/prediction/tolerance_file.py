"""Tolerance file of ``robacc predict --tolerances``: YAML, every problem with its line and key.

units: {length: mm, angle: deg}
distribution: limits            # normal (default) | uniform | limits
coverage: 3                     # limits only: number of standard deviations of a limit
all: {theta: 0.01, d: 0.2, a: 0.2, alpha: 0.01}   # every moving joint
joints:
  j2: {a: 0.5}                  # replaces all
base: {x: 0.5, yaw: 0.05}
tool: {z: 0.1}
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import cast

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, compose, describe, nearest
from robacc.prediction.parameters import FRAME_PARAMETERS, Distribution, Tolerances, lengths_of
from robacc.robots.description import DH_PARAMETERS, LENGTH_PARAMETERS, ORIGIN_PARAMETERS, Robot
from robacc.robots.yaml_units import Units

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
    if top is None:
        source.finish()
        raise AssertionError("finish() raises where section() returned None")
    units = _read_units(top)
    distribution = _read_distribution(top)
    coverage = _read_coverage(top, distribution)
    if units is None:
        # Nothing else can be checked without units.
        source.finish()
        raise AssertionError("finish() raises where there are no units")
    reader = _ToleranceFileReader(
        robot, units, {"normal": 1.0, "uniform": math.sqrt(3.0), "limits": coverage}[distribution]
    )
    tolerances = Tolerances(
        distribution,
        coverage,
        moving_joints=reader.moving_joints(top),
        joints=reader.joints(top),
        base=reader.frame(top, "base"),
        tool=reader.frame(top, "tool"),
    )
    if not any((tolerances.moving_joints, tolerances.joints, tolerances.base, tolerances.tool)) and not source.problems:
        source.report(None, "", "no tolerance is given", "add all, joints, base or tool")
    source.finish()
    return tolerances


class _ToleranceFileReader:
    """Reader of one file's sections for one robot; ``divisor`` converts a tolerance into a standard deviation."""

    def __init__(self, robot: Robot, units: Units, divisor: float) -> None:
        self.robot, self.units, self.divisor = robot, units, divisor
        self.kinds = ORIGIN_PARAMETERS if robot.convention == "urdf" else DH_PARAMETERS

    def moving_joints(self, top: YamlSection) -> dict[str, float]:
        """Read the section ``all``."""
        node = top.get("all")
        if node is None:
            return {}
        moving = {joint.type for joint in self.robot.joints if joint.type != "fixed"}
        lengths = LENGTH_PARAMETERS | ({"offset"} if moving == {"prismatic"} else set())
        values = self._values(top.source, node, "all", self.kinds, lengths)
        if "offset" in values and len(moving) > 1:
            message = "offset is an angle of revolute joints and a length of prismatic joints"
            top.source.report(node, "all.offset", message, "give it under joints, for each joint by name")
        return values

    def joints(self, top: YamlSection) -> dict[str, dict[str, float]]:
        """Read the section ``joints``, by name."""
        node = top.get("joints")
        if node is None:
            return {}
        source, result = top.source, {}
        if not isinstance(node, yaml.MappingNode):
            source.report(node, "joints", f"expected names of joints with tolerances, found {describe(node)}")
            return {}
        joints_by_name = {joint.name: joint for joint in self.robot.joints}
        for name, key_node, value in source.entries(node, "joints"):
            if name not in joints_by_name:
                fix = nearest(name, tuple(joints_by_name)) or f"the joints are {', '.join(joints_by_name)}"
                source.report(key_node, f"joints.{name}", "the robot has no such joint", fix)
                continue
            joint = joints_by_name[name]
            kinds = FRAME_PARAMETERS if joint.type == "fixed" else self.kinds
            lengths = lengths_of(joint, self.robot.convention)
            result[name] = self._values(source, value, f"joints.{name}", kinds, lengths)
        return result

    def frame(self, top: YamlSection, key: str) -> dict[str, float]:
        """Read the section ``base`` or ``tool``."""
        node = top.get(key)
        return {} if node is None else self._values(top.source, node, key, FRAME_PARAMETERS, LENGTH_PARAMETERS)

    def _values(
        self, source: Source, node: yaml.Node, path: str, kinds: Sequence[str], lengths: Collection[str]
    ) -> dict[str, float]:
        section = source.section(node, path, kinds)
        result: dict[str, float] = {}
        for name, item in (section.values if section else {}).items():
            value = self.units.parameter(source, item, f"{path}.{name}", is_length=name in lengths)
            if value is not None and value < 0:
                source.report(item, f"{path}.{name}", f"a tolerance cannot be negative, found {describe(item)}")
            elif value is not None:
                result[name] = value / self.divisor
        return result


def _read_units(top: YamlSection) -> Units | None:
    node = top.require("units")
    section = node and top.source.section(node, "units", ("length", "angle"))
    if not section:
        return None
    units = []
    for key, options in (("length", ("m", "mm")), ("angle", ("rad", "deg"))):
        item = section.require(key)
        units.append(top.source.choice(item, section.at(key), options) if item else None)
    length, angle = units
    return Units.of(length, angle) if length and angle else None


def _read_distribution(top: YamlSection) -> Distribution:
    node = top.get("distribution")
    value = top.source.choice(node, "distribution", _DISTRIBUTIONS) if node else None
    return cast(Distribution, value or "normal")


def _read_coverage(top: YamlSection, distribution: Distribution) -> float:
    node = top.get("coverage")
    if node is None:
        return DEFAULT_COVERAGE
    value = top.source.number(node, "coverage")
    if distribution != "limits":
        top.source.report(node, "coverage", "applies only to limits", "write distribution: limits")
    elif value is not None and not 0 < value <= _MAX_COVERAGE:
        top.source.report(node, "coverage", f"expected standard deviations, above 0 and at most 10, found {value:g}")
    return value if value and value > 0 else DEFAULT_COVERAGE
