"""Read a stored result for a comparison: its figures, the errors behind them, and how it was made.

One key stands for one kind of figure: the figures of a fit on held-out poses have the keys of an estimate, because both
come from poses that the model was not fitted to.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.grade import GradeStep, Scale
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.statistics.intervals import EstimatedValue, Interval

_LARGEST = 1e9
"""m or rad: every joint, position and error is smaller; the square of a much larger number overflows."""

Document = Mapping[str, Any]


def _at(document: Document, path: str) -> Any:
    """Return the value at a path, in which dots join the keys and the indices of lists; None if there is none."""
    node: Any = document
    for step in path.split("."):
        if isinstance(node, list):
            node = node[int(step)] if int(step) < len(node) else None
        elif node is not None:
            node = node.get(step)
    return node


def _column(document: Document, path: str, n: int, width: int | None = None) -> NDArray[Any] | None:
    """Return ``(n,)`` values, or ``(width, n)`` numbers from a list of rows; None if there are none.

    Raises:
        ValueError: The number of rows differs from ``n``, the rows differ in length, or a number is too large.
    """
    rows = _at(document, path)
    if rows is None:
        return None
    array = np.array(rows, dtype=None if width is None else float)
    if array.shape != (n,) + (() if width is None else (width or array.shape[-1],)):
        raise ValueError(f"{path}: expected {n} rows")
    if width is not None and not np.all(np.abs(array) < _LARGEST):
        raise ValueError(f"{path}: expected numbers below {_LARGEST:g}")
    return array.T


# A result to compare: its figures, the errors of every pose behind them, and how it was made.


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSample:
    """Errors of one result, grouped by commanded pose."""

    vectors: Array
    """``(3, n)`` m or rad"""
    groups: NDArray[np.int64]
    """``(n,)`` commanded pose of each row, 0 to G - 1; paired samples share the numbering."""

    @property
    def n_groups(self) -> int:
        """Return the number of commanded poses."""
        return int(self.groups.max()) + 1

    def sums(self) -> Array:
        """Return sums over each pose's rows ``(9, G)``: count, length, its square, components and their squares."""
        lengths = np.sqrt(np.sum(np.square(self.vectors), axis=0))
        features = (np.ones(lengths.size), lengths, lengths**2, *self.vectors, *np.square(self.vectors))
        return np.stack([np.bincount(self.groups, weights=feature, minlength=self.n_groups) for feature in features])


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSet(ErrorSample):
    """Errors behind a group of figures, with the commanded pose of every row."""

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


@dataclass(frozen=True, slots=True)
class ComparedResult:
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


def split_key(key: str) -> tuple[str, str]:
    """Return the group of a key's errors and its statistic: ``after.fitted.position`` and ``rms``."""
    group, _, statistic = key.rpartition(".")
    return group, statistic


def unit_of(key: str) -> str:
    """Return the unit of a key's value: ``m`` or ``rad``."""
    return "rad" if "orientation" in key.split(".") else "m"


FITS = ("calibrate", "trace")
COMPARED = ("estimate", *FITS, "predict", "iso9283")
_QUANTITIES = ("position", "orientation")
_LENGTHS = ("rms", "mean_error", "p95", "max")
_STATISTICS: tuple[tuple[str, str, str], ...] = (
    *((name, f"{name}_*", f"intervals.{name}_*") for name in (*_LENGTHS, "max_radius95")),
    ("radius95", "radius95.fitted_mean.radius_*", "radius95.fitted_mean.interval"),
    ("longest_sd", "ellipsoid.0.sd_*", "ellipsoid.0.interval"),
    *((f"mean_{axis}", f"mean_*.{i}", f"intervals.mean_*.{i}") for i, axis in enumerate("xyz")),
)
"""Statistics with the places of their value and interval; a star stands for the unit."""
_ISO9283 = ("AP", "RP", "vAP", "AD", "RD", "drift.AP", "drift.RP", "drift.barycentre", "exchangeability")
_STAGES = (
    ("", "after.held_out"),
    ("before.held_out.", "before.held_out"),
    ("nominal.held_out.", "nominal.held_out"),
    ("after.fitted.", "after.fitted"),
)
"""Stages of a fit: the start of their keys, and their place in the document."""


def read_compared_result(document: Mapping[str, Any], name: str, file: str, digest: str) -> ComparedResult:
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
    if command not in COMPARED:
        raise UsageError(f"{file} is a result of {command}; only results of {', '.join(COMPARED)} can be compared")
    grade = document.get("grade") or {}
    places = dict(_places(document, command))
    figures = dict(_figures(document, command, places))
    if not figures:
        raise ValueError("no figures to compare")
    scale = None
    if all(grade.get(key) is not None for key in ("scale", "statistic", "confidence", "steps", "otherwise")):
        steps = tuple(
            GradeStep(step["grade"], step["position_m"], step.get("orientation_rad")) for step in grade["steps"]
        )
        scale = Scale(grade["scale"], grade["statistic"], grade["confidence"], steps, grade["otherwise"])
    own = grade.get("grade")
    if own is not None:
        own += ", predicted" if command == "predict" else f", {'' if grade.get('demonstrated') else 'not '}confirmed"
    return ComparedResult(
        name=name,
        command=command,
        version=document["robacc"],
        n_poses=document["n_poses"],
        robot=_at(document, "robot.name"),
        figures=figures,
        errors={start: errors for start, place in places.items() if (errors := errors_behind(document, place))},
        provenance=_provenance(document, command, figures),
        grade=own,
        scale=scale,
        scale_name=grade.get("scale"),
        frame=document.get("frame"),
        digest=digest,
    )


def _places(document: Document, command: str) -> Iterator[tuple[str, str]]:
    """Yield the groups of figures, the starts of their keys, with their places in the document.

    Without held-out poses, the stages of a fit on calibration poses take their place.
    """
    if command == "iso9283":
        for symbol in _ISO9283:
            yield from ((f"iso9283.{symbol}{part}",) * 2 for part in ("", ".orientation"))
        return
    has_held_out = _at(document, "after.held_out") is not None
    for quantity in _QUANTITIES:
        if command not in FITS:
            yield quantity, quantity
        for start, stage in _STAGES if command in FITS else ():
            if has_held_out or "held_out" in stage:
                poses = ("held_out", "held_out" if has_held_out else "fitted")
                yield f"{start}{quantity}".replace(*poses), f"{stage}.{quantity}".replace(*poses)


def _figures(document: Document, command: str, places: Mapping[str, str]) -> Iterator[tuple[str, EstimatedValue]]:
    names = ("max",) if command == "iso9283" else _LENGTHS if command in FITS else ()  # none stands for all
    for start, place in places.items():
        unit = unit_of(start)
        for name, path, interval_path in _STATISTICS:
            value = None if names and name not in names else _at(document, f"{place}.{path}".replace("*", unit))
            if value is not None:
                stored = _at(document, f"{place}.{interval_path}".replace("*", unit))
                yield f"{start}.{name}", EstimatedValue(value, None if stored is None else stored_interval(stored))
        for i, axis in enumerate("" if names else "xyz"):
            variance = _at(document, f"{place}.centred_covariance_{unit}2.{i}.{i}")
            if variance is not None:
                yield f"{start}.sd_{axis}", EstimatedValue(max(variance, 0.0) ** 0.5, None)


def stored_interval(stored: Document) -> Interval:
    """Return the interval that a result stores, under the names of an interval or of a gain."""
    lower, upper = stored.get("lower", stored.get("low")), stored.get("upper", stored.get("high"))
    method = stored.get("method") or "interval stored in the result"
    return Interval(
        lower, upper, stored.get("upper_bound"), stored.get("confidence") or 0.95, method, stored.get("why")
    )


def errors_behind(document: Document, place: str) -> ErrorSet | None:
    """Return the errors behind the figures of a place; None if the result does not list them.

    Args:
        document: The JSON document of a result.
        place: ``position`` of an estimate, ``after.held_out.position`` of a fit …; its metrics count outliers.

    Raises:
        ValueError: The lists of the document do not belong together.
    """
    *stage, quantity = place.split(".")
    if quantity not in _QUANTITIES or stage[1:] not in ([], ["fitted"], ["held_out"]):
        return None
    unit, rows, kind = unit_of(quantity), "poses", "poses"
    path = f"{quantity}.errors_{unit}"
    if stage:
        name = stage[0]
        if stage[1:] == ["held_out"] and document.get("poses_apart") is not None:
            rows, kind = "poses_apart", "holdout"
        elif stage[1:] == ["held_out"]:
            name = f"held_out_{name}"
        path = f"{rows}.errors_{unit}.{name}"
    n = document.get("n_poses", 0) if rows == "poses" else len(document[rows]["line"])
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
        None if stage else _at(document, f"{quantity}.independent_poses"),
    )


def _provenance(document: Document, command: str, figures: Mapping[str, EstimatedValue]) -> dict[str, str]:
    """Return how the result was made, as text by aspect; two results that differ in an aspect give a warning."""
    confidences = sorted({figure.interval.confidence for figure in figures.values() if figure.interval is not None})
    held_out = fitted_to_these = None
    alignment = "fitted with the model"
    if command in FITS:
        has_holdout = document.get("poses_apart") is not None
        held_out = "separate poses" if has_holdout else f"{document.get('n_folds')} groups of poses, each in turn"
        if _at(document, "after.held_out") is None:
            held_out = "nothing (errors of calibration poses)"
    else:
        effects = _at(document, "alignment.0.what" if command == "iso9283" else "alignment.what")
        alignment = f"{' and '.join(effects)} registered" if effects else "none"
    fitted_to, targets = _at(document, "robot.fitted_to"), _at(document, "poses.target")
    if fitted_to is not None:
        same_poses = any(entry["sha256"] in fitted_to for entry in document["inputs"] if entry["kind"] == "poses")
        fitted_to_these = "fitted to the same poses" if same_poses else "not fitted to these poses"
    aspects = {
        "command": command,
        "robacc version": document["robacc"],
        "frame": document.get("frame"),
        "alignment": alignment,
        "grade scale": _at(document, "grade.scale"),
        "confidence": ", ".join(f"{confidence:g}" for confidence in confidences) or None,
        "held out": held_out,
        "robot file": fitted_to_these,
        "targets": None if targets is None else ", ".join(sorted(set(targets))),
    }
    return {aspect: text for aspect, text in aspects.items() if text is not None}
