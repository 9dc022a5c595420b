"""Tools and bases that a controller knows by number or name and a program does not contain, from a YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import yaml

from robacc.io.yaml_nodes import Source, YamlSection, compose, join
from robacc.programs.program import Program, ProgramFrame
from robacc.robots.description import Frame
from robacc.robots.yaml_units import Units

_KEYS = ("units", "tools", "bases")
DEFAULT = "default"
"""Name of the frame of targets for which the program names none."""


@dataclass(frozen=True, slots=True)
class FrameTable:
    """Frames by the names that programs use."""

    tools: Mapping[str, Frame] = field(default_factory=dict)
    """Tools in the flange's frame."""
    bases: Mapping[str, Frame] = field(default_factory=dict)
    """Bases in the robot's base frame."""


def parse_frames(text: str, file: str) -> FrameTable:
    """Return the frames of a YAML file with the keys ``units``, ``tools`` and ``bases``.

    Raises:
        InputError: The file has problems; the error carries all of them, with line and key.
    """
    source = Source(file)
    top = source.section(compose(text, file), "", _KEYS)
    units = None if top is None else _units(top)
    if top is None or units is None:
        source.finish()
        raise AssertionError("finish() raises where a section is missing")
    table = FrameTable(_frames(top, "tools", units), _frames(top, "bases", units))
    source.finish()
    return table


def with_frames(program: Program, table: FrameTable) -> Program:
    """Return the program with the frames of a table where the program names a frame but does not define it.

    Names are compared without regard to case. The frame :data:`DEFAULT` stands for one that the program does not name.
    """
    tools = {name.lower(): frame for name, frame in table.tools.items()}
    bases = {name.lower(): frame for name, frame in table.bases.items()}

    def known(frame: ProgramFrame | None, names: Mapping[str, Frame]) -> ProgramFrame | None:
        if frame is None:
            return ProgramFrame(DEFAULT, names[DEFAULT]) if DEFAULT in names else None
        return ProgramFrame(frame.name, names.get(frame.name.lower())) if frame.frame is None else frame

    targets = [replace(t, tool=known(t.tool, tools), base=known(t.base, bases)) for t in program.targets]
    moves = [replace(m, tool=known(m.tool, tools), base=known(m.base, bases)) for m in program.moves]
    return replace(program, targets=tuple(targets), moves=tuple(moves))


def _units(top: YamlSection) -> Units | None:
    node = top.require("units")
    section = node and top.source.section(node, "units", ("length", "angle"))
    if not section:
        return None
    names = []
    for key, options in (("length", ("m", "mm")), ("angle", ("rad", "deg"))):
        entry = section.require(key)
        names.append(entry and section.source.choice(entry, section.at(key), options))
    return Units.of(names[0], names[1]) if names[0] and names[1] else None


def _frames(top: YamlSection, key: str, units: Units) -> dict[str, Frame]:
    node = top.get(key)
    if node is None:
        return {}
    if not isinstance(node, yaml.MappingNode):
        top.source.report(node, key, "expected frames by name, each with xyz and rpy")
        return {}
    result = {}
    for name, _, value in top.source.entries(node, key):
        section = top.source.section(value, join(key, name), ("xyz", "rpy"))
        if section is not None:
            result[name] = units.frame(section)
    return result
