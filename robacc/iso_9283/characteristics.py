"""Characteristics from the estimates at each place: every place's figures, and the largest of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from robacc.geometry import Array
from robacc.iso_9283.distance import distance
from robacc.iso_9283.estimates import IntervalEstimate, largest_estimate, largest_figure, magnitude, student
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
"""Clause of ISO 9283:1998 that defines each criterion."""
ANGLE_LETTERS = "abc"


@dataclass(frozen=True, slots=True)
class PlaceEstimate:
    """Estimate of one criterion at one place, before a confidence is chosen."""

    poses: tuple[str, ...]
    source: str | None
    n: int
    position: IntervalEstimate
    axes: tuple[IntervalEstimate, ...] | None = None
    angles: tuple[IntervalEstimate, ...] | None = None
    mean_distance: float | None = None
    sd_distance: float | None = None
    between: str | None = None


def combine_places(
    symbol: Symbol, places: Sequence[PlaceEstimate], confidence: float, no_angle: str, notes: Sequence[str] = ()
) -> Characteristic:
    """Return the characteristic over at least one of ``places``; ``no_angle`` is the reason if angles are missing."""
    largest, position = largest_figure([magnitude(place.position) for place in places], confidence)
    angle, angle_at = CriterionFigure.missing(confidence, no_angle), None
    angles = [(place, letter, magnitude(estimate)) for place in places for letter, estimate in _lettered_angles(place)]
    if angles:
        worst, angle = largest_figure([estimate for _, _, estimate in angles], confidence)
        angle_at = f"{place_label(angles[worst][0], places)}, {angles[worst][1]}"
    return Characteristic(
        symbol,
        CLAUSES[symbol],
        position,
        place_label(places[largest], places),
        angle,
        angle_at,
        tuple(_place_criterion(place, confidence) for place in places),
        tuple(notes),
    )


def missing_characteristic(symbol: Symbol, confidence: float, reason: str) -> Characteristic:
    """Return a characteristic without a value, which the data cannot support, and the reason."""
    missing = CriterionFigure.missing(confidence, reason)
    return Characteristic(symbol, CLAUSES[symbol], missing, None, missing, None, ())


def place_label(place: PlaceEstimate, places: Sequence[PlaceEstimate]) -> str:
    """Return the label of a place: its poses, and the file if ``places`` come from several files."""
    name = "–".join(place.poses)
    in_several_files = len({entry.source for entry in places}) > 1
    return f"{name} of {place.source}" if in_several_files else name


def separation(
    groups: Sequence[Array], names: Sequence[str], group_angles: Sequence[Array] | None
) -> tuple[IntervalEstimate, tuple[IntervalEstimate, ...] | None, str]:
    """Return the largest distance and angle differences between barycentres of groups of visits ``(3, n_i)``.

    The scatter is pooled over the groups. The third element names the two groups with the largest distance.
    """
    pairs = list(combinations(range(len(groups)), 2))
    distances = [_position_separation(groups[first], groups[second], *_pooled(groups)) for first, second in pairs]
    first, second = pairs[max(range(len(pairs)), key=lambda i: distances[i].value)]
    largest_angles = None
    if group_angles is not None:
        covariance, dof = _pooled(group_angles)
        largest_angles = tuple(
            largest_estimate(
                [
                    _angle_separation(group_angles[h][axis], group_angles[k][axis], float(covariance[axis, axis]), dof)
                    for h, k in pairs
                ]
            )
            for axis in range(3)
        )
    return largest_estimate(distances), largest_angles, f"{names[first]} and {names[second]}"


def _pooled(groups: Sequence[Array]) -> tuple[Array, float]:
    """Return the covariance ``(3, 3)`` within groups and its degrees of freedom."""
    dof = sum(group.shape[1] - 1 for group in groups)
    centred = np.concatenate([group - group.mean(axis=1, keepdims=True) for group in groups], axis=1)
    return centred @ centred.T / max(dof, 1), float(dof)


def _position_separation(first: Array, second: Array, covariance: Array, dof: float) -> IntervalEstimate:
    factor = 1.0 / first.shape[1] + 1.0 / second.shape[1]
    return distance(first.mean(axis=1) - second.mean(axis=1), covariance * factor, dof)


def _angle_separation(first: Array, second: Array, variance: float, dof: float) -> IntervalEstimate:
    standard_error = (variance * (1.0 / first.size + 1.0 / second.size)) ** 0.5
    return magnitude(student(float(first.mean() - second.mean()), standard_error, dof))


def _lettered_angles(place: PlaceEstimate) -> list[tuple[str, IntervalEstimate]]:
    return [] if place.angles is None else list(zip(ANGLE_LETTERS, place.angles, strict=True))


def _place_criterion(place: PlaceEstimate, confidence: float) -> IsoCriterion:
    def figures(estimates: Sequence[IntervalEstimate] | None) -> tuple[CriterionFigure, ...] | None:
        return None if estimates is None else tuple(estimate.figure(confidence) for estimate in estimates)

    return IsoCriterion(
        place.poses,
        place.source,
        place.n,
        place.position.figure(confidence),
        figures(place.axes),
        figures(place.angles),
        place.mean_distance,
        place.sd_distance,
        place.between,
    )
