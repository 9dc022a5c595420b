"""Changes of the measured poses that undo a data mistake: units, axes, inverse poses, conventions of orientation."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robacc.geometry import (
    Array,
    log_so3,
    quaternion_from_rotation,
    rotate_back,
    rotation_from_quaternion,
    rpy_from_rotation,
    transpose,
)
from robacc.poses.angles import CONVENTIONS

UNITS = (
    (1e-3, "millimetres", "give the unit in their names, as in x_mm"),
    (1e-6, "micrometres", "give the unit in their names, as in x_um"),
    (1e3, "metres but marked as millimetres", "give the unit in their names, as in x_m"),
    (0.0254, "inches", "convert them, or give their unit"),
    (25.4, "inches but marked as millimetres", "convert them, or give their unit"),
)
"""Factor to metres, the unit, and the fix."""
_CLOSE = 0.3
"""Largest difference of an element of a rotation from that of a signed permutation."""
_READ_AS = {"fixed-xyz": "roll, pitch, yaw", "rotvec": "a rotation vector"}
_WRITTEN_AS = {
    "rotvec": "rotation vectors",
    "fixed-xyz": "angles about the fixed axes x, y, z",
    "moving-xyz": "angles about the moving axes x, y, z",
    "kuka-abc": "angles A, B, C about z, y, x",
    "zyz": "angles about the moving axes z, y, z",
}


@dataclass(frozen=True, slots=True)
class MeasuredPoses:
    """Measured poses with some mistakes undone."""

    position: Array
    """``(3, N)``, m"""
    rotation: Array | None
    """``(3, 3, N)``"""
    texts: tuple[str, ...] = ()
    fixes: tuple[str, ...] = ()
    complexity: int = 0
    """Number of mistakes."""
    mirrored: bool = False
    """Whether the first axis of the positions is reversed, so that a left-handed frame becomes right-handed."""

    def with_rotation(self, text: str, fix: str, rotation: Array) -> MeasuredPoses:
        """Return the poses with a wrong reading of the orientations undone."""
        texts, fixes = (*self.texts, text), (*self.fixes, fix)
        return dataclasses.replace(self, rotation=rotation, texts=texts, fixes=fixes, complexity=self.complexity + 1)

    def with_axes(self, text: str, fix: str, matrix: Array) -> MeasuredPoses:
        """Return the poses with wrong axes of the positions undone, which replaces the reversal of the first axis."""
        position, count = self.position, len(self.texts)
        if self.mirrored:
            position, count = position * np.array([[-1.0], [1.0], [1.0]]), count - 1
        texts, fixes = (*self.texts[:count], text), (*self.fixes[:count], fix)
        # A column reversed or an exchange is usual, all columns reversed is not.
        complexity = count + 1 + max(int(np.count_nonzero(matrix.sum(axis=0) < 0)) - 1, 0) ** 2
        return MeasuredPoses(matrix @ position, self.rotation, texts, fixes, complexity)


def measured_changes(position: Array, rotation: Array | None, expected_spread: float) -> list[MeasuredPoses]:
    """Return the measured poses as they are and with mistakes undone.

    Args:
        position: ``(3, N)`` m.
        rotation: ``(3, 3, N)``, or None.
        expected_spread: Standard deviation of the arm's own positions, m.
    """
    as_measured = MeasuredPoses(position, rotation)
    variants = [as_measured]
    spread = max(float(np.sqrt(np.var(position, axis=1).sum())), 1e-12)
    if not 1 / 3 < spread / expected_spread < 3:
        for factor, unit, fix in UNITS:
            if 1 / 3 < factor * spread / expected_spread < 3:
                variants.append(
                    MeasuredPoses(position * factor, rotation, (f"the positions seem to be in {unit}",), (fix,), 1)
                )
    if rotation is not None:
        variants.append(
            MeasuredPoses(
                -rotate_back(rotation, position),
                transpose(rotation),
                ("the measured poses seem to be inverted: the instrument's pose in the target's frame",),
                ("invert each measured pose",),
                1,
            )
        )
    left_handed = "the positions seem to be in a left-handed frame"
    advice = "look for a column with a reversed sign, or for two exchanged columns"
    mirrored = [
        MeasuredPoses(
            item.position * np.array([[-1.0], [1.0], [1.0]]),
            item.rotation,
            (*item.texts, left_handed),
            (*item.fixes, advice),
            item.complexity + 1,
            mirrored=True,
        )
        for item in variants
    ]
    return [*variants, *mirrored]


def orientation_changes(rotation: Array) -> Iterator[tuple[str, str, Array]]:
    """Yield the name, the fix and the orientations with a wrong reading undone."""
    quaternion = quaternion_from_rotation(rotation)
    yield (
        "the quaternions seem to be in the order x, y, z, w",
        "correct the names of the columns: qw is the scalar part",
        rotation_from_quaternion(np.roll(quaternion, 1, axis=0)),
    )
    yield (
        "the orientations seem to be inverted: of the measuring frame in the target's",
        "invert each orientation (for quaternions, reverse the signs of qx, qy, qz)",
        transpose(rotation),
    )
    numbers = {"fixed-xyz": rpy_from_rotation(rotation), "rotvec": log_so3(rotation)}
    for read_as, angles in numbers.items():
        for written_as, text in _WRITTEN_AS.items():
            if written_as != read_as:
                yield (
                    f"the orientations seem to be {text}, read as {_READ_AS[read_as]}",
                    f"give `angles`: {written_as}, or convert the columns",
                    CONVENTIONS[written_as](angles),
                )
        yield (
            f"the orientations seem to be {_READ_AS[read_as]} with the columns in the reverse order",
            "correct the names of the columns",
            CONVENTIONS[read_as](angles[::-1]),
        )
        yield (
            f"the orientations, read as {_READ_AS[read_as]}, seem to be in degrees",
            "give the unit in the names of the columns, as in rx_deg",
            CONVENTIONS[read_as](np.deg2rad(angles)),
        )


def axis_change(of_positions: Array, of_orientations: Array, mirrored: bool) -> tuple[str, str, Array] | None:
    """Return the wrong axes of the positions as text, fix and matrix; None if the frames agree.

    Args:
        of_positions: ``(3, 3)`` rotation from the measuring frame to the base, of the positions.
        of_orientations: ``(3, 3)`` the same, of the orientations.
        mirrored: Whether the first axis of the positions was reversed before.
    """
    matrix = of_orientations.T @ of_positions @ np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0])
    signed = np.round(matrix)
    if np.abs(matrix - signed).max() > _CLOSE or np.abs(np.linalg.det(signed)) != 1.0 or np.all(signed == np.eye(3)):
        return None
    order = np.argmax(np.abs(signed), axis=1)
    signs = signed[np.arange(3), order]
    if np.all(order == np.arange(3)):
        names = ["xyz"[i] for i in np.flatnonzero(signs < 0)]
        if len(names) == 1:
            text = f"the column {names[0]} seems to have a reversed sign"
        else:
            text = f"the columns {', '.join(names)} seem to have reversed signs"
        return text, "measure in a right-handed frame, or reverse the sign of the column", signed
    moved = [i for i in range(3) if order[i] != i]
    if len(moved) == 2 and np.all(signs > 0):
        text = f"the columns {'xyz'[moved[0]]} and {'xyz'[moved[1]]} seem to be exchanged"
    else:
        contents = ", ".join(("-" if s < 0 else "") + "xyz"[o] for s, o in zip(signs, order, strict=True))
        text = f"the columns of the positions seem to be exchanged: x, y, z are {contents} of the file"
    return text, "correct the names of the columns", signed
