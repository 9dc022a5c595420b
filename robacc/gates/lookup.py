"""Values of a result by their short key: the value, its unit, and the bounds that the result or its poses give."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import length_intervals
from robacc.gates.bound_curve import LEVELS, BoundCurve
from robacc.geometry import Array
from robacc.statistics.intervals import Interval
from robacc.statistics.records import Statistic

MOST_POSES = 20_000
"""With more poses, the stored interval is as good as a recomputed one and costs nothing."""
_UNITS = ("m", "rad")
_DIMENSIONS = {"m": "length", "rad": "angle"}


@dataclass(frozen=True, slots=True)
class GateSample:
    """Errors of every pose behind a figure."""

    errors: Array
    """``(3, N)`` m or rad"""
    groups: NDArray[np.int64]
    """``(N,)`` number of each row's commanded pose."""
    rows: NDArray[np.int64]
    """``(N,)`` index of each row in the file, from 0."""
    commanded: Array | None
    """``(3, N)`` commanded position of the target, m."""
    file: str | None
    """SHA-256 of the file of poses."""


@dataclass(frozen=True, slots=True)
class GateFigure:
    """One number of a result."""

    value: float
    dimension: str
    """length (m), angle (rad) or number."""
    curve: BoundCurve | None
    """None if the result has no interval for the figure."""
    n: int | None
    """Number of commanded poses."""
    statistic: str
    """Last part of the key."""


@dataclass(frozen=True, slots=True)
class Missing:
    """Reason why a result has no value for a key."""

    why: str


def value_at(document: Mapping[str, Any], key: str) -> tuple[Any, Mapping[str, Any], str] | Missing:
    """Return the value of a short key, the object that holds it, and its full name in that object."""
    node: Any = document
    path: list[str] = []
    holder, name = document, ""
    for part in key.split("."):
        if not isinstance(node, Mapping):
            return Missing(f"the result has no keys within {'.'.join(path)}")
        names = (part, *(f"{part}_{unit}" for unit in _UNITS))
        full_name = next((candidate for candidate in names if candidate in node), None)
        path.append(part)
        if full_name is None:
            return Missing(f"a result of robacc {document.get('command', '?')} has no {'.'.join(path)}")
        holder, name, node = node, full_name, node[full_name]
        if node is None:
            why = holder.get("why")
            return Missing(f"the result has no {'.'.join(path)}" + (f": {why}" if isinstance(why, str) else ""))
    return node, holder, name


def word_at(document: Mapping[str, Any], key: str) -> str | Missing:
    """Return the word of a key; a boolean gives ``true`` or ``false``."""
    match = value_at(document, key)
    if isinstance(match, Missing):
        return match
    value = match[0]
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    return value if isinstance(value, str) else Missing(f"the result's {key} is not a word")


def figure_at(document: Mapping[str, Any], key: str, confidence: float) -> GateFigure | Missing:
    """Return the number of a key, with its curve; ``confidence`` is the level that a recomputed curve includes."""
    match = value_at(document, key)
    if isinstance(match, Missing):
        return match
    value, holder, name = match
    stored: Any = _stored_interval(holder, name)
    if isinstance(value, Mapping):
        if "value" not in value:
            return Missing(f"the result's {key} is not a number")
        stored, value = value, value["value"]
    number = _number(value)
    if number is None:
        return Missing(f"the result's {key} is not a number")
    dimension = _DIMENSIONS.get(name.rpartition("_")[2], "number")
    statistic = key.rpartition(".")[2]
    n = _n_poses(document, holder)
    curve = None if stored is None else _stored_curve(_interval(stored), number, statistic)
    sample = sample_at(document, key)
    if sample is not None and statistic in ("rms", "mean_error", "p95") and sample.rows.size <= MOST_POSES:
        levels = sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})
        n = int(np.unique(sample.groups).size)
        share = (_number(holder.get("independent_poses")) or n) / n
        seed = document.get("seed") or 0
        statistics = length_intervals(sample.errors, levels, groups=sample.groups, share=share, seed=seed)
        intervals = [by_name[cast("Statistic", statistic)] for by_name in statistics]
        curve = BoundCurve.through(intervals)
    return GateFigure(number, dimension, curve, n, statistic)


def sample_at(document: Mapping[str, Any], key: str) -> GateSample | None:
    """Return the errors of the poses behind the statistic of a key; None if the result does not list them."""
    parts = key.split(".")
    unit = {"position": "m", "orientation": "rad"}.get(parts[-2] if len(parts) > 1 else "")
    if unit is None:
        return None
    if len(parts) == 2:
        quantity = document.get(parts[0])
        errors = quantity.get(f"errors_{unit}") if isinstance(quantity, Mapping) else None
        return _sample(errors, document.get("poses"), document)
    kind = parts[1].removesuffix("_inliers")
    if len(parts) != 4 or kind not in ("fitted", "held_out"):
        return None
    holdout = document.get("poses_apart") if kind == "held_out" else None
    poses = document.get("poses") if holdout is None else holdout
    cross_validated = kind == "held_out" and holdout is None and parts[0] != "nominal_unregistered"
    stages = poses.get(f"errors_{unit}") if isinstance(poses, Mapping) else None
    errors = (
        stages.get(f"held_out_{parts[0]}" if cross_validated else parts[0]) if isinstance(stages, Mapping) else None
    )
    source = "poses" if holdout is None else "holdout"
    return _sample(errors, poses, document, source, inliers=parts[1].endswith("_inliers"))


def _sample(
    errors: Any, poses: Any, document: Mapping[str, Any], kind: str = "poses", *, inliers: bool = False
) -> GateSample | None:
    """Return all rows of ``errors``, or those of inliers; None if the document does not say to which poses they belong.

    The metrics of a stage count outliers; those without outliers have keys of their own.
    """
    if errors is None or not isinstance(poses, Mapping) or poses.get("group") is None:
        return None
    rows = np.asarray(errors, dtype=float)
    flags = poses.get("used") if inliers else None
    used = np.ones(len(rows), dtype=bool) if flags is None else np.asarray(flags, dtype=bool)
    groups = np.asarray(poses["group"], dtype=np.int64)
    if rows.ndim != 2 or rows.shape[1] != 3 or used.shape != groups.shape or len(rows) != len(groups) or not used.any():
        return None
    commanded = poses.get("commanded_m")
    digests = [entry["sha256"] for entry in document.get("inputs", ()) if entry.get("kind") == kind]
    return GateSample(
        rows[used].T,
        groups[used],
        np.flatnonzero(used),
        None if commanded is None else np.asarray(commanded, dtype=float)[used].T,
        digests[0] if digests and digests[0] else None,
    )


def _stored_interval(holder: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    """Return the interval stored beside a value."""
    intervals = holder.get("intervals")
    for interval in (intervals.get(name) if isinstance(intervals, Mapping) else None, holder.get("interval")):
        if isinstance(interval, Mapping):
            return interval
    return None


def _stored_curve(interval: Interval, value: float, statistic: str) -> BoundCurve:
    """Return the curve through a stored interval, and through the value at level 1/2 if the interval is about it.

    The 95th percentile of a small sample is biased low, so two bounds locate the median better than the value does.
    """
    two_sided = interval.lower is not None and (interval.upper_bound is not None or interval.upper is not None)
    centre = None if two_sided and statistic == "p95" else value
    return BoundCurve.through([interval], centre)


def _interval(stored: Mapping[str, Any]) -> Interval:
    def number(*names: str) -> float | None:
        return next((value for name in names if (value := _number(stored.get(name))) is not None), None)

    why = stored.get("why")
    method = stored.get("method")
    return Interval(
        number("lower", "low"),
        number("upper", "high"),
        number("upper_bound"),
        number("confidence") or 0.95,
        method if isinstance(method, str) else "interval stored in the result",
        why if isinstance(why, str) else None,
    )


def _n_poses(document: Mapping[str, Any], holder: Mapping[str, Any]) -> int | None:
    for node, name in ((holder, "n_commanded_poses"), (holder, "n_poses"), (document, "n_poses")):
        value = _number(node.get(name))
        if value is not None:
            return int(value)
    return None


def _number(value: Any) -> float | None:
    """Return a finite number; None for anything else, booleans included."""
    if isinstance(value, bool | np.bool_ | str | Sequence | Mapping) or value is None or np.ndim(value):
        return None
    return float(value) if math.isfinite(value) else None
