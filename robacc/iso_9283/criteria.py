"""Criteria of ISO 9283:1998, clause 7: pose and distance accuracy and repeatability, exchangeability, drift.

"Pose" is the standard's word for a commanded pose; a visit is one arrival at it. The standard's a, b, c are roll, pitch
and yaw of R = Rz(c) Ry(b) Rx(a). Each deviation is wrapped into half a turn, so that angles near half a turn cause no
jump. Within 10 degrees of b = 90 degrees, where a and c are not defined separately, the rotation from the commanded to
the attained orientation about x, y, z of the measuring frame is used.

Visits of one commanded pose are treated as independent Gaussian samples; a drift during the run counts as scatter,
which makes the intervals wider, not narrower. No interval includes the systematic part of the measuring uncertainty.
"""

import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from robacc.accuracy.error_statistics import principal_axes
from robacc.errors import Problem, by_key, refuse
from robacc.geometry import Array, NDArray, compose, log_so3, rpy_from_rotation, transpose
from robacc.measurements import STILL, Measurements
from robacc.statistics.intervals import (
    STUDENT,
    EstimateOrReason,
    Interval,
    chi2_interval,
    difference_limits,
    normal_quantile,
    quantiles,
    root,
    student_interval,
    student_quantile,
)
from robacc.statistics.lengths import length_probability, mean_lengths

if TYPE_CHECKING:
    from robacc.fitting.registration import Alignment

# Visits of each commanded pose, and the records of an evaluation.


Symbol = Literal["AP", "RP", "vAP", "AD", "RD", "dAP", "dRP", "shift", "E"]


class CommandedPose(NamedTuple):
    """Visits of one commanded pose of one file."""

    label: str
    source: str
    number: int
    """Index of the file, from 0."""
    data: Measurements
    """The visits, in the order measured if it is known."""
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

    def place(self, position: Any, n: int | None = None, **others: Any) -> "IsoCriterion":
        """Return a criterion at this pose, of ``n`` visits or of all."""
        return IsoCriterion((self.label,), self.source, self.data.n if n is None else n, position, **others)

    def parts(self, rows: Sequence[NDArray[np.int64]]) -> tuple[list[Array], list[Array] | None]:
        """Return attained positions and deviations of the angles of groups of visits, ``(3, n_i)`` each."""
        turns = None if self.turn is None else [self.turn[:, part] for part in rows]
        return [self.data.position[:, part] for part in rows], turns

    def seed(self, *numbers: int) -> tuple[int, ...]:
        """Return the seed of this pose's random numbers, independent of the order of rows."""
        return numbers[0], self.number, zlib.crc32(self.label.encode()), *numbers[1:]


class IsoCriterion(NamedTuple):
    """One criterion at one place: a commanded pose or a pair of commanded poses.

    Results have figures with the interval at one confidence; the computation has estimates with intervals at any.
    """

    poses: tuple[str, ...]
    source: str | None
    """Name of the file; None if the criterion is over several files."""
    n: int
    """Number of visits, or of pairs of visits."""
    position: Any
    """m"""
    axes: tuple[Any, ...] | None = None
    """Components along x, y, z of the measuring frame, m, if the standard defines them."""
    angles: tuple[Any, ...] | None = None
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
    places: tuple[IsoCriterion, ...]
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
    alignments: "tuple[Alignment, ...]"
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
    members = by_key(zip(zip(ids.tolist(), targets.tolist(), strict=True), range(data.n), strict=True))
    several_targets, poses = len({target for _, target in members}) > 1, []
    for index, ((own, target), visits) in enumerate(members.items()):
        rows = np.array(visits)
        if data.time is not None:
            rows = rows[np.argsort(data.time[rows], kind="stable")]
        position, orientation = (None if column is None else column[..., rows] for column in command)
        of_pose, reference, turn, at_pole = data.subset(rows), None, None, False
        if (rotation := of_pose.rotation) is not None:
            wanted = rotation[..., :1] if orientation is None else orientation
            angles = rpy_from_rotation(wanted)
            # From b = 80° a deviation of a or c is at least six times the rotation that causes it.
            reference, at_pole = angles[:, 0], bool(np.min(np.cos(angles[1])) < np.cos(np.deg2rad(80.0)))
            turn = (
                log_so3(compose(rotation, transpose(np.broadcast_to(wanted, rotation.shape))))
                if at_pole
                else wrapped(rpy_from_rotation(rotation) - angles)
            )
        label = f"pose {index + 1}" if data.pose is None else str(own)
        poses.append(
            CommandedPose(
                f"{label} {target}" if several_targets else label,
                source,
                number,
                of_pose,
                None if position is None else position[:, 0],
                None if position is None else of_pose.position - position,
                *(reference, turn, orientation is not None, at_pole),
            )
        )
    return tuple(poses)


def wrapped(angle: Array) -> Array:
    """Return the same angle in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))


# Numbers with the function that computes their interval at any confidence.


class IntervalEstimate(NamedTuple):
    """A number with the function that computes its interval."""

    value: float
    interval_at: Callable[[float], Interval]
    """Interval at a confidence."""

    def figure(self, confidence: float) -> EstimateOrReason:
        """Return the number with its interval at a confidence."""
        return EstimateOrReason(self.value, self.interval_at(confidence))


def student(value: float, standard_error: float, dof: float, method: str = STUDENT) -> IntervalEstimate:
    """Return a number with a standard error on ``dof`` degrees of freedom; infinite: normal, below 1: no interval."""
    if dof < 1:
        why = "one visit has no scatter to estimate an interval from"
        return IntervalEstimate(value, partial(Interval.missing, why=why))
    return IntervalEstimate(value, lambda confidence: student_interval(value, standard_error, dof, confidence, method))


def mean(values: Array, offset: float = 0.0) -> IntervalEstimate:
    """Return the mean of ``values`` ``(n,)`` minus ``offset``, by Student's t."""
    deviation = float(np.std(values, ddof=1)) if values.size > 1 else 0.0
    return student(float(np.mean(values)) - offset, deviation / math.sqrt(values.size), values.size - 1)


def magnitude(signed: IntervalEstimate) -> IntervalEstimate:
    """Return the absolute value of a signed estimate."""

    def interval_at(confidence: float) -> Interval:
        interval = signed.interval_at(confidence)
        if interval.limits is None:
            return interval
        low, high, bound = interval.limits
        bound += abs(signed.value) - signed.value
        return Interval(max(0.0, low, -high), max(-low, high), bound, confidence, interval.method)

    return IntervalEstimate(abs(signed.value), interval_at)


def threefold_std(values: Array) -> IntervalEstimate:
    """Return 3 S of ``values`` ``(n,)``, n at least 2, S with divisor n - 1; the interval is exact if Gaussian."""
    value, dof = 3.0 * float(np.std(values, ddof=1)), values.size - 1.0
    return IntervalEstimate(value, lambda confidence: chi2_interval(value**2, dof, confidence, "chi-square").root())


def change(after: IntervalEstimate, before: IntervalEstimate) -> IntervalEstimate:
    """Return ``after - before`` of two independent estimates, from their intervals."""

    def interval_at(confidence: float) -> Interval:
        later, earlier = after.interval_at(confidence), before.interval_at(confidence)
        if later.limits is None or earlier.limits is None:
            return later if later.limits is None else earlier
        (low, high, top), (*ends, _) = later.limits, earlier.limits
        # The lower limit at twice the tail is the one-sided bound.
        two_sided = before.interval_at(2.0 * confidence - 1.0).lower if confidence > 0.5 else before.value
        return Interval(
            *difference_limits(after.value, (low, high), before.value, (ends[0], ends[1])),
            difference_limits(after.value, (0.0, top), before.value, (two_sided or 0.0, 0.0))[1],
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
    interval = next((interval for interval in intervals if interval.limits is None), intervals[0])
    if interval.limits is not None and len(estimates) > 1:
        adjusted = 1.0 - (1.0 - confidence) / len(estimates)
        lower, upper, bound = zip(*(interval.limits for interval in intervals if interval.limits), strict=True)
        least = estimates[lower.index(max(lower))].interval_at(adjusted).lower or 0.0
        # A limit at a stricter confidence is lower, so that the first few decide.
        others = [estimate for estimate, low in zip(estimates, lower, strict=True) if low > least]
        stricter = (estimate.interval_at(adjusted).lower or 0.0 for estimate in others)
        method = f"{intervals[largest].method}; largest of {len(estimates)}"
        interval = Interval(max(0.0, least, *stricter), max(0.0, *upper), max(0.0, *bound), confidence, method)
    return largest, EstimateOrReason(estimates[largest].value, interval)


def largest_magnitude(signed: Sequence[IntervalEstimate]) -> IntervalEstimate:
    """Return the largest absolute value of the estimates' true values, as an estimate."""
    sizes = [*map(magnitude, signed)]
    value = max(estimate.value for estimate in sizes)
    return IntervalEstimate(value, cache(lambda confidence: largest_figure(sizes, confidence)[1].interval))


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
    variances, axes = principal_axes(covariance)
    components, longest = axes.T @ difference, math.sqrt(float(variances[0]))
    # Standard errors from zero beyond which a distance has the error of its own direction (to 1 part in 800).
    if dof < 1 or value**2 > 20.0**2 * float(np.sum(variances)) > 0.0:
        return student(value, math.sqrt(float(np.sum(variances * components**2))) / (value or 1.0), dof)
    if longest == 0.0:
        return IntervalEstimate(value, partial(Interval.exact, value))
    scaled = list(zip(components.tolist(), (variances / variances[0]).tolist(), strict=True))

    def limit(probability: float) -> float:
        """Return the true length under which a length up to the measured one has the ``probability``."""
        quantile, outer = normal_quantile(probability), max(probability, 1.0 - probability)
        widened = variances * (student_quantile(outer, dof) / normal_quantile(outer)) ** 2

        @cache
        def excess(length: float) -> float:
            """Return the normal quantile's excess, which rises nearly linearly through zero with the true length."""
            low, high = 1e-12, 1e9
            for _ in range(60):
                # The length is even in the logarithm of 1 + lambda.
                middle = math.sqrt(low * high)
                likeliest = [component / (1.0 + (middle - 1.0) * ratio) for component, ratio in scaled]
                low, high = (middle, high) if math.hypot(*likeliest) > length else (low, middle)
            size = math.hypot(*likeliest)
            along = np.array([length, 0.0, 0.0]) if size == 0.0 else np.array(likeliest) * (length / size)
            # A probability of 0 or 1 has no finite quantile.
            share = min(max(length_probability(value, along, widened), 1e-15), 1.0 - 1e-15)
            return quantile - normal_quantile(share)

        furthest = value + 6.0 * math.sqrt(float(np.sum(widened)))
        # Relative accuracy of a limit.
        return root(excess, 0.0, furthest, 1e-7) if excess(0.0) < 0.0 < excess(furthest) else 0.0

    def limit_of(p: float) -> float:
        # No true length is likely for a vector much shorter than its scatter, and the upper limit would be zero; the
        # scatter along the longest axis bounds it from below.
        return limit(1.0 - p) if p < 0.5 else max(limit(1.0 - p), value, longest * student_quantile(p, dof))

    method = "noncentral: the true distances under which the measured distance is likely, scatter as between visits"
    return IntervalEstimate(value, cache(lambda confidence: Interval.at(limit_of, confidence, method)))


# Position repeatability RP_l = mean l + 3 S_l with its interval.

DELTA = "delta method, normal"
_DRAWS = 4000


def position_repeatability(visits: Array, seed: tuple[int, ...]) -> IntervalEstimate:
    """Return RP_l = mean l + 3 S_l, l the distances of ``visits`` ``(3, n)`` from their barycentre, n at least 2."""
    n = visits.shape[1]
    residuals = visits - visits.mean(axis=1, keepdims=True)
    lengths = np.linalg.norm(residuals, axis=0)
    length_std = float(np.std(lengths, ddof=1))
    value = float(np.mean(lengths)) + 3.0 * length_std
    if n < 3:
        return IntervalEstimate(value, partial(Interval.missing, why="fewer than three visits"))
    if value == 0.0:
        return IntervalEstimate(0.0, partial(Interval.exact, 0.0))
    # With more visits, the delta method's error is far below the scatter of the draws.
    if n > 300:
        # Influence of a visit on mean + 3 S: its length, and 3 times its part of dS = d(S^2) / (2 S).
        influence = lengths + 1.5 * np.square(lengths - np.mean(lengths)) / (length_std or 1.0)
        return student(value, float(np.std(influence, ddof=1)) / math.sqrt(n), math.inf, DELTA)
    # RP of n simulated visits over RP of infinitely many visits.
    variances, _ = principal_axes(residuals @ residuals.T / (n - 1.0))
    points = np.random.default_rng(seed).standard_normal((3, _DRAWS, n)) * np.sqrt(variances)[:, None, None]
    points -= points.mean(axis=2, keepdims=True)
    drawn = np.sqrt(np.sum(np.square(points), axis=0))
    mean_length = float(mean_lengths(variances[::-1, None])[0])
    truth = mean_length + 3.0 * math.sqrt(max(float(np.sum(variances)) - mean_length**2, 0.0))
    ratios = np.asarray((drawn.mean(axis=1) + 3.0 * drawn.std(axis=1, ddof=1)) / truth)
    method = f"parametric bootstrap: RP over the true RP, for Gaussian visits with the same scatter, {_DRAWS} draws"
    return IntervalEstimate(value, lambda c: Interval.at(lambda p: value / quantiles(ratios, [1.0 - p])[0], c, method))


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
    symbol: Symbol, places: Sequence[IsoCriterion], confidence: float, why: str, notes: Sequence[str] = ()
) -> Characteristic:
    """Return the criterion over ``places``; without any, it has no value, and ``why`` is the reason."""
    clause, no_angle = _CRITERIA[symbol]

    def largest(labelled: Sequence[tuple[str, IntervalEstimate]], reason: str) -> tuple[EstimateOrReason, str | None]:
        if not labelled:
            return EstimateOrReason.missing(confidence, reason), None
        i, figure = largest_figure([magnitude(estimate) for _, estimate in labelled], confidence)
        return figure, labelled[i][0]

    def figures(estimates: Sequence[IntervalEstimate] | None) -> tuple[EstimateOrReason, ...] | None:
        return None if estimates is None else tuple(estimate.figure(confidence) for estimate in estimates)

    several_files = len({place.source for place in places}) > 1
    of_file = [f" of {place.source}" * several_files for place in places]
    labelled = [("–".join(place.poses) + name, place) for name, place in zip(of_file, places, strict=True)]
    angles = [
        (f"{label}, {letter}", estimate)
        for label, place in labelled
        for letter, estimate in zip("abc", place.angles or (), strict=False)
    ]
    return Characteristic(
        symbol,
        clause,
        *largest([(label, place.position) for label, place in labelled], why),
        *largest(angles, no_angle if places else why),
        tuple(
            place._replace(
                position=place.position.figure(confidence), axes=figures(place.axes), angles=figures(place.angles)
            )
            for place in places
        ),
        tuple(notes) if places else (),
    )


def _each(function: Callable[..., IntervalEstimate], *rows: Any) -> tuple[IntervalEstimate, ...] | None:
    """Return the estimate from each row; None where there are none."""
    return None if rows[0] is None else tuple(map(function, *rows))


def _pooled(groups: Sequence[Array]) -> tuple[Array, Array, Array, float]:
    """Return means ``(3, G)`` of groups ``(3, n_i)``, covariance ``(3, 3)`` within them, 1 / n_i, and its dof."""
    sizes = np.array([group.shape[1] for group in groups])
    means = np.stack([group.mean(axis=1) for group in groups], axis=1)
    centred = np.concatenate(groups, axis=1) - np.repeat(means, sizes, axis=1)
    dof = float(np.sum(sizes - 1))
    return means, centred @ centred.T / max(dof, 1.0), 1.0 / sizes, dof


def separation(groups: Sequence[Array], pairs: Sequence[tuple[int, int]]) -> list[IntervalEstimate]:
    """Return the distances between the barycentres of pairs of groups of visits ``(3, n_i)``, with pooled scatter."""
    means, covariance, shares, dof = _pooled(groups)
    return [distance(means[:, h] - means[:, k], covariance * (shares[h] + shares[k]), dof) for h, k in pairs]


def _largest_angles(
    groups: Sequence[Array] | None, pairs: Sequence[tuple[int, int]]
) -> tuple[IntervalEstimate, ...] | None:
    """Return the largest difference of mean a, b and c of ``pairs`` of groups, with the scatter of all groups."""
    if groups is None:
        return None
    means, covariance, shares, dof = _pooled(groups)
    first, second = np.array(pairs).T
    values = (means[:, first] - means[:, second]).tolist()
    spreads = np.sqrt(np.outer(np.diag(covariance), shares[first] + shares[second])).tolist()
    return tuple(
        largest_magnitude([student(value, spread, dof) for value, spread in zip(*row, strict=True)])
        for row in zip(values, spreads, strict=True)
    )


# Pose accuracy, repeatability, multi-directional variation and exchangeability: clauses 7.2 and 7.7 of ISO 9283:1998.
#
# With n visits p_j of a commanded pose p_c, their barycentre p̄ and the distances l_j = |p_j - p̄|:
#
#     AP_p = |p̄ - p_c|,  AP_x = x̄ - x_c …,  AP_a = ā - a_c …
#     RP_l = l̄ + 3 S_l,  S_l^2 = sum (l_j - l̄)^2 / (n - 1),  RP_a = ± 3 S_a …
#     vAP_p = max |p̄_h - p̄_k|,  vAP_a = max |ā_h - ā_k| …   over approaches h, k
#     E = max |p̄_h - p̄_k|                                    over robots h, k


def accuracy(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the accuracy (AP) of every commanded pose."""
    places = []
    for pose in poses:
        if pose.deviation is None:
            return characteristic("AP", [], confidence, NO_COMMAND)
        n = pose.data.n
        covariance = np.cov(pose.deviation, ddof=1) / n if n > 1 else np.zeros((3, 3))
        length, angles = distance(pose.deviation.mean(axis=1), covariance, n - 1), pose.turn if pose.oriented else None
        places.append(pose.place(length, axes=_each(mean, pose.deviation), angles=_each(mean, angles)))
    return characteristic("AP", places, confidence, NO_COMMAND)


def repeatability(poses: Sequence[CommandedPose], confidence: float, seed: int) -> Characteristic:
    """Return the repeatability (RP) of every commanded pose with at least two visits."""
    places = []
    for pose in (pose for pose in poses if pose.data.n > 1):
        attained = pose.data.position
        lengths = np.sqrt(np.sum(np.square(attained - attained.mean(axis=1, keepdims=True)), axis=0))
        place = pose.place(position_repeatability(attained, pose.seed(seed)), angles=_each(threefold_std, pose.turn))
        mean_distance, sd_distance = float(np.mean(lengths)), float(np.std(lengths, ddof=1))
        places.append(place._replace(mean_distance=mean_distance, sd_distance=sd_distance))
    why = "every commanded pose was visited only once: RP needs several cycles"
    return characteristic("RP", places, confidence, why)


def multidirectional(poses: Sequence[CommandedPose], confidence: float) -> Characteristic:
    """Return the variation (vAP) of every commanded pose with several approaches (directions of the joints)."""
    why = (
        "approach directions are not known: give dir_q columns, or `ordered`"
        if all(pose.data.direction is None for pose in poses)
        else "every commanded pose was always approached from the same direction"
    )
    places = []
    for pose in poses:
        if (direction := pose.data.direction) is None:
            continue
        # Visits without a moving joint are left out.
        moving = np.flatnonzero(np.any(direction != 0, axis=0))
        approaches, index = np.unique(direction[:, moving], axis=1, return_inverse=True)
        names = ["".join("−0+"[int(np.sign(value)) + 1] for value in directions) for directions in approaches.T]
        # Largest number of approach directions at a pose; more are random moves.
        if len(names) > 8:
            why = "the moves to a pose differ from visit to visit: there are no approaches to compare"
        elif len(names) > 1:
            groups, turns = pose.parts([moving[index.ravel() == i] for i in range(len(names))])
            largest, between = _largest_separation(groups, names)
            angles = _largest_angles(turns, [*combinations(range(len(names)), 2)])
            places.append(pose.place(largest, moving.size, angles=angles, between=between))
    return characteristic("vAP", places, confidence, why)


def _largest_separation(groups: Sequence[Array], names: Sequence[str]) -> tuple[IntervalEstimate, str]:
    """Return the largest distance between barycentres of groups, and the names of the two."""
    pairs = list(combinations(range(len(groups)), 2))
    distances = separation(groups, pairs)
    first, second = pairs[max(range(len(pairs)), key=lambda i: distances[i].value)]
    return largest_magnitude(distances), f"{names[first]} and {names[second]}"


def exchangeability(poses_by_file: Sequence[Sequence[CommandedPose]], confidence: float) -> Characteristic:
    """Return E between robots, one per file, at the commanded poses that all files have, in a frame that they share."""
    by_label = [{pose.label: pose for pose in file} for file in poses_by_file]
    if len(by_label) < 2:
        return characteristic("E", [], confidence, "exchangeability compares several robots: give one file per robot")
    places = []
    for label in [label for label in by_label[0] if all(label in labels for labels in by_label)]:
        shared = [labels[label] for labels in by_label]
        first = shared[0]
        for pose in shared:
            both = [each.commanded for each in (first, pose) if each.commanded is not None]
            offset = float(np.linalg.norm(both[-1] - both[0])) if both else 0.0
            if offset > STILL:
                why = (
                    f"{pose.label} of {pose.source} is commanded {offset * 1e3:.3g} mm from that of {first.source}: "
                    "exchangeability needs the same commanded poses"
                )
                return characteristic("E", [], confidence, why)
        groups, names = [pose.data.position for pose in shared], [pose.source for pose in shared]
        largest, between = _largest_separation(groups, names)
        n_visits = sum(pose.data.n for pose in shared)
        places.append(IsoCriterion((label,), None, n_visits, largest, between=between))
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
    by_file = [[pose for pose in poses if pose.number == number] for number in sorted({pose.number for pose in poses})]
    pairs = [
        pair
        for file in by_file
        for pair in (pairwise(file) if len(file) > MAX_POSES_ALL_PAIRS else combinations(file, 2))
    ]
    note = f"with more than {MAX_POSES_ALL_PAIRS} commanded poses only neighbours in order of visit are paired"
    notes = [note] * any(len(file) > MAX_POSES_ALL_PAIRS for file in by_file)
    why = why_accuracy = "no cycle visits two commanded poses" if pairs else "one commanded pose has no distances"
    accurate, repeatable = [], []
    is_commanded = all(pose.commanded is not None for pose in poses)
    for a, b in pairs:
        # Visits of the same cycle match, else the j-th of one with the j-th of the other.
        rows = [np.arange(min(a.data.n, b.data.n))] * 2
        cycles = [cycle for cycle in (a.data.cycle, b.data.cycle) if cycle is not None]
        if len(cycles) == 2 and all(np.unique(cycle).size == cycle.size for cycle in cycles):
            rows = list(np.intersect1d(cycles[0], cycles[1], return_indices=True)[1:])
        if rows[0].size == 0:
            continue
        why, why_accuracy = "every pair of commanded poses was visited once: RD needs cycles", NO_COMMAND
        place = IsoCriterion((a.label, b.label), a.source, int(rows[0].size), None)
        axes = np.abs(a.data.position[:, rows[0]] - b.data.position[:, rows[1]])
        length, angles, turned = np.linalg.norm(axes, axis=0), None, None
        if a.turn is not None and b.turn is not None and not (a.at_pole or b.at_pole):
            turned = wrapped(np.asarray(a.reference) - np.asarray(b.reference))
            # Relative to the references' difference, so that poses half a turn apart do not flip sign.
            angles = np.abs(turned[:, None] + a.turn[:, rows[0]] - b.turn[:, rows[1]])
        if a.commanded is not None and b.commanded is not None and is_commanded:
            offset = np.abs(a.commanded - b.commanded)
            of_angles = None if turned is None else _each(mean, angles, np.abs(turned))
            of_angles = of_angles if a.oriented and b.oriented else None
            own = mean(length, float(np.linalg.norm(offset)))
            accurate.append(place._replace(position=own, axes=_each(mean, axes, offset), angles=of_angles))
        if length.size > 1:
            own, along, of_angles = threefold_std(length), _each(threefold_std, axes), _each(threefold_std, angles)
            repeatable.append(place._replace(position=own, axes=along, angles=of_angles))
    return (
        characteristic("AD", accurate, confidence, why_accuracy, notes),
        characteristic("RD", repeatable, confidence, why, notes),
    )


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
        (pose, np.array_split(np.arange(pose.data.n), count))
        for pose in poses
        for count in [windows or min(max(pose.data.n // 10, 2), 10)]
        if pose.data.n >= MIN_WINDOW_VISITS * count
    ]
    why = (
        f"drift needs {MIN_WINDOW_VISITS * (windows or 2)} visits of a commanded pose, {MIN_WINDOW_VISITS} in each of "
        f"{windows or 2} windows"
    )
    is_commanded = all(pose.deviation is not None for pose, _ in divided)
    accurate, repeated, shifted = [], [], []

    def place(changes: Sequence[IntervalEstimate], angles: tuple[IntervalEstimate, ...] | None) -> IsoCriterion:
        """Return the largest absolute change of the windows after the first, and those of the angles."""
        largest = max(range(len(changes)), key=lambda window: abs(changes[window].value))
        return pose.place(largest_magnitude(changes), angles=angles, between=f"windows 1 and {largest + 2}")

    for pose, rows in divided:
        attained, turns = pose.parts(rows)
        pairs = [(i, 0) for i in range(1, len(rows))]
        if is_commanded and pose.deviation is not None:
            means, covariance, shares, dof = _pooled([pose.deviation[:, part] for part in rows])
            lengths = np.linalg.norm(means, axis=0)
            # AP changes as the mean does along its own direction (delta method).
            directions = np.divide(means, lengths, out=np.zeros_like(means), where=lengths > 0.0)
            variances = np.einsum("iw,ij,jw->w", directions, covariance, directions) * shares
            sizes = zip(
                (lengths[1:] - lengths[0]).tolist(), np.sqrt(variances[1:] + variances[0]).tolist(), strict=True
            )
            # AP_a = ā - a_c changes as ā does.
            angles = _largest_angles(turns if pose.oriented else None, pairs)
            accurate.append(place([student(*size, dof) for size in sizes], angles))
        spreads = [position_repeatability(part, pose.seed(seed, i)) for i, part in enumerate(attained)]
        by_axis = [[threefold_std(turn[axis]) for turn in turns] for axis in range(3)] if turns else []
        changes = [[change(later, first) for later in rest] for first, *rest in (spreads, *by_axis)]
        repeated.append(place(changes[0], tuple(map(largest_magnitude, changes[1:])) or None))
        moves = [separation([attained[0], later], [(0, 1)])[0] for later in attained[1:]]
        shifted.append(place(moves, None))
    notes = [_window_note(*entry) for entry in divided[:1]]
    return (
        characteristic("dAP", accurate, confidence, NO_COMMAND if divided else why, notes),
        characteristic("dRP", repeated, confidence, why, notes),
        characteristic("shift", shifted, confidence, why, notes),
    )


def _window_note(pose: CommandedPose, rows: Sequence[NDArray[np.int64]]) -> str:
    order = "in the order of the file's rows"
    if (time := pose.data.time) is not None:
        minutes = float(np.mean(time[rows[-1]]) - np.mean(time[rows[0]])) / 60.0
        order = f"by time_s, the first and the last {minutes:.3g} min apart"
    count = " or ".join(map(str, sorted({rows[0].size, rows[-1].size})))
    return f"{len(rows)} windows of {count} visits, {order}; each against the first"
