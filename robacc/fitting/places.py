"""Places: poses that lie close together, such as repetitions whose joints were logged as read, not as commanded.

Poses of one place share the arm's errors there, so that a held-out error is an error elsewhere only if the whole place
is held out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.measurements import Measurements

_NEAR = 0.03
"""Share of each joint's range up to which two poses are close. Of 1,000 random poses of six joints, none is expected to
be."""
_WIDEST = 4.0
"""Largest extent of a place, in multiples of that distance; a sweep of joints is longer."""
_EVIDENT = 0.1
"""Share of the poses that lie close to another from which places count."""
_LEAST_PLACES = 6
"""Places that poses must lie in; of fewer, none could be held out."""
_MOST_POSES = 5000
"""Largest number of poses that are compared; more are close to others in any case."""


def places(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` the number of each row's place; the number of its commanded pose where no poses lie together."""
    groups = data.groups()
    numbers, first, which = np.unique(groups, return_index=True, return_inverse=True)
    commands = data.commands
    if commands is None or not 2 <= numbers.size <= _MOST_POSES:
        return groups
    place = _numbered(commands[:, first])
    count = np.bincount(place)
    if np.mean(count[place] > 1) < _EVIDENT or np.count_nonzero(count) < _LEAST_PLACES:
        return groups
    result: NDArray[np.int64] = np.unique(place[which], return_inverse=True)[1].astype(np.int64)
    return result


def places_warning(data: Measurements) -> tuple[str, ...]:
    """Return a warning of poses that are held out together because they lie close together."""
    groups, place = data.groups(), places(data)
    n_groups, n_places = np.unique(groups).size, np.unique(place).size
    if n_groups == n_places:
        return ()
    return (
        f"{f'{data.source}: ' if data.source else ''}{n_groups} poses lie in {n_places} places, closer together than "
        f"{100 * _NEAR:.0f} % of each joint's range; poses of one place are held out together; for repetitions of one "
        "commanded pose, add a pose column or the commanded joints",
    )


def _numbered(commands: Array) -> NDArray[np.int64]:
    """Return ``(P,)`` the lowest number among the poses of the place of each pose of ``(K, P)``."""
    extent = np.ptp(commands, axis=1)
    moved = commands[extent > 0.0] / extent[extent > 0.0, None]
    place = np.arange(commands.shape[1])
    if not moved.size:
        return place
    first, second = _close_pairs(moved)
    while True:
        # The lowest number spreads along the pairs.
        lowest = np.minimum(place[first], place[second])
        before = place.copy()
        np.minimum.at(place, first, lowest)
        np.minimum.at(place, second, lowest)
        if np.array_equal(place, before):
            break
    low, high = (np.full((moved.shape[0], place.size), start) for start in (np.inf, -np.inf))
    for row, lower, upper in zip(moved, low, high, strict=True):
        np.minimum.at(lower, place, row)
        np.maximum.at(upper, place, row)
    wide = (high - low).max(axis=0) > _WIDEST * _NEAR
    return np.where(wide[place], np.arange(place.size), place)


def _close_pairs(moved: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of close poses of ``(K, P)``, in shares of the range; the first in order of the first joint."""
    order = np.argsort(moved[0], kind="stable")
    ends = np.searchsorted(moved[0, order], moved[0, order] + _NEAR, side="right")
    firsts, seconds = [], []
    for i, end in enumerate(ends):
        others = order[i + 1 : end]
        close = others[np.abs(moved[:, others] - moved[:, order[i], None]).max(axis=0, initial=0.0) <= _NEAR]
        firsts.append(np.full(close.size, order[i]))
        seconds.append(close)
    return np.concatenate(firsts).astype(np.int64), np.concatenate(seconds).astype(np.int64)
