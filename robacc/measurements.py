"""Measured poses as validated, read-only columns in SI units, poses last."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Counted
from robacc.geometry import Array, Poses

_BLOCK = 16384
"""Poses hashed at a time: the working arrays of a block stay in the cache."""
_ONE_COMMAND = 1e-3
"""rad or m; what rounding, or joints read back in place of those commanded, may set between rows of one ``pose`` id.
Over so little an arm's error changes by some thousandth of itself, so such rows are repetitions still."""


@dataclass(frozen=True, slots=True)
class Grouping:
    """Which rows are of one commanded pose."""

    numbers: NDArray[np.int64]
    """``(N,)`` from 0, the same for rows of one pose."""
    doubted: NDArray[np.bool_] | None = None
    """``(N,)`` rows whose id was not believed; None: there are none."""

    @property
    def repeated(self) -> NDArray[np.int64] | None:
        """The numbers where some pose was measured more than once; None where each row is of its own."""
        return None if self.numbers.max(initial=-1) + 1 == self.numbers.size else self.numbers


@dataclass(frozen=True, slots=True)
class Measurements:
    """N measured poses. A column that the file did not have is None; none has a missing value."""

    position: Array
    """``(3, N)`` attained position of the target in the measuring frame, m."""
    rotation: Array | None = None
    """``(3, 3, N)`` attained orientation."""
    q: Array | None = None
    """``(J, N)`` commanded joint variables, rad or m, in chain order."""
    commanded_position: Array | None = None
    commanded_rotation: Array | None = None
    sigma_position: Array | None = None
    """``(3, N)`` measuring uncertainty, one standard deviation along x, y, z of the measuring frame, m."""
    sigma_rotation: Array | None = None
    """``(N,)`` the same of the orientation about any axis, rad."""
    pose: NDArray[Any] | None = None
    """``(N,)`` id of the commanded pose, text."""
    cycle: NDArray[Any] | None = None
    target: NDArray[Any] | None = None
    """``(N,)`` name of the target measured, text."""
    time: Array | None = None
    """``(N,)`` s"""
    temperature: Array | None = None
    """``(N,)`` degrees Celsius"""
    payload: Array | None = None
    """``(N,)`` kg"""
    direction: Array | None = None
    """``(J, N)`` in {-1, 0, 1}"""
    speed: Array | None = None
    """``(J, N)`` signed fraction of full speed"""
    rows: NDArray[np.int64] | None = None
    """``(N,)`` 1-based line of the file that each pose stands on, or its row where the file has no lines."""
    counted: Counted = "line"
    source: str | None = None
    """File name as given."""
    sha256: str | None = None
    ordered: bool = False
    """Whether rows are in the order measured."""
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make every column read-only: a record that several computations share is not written to."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def n(self) -> int:
        """Number of poses."""
        return int(self.position.shape[-1])

    @property
    def poses(self) -> Poses | None:
        """The attained poses, where orientation was measured."""
        return None if self.rotation is None else Poses(self.rotation, self.position)

    def subset(self, index: NDArray[Any] | slice) -> Measurements:
        """The poses of an index or boolean array, in its order; of a slice without copying them."""
        changes = {
            field.name: getattr(self, field.name)[..., index]
            for field in dataclasses.fields(self)
            if isinstance(getattr(self, field.name), np.ndarray)
        }
        return dataclasses.replace(self, **changes)

    def line(self, i: int) -> int:
        """The file's line of pose i; its number counted from 1 where there is no file."""
        return int(self.rows[i]) if self.rows is not None else i + 1

    def place(self, i: int) -> str:
        """Where pose i stands, in words."""
        return f"{self.counted} {self.line(i)}"

    @property
    def commands(self) -> Array | None:
        """Where the robot was sent: ``(J, N)`` joints, else ``(3, N)`` the commanded position, m; None: nobody says."""
        return self.q if self.q is not None else self.commanded_position

    def groups(self) -> NDArray[np.int64]:
        """``(N,)`` number of the commanded pose that each row belongs to; rows of one pose share it.

        By the ``pose`` column where there is one, else rows whose commanded joints (or commanded pose) are equal. An id
        whose rows were sent to different places is not believed: of them only those with equal commands are one pose.
        """
        return self._grouping().numbers

    def repetitions(self) -> Grouping | None:
        """The same as a record; None where a quick look tells that each row is of its own.

        Without a ``pose`` column, that none was repeated is found in a fifth of the time that the groups take.
        """
        if self.n == 0 or (self.pose is None and (self.commands is None or _all_differ(self.commands))):
            return None
        return self._grouping()

    def contradicted_ids(self, found: Grouping | None = None) -> tuple[str, ...]:
        """A warning where rows that share a ``pose`` id were sent to different places; nothing where none were.

        Args:
            found: Of :meth:`repetitions`, where it is at hand: a million ids take a while to sort.
        """
        if self.pose is None or (doubted := (found or self._grouping()).doubted) is None:
            return ()
        rows = np.flatnonzero(doubted)
        names = np.unique(self.pose[rows])
        count = np.unique(self.pose).size
        rows = rows[self.pose[rows] == names[0]]
        commands = self.commands
        assert commands is not None
        away = np.abs(commands[:, rows] - commands[:, rows[:1]]).max(axis=0)
        places = f"{self.place(int(rows[0]))} and {self.place(int(rows[np.argmax(away)]))}"
        many = f"{names.size} of {count} pose ids are" if count > 1 else "the one pose id is"
        return (
            f"{f'{self.source}: ' if self.source else ''}{many} of rows that were commanded to different places, as "
            f"{names[0]} is on {places}: of such rows only those with equal commands are taken for repetitions",
        )

    def _grouping(self) -> Grouping:
        return commanded_groups(self.pose, self.commands) or Grouping(np.arange(self.n))


def motion_between_rows(q: Array) -> tuple[Array, Array]:
    """Direction in {-1, 0, 1} and relative speed, both ``(J, N)``, of straight moves from each row to the next.

    Speed is dq over the largest |dq| of that move, all joints ending together. The first row and a row equal to the
    one before get 0.
    """
    speed = np.zeros(q.shape)
    np.subtract(q[:, 1:], q[:, :-1], out=speed[:, 1:])
    direction = np.sign(speed)
    largest = np.max(np.abs(speed), axis=0, initial=0.0)
    np.divide(speed, largest, out=speed, where=largest > 0)
    return direction, speed


def commanded_groups(ids: NDArray[Any] | None, commands: Array | None) -> Grouping | None:
    """Which rows are of one commanded pose, as :meth:`Measurements.groups` has it; None where nothing says.

    Args:
        ids: ``(N,)`` text, where there are ids.
        commands: ``(K, N)`` rad or m, where they are known.
    """
    if ids is None:
        return None if commands is None else Grouping(_equal_columns(commands))
    names, number = np.unique(ids, return_inverse=True)
    number = number.astype(np.int64)
    if commands is None or names.size == ids.size or not (wrong := _contradicted(number, commands)).any():
        return Grouping(number)
    rows = wrong[number]
    number[rows] = names.size + _equal_columns(commands[:, rows])
    return Grouping(np.unique(number, return_inverse=True)[1].astype(np.int64), rows)


def _contradicted(number: NDArray[np.int64], commands: Array) -> NDArray[np.bool_]:
    """``(G,)`` whether the rows of a group were sent to different places, each held against one of its group."""
    result = np.zeros(int(number.max(initial=-1)) + 1, dtype=bool)
    one = np.empty(result.size, dtype=np.int64)
    one[number] = np.arange(number.size)
    for row in commands:
        result[number[np.abs(row - row[one[number]]) > _ONE_COMMAND]] = True
    return result


def _equal_columns(values: Array) -> NDArray[np.int64]:
    """``(N,)`` number of each column of ``(K, N)``, the same for columns equal to 1e-9, by content and not by place.

    Sorting one hash a column takes a tenth of the time that sorting whole columns takes; a collision, which is all but
    impossible, is noticed and sorted in full.
    """
    mixed = _hashes(values)
    _, first, number = np.unique(mixed, return_index=True, return_inverse=True)
    if first.size == mixed.size or all(
        np.array_equal(np.round(row, 9), np.round(row, 9)[first][number]) for row in values
    ):
        return number.astype(np.int64)
    return np.unique(np.round(values, 9), axis=1, return_inverse=True)[1].ravel().astype(np.int64)


def _all_differ(values: Array) -> bool:
    """Whether no two columns of ``(K, N)`` are equal to 1e-9, as far as a hash that never says so wrongly can tell."""
    mixed = _hashes(values)
    mixed.sort()
    return not np.any(mixed[1:] == mixed[:-1])


def _hashes(values: Array) -> NDArray[np.uint64]:
    """``(N,)`` a hash of each column of ``(K, N)``, rounded to 1e-9."""
    result = np.empty(values.shape[1], dtype=np.uint64)
    for start in range(0, result.size, _BLOCK):
        mixed = np.zeros(min(_BLOCK, result.size - start), dtype=np.uint64)
        for row in values[:, start : start + _BLOCK]:
            bits = (np.round(row, 9) + 0.0).view(np.uint64)
            mixed = (mixed ^ bits) * np.uint64(0x9E3779B97F4A7C15)
            mixed ^= mixed >> np.uint64(29)
        result[start : start + _BLOCK] = mixed
    return result
