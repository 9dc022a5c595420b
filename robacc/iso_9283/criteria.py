"""Criteria of ISO 9283:1998, clause 7: pose and distance accuracy and repeatability, exchangeability, drift.

"Pose" is the standard's word for a commanded pose; a visit is one arrival at it. The standard's a, b, c are roll, pitch
and yaw of R = Rz(c) Ry(b) Rx(a). Each deviation is wrapped into half a turn, so that angles near half a turn cause no
jump. Within 10 degrees of b = 90 degrees, where a and c are not defined separately, the rotation from the commanded to
the attained orientation about x, y, z of the measuring frame is used.

Visits of one commanded pose are treated as independent Gaussian samples; a drift during the run counts as scatter,
which makes the intervals wider, not narrower. No interval includes the systematic part of the measuring uncertainty.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import combinations, pairwise
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import principal_axes
from robacc.errors import Problem, refuse
from robacc.fitting.registration import Alignment
from robacc.geometry import Array, compose, log_so3, rpy_from_rotation, transpose
from robacc.measurements import Measurements
from robacc.statistics.distributions import normal_quantile, root, student_quantile
from robacc.statistics.intervals import (
    STUDENT,
    EstimateOrReason,
    Interval,
    chi2_interval,
    difference_limits,
    quantiles,
    student_interval,
    tails,
)
from robacc.statistics.lengths import length_probability, mean_lengths

# Visits of each commanded pose, and the records of an evaluation.

_POLE = np.cos(np.deg2rad(80.0))
"""cos(b) below which a deviation of a or c is at least six times the rotation that causes it."""

Symbol = Literal["AP", "RP", "vAP", "AD", "RD", "dAP", "dRP", "shift", "E"]
Figure = TypeVar("Figure")


class CommandedPose(NamedTuple):
    """Visits of one commanded pose of one file, in the order measured if it is known."""

    label: str
    source: str
    number: int
    """Index of the file, from 0."""
    attained: Array
    """``(3, n)`` m, measuring frame."""
    commanded: Array | None
    """``(3,)`` m, of the first visit; None: not known."""
    deviation: Array | None
    """``(3, n)`` attained minus commanded position, m."""
    reference: Array | None
    """``(3,)`` a, b, c of the commanded orientation, or of the first visit if none was commanded, rad."""
    turn: Array | None
    """``(3, n)`` deviations of a, b, c from ``reference``, rad."""
    oriented: bool
    """True if ``reference`` is the commanded orientation."""
    at_pole: bool
    """True if the deviations are about x, y, z of the measuring frame, since a and c are not defined."""
    cycle: NDArray[Any] | None
    """``(n,)`` names of the repetitions."""
    time: Array | None
    """``(n,)`` s"""
    direction: Array | None
    """``(J, n)`` in {-1, 0, 1}"""

    @property
    def n(self) -> int:
        """Number of visits."""
        return int(self.attained.shape[1])

    @property
    def stream(self) -> tuple[int, int]:
        """Stream of random numbers of this pose, independent of the order of rows."""
        return self.number, zlib.crc32(self.label.encode())


@dataclass(frozen=True, slots=True)
class IsoCriterion(Generic[Figure]):
    """One criterion at one place: a commanded pose or a pair of commanded poses.

    Results have figures with the interval at one confidence; the computation has estimates with intervals at any.
    """

    poses: tuple[str, ...]
    source: str | None
    """Name of the file; None if the criterion is over several files."""
    n: int
    """Number of visits, or of pairs of visits."""
    position: Figure
    """m"""
    axes: tuple[Figure, ...] | None = None
    """Components along x, y, z of the measuring frame, m, if the standard defines them."""
    angles: tuple[Figure, ...] | None = None
    """a, b, c: rad."""
    mean_distance: float | None = None
    """RP: mean distance of the visits from their barycentre, m."""
    sd_distance: float | None = None
    """RP: standard deviation S_l of that distance, m."""
    between: str | None = None
    """The two approaches, windows or files with the largest distance."""


class Characteristic(NamedTuple):
    """One criterion over all places: its largest value, and the value at every place."""

    symbol: Symbol
    clause: str
    """Clause of ISO 9283:1998."""
    position: EstimateOrReason
    """Largest value, m; largest absolute value of a signed criterion."""
    position_at: str | None
    """Place of the largest value."""
    angle: EstimateOrReason
    """Largest of a, b, c, rad."""
    angle_at: str | None
    """Place and letter of the largest angle."""
    places: tuple[IsoCriterion[EstimateOrReason], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Iso9283Result:
    """Result of ``robacc iso9283``."""

    n_poses: int
    """Measured poses (rows) of all files."""
    sources: tuple[str, ...]
    """Name of each file."""
    commanded: Literal["robot", "file"] | None
    """Source of the commanded poses; None: not known."""
    poses: tuple[CommandedPose, ...]
    characteristics: tuple[Characteristic, ...]
    """In the standard's order; a criterion that the data cannot support has a reason and no number."""
    protocol: Sequence[Mapping[str, str]]
    """Conditions of the standard's protocol, their status and its reason, with the keys of the result."""
    alignments: tuple[Alignment, ...]
    """Registration of each file, if one was requested."""
    unaligned: Array | None
    """``(files,)`` largest AP before registration, m."""
    confidence: float
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def characteristic(self, symbol: Symbol) -> Characteristic:
        """Return the characteristic with ``symbol``."""
        return next(entry for entry in self.characteristics if entry.symbol == symbol)


def visits_of(
    data: Measurements, command: tuple[Array | None, Array | None], source: str, number: int
) -> tuple[CommandedPose, ...]:
    """Return the commanded poses of one file in the order of their first visit; each target counts as a separate pose.

    ``command`` are the commanded position and orientation of each row, as far as they are known.

    Raises:
        InputError: There are no poses.
    """
    refuse((data.n == 0, Problem("has no measured poses", source)))
    # Grouped by id even if the commands differ, which a warning reports: then the command is wrong.
    ids = data.groups() if data.pose is None else data.pose
    targets = np.zeros(data.n) if data.target is None else data.target
    members: dict[tuple[object, object], list[int]] = {}
    for row, key in enumerate(zip(ids.tolist(), targets.tolist(), strict=True)):
        members.setdefault(key, []).append(row)
    several_targets, poses = len({target for _, target in members}) > 1, []
    for index, ((own, target), visits) in enumerate(members.items()):
        rows = np.array(visits)
        if data.time is not None:
            rows = rows[np.argsort(data.time[rows], kind="stable")]
        cycle, time, direction, rotation, position, orientation = (
            None if column is None else column[..., rows]
            for column in (data.cycle, data.time, data.direction, data.rotation, *command)
        )
        attained, reference, turn, at_pole = data.position[:, rows], None, None, False
        if rotation is not None:
            wanted = rotation[..., :1] if orientation is None else orientation
            angles = rpy_from_rotation(wanted)
            reference, at_pole = angles[:, 0], bool(np.min(np.cos(angles[1])) < _POLE)
            turn = (
                log_so3(compose(rotation, transpose(np.broadcast_to(wanted, rotation.shape))))
                if at_pole
                else wrapped(rpy_from_rotation(rotation) - angles)
            )
        label = f"pose {index + 1}" if data.pose is None else str(own)
        poses.append(
            CommandedPose(
                label=f"{label} {target}" if several_targets else label,
                source=source,
                number=number,
                attained=attained,
                commanded=None if position is None else position[:, 0],
                deviation=None if position is None else attained - position,
                reference=reference,
                turn=turn,
                oriented=orientation is not None,
                at_pole=at_pole,
                cycle=cycle,
                time=time,
                direction=direction,
            )
        )
    return tuple(poses)


def wrapped(angle: Array) -> Array:
    """Return the same angle in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))


# Numbers with the function that computes their interval at any confidence.

ONE_VISIT = "one visit has no scatter to estimate an interval from"
FEW_VISITS = "fewer than three visits"


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
    """A number with the function that computes its interval."""

    value: float
    interval_at: Callable[[float], Interval]
    """Interval at a confidence."""

    def __post_init__(self) -> None:
        """Cache the intervals: each place and the largest over places use the same ones."""
        object.__setattr__(self, "interval_at", lru_cache(maxsize=8)(self.interval_at))


Place = IsoCriterion[IntervalEstimate]


def student(value: float, standard_error: float, dof: float, method: str = STUDENT) -> IntervalEstimate:
    """Return a number with a standard error on ``dof`` degrees of freedom; infinite: normal, below 1: no interval."""
    if dof < 1:
        return IntervalEstimate(value, partial(Interval.missing, why=ONE_VISIT))
    return IntervalEstimate(value, lambda confidence: student_interval(value, standard_error, dof, confidence, method))


def mean(values: Array, offset: float = 0.0) -> IntervalEstimate:
    """Return the mean of ``values`` ``(n,)`` minus ``offset``, by Student's t."""
    deviation = float(np.std(values, ddof=1)) if values.size > 1 else 0.0
    return student(float(np.mean(values)) - offset, deviation / math.sqrt(values.size), values.size - 1)


def magnitude(signed: IntervalEstimate) -> IntervalEstimate:
    """Return the absolute value of a signed estimate."""

    def interval_at(confidence: float) -> Interval:
        interval = signed.interval_at(confidence)
        if interval.lower is None or interval.upper is None or interval.upper_bound is None:
            return interval
        lowest = max(0.0, interval.lower, -interval.upper)
        bound = abs(signed.value) + (interval.upper_bound - signed.value)
        return Interval(lowest, max(-interval.lower, interval.upper), bound, confidence, interval.method)

    return IntervalEstimate(abs(signed.value), interval_at)


def threefold_std(values: Array) -> IntervalEstimate:
    """Return 3 S of ``values`` ``(n,)``, n at least 2, S with divisor n - 1; the interval is exact if Gaussian."""
    value = 3.0 * float(np.std(values, ddof=1))
    dof = values.size - 1.0
    return IntervalEstimate(value, lambda confidence: chi2_interval(value**2, dof, confidence, "chi-square").root())


def change(after: IntervalEstimate, before: IntervalEstimate) -> IntervalEstimate:
    """Return ``after - before`` of two independent estimates, from their intervals."""

    def interval_at(confidence: float) -> Interval:
        later, earlier = after.interval_at(confidence), before.interval_at(confidence)
        for interval in (later, earlier):
            if interval.lower is None or interval.upper is None:
                return interval
        if later.upper_bound is None:
            return Interval.missing(confidence, FEW_VISITS)
        # The lower limit at twice the tail is the one-sided bound.
        two_sided = before.interval_at(2.0 * confidence - 1.0).lower if confidence > 0.5 else before.value
        ends = [(part.lower or 0.0, part.upper or 0.0) for part in (later, earlier)]
        lower, upper = difference_limits(after.value, ends[0], before.value, ends[1])
        bounds = (0.0, later.upper_bound), (two_sided or 0.0, 0.0)
        return Interval(
            lower,
            upper,
            difference_limits(after.value, bounds[0], before.value, bounds[1])[1],
            confidence,
            "from the intervals of both estimates (method of variance estimates recovery)",
        )

    return IntervalEstimate(after.value - before.value, interval_at)


def largest_figure(estimates: Sequence[IntervalEstimate], confidence: float) -> tuple[int, EstimateOrReason]:
    """Return the index of the largest estimate, and the figure of the largest of the true values.

    The largest upper limit needs no correction: it is at least the upper limit of the estimate whose true value is
    largest. Chance would raise the largest lower limit, so each is computed at the tail divided by the number of
    estimates (Bonferroni).
    """
    largest = max(range(len(estimates)), key=lambda i: estimates[i].value)
    intervals = [estimate.interval_at(confidence) for estimate in estimates]
    interval = next((interval for interval in intervals if interval.upper is None), intervals[0])
    if interval.upper is not None and len(estimates) > 1:
        adjusted, lower = 1.0 - (1.0 - confidence) / len(estimates), 0.0
        for plain, i in sorted(((interval.lower or 0.0, i) for i, interval in enumerate(intervals)), reverse=True):
            # A limit at a stricter confidence is lower, so that the first few decide.
            if plain > lower:
                lower = max(lower, estimates[i].interval_at(adjusted).lower or 0.0)
        interval = Interval(
            lower,
            max(interval.upper or 0.0 for interval in intervals),
            max(interval.upper_bound or 0.0 for interval in intervals),
            confidence,
            f"{intervals[largest].method}; largest of {len(estimates)}",
        )
    return largest, EstimateOrReason(estimates[largest].value, interval)


def largest_magnitude(signed: Sequence[IntervalEstimate]) -> IntervalEstimate:
    """Return the largest absolute value of the estimates' true values, as an estimate."""
    sizes = [magnitude(estimate) for estimate in signed]
    value = max(estimate.value for estimate in sizes)
    return IntervalEstimate(value, lambda confidence: largest_figure(sizes, confidence)[1].interval)


# Length of a mean vector with its interval: the distance between barycentres.


def distance(difference: Array, covariance: Array, dof: float) -> IntervalEstimate:
    """Return the length of a mean vector ``(3,)`` with covariance ``(3, 3)`` on ``dof`` degrees of freedom.

    The length is never negative, and it is too large for a vector that is small compared with its scatter. The limits
    are therefore the true lengths under which a length as large or as small has the probability of the tail. Each uses
    the direction under which the measured vector is likeliest, the constrained maximum of the likelihood (T. J.
    DiCiccio, M. A. Martin, S. E. Stern, Canadian Journal of Statistics 29, 2001). The scatter is widened by Student's t
    over the normal quantile, which is exact where the length is large.
    """
    value = float(np.linalg.norm(difference))
    if dof < 1:
        return IntervalEstimate(value, partial(Interval.missing, why=ONE_VISIT))
    variances, axes = principal_axes(covariance)
    if not np.any(variances > 0.0):
        return IntervalEstimate(value, partial(Interval.exact, value))
    components = axes.T @ difference
    # Standard errors from zero beyond which a distance has the error of its own direction (to 1 part in 800).
    if value**2 > 20.0**2 * float(np.sum(variances)):
        return student(value, math.sqrt(float(np.sum(variances * components**2))) / value, dof)

    def limit(probability: float) -> float:
        """Return the true length under which a length up to the measured one has the ``probability``."""
        quantile, outer = normal_quantile(probability), max(probability, 1.0 - probability)
        widened = variances * (student_quantile(outer, dof) / normal_quantile(outer)) ** 2

        @cache
        def excess(length: float) -> float:
            """Return the normal quantile's excess, which rises nearly linearly through zero with the true length."""
            scaled = list(zip(components.tolist(), (variances / variances[0]).tolist(), strict=True))
            low, high = 1e-12, 1e9
            for _ in range(60):
                # The length is even in the logarithm of 1 + lambda.
                middle = math.sqrt(low * high)
                likeliest = [component / (1.0 + (middle - 1.0) * ratio) for component, ratio in scaled]
                low, high = (middle, high) if math.hypot(*likeliest) > length else (low, middle)
            size = math.hypot(*likeliest)
            share = length_probability(
                value, np.array([length, 0.0, 0.0]) if size == 0.0 else np.array(likeliest) * (length / size), widened
            )
            # A probability of 0 or 1 has no finite quantile.
            return quantile - normal_quantile(min(max(share, 1e-15), 1.0 - 1e-15))

        furthest = value + 6.0 * math.sqrt(float(np.sum(widened)))
        # Relative accuracy of a limit.
        return root(excess, 0.0, furthest, 1e-7) if excess(0.0) < 0.0 < excess(furthest) else 0.0

    def interval_at(confidence: float) -> Interval:
        below, above, bound = tails(confidence)
        # No true length is likely for a vector much shorter than its scatter, and the upper limit would be zero; the
        # scatter along the longest axis bounds it from below.
        longest = math.sqrt(float(variances[0]))
        upper, top = (max(limit(1.0 - p), value, longest * student_quantile(p, dof)) for p in (above, bound))
        return Interval(
            limit(1.0 - below),
            upper,
            top,
            confidence,
            "noncentral: the true distances under which the measured distance is likely, scatter as between visits",
        )

    return IntervalEstimate(value, interval_at)


# Position repeatability RP_l = mean l + 3 S_l with its interval.

DELTA = "delta method, normal"
_DRAWS = 4000


def position_repeatability(visits: Array, seed: tuple[int, ...]) -> IntervalEstimate:
    """Return RP_l = mean l + 3 S_l, l the distances of ``visits`` ``(3, n)`` from their barycentre, n at least 2."""
    n = visits.shape[1]
    residuals = visits - visits.mean(axis=1, keepdims=True)
    lengths = np.sqrt(np.sum(np.square(residuals), axis=0))
    length_std = float(np.std(lengths, ddof=1))
    value = float(np.mean(lengths)) + 3.0 * length_std
    if n < 3:
        return IntervalEstimate(value, partial(Interval.missing, why=FEW_VISITS))
    if not np.any(lengths > 0.0):
        return IntervalEstimate(0.0, partial(Interval.exact, 0.0))
    # With more visits, the delta method's error is far below the scatter of the draws.
    if n > 300:
        # Influence of a visit on mean + 3 S: its length, and 3 times its part of dS = d(S^2) / (2 S).
        influence = lengths + 1.5 * np.square(lengths - np.mean(lengths)) / length_std if length_std > 0.0 else lengths
        return student(value, float(np.std(influence, ddof=1)) / math.sqrt(n), math.inf, DELTA)
    # RP of n simulated visits over RP of infinitely many visits.
    variances, _ = principal_axes(residuals @ residuals.T / (n - 1.0))
    points = np.random.default_rng(seed).standard_normal((3, _DRAWS, n)) * np.sqrt(variances)[:, None, None]
    points -= points.mean(axis=2, keepdims=True)
    drawn = np.sqrt(np.sum(np.square(points), axis=0))
    mean_length = float(mean_lengths(variances[::-1, None])[0])
    truth = mean_length + 3.0 * math.sqrt(max(float(np.sum(variances)) - mean_length**2, 0.0))
    ratios = np.asarray((drawn.mean(axis=1) + 3.0 * drawn.std(axis=1, ddof=1)) / truth)

    def interval_at(confidence: float) -> Interval:
        low, high, top = (value / ratio for ratio in quantiles(ratios, [1.0 - p for p in tails(confidence)]))
        return Interval(
            low,
            high,
            top,
            confidence,
            f"parametric bootstrap: RP over the true RP, for Gaussian visits with the same scatter, {_DRAWS} draws",
        )

    return IntervalEstimate(value, interval_at)


# Characteristics from the estimates at each place: every place's figures, and the largest of them.

NO_COMMAND = "the commanded poses are not known: give `robot`, or columns cmd_x, cmd_y, cmd_z"
_NO_ANGLES = "no orientation was measured"
_CRITERIA: dict[Symbol, tuple[str, str]] = {
    "AP": ("7.2.1", "no orientation was commanded and measured"),
    "RP": ("7.2.2", _NO_ANGLES),
    "vAP": ("7.2.3", _NO_ANGLES),
    "AD": ("7.3.2", _NO_ANGLES),
    "RD": ("7.3.3", _NO_ANGLES),
    "dAP": ("7.6", _NO_ANGLES),
    "dRP": ("7.6", _NO_ANGLES),
    "shift": ("7.6", "the angles' shift is their dAP"),
    "E": ("7.7", "the criterion is defined for positions only"),
}
"""Clause of ISO 9283:1998 that defines each criterion, and the reason where no place has angles."""


def characteristic(
    symbol: Symbol, places: Sequence[Place], confidence: float, why: str, notes: Sequence[str] = ()
) -> Characteristic:
    """Return the criterion over ``places``; without any, it has no value, and ``why`` is the reason."""
    clause, no_angle = _CRITERIA[symbol]

    def largest(labelled: Sequence[tuple[str, IntervalEstimate]], reason: str) -> tuple[EstimateOrReason, str | None]:
        if not labelled:
            return EstimateOrReason.missing(confidence, reason), None
        i, figure = largest_figure([magnitude(estimate) for _, estimate in labelled], confidence)
        return figure, labelled[i][0]

    def figure(estimate: IntervalEstimate) -> EstimateOrReason:
        return EstimateOrReason(estimate.value, estimate.interval_at(confidence))

    several_files = len({place.source for place in places}) > 1
    labels = ["–".join(place.poses) + (f" of {place.source}" if several_files else "") for place in places]
    positions = [(label, place.position) for label, place in zip(labels, places, strict=True)]
    angles = [
        (f"{label}, {letter}", estimate)
        for label, place in zip(labels, places, strict=True)
        for letter, estimate in zip("abc", place.angles or (), strict=False)
    ]
    figures = tuple(
        IsoCriterion(
            place.poses,
            place.source,
            place.n,
            figure(place.position),
            None if place.axes is None else tuple(map(figure, place.axes)),
            None if place.angles is None else tuple(map(figure, place.angles)),
            place.mean_distance,
            place.sd_distance,
            place.between,
        )
        for place in places
    )
    return Characteristic(
        symbol,
        clause,
        *largest(positions, why),
        *largest(angles, no_angle if places else why),
        figures,
        tuple(notes) if places else (),
    )


def _each(function: Callable[[Array], IntervalEstimate], rows: Array | None) -> tuple[IntervalEstimate, ...] | None:
    """Return the estimate from each row; None where there are none."""
    return None if rows is None else tuple(map(function, rows))


def separation(
    groups: Sequence[Array], names: Sequence[str], group_angles: Sequence[Array] | None
) -> tuple[IntervalEstimate, tuple[IntervalEstimate, ...] | None, str]:
    """Return the largest distance and angle differences between barycentres of groups of visits ``(3, n_i)``.

    The scatter is pooled over the groups. The third element names the two groups with the largest distance.
    """
    pairs = list(combinations(range(len(groups)), 2))
    covariance, dof = _pooled(groups)
    means, shares = [group.mean(axis=1) for group in groups], [1.0 / group.shape[1] for group in groups]
    distances = [distance(means[h] - means[k], covariance * (shares[h] + shares[k]), dof) for h, k in pairs]
    first, second = pairs[max(range(len(pairs)), key=lambda i: distances[i].value)]
    angles = None
    if group_angles is not None:
        angles = _largest_angles([(group_angles[h], group_angles[k]) for h, k in pairs], group_angles)
    return largest_magnitude(distances), angles, f"{names[first]} and {names[second]}"


def _pooled(groups: Sequence[Array]) -> tuple[Array, float]:
    """Return the covariance ``(K, K)`` within groups ``(K, n_i)`` and its degrees of freedom."""
    dof = sum(group.shape[1] - 1 for group in groups)
    centred = np.concatenate([group - group.mean(axis=1, keepdims=True) for group in groups], axis=1)
    return centred @ centred.T / max(dof, 1), float(dof)


def _largest_angles(pairs: Sequence[tuple[Array, Array]], groups: Sequence[Array]) -> tuple[IntervalEstimate, ...]:
    """Return the largest difference of mean a, b and c of ``pairs`` of groups, with the scatter of all ``groups``."""
    covariance, dof = _pooled(groups)
    shares = [1.0 / one.shape[1] + 1.0 / other.shape[1] for one, other in pairs]
    angles = []
    for axis, variance in enumerate(np.diag(covariance).tolist()):
        means = [float(one[axis].mean() - other[axis].mean()) for one, other in pairs]
        errors = [(variance * share) ** 0.5 for share in shares]
        angles.append(largest_magnitude([student(*entry, dof) for entry in zip(means, errors, strict=True)]))
    return tuple(angles)


# Pose accuracy, repeatability, multi-directional variation and exchangeability: clauses 7.2 and 7.7 of ISO 9283:1998.
#
# With n visits p_j of a commanded pose p_c, their barycentre p̄ and the distances l_j = |p_j - p̄|:
#
#     AP_p = |p̄ - p_c|,  AP_x = x̄ - x_c …,  AP_a = ā - a_c …
#     RP_l = l̄ + 3 S_l,  S_l^2 = sum (l_j - l̄)^2 / (n - 1),  RP_a = ± 3 S_a …
#     vAP_p = max |p̄_h - p̄_k|,  vAP_a = max |ā_h - ā_k| …   over approaches h, k
#     E = max |p̄_h - p̄_k|                                    over robots h, k

SAME_COMMAND = 1e-6
"""m: commanded positions closer than this are the same."""


def accuracy(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the accuracy (AP) of every commanded pose."""
    places = []
    for pose in poses:
        if pose.deviation is None:
            return characteristic("AP", [], confidence, NO_COMMAND)
        covariance = np.cov(pose.deviation, ddof=1) / pose.n if pose.n > 1 else np.zeros((3, 3))
        places.append(
            IsoCriterion(
                (pose.label,),
                pose.source,
                pose.n,
                distance(pose.deviation.mean(axis=1), covariance, pose.n - 1),
                _each(mean, pose.deviation),
                _each(mean, pose.turn if pose.oriented else None),
            )
        )
    return characteristic("AP", places, confidence, NO_COMMAND)


def repeatability(poses: Sequence[CommandedPose], confidence: float, seed: int) -> Characteristic:
    """Return the repeatability (RP) of every commanded pose with at least two visits."""
    places = []
    for pose in (pose for pose in poses if pose.n > 1):
        lengths = np.sqrt(np.sum(np.square(pose.attained - pose.attained.mean(axis=1, keepdims=True)), axis=0))
        places.append(
            IsoCriterion(
                (pose.label,),
                pose.source,
                pose.n,
                position_repeatability(pose.attained, (seed, *pose.stream)),
                angles=_each(threefold_std, pose.turn),
                mean_distance=float(np.mean(lengths)),
                sd_distance=float(np.std(lengths, ddof=1)),
            )
        )
    return characteristic(
        "RP", places, confidence, "every commanded pose was visited only once: RP needs several cycles"
    )


def multidirectional(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the variation (vAP) of every commanded pose with several approaches (directions of the joints)."""
    why = "every commanded pose was always approached from the same direction"
    if all(pose.direction is None for pose in poses):
        why = "approach directions are not known: give dir_q columns, or `ordered`"
    places = []
    for pose in poses:
        if pose.direction is None:
            continue
        # Visits without a moving joint are left out.
        moving = np.flatnonzero(np.any(pose.direction != 0, axis=0))
        approaches, index = np.unique(pose.direction[:, moving], axis=1, return_inverse=True)
        names = ["".join("−0+"[int(np.sign(value)) + 1] for value in directions) for directions in approaches.T]
        # Largest number of approach directions at a pose; more are random moves.
        if len(names) > 8:
            why = "the moves to a pose differ from visit to visit: there are no approaches to compare"
        elif len(names) > 1:
            rows = [moving[index.ravel() == i] for i in range(len(names))]
            turns = None if pose.turn is None else [pose.turn[:, part] for part in rows]
            position, angles, between = separation([pose.attained[:, part] for part in rows], names, turns)
            places.append(
                IsoCriterion((pose.label,), pose.source, moving.size, position, None, angles, between=between)
            )
    return characteristic("vAP", places, confidence, why)


def exchangeability(
    poses_by_file: Sequence[Sequence[CommandedPose]], attained: Sequence[Sequence[Array]], confidence: float
) -> Characteristic:
    """Return E between robots, one per file, at the commanded poses that all files have.

    Args:
        poses_by_file: Commanded poses of each file.
        attained: Attained positions ``(3, n)`` of each commanded pose, in a frame that the robots share, m.
        confidence: Confidence of the intervals.
    """
    if len(poses_by_file) < 2:
        return characteristic("E", [], confidence, "exchangeability compares several robots: give one file per robot")
    by_label = [
        {pose.label: (pose, positions) for pose, positions in zip(*file, strict=True)}
        for file in zip(poses_by_file, attained, strict=True)
    ]
    places = []
    for label in [label for label in by_label[0] if all(label in labels for labels in by_label[1:])]:
        shared, groups = zip(*(labels[label] for labels in by_label), strict=True)
        first = shared[0]
        for pose in shared[1:]:
            is_known = first.commanded is not None and pose.commanded is not None
            offset = float(np.linalg.norm(pose.commanded - first.commanded)) if is_known else 0.0
            if offset > SAME_COMMAND:
                return characteristic(
                    "E",
                    [],
                    confidence,
                    f"{pose.label} of {pose.source} is commanded {offset * 1e3:.3g} mm from that of {first.source}: "
                    "exchangeability needs the same commanded poses",
                )
        position, _, between = separation(groups, [pose.source for pose in shared], None)
        places.append(IsoCriterion((label,), None, sum(pose.n for pose in shared), position, between=between))
    return characteristic("E", places, confidence, "the files share no commanded pose")


# Distance accuracy and distance repeatability: clause 7.3 of ISO 9283:1998.
#
# With D_j = |p_1j - p_2j| between the j-th visits of two commanded poses and D_c = |p_c1 - p_c2|:
#
#     AD_p = D̄ - D_c,   RD_p = ± 3 S_D,   S_D^2 = sum (D_j - D̄)^2 / (n - 1)
#
# and likewise for D_x = |x_1 - x_2| … and the angles' D_a = |a_1 - a_2| …; registration of frames has no effect.

MAX_POSES_ALL_PAIRS = 10
"""With more commanded poses, only neighbours in the order of their first visit are paired."""


def distance_criteria(poses: Sequence[CommandedPose], confidence: float) -> tuple[Characteristic, Characteristic]:
    """Return AD and RD between the commanded poses of each file."""
    pairs: list[tuple[CommandedPose, CommandedPose]] = []
    notes: list[str] = []
    for number in sorted({pose.number for pose in poses}):
        file_poses = [pose for pose in poses if pose.number == number]
        if len(file_poses) <= MAX_POSES_ALL_PAIRS:
            pairs += combinations(file_poses, 2)
        else:
            pairs += pairwise(file_poses)
            notes = [
                f"with more than {MAX_POSES_ALL_PAIRS} commanded poses only neighbours in order of visit are paired"
            ]
    why = why_accuracy = "no cycle visits two commanded poses" if pairs else "one commanded pose has no distances"
    accurate, repeatable = [], []
    is_commanded = all(pose.commanded is not None for pose in poses)
    for pose_a, pose_b in pairs:
        # Visits of the same cycle match, else the j-th of one with the j-th of the other.
        rows_a = rows_b = np.arange(min(pose_a.n, pose_b.n))
        cycles = [pose.cycle for pose in (pose_a, pose_b) if pose.cycle is not None]
        if len(cycles) == 2 and [np.unique(cycle).size for cycle in cycles] == [pose_a.n, pose_b.n]:
            _, rows_a, rows_b = np.intersect1d(cycles[0], cycles[1], return_indices=True)
        if rows_a.size == 0:
            continue
        why, why_accuracy = "every pair of commanded poses was visited once: RD needs cycles", NO_COMMAND
        place = (pose_a.label, pose_b.label), pose_a.source, int(rows_a.size)
        differences = pose_a.attained[:, rows_a] - pose_b.attained[:, rows_b]
        length, axes, angles, turned = np.sqrt(np.sum(np.square(differences), axis=0)), np.abs(differences), None, None
        turns = [
            (pose.reference, pose.turn[:, rows])
            for pose, rows in ((pose_a, rows_a), (pose_b, rows_b))
            if pose.reference is not None and pose.turn is not None and not pose.at_pole
        ]
        if len(turns) == 2:
            (reference_a, turn_a), (reference_b, turn_b) = turns
            turned = wrapped(reference_a - reference_b)
            # Relative to the references' difference, so that poses half a turn apart do not flip sign.
            angles = np.abs(turned[:, None] + turn_a - turn_b)
        if pose_a.commanded is not None and pose_b.commanded is not None and is_commanded:
            offset = pose_a.commanded - pose_b.commanded
            accurate.append(
                IsoCriterion(
                    *place,
                    mean(length, float(np.linalg.norm(offset))),
                    _less(axes, offset),
                    _less(angles, turned) if pose_a.oriented and pose_b.oriented else None,
                )
            )
        if rows_a.size > 1:
            repeatable.append(
                IsoCriterion(*place, threefold_std(length), _each(threefold_std, axes), _each(threefold_std, angles))
            )
    return (
        characteristic("AD", accurate, confidence, why_accuracy, notes),
        characteristic("RD", repeatable, confidence, why, notes),
    )


def _less(distances: Array | None, commanded: Array | None) -> tuple[IntervalEstimate, ...] | None:
    """Return the mean of each row of ``distances`` ``(3, n)`` less the commanded one; None where they are not known."""
    return None if distances is None or commanded is None else tuple(map(mean, distances, np.abs(commanded).tolist()))


# Drift of pose characteristics over the run: clause 7.6 of ISO 9283:1998.
#
# The visits of each commanded pose, ordered by time (by the file's rows if no time was logged), are divided into
# windows of equal size. With t = 0 the first window and T any later one:
#
#     dAP_p = max |AP_p(t = 0) - AP_p(t = T)|,   dRP_p = max |RP_l(t = 0) - RP_l(t = T)|,   angles likewise
#
# AP is a length and can stay constant while the pose moves around the command, so the shift of the barycentre itself
# is reported too: max |p̄(t = T) - p̄(t = 0)|.

MIN_WINDOW_VISITS = 3
"""Smallest number of visits in a window: RP of two visits is almost entirely chance."""


def drift(
    poses: Sequence[CommandedPose], confidence: float, seed: int, windows: int | None = None
) -> tuple[Characteristic, Characteristic, Characteristic]:
    """Return dAP, dRP and the barycentre's shift; ``windows`` None: as many as have ten visits each, two to ten.

    Poses with fewer than three visits in each window are left out.
    """
    divided = [
        (pose, np.array_split(np.arange(pose.n), count))
        for pose in poses
        for count in [windows or min(max(pose.n // 10, 2), 10)]
        if pose.n >= MIN_WINDOW_VISITS * count
    ]
    why = (
        f"drift needs {MIN_WINDOW_VISITS * (windows or 2)} visits of a commanded pose, {MIN_WINDOW_VISITS} in each of "
        f"{windows or 2} windows"
    )
    notes = [_window_note(*entry) for entry in divided[:1]]
    is_commanded = all(pose.deviation is not None for pose, _ in divided)
    accurate, repeated, shifted = [], [], []
    for pose, rows in divided:
        attained = [pose.attained[:, part] for part in rows]
        turns = None if pose.turn is None else [pose.turn[:, part] for part in rows]
        if is_commanded and pose.deviation is not None:
            # AP_a = ā - a_c changes as ā does.
            angles = (
                _largest_angles([(turn, turns[0]) for turn in turns[1:]], turns)
                if turns is not None and pose.oriented
                else None
            )
            accurate.append(_drift_place(pose, _accuracy_changes([pose.deviation[:, part] for part in rows]), angles))
        spreads = [position_repeatability(part, (seed, *pose.stream, i)) for i, part in enumerate(attained)]
        angles = None
        if turns is not None:
            by_axis = [[threefold_std(turn[axis]) for turn in turns] for axis in range(3)]
            angles = tuple(largest_magnitude([change(later, first) for later in rest]) for first, *rest in by_axis)
        repeated.append(_drift_place(pose, [change(later, spreads[0]) for later in spreads[1:]], angles))
        moves = [separation([attained[0], later], ("", ""), None)[0] for later in attained[1:]]
        shifted.append(_drift_place(pose, moves, None))
    return (
        characteristic("dAP", accurate, confidence, NO_COMMAND if divided else why, notes),
        characteristic("dRP", repeated, confidence, why, notes),
        characteristic("shift", shifted, confidence, why, notes),
    )


def _window_note(pose: CommandedPose, window_rows: Sequence[NDArray[np.int64]]) -> str:
    order = "in the order of the file's rows"
    if pose.time is not None:
        first, last = (float(np.mean(pose.time[rows])) for rows in (window_rows[0], window_rows[-1]))
        order = f"by time_s, the first and the last {(last - first) / 60.0:.3g} min apart"
    smallest, largest = window_rows[-1].size, window_rows[0].size
    count = str(largest) if smallest == largest else f"{smallest} or {largest}"
    return f"{len(window_rows)} windows of {count} visits, {order}; each against the first"


def _drift_place(
    pose: CommandedPose, changes: Sequence[IntervalEstimate], angles: tuple[IntervalEstimate, ...] | None
) -> Place:
    """Return the largest absolute change of the windows after the first, and those of the angles."""
    largest = max(range(len(changes)), key=lambda window: abs(changes[window].value))
    return IsoCriterion(
        (pose.label,),
        pose.source,
        pose.n,
        largest_magnitude(changes),
        angles=angles,
        between=f"windows 1 and {largest + 2}",
    )


def _accuracy_changes(windows: Sequence[Array]) -> list[IntervalEstimate]:
    """Return the changes of AP from the first window of deviations ``(3, n_i)`` to each later one."""
    covariance, dof = _pooled(windows)
    means = np.stack([window.mean(axis=1) for window in windows], axis=1)
    lengths = np.sqrt(np.sum(np.square(means), axis=0))
    directions = np.divide(means, lengths, out=np.zeros_like(means), where=lengths > 0.0)
    # AP changes as the mean does along its own direction (delta method).
    variances = np.einsum("iw,ij,jw->w", directions, covariance, directions) / [part.shape[1] for part in windows]
    errors = np.sqrt(variances[1:] + variances[0])
    return [student(float(at - lengths[0]), float(error), dof) for at, error in zip(lengths[1:], errors, strict=True)]
