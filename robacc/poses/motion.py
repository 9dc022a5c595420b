"""Direction and speed of the joints' last motion: as given, or derived from the order of visits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Counted
from robacc.geometry import Array
from robacc.io.problem_log import ProblemLog, clip
from robacc.measurements import commanded_groups, motion_between_rows
from robacc.poses.layout import listing
from robacc.poses.values import COMMANDED_AXES, Values

_SAME_VISIT = 1e-3
"""rad or m; largest difference between the commands of the rows of a visit, from joints that were read back."""

Texts = NDArray[Any] | None


def numbered(*columns: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number ``(N,)`` of each row's combination of values."""
    codes = np.stack([np.unique(column, return_inverse=True)[1] for column in columns])
    return np.unique(codes, axis=1, return_inverse=True)[1].ravel().astype(np.int64)


def rank_among_equals(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many rows before each row have the same number."""
    order = np.argsort(numbers, kind="stable")
    ordered = numbers[order]
    start = np.searchsorted(ordered, ordered)
    rank = np.empty(numbers.size, dtype=np.int64)
    rank[order] = np.arange(numbers.size) - start
    return rank


def visits_in_order(groups: NDArray[np.int64], visit: Texts, cycle: Texts, target: Texts) -> NDArray[np.int64]:
    """Return the visit ``(N,)`` of each row where rows are in the order measured.

    A column ``visit`` decides. Without it, consecutive rows of one commanded pose and cycle are one visit. Without
    cycles, a target that is measured again belongs to the next visit, and so does each row of a file without targets.

    Args:
        groups: ``(N,)`` commanded pose of each row.
        visit: ``(N,)`` ids, or None; likewise ``cycle`` and ``target``.
        cycle: See ``visit``.
        target: See ``visit``.
    """
    if visit is not None:
        return numbered(visit)
    if cycle is None and target is None:
        return np.arange(groups.size)
    starts = np.ones(groups.size, dtype=bool)
    starts[1:] = groups[1:] != groups[:-1]
    if cycle is not None:
        starts[1:] |= cycle[1:] != cycle[:-1]
    run = np.cumsum(starts)
    return run if cycle is not None or target is None else numbered(run, rank_among_equals(numbered(run, target)))


def motion_between_visits(q: Array, visits: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return direction and relative speed, both ``(J, N)``, of direct moves from each visit to the next.

    Every row has the motion that led to its visit. Visits follow each other in the order of their first rows.
    """
    _, first, number = np.unique(visits, return_index=True, return_inverse=True)
    if first.size == visits.size:
        return motion_between_rows(q)
    order = np.argsort(first)
    place = np.empty(order.size, dtype=np.int64)
    place[order] = np.arange(order.size)
    direction, speed = motion_between_rows(q[:, first[order]])
    return direction[:, place[number]], speed[:, place[number]]


def check_visits(values: Values, ordered: bool, log: ProblemLog) -> None:
    """Log each row that contradicts its ``visit``: other commands, or with ``ordered`` an earlier visit continued."""
    visit = values.texts.get("visit")
    if visit is None or visit.size < 2:
        return
    _, first, number = np.unique(visit, return_index=True, return_inverse=True)
    origin = first[number]
    commands = values.column_set(values.layout.joints())
    if commands is None:
        commands = values.column_set(COMMANDED_AXES)
    if commands is not None:
        distance = np.max(np.abs(commands - commands[:, origin]), axis=0)
        log.add_rows(
            distance > _SAME_VISIT,
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} has another command than on {log.counted} {values.lines[origin[i]]}; "
                "a visit is one arrival of the arm, so number each arrival differently"
            ),
        )
    if ordered:
        returned = np.zeros(visit.size, dtype=bool)
        returned[1:] = (visit[1:] != visit[:-1]) & (origin[1:] < np.arange(1, visit.size))
        log.add_rows(
            returned,
            values.lines,
            "visit",
            lambda i: (
                f"visit {clip(str(visit[i]))} continues after another visit began, although rows are said to be in the "
                "order measured; number each arrival differently, or sort the rows"
            ),
        )


def motion_of(
    values: Values, ordered: bool, counted: Counted
) -> tuple[tuple[Array | None, Array | None], tuple[str, ...]]:
    """Return direction and speed ``(J, N)``: as given, derived from the order of visits, or 0 with a warning."""
    layout = values.layout
    warnings: list[str] = []
    derived = _derived(values) if ordered else None
    if ordered and derived is None:
        warnings.append("the file has no joint columns, so the order of rows does not give the joints' directions")
    if ordered and (time := values.column("time_s")) is not None and np.any(np.diff(time) < 0):
        line = values.lines[int(np.argmax(np.diff(time) < 0)) + 1]
        warnings.append(f"rows should be in the order measured, but time_s decreases at {counted} {line}")
    result: list[Array | None] = []
    for number, prefix in enumerate(("dir_", "speed_")):
        keys = layout.joints(prefix)
        missing = [key for key in keys if key not in values.row_index]
        if not missing and keys:
            result.append(values.column_set(keys))
        elif derived is None and len(missing) == len(keys):
            result.append(None)
        else:
            table = np.zeros((len(keys), values.lines.size)) if derived is None else derived[number]
            for i, key in enumerate(keys):
                if (column := values.column(key)) is not None:
                    table[i] = column
            result.append(table)
            if derived is None:
                warnings.append(f"no column {listing(missing)}: 0 (not moving) is assumed")
    return (result[0], result[1]), (*warnings, *_opposite_sign_warnings(values, counted))


def _derived(values: Values) -> tuple[Array, Array] | None:
    """Return direction and speed from the order of visits; None without joint columns."""
    q = values.column_set(values.layout.joints())
    if q is None:
        return None
    visit, cycle, target, pose = (values.texts.get(name) for name in ("visit", "cycle", "target", "pose"))
    if visit is None and cycle is None and target is None:
        return motion_between_rows(q)
    grouping = commanded_groups(pose, q)
    groups = np.arange(values.lines.size) if grouping is None else grouping.numbers
    return motion_between_visits(q, visits_in_order(groups, visit, cycle, target))


def _opposite_sign_warnings(values: Values, counted: Counted) -> Iterator[str]:
    """Yield a warning for each joint whose given direction and speed have opposite signs."""
    for keys in zip(values.layout.joints("dir_"), values.layout.joints("speed_"), strict=True):
        direction, speed = (values.column(key) for key in keys)
        if direction is not None and speed is not None and (opposite := direction * speed < 0).any():
            place = f"{counted} {values.lines[np.argmax(opposite)]}"
            yield f"{' and '.join(keys)} have opposite signs at {place}: one of them is wrong"
