"""Units of a robot file: convert numbers to m and rad, and report values that only make sense in another unit."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import cast

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, describe, join
from robacc.robots.description import LENGTH_PARAMETERS, ZERO, Frame, Joint, Robot, Vector

_LENGTHS = {"m": 1.0, "mm": 1e-3}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180}

MAX_LENGTH = 50.0
"""m: no arm has a longer link, and no base is farther from its instrument."""
MIN_LENGTH = 5e-3
"""m: an arm with only shorter lengths was written in m and declared as mm."""
TURN = 2 * math.pi * 1.001
"""rad: a fixed angle beyond a turn (and rounding) was written in degrees."""
_LIMITS_IN_DEGREES = (4 * math.pi, 1000.0)
"""rad: limits beyond two turns are rare, for all joints of an arm unknown; much larger ones mean "no limit"."""
TRAVEL_IN_MM = (MAX_LENGTH, 1e4)
"""m: a travel between these values was written in mm; a longer travel means "no limit"."""
_NO_LIMIT = {"revolute": _LIMITS_IN_DEGREES[1], "prismatic": TRAVEL_IN_MM[1]}
"""rad or m: a limit beyond this value means "no limit"."""


@dataclass(frozen=True, slots=True)
class Units:
    """Units of a robot file's numbers."""

    length: float
    """Unit of length in m."""
    angle: float
    """Unit of angle in rad."""

    @property
    def names(self) -> tuple[str, str]:
        """Names of the unit of length and of angle in a file."""
        lengths, angles = ({size: name for name, size in sizes.items()} for sizes in (_LENGTHS, _ANGLES))
        return lengths[self.length], angles[self.angle]

    def of_joint(self, joint_type: str) -> float:
        """Return the unit of a joint's variable."""
        return self.length if joint_type == "prismatic" else self.angle

    def parameter(self, source: Source, node: yaml.Node, path: str, *, is_length: bool) -> float | None:
        """Return a length in m or an angle in rad; report a value that is too large, with the likely cause."""
        value = source.number(node, path)
        unit, most = (self.length, MAX_LENGTH) if is_length else (self.angle, TURN)
        if value is None or abs(value) * unit <= most:
            return None if value is None else value * unit
        if is_length:
            fix = "it looks like mm: write length: mm under units" if unit == 1.0 else None
            source.report(node, path, f"{value:g} is {abs(value) * unit:g} m, too long for an arm", fix)
        else:
            fix = "it looks like degrees: write angle: deg under units" if unit == 1.0 else None
            source.report(node, path, f"{value:g} {'rad' if fix else 'deg'} is more than a turn", fix)
        return None

    def vector(self, source: Source, node: yaml.Node, path: str, *, is_length: bool = True) -> Vector | None:
        """Return three lengths in m or three angles in rad."""
        if source.numbers(node, path, 3) is None:
            return None
        items = enumerate(cast(yaml.SequenceNode, node).value)
        values = [self.parameter(source, item, f"{path}[{i}]", is_length=is_length) for i, item in items]
        return None if None in values else cast(Vector, tuple(values))

    def frame(self, section: YamlSection) -> Frame:
        """Return ``xyz`` and ``rpy`` of a section, each zero where absent."""
        nodes = ((key, section.get(key)) for key in ("xyz", "rpy"))
        xyz, rpy = (
            (node and self.vector(section.source, node, section.at(key), is_length=key == "xyz")) or ZERO
            for key, node in nodes
        )
        return Frame(xyz, rpy)

    def tolerances(
        self, section: YamlSection, names: Sequence[str], lengths: Collection[str] = LENGTH_PARAMETERS
    ) -> dict[str, float]:
        """Return the section's ``tolerance``: standard deviations by name, m for the ``lengths``, else rad."""
        node = section.get("tolerance")
        inner = node and section.source.section(node, section.at("tolerance"), names)
        result: dict[str, float] = {}
        for name, item in inner.values.items() if isinstance(inner, YamlSection) else ():
            path = join(section.at("tolerance"), name)
            value = self.parameter(section.source, item, path, is_length=name in lengths)
            if value is not None and value < 0:
                message = f"a standard deviation cannot be negative, found {describe(item)}"
                section.source.report(item, path, message)
            elif value is not None:
                result[name] = value
        return result


SI = Units(1.0, 1.0)
"""m and rad."""


def read_units(top: YamlSection) -> Units | None:
    """Return the units of the key ``units`` of a file; None where they cannot be read."""
    node = top.require("units")
    section = node and top.source.section(node, "units", ("length", "angle"))
    if not section:
        return None
    names = []
    for key, sizes in (("length", _LENGTHS), ("angle", _ANGLES)):
        entry = section.require(key)
        names.append(entry and section.source.choice(entry, section.at(key), tuple(sizes)))
    return Units(_LENGTHS[names[0]], _ANGLES[names[1]]) if names[0] and names[1] else None


def check_likely_units(robot: Robot, units: Units, top: YamlSection) -> None:
    """Report a robot without other problems whose numbers were likely written in units other than declared."""
    source, node = top.source, top.values["units"]
    if units.angle == 1.0 and limits_likely_degrees(robot.joints):
        first = next(joint.limits for joint in robot.joints if joint.limits and joint.type == "revolute")
        message = f"the limits of every joint (the first: {first} rad) are more than two turns"
        source.report(node, "units.angle", message, "they look like degrees: write angle: deg")
    parameters = [item for joint in robot.joints for item in joint.parameters.items()]
    fixed = [value for name, value in parameters if name not in LENGTH_PARAMETERS and name != "offset" and value]
    angles = [abs(value) / units.angle for value in fixed]
    right = (math.pi / 2, math.pi)
    if units.angle != 1.0 and angles and all(min(abs(value - angle) for angle in right) < 1e-3 for value in angles):
        message = f"the joints' angles ({angles[0]:g} and so on) are multiples of a quarter turn in rad, not in deg"
        source.report(node, "units.angle", message, "they look like radians: write angle: rad")
    travels = [value for joint in robot.joints if joint.type == "prismatic" for value in joint.limits or ()]
    lengths = [value for name, value in parameters if name in LENGTH_PARAMETERS]
    longest = max(map(abs, (*lengths, *travels)), default=0.0)
    if units.length != 1.0 and 0 < longest < MIN_LENGTH:
        message = f"the longest length of the arm is {longest / units.length:g} mm"
        source.report(node, "units.length", message, "the lengths look like metres: write length: m")


def finite_limits(kind: str, limits: tuple[float, float]) -> tuple[tuple[float, float] | None, str | None]:
    """Return a joint's limits, rad or m, None where large numbers mean "no limit", and a problem of them or None."""
    beyond = [abs(value) > _NO_LIMIT[kind] for value in limits]
    if not any(beyond):
        return limits, None
    if all(beyond) and limits[0] < 0 < limits[1]:
        return None, None
    return None, f"the limits {limits[0]:g} and {limits[1]:g} are too large for a joint"


def limits_likely_degrees(joints: Sequence[Joint]) -> bool:
    """Return whether the limits of all revolute joints, in rad, only make sense in degrees."""
    limits = [joint.limits for joint in joints if joint.limits and joint.type == "revolute"]
    low, high = _LIMITS_IN_DEGREES
    return bool(limits) and all(low < max(map(abs, pair)) < high for pair in limits)
