"""Targets that two files of measured poses have in common, and the means of their rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Robot

_FEWEST = 3
"""Smallest number of shared targets."""


@dataclass(frozen=True, slots=True)
class TargetRows:
    """Measured poses of one file, and the rows of each shared target in it."""

    data: Measurements
    rows: tuple[NDArray[np.int64], ...]

    @property
    def first_rows(self) -> NDArray[np.int64]:
        """First row of each target."""
        return np.array([index[0] for index in self.rows])

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of rows of each target."""
        return np.array([index.size for index in self.rows])

    def means(self, values: Array) -> Array:
        """Return the means ``(K, T)`` of the columns of ``(K, N)`` over the rows of each target."""
        return np.stack([values[:, index].mean(axis=1) for index in self.rows], axis=1)


@dataclass(frozen=True, slots=True)
class SharedTargets:
    """T targets measured before and after."""

    names: tuple[str, ...]
    before: TargetRows
    after: TargetRows

    def wanted(self, nominal: Robot | None) -> Array:
        """Return the wanted positions ``(3, T)``, measuring frame, m: of the file after, else before, else nominal.

        Raises:
            UsageError: Neither file has wanted poses, and there is no nominal robot.
        """
        for file in (self.after, self.before):
            if file.data.commanded_position is not None:
                return file.means(file.data.commanded_position)
        before = self.before.data
        if nominal is None or before.q is None:
            raise UsageError("the files have no wanted poses: add cmd_x, cmd_y, cmd_z, or give `nominal` and joints")
        return self.before.means(predict(dataclasses.replace(nominal, effects=()), before).translation)


def shared_targets(first: Measurements, second: Measurements) -> SharedTargets:
    """Return the targets of both files, paired by their ``pose``, or by their order without such a column.

    Raises:
        InputError: The files share fewer than three targets.
    """
    if (first.pose is None) != (second.pose is None):
        raise InputError(Problem("one file has a column pose, the other has none", fix="add it to both files"))
    rows: Sequence[Sequence[NDArray[np.int64]]]
    if first.pose is None or second.pose is None:
        if first.n != second.n:
            message = f"{first.n} and {second.n} rows without a column pose cannot be paired"
            raise InputError(Problem(message, second.source, fix="add a column pose to both files"))
        rows = [[np.array([i]) for i in range(first.n)]] * 2
        names = tuple(str(i + 1) for i in range(first.n))
    else:
        rows_of = [rows_of_targets(data) for data in (first, second)]
        common = [key for key in rows_of[0] if key in rows_of[1]]
        rows = [[np.array(file[key]) for key in common] for file in rows_of]
        names = tuple(" ".join(key) for key in common)
    if len(names) < _FEWEST:
        fix = "give the files of the same targets before and after the correction"
        raise InputError(Problem(f"the files share {len(names)} targets, {_FEWEST} are needed", second.source, fix=fix))
    before, after = (TargetRows(data, tuple(index)) for data, index in zip((first, second), rows, strict=True))
    return SharedTargets(names, before, after)


def rows_of_targets(data: Measurements) -> dict[tuple[str, ...], list[int]]:
    """Return the rows of each target by its name: its pose, and the measured target if the file has that column."""
    assert data.pose is not None
    columns = (data.pose,) if data.target is None else (data.pose, data.target)
    rows: dict[tuple[str, ...], list[int]] = {}
    for i, key in enumerate(zip(*(map(str, column) for column in columns), strict=True)):
        rows.setdefault(key, []).append(i)
    return rows
