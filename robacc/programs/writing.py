"""Programs with other numbers in their targets, everything else byte for byte."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.programs.assemble import native_of
from robacc.programs.conventions import Convention, rotation_distance, to_native
from robacc.programs.digits import edit
from robacc.programs.program import Dialect, Program, ProgramNumber

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
                part = edit(program.source, number, value, _decimals(program.dialect, number, c), bare_point)
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


def _decimals(dialect: Dialect, number: ProgramNumber, component: int) -> int:
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
