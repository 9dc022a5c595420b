"""Write a fitted robot as a robot file, in the units and the layout of the file that the robot was read from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robacc.effects.entry_units import with_effect_units
from robacc.errors import InputError
from robacc.io.yaml_edit import edited
from robacc.robots.description import STANDARD_GRAVITY, Robot
from robacc.robots.yaml_robot import file_units, parse_robot
from robacc.robots.yaml_writer import comment_lines, robot_document, robot_to_yaml, rounded_document

_OLD_COMMENTS = "the comments below are those of the robot file before the fit"
_RELATIVE, _ABSOLUTE = 1e-9, 1e-11
"""Differences between two documents that rounding to twelve digits explains."""


def model_text(robot: Robot, comments: Sequence[str] = ()) -> str:
    """Return the robot file of a fitted robot, its numbers rounded to twelve digits.

    A robot that was read from a robot file keeps the file's units, comments, order of keys and unchanged numbers; any
    other robot is written in m and rad.

    Raises:
        InputError: The robot's effects cannot be read.
    """
    text = robot.file_text
    if text is None:
        return robot_to_yaml(with_effect_units(robot), comments, rounded=True)
    units = file_units(text, robot.name)
    in_units = with_effect_units(robot, units.length, units.angle)
    document = rounded_document(robot_document(in_units, units))
    updated = edited(text, _complete(document, robot), robot.name, rewritten=("effects", "campaign", "fit"))
    if _is_read_as(updated, robot):
        return comment_lines((*comments, *_remark(text))) + updated
    # The file states something in a form that no longer holds, such as a parameter that the fit removed.
    return robot_to_yaml(in_units, comments, rounded=True, units=units)


def _remark(text: str) -> tuple[str, ...]:
    """Return the comment on the comments of the file; empty if it has none, or has this comment already."""
    return (_OLD_COMMENTS,) if "#" in text and _OLD_COMMENTS not in text else ()


def _complete(document: dict[str, Any], robot: Robot) -> dict[str, Any]:
    """Return a document with zeros and empty lists that a file may state otherwise.

    It has no defaults of other kinds, and nothing that a fit does not change and that files write in several forms.
    """
    joints = []
    for number, entry in enumerate(document["joints"], 1):
        joint = entry if robot.convention == "urdf" else {**entry, "beta": entry.get("beta", 0.0)}
        joints.append({key: value for key, value in joint.items() if (key, value) != ("name", f"j{number}")})
    complete = {**document, "joints": joints}
    complete |= {key: [] for key in ("effects", "fitted_to") if key not in document}
    stated = {"identity", *({"gravity"} if robot.gravity == STANDARD_GRAVITY else ())}
    return {key: value for key, value in complete.items() if key not in stated}


def _is_read_as(text: str, robot: Robot) -> bool:
    """Return whether a text reads as the robot, within the rounding of its numbers."""
    try:
        read = parse_robot(text, robot.name)
        documents = [robot_document(with_effect_units(item)) for item in (read, robot)]
    except InputError:
        return False
    return _is_close(*documents)


def _is_close(first: Any, second: Any) -> bool:
    """Return whether two documents are equal but for the rounding of numbers."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(_is_close(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple) and isinstance(second, list | tuple):
        return len(first) == len(second) and all(map(_is_close, first, second))
    if isinstance(first, float) or isinstance(second, float):
        return math.isclose(first, second, rel_tol=_RELATIVE, abs_tol=_ABSOLUTE)
    return bool(first == second)
