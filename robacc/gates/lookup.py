"""What a result says of a key: the value, its unit, and the bounds that it carries or its poses allow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.error_statistics import length_intervals
from robacc.gates.confidence import LEVELS, BoundCurve
from robacc.geometry import Array
from robacc.statistics.intervals import Interval
from robacc.statistics.records import Statistic

MOST_POSES = 20_000
"""With more poses their stored interval is as good as one computed again, and costs nothing."""
_UNITS = ("m", "rad")
_SUFFIX = {"m": "length", "rad": "angle"}


@dataclass(frozen=True, slots=True)
class GateSample:
    """The errors of every pose that a figure is of."""

    errors: Array
    """``(3, N)`` m or rad"""
    groups: NDArray[np.int64]
    """``(N,)`` number of each row's commanded pose."""
    rows: NDArray[np.int64]
    """``(N,)`` which rows of the file they are, counted from 0."""
    commanded: Array | None
    """``(3, N)`` where the target was to be, m."""
    file: str | None
    """SHA-256 of the file of poses."""


@dataclass(frozen=True, slots=True)
class GateFigure:
    """One number of a result."""

    value: float
    dimension: str
    """length (m), angle (rad) or number."""
    curve: BoundCurve | None
    """None where the result has no interval of such a figure."""
    n: int | None
    """Poses it is of, repetitions of one counted as one."""
    statistic: str
    """Last part of the key."""


@dataclass(frozen=True, slots=True)
class Missing:
    """What a result lacks to answer."""

    why: str


def found_at(document: Mapping[str, Any], key: str) -> tuple[Any, Mapping[str, Any], str] | Missing:
    """The value that a short key means, the object that holds it, and its full name there."""
    node: Any = document
    walked: list[str] = []
    holder, name = document, ""
    for part in key.split("."):
        if not isinstance(node, Mapping):
            return Missing(f"the result has nothing within {'.'.join(walked)}")
        full = next((other for other in (part, *(f"{part}_{unit}" for unit in _UNITS)) if other in node), None)
        walked.append(part)
        if full is None:
            schema = document.get("command", "?")
            return Missing(f"a result of robacc {schema} has no {'.'.join(walked)}")
        holder, name, node = node, full, node[full]
        if node is None:
            why = holder.get("why")
            return Missing(f"the result has no {'.'.join(walked)}" + (f": {why}" if isinstance(why, str) else ""))
    return node, holder, name


def word(document: Mapping[str, Any], key: str) -> str | Missing:
    """The word at a key; true and false are words too."""
    found = found_at(document, key)
    if isinstance(found, Missing):
        return found
    value = found[0]
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    return value if isinstance(value, str) else Missing(f"the result's {key} is no word")


def figure(document: Mapping[str, Any], key: str, confidence: float) -> GateFigure | Missing:
    """The number at a key, with its curve drawn through bounds at ``confidence`` where the poses allow it."""
    found = found_at(document, key)
    if isinstance(found, Missing):
        return found
    value, holder, name = found
    stored: Any = _stored(holder, name)
    if isinstance(value, Mapping):
        if "value" not in value:
            return Missing(f"the result's {key} is no number")
        stored, value = value, value["value"]
    number = _number(value)
    if number is None:
        return Missing(f"the result's {key} is no number")
    dimension = _SUFFIX.get(name.rpartition("_")[2], "number")
    statistic = key.rpartition(".")[2]
    curve = None if stored is None else _stored_curve(_interval(stored), number, statistic)
    n = _poses(document, holder)
    drawn = sample(document, key)
    if isinstance(drawn, GateSample) and statistic in ("rms", "mean_error", "p95") and drawn.rows.size <= MOST_POSES:
        levels = sorted({*LEVELS, confidence, max(2.0 * confidence - 1.0, 0.01)})
        intervals = length_intervals(drawn.errors, levels, groups=drawn.groups, seed=document.get("seed") or 0)
        curve = BoundCurve.through([one[cast("Statistic", statistic)] for one in intervals])
        n = int(np.unique(drawn.groups).size)
    return GateFigure(number, dimension, curve, n, statistic)


def sample(document: Mapping[str, Any], key: str) -> GateSample | None:
    """The errors of the poses that a statistic at ``key`` is of; None where the result does not list them."""
    parts = key.split(".")
    unit = {"position": "m", "orientation": "rad"}.get(parts[-2] if len(parts) > 1 else "")
    if unit is None:
        return None
    if len(parts) == 2:
        part = document.get(parts[0])
        errors = part.get(f"errors_{unit}") if isinstance(part, Mapping) else None
        return _sample(errors, document.get("poses"), document)
    if len(parts) != 4 or parts[1] not in ("fitted", "held_out"):
        return None
    apart = document.get("poses_apart") if parts[1] == "held_out" else None
    poses = document.get("poses") if apart is None else apart
    held = parts[1] == "held_out" and apart is None and parts[0] != "nominal"
    stages = poses.get(f"errors_{unit}") if isinstance(poses, Mapping) else None
    errors = stages.get(f"held_out_{parts[0]}" if held else parts[0]) if isinstance(stages, Mapping) else None
    return _sample(errors, poses, document, "poses" if apart is None else "holdout")


def _sample(errors: Any, poses: Any, document: Mapping[str, Any], kind: str = "poses") -> GateSample | None:
    """The rows in use of ``errors``; None where the document does not say which poses they are of."""
    if errors is None or not isinstance(poses, Mapping) or poses.get("group") is None:
        return None
    rows = np.asarray(errors, dtype=float)
    used = poses.get("used")
    kept = np.ones(len(rows), dtype=bool) if used is None else np.asarray(used, dtype=bool)
    groups = np.asarray(poses["group"], dtype=np.int64)
    if rows.ndim != 2 or rows.shape[1] != 3 or kept.shape != groups.shape or len(rows) != len(groups) or not kept.any():
        return None
    commanded = poses.get("commanded_m")
    files = [one["sha256"] for one in document.get("inputs", ()) if one.get("kind") == kind]
    return GateSample(
        rows[kept].T,
        groups[kept],
        np.flatnonzero(kept),
        None if commanded is None else np.asarray(commanded, dtype=float)[kept].T,
        files[0] if files and files[0] else None,
    )


def _stored(holder: Mapping[str, Any], name: str) -> Mapping[str, Any] | None:
    """The interval that stands beside a value."""
    intervals = holder.get("intervals")
    for beside in (intervals.get(name) if isinstance(intervals, Mapping) else None, holder.get("interval")):
        if isinstance(beside, Mapping):
            return beside
    return None


def _stored_curve(interval: Interval, value: float, statistic: str) -> BoundCurve:
    """The curve through a stored interval, and through the value at one half where that is what it is about.

    A sample's 95th percentile is not: of few poses it is low, so the bounds on either side say more of the middle.
    """
    both = interval.lower is not None and (interval.upper_bound is not None or interval.upper is not None)
    return BoundCurve.through([interval], None if both and statistic == "p95" else value)


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
        method if isinstance(method, str) else "the result's own interval",
        why if isinstance(why, str) else None,
    )


def _poses(document: Mapping[str, Any], holder: Mapping[str, Any]) -> int | None:
    for place, name in ((holder, "n_commanded_poses"), (holder, "n_poses"), (document, "n_poses")):
        value = _number(place.get(name))
        if value is not None:
            return int(value)
    return None


def _number(value: Any) -> float | None:
    """A finite number; None for anything else, booleans included."""
    if isinstance(value, bool | np.bool_ | str | Sequence | Mapping) or value is None or np.ndim(value):
        return None
    return float(value) if math.isfinite(value) else None
