"""Programs with other numbers in their targets, everything else byte for byte, and new programs."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from typing import Any

import numpy as np

from robacc.errors import UsageError
from robacc.programs.program import (
    Dialect,
    Program,
    ProgramNumber,
    ProgramSource,
    by_convention,
    native_of,
    rotation_distance,
)

# Numbers written as the program writes them: decimals, column width, sign and leading zero.


def _edit(
    source: ProgramSource, number: ProgramNumber, value: float, decimals: int, bare_point: bool
) -> Iterator[tuple[int, int, str]]:
    """Yield the edit ``(start, end, text)`` that gives a number the ``value`` (program's unit), if it changes.

    Args:
        source: Text of the program.
        number: Number to change.
        value: New value.
        decimals: Least decimals; a number with more keeps them.
        bare_point: Omit the zero before the decimal point.
    """
    start, end = number.start, number.end
    old = source.text[start:end]
    decimals = max(decimals, 0 if "e" in old.lower() else len(old.partition(".")[2]))
    new = f"{value:.{decimals}f}"
    if float(new) == number.value or new == f"{number.value:.{decimals}f}":
        return
    new = _shortened(new, bare_point)
    if old.startswith("+") and not new.startswith("-"):
        new = f"+{new}"
    before = source.text[max(start - 80, 0) : start]
    spaces = len(before) - len(before.rstrip(" "))
    if spaces >= 2:
        # A column that is aligned to the right: the spaces give way, all but the last.
        start -= spaces - 1
        new = new.rjust(end - start)
    yield start, end, new


def _shortened(number: str, bare_point: bool) -> str:
    """Return a number without the sign of a zero and, with ``bare_point``, without the zero before its point."""
    unsigned = number.removeprefix("-") if float(number) == 0 else number
    return re.sub(r"^(-?)0\.", r"\1.", unsigned) if bare_point else unsigned


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
        ValueError: The number of values is not that of the targets.
    """
    edits: list[tuple[int, int, str]] = []
    text = program.source.text
    # A program with a .5 for 0.5 has all numbers so.
    bare_point = any(text[n.start : n.end].lstrip("+-").startswith(".") for t in program.targets for n in t.numbers)
    pairs = enumerate(zip(program.targets, values, strict=True))
    changed = {i: target for i, (target, new) in pairs if new is not None}
    for convention, rows in by_convention(changed):
        targets = [changed[i] for i in rows]
        wanted = np.array([values[i] for i in rows], dtype=float).T
        old = np.array([target.values for target in targets], dtype=float).T
        is_moved = np.any(np.abs(wanted - old)[: None if convention is None else 3] > _SAME, axis=0)
        native, is_new = wanted, np.repeat(is_moved[None], len(targets[0].numbers), axis=0)
        if convention is not None:
            native = np.concatenate((wanted[:3], convention.numbers(wanted[3:], native_of(targets)[3:])))
            unit = wanted[3:] / np.sqrt(np.sum(np.square(wanted[3:]), axis=0))
            # Quaternions of equal rotations agree to rounding, and the angle between them to four times that.
            is_new[3:] = rotation_distance(old[3:], unit) > 4 * _SAME
        for c, k in np.argwhere(is_new).tolist():
            number = targets[k].numbers[c]
            resolution = _ANGLE_DIGITS if number.unit != 1e-3 and (c >= 3 or number.unit < 1) else _LENGTH_DIGITS
            decimals = max(0, round(-float(np.log10(resolution / number.unit))))
            if program.dialect == Dialect.rapid and number.unit == 1.0:
                decimals = _QUATERNION_DECIMALS
            decimals = _FANUC_DECIMALS if program.dialect == Dialect.fanuc else decimals
            edits += _edit(program.source, number, float(native[c, k]) / number.unit, decimals, bare_point)
    return program.source.replaced(edits)


# New programs that go to given joints: one motion to each, slow, with a stop for the measurement.

_JOINTS = 6
_UNUSED = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"


_LAYOUT = {
    "data": "",
    "line": "{line}",
    "number": "{value}",
    "decimals": 5,
    "comma": ",",
    "half": ",",
    "units": (1e3, 180 / np.pi),
    "joints": range(1, _JOINTS + 1),
    "padded": 0,
    "line_end": "\r\n",
}
"""What most dialects share of a new program's layout.

``suffix``
    of the file
``program``
    whole text, with its ``{name}`` and the lines of ``{data}`` and of ``{moves}``
``data``
    data of the target number ``k``, with its ``{numbers}`` and its ``{comment}``
``move``, ``wait``
    lines of the motion to it, and of the stop
``line``
    a line of the motions and waits, of number ``i``
``number``, ``decimals``, ``units``
    a number of joint ``key``; of a length in m and an angle in rad
``comma``, ``half``
    text between numbers, and between the third and the fourth
``joints``, ``padded``
    numbers of joints that a target may have, the text that says so (``has``), and the number to which zeros fill it up
"""
_LAYOUTS: dict[str, dict[str, Any]] = {
    Dialect.krl: {
        **_LAYOUT,
        "has": f"a krl program's targets have 1 to {_JOINTS}",
        "suffix": ".src",
        "program": "&ACCESS RVP\nDEF {name}( )\n"
        "; written by robacc: check the speed, the tool and every motion before you run it\nBAS (#INITMOV,0)\n"
        + "".join(f"$VEL_AXIS[{i + 1}]=10\n" for i in range(_JOINTS))
        + "$VEL.CP=0.100\n{moves}\nEND\n",
        "move": "; {comment}\nPTP {{{numbers}}}",
        "wait": "WAIT SEC 2",
        "number": "A{key} {value}",
    },
    Dialect.rapid: {
        **_LAYOUT,
        "has": f"a rapid program's targets have 1 to {_JOINTS}",
        "padded": _JOINTS,
        "suffix": ".mod",
        "program": "MODULE {name}\n"
        "  ! written by robacc: check the speed, the tool and every motion before you run it\n"
        "{data}\n\n  PROC main()\n{moves}\n  ENDPROC\nENDMODULE\n",
        "data": f"  CONST jointtarget jt{{k}}:=[[{{numbers}}],{_UNUSED}]; ! {{comment}}",
        "move": "    MoveAbsJ jt{k}\\NoEOffs,v100,fine,tool0;",
        "wait": "    WaitTime \\InPos,2;",
    },
    Dialect.fanuc: {
        **_LAYOUT,
        "has": f"a fanuc program's targets have 1 to {_JOINTS}",
        "suffix": ".ls",
        "program": '/PROG  {NAME}\n/ATTR\nOWNER\t\t= MNEDITOR;\nCOMMENT\t\t= "robacc";\nPROTECT\t\t= READ_WRITE;\n'
        "DEFAULT_GROUP\t= 1,*,*,*,*;\n/MN\n{moves}\n/POS\n{data}\n/END\n",
        "data": "P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t{numbers}\n}};",
        "move": "J P[{k}] 10% FINE",
        "wait": "  WAIT   2.00(sec)",
        "line": "{i:4d}:{line} ;",
        "number": "J{key}= {value:>9} deg",
        "decimals": _FANUC_DECIMALS,
        "comma": ",\t",
        "half": ",\n\t",
    },
    Dialect.urscript: {
        **_LAYOUT,
        "joints": [_JOINTS],
        "has": f"a URScript target has {_JOINTS}",
        "suffix": ".script",
        "program": "def {name}():\n  # written by robacc: check the speed, the TCP and every motion before you run it\n"
        "{moves}\nend\n",
        "move": "  # {comment}\n  movej([{numbers}], a=0.5, v=0.314)",
        "wait": "  sleep(2)",
        "decimals": 7,
        "units": (1.0, 1.0),
        "line_end": "\n",
    },
}
SUFFIX = {dialect: layout["suffix"] for dialect, layout in _LAYOUTS.items()}
"""Suffix of a new program."""


def write_program(
    dialect: str,
    targets: Sequence[tuple[str, Sequence[float]]],
    *,
    name: str = "robacc",
    linear: Collection[int] = (),
) -> str:
    """Return the text of a new program that goes to each target, joint by joint, and waits there for 2 s.

    The speed is a tenth of the largest, and tool and base are those of the controller.

    Args:
        dialect: Language of the program.
        targets: Name and joint variables, rad and m, of each target.
        name: Name of the program.
        linear: Numbers of the prismatic joints, counted from 0.

    Raises:
        UsageError: The dialect is not in :data:`SUFFIX`, or a target has more joints, or fewer, than its targets have.
    """
    if dialect not in SUFFIX:
        raise UsageError(f"robacc writes no new {dialect} program; choose {', '.join(SUFFIX)}")
    layout = _LAYOUTS[dialect]
    data: list[str] = []
    moves: list[str] = []
    for k, (target, q) in enumerate(targets, start=1):
        if len(q) not in layout["joints"]:
            raise UsageError(f"target {target} has {len(q)} joints; {layout['has']}")
        values = [value * layout["units"][i not in linear] for i, value in enumerate(q)]
        values += [0.0] * (layout["padded"] - len(q))
        texts = [_shortened(f"{value:.{layout['decimals']}f}", dialect == Dialect.fanuc) for value in values]
        entries = [layout["number"].format(key=key, value=text) for key, text in enumerate(texts, start=1)]
        halves = (layout["comma"].join(half) for half in (entries[:3], entries[3:]) if half)
        comment = re.sub(r"[^\x20-\x7e]", "?", target)[:60]
        words = {"k": k, "numbers": layout["half"].join(halves), "comment": comment}
        data.append(layout["data"].format(**words))
        moves += [*layout["move"].format(**words).split("\n"), layout["wait"]]
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII) or "robacc"
    identifier = identifier if identifier[0].isalpha() else f"p{identifier}"
    lines = "\n".join(layout["line"].format(i=i, line=line) for i, line in enumerate(moves, start=1))
    whole: str = layout["program"].format(
        name=identifier, NAME=identifier.upper()[:36], data="\n".join(data), moves=lines
    )
    return whole.replace("\n", layout["line_end"])
