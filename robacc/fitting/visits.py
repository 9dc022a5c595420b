"""Visits and places: arrivals of the arm, and poses that lie close together; random parts of the rows."""

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.levels import FEW
from robacc.measurements import Measurements, different, hashed, numbered_visits
from robacc.poses.checks import MOST_POSES, close_groups


def visit_numbers(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` the number of the visit of each row, from 0.

    The columns ``visit`` and ``cycle`` decide. Without them, each repetition of a target at a pose is a separate visit;
    where rows are in the order measured, only consecutive rows share a visit.
    """
    ordered = data.ordered and data.cycle is None
    return numbered_visits(data.groups(), data.visit, data.cycle, data.target, ordered=ordered)


def random_rows(data: Measurements, most: int) -> NDArray[np.int64]:
    """Return ``most`` random rows, in their order; all if there are no more."""
    return first_ranks(row_ranks(data), most)


def row_ranks(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` a random rank of each row, whatever their order: the first rows have nearly all poses."""
    values = data.position if data.commands is None else np.concatenate((data.commands, data.position))
    return hashed(values).view(np.int64)


def pose_ranks(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` a random rank of each row's commanded pose, whose rows show scatter and noise apart."""
    groups = data.groups()
    return np.random.default_rng(0).permutation(int(groups.max(initial=-1)) + 1)[groups]


def first_ranks(draw: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return the numbers of the rows of the first ranks, at most ``most`` of them but all of the first."""
    ranked = np.sort(draw)
    return np.flatnonzero(draw < max(ranked[most], ranked[0] + 1)) if most < ranked.size else np.arange(ranked.size)


# Places: poses that lie close together, such as repetitions whose joints were logged as read, not as commanded.
#
# Poses of one place share the arm's errors there, so that a held-out error is an error elsewhere only if the whole
# place is held out.

_NEAR = 0.03
"""Share of each joint's range up to which two poses are close. Of 1,000 random poses of six joints, none is expected to
be."""
_WIDEST = 4.0
"""Largest extent of a place, in multiples of that distance; a sweep of joints is longer."""
LEAST_PLACES = 6
"""Places that poses must lie in; of fewer, none could be held out."""


def places(data: Measurements) -> NDArray[np.int64]:
    """Return ``(N,)`` the number of each row's place; the number of its commanded pose where no poses lie together."""
    groups = data.groups()
    commands = data.commands
    if commands is None or not 2 <= different(groups) <= MOST_POSES:
        return groups
    _, first, which = np.unique(groups, return_index=True, return_inverse=True)
    extent = np.ptp(commands, axis=1)
    place = close_groups(commands[:, first] / np.where(extent > 0.0, extent, 1.0)[:, None], _NEAR, _WIDEST * _NEAR)
    count = np.bincount(place)
    if np.mean(count[place] > 1) < FEW or np.count_nonzero(count) < LEAST_PLACES:
        return groups
    return np.asarray(np.unique(place[which], return_inverse=True)[1], dtype=np.int64)


def places_warning(data: Measurements) -> tuple[str, ...]:
    """Return a warning of poses that are held out together because they lie close together."""
    groups, place = data.groups(), places(data)
    n_groups, n_places = different(groups), different(place)
    if n_groups == n_places:
        return ()
    return (
        f"{f'{data.source}: ' if data.source else ''}{n_groups} poses lie in {n_places} places, closer together than "
        f"{100 * _NEAR:.0f} % of each joint's range; poses of one place are held out together; for repetitions of one "
        "commanded pose, add a pose column or the commanded joints",
    )
