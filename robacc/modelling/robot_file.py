"""A robot from a file, whichever of the two formats it is in."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import PurePath

from robacc.errors import InputError, Problem, UsageError
from robacc.io.files import read_text
from robacc.robots.description import Robot

_XML_SUFFIXES = frozenset({".urdf", ".xml"})
_MESHES = frozenset({".stl", ".dae", ".obj", ".ply", ".step", ".stp", ".iges", ".igs", ".glb", ".gltf", ".3mf"})
_TABLES = frozenset({".csv", ".tsv", ".txt", ".xlsx", ".ods"})
_EXPECTED = "a robot file (YAML) or a URDF is needed"


def read_robot(path: str | os.PathLike[str], *, base_link: str | None = None, tip_link: str | None = None) -> Robot:
    """The robot that a robot file (YAML) or a URDF describes; the content decides which it is.

    Args:
        path: The file.
        base_link: URDF only: link that the chain starts at.
        tip_link: URDF only: link that it ends at.

    Raises:
        InputError: The file cannot be read, is something else, or is wrong.
        UsageError: A link is named that the URDF does not have, or with a robot file, which is one chain already.
    """
    name = os.fspath(path)
    suffix = PurePath(name).suffix.lower()
    if suffix in _MESHES:
        raise InputError(Problem(f"is a shape ({suffix}), which has no joints", name, fix=_EXPECTED))
    text = read_text(path)
    if suffix == ".xacro":
        fix = "run xacro on it first: xacro robot.xacro > robot.urdf"
        raise InputError(Problem("is xacro, not yet URDF", name, fix=fix))
    if suffix in _XML_SUFFIXES or text.lstrip().startswith("<"):
        from robacc.robots.urdf import parse_urdf

        return parse_urdf(text, name, base_link, tip_link)
    if base_link is not None or tip_link is not None:
        raise UsageError(f"--base-link and --tip-link choose a chain of a URDF; {name} is a robot file with one chain")
    if suffix in _TABLES:
        raise InputError(Problem("is a table, not a robot", name, fix=_EXPECTED))
    from robacc.robots.yaml_robot import parse_robot

    robot = parse_robot(text, name)
    _check_effects(robot, text, name)
    return robot


def _check_effects(robot: Robot, text: str, file: str) -> None:
    """Refuse effects that no command could apply, each with its line: later nobody knows the file any more."""
    if not robot.effects:
        return
    from robacc.effects.specification import known_effects
    from robacc.robots.yaml_robot import effect_lines

    try:
        known_effects(robot)
    except InputError as error:
        lines = effect_lines(text, file)
        placed = [replace(one, file=file, line=lines[one.column or ""]) for one in error.problems]
        raise InputError(placed, total=error.total) from None
