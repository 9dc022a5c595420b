"""Program put together from what a dialect's reader found: values in SI units, and each target's motions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from robacc.geometry import Array, rotation_from_quaternion, rpy_from_rotation
from robacc.programs.conventions import Convention, to_values
from robacc.programs.program import (
    Dialect,
    MotionType,
    Program,
    ProgramFrame,
    ProgramMove,
    ProgramNote,
    ProgramNumber,
    ProgramTarget,
    TargetKind,
)
from robacc.programs.source import ProgramSource
from robacc.robots.description import Frame

_LARGEST = 1e6
"""Largest number of a target in the program's unit that is taken for one; above it, numbers stand for no value."""


@dataclass(slots=True)
class Draft:
    """Findings of a reader, to be assembled into a program."""

    source: ProgramSource
    dialect: Dialect
    targets: list[ProgramTarget] = field(default_factory=list)
    moves: list[ProgramMove] = field(default_factory=list)
    notes: list[ProgramNote] = field(default_factory=list)
    tools: dict[str, Frame] = field(default_factory=dict)
    bases: dict[str, Frame] = field(default_factory=dict)

    def note(self, start: int, end: int, reason: str) -> None:
        """Add a part of the text that is left as it is."""
        self.notes.append(ProgramNote(self.source.line(start), self.source.excerpt(start, end), reason))

    def add(
        self,
        name: str,
        convention: Convention,
        numbers: Sequence[ProgramNumber],
        *,
        configuration: str = "",
        external: str = "",
        tool: ProgramFrame | None = None,
        base: ProgramFrame | None = None,
    ) -> int | None:
        """Add a target, its values still missing; return its index, or None for numbers that are no target."""
        start = numbers[0].start
        line = self.source.line(start)
        if any(not abs(number.value) < _LARGEST for number in numbers):
            self.note(start, numbers[-1].end, "a number of this target is a placeholder")
            return None
        kind: TargetKind = "joint" if convention is Convention.joints else "cartesian"
        name = self.source.name(name) or f"line {line}"
        target = ProgramTarget(
            name, line, kind, (), convention, tuple(numbers), configuration, tool, base, None, external
        )
        self.targets.append(target)
        return len(self.targets) - 1

    def move(
        self,
        position: int,
        target: int | None,
        motion: MotionType,
        tool: ProgramFrame | None = None,
        base: ProgramFrame | None = None,
    ) -> None:
        """Add a motion to a target of this draft."""
        if target is not None:
            self.moves.append(ProgramMove(self.source.line(position), target, motion, tool, base))

    def program(self, dropped: Mapping[int, str] | None = None) -> Program:
        """Return the program; ``dropped`` targets become notes with their reasons."""
        dropped = dropped or {}
        for index, reason in dropped.items():
            numbers = self.targets[index].numbers
            note = ProgramNote(
                self.source.line(numbers[0].start),
                f"{self.targets[index].name}: {self.source.excerpt(numbers[0].start, numbers[-1].end)}",
                reason,
            )
            self.notes.append(note)
        kept = sorted(
            (i for i in range(len(self.targets)) if i not in dropped), key=lambda i: self.targets[i].numbers[0].start
        )
        places = {index: place for place, index in enumerate(kept)}
        moves = tuple(replace(move, target=places[move.target]) for move in self.moves if move.target in places)
        targets = _with_values([self.targets[i] for i in kept])
        return Program(
            self.source.file,
            self.dialect,
            self.source,
            tuple(_with_motions(targets, moves)),
            moves,
            tuple(sorted(self.notes, key=lambda note: note.line)),
            self.tools,
            self.bases,
        )


def frame_of(convention: Convention, native: Sequence[float]) -> Frame:
    """Return a frame from numbers of ``convention`` in m and rad."""
    values = to_values(convention, np.array(native, dtype=float)[:, None])
    roll, pitch, yaw = (float(angle) + 0.0 for angle in rpy_from_rotation(rotation_from_quaternion(values[3:]))[:, 0])
    x, y, z = (float(value) for value in values[:3, 0])
    return Frame((x, y, z), (roll, pitch, yaw))


def _with_values(targets: Sequence[ProgramTarget]) -> list[ProgramTarget]:
    """Return the targets with their values, converted for all targets of a convention at once."""
    result = list(targets)
    groups: dict[tuple[Convention, int], list[int]] = {}
    for i, target in enumerate(targets):
        groups.setdefault((target.convention, len(target.numbers)), []).append(i)
    for (convention, _), rows in groups.items():
        values = to_values(convention, native_of([targets[i] for i in rows]))
        for i, column in zip(rows, values.T.tolist(), strict=True):
            result[i] = replace(targets[i], values=tuple(column))
    return result


def native_of(targets: Sequence[ProgramTarget]) -> Array:
    """Return the programs' numbers ``(components, N)`` of targets of one convention, m and rad."""
    rows = [[number.value * number.unit for number in target.numbers] for target in targets]
    return np.array(rows, dtype=float).T


def _with_motions(targets: Sequence[ProgramTarget], moves: Iterable[ProgramMove]) -> list[ProgramTarget]:
    """Return the targets with what all motions to each have in common."""
    by_target: dict[int, list[ProgramMove]] = {}
    for move in moves:
        by_target.setdefault(move.target, []).append(move)
    result = []
    for i, target in enumerate(targets):
        used = by_target.get(i, [])
        if used:
            target = replace(
                target,
                motion=used[0].motion if len({move.motion for move in used}) == 1 else None,
                tool=target.tool or _common([move.tool for move in used]),
                base=target.base or _common([move.base for move in used]),
            )
        result.append(target)
    return result


def _common(frames: Sequence[ProgramFrame | None]) -> ProgramFrame | None:
    return frames[0] if all(frame == frames[0] for frame in frames) else None
