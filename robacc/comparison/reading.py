"""Read a stored result for a comparison: its figures, the errors behind them, and how it was made.

One key stands for one kind of figure: the figures of a fit on held-out poses have the keys of an estimate, because both
come from poses that the model was not fitted to.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.grade import STATISTICS, GradeStep, Scale
from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array

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

    def texts(self, path: str, n: int) -> NDArray[Any] | None:
        """Return ``(n,)`` texts; None if there are none."""
        values = self.at(path)
        if values is None:
            return None
        if not isinstance(values, list) or len(values) != n or not all(isinstance(value, str) for value in values):
            self.report(path, f"expected {n} texts")
            return None
        return np.array(values, dtype=str)

    def flags(self, path: str, n: int) -> NDArray[np.bool_] | None:
        """Return ``(n,)`` booleans; None if there are none."""
        values = self.at(path)
        if values is None:
            return None
        if not isinstance(values, list) or len(values) != n or not all(isinstance(value, bool) for value in values):
            self.report(path, f"expected {n} booleans")
            return None
        return np.array(values, dtype=bool)


# A result to compare: its figures, the errors of every pose behind them, and how it was made.


@dataclass(frozen=True, slots=True)
class ComparedFigure:
    """One number of one result."""

    value: float
    unit: str
    """``m``, ``rad`` or ``1``"""
    lower: float | None = None
    upper: float | None = None
    confidence: float | None = None
    """Confidence of the interval from ``lower`` to ``upper``, if the result has an interval."""


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

    def subset(self, rows: NDArray[np.bool_]) -> ComparedPoses:
        """Return the poses of the rows where ``rows`` is true."""
        return ComparedPoses(
            int(np.count_nonzero(rows)),
            None if self.q is None else self.q[:, rows],
            None if self.commanded is None else self.commanded[:, rows],
            None if self.pose is None else self.pose[rows],
            None if self.target is None else self.target[rows],
        )


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
    figures: Mapping[str, ComparedFigure]
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


FITS = ("calibrate", "trace")
COMPARED = ("estimate", *FITS, "predict", "iso9283")
_LENGTHS = ("rms", "mean_error", "p95", "max")
_QUANTITIES = (("position", "m"), ("orientation", "rad"))


class _FitStage(NamedTuple):
    """Place of one stage of a fit in its document."""

    prefix: str
    """Start of the keys."""
    stage: str
    poses: str
    """``fitted`` or ``held_out``"""
    errors: str
    """Name of the errors under ``poses``."""
    holdout_errors: str | None
    """Name of the errors under ``poses_apart``; None if there are none."""


_STAGES = (
    _FitStage("", "after", "held_out", "held_out_after", "after"),
    _FitStage("before.held_out.", "before", "held_out", "held_out_before", "before"),
    _FitStage("nominal.held_out.", "nominal", "held_out", "held_out_nominal", "nominal"),
    _FitStage("after.fitted.", "after", "fitted", "after", None),
)


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
    provenance = dict(_provenance(result, command, figures))
    compared = ComparedResult(
        name=name,
        command=command,
        version=str(document["robacc"]),
        n_poses=n,
        robot=result.text("robot.name"),
        figures=figures,
        errors=errors,
        provenance=provenance,
        grade=_grade(result),
        scale=scale,
        scale_name=scale_name,
        frame=result.text("frame"),
        digest=digest,
    )
    if result.problems:
        raise InputError(result.problems)
    return compared


def _figures(result: ResultDocument, command: str) -> Iterator[tuple[str, ComparedFigure]]:
    if command == "iso9283":
        yield from _iso9283(result)
        return
    for quantity, unit in _QUANTITIES:
        if command in FITS:
            for stage in _stages(result):
                path = f"{stage.stage}.{stage.poses}.{quantity}"
                yield from _lengths(result, path, f"{stage.prefix}{quantity}", unit)
        else:
            yield from _lengths(result, quantity, quantity, unit)
            yield from _other_figures(result, quantity, unit)


def _stages(result: ResultDocument) -> tuple[_FitStage, ...]:
    """Return the stages of a fit; without held-out poses, the stages on calibration poses take their place."""
    if result.at("after.held_out") is not None:
        return _STAGES
    return tuple(
        _FitStage(entry.prefix.replace("held_out", "fitted"), entry.stage, "fitted", entry.stage, None)
        for entry in _STAGES[:3]
    )


def _lengths(result: ResultDocument, path: str, key: str, unit: str) -> Iterator[tuple[str, ComparedFigure]]:
    for name in _LENGTHS:
        yield from _figure(result, path, f"{key}.{name}", f"{name}_{unit}", unit)


def _figure(result: ResultDocument, path: str, key: str, name: str, unit: str) -> Iterator[tuple[str, ComparedFigure]]:
    """Yield the figure ``name`` of the mapping at ``path``, with the interval stored beside it."""
    value = result.number(f"{path}.{name}")
    if value is not None:
        yield key, _with_interval(result, value, unit, f"{path}.intervals.{name}")


def _with_interval(result: ResultDocument, value: float, unit: str, path: str) -> ComparedFigure:
    limits = (result.number(f"{path}.lower"), result.number(f"{path}.upper"), result.number(f"{path}.confidence"))
    return ComparedFigure(value, unit, *limits)


def _other_figures(result: ResultDocument, quantity: str, unit: str) -> Iterator[tuple[str, ComparedFigure]]:
    """Yield the figures of an estimate or a prediction other than lengths."""
    yield from _figure(result, quantity, f"{quantity}.max_radius95", f"max_radius95_{unit}", unit)
    radius = f"{quantity}.radius95.fitted_mean"
    value = result.number(f"{radius}.radius_{unit}")
    if value is not None:
        yield f"{quantity}.radius95", _with_interval(result, value, unit, f"{radius}.interval")
    value = result.number(f"{quantity}.ellipsoid.0.sd_{unit}")
    if value is not None:
        yield f"{quantity}.longest_sd", _with_interval(result, value, unit, f"{quantity}.ellipsoid.0.interval")
    for i, axis in enumerate("xyz"):
        value = result.number(f"{quantity}.mean_{unit}.{i}")
        if value is not None:
            yield (
                f"{quantity}.mean_{axis}",
                _with_interval(result, value, unit, f"{quantity}.intervals.mean_{unit}.{i}"),
            )
    for i, axis in enumerate("xyz"):
        variance = result.number(f"{quantity}.centred_covariance_{unit}2.{i}.{i}")
        if variance is not None:
            yield f"{quantity}.sd_{axis}", ComparedFigure(max(variance, 0.0) ** 0.5, unit)


def _iso9283(result: ResultDocument) -> Iterator[tuple[str, ComparedFigure]]:
    for symbol in ("AP", "RP", "vAP", "AD", "RD", "drift.AP", "drift.RP", "drift.barycentre", "exchangeability"):
        path = f"iso9283.{symbol}"
        yield from _figure(result, path, f"{path}.max", "max_m", "m")
        yield from _figure(result, f"{path}.orientation", f"{path}.orientation.max", "max_rad", "rad")


def _errors(result: ResultDocument, command: str, n: int) -> Iterator[tuple[str, ErrorSet]]:
    if command == "estimate":
        poses = _poses(result, "poses", n)
        for quantity, unit in _QUANTITIES:
            vectors = result.matrix(f"{quantity}.errors_{unit}", n, 3)
            if vectors is not None and n:
                yield quantity, ErrorSet(vectors, poses, result.number(f"{quantity}.independent_poses"))
        return
    if command not in FITS:
        return
    has_holdout = result.at("poses_apart") is not None
    n_holdout = len(result.at("poses_apart.line") or ()) if has_holdout else 0
    for stage in _stages(result):
        path, size, name = "poses", n, stage.errors
        if has_holdout and stage.poses == "held_out":
            if stage.holdout_errors is None:
                continue
            path, size, name = "poses_apart", n_holdout, stage.holdout_errors
        if not size:
            continue
        poses = _poses(result, path, size)
        result.flags(f"{path}.used", size)  # checked only: the figures count outliers
        for quantity, unit in _QUANTITIES:
            vectors = result.matrix(f"{path}.errors_{unit}.{name}", size, 3)
            if vectors is not None:
                yield f"{stage.prefix}{quantity}", ErrorSet(vectors, poses)


def _poses(result: ResultDocument, path: str, n: int) -> ComparedPoses:
    return ComparedPoses(
        n,
        result.matrix(f"{path}.q", n),
        result.matrix(f"{path}.commanded_m", n, 3),
        result.texts(f"{path}.pose", n),
        result.texts(f"{path}.target", n),
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


def _provenance(
    result: ResultDocument, command: str, figures: Mapping[str, ComparedFigure]
) -> Iterator[tuple[str, str]]:
    """Yield how the result was made, as text by aspect; two results that differ in an aspect give a warning."""
    yield "command", command
    yield "robacc version", str(result.root["robacc"])
    frame = result.text("frame")
    if frame is not None:
        yield "frame", frame
    yield "alignment", _alignment(result, command)
    scale = result.text("grade.scale")
    if scale is not None:
        yield "grade scale", scale
    confidences = sorted({figure.confidence for figure in figures.values() if figure.confidence is not None})
    if confidences:
        yield "confidence", ", ".join(f"{confidence:g}" for confidence in confidences)
    if command in FITS:
        has_holdout = result.at("poses_apart") is not None
        source = "separate poses" if has_holdout else f"{result.at('n_folds')} groups of poses, each in turn"
        has_held_out = result.at("after.held_out") is not None
        yield "held out", source if has_held_out else "nothing (errors of calibration poses)"
    fitted_to = result.at("robot.fitted_to")
    if isinstance(fitted_to, list):
        inputs = [entry for entry in result.at("inputs") or () if isinstance(entry, Mapping)]
        same_poses = any(entry.get("sha256") in fitted_to for entry in inputs if entry.get("kind") == "poses")
        yield "robot file", "fitted to the same poses" if same_poses else "not fitted to these poses"
    targets = result.at("poses.target")
    if isinstance(targets, list):
        yield "targets", ", ".join(sorted({str(target) for target in targets}))


def _alignment(result: ResultDocument, command: str) -> str:
    if command in FITS:
        return "fitted with the model"
    effects = result.at("alignment.what") if command != "iso9283" else result.at("alignment.0.what")
    if not isinstance(effects, list) or not effects:
        return "none"
    return " and ".join(str(effect) for effect in effects) + " registered"
