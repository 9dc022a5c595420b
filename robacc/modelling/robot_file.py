"""Reader of a robot from a robot file (YAML) or a URDF."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import PurePath

from robacc.errors import InputError, Problem, UsageError
from robacc.io.files import read_text
from robacc.robots.description import Robot

_XML_SUFFIXES = frozenset({".urdf", ".xml"})
_MESHES = frozenset({".stl", ".dae", ".obj", ".ply", ".step", ".stp", ".iges", ".igs", ".glb", ".gltf", ".3mf"})
_TABLES = frozenset({".csv", ".tsv", ".txt", ".xlsx", ".ods"})
_EXPECTED = "give a robot file (YAML) or a URDF"


def robot_path(source: str | os.PathLike[str]) -> str:
    """Return the file that a robot's name or path stands for; the name of an arm of the package is its file.

    A file of that name in the working folder comes first. Any other text is returned as it is.
    """
    name = os.fspath(source)
    if not _may_be_arm(name):
        return name
    from robacc.robots.library import find_arm

    arm = find_arm(name)
    return name if arm is None else os.fspath(arm.path)


def _may_be_arm(name: str) -> bool:
    """Return whether a text can be the name of an arm of the package: no file, no path, no suffix of a file."""
    has_suffix = bool(re.fullmatch(r"\.[a-z]\w*", PurePath(name).suffix.lower()))
    return bool(name) and name != "-" and PurePath(name).name == name and not has_suffix and not os.path.lexists(name)


def _check_name(name: str) -> None:
    """Raise InputError for a text that can only be the name of an arm, and is the name of none."""
    if not _may_be_arm(name):
        return
    from robacc.robots.library import similar_arms

    near = " or ".join(similar_arms(name))
    fix = f"did you mean {near}?" if near else f"robacc robots lists the arms; {_EXPECTED}"
    raise InputError(Problem("is neither a file nor an arm of the package", name, fix=fix))


def read_robot(
    path: str | os.PathLike[str],
    *,
    base_link: str | None = None,
    tip_link: str | None = None,
    joint_columns: Callable[[], Sequence[str]] | None = None,
) -> Robot:
    """Read a robot file (YAML) or a URDF; the content decides which it is.

    Args:
        path: The file, or the name of an arm of the package (``ur10e``).
        base_link: URDF only: first link of the chain.
        tip_link: URDF only: last link of the chain.
        joint_columns: URDF only: returns the columns of a pose file, by which the chain is chosen without a
            ``tip_link``; called for a URDF only.

    Raises:
        InputError: The file cannot be read, is in another format, or has errors.
        UsageError: The URDF has no such link, or a link is named for a robot file, which has only one chain.
    """
    name = robot_path(path)
    _check_name(name)
    suffix = PurePath(name).suffix.lower()
    if suffix in _MESHES:
        raise InputError(Problem(f"is a mesh ({suffix}), which has no joints", name, fix=_EXPECTED))
    text = read_text(name)
    if suffix == ".xacro":
        fix = "convert it first: xacro robot.xacro > robot.urdf"
        raise InputError(Problem("is xacro, not URDF", name, fix=fix))
    if suffix in _XML_SUFFIXES or text.lstrip().startswith("<"):
        from robacc.robots.urdf import parse_urdf

        return parse_urdf(text, name, base_link, tip_link, joint_columns)
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
    if not robot.effects and robot.campaign is None:
        return
    from robacc.effects.specification import known_effects
    from robacc.robots.yaml_robot import effect_lines

    if robot.campaign is not None:
        _check_campaign(robot, file)
    try:
        known_effects(robot)
    except InputError as error:
        lines = effect_lines(text, file)
        placed = [replace(problem, file=file, line=lines[problem.column or ""]) for problem in error.problems]
        raise InputError(placed, total=error.total) from None


def _check_campaign(robot: Robot, file: str) -> None:
    """Raise InputError for invalid effects of the campaign."""
    from robacc.effects.specification import known_effects

    assert robot.campaign is not None
    try:
        known_effects(replace(robot, effects=robot.campaign.effects))
    except InputError as error:
        placed = [replace(problem, file=file, column=f"campaign.{problem.column}") for problem in error.problems]
        raise InputError(placed, total=error.total) from None
