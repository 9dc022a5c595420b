"""Stored results: figures and errors by key, pairing by commanded pose, and differences of two results.

One key stands for one kind of figure: the figures of a fit on held-out poses have the keys of an estimate, because both
come from poses that the model was not fitted to.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args

import numpy as np

from robacc.accuracy.error_statistics import Statistic, Unit
from robacc.accuracy.grade import GradeStep, Quantity, Scale
from robacc.errors import applying, given, refuse
from robacc.geometry import Array, NDArray, vector_lengths
from robacc.statistics.intervals import (
    FEWEST,
    MOST_FOR_BOOTSTRAP,
    EstimatedValue,
    Interval,
    difference_limits,
    f_sf,
    normal_cdf,
    normal_quantile,
    quantiles,
    resampled_counts,
    student_quantile,
)

Document = Mapping[str, Any]

# Figures of a result by their short key.

_LARGEST = 1e9
"""m or rad: every joint, position and error is smaller; the square of a much larger number overflows."""
QUANTITIES: dict[Quantity, Unit] = {"position": "m", "orientation": "rad"}
"""Unit of each quantity."""
_APART = "the result's lists do not belong together"


class NoValueError(ValueError):
    """Reason why a result has no value for a key."""


def value_at(document: Document, key: str) -> tuple[Any, Document, str]:
    """Return the value of a short key, the object that holds it, and its full name in that object.

    A part of the key is a name with or without its unit, or an index of a list.

    Raises:
        NoValueError: The result has no such key, or null there.
    """
    node: Any = document
    holder, name, parts = document, "", key.split(".")
    for i, part in enumerate(parts):
        path = ".".join(parts[: i + 1])
        if isinstance(node, list) and part.isdecimal():
            node = node[int(part)] if int(part) < len(node) else None
        else:
            outside = f"the result has no keys within {path.rpartition('.')[0]}"
            refuse((not isinstance(node, Mapping), outside), error=NoValueError)
            names = (part, *(f"{part}_{unit}" for unit in QUANTITIES.values()))
            holder, name = node, next((full for full in names if full in node), "")
            refuse((not name, f"a result of robacc {document.get('command', '?')} has no {path}"), error=NoValueError)
            node = node[name]
        reason = f": {why}" if isinstance(why := holder.get("why"), str) else ""
        refuse((node is None, f"the result has no {path}{reason}"), error=NoValueError)
    return node, holder, name


def number_at(document: Document, key: str) -> tuple[EstimatedValue, Document, str]:
    """Return the number of a short key with its stored interval, the object that holds it, and its full name there.

    Raises:
        NoValueError: The result has no number there.
    """
    value, holder, name = value_at(document, key)
    stored = [(holder.get("intervals") or {}).get(name), holder.get("interval")]
    if isinstance(stored[0], list) and (index := key.rpartition(".")[2]).isdecimal():
        stored[0] = stored[0][int(index)]
    if isinstance(value, Mapping):
        stored, value = [value], value.get("value")
    number = given(finite_number(value), f"the result's {key} is not a number", NoValueError)
    entry = next((each for each in stored if isinstance(each, Mapping)), None)
    if entry is None:
        return EstimatedValue(number, None), holder, name
    # Under the names of an interval or of a gain.
    ends = entry.get("lower", entry.get("low")), entry.get("upper", entry.get("high")), entry.get("upper_bound")
    method = entry.get("method") or "interval stored in the result"
    interval = Interval(*ends, entry.get("confidence") or 0.95, method, entry.get("why"))
    return EstimatedValue(number, interval), holder, name


def finite_number(value: Any) -> float | None:
    """Return a finite number; None for anything else, booleans included."""
    is_other = isinstance(value, bool | np.bool_ | str | Sequence | Mapping) or value is None or np.ndim(value)
    return None if is_other or not math.isfinite(value) else float(value)


def _at(document: Document, path: str, reader: Callable[[Document, str], tuple[Any, ...]] = value_at) -> Any:
    """Return the value of a short key; None if there is none."""
    try:
        return reader(document, path)[0]
    except NoValueError:
        return None


def unit_of(key: str) -> str:
    """Return the unit of a key's value: ``m`` or ``rad``."""
    return "rad" if "orientation" in key.split(".") else "m"


# Errors of every pose behind the figures of a result.


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSet:
    """Errors of one result, grouped by commanded pose, with the commanded pose of every row."""

    vectors: Array
    """``(3, n)`` m or rad"""
    groups: NDArray[np.int64]
    """``(n,)`` commanded pose of each row, 0 to G - 1; paired sets share the numbering."""
    q: Array | None = None
    """``(J, n)`` commanded joints, rad or m."""
    commanded: Array | None = None
    """``(3, n)`` commanded position, m."""
    pose: NDArray[Any] | None = None
    """``(n,)`` id, text."""
    target: NDArray[Any] | None = None
    files: tuple[str, ...] = ()
    """SHA-256 of each file of poses."""
    independent_poses: float | None = None
    """Number of poses that intervals count; None for all commanded poses."""

    @property
    def n_groups(self) -> int:
        """Return the number of commanded poses."""
        return int(self.groups.max()) + 1

    @property
    def share(self) -> float:
        """Return the share of the commanded poses that intervals count."""
        return (self.independent_poses or self.n_groups) / self.n_groups

    def sums(self) -> Array:
        """Return sums over each pose's rows ``(9, G)``: count, length, its square, components and their squares."""
        lengths = vector_lengths(self.vectors)
        features = (np.ones(lengths.size), lengths, lengths**2, *self.vectors, *np.square(self.vectors))
        return np.stack([np.bincount(self.groups, weights=feature, minlength=self.n_groups) for feature in features])


def errors_behind(document: Document, place: str) -> ErrorSet | None:
    """Return the errors behind the figures of a place; None if the result does not list them.

    Args:
        document: The JSON document of a result.
        place: ``position`` of an estimate, ``after.held_out.position`` of a fit …; its metrics count outliers.

    Raises:
        NoValueError: The lists of the document do not belong together.
    """
    *stage, quantity = place.split(".")
    if quantity not in QUANTITIES or stage[1:] not in ([], ["fitted"], ["held_out"]):
        return None
    unit, rows, kind, is_held_out = unit_of(quantity), "poses", "poses", stage[1:] == ["held_out"]
    if is_held_out and document.get("poses_apart") is not None:
        rows, kind, is_held_out = "poses_apart", "holdout", False
    of_stage = f"{rows}.errors_{unit}.{'held_out_' * is_held_out}{''.join(stage[:1])}"
    path = of_stage if stage else f"{quantity}.errors_{unit}"
    # Of a large file some rows are listed.
    lines = _at(document, f"{rows}.line")
    n = document.get("n_poses", 0) if lines is None else len(lines)
    vectors, groups = _column(document, path, n, 3), _column(document, f"{rows}.group", n)
    if vectors is None or n == 0:
        return None
    return ErrorSet(
        vectors,
        np.arange(n) if groups is None else np.unique(groups, return_inverse=True)[1].astype(np.int64),
        _column(document, f"{rows}.q", n, 0),
        _column(document, f"{rows}.commanded_m", n, 3),
        _column(document, f"{rows}.pose", n),
        _column(document, f"{rows}.target", n),
        tuple(entry["sha256"] for entry in document.get("inputs", ()) if entry["kind"] == kind),
        None if stage or n != document.get("n_poses") else _at(document, f"{quantity}.independent_poses"),
    )


def _column(document: Document, path: str, n: int, width: int | None = None) -> NDArray[Any] | None:
    """Return ``(n,)`` values, or ``(width, n)`` numbers from a list of rows; None if there are none.

    Raises:
        NoValueError: The number of rows differs from ``n``, the rows differ in length, or a number is too large.
    """
    rows = _at(document, path)
    if rows is None:
        return None
    array = np.array(rows, dtype=None if width is None else float)
    shape = (n,) + (() if width is None else (width or array.shape[-1],))
    is_too_large = width is not None and not np.all(np.abs(array) < _LARGEST)
    refuse(
        (array.shape != shape, f"{_APART}: {path}: expected {n} rows"),
        (is_too_large, f"{_APART}: {path}: expected numbers below {_LARGEST:g}"),
        error=NoValueError,
    )
    return array.T


# A result to compare: its figures, the errors of every pose behind them, and how it was made.


class ComparedResult(NamedTuple):
    """One result to compare."""

    name: str
    """Unique name in the comparison."""
    command: str
    version: str
    """Version of robacc that made the result."""
    n_poses: int
    robot: str | None
    figures: Mapping[str, EstimatedValue]
    """Figures by key: ``position.rms``, ``nominal.held_out.position.p95`` …"""
    errors: Mapping[str, ErrorSet]
    """Errors by group, the start of a key: ``position``, ``orientation``, ``nominal.held_out.position`` …"""
    provenance: Mapping[str, str]
    """How the result was made, as text by aspect."""
    grade: str | None
    """The result's own grade, with ``confirmed``, ``not confirmed`` or ``predicted``."""
    scale: Scale | None
    """Grade scale of the result, if the result stores the complete scale."""
    scale_name: str | None
    frame: str | None
    """Axes of vectors: ``tool`` or ``base``."""
    digest: str
    """SHA-256 of the file; equal files are the same result."""

    @property
    def measured(self) -> bool:
        """Return whether the figures come from measured poses, as all but those of a prediction do."""
        return self.command != "predict"


FITS = ("calibrate", "trace")
COMPARED = ("estimate", *FITS, "predict", "iso9283")
LENGTHS = get_args(Statistic)
_STATISTICS = {
    **{name: name for name in (*LENGTHS, "max_radius95")},
    **{"radius95": "radius95.fitted_mean.radius", "longest_sd": "ellipsoid.0.sd"},
    **{f"mean_{axis}": f"mean.{i}" for i, axis in enumerate("xyz")},
}
"""Statistics with their short keys in a quantity."""
_ISO9283 = ("AP", "RP", "vAP", "AD", "RD", "drift.AP", "drift.RP", "drift.barycentre", "exchangeability")
_STAGES = (
    ("", "after.held_out"),
    ("before.held_out.", "before.held_out"),
    ("nominal.held_out.", "nominal.held_out"),
    ("after.fitted.", "after.fitted"),
)
"""Stages of a fit: the start of their keys, and their place in the document."""


def read_compared_result(document: Document, name: str, file: str, digest: str) -> ComparedResult:
    """Return the figures, errors and provenance of a result.

    Args:
        document: The JSON document, from :func:`robacc.documents.envelope.read_result`.
        name: Unique name of the result in the comparison.
        file: The result's file, for messages.
        digest: SHA-256 of the file.

    Raises:
        UsageError: The command's results cannot be compared.
        KeyError, ValueError: The document lacks what the command writes, or its lists do not belong together.
    """
    command = document["command"]
    only = f"{file} is a result of {command}; only results of {', '.join(COMPARED)} can be compared"
    refuse((command not in COMPARED, only))
    grade = document.get("grade") or {}
    places = _places(document, command)
    figures = dict(_figures(document, command, places))
    refuse((not figures, "no figures to compare"), error=ValueError)
    scale = None
    if all(grade.get(key) is not None for key in ("scale", "statistic", "confidence", "steps", "otherwise")):
        steps = tuple(
            GradeStep(step["grade"], step["position_m"], step.get("orientation_rad")) for step in grade["steps"]
        )
        scale = Scale(grade["scale"], grade["statistic"], grade["confidence"], steps, grade["otherwise"])
    status = "predicted" if command == "predict" else f"{'' if grade.get('demonstrated') else 'not '}confirmed"
    own = f"{grade['grade']}, {status}" if grade.get("grade") is not None else None
    confidences = sorted({figure.interval.confidence for figure in figures.values() if figure.interval is not None})
    effects = _at(document, "alignment.0.what" if command == "iso9283" else "alignment.what")
    alignment = f"{' and '.join(effects)} registered" if effects else "none"
    held_out, *_ = applying(
        (_at(document, "after.held_out") is None, "nothing (errors of calibration poses)"),
        (document.get("poses_apart") is not None, "separate poses"),
        (True, f"{document.get('n_folds')} groups of poses, each in turn"),
    )
    fitted_to, targets = _at(document, "robot.fitted_to"), _at(document, "poses.target")
    same_poses = any(e["sha256"] in (fitted_to or ()) for e in document["inputs"] if e["kind"] == "poses")
    fitted = "fitted to the same poses" if same_poses else "not fitted to these poses"
    aspects = {
        "command": command,
        "robacc version": document["robacc"],
        "frame": document.get("frame"),
        "alignment": "fitted with the model" if command in FITS else alignment,
        "grade scale": _at(document, "grade.scale"),
        "confidence": ", ".join(f"{confidence:g}" for confidence in confidences) or None,
        "held out": held_out if command in FITS else None,
        "robot file": None if fitted_to is None else fitted,
        "targets": None if targets is None else ", ".join(sorted(set(targets))),
    }
    return ComparedResult(
        name=name,
        command=command,
        version=document["robacc"],
        n_poses=document["n_poses"],
        robot=_at(document, "robot.name"),
        figures=figures,
        errors={start: errors for start, place in places.items() if (errors := errors_behind(document, place))},
        provenance={aspect: text for aspect, text in aspects.items() if text is not None},
        grade=own,
        scale=scale,
        scale_name=grade.get("scale"),
        frame=document.get("frame"),
        digest=digest,
    )


def _places(document: Document, command: str) -> dict[str, str]:
    """Return the places in the document of the groups of figures, by the starts of their keys.

    Without held-out poses, the stages of a fit on calibration poses take their place.
    """
    if command == "iso9283":
        groups = [f"iso9283.{symbol}{part}" for symbol in _ISO9283 for part in ("", ".orientation")]
        return dict(zip(groups, groups, strict=True))
    if command not in FITS:
        return {quantity: quantity for quantity in QUANTITIES}
    poses = "fitted" if _at(document, "after.held_out") is None else "held_out"
    return {
        f"{start}{quantity}".replace("held_out", poses): f"{stage}.{quantity}".replace("held_out", poses)
        for quantity in QUANTITIES
        for start, stage in _STAGES
        if poses == "held_out" or "held_out" in stage
    }


def _figures(document: Document, command: str, places: Mapping[str, str]) -> Iterator[tuple[str, EstimatedValue]]:
    names = ("max",) if command == "iso9283" else LENGTHS if command in FITS else tuple(_STATISTICS)
    for start, place in places.items():
        figures = {name: _at(document, f"{place}.{_STATISTICS[name]}", number_at) for name in names}
        yield from ((f"{start}.{name}", figure) for name, figure in figures.items() if figure is not None)
        for i, axis in enumerate("xyz" if len(names) == len(_STATISTICS) else ""):
            variance = _at(document, f"{place}.centred_covariance_{unit_of(start)}2.{i}.{i}")
            if variance is not None:
                yield f"{start}.sd_{axis}", EstimatedValue(max(variance, 0.0) ** 0.5, None)


# Pairing of two results by commanded pose.

_SAME_JOINT = 1e-6
"""Largest difference of equal joint commands, rad or m: below any encoder's step, above the rounding of a file."""
_SAME_POSITION = 1e-4
"""Largest distance of equal commanded positions, m, for arms or alignments that differ."""


def pair_poses(first: ErrorSet, second: ErrorSet) -> tuple[ErrorSet, ErrorSet] | None:
    """Return the errors of common commanded poses with the same numbers; None with too few common poses."""
    keys = _common_keys(first, second)
    common = np.zeros(0) if keys is None else np.intersect1d(*keys)
    # Smallest share of common poses, of either result's poses, for a paired comparison.
    if keys is None or common.size < max(2, 0.5 * max(np.unique(numbers).size for numbers in keys)):
        return None
    rows = [np.isin(numbers, common) for numbers in keys]
    numbers = [np.searchsorted(common, key[mask]) for key, mask in zip(keys, rows, strict=True)]
    return ErrorSet(first.vectors[:, rows[0]], numbers[0]), ErrorSet(second.vectors[:, rows[1]], numbers[1])


def _common_keys(first: ErrorSet, second: ErrorSet) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return numbers of commanded poses with the same meaning in both results; None if nothing relates the poses.

    Rows are matched in order if both results have the same rows; otherwise by the joints, or by ids that name the
    same positions.
    """
    joints = (
        (first.q, second.q)
        if first.q is not None and second.q is not None and first.q.shape[0] == second.q.shape[0]
        else None
    )
    # No targets are an array without axes.
    if first.groups.size == second.groups.size and np.array_equal(np.array(first.target), np.array(second.target)):
        same_files = bool(first.files) and first.files == second.files
        close = joints is not None and _close(*joints, _SAME_JOINT)
        if same_files or close or _close(first.commanded, second.commanded, _SAME_POSITION):
            # A pose repeated in one result is one pose in both.
            return first.groups, first.groups
    if joints is not None:
        return _numbers_of(*(np.round(q / _SAME_JOINT).T for q in joints))
    if first.pose is None or second.pose is None:
        return None
    if first.commanded is not None and second.commanded is not None:
        # Equal ids have equal commanded positions, as far as both results list positions.
        positions = dict(zip(first.pose.tolist(), first.commanded.T, strict=True))
        same = zip(second.pose.tolist(), second.commanded.T, strict=True)
        if not all(_close(positions.get(name, position), position, _SAME_POSITION) for name, position in same):
            return None
    return _numbers_of(first.pose, second.pose)


def _close(first: Array | None, second: Array | None, tolerance: float) -> bool:
    return (
        first is not None
        and second is not None
        and first.shape == second.shape
        and bool(np.all(np.abs(first - second) <= tolerance))
    )


def _numbers_of(first: NDArray[Any], second: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return a number for each row of two arrays, the same for equal rows."""
    numbers = np.unique(np.concatenate((first, second)), axis=0, return_inverse=True)[1].ravel().astype(np.int64)
    return numbers[: len(first)], numbers[len(first) :]


# Difference of one statistic between two results, paired by commanded pose, with interval and p-value.
#
# A smooth statistic is a function of sums over commanded poses, so each pose has an influence on its value (F. R.
# Hampel, "The influence curve and its role in robust estimation", JASA 69, 1974). If both sets have the same poses, the
# two influences of a pose are subtracted before they are squared, and their common part cancels; otherwise the squares
# of the two standard errors add up, with Welch and Satterthwaite's degrees of freedom. Student's t is widened on either
# side to the studentised bootstrap over poses if the bootstrap is wider (P. Hall, The Bootstrap and Edgeworth
# Expansion, 1992). The standard error of a percentile comes from the bootstrap.
#
# The p-value agrees with the interval: it is below 1 - confidence exactly if the interval excludes zero.

DRAWS = 2000


class Difference(NamedTuple):
    """Statistic of the second set minus statistic of the first."""

    value: float
    interval: Interval
    """It gives the reason for a missing interval or p-value."""
    p_value: float | None = None
    """Two-sided p-value of no difference."""
    paired: bool = False
    n_poses: int | None = None
    """Commanded poses of a paired difference."""

    def document(self) -> dict[str, Any]:
        """Return the keys of the document."""
        return {
            "value": self.value,
            **{name: getattr(self.interval, name) for name in ("lower", "upper", "confidence")},
            **{name: getattr(self, name) for name in ("p_value", "paired", "n_poses")},
            **{name: getattr(self.interval, name) for name in ("method", "why")},
        }


_MOMENTS: dict[str, tuple[int, int]] = {
    "rms": (0, 2),
    "mean_error": (1, 0),
    **{f"mean_{axis}": (3 + i, 0) for i, axis in enumerate("xyz")},
    **{f"sd_{axis}": (3 + i, 6 + i) for i, axis in enumerate("xyz")},
}
"""Rows of :meth:`ErrorSet.sums` with the means m and s of a statistic, 0 for none: m, or the root of s - m^2."""
VECTORIAL = frozenset(_MOMENTS) - {"rms", "mean_error"}
"""Statistics of components, which depend on the frame."""
RESAMPLED = frozenset({*_MOMENTS, "p95"})
"""Statistics whose difference is computed from errors."""
NO_TEST_OF_MAXIMUM = "no test exists for the largest of all errors"


def difference(
    statistic: str, first: ErrorSet, second: ErrorSet, *, paired: bool, confidence: float = 0.95, seed: int = 0
) -> Difference:
    """Return the ``statistic`` of ``second`` minus that of ``first``.

    Args:
        statistic: A member of :data:`RESAMPLED`, or ``max``, which has no interval.
        first: Errors to compare with.
        second: Errors to compare; if ``paired``, of the same commanded poses with the same numbers.
        paired: Both sets have the same commanded poses.
        confidence: Confidence of the interval.
        seed: Seed of the resampling.
    """
    sets, sizes = (first, second), [first.n_groups, second.n_groups]
    n, is_smooth, sums = first.n_groups if paired else None, statistic in _MOMENTS, [part.sums() for part in sets]
    if is_smooth:
        values, variances = _moments(statistic, sums, [np.ones((1, size)) for size in sizes], paired)
    else:
        values = [
            np.array(quantiles(vector_lengths(part.vectors), [0.95 if statistic == "p95" else 1.0])) for part in sets
        ]
    value = float(values[1][0] - values[0][0])
    # With fewer poses, a single pose sets the 95th percentile, and bootstrap intervals cover less than they claim.
    fewest = 30 if statistic == "p95" else FEWEST
    obstacles = applying(
        (statistic == "max", NO_TEST_OF_MAXIMUM),
        (min(sizes) < 2, "one commanded pose shows no scatter between poses"),
        (
            statistic == "p95" and min(sizes) < fewest,
            f"{min(sizes)} poses: too few to compare 95th percentiles; at least {fewest} are needed",
        ),
        (
            statistic.startswith("sd_") and min(sizes) < fewest,
            f"fewer than {fewest} poses: too few to compare standard deviations",
        ),
    )
    if obstacles:
        n = n if statistic == "p95" and min(sizes) > 1 else None
        return Difference(value, Interval.missing(confidence, obstacles[0]), None, paired, n)
    if is_smooth:
        error, method = math.sqrt(float(np.sum(variances))), "Student's t"
    else:
        percentiles = [_resampled_percentile(part, seed, 0 if paired else i) for i, part in enumerate(sets)]
        variances = [
            np.asarray(np.var(spread)) for spread in ([percentiles[1] - percentiles[0]] if paired else percentiles)
        ]
        error = float(np.std(percentiles[1] - percentiles[0]))
        method = f"Student's t with the bootstrap's standard error ({percentiles[0].size} draws)"
    # A standard error below this fraction of the statistic is rounding.
    if error <= 1e-13 * max(abs(float(part[0])) for part in values):
        exact = Interval.exact(value, confidence, "the same at every pose")
        return Difference(value, exact, float(value == 0.0), paired, n)
    terms = (float(np.sum(variance)) ** 2 / (size - 1.0) for variance, size in zip(variances, sizes, strict=False))
    dof = float(np.sum(variances)) ** 2 / sum(terms)
    below = above = t = student_quantile(0.5 + 0.5 * confidence, dof)
    if is_smooth and min(sizes) >= FEWEST and max(sizes) <= MOST_FOR_BOOTSTRAP:
        # (resampled difference - difference) / standard error of the resample.
        counts = [resampled_counts(size, DRAWS, (seed, 0 if paired else i)) for i, size in enumerate(sizes)]
        resamples, spreads = _moments(statistic, sums, counts, paired)
        errors = np.sqrt(sum(spreads, np.zeros(DRAWS)))
        usable = errors > 0.0
        studentised = (resamples[1] - resamples[0] - value)[usable] / errors[usable]
        low, high = quantiles(studentised, (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence))
        # The lower limit follows from the upper quantile of t, and the upper limit from the lower quantile.
        below, above = max(t, high), max(t, -low)
        method = f"Student's t, no narrower than the studentised bootstrap ({DRAWS} draws)"
    p_value = f_sf((value / error / ((below if value > 0.0 else above) / t)) ** 2, 1.0, dof)
    basis = f"over {n} poses, paired" if paired else "Welch's degrees of freedom"
    interval = Interval(value - below * error, value + above * error, None, confidence, f"{method}, {basis}")
    return Difference(value, interval, p_value, paired, n)


def _moments(
    statistic: str, sums: Sequence[Array], counts: Sequence[Array], paired: bool
) -> tuple[list[Array], list[Array]]:
    """Return the statistic of each set over resamples ``(B,)``, and the squared standard errors of the difference.

    These are a single term for paired sets, else a term for each set. ``counts`` ``(B, G)`` says how often each
    resample contains each pose.
    """
    first, second = _MOMENTS[statistic]
    values, influences = [], []
    for part, weight in zip(sums, counts, strict=True):
        used = part[[0, first, second]]
        rows, mean, square = (weight @ used.T).T
        mean, square = (mean / rows if first else np.zeros_like(rows)), square / rows
        value, by_mean, by_square = mean, np.ones_like(rows), np.zeros_like(rows)
        if second:
            value = np.sqrt(np.maximum(square - mean**2, 0.0))
            by_square = 0.5 / np.maximum(value, 1e-300)
            by_mean = -2.0 * mean * by_square
        values.append(value)
        influences.append((np.stack([-by_mean * mean - by_square * square, by_mean, by_square]) / rows).T @ used)
    terms = [influences[1] - influences[0]] if paired else influences
    pairs = [(term, weight, term.shape[-1]) for term, weight in zip(terms, counts, strict=False)]
    return values, [np.sum(w * np.square(term), axis=-1) * (size / (size - 1.0)) for term, w, size in pairs if size > 1]


def _resampled_percentile(errors: ErrorSet, seed: int, stream: int) -> Array:
    """Return the 95th percentiles of resamples of poses, ``(B,)``; repetitions of a pose stay together."""
    lengths, size = vector_lengths(errors.vectors), errors.n_groups
    order = np.argsort(lengths, kind="stable")
    lengths, groups, rng = lengths[order], errors.groups[order], np.random.default_rng([seed, stream])
    # With many poses the percentile is nearly Gaussian, and few draws suffice for its standard error.
    draws = DRAWS if size <= MOST_FOR_BOOTSTRAP else 200
    counts = (np.bincount(rng.integers(size, size=size), minlength=size)[groups] for _ in range(draws))
    samples = (np.repeat(lengths, count) for count in counts)
    return np.array([np.interp(0.95 * (own.size - 1), np.arange(own.size), own) for own in samples])


def from_intervals(first: EstimatedValue, second: EstimatedValue, confidence: float) -> Difference:
    """Return ``second`` minus ``first`` of two numbers that have only intervals.

    Independence is assumed, which is conservative for results on the same poses. ``confidence`` is recorded where there
    is no interval.
    """
    value = second.value - first.value
    ends = [
        (min(own.lower, figure.value), max(own.upper, figure.value), own.confidence)
        for figure in (first, second)
        if (own := figure.interval) is not None and own.lower is not None and own.upper is not None
    ]
    levels = [level for _, _, level in ends]
    if len({*levels}) != 1 or len(levels) < 2:
        why = f"the intervals of the results have different confidences, {' and '.join(f'{p:g}' for p in levels)}"
        why = why if len(levels) == 2 else "the results have no interval for this figure"
        return Difference(value, Interval.missing(confidence, why))
    low, high = difference_limits(second.value, ends[1][:2], first.value, ends[0][:2])
    # The p-value is as if the limit that faces zero were a Gaussian's.
    distance = value - low if value > 0.0 else high - value
    ratio = abs(value) / distance if distance else math.inf if value else 0.0
    p_value = 2.0 * normal_cdf(-normal_quantile(0.5 + 0.5 * levels[0]) * ratio)
    method = "from the intervals of the two results, assumed independent (Zou and Donner)"
    return Difference(value, Interval(low, high, None, levels[0], method), p_value)
