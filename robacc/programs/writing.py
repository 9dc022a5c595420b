"""Programs with other numbers in their targets, everything else byte for byte, and new programs."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.programs.program import (
    Convention,
    Dialect,
    Program,
    ProgramNumber,
    ProgramSource,
    ProgramTarget,
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
    decimals = max(decimals, _decimals_of_text(old))
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


def _decimals_of_text(text: str) -> int:
    if "e" in text.lower():
        return 0
    return len(text.partition(".")[2])


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
    bare_point = _omits_zero(program)
    groups: dict[tuple[Convention, int], list[int]] = {}
    for i, (target, new) in enumerate(zip(program.targets, values, strict=True)):
        if new is None:
            continue
        if len(new) != len(target.values):
            raise ValueError(f"target {target.name} has {len(target.values)} values, not {len(new)}")
        groups.setdefault((target.convention, len(target.numbers)), []).append(i)
    for (convention, _), rows in groups.items():
        targets = [program.targets[i] for i in rows]
        wanted = np.array([values[i] for i in rows], dtype=float).T
        old = np.array([target.values for target in targets], dtype=float).T
        native = to_native(convention, wanted, native_of(targets))
        turned, moved = _changes(convention, old, wanted)
        for k, target in enumerate(targets):
            for c, number in enumerate(target.numbers):
                changed = moved[k] if convention is Convention.joints or c < 3 else turned[k]
                if not changed:
                    continue
                value = float(native[c, k]) / number.unit
                part = edit(program.source, number, value, _least_decimals(program.dialect, number, c), bare_point)
                if part is not None:
                    edits.append(part)
    return program.source.replaced(edits)


def _changes(convention: Convention, old: Array, new: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return for each target whether its orientation, and whether its position or joints change."""
    if convention is Convention.joints:
        moved = np.any(np.abs(new - old) > _SAME, axis=0)
        return moved, moved
    unit = new[3:] / np.sqrt(np.sum(np.square(new[3:]), axis=0))
    # Quaternions of equal rotations agree to rounding, and the angle between them to four times that.
    return rotation_distance(old[3:], unit) > 4 * _SAME, np.any(np.abs(new[:3] - old[:3]) > _SAME, axis=0)


def _least_decimals(dialect: Dialect, number: ProgramNumber, component: int) -> int:
    """Return the least decimals of a number."""
    if dialect is Dialect.fanuc:
        return _FANUC_DECIMALS
    if number.unit == 1.0 and dialect is Dialect.rapid:
        return _QUATERNION_DECIMALS
    resolution = _ANGLE_DIGITS if number.unit != 1e-3 and (component >= 3 or number.unit < 1) else _LENGTH_DIGITS
    return max(0, round(-float(np.log10(resolution / number.unit))))


def _omits_zero(program: Program) -> bool:
    """Return whether a number of the program's targets is written .5 for 0.5."""
    text = program.source.text
    return any(text[n.start : n.end].lstrip("+-").startswith(".") for t in program.targets for n in t.numbers)


# New programs with given targets: one motion to each, slow, with a stop for the measurement.

_MOST_JOINTS = 6
_UNUSED = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
_CONVENTIONS = {
    Dialect.krl: Convention.zyx,
    Dialect.rapid: Convention.quaternion,
    Dialect.fanuc: Convention.fixed_xyz,
    Dialect.urscript: Convention.rotation_vector,
}
SUFFIX = {Dialect.krl: ".src", Dialect.rapid: ".mod", Dialect.fanuc: ".ls", Dialect.urscript: ".script"}
"""Suffix of a new program."""


def joint_target(name: str, q: Sequence[float]) -> ProgramTarget:
    """Return a target for :func:`write_program` from joint variables in rad and m."""
    return ProgramTarget(name, 0, "joint", tuple(float(value) for value in q), Convention.joints, ())


def cartesian_target(name: str, values: Sequence[float], configuration: str = "") -> ProgramTarget:
    """Return a target for :func:`write_program` from x, y, z (m) and the quaternion w, x, y, z."""
    pose = tuple(float(value) for value in values)
    return ProgramTarget(name, 0, "cartesian", pose, Convention.quaternion, (), configuration)


def write_program(
    dialect: Dialect,
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
        raise UsageError(f"robacc writes no new {dialect.value} program; choose {', '.join(SUFFIX)}")
    if not 0 < speed <= 1:
        raise UsageError(f"a speed of {speed:g} is not a fraction of the largest; give a number above 0 and at most 1")
    if not pause >= 0:
        raise UsageError(f"a pause of {pause:g} s cannot be waited for; give a number of seconds that is not negative")
    for target in targets:
        if target.kind == "joint" and (len(target.values) > _MOST_JOINTS or not target.values):
            raise UsageError(
                f"target {target.name} has {len(target.values)} joints; "
                f"a {dialect.value} program's targets have 1 to {_MOST_JOINTS}"
            )
        if target.kind == "joint" and dialect is Dialect.urscript and len(target.values) != _MOST_JOINTS:
            raise UsageError(f"target {target.name} has {len(target.values)} joints; a URScript target has 6")
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII) or "robacc"
    identifier = identifier if identifier[0].isalpha() else f"p{identifier}"
    writer = {Dialect.krl: _krl, Dialect.rapid: _rapid, Dialect.fanuc: _fanuc, Dialect.urscript: _urscript}[dialect]
    numbers = [_numbers(dialect, target, frozenset(linear)) for target in targets]
    return writer(targets, numbers, identifier, speed, pause)


def _numbers(dialect: Dialect, target: ProgramTarget, linear: frozenset[int]) -> list[float]:
    """Return the numbers of a target in the dialect's units."""
    length, angle = (1.0, 1.0) if dialect is Dialect.urscript else (1e3, 180 / np.pi)
    if target.kind == "joint":
        return [value * (length if i in linear else angle) for i, value in enumerate(target.values)]
    convention = _CONVENTIONS[dialect]
    near = np.zeros((convention.components, 1))
    native = to_native(convention, np.array(target.values)[:, None], near)[:, 0]
    scale = [length] * 3 + [1.0 if convention is Convention.quaternion else angle] * (len(native) - 3)
    return [float(value * factor) for value, factor in zip(native, scale, strict=True)]


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def _krl(
    targets: Sequence[ProgramTarget], numbers: Sequence[Sequence[float]], name: str, speed: float, pause: float
) -> str:
    lines = [
        "&ACCESS RVP",
        f"DEF {name}( )",
        "; written by robacc: check the speed, the tool and every motion before you run it",
        "BAS (#INITMOV,0)",
        *(f"$VEL_AXIS[{i + 1}]={max(1, round(100 * speed))}" for i in range(6)),
        f"$VEL.CP={speed:.3f}",
    ]
    for target, values in zip(targets, numbers, strict=True):
        keys = [f"A{i + 1}" for i in range(len(values))] if target.kind == "joint" else list("XYZABC")
        decimals = [5] * len(values) if target.kind == "joint" else [4, 4, 4, 5, 5, 5]
        entries = [f"{k} {_fixed(v, d)}" for k, v, d in zip(keys, values, decimals, strict=True)]
        if target.kind == "cartesian" and target.configuration:
            entries.append(target.configuration)
        lines.append(f"; {_comment(target.name)}")
        lines.append(f"{'PTP' if target.kind == 'joint' else 'LIN'} {{{','.join(entries)}}}")
        if pause:
            lines.append(f"WAIT SEC {pause:g}")
    return "\r\n".join([*lines, "END", ""])


def _rapid(
    targets: Sequence[ProgramTarget], numbers: Sequence[Sequence[float]], name: str, speed: float, pause: float
) -> str:
    lines = [f"MODULE {name}", "  ! written by robacc: check the speed, the tool and every motion before you run it"]
    moves = []
    for k, (target, values) in enumerate(zip(targets, numbers, strict=True), start=1):
        if target.kind == "joint":
            axes = ",".join(_fixed(v, 5) for v in [*values, *[0.0] * (6 - len(values))])
            lines.append(f"  CONST jointtarget jt{k}:=[[{axes}],{_UNUSED}]; ! {_comment(target.name)}")
            moves.append(f"    MoveAbsJ jt{k}\\NoEOffs,v{_rapid_speed(speed)},fine,tool0;")
        else:
            place = ",".join(_fixed(v, 4) for v in values[:3])
            turn = ",".join(_fixed(v, 8) for v in values[3:])
            configuration = target.configuration or "[0,0,0,0]"
            data = f"[[{place}],[{turn}],{configuration},{_UNUSED}]"
            lines.append(f"  CONST robtarget rt{k}:={data}; ! {_comment(target.name)}")
            moves.append(f"    MoveL rt{k},v{_rapid_speed(speed)},fine,tool0;")
        if pause:
            moves.append(f"    WaitTime \\InPos,{pause:g};")
    return "\r\n".join([*lines, "", "  PROC main()", *moves, "  ENDPROC", "ENDMODULE", ""])


def _rapid_speed(speed: float) -> int:
    """Return the predefined speed of at most that fraction of 1 m/s."""
    fixed = (5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000)
    return max([v for v in fixed if v <= 1000 * speed], default=5)


def _fanuc(
    targets: Sequence[ProgramTarget], numbers: Sequence[Sequence[float]], name: str, speed: float, pause: float
) -> str:
    program = name.upper()[:36]
    lines = [f"/PROG  {program}", "/ATTR", "OWNER\t\t= MNEDITOR;", 'COMMENT\t\t= "robacc";', "PROTECT\t\t= READ_WRITE;"]
    lines += ["DEFAULT_GROUP\t= 1,*,*,*,*;", "/MN"]
    moves, positions = [], []
    for k, (target, values) in enumerate(zip(targets, numbers, strict=True), start=1):
        is_joint = target.kind == "joint"
        moves.append(
            f"J P[{k}] {max(1, round(100 * speed))}% FINE" if is_joint else f"L P[{k}] {1000 * speed:.0f}mm/sec FINE"
        )
        if pause:
            moves.append(f"  WAIT {pause:6.2f}(sec)")
        positions += [f"P[{k}]{{", "   GP1:"]
        keys = [f"J{i + 1}" for i in range(len(values))] if is_joint else list("XYZWPR")
        units = ["deg"] * len(values) if is_joint else [" mm"] * 3 + ["deg"] * 3
        configuration = "" if is_joint else f"\t\tCONFIG : '{target.configuration or 'N U T, 0, 0, 0'}',"
        positions.append(f"\tUF : 0, UT : 1,{configuration}")
        cells = [_cell(key, value, unit, is_joint) for key, value, unit in zip(keys, values, units, strict=True)]
        rows = ["\t" + ",\t".join(cells[i : i + 3]) for i in range(0, len(cells), 3)]
        positions += [*(row + "," for row in rows[:-1]), rows[-1], "};"]
    program_lines = [f"{i:4d}:{text} ;" for i, text in enumerate(moves, start=1)]
    return "\r\n".join([*lines, *program_lines, "/POS", *positions, "/END", ""])


def _cell(key: str, value: float, unit: str, is_joint: bool) -> str:
    text = re.sub(r"^(-?)0\.", r"\1.", _fixed(value, 3))
    return f"{key}{'=' if is_joint else ' ='} {text:>9} {unit}"


def _urscript(
    targets: Sequence[ProgramTarget], numbers: Sequence[Sequence[float]], name: str, speed: float, pause: float
) -> str:
    lines = [f"def {name}():", "  # written by robacc: check the speed, the TCP and every motion before you run it"]
    for target, values in zip(targets, numbers, strict=True):
        lines.append(f"  # {_comment(target.name)}")
        text = ",".join(_fixed(value, 7) for value in values)
        if target.kind == "joint":
            lines.append(f"  movej([{text}], a=0.5, v={3.14 * speed:.3f})")
        else:
            lines.append(f"  movel(p[{text}], a=0.5, v={speed:.3f})")
        if pause:
            lines.append(f"  sleep({pause:g})")
    return "\n".join([*lines, "end", ""])


def _comment(text: str) -> str:
    return re.sub(r"[^\x20-\x7e]", "?", text)[:60]
