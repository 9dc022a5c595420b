"""Programs with other numbers in their targets, everything else byte for byte, and new programs."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.programs.program import (
    FIXED_XYZ,
    QUATERNION,
    ROTATION_VECTOR,
    ZYX,
    Convention,
    Dialect,
    Program,
    ProgramNumber,
    ProgramSource,
    ProgramTarget,
    by_convention,
    native_of,
    rotation_distance,
    to_native,
)

# Numbers written as the program writes them: decimals, column width, sign and leading zero.


def edit(
    source: ProgramSource, number: ProgramNumber, value: float, decimals: int, bare_point: bool
) -> tuple[int, int, str] | None:
    """Return the edit ``(start, end, text)`` that gives a number the ``value`` (program's unit); None for no change.

    Args:
        source: Text of the program.
        number: Number to change.
        value: New value.
        decimals: Least decimals; a number with more keeps them.
        bare_point: Omit the zero before the decimal point.
    """
    old = source.text[number.start : number.end]
    decimals = max(decimals, 0 if "e" in old.lower() else len(old.partition(".")[2]))
    new = f"{value:.{decimals}f}"
    if float(new) == number.value or new == f"{number.value:.{decimals}f}":
        return None
    if float(new) == 0 and new.startswith("-"):
        new = new[1:]
    if bare_point:
        new = re.sub(r"^(-?)0\.", r"\1.", new)
    if old.startswith("+") and not new.startswith("-"):
        new = f"+{new}"
    start = number.start
    spaces = start
    while spaces > 0 and source.text[spaces - 1] == " ":
        spaces -= 1
    if start - spaces >= 2:
        # A column that is aligned to the right: the spaces give way, all but the last.
        start = spaces + 1
        new = new.rjust(number.end - start)
    return start, number.end, new


_LENGTH_DIGITS = 1e-7
"""Resolution of written lengths, m: a tenth of the micrometre that a correction converges to."""
_ANGLE_DIGITS = 2e-7
"""Resolution of written angles, rad."""
_QUATERNION_DECIMALS = 8
_FANUC_DECIMALS = 3
"""Decimals of every number in a .LS file, whose columns have a fixed width."""
_SAME = 1e-12
"""Change in m, rad or of a quaternion below which a target keeps its text."""


def with_targets(program: Program, values: Sequence[Sequence[float] | None]) -> bytes:
    """Return the program's bytes with other values in its targets.

    Numbers keep their decimals, and get more where they have fewer than the correction needs. A target whose values do
    not change keeps its text.

    Args:
        program: Program as read.
        values: For each target its new ``values``, in the order of ``program.targets``; None leaves a target alone.

    Raises:
        ValueError: The number of values is not that of the targets or of a target's values.
    """
    edits: list[tuple[int, int, str]] = []
    text = program.source.text
    # A program with a .5 for 0.5 has all numbers so.
    bare_point = any(text[n.start : n.end].lstrip("+-").startswith(".") for t in program.targets for n in t.numbers)
    changed = {}
    for i, (target, new) in enumerate(zip(program.targets, values, strict=True)):
        if new is not None and len(new) != len(target.values):
            raise ValueError(f"target {target.name} has {len(target.values)} values, not {len(new)}")
        if new is not None:
            changed[i] = target
    for convention, rows in by_convention(changed):
        targets = [changed[i] for i in rows]
        wanted = np.array([values[i] for i in rows], dtype=float).T
        old = np.array([target.values for target in targets], dtype=float).T
        native = to_native(convention, wanted, native_of(targets))
        turned, moved = _changes(convention, old, wanted)
        for k, target in enumerate(targets):
            for c, number in enumerate(target.numbers):
                if not (moved[k] if convention is None or c < 3 else turned[k]):
                    continue
                value = float(native[c, k]) / number.unit
                part = edit(program.source, number, value, _least_decimals(program.dialect, number, c), bare_point)
                if part is not None:
                    edits.append(part)
    return program.source.replaced(edits)


def _changes(convention: Convention | None, old: Array, new: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return for each target whether its orientation, and whether its position or joints change."""
    if convention is None:
        moved = np.any(np.abs(new - old) > _SAME, axis=0)
        return moved, moved
    unit = new[3:] / np.sqrt(np.sum(np.square(new[3:]), axis=0))
    # Quaternions of equal rotations agree to rounding, and the angle between them to four times that.
    return rotation_distance(old[3:], unit) > 4 * _SAME, np.any(np.abs(new[:3] - old[:3]) > _SAME, axis=0)


def _least_decimals(dialect: str, number: ProgramNumber, component: int) -> int:
    """Return the least decimals of a number."""
    if dialect == Dialect.fanuc:
        return _FANUC_DECIMALS
    if number.unit == 1.0 and dialect == Dialect.rapid:
        return _QUATERNION_DECIMALS
    resolution = _ANGLE_DIGITS if number.unit != 1e-3 and (component >= 3 or number.unit < 1) else _LENGTH_DIGITS
    return max(0, round(-float(np.log10(resolution / number.unit))))


# New programs with given targets: one motion to each, slow, with a stop for the measurement.

_MOST_JOINTS = 6
_WRITTEN = "written by robacc: check the speed, the {} and every motion before you run it"


@dataclass(frozen=True, slots=True, kw_only=True)
class _NewProgram:
    """Text of a new program; formats of a target take its number ``k``, its numbers and its comment."""

    suffix: str
    convention: Convention
    line_end: str = "\r\n"
    units: tuple[float, float] = (1e3, 180 / np.pi)
    """Of a length in m and an angle in rad."""
    program: str
    """Whole text, with the lines of ``data`` and of ``moves``."""
    line: str = "{line}"
    """Line of ``moves``."""
    wait: str
    joint: tuple[str, str]
    """Line or lines of data, and of motions, of a joint target."""
    cartesian: tuple[str, str]
    keys: str = ""
    """Names of the numbers of a Cartesian target."""
    entries: tuple[str, str, str] = ("{value}",) * 3
    """Format of a joint, of a length, and of another number of a Cartesian target."""
    decimals: tuple[int, int, int]
    comma: str = ","
    halves: tuple[str, str] = (",", ",")
    """Text between the first three numbers and the others of a joint target, and of a Cartesian one."""
    configuration: str = "{}"
    no_configuration: str = ""


_UNUSED = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
_LAYOUTS: dict[str, _NewProgram] = {
    Dialect.krl: _NewProgram(
        suffix=".src",
        convention=ZYX,
        program=f"&ACCESS RVP\nDEF {{name}}( )\n; {_WRITTEN.format('tool')}\nBAS (#INITMOV,0)\n"
        + "".join(f"$VEL_AXIS[{i + 1}]={{percent}}\n" for i in range(6))
        + "$VEL.CP={speed:.3f}\n{moves}\nEND\n",
        wait="WAIT SEC {pause:g}",
        joint=("", "; {comment}\nPTP {{{numbers}}}"),
        cartesian=("", "; {comment}\nLIN {{{numbers}{configuration}}}"),
        keys="XYZABC",
        entries=("A{key} {value}", "{key} {value}", "{key} {value}"),
        decimals=(5, 4, 5),
        configuration=",{}",
    ),
    Dialect.rapid: _NewProgram(
        suffix=".mod",
        convention=QUATERNION,
        program=f"MODULE {{name}}\n  ! {_WRITTEN.format('tool')}\n"
        "{data}\n\n  PROC main()\n{moves}\n  ENDPROC\nENDMODULE\n",
        wait="    WaitTime \\InPos,{pause:g};",
        joint=(
            f"  CONST jointtarget jt{{k}}:=[[{{numbers}}],{_UNUSED}]; ! {{comment}}",
            "    MoveAbsJ jt{k}\\NoEOffs,v{preset},fine,tool0;",
        ),
        cartesian=(
            f"  CONST robtarget rt{{k}}:=[[{{numbers}}],{{configuration}},{_UNUSED}]; ! {{comment}}",
            "    MoveL rt{k},v{preset},fine,tool0;",
        ),
        decimals=(5, 4, 8),
        halves=(",", "],["),
        no_configuration="[0,0,0,0]",
    ),
    Dialect.fanuc: _NewProgram(
        suffix=".ls",
        convention=FIXED_XYZ,
        program='/PROG  {NAME}\n/ATTR\nOWNER\t\t= MNEDITOR;\nCOMMENT\t\t= "robacc";\nPROTECT\t\t= READ_WRITE;\n'
        "DEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n{moves}\n/POS\n{data}\n/END\n",
        line="{i:4d}:{line} ;",
        wait="  WAIT {pause:6.2f}(sec)",
        joint=("P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t{numbers}\n}};", "J P[{k}] {percent}% FINE"),
        cartesian=(
            "P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\tCONFIG : '{configuration}',\n\t{numbers}\n}};",
            "L P[{k}] {mm_per_s:.0f}mm/sec FINE",
        ),
        keys="XYZWPR",
        entries=("J{key}= {value:>9} deg", "{key} = {value:>9}  mm", "{key} = {value:>9} deg"),
        decimals=(3, 3, 3),
        comma=",\t",
        halves=(",\n\t", ",\n\t"),
        no_configuration="N U T, 0, 0, 0",
    ),
    Dialect.urscript: _NewProgram(
        suffix=".script",
        convention=ROTATION_VECTOR,
        line_end="\n",
        units=(1.0, 1.0),
        program=f"def {{name}}():\n  # {_WRITTEN.format('TCP')}\n{{moves}}\nend\n",
        wait="  sleep({pause:g})",
        joint=("", "  # {comment}\n  movej([{numbers}], a=0.5, v={rad_per_s:.3f})"),
        cartesian=("", "  # {comment}\n  movel(p[{numbers}], a=0.5, v={speed:.3f})"),
        decimals=(7, 7, 7),
    ),
}
SUFFIX = {dialect: layout.suffix for dialect, layout in _LAYOUTS.items()}
"""Suffix of a new program."""
_PRESETS = (5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000)
"""Predefined speeds of RAPID, mm/s."""


def joint_target(name: str, q: Sequence[float]) -> ProgramTarget:
    """Return a target for :func:`write_program` from joint variables in rad and m."""
    return ProgramTarget(None, (), name=name, values=tuple(float(value) for value in q))


def cartesian_target(name: str, values: Sequence[float], configuration: str = "") -> ProgramTarget:
    """Return a target for :func:`write_program` from x, y, z (m) and the quaternion w, x, y, z."""
    return ProgramTarget(QUATERNION, (), configuration, name=name, values=tuple(float(value) for value in values))


def write_program(
    dialect: str,
    targets: Sequence[ProgramTarget],
    *,
    name: str = "robacc",
    speed: float = 0.1,
    pause: float = 2.0,
    linear: Collection[int] = (),
) -> str:
    """Return the text of a new program that goes to each target and waits there.

    Joint targets are driven to joint by joint, Cartesian ones in a straight line, with tool and base of the controller.

    Args:
        dialect: Language of the program.
        targets: Targets of :func:`joint_target` or :func:`cartesian_target`, or of a program that was read.
        name: Name of the program.
        speed: Speed as a fraction of the largest, 0 to 1.
        pause: Time to wait at each target, s.
        linear: Numbers of the prismatic joints, counted from 0.

    Raises:
        UsageError: The dialect is not in :data:`SUFFIX`.
        UsageError: A target has more joints than the dialect's targets, or the speed is not in (0, 1].
    """
    if dialect not in SUFFIX:
        raise UsageError(f"robacc writes no new {dialect} program; choose {', '.join(SUFFIX)}")
    if not 0 < speed <= 1:
        raise UsageError(f"a speed of {speed:g} is not a fraction of the largest; give a number above 0 and at most 1")
    if not pause >= 0:
        raise UsageError(f"a pause of {pause:g} s cannot be waited for; give a number of seconds that is not negative")
    layout = _LAYOUTS[dialect]
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII) or "robacc"
    identifier = identifier if identifier[0].isalpha() else f"p{identifier}"
    words = {
        "name": identifier,
        "NAME": identifier.upper()[:36],
        "speed": speed,
        "pause": pause,
        "percent": max(1, round(100 * speed)),
        "mm_per_s": 1000 * speed,
        "rad_per_s": 3.14 * speed,
        # The fastest of RAPID's speeds that is at most that fraction of 1 m/s.
        "preset": max([v for v in _PRESETS if v <= 1000 * speed], default=_PRESETS[0]),
    }
    data: list[str] = []
    moves: list[str] = []
    for k, target in enumerate(targets, start=1):
        text = {
            "k": k,
            "numbers": _numbers(dialect, target, frozenset(linear)),
            "comment": re.sub(r"[^\x20-\x7e]", "?", target.name)[:60],
            "configuration": layout.configuration.format(target.configuration)
            if target.configuration
            else layout.no_configuration,
        }
        lines = layout.joint if target.kind == "joint" else layout.cartesian
        data.append(lines[0].format(**words, **text))
        moves += lines[1].format(**words, **text).split("\n")
        if pause:
            moves.append(layout.wait.format(**words))
    numbered = [layout.line.format(i=i, line=line) for i, line in enumerate(moves, start=1)]
    whole = layout.program.format(**words, data="\n".join(data), moves="\n".join(numbered))
    return whole.replace("\n", layout.line_end)


def _numbers(dialect: str, target: ProgramTarget, linear: frozenset[int]) -> str:
    """Return the numbers of a target in the dialect's units, as it writes them.

    Raises:
        UsageError: The target has more joints, or fewer, than the dialect's targets.
    """
    layout, values, n = _LAYOUTS[dialect], list(target.values), len(target.values)
    length, angle = layout.units
    if target.kind == "joint":
        if n > _MOST_JOINTS or not n:
            raise UsageError(
                f"target {target.name} has {n} joints; a {dialect} program's targets have 1 to {_MOST_JOINTS}"
            )
        if dialect == Dialect.urscript and n != _MOST_JOINTS:
            raise UsageError(f"target {target.name} has {n} joints; a URScript target has 6")
        if dialect == Dialect.rapid:
            values += [0.0] * (_MOST_JOINTS - n)
        parts = [(str(i + 1), 0, value * (length if i in linear else angle)) for i, value in enumerate(values)]
    else:
        near = np.zeros((7 if layout.convention is QUATERNION else 6, 1))
        native = to_native(layout.convention, np.array(values)[:, None], near)[:, 0].tolist()
        turn = 1.0 if layout.convention is QUATERNION else angle
        keys = layout.keys or " " * len(native)
        parts = [
            (key, 1 if i < 3 else 2, value * (length if i < 3 else turn))
            for i, (key, value) in enumerate(zip(keys, native, strict=True))
        ]
    entries = []
    for key, kind, value in parts:
        text = f"{value:.{layout.decimals[kind]}f}"
        text = text.removeprefix("-") if float(text) == 0 else text
        text = re.sub(r"^(-?)0\.", r"\1.", text) if dialect == Dialect.fanuc else text
        entries.append(layout.entries[kind].format(key=key, value=text))
    halves = (layout.comma.join(entries[:3]), layout.comma.join(entries[3:]))
    return layout.halves[target.kind != "joint"].join(filter(None, halves))
