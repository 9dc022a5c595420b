"""Read a stored result for a comparison: its figures, the errors behind them, and how it was made.

One key stands for one kind of figure: the figures of a fit on held-out poses have the keys of an estimate, because both
come from poses that the model was not fitted to.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.grade import STATISTICS, GradeStep, Scale
from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array
from robacc.statistics.intervals import EstimatedValue, Interval

# Typed access to the JSON document of a stored result, by path; problems are collected.

_LARGEST = 1e9
"""m or rad: every joint, position and error is smaller; the square of a much larger number overflows."""

MOST_POSES = 10**8
"""Largest number of poses of a file; a larger one would fill the memory before its mismatch is noticed."""


@dataclass(frozen=True, slots=True)
class ResultDocument:
    """JSON document of a result; dots join the keys of a path, and a number is an index into a list."""

    root: Mapping[str, Any]
    file: str
    problems: list[Problem] = field(default_factory=list)

    def report(self, path: str, message: str) -> None:
        """Add a problem at a path."""
        self.problems.append(Problem(message, self.file, column=path, fix=None))

    def at(self, path: str) -> Any:
        """Return the value at a path; None if there is none."""
        node: Any = self.root
        for step in path.split("."):
            if isinstance(node, Mapping):
                node = node.get(step)
            elif isinstance(node, Sequence) and not isinstance(node, str) and step.isdecimal():
                node = node[int(step)] if int(step) < len(node) else None
            else:
                return None
        return node

    def number(self, path: str) -> float | None:
        """Return a finite number, or None if there is none."""
        value = self.at(path)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self.report(path, f"expected a number, found {str(value)[:40]!r}")
            return None
        return float(value)

    def text(self, path: str) -> str | None:
        """Return a text, or None if there is none."""
        value = self.at(path)
        if value is None or isinstance(value, str):
            return value
        self.report(path, f"expected text, found {str(value)[:40]!r}")
        return None

    def count(self, path: str) -> int:
        """Return a number of poses; a missing number is a problem."""
        value = self.at(path)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MOST_POSES:
            self.report(path, "expected a number of poses")
            return 0
        return value

    def matrix(self, path: str, n: int, width: int | None = None) -> Array | None:
        """Return ``(width, n)`` from a list of ``n`` rows of finite numbers; None if there is none."""
        rows = self.at(path)
        if rows is None:
            return None
        try:
            array = np.array(rows, dtype=float)
        except (TypeError, ValueError):
            array = np.zeros(())
        if array.ndim != 2 or array.shape[0] != n or array.shape[1] != (width or array.shape[1]):
            self.report(path, f"expected {n} rows of {width if width else 'equally many'} numbers")
            return None
        if not np.all(np.abs(array) < _LARGEST):
            self.report(path, f"expected numbers below {_LARGEST:g}")
            return None
        return array.T

    def column(self, path: str, n: int, kind: type, plural: str) -> NDArray[Any] | None:
        """Return ``(n,)`` values of one kind; None if there are none."""
        values = self.at(path)
        if values is None:
            return None
        if not isinstance(values, list) or len(values) != n or not all(isinstance(value, kind) for value in values):
            self.report(path, f"expected {n} {plural}")
            return None
        return np.array(values, dtype=kind)


# A result to compare: its figures, the errors of every pose behind them, and how it was made.


@dataclass(frozen=True, slots=True, eq=False)
class ComparedPoses:
    """Commanded poses of a result's rows."""

    n: int
    q: Array | None
    """``(J, n)`` commanded joints, rad or m."""
    commanded: Array | None
    """``(3, n)`` commanded position, m."""
    pose: NDArray[Any] | None
    """``(n,)`` id, text."""
    target: NDArray[Any] | None


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSet:
    """Errors behind a group of figures."""

    vectors: Array
    """``(3, n)`` m or rad"""
    poses: ComparedPoses
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
    ("", "after", "held_out"),
    ("before.held_out.", "before", "held_out"),
    ("nominal.held_out.", "nominal", "held_out"),
    ("after.fitted.", "after", "fitted"),
)
"""Stages of a fit: the start of their keys, the name of the stage, and its poses."""


def read_compared_result(document: Mapping[str, Any], name: str, file: str, digest: str) -> ComparedResult:
    """Return the figures, errors and provenance of a result.

    Args:
        document: The JSON document, from :func:`robacc.documents.read_result.read_result`.
        name: Unique name of the result in the comparison.
        file: The result's file, for messages.
        digest: SHA-256 of the file.

    Raises:
        InputError: The document has invalid values; every problem is listed.
        UsageError: The result has no figures to compare.
    """
    command = str(document["command"])
    if command not in COMPARED:
        raise UsageError(f"{file} is a result of {command}; only results of {', '.join(COMPARED)} can be compared")
    result = ResultDocument(document, file)
    n = result.count("n_poses")
    figures, errors = dict(_figures(result, command)), dict(_errors(result, command, n))
    scale, scale_name = _scale(result)
    if not figures and not result.problems:
        result.report("position", "expected the figures of a result")
    compared = ComparedResult(
        name=name,
        command=command,
        version=str(document["robacc"]),
        n_poses=n,
        robot=result.text("robot.name"),
        figures=figures,
        errors=errors,
        provenance=_provenance(result, command, figures),
        grade=_grade(result),
        scale=scale,
        scale_name=scale_name,
        frame=result.text("frame"),
        digest=digest,
    )
    if result.problems:
        raise InputError(result.problems)
    return compared


def _figures(result: ResultDocument, command: str) -> Iterator[tuple[str, EstimatedValue]]:
    places = [(f"{quantity}.", f"{quantity}.") for quantity in _QUANTITIES]
    names: tuple[str, ...] = ()  # all statistics

    if command == "iso9283":
        places = [(f"iso9283.{name}",) * 2 for symbol in _ISO9283 for name in (f"{symbol}.", f"{symbol}.orientation.")]
        names = ("max",)
    elif command in FITS:
        places = [
            (f"{start}{quantity}.", f"{stage}.{poses}.{quantity}.")
            for quantity in _QUANTITIES
            for start, stage, poses in _stages(result)
        ]
        names = _LENGTHS
    for start, place in places:
        unit = unit_of(start)
        for name, path, interval_path in _STATISTICS:
            value = None if names and name not in names else result.number(place + path.replace("*", unit))
            if value is not None:
                yield (
                    f"{start}{name}",
                    EstimatedValue(value, _interval(result, place + interval_path.replace("*", unit))),
                )
        for i, axis in enumerate("" if names else "xyz"):
            variance = result.number(f"{place}centred_covariance_{unit}2.{i}.{i}")
            if variance is not None:
                yield f"{start}sd_{axis}", EstimatedValue(max(variance, 0.0) ** 0.5, None)


def _interval(result: ResultDocument, path: str) -> Interval | None:
    lower, upper, confidence = (result.number(f"{path}.{name}") for name in ("lower", "upper", "confidence"))
    return None if confidence is None else Interval(lower, upper, None, confidence, "interval stored in the result")


def _stages(result: ResultDocument) -> tuple[tuple[str, str, str], ...]:
    """Return the stages of a fit; without held-out poses, the stages on calibration poses take their place."""
    if result.at("after.held_out") is not None:
        return _STAGES
    return tuple((start.replace("held_out", "fitted"), stage, "fitted") for start, stage, _ in _STAGES[:3])


def _errors(result: ResultDocument, command: str, n: int) -> Iterator[tuple[str, ErrorSet]]:
    if command == "estimate":
        poses = _poses(result, "poses", n)
        for quantity in _QUANTITIES:
            vectors = result.matrix(f"{quantity}.errors_{unit_of(quantity)}", n, 3)
            if vectors is not None and n:
                yield quantity, ErrorSet(vectors, poses, result.number(f"{quantity}.independent_poses"))
    has_holdout = result.at("poses_apart") is not None
    for start, stage, kind in _stages(result) if command in FITS else ():
        path, size, name = "poses", n, stage
        if kind == "held_out" and has_holdout:
            path, size = "poses_apart", len(result.at("poses_apart.line") or ())
        elif kind == "held_out":
            name = f"held_out_{stage}"
        if not size:
            continue
        poses = _poses(result, path, size)
        result.column(f"{path}.used", size, bool, "booleans")  # checked only: the figures count outliers
        for quantity in _QUANTITIES:
            vectors = result.matrix(f"{path}.errors_{unit_of(quantity)}.{name}", size, 3)
            if vectors is not None:
                yield f"{start}{quantity}", ErrorSet(vectors, poses)


def _poses(result: ResultDocument, path: str, n: int) -> ComparedPoses:
    return ComparedPoses(
        n,
        result.matrix(f"{path}.q", n),
        result.matrix(f"{path}.commanded_m", n, 3),
        result.column(f"{path}.pose", n, str, "texts"),
        result.column(f"{path}.target", n, str, "texts"),
    )


def _grade(result: ResultDocument) -> str | None:
    grade = result.text("grade.grade")
    if grade is None:
        return None
    if result.root["command"] == "predict":
        return f"{grade}, predicted"
    return f"{grade}, confirmed" if result.at("grade.demonstrated") is True else f"{grade}, not confirmed"


def _scale(result: ResultDocument) -> tuple[Scale | None, str | None]:
    """Return the grade scale of the result, if its document stores the complete scale, and the scale's name."""
    name, statistic = result.text("grade.scale"), result.text("grade.statistic")
    entries, otherwise = result.at("grade.steps"), result.text("grade.otherwise")
    confidence = result.number("grade.confidence")
    if not isinstance(entries, list) or name is None or statistic not in STATISTICS or otherwise is None:
        return None, name
    steps = []
    for i in range(len(entries)):
        grade, position = result.text(f"grade.steps.{i}.grade"), result.number(f"grade.steps.{i}.position_m")
        if grade is None or position is None:
            result.report(f"grade.steps.{i}", "expected a grade and its position limit")
            return None, name
        steps.append(GradeStep(grade, position, result.number(f"grade.steps.{i}.orientation_rad")))
    if confidence is None or not 0.5 <= confidence < 1.0 or not steps:
        return None, name
    return Scale(name, statistic, confidence, tuple(steps), otherwise), name  # type: ignore[arg-type]


def _provenance(result: ResultDocument, command: str, figures: Mapping[str, EstimatedValue]) -> dict[str, str]:
    """Return how the result was made, as text by aspect; two results that differ in an aspect give a warning."""
    confidences = sorted({figure.interval.confidence for figure in figures.values() if figure.interval is not None})
    held_out = fitted_to_these = None
    if command in FITS:
        has_holdout = result.at("poses_apart") is not None
        held_out = "separate poses" if has_holdout else f"{result.at('n_folds')} groups of poses, each in turn"
        if result.at("after.held_out") is None:
            held_out = "nothing (errors of calibration poses)"
    fitted_to, targets = result.at("robot.fitted_to"), result.at("poses.target")
    if isinstance(fitted_to, list):
        inputs = [entry for entry in result.at("inputs") or () if isinstance(entry, Mapping)]
        same_poses = any(entry.get("sha256") in fitted_to for entry in inputs if entry.get("kind") == "poses")
        fitted_to_these = "fitted to the same poses" if same_poses else "not fitted to these poses"
    aspects = {
        "command": command,
        "robacc version": str(result.root["robacc"]),
        "frame": result.text("frame"),
        "alignment": _alignment(result, command),
        "grade scale": result.text("grade.scale"),
        "confidence": ", ".join(f"{confidence:g}" for confidence in confidences) or None,
        "held out": held_out,
        "robot file": fitted_to_these,
        "targets": ", ".join(sorted(set(map(str, targets)))) if isinstance(targets, list) else None,
    }
    return {aspect: text for aspect, text in aspects.items() if text is not None}


def _alignment(result: ResultDocument, command: str) -> str:
    if command in FITS:
        return "fitted with the model"
    effects = result.at("alignment.what") if command != "iso9283" else result.at("alignment.0.what")
    if not isinstance(effects, list) or not effects:
        return "none"
    return " and ".join(str(effect) for effect in effects) + " registered"
