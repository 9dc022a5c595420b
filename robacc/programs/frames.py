"""Frames of targets: those that a controller knows, and poses of the flange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robacc.geometry import Array, Poses, quaternion_from_rotation, rotation_from_quaternion, rotation_from_rpy
from robacc.io.yaml_nodes import Source, compose
from robacc.programs.program import Program, ProgramFrame, ProgramTarget
from robacc.robots.description import Frame
from robacc.robots.yaml_robot import named_frames, read_fields, read_units

# Tools and bases that a controller knows by number or name and a program does not contain, from a YAML file.

_KEYS = ("units", "tools", "bases")
DEFAULT = "default"
"""Name of the frame of targets for which the program names none."""


def parse_frames(text: str, file: str) -> dict[str, Mapping[str, Frame]]:
    """Return ``tools`` in the flange's frame and ``bases`` in the robot's base frame, by name, of a YAML file.

    Raises:
        InputError: The file has problems; the error carries all of them, with line and key.
    """
    source = Source(file)
    top = source.section(compose(text, file), "", _KEYS)
    units = None if top is None else read_units(top)
    if top is None or units is None:
        source.finish()
        raise AssertionError("finish() raises where a section is missing")
    frames = named_frames("expected frames by name, each with xyz and rpy, found {found}")
    table = read_fields(top, {"tools": frames, "bases": frames}, units)
    source.finish()
    return table


def with_frames(program: Program, table: Mapping[str, Mapping[str, Frame]]) -> Program:
    """Return the program with the frames of a table where the program names a frame but does not define it.

    Names are compared without regard to case. The frame :data:`DEFAULT` stands for one that the program does not name.
    """
    tools, bases = ({name.lower(): at for name, at in table.get(key, {}).items()} for key in ("tools", "bases"))

    def known(frame: ProgramFrame | None, names: Mapping[str, Frame]) -> ProgramFrame | None:
        if frame is None:
            return ProgramFrame(DEFAULT, names[DEFAULT]) if DEFAULT in names else None
        return ProgramFrame(frame.name, names.get(frame.name.lower())) if frame.frame is None else frame

    targets = [replace(t, tool=known(t.tool, tools), base=known(t.base, bases)) for t in program.targets]
    moves = [replace(m, tool=known(m.tool, tools), base=known(m.base, bases)) for m in program.moves]
    return replace(program, targets=tuple(targets), moves=tuple(moves))


# Cartesian targets as poses of the flange in the robot's base frame, and back, through each target's tool and base.


@dataclass(frozen=True, slots=True)
class FlangeTargets:
    """Cartesian targets of a program whose tool and base are known."""

    numbers: tuple[int, ...]
    """Index of each in ``Program.targets``."""
    flange: Poses
    """Pose of the flange in the robot's base frame, over N."""
    unknown: tuple[tuple[int, str], ...]
    """Index of each other Cartesian target, and the reason."""


def flange_targets(program: Program) -> FlangeTargets:
    """Return the flange's poses at the Cartesian targets of a program."""
    numbers, unknown = [], []
    for i, target in enumerate(program.targets):
        if target.kind != "cartesian":
            continue
        reason = _unknown(target.tool, "tool") or _unknown(target.base, "base")
        if reason:
            unknown.append((i, reason))
        else:
            numbers.append(i)
    targets = [program.targets[i] for i in numbers]
    values = np.array([target.values for target in targets], dtype=float).reshape(-1, 7).T
    poses = Poses(rotation_from_quaternion(values[3:]), values[:3])
    base, tool = _frames_of_targets(targets)
    return FlangeTargets(tuple(numbers), base @ poses @ tool.inverse(), tuple(unknown))


def values_at(program: Program, numbers: Sequence[int], flange: Poses) -> list[tuple[float, ...]]:
    """Return the values of targets (x, y, z and quaternion) that bring the flange to poses in the robot's base frame.

    Args:
        program: Program of the targets.
        numbers: Index of each target, as of :attr:`FlangeTargets.numbers`.
        flange: Poses over the same targets.
    """
    base, tool = _frames_of_targets([program.targets[i] for i in numbers])
    poses = base.inverse() @ flange @ tool
    columns = np.concatenate((poses.translation, quaternion_from_rotation(poses.rotation)))
    return [tuple(column) for column in columns.T.tolist()]


def joint_targets(program: Program) -> tuple[tuple[int, ...], Array]:
    """Return the indices of a program's joint targets, and their joint variables ``(J, N)``, rad and m.

    Raises:
        ValueError: Targets have different numbers of joints.
    """
    numbers = tuple(i for i, target in enumerate(program.targets) if target.kind == "joint")
    rows = [program.targets[i].values for i in numbers]
    if len({len(row) for row in rows}) > 1:
        raise ValueError("the joint targets have different numbers of joints")
    return numbers, np.array(rows, dtype=float).T if rows else np.empty((0, 0))


def _unknown(frame: ProgramFrame | None, kind: str) -> str:
    """Return why a frame is unknown; empty where it is known."""
    if frame is None:
        return f"the program names no {kind}, or several, for this target"
    return f"the {kind} {frame.name} is in none of the files read" if frame.frame is None else ""


def _frames_of_targets(targets: Sequence[ProgramTarget]) -> tuple[Poses, Poses]:
    """Return base and tool of each target over N."""
    bases = [target.base.frame for target in targets if target.base and target.base.frame]
    tools = [target.tool.frame for target in targets if target.tool and target.tool.frame]
    return _poses(bases), _poses(tools)


def _poses(frames: Sequence[Frame]) -> Poses:
    xyz = np.array([frame.xyz for frame in frames], dtype=float).reshape(-1, 3).T
    rpy = np.array([frame.rpy for frame in frames], dtype=float).reshape(-1, 3).T
    return Poses(rotation_from_rpy(rpy), xyz)
