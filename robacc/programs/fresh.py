"""New programs with given targets: one motion to each, slow, with a stop for the measurement."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from robacc.errors import UsageError
from robacc.programs.conventions import Convention, to_native
from robacc.programs.program import Dialect, ProgramTarget

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
