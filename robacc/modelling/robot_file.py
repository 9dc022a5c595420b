"""Read a robot from a robot file (YAML), a URDF or the arms of the package, and write a fitted robot as its file is."""

import difflib
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path, PurePath
from typing import Any

from robacc.effects.specification import known_effects, with_effect_units
from robacc.errors import InputError, Problem, given, refuse
from robacc.io.files import read_text
from robacc.io.yaml_nodes import edited
from robacc.plug_ins import plug_in
from robacc.robots.description import STANDARD_GRAVITY, Robot
from robacc.robots.yaml_robot import (
    Units,
    comment_lines,
    effect_lines,
    parse_robot,
    robot_document,
    robot_to_yaml,
)

_MESHES = frozenset({".stl", ".dae", ".obj", ".ply", ".step", ".stp", ".iges", ".igs", ".glb", ".gltf", ".3mf"})
_EXPECTED = "give a robot file (YAML), a URDF, or a table with columns theta, d, a, alpha"
_DATA = Path(__file__).parents[1] / "data"


@cache
def library() -> tuple[Mapping[str, Any], ...]:
    """Return the arms of the package by maker and name, each by the keys of the result.

    The ``name`` stands for the file at its ``path``, which is without suffix the same.
    """
    import yaml

    text = read_text(_DATA / "robots.yaml")
    # The package's own file, so the fast reader is safe.
    entries = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))["robots"]
    return tuple(
        {
            "name": name,
            "maker": entry["maker"],
            "model": entry["name"],
            "n_axes": entry["axes"],
            "reach_m": entry["reach"] * 1e-3,
            "source": entry["source"],
            "path": _DATA / "robots" / f"{name}.yaml",
        }
        for name, entry in entries.items()
    )


def find_arm(name: str) -> Mapping[str, Any] | None:
    """Return the arm with a name, or with the maker's name of it; capitals, blanks and hyphens do not matter.

    A name that fits several arms stands for none: variants of one arm differ by decimetres.
    """
    wanted = _plain(name)
    matches = [arm for arm in library() if wanted in map(_plain, _names(arm))]
    return matches[0] if len(matches) == 1 else None


def similar_arms(name: str) -> tuple[str, ...]:
    """Return the names of arms that a name may mean, the likeliest first."""
    wanted, most = _plain(name), 4
    by_name = {_plain(name): arm["name"] for arm in library() for name in _names(arm)}
    variants = [key for plain, key in by_name.items() if wanted and wanted in plain]
    near = [by_name[plain] for plain in difflib.get_close_matches(wanted, by_name, most, 0.6)]
    return tuple(dict.fromkeys(variants or near))[:most]


def _names(arm: Mapping[str, Any]) -> tuple[str, str, str]:
    return arm["maker"] + arm["model"], arm["model"], arm["name"]


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def robot_path(source: str | os.PathLike[str]) -> str:
    """Return the file that a robot's name or path stands for; the name of an arm of the package is its file.

    A file of that name in the working folder comes first. Any other text is returned as it is.
    """
    name = os.fspath(source)
    arm = find_arm(name) if _may_be_arm(name) else None
    return name if arm is None else os.fspath(arm["path"])


def _may_be_arm(name: str) -> bool:
    """Return whether a text can be the name of an arm of the package: no file, no path, no suffix of a file."""
    has_suffix = bool(re.fullmatch(r"\.[a-z]\w*", PurePath(name).suffix.lower()))
    return bool(name) and name != "-" and PurePath(name).name == name and not has_suffix and not os.path.lexists(name)


def read_robot(
    path: str | os.PathLike[str],
    *,
    base_link: str | None = None,
    tip_link: str | None = None,
    joint_columns: Callable[[], Sequence[str]] | None = None,
) -> Robot:
    """Read a robot file (YAML), a URDF, or a Denavit-Hartenberg table (CSV).

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
    if _may_be_arm(name):
        near = " or ".join(similar_arms(name))
        fix = f"did you mean {near}?" if near else f"robacc show robots lists the arms; {_EXPECTED}"
        raise InputError(Problem("is neither a file nor an arm of the package", name, fix=fix))
    suffix = PurePath(name).suffix.lower()
    refuse(
        (suffix in _MESHES, Problem(f"is a mesh ({suffix}), which has no joints", name, fix=_EXPECTED)),
        (suffix in (".m", ".mlx", ".py"), Problem("is a program, which is not run", name, fix=_EXPECTED)),
    )
    text, fix = read_text(name), "convert it first: xacro robot.xacro > robot.urdf"
    refuse(
        (suffix == ".xacro", Problem("is xacro, not URDF", name, fix=fix)),
        (
            re.search(r"^(delta_theta\s*=|kinematics\s*:)", text, re.MULTILINE),
            Problem("is a kinematics file", name, fix="convert it first: robacc init --from FILE --output robot.yaml"),
        ),
    )
    if suffix in (".urdf", ".xml") or text.lstrip().startswith("<"):
        from robacc.robots.urdf import parse_urdf

        return parse_urdf(text, name, base_link, tip_link, joint_columns)
    refuse(
        (
            base_link is not None or tip_link is not None,
            f"`base_link` and `tip_link` choose a chain of a URDF; {name} is a robot file, which has only one chain",
        ),
    )
    if suffix in {".csv", ".tsv", ".txt", ".xlsx", ".ods"}:
        table: Robot | None = plug_in("robacc.importers", "dh-table")(text, name)
        return given(table, Problem("is a table, not a robot description", name, fix=_EXPECTED))
    robot = parse_robot(text, name)
    # Invalid effects, those of the campaign first, with their lines.
    for where, part in (("campaign.", robot.campaign), ("", robot)):
        try:
            known_effects(replace(robot, effects=part.effects if part else ()))
        except InputError as error:
            lines = {} if where else effect_lines(text, name)
            placed = [
                replace(problem, file=name, column=f"{where}{problem.column}", line=lines.get(problem.column or ""))
                for problem in error.problems
            ]
            raise InputError(placed, total=error.total) from None
    return robot


# Write a fitted robot as a robot file, in the units and the layout of the file that the robot was read from.

_OLD_COMMENTS = "the comments below are those of the robot file before the fit"


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
    units = Units(*parse_robot(text, robot.name).effect_units)
    in_units = with_effect_units(robot, units.length, units.angle)
    document = robot_document(in_units, units, rounded=True)
    # Zeros and empty lists that the file may state otherwise; nothing that a fit does not change and that files write
    # in several forms.
    joints = []
    for number, entry in enumerate(document["joints"], 1):
        joint = entry if robot.convention == "urdf" else {**entry, "beta": entry.get("beta", 0.0)}
        joints.append({key: value for key, value in joint.items() if (key, value) != ("name", f"j{number}")})
    complete = {**document, "joints": joints}
    complete |= {key: [] for key in ("effects", "fitted_to") if key not in document}
    stated = {"identity", *({"gravity"} if robot.gravity == STANDARD_GRAVITY else ())}
    updated = edited(
        text,
        {key: value for key, value in complete.items() if key not in stated},
        robot.name,
        rewritten=("effects", "campaign", "fit"),
    )
    with suppress(InputError):
        documents = [robot_document(with_effect_units(item)) for item in (parse_robot(updated, robot.name), robot)]
        if _is_close(*documents):
            remark = (_OLD_COMMENTS,) if "#" in text and _OLD_COMMENTS not in text else ()
            return comment_lines((*comments, *remark)) + updated
    # The file states something in a form that no longer holds, such as a parameter that the fit removed.
    return robot_to_yaml(in_units, comments, rounded=True, units=units)


def _is_close(first: Any, second: Any) -> bool:
    """Return whether two documents are equal but for the rounding of numbers."""
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(_is_close(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple) and isinstance(second, list | tuple):
        return len(first) == len(second) and all(map(_is_close, first, second))
    if isinstance(first, float) or isinstance(second, float):  # rounded to twelve digits
        return math.isclose(first, second, rel_tol=1e-9, abs_tol=1e-11)
    return bool(first == second)
