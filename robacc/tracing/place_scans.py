"""Scan of the places where the instrument may stand, for effects that its line of sight decides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.instrument_place import LineOfSight, Place, first_places, lines_of_sight, neighbours
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.tracing.candidates import TYPICAL_CANDIDATES, Candidate
from robacc.tracing.conditioned_columns import Conditioned, Family
from robacc.tracing.whitened_columns import Columns

_STEP = 0.25
"""First step of the refinement, rad and log distance: half the spacing of the grid."""
_SMALLEST_STEP = 0.004
_MOST_MOVES = 24


@dataclass(frozen=True, eq=False)
class PlaceScan:
    """One form of an effect of the line of sight, on all poses of a linearisation."""

    form: LineOfSight
    arm: Arm
    data: Measurements
    base_columns: Array
    """``(M, 3, n)`` whitened columns of the base along x, y, z of the measuring frame."""
    position: Array
    rotation: Array
    log_prior: float
    """Log prior of the form at one place of the grid."""

    @cached_property
    def places(self) -> Array:
        """``(P, 3)`` places of the grid."""
        return first_places(self.position)

    def candidate(self, place: Array) -> Candidate:
        """Return the effect at a place."""
        effect = self.form.at(rounded(place))
        return Candidate(effect, effect.terms(self.arm, self.data), self.log_prior)

    def family(self, system: Columns, at: NDArray[np.int64], places: Array) -> PlaceFamily:
        """Return the effects at several places, on the poses ``at``."""
        shifts = self.form.shifts(self.position[:, at], self.rotation[:, :, at], places)
        sizes = np.array([typical for _, _, typical in self.form.labels])
        return PlaceFamily(system, self.base_columns[:, :, at], shifts * sizes[:, None, None])

    def refined(self, conditioned: Conditioned, system: Columns, at: NDArray[np.int64], start: Place) -> Candidate:
        """Return the effect at the place of largest evidence near ``start``, by steps that halve."""
        centre, place, step = self.position.mean(axis=1), np.array(start), _STEP
        for _ in range(_MOST_MOVES):
            places = neighbours(place, centre, step)
            scores = self.family(system, at, places).judge(conditioned)
            best = int(np.argmax(scores.evidence))
            if scores.evidence[best] > scores.evidence[len(places) // 2] + 1e-6:
                place = places[best]
            elif step <= _SMALLEST_STEP:
                break
            else:
                step /= 2
        return self.candidate(place)


class PlaceFamily(Family):
    """Effects of one form at several places; their columns are those of the base times the shifts."""

    def __init__(self, system: Columns, base_columns: Array, shifts: Array) -> None:
        """Store ``base_columns`` ``(M, 3, n)`` and the shifts ``(P, Q, 3, n)``."""
        self.shrunk = False
        count, size = shifts.shape[:2]
        columns = np.einsum("mxn,pqxn->mpqn", base_columns, shifts, optimize=True)
        self._columns = columns.reshape(columns.shape[0], count * size, -1)
        self.gram = np.einsum("mpqn,mprn->pqr", columns, columns, optimize=True)
        self.rhs = np.einsum("mcn,mn->c", self._columns, system.residual).reshape(count, size)
        self._store_none(count * size)

    def new_products(self, columns: Array) -> Array:
        """Return ``(A, P Q)`` products of ``columns`` ``(M, A, n)`` with every column of the family."""
        return np.asarray((columns @ np.swapaxes(self._columns, 1, 2)).sum(axis=0))


def place_scans(
    arm: Arm, data: Measurements, base_columns: Array, only: Sequence[str] | None = None
) -> tuple[PlaceScan, ...]:
    """Return a scan of each form of each effect of the line of sight."""
    classes = [cls for name, cls in REGISTRY.items() if issubclass(cls, LineOfSight) and (only is None or name in only)]
    if not classes or data.q is None or data.n < 2:
        return ()
    position, rotation = lines_of_sight(arm, data, "a line of sight")
    scans = []
    for cls in classes:
        effect = cls()
        forms = list(effect.forms())
        places = first_places(position)
        log_prior = -math.log(TYPICAL_CANDIDATES * len(forms) * len(places))
        scans += [PlaceScan(form, arm, data, base_columns, position, rotation, log_prior) for form in forms]
    return tuple(scans)


def is_placed(effect: Effect) -> bool:
    """Return whether a search finds the instrument's place of an effect."""
    return isinstance(effect, LineOfSight)


def place_scan_for(scans: Sequence[PlaceScan], effect: Effect) -> PlaceScan | None:
    """Return the scan of the effect's form, or None."""
    return next((scan for scan in scans if scan.form.search_key() == effect.search_key()), None)


def rounded(place: Array) -> Place:
    """Return a place to the millimetre."""
    x, y, z = (round(float(value), 3) for value in place)
    return (x, y, z)
