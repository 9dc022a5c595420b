"""Tools that the dialects of robot programs share: conventions, grammar, frames in force, and new programs.

The reader of a dialect is a table of patterns for its statements, and functions that say what a statement means. It
works on the text with blanks in place of comments and strings (:func:`mask`), so that a place in one is a place in the
other, and collects what it finds in a :class:`Draft`.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from robacc.errors import refuse
from robacc.geometry import (
    Array,
    NDArray,
    compose,
    exp_so3,
    log_so3,
    quaternion_from_rotation,
    rotation_about,
    rotation_from_quaternion,
    rotation_from_rpy,
    rpy_from_rotation,
)
from robacc.programs.program import (
    ConfigurationRules,
    Convention,
    Program,
    ProgramFrame,
    ProgramNote,
    ProgramNumber,
    ProgramSource,
    ProgramTarget,
    by_convention,
    native_of,
)
from robacc.programs.targets import N_AXES, shortened
from robacc.robots.arm import Arm

NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
"""Pattern of a number in every dialect."""


# Conventions of orientations.


def _nearest_quaternion(quaternion: Array, near: Array) -> Array:
    unit = quaternion / np.sqrt(np.sum(np.square(quaternion), axis=0))
    return np.asarray(np.where(np.sum(unit * near, axis=0) < 0, -unit, unit))


def _nearest_vector(quaternion: Array, near: Array) -> Array:
    vector = log_so3(rotation_from_quaternion(quaternion))
    # The axis of a zero rotation is free: a whole turn about the program's own axis.
    axis = np.where(np.any(vector != 0, axis=0), vector, near)
    length = np.sqrt(np.sum(np.square(axis), axis=0))
    turn = 2 * np.pi * axis / np.where(length > 0, length, 1.0)
    candidates = np.stack((vector, vector - turn, vector + turn))
    best = np.argmin(np.sum(np.square(candidates - near), axis=1), axis=0)
    return np.asarray(np.take_along_axis(candidates, best[None, None], axis=0)[0])


def nearest_angles(rotation: Array, near: Array) -> Array:
    """Return roll, pitch, yaw ``(3, N)`` of the solution nearest to ``near``, in the range that ``near`` is in."""
    first = rpy_from_rotation(rotation)
    pole = np.abs(np.abs(first[1]) - np.pi / 2) < 1e-9
    if np.any(pole):
        # Only yaw -+ roll is determined: keep the program's roll.
        upright = compose(rotation, np.swapaxes(rotation_about(0, near[0]), 0, 1))
        first = np.where(pole, np.stack((near[0], first[1], np.arctan2(-upright[0, 1], upright[1, 1]))), first)
    second = np.stack((first[0] + np.pi, np.pi - first[1], first[2] + np.pi))
    to_first, to_second = (np.sum(np.square(_wrapped(angles - near)), axis=0) for angles in (first, second))
    chosen = np.where(to_second < to_first, second, first)
    return np.where(np.abs(near) <= np.pi + 1e-9, _wrapped(chosen), near + _wrapped(chosen - near))


def _wrapped(angle: Array) -> Array:
    """Return angles in [-pi, pi]."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


ZYX = Convention(
    lambda angles: rotation_from_rpy(angles[::-1]),
    lambda quaternions, near: nearest_angles(rotation_from_quaternion(quaternions), near[::-1])[::-1],
)
"""x, y, z, A, B, C with R = Rz(A) Ry(B) Rx(C) (KUKA)."""
FIXED_XYZ = Convention(
    rotation_from_rpy, lambda quaternions, near: nearest_angles(rotation_from_quaternion(quaternions), near)
)
"""x, y, z, W, P, R with R = Rz(R) Ry(P) Rx(W) (FANUC)."""
QUATERNION = Convention(rotation_from_quaternion, _nearest_quaternion)
"""x, y, z, q1 … q4 with q1 the scalar part (ABB)."""
ROTATION_VECTOR = Convention(exp_so3, _nearest_vector)
"""x, y, z, rx, ry, rz with the rotation vector (Universal Robots)."""


# Grammar that all dialects share: places of arguments and numbers in the text, and the frames in force.

MM = 1e-3
DEGREE = np.pi / 180
POSE_UNITS = (MM, MM, MM, DEGREE, DEGREE, DEGREE)
"""Units of x, y, z and three angles, in the dialects that write mm and degrees."""
AXIS_UNITS = (DEGREE,) * 6
RUN_TIME = "the target is computed at run time"
ELSEWHERE = "the target's numbers are in none of the files read"
CHANGED = "the program assigns it at run time in line {}"

Place = tuple[int, int]
"""First character of a part of the text, and the one behind its last."""

_PUNCTUATION = re.compile(r"[\[\](){},\\]")
_NUMBER = re.compile(NUMBER)


def mask(text: str, hidden: re.Pattern[str]) -> str:
    """Return the text with spaces in place of every match of ``hidden`` (comments and strings), line ends kept."""
    return hidden.sub(lambda match: re.sub(r"[^\r\n]", " ", match[0]), text)


def stripped(text: str, place: Place) -> Place:
    """Return a place without the blanks at its ends."""
    part = text[slice(*place)]
    return place[1] - len(part.lstrip()), place[0] + len(part.rstrip())


def arguments(text: str, start: int, end: int | None = None) -> tuple[list[Place], int]:
    """Return the places between commas outside of brackets, and where they end.

    They end at ``end``, or before at a bracket that closes none of theirs. A switch of RAPID is a part of its own, with
    its backslash.
    """
    end = len(text) if end is None else end
    places, first, depth = [], start, 0
    for match in _PUNCTUATION.finditer(text, start, end):
        if match[0] in "[({":
            depth += 1
        elif match[0] in ",\\":
            if depth == 0:
                places.append((first, match.start()))
                first = match.start() + (match[0] == ",")
        elif depth:
            depth -= 1
        else:
            end = match.start()
            break
    return [stripped(text, place) for place in (*places, (first, end))], end


def items(text: str, place: Place) -> list[Place]:
    """Return the places of the parts of an aggregate ``[…]`` or ``{…}``; none for anything else."""
    start, end = stripped(text, place)
    parts, closed = arguments(text, start + 1, end)
    return parts if text[start:end][:1] in ("[", "{") and closed == end - 1 else []


def numbers(text: str, places: Sequence[Place], units: Sequence[float]) -> tuple[ProgramNumber, ...] | None:
    """Return the numbers at places, one for each unit; None where a part is no number, or one lacks or is too many."""
    if len(places) != len(units) or not all(_NUMBER.fullmatch(text, *place) for place in places):
        return None
    return tuple(
        ProgramNumber(*place, float(text[slice(*place)]), unit) for place, unit in zip(places, units, strict=True)
    )


def unclosed(blocks: Iterable[tuple[str, int, bool]]) -> list[tuple[str, int]]:
    """Return the word and place of each block that has no end; blocks are word, place and whether it opens one."""
    opened: list[tuple[str, int]] = []
    for word, position, opens in blocks:
        if opens:
            opened.append((word, position))
        elif opened:
            opened.pop()
    return opened


# Tool or base frame in force at each place of a program, where the text alone decides it.

EventKind = Literal["routine", "open", "loop", "next", "close", "set", "may set", "call"]


@dataclass(frozen=True, slots=True)
class FrameEvent:
    """Statement that matters for the frame in force: start of a routine, a block's ends, a call, or an assignment."""

    position: int
    kind: EventKind
    frame: ProgramFrame | None = None
    """Frame of an assignment; None where the program computes it."""
    name: str = ""
    """Name of a routine that starts or is called."""


def timeline(events: Sequence[FrameEvent]) -> Callable[[int], ProgramFrame | None]:
    """Return a function of a place that returns the frame in force there; None where the text leaves it open.

    A frame that is set inside a branch is unknown after the branch. One that is set inside a loop is unknown from the
    loop's head to the assignment, since the second turn begins with it, and after the loop. A routine that sets one,
    itself or by a call, leaves it unknown after its call.
    """
    setting: set[int | str] = set()
    before = -1
    while before < len(setting):
        before = len(setting)
        frames = _frames(events, setting)

    def at(position: int) -> ProgramFrame | None:
        k = bisect_right(events, position, key=lambda event: event.position) - 1
        return frames[k] if k >= 0 else None

    return at


def _frames(events: Sequence[FrameEvent], setting: set[int | str]) -> list[ProgramFrame | None]:
    """Return the frames after each event, and add the blocks (by place) and routines (by name) that set one."""
    result: list[ProgramFrame | None] = []
    current: ProgramFrame | None = None
    opened: list[tuple[FrameEvent, ProgramFrame | None]] = []
    for event in events:
        if event.kind in ("set", "may set") or (event.kind == "call" and event.name in setting):
            if event.kind != "may set":
                current = event.frame
            around = [block for block, _ in opened]
            routine = max((i for i, block in enumerate(around) if block.kind == "routine"), default=-1)
            setting |= {around[routine].name if routine >= 0 else "", *(b.position for b in around[routine + 1 :])}
        elif event.kind == "routine":
            opened.append((event, current))
            current = None
        elif event.kind in ("open", "loop"):
            current = None if event.kind == "loop" and event.position in setting else current
            opened.append((event, current))
        elif opened and event.kind == "next":
            current = opened[-1][1]
        elif opened and event.kind == "close":
            block, outer = opened.pop()
            if block.kind == "routine":
                current = outer  # a definition runs nothing
            elif block.position in setting:
                current = None
        result.append(current)
    return result


# Program put together from what a dialect's reader found: values in SI units, and each target's motions.


@dataclass(slots=True)
class Draft:
    """Findings of a reader, to be assembled into a program."""

    source: ProgramSource
    dialect: str
    targets: list[ProgramTarget] = field(default_factory=list)
    moves: list[tuple[int, ProgramFrame | None, ProgramFrame | None]] = field(default_factory=list)
    """Index of the target, tool and base of each motion."""
    notes: list[ProgramNote] = field(default_factory=list)
    dropped: dict[int, str] = field(default_factory=dict)
    """Reasons of targets that are left alone, by index."""
    configurations: ConfigurationRules = field(default_factory=ConfigurationRules)
    decimals: Mapping[float, int] = field(default_factory=dict)
    """See :class:`~robacc.programs.program.Program`; likewise the configurations."""

    def note(self, place: Place, reason: str) -> None:
        """Add a part of the text that is left as it is."""
        self.notes.append(ProgramNote(self.source.line(place[0]), self.source.excerpt(*place), reason))

    def add(
        self,
        name: str,
        target: ProgramTarget | None,
        place: Place = (0, 0),
        reason: str = "",
        *,
        tool: ProgramFrame | None = None,
        base: ProgramFrame | None = None,
    ) -> int | None:
        """Add the target that stands at a place; return its index, or None for numbers that are no target.

        These give a note with the ``reason``, if there is one.
        """
        # Larger numbers, in the program's unit, stand for no value.
        if target is not None and all(abs(number.value) < 1e6 for number in target.numbers):
            line = self.source.line(target.place[0])
            self.targets.append(replace(target, name=name or f"line {line}", line=line, tool=tool, base=base))
            return len(self.targets) - 1
        if target is not None:
            self.note(target.place, "a number of this target is a placeholder")
        if reason:
            self.note(place, reason)
        return None

    def move(
        self,
        place: Place,
        found: Iterable[int | None] | str,
        tool: ProgramFrame | None = None,
        base: ProgramFrame | None = None,
    ) -> None:
        """Add the motions of the instruction at a place to targets that were found, or a note why there is none."""
        if isinstance(found, str):
            self.note(place, found)
        else:
            self.moves += [(index, tool, base) for index in found if index is not None]

    def program(self) -> Program:
        """Return the program, its targets with their values and what all motions to each have in common."""
        for index, reason in self.dropped.items():
            target = self.targets[index]
            self.notes.append(ProgramNote(target.line, f"{target.name}: {self.source.excerpt(*target.place)}", reason))
        kept = sorted(set(range(len(self.targets))) - set(self.dropped), key=lambda i: self.targets[i].place)
        places = {index: place for place, index in enumerate(kept)}
        used: dict[int, list[tuple[object, ...]]] = {}
        for index, *circumstances in self.moves:
            used.setdefault(index, []).append(tuple(circumstances))
        targets = []
        for index in kept:
            target = self.targets[index]
            # What all motions to the target have in common.
            parts: Iterable[tuple[Any, ...]] = zip(*used.get(index, ((None,) * 2,)), strict=True)
            tool, base = (part[0] if len(set(part)) == 1 else None for part in parts)
            targets.append(replace(target, tool=target.tool or tool, base=target.base or base))
        for convention, rows in by_convention(dict(enumerate(targets))):
            values = native_of([targets[i] for i in rows])
            if convention is not None:
                values = np.concatenate((values[:3], quaternion_from_rotation(convention.rotation(values[3:]))))
            for i, column in zip(rows, values.T.tolist(), strict=True):
                targets[i] = replace(targets[i], values=tuple(column))
        return Program(
            self.source.file,
            self.dialect,
            self.source,
            tuple(targets),
            tuple(places[index] for index, *_ in self.moves if index in places),
            tuple(sorted(self.notes, key=lambda note: note.line)),
            self.configurations,
            self.decimals,
        )


# New programs that go to given joints: one motion to each, slow, with a stop for the measurement.

LAYOUT: Mapping[str, Any] = {
    "data": "",
    "line": "{line}",
    "number": "{value}",
    "decimals": 5,
    "bare_point": False,
    "comma": ",",
    "half": ",",
    "units": (1e3, 180 / np.pi),
    "joints": range(1, N_AXES + 1),
    "padded": 0,
    "line_end": "\r\n",
}
"""What most dialects share of a new program's layout.

``program``
    whole text, with its ``{name}`` and the lines of ``{data}`` and of ``{moves}``
``data``
    data of the target number ``k``, with its ``{numbers}`` and its ``{comment}``
``move``, ``wait``
    lines of the motion to it, and of the stop
``line``
    a line of the motions and waits, of number ``i``
``number``, ``decimals``, ``bare_point``, ``units``
    a number of joint ``key``; whether 0.5 is .5; of a length in m and an angle in rad
``comma``, ``half``
    text between numbers, and between the third and the fourth
``joints``, ``padded``
    numbers of joints that a target may have, the text that says so (``has``), and the number to which zeros fill it up
"""


def write_program(
    layout: Mapping[str, Any],
    targets: Sequence[tuple[str, Sequence[float]]],
    *,
    name: str = "robacc",
    linear: Collection[int] = (),
) -> str:
    """Return the text of a new program that goes to each target, joint by joint, and waits there for 2 s.

    The speed is a tenth of the largest, and tool and base are those of the controller.

    Args:
        layout: Layout of the language, as :data:`LAYOUT`.
        targets: Name and joint variables, rad and m, of each target.
        name: Name of the program.
        linear: Numbers of the prismatic joints, counted from 0.

    Raises:
        UsageError: A target has more joints, or fewer, than those of the language have.
    """
    data: list[str] = []
    moves: list[str] = []
    for k, (target, q) in enumerate(targets, start=1):
        refuse((len(q) not in layout["joints"], f"target {target} has {len(q)} joints; {layout['has']}"))
        values = [value * layout["units"][i not in linear] for i, value in enumerate(q)]
        values += [0.0] * (layout["padded"] - len(q))
        texts = [shortened(f"{value:.{layout['decimals']}f}", layout["bare_point"]) for value in values]
        entries = [layout["number"].format(key=key, value=text) for key, text in enumerate(texts, start=1)]
        halves = (layout["comma"].join(half) for half in (entries[:3], entries[3:]) if half)
        words = {"k": k, "numbers": layout["half"].join(halves), "comment": re.sub(r"[^\x20-\x7e]", "?", target)[:60]}
        data.append(layout["data"].format(**words))
        moves += [*layout["move"].format(**words).split("\n"), layout["wait"]]
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII) or "robacc"
    identifier = identifier if identifier[0].isalpha() else f"p{identifier}"
    lines = "\n".join(layout["line"].format(i=i, line=line) for i, line in enumerate(moves, start=1))
    whole: str = layout["program"].format(
        name=identifier, NAME=identifier.upper()[:36], data="\n".join(data), moves=lines
    )
    return whole.replace("\n", layout["line_end"])


# Sides of the wrist centre, by which configurations name a solution of the inverse kinematics.

_SPHERICAL = 1e-4
"""m: distance from their common point up to which the wrist axes count as intersecting."""


def on_sides(arm: Arm, q: Array, behind: bool, in_front: bool, negative: bool) -> NDArray[np.bool_]:
    """Return ``(N,)`` whether joints ``(J, N)`` lie on sides; all, for arms of other than six revolute axes.

    The sides of the wrist centre count where the wrist's three axes intersect.

    Args:
        arm: Nominal arm with the identity as its base frame.
        q: Joints, rad.
        behind: Whether the wrist centre is behind axis 1.
        in_front: Whether the wrist centre is in front of the straight line from axis 2 to axis 3.
        negative: Whether axis 5 is negative.
    """
    if q.shape[0] != N_AXES or not all(arm.is_revolute(name) for name in arm.names):
        return np.ones(q.shape[1], dtype=bool)
    measures = [(negative, -q[4])]
    if (sides := _sides(arm, q)) is not None:
        measures += [(behind, -sides[0]), (in_front, sides[1])]
    signed = np.array([value if is_on else -value for is_on, value in measures])
    # m or rad: distance from a border within which both sides count.
    return np.asarray(np.all(signed > -1e-4, axis=0))


def _sides(arm: Arm, q: Array) -> tuple[Array, Array] | None:
    """Return the wrist centre's place ``(N,)`` m in front of axis 1, and of the line from axis 2 to axis 3.

    None for a wrist whose axes do not intersect.
    """
    points, axes = _lines(arm, q)
    across = np.eye(3)[:, :, None, None] - axes[:, None, 3:] * axes[None, :, 3:]
    # The axes of a wrist in its singular pose are still three lines, two of which coincide.
    inverse = np.linalg.pinv(np.moveaxis(across.sum(axis=2), 2, 0), rcond=1e-9, hermitian=True)
    centre = np.einsum("nac,cbjn,bjn->an", inverse, across, points[:, 3:])
    misses = np.einsum("abjn,bjn->ajn", across, centre[:, None] - points[:, 3:])
    if float(np.linalg.norm(misses, axis=0).max(initial=0.0)) > _SPHERICAL:
        return None
    second = axes[:, 1]
    # In front is where axis 2 turns the upright arm: along axis 2 crossed with the base's z.
    first = second[1] * (centre - points[:, 0])[0] - second[0] * (centre - points[:, 0])[1]
    # The component along axis 2 of a cross product has no part of the free places of the points along that axis.
    link, forearm = points[:, 2] - points[:, 1], centre - points[:, 2]
    moment = np.einsum("an,an->n", second, np.cross(link, forearm, axis=0))
    length = np.linalg.norm(link - second * np.einsum("an,an->n", second, link), axis=0)
    return first, moment / np.maximum(length, _SPHERICAL)


def _lines(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return a point and the positive direction of each joint's axis, each ``(3, J, N)``, base frame."""
    joints = arm.robot.variables
    sweep = arm.chain.sweep(arm.chain.scalars(q), q.shape[1], [arm.axis_motion(joint.name) for joint in joints])
    turning, moving = sweep.jacobian[3:], sweep.jacobian[:3]
    points = sweep.poses.translation[:, None] - np.cross(moving, turning, axis=0)
    return points, turning * np.array([float(joint.sign) for joint in joints])[:, None]
