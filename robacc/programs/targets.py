"""Targets of a program for an arm: flange poses, joints, configurations, and their text in the program or a new one.

What a configuration says of the joints is a matter of the dialect. All count the axes of a six-axis arm, so they are
not read for other chains, such as an arm on a rail.
"""

import re
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from robacc.errors import refuse
from robacc.geometry import Array, NDArray, Poses, quaternion_from_rotation, rotation_from_quaternion, rotation_from_rpy
from robacc.io.files import spliced
from robacc.programs.program import (
    ConfigurationRules,
    Program,
    ProgramFrame,
    ProgramNumber,
    ProgramSource,
    by_convention,
    native_of,
    rotation_distance,
)

# Cartesian targets as poses of the flange in the robot's base frame, and back, through each target's tool and base.


def flange_targets(program: Program) -> tuple[tuple[int, ...], Poses, tuple[tuple[int, str], ...]]:
    """Return the Cartesian targets of a program whose tool and base are known, and the flange's poses at them.

    Returns:
        Index of each of these targets in ``Program.targets``; the flange's poses over them in the robot's base frame;
        index of each other Cartesian target, with the reason.
    """
    reasons = {
        i: _unknown(target.tool, "tool") or _unknown(target.base, "base")
        for i, target in enumerate(program.targets)
        if target.kind == "cartesian"
    }
    numbers = tuple(i for i, reason in reasons.items() if not reason)
    targets = [program.targets[i] for i in numbers]
    values = np.array([target.values for target in targets], dtype=float).reshape(-1, 7).T
    poses = Poses(rotation_from_quaternion(values[3:]), values[:3]) @ _poses(t.tool for t in targets).inverse()
    unknown = tuple((i, reason) for i, reason in reasons.items() if reason)
    return numbers, _poses(target.base for target in targets) @ poses, unknown


def values_at(program: Program, numbers: Sequence[int], flange: Poses) -> list[tuple[float, ...]]:
    """Return the values of targets (x, y, z and quaternion) that bring the flange to poses in the robot's base frame.

    Args:
        program: Program of the targets.
        numbers: Index of each target.
        flange: Poses over the same targets.
    """
    base, tool = _poses(program.targets[i].base for i in numbers), _poses(program.targets[i].tool for i in numbers)
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
    counts = {len(row) for row in rows}
    refuse((len(counts) > 1, "the joint targets have different numbers of joints"), error=ValueError)
    return numbers, np.array(rows, dtype=float).T if rows else np.empty((0, 0))


def _unknown(frame: ProgramFrame | None, kind: str) -> str:
    """Return why a frame is unknown; empty where it is known."""
    if frame is None:
        return f"the program names no {kind}, or several, for this target"
    return f"the {kind} {frame.name} is in none of the files read" if frame.frame is None else ""


def _poses(frames: Iterable[ProgramFrame | None]) -> Poses:
    """Return known frames as poses over N."""
    known = [(frame.frame.xyz, frame.frame.rpy) for frame in frames if frame and frame.frame]
    place, angles = np.array(known, dtype=float).reshape(-1, 2, 3).transpose(1, 2, 0)
    return Poses(rotation_from_rpy(angles), place)


# Configurations of Cartesian targets: the joints that they allow.

N_AXES = 6
_AT_BORDER = 1e-3
"""rad: distance from a border within which both sides count."""


def joint_window(rules: ConfigurationRules, text: str, n_joints: int) -> Array | None:
    """Return the least and the largest value ``(2, J)`` of each joint that a configuration allows, rad.

    They are infinite where it says nothing; None where it is not given, or not read, as for arms of other than six
    axes.
    """
    return rules.window(text) if n_joints == N_AXES else None


def is_read(rules: ConfigurationRules, text: str, n_joints: int) -> bool:
    """Return whether a configuration is given and read as a whole, letters and words too."""
    return rules.are_read_whole and joint_window(rules, text, n_joints) is not None


def allowed_by_window(window: Array, q: Array) -> NDArray[np.bool_]:
    """Return ``(N,)`` whether each column of joints ``(J, N)``, rad, lies in the window of a configuration."""
    low, high = window[:, :, None]
    return np.asarray(np.all((q > low - _AT_BORDER) & (q < high + _AT_BORDER), axis=0))


def turned_into(window: Array, q: Array, limits: tuple[Array, Array], revolute: NDArray[np.bool_]) -> Array:
    """Return joints ``(J, N)`` with whole turns added where these bring a revolute joint into a window.

    Args:
        window: From :func:`joint_window`.
        q: Joints, rad.
        limits: Lower and upper joint limits, each ``(J,)``, rad or m.
        revolute: ``(J,)`` whether a joint turns.
    """
    low, high = window[:, :, None] + _AT_BORDER * np.array([-1, 1])[:, None, None]
    up, down = (np.maximum(np.ceil(gap / (2.0 * np.pi)), 0.0) for gap in (low - q, q - high))
    moved = q + 2.0 * np.pi * (up - down)
    fits = (moved > low) & (moved < high) & (moved >= limits[0][:, None]) & (moved <= limits[1][:, None])
    return np.where(fits & revolute[:, None], moved, q)


def leaves_configuration(rules: ConfigurationRules, text: str, before: Array, after: Array) -> bool:
    """Return whether corrected joints have another configuration than the one that a target states.

    Joints that were on a border already leave nothing.

    Args:
        rules: What the configurations of the program say.
        text: Configuration as written.
        before: Joints ``(J,)`` of the target, rad.
        after: Corrected joints ``(J,)``, rad.
    """
    window = joint_window(rules, text, before.size)
    low, high = (-np.inf, np.inf) if window is None else window
    left = (before > low) & (before < high) & ((after < low) | (after > high))
    # Every dialect's configuration names the side of axis 5.
    return bool(np.any(left) or (text != "" and before.size == N_AXES and before[4] * after[4] < 0))


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
    new = shortened(new, bare_point)
    if old.startswith("+") and not new.startswith("-"):
        new = f"+{new}"
    before = source.text[max(start - 80, 0) : start]
    spaces = len(before) - len(before.rstrip(" "))
    if spaces >= 2:
        # A column that is aligned to the right: the spaces give way, all but the last.
        start -= spaces - 1
        new = new.rjust(end - start)
    yield start, end, new


def shortened(number: str, bare_point: bool) -> str:
    """Return a number without the sign of a zero and, with ``bare_point``, without the zero before its point."""
    unsigned = number.removeprefix("-") if float(number) == 0 else number
    return re.sub(r"^(-?)0\.", r"\1.", unsigned) if bare_point else unsigned


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
            # Of lengths a tenth of the micrometre that a correction converges to, m, and of angles rad.
            resolution = 2e-7 if number.unit != 1e-3 and (c >= 3 or number.unit < 1) else 1e-7
            needed = max(0, round(-float(np.log10(resolution / number.unit))))
            decimals = program.decimals.get(number.unit, needed)
            edits += _edit(program.source, number, float(native[c, k]) / number.unit, decimals, bare_point)
    return spliced(text, edits).encode(program.source.encoding)
