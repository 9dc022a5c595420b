"""Orientations of a pose file: their representation, and the convention of angles that names leave open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robacc.errors import Note
from robacc.geometry import Array
from robacc.poses.columns import QUATERNION, ROTATION_VECTOR, RPY, is_documented
from robacc.poses.layout import Values
from robacc.poses.reading import CONVENTIONS, KnownPoses, PoseAt, Reading, is_ruled_out, try_conventions

_BLOCK = 4096
"""Rotations converted at a time: the working arrays of a block fit the cache."""
_SAMPLE = 400
"""Poses that a trial of conventions uses at most."""
_WRITERS = {
    "rotvec": "Universal Robots",
    "fixed-xyz": "trackers, FANUC, Yaskawa",
    "moving-xyz": "Stäubli",
    "kuka-abc": "KUKA",
    "zyz": "Kawasaki",
    "wxyz": "scalar part first",
    "xyzw": "scalar part last, ROS",
}
"""Makers whose exports use a convention."""
_OPTIONS = {
    ROTATION_VECTOR[0]: ("rotvec", "fixed-xyz", "moving-xyz"),
    RPY[0]: ("fixed-xyz", "moving-xyz"),
    QUATERNION[0]: ("wxyz", "xyzw"),
}
"""Conventions that files use, by the first of the columns; the first convention is the documented one."""


def rotations(values: Values, keys: tuple[str, ...] | None, convention: str) -> Array | None:
    """Return rotations ``(3, 3, N)`` from the file's representation; None where the file has none."""
    if keys is None or (columns := values.column_set(keys)) is None:
        return None
    result = np.empty((3, 3, columns.shape[1]))
    for start in range(0, columns.shape[1], _BLOCK):
        result[..., start : start + _BLOCK] = CONVENTIONS[convention](columns[:, start : start + _BLOCK])
    return result


def _convention(keys: Sequence[str], stated: str | None) -> str:
    """Return the convention of these columns as stated, or as documented; other names than rx take few."""
    options = _OPTIONS[keys[0].removeprefix("cmd_")]
    return stated if stated in options or (stated and options[0] == "rotvec") else options[0]


def conventions(
    values: Values, reading: Reading, pose_at: PoseAt | None, known_poses: KnownPoses | None
) -> Mapping[str, str]:
    """Return the convention of attained and commanded angles, by prefix: as stated, as named, or as the data show.

    Questions go to the log, and notes of what the data showed. Documented names keep their convention; the data may
    show that it is wrong. Roll, pitch and yaw of an export are about fixed axes unless the data show otherwise.
    """
    layout, log, n = values.layout, values.log, values.lines.size
    orientations = {prefix: keys for prefix in ("", "cmd_") if (keys := layout.orientation(prefix)) is not None}
    stated: dict[str, str | None] = {}
    for prefix, keys in orientations.items():
        named = layout.angles.get(prefix, ())
        # The order of a quaternion is no statement on angles, nor on names that say the order.
        is_open = keys[0] == prefix + QUATERNION[0] and (named or reading.columns is not None)
        angles = reading.angles if is_open or reading.angles not in _OPTIONS[QUATERNION[0]] else None
        stated[prefix] = named[0] if len(named) == 1 else angles
    chosen = {prefix: _convention(keys, stated[prefix]) for prefix, keys in orientations.items()}
    rows = np.linspace(0, n - 1, min(n, _SAMPLE)).astype(int)
    is_sound = n > 0 and not log.total  # without sound numbers a trial shows nothing

    def known_orientations(prefix: str) -> Array | None:
        """Return orientations of the rows that do not depend on the angles in question; None where there are none."""
        if pose_at is not None and (q := values.column_set(layout.joints())) is not None:
            return pose_at(q[:, rows]).rotation
        if known_poses is not None:
            known = known_poses(values.keys)[1]
            return None if known is None else known[..., rows]
        other = "" if prefix else "cmd_"
        keys = orientations.get(other)
        if keys is None or (columns := values.column_set(keys)) is None:
            return None
        is_certain = keys[0] != other + ROTATION_VECTOR[0] and other not in layout.angles
        if not is_certain and not stated[other]:
            return None
        return CONVENTIONS[_convention(keys, stated[other])](columns[:, rows])

    for prefix, keys in orientations.items():
        open_names = layout.angles.get(prefix)
        is_quaternion = open_names is None and keys[0] == prefix + QUATERNION[0]
        if stated[prefix] or is_quaternion or not is_sound:
            continue
        options = open_names or _OPTIONS[keys[0].removeprefix("cmd_")]
        known, columns = known_orientations(prefix), values.column_set(keys)
        trial = None if known is None or columns is None else try_conventions(columns[:, rows], known, options)
        names = [layout.columns[key].name for key in keys]
        listed, doubt = ", ".join(names), ""
        if open_names is not None:
            if trial is None or sum(not is_ruled_out(name, trial) for name in trial) > 1:
                doubt = "may be angles of several conventions"
        elif trial is None or not is_ruled_out(chosen[prefix], trial):
            continue
        elif keys[0] == prefix + ROTATION_VECTOR[0]:
            doubt = "are documented as a rotation vector, which they do not fit"
        elif any(map(is_documented, names)):
            doubt = "are documented as about fixed axes, which they do not fit"
        if doubt:
            log.add(f"these {doubt}{_sizes(trial)}", values.header, listed, f"give `angles`: {_listed(options)}")
        elif trial is not None:
            best, worse, *_ = sorted(trial, key=trial.__getitem__)
            fits = f"it fits the known orientations to {_degrees(trial[best])}, others miss by {_degrees(trial[worse])}"
            log.warn(Note(f"{listed} taken as {best}: {fits}"), of_file=True)
            chosen[prefix] = best
    return chosen


def _sizes(trial: Mapping[str, float] | None) -> str:
    sizes = ", ".join(f"{name} by {_degrees(size)}" for name, size in (trial or {}).items())
    return f" (they miss the known orientations: {sizes})" if trial else ""


def _listed(options: Sequence[str]) -> str:
    return ", ".join(f"{name} ({_WRITERS[name]})" if name in _WRITERS else name for name in options)


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.2g} degrees"
