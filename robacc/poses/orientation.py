"""Orientations of a pose file: their representation, and the convention of angles that names leave open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robacc.errors import Note
from robacc.geometry import Array
from robacc.io.files import ProblemLog
from robacc.poses.columns import QUATERNION, ROTATION_VECTOR, RPY, is_documented
from robacc.poses.layout import Values
from robacc.poses.reading import CONVENTIONS, AngleTrial, PoseAt, Reading, try_conventions
from robacc.poses.units import KnownPoses

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
_DOCUMENTED = ("rotvec", "fixed-xyz", "moving-xyz")
"""Conventions that files use for columns rx, ry, rz, which are documented as a rotation vector."""

_ABOUT_XYZ = ("fixed-xyz", "moving-xyz")
"""Conventions that instruments use for roll, pitch and yaw, which are documented as about fixed axes."""

_ORDERS = ("wxyz", "xyzw")
"""Orders of a quaternion whose names leave its scalar part open."""


def rotations(values: Values, keys: tuple[str, ...] | None, convention: str) -> Array | None:
    """Return rotations ``(3, 3, N)`` from the file's representation; None where the file has none."""
    if keys is None or (columns := values.column_set(keys)) is None:
        return None
    result = np.empty((3, 3, columns.shape[1]))
    for start in range(0, columns.shape[1], _BLOCK):
        result[..., start : start + _BLOCK] = CONVENTIONS[convention](columns[:, start : start + _BLOCK])
    return result


def _convention(keys: tuple[str, ...] | None, stated: str | None) -> str:
    """Return the convention of these columns as stated, or as documented; roll, pitch, yaw are about x, y, z."""
    if keys is not None and keys[0].removeprefix("cmd_") == RPY[0]:
        return stated if stated in _ABOUT_XYZ else _ABOUT_XYZ[0]
    if keys is not None and keys[0].removeprefix("cmd_") == QUATERNION[0]:
        return stated if stated in _ORDERS else _ORDERS[0]
    return stated or "rotvec"


class AngleChoice:
    """Choice of the convention of attained and commanded angles: as stated, as named, or as the data show."""

    def __init__(
        self,
        values: Values,
        reading: Reading,
        pose_at: PoseAt | None,
        log: ProblemLog,
        line: int | None,
        known_poses: KnownPoses | None = None,
    ) -> None:
        """Choose for ``values``; questions go to ``log``, and what the data showed to :attr:`remarks`."""
        self._values = values
        self._reading = reading
        self._pose_at = pose_at
        self._log = log
        self._line = line
        self._known_poses = known_poses
        self.remarks: list[str] = []

    def run(self) -> Mapping[str, str]:
        """Return the convention of the angles by prefix, ``""`` and ``cmd_``."""
        layout = self._values.layout
        orientations = {"": layout.orientation, "cmd_": layout.commanded_orientation}
        chosen = {prefix: _convention(keys, self._stated(prefix)) for prefix, keys in orientations.items()}
        if self._log.total or not self._values.lines.size:
            return chosen  # without sound numbers a trial shows nothing
        for prefix, keys in orientations.items():
            if keys is not None and not self._stated(prefix):
                chosen[prefix] = self._tried(prefix, keys, chosen[prefix], orientations)
        return chosen

    def _stated(self, prefix: str) -> str | None:
        """Return the convention that the user or the names state; None where they leave it open."""
        named = self._values.layout.foreign.angles.get(prefix, ())
        is_named = self._reading.angles in _ORDERS and not named and self._reading.columns is None
        return named[0] if len(named) == 1 else None if is_named else self._reading.angles

    def _tried(
        self, prefix: str, keys: tuple[str, ...], documented: str, orientations: Mapping[str, tuple[str, ...] | None]
    ) -> str:
        """Return the convention that the data show, with a remark; where they leave it open, a question is logged.

        Documented names keep their convention; the data may show that it is wrong. Roll, pitch and yaw of an export are
        about fixed axes unless the data show otherwise.
        """
        open_names = self._values.layout.foreign.angles.get(prefix)
        is_rpy = open_names is None and keys[0] == prefix + RPY[0]
        if not is_rpy and open_names is None and keys[0] != prefix + ROTATION_VECTOR[0]:
            return documented
        options = open_names or (_ABOUT_XYZ if is_rpy else _DOCUMENTED)
        n = self._values.lines.size
        rows = np.linspace(0, n - 1, min(n, _SAMPLE)).astype(int)
        known, angles = self._known(prefix, rows, orientations), self._values.column_set(keys)
        trial = None if known is None or angles is None else try_conventions(angles[:, rows], known, options)
        columns = [self._values.layout.columns[key].name for key in keys]
        names = ", ".join(columns)
        if open_names is not None:
            if trial is None or not trial.decided:
                self._ask(names, "may be angles of several conventions", trial, options)
                return options[0]
        elif trial is None or not trial.rules_out(documented):
            return documented
        elif not is_rpy:
            self._ask(names, "are documented as a rotation vector, which they do not fit", trial, options)
            return documented
        elif any(map(is_documented, columns)):
            self._ask(names, "are documented as about fixed axes, which they do not fit", trial, options)
        worse = min(size for name, size in trial.disagreement.items() if name != trial.best)
        self.remarks.append(
            Note(
                f"{names} taken as {trial.best}: it fits the known orientations to "
                f"{_degrees(trial.disagreement[trial.best])}, others miss by {_degrees(worse)}"
            )
        )
        return trial.best

    def _known(self, prefix: str, rows: Array, orientations: Mapping[str, tuple[str, ...] | None]) -> Array | None:
        """Return orientations of the rows that do not depend on the angles in question; None where there are none."""
        q = self._values.column_set(self._values.layout.joints())
        if q is not None and self._pose_at is not None:
            return self._pose_at(q[:, rows]).rotation
        if self._known_poses is not None:
            known = self._known_poses(self._values.texts.get("pose"), self._values.lines.size)[1]
            return None if known is None else known[..., rows]
        other = "" if prefix else "cmd_"
        keys = orientations[other]
        if keys is None or (columns := self._values.column_set(keys)) is None:
            return None
        certain = (
            keys[0] != other + ROTATION_VECTOR[0] and other not in self._values.layout.foreign.angles
        ) or self._stated(other)
        return CONVENTIONS[_convention(keys, self._stated(other))](columns[:, rows]) if certain else None

    def _ask(self, names: str, doubt: str, trial: AngleTrial | None, conventions: Sequence[str]) -> None:
        sizes = ", ".join(f"{name} by {_degrees(size)}" for name, size in trial.disagreement.items()) if trial else ""
        tried = f" (they miss the known orientations: {sizes})" if trial else ""
        writers = (f"{name} ({_WRITERS[name]})" if name in _WRITERS else name for name in conventions)
        self._log.add(f"these {doubt}{tried}", self._line, names, f"give `angles`: {', '.join(writers)}")


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.2g} degrees"
