"""From what was found at each place to a characteristic: every place's figures, and the largest over all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from robacc.geometry import Array
from robacc.iso_9283.distance import distance
from robacc.iso_9283.estimates import IntervalEstimate, largest, largest_of, size, student
from robacc.iso_9283.records import Characteristic, CriterionFigure, IsoCriterion, Symbol

CLAUSES: dict[Symbol, str] = {
    "AP": "7.2.1",
    "RP": "7.2.2",
    "vAP": "7.2.3",
    "AD": "7.3.2",
    "RD": "7.3.3",
    "dAP": "7.6",
    "dRP": "7.6",
    "shift": "7.6",
    "E": "7.7",
}
"""Clause of ISO 9283:1998 that defines each."""
LETTERS = "abc"


@dataclass(frozen=True, slots=True)
class Found:
    """One criterion at one place, before a confidence is chosen."""

    poses: tuple[str, ...]
    source: str | None
    n: int
    position: IntervalEstimate
    axes: tuple[IntervalEstimate, ...] | None = None
    angles: tuple[IntervalEstimate, ...] | None = None
    mean_distance: float | None = None
    sd_distance: float | None = None
    between: str | None = None


def collected(
    symbol: Symbol, found: Sequence[Found], confidence: float, no_angle: str, notes: Sequence[str] = ()
) -> Characteristic:
    """The characteristic over all places, of which there is at least one; ``no_angle`` says why there are no angles."""
    best, position = largest([size(one.position) for one in found], confidence)
    angle, angle_at = CriterionFigure.missing(confidence, no_angle), None
    turned = [(one, letter, size(estimate)) for one in found for letter, estimate in _lettered(one)]
    if turned:
        worst, angle = largest([estimate for _, _, estimate in turned], confidence)
        angle_at = f"{place(turned[worst][0], found)}, {turned[worst][1]}"
    return Characteristic(
        symbol,
        CLAUSES[symbol],
        position,
        place(found[best], found),
        angle,
        angle_at,
        tuple(_criterion(one, confidence) for one in found),
        tuple(notes),
    )


def absent(symbol: Symbol, confidence: float, why: str) -> Characteristic:
    """A characteristic that the data cannot support."""
    missing = CriterionFigure.missing(confidence, why)
    return Characteristic(symbol, CLAUSES[symbol], missing, None, missing, None, ())


def place(one: Found, among: Sequence[Found]) -> str:
    """What to call a place: its poses, with the file where there are several."""
    name = "–".join(one.poses)
    several = len({other.source for other in among}) > 1
    return f"{name} of {one.source}" if several else name


def separation(
    groups: Sequence[Array], names: Sequence[str], turns: Sequence[Array] | None
) -> tuple[IntervalEstimate, tuple[IntervalEstimate, ...] | None, str]:
    """The largest distance between barycentres of groups of visits ``(3, n_i)``, the largest |mean angle difference|s.

    The scatter is pooled over the groups. The third is which two groups are furthest apart.
    """
    pairs = list(combinations(range(len(groups)), 2))
    position = [_apart(groups[h], groups[k], *_pooled(groups)) for h, k in pairs]
    h, k = pairs[max(range(len(pairs)), key=lambda i: position[i].value)]
    angles = None
    if turns is not None:
        scatter, dof = _pooled(turns)
        angles = tuple(
            largest_of([_angle_apart(turns[h][i], turns[k][i], float(scatter[i, i]), dof) for h, k in pairs])
            for i in range(3)
        )
    return largest_of(position), angles, f"{names[h]} and {names[k]}"


def _pooled(groups: Sequence[Array]) -> tuple[Array, float]:
    """Covariance ``(3, 3)`` within groups, and its degrees of freedom."""
    dof = sum(group.shape[1] - 1 for group in groups)
    centred = np.concatenate([group - group.mean(axis=1, keepdims=True) for group in groups], axis=1)
    return centred @ centred.T / max(dof, 1), float(dof)


def _apart(one: Array, other: Array, scatter: Array, dof: float) -> IntervalEstimate:
    share = 1.0 / one.shape[1] + 1.0 / other.shape[1]
    return distance(one.mean(axis=1) - other.mean(axis=1), scatter * share, dof)


def _angle_apart(one: Array, other: Array, variance: float, dof: float) -> IntervalEstimate:
    error = (variance * (1.0 / one.size + 1.0 / other.size)) ** 0.5
    return size(student(float(one.mean() - other.mean()), error, dof))


def _lettered(one: Found) -> list[tuple[str, IntervalEstimate]]:
    return [] if one.angles is None else list(zip(LETTERS, one.angles, strict=True))


def _criterion(one: Found, confidence: float) -> IsoCriterion:
    def figures(estimates: Sequence[IntervalEstimate] | None) -> tuple[CriterionFigure, ...] | None:
        return None if estimates is None else tuple(estimate.figure(confidence) for estimate in estimates)

    return IsoCriterion(
        one.poses,
        one.source,
        one.n,
        one.position.figure(confidence),
        figures(one.axes),
        figures(one.angles),
        one.mean_distance,
        one.sd_distance,
        one.between,
    )
