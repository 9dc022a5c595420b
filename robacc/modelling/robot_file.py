"""Reader of a robot from a robot file (YAML) or a URDF."""

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
_EXPECTED = "give a robot file (YAML) or a URDF"


def read_robot(path: str | os.PathLike[str], *, base_link: str | None = None, tip_link: str | None = None) -> Robot:
    """Read a robot file (YAML) or a URDF; the content decides which it is.

    Args:
        path: The file.
        base_link: URDF only: first link of the chain.
        tip_link: URDF only: last link of the chain.

    Raises:
        InputError: The file cannot be read, is in another format, or has errors.
        UsageError: The URDF has no such link, or a link is named for a robot file, which has only one chain.
    """
    name = os.fspath(path)
    suffix = PurePath(name).suffix.lower()
    if suffix in _MESHES:
        raise InputError(Problem(f"is a mesh ({suffix}), which has no joints", name, fix=_EXPECTED))
    text = read_text(path)
    if suffix == ".xacro":
        fix = "convert it first: xacro robot.xacro > robot.urdf"
        raise InputError(Problem("is xacro, not URDF", name, fix=fix))
    if suffix in _XML_SUFFIXES or text.lstrip().startswith("<"):
        from robacc.robots.urdf import parse_urdf

        return parse_urdf(text, name, base_link, tip_link)
    if base_link is not None or tip_link is not None:
        raise UsageError(
            f"`base_link` and `tip_link` choose a chain of a URDF; {name} is a robot file, which has only one chain"
        )
    if suffix in _TABLES:
        raise InputError(Problem("is a table, not a robot description", name, fix=_EXPECTED))
    from robacc.robots.yaml_robot import parse_robot

    robot = parse_robot(text, name)
    _check_effects(robot, text, name)
    return robot


def _check_effects(robot: Robot, text: str, file: str) -> None:
    """Raise InputError for invalid effects, with their lines, which are known only here."""
    if not robot.effects:
        return
    from robacc.effects.specification import known_effects
    from robacc.robots.yaml_robot import effect_lines

    try:
        known_effects(robot)
    except InputError as error:
        lines = effect_lines(text, file)
        placed = [replace(problem, file=file, line=lines[problem.column or ""]) for problem in error.problems]
        raise InputError(placed, total=error.total) from None
