"""A stored result as something to compare: its figures, the errors behind them, and how it was made.

What compares under one key is one thing: the figures of a fit held out after it stand where those of an estimate do,
because both are of poses that had no part in what predicts them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from robacc.accuracy.grade_scale import STATISTICS, GradeStep, Scale
from robacc.comparison.compared_result import ComparedFigure, ComparedPoses, ComparedResult, ErrorSet
from robacc.comparison.document import ResultDocument
from robacc.errors import InputError, UsageError

FITS = ("calibrate", "trace")
COMPARED = ("estimate", *FITS, "predict", "iso9283")
_LENGTHS = ("rms", "mean_error", "p95", "max")
_QUANTITIES = (("position", "m"), ("orientation", "rad"))
_STAGES = (
    ("", "after", "held_out", "held_out_after", "after"),
    ("before.held_out.", "before", "held_out", "held_out_before", "before"),
    ("nominal.held_out.", "nominal", "held_out", "nominal", "nominal"),
    ("after.fitted.", "after", "fitted", "after", None),
)
"""What keys of a fit begin with, the stage, its poses, and the name of its errors in the poses' own record and in that
of poses apart (None: it has none there)."""


def subject(document: Mapping[str, Any], name: str, file: str, digest: str) -> ComparedResult:
    """The subject of a result's document.

    Args:
        document: As :func:`robacc.documents.read_result.read_result` gives it.
        name: Under which it is to appear.
        file: Its file, for messages.
        digest: SHA-256 of the file.

    Raises:
        InputError: With everything that is wrong with it.
        UsageError: It is a result of a command that has nothing to compare.
    """
    command = str(document["command"])
    if command not in COMPARED:
        raise UsageError(f"{file} is a result of {command}; compared are those of {', '.join(COMPARED)}")
    found = ResultDocument(document, file)
    n = found.count("n_poses")
    figures, errors = dict(_figures(found, command)), dict(_errors(found, command, n))
    scale, scale_name = _scale(found)
    if not figures and not found.problems:
        found.report("position", "the figures of a result are expected here")
    made = dict(_made(found, command, figures))
    result = ComparedResult(
        name=name,
        command=command,
        version=str(document["robacc"]),
        n_poses=n,
        robot=found.text("robot.name"),
        figures=figures,
        errors=errors,
        made=made,
        grade=_grade(found),
        scale=scale,
        scale_name=scale_name,
        frame=found.text("frame"),
        digest=digest,
    )
    if found.problems:
        raise InputError(found.problems)
    return result


def _figures(found: ResultDocument, command: str) -> Iterator[tuple[str, ComparedFigure]]:
    if command == "iso9283":
        yield from _iso9283(found)
        return
    for quantity, unit in _QUANTITIES:
        if command in FITS:
            for prefix, stage, poses, _, _ in _stages(found):
                yield from _lengths(found, f"{stage}.{poses}.{quantity}", f"{prefix}{quantity}", unit)
        else:
            yield from _lengths(found, quantity, quantity, unit)
            yield from _further(found, quantity, unit)


def _stages(found: ResultDocument) -> tuple[tuple[str, str, str, str, str | None], ...]:
    """The stages of a fit; without poses held out, the fitted figures stand in their place, and the result says so."""
    if found.at("after.held_out") is not None:
        return _STAGES
    return tuple(
        (prefix.replace("held_out", "fitted"), stage, "fitted", stage, None) for prefix, stage, *_ in _STAGES[:3]
    )


def _lengths(found: ResultDocument, path: str, key: str, unit: str) -> Iterator[tuple[str, ComparedFigure]]:
    for name in _LENGTHS:
        yield from _one(found, path, f"{key}.{name}", f"{name}_{unit}", unit)


def _one(found: ResultDocument, path: str, key: str, name: str, unit: str) -> Iterator[tuple[str, ComparedFigure]]:
    """The figure ``name`` of the mapping at ``path``, with its interval beside it."""
    value = found.number(f"{path}.{name}")
    if value is not None:
        yield key, _with_interval(found, value, unit, f"{path}.intervals.{name}")


def _with_interval(found: ResultDocument, value: float, unit: str, path: str) -> ComparedFigure:
    limits = (found.number(f"{path}.lower"), found.number(f"{path}.upper"), found.number(f"{path}.confidence"))
    return ComparedFigure(value, unit, *limits)


def _further(found: ResultDocument, quantity: str, unit: str) -> Iterator[tuple[str, ComparedFigure]]:
    """What an estimate or a prediction has beside the lengths."""
    yield from _one(found, quantity, f"{quantity}.max_radius95", f"max_radius95_{unit}", unit)
    radius = f"{quantity}.radius95.fitted_mean"
    value = found.number(f"{radius}.radius_{unit}")
    if value is not None:
        yield f"{quantity}.radius95", _with_interval(found, value, unit, f"{radius}.interval")
    value = found.number(f"{quantity}.ellipsoid.0.sd_{unit}")
    if value is not None:
        yield f"{quantity}.longest_sd", _with_interval(found, value, unit, f"{quantity}.ellipsoid.0.interval")
    for i, axis in enumerate("xyz"):
        value = found.number(f"{quantity}.mean_{unit}.{i}")
        if value is not None:
            yield (
                f"{quantity}.mean_{axis}",
                _with_interval(found, value, unit, f"{quantity}.intervals.mean_{unit}.{i}"),
            )
    for i, axis in enumerate("xyz"):
        variance = found.number(f"{quantity}.centred_covariance_{unit}2.{i}.{i}")
        if variance is not None:
            yield f"{quantity}.sd_{axis}", ComparedFigure(max(variance, 0.0) ** 0.5, unit)


def _iso9283(found: ResultDocument) -> Iterator[tuple[str, ComparedFigure]]:
    for symbol in ("AP", "RP", "vAP", "AD", "RD", "drift.AP", "drift.RP", "drift.barycentre", "exchangeability"):
        path = f"iso9283.{symbol}"
        yield from _one(found, path, f"{path}.max", "max_m", "m")
        yield from _one(found, f"{path}.orientation", f"{path}.orientation.max", "max_rad", "rad")


def _errors(found: ResultDocument, command: str, n: int) -> Iterator[tuple[str, ErrorSet]]:
    if command == "estimate":
        poses = _poses(found, "poses", n)
        for quantity, unit in _QUANTITIES:
            vectors = found.matrix(f"{quantity}.errors_{unit}", n, 3)
            if vectors is not None and n:
                yield quantity, ErrorSet(vectors, poses)
        return
    if command not in FITS:
        return
    apart = found.at("poses_apart") is not None
    n_apart = len(found.at("poses_apart.line") or ()) if apart else 0
    for prefix, _, of, name, name_apart in _stages(found):
        place, size, label = ("poses_apart", n_apart, name_apart) if apart and of == "held_out" else ("poses", n, name)
        if label is None or not size:
            continue
        poses, used = _poses(found, place, size), found.flags(f"{place}.used", size)
        rows = np.ones(size, dtype=bool) if used is None else used
        for quantity, unit in _QUANTITIES:
            vectors = found.matrix(f"{place}.errors_{unit}.{label}", size, 3)
            if vectors is not None and np.any(rows):
                yield f"{prefix}{quantity}", ErrorSet(vectors[:, rows], poses.subset(rows))


def _poses(found: ResultDocument, path: str, n: int) -> ComparedPoses:
    return ComparedPoses(
        n,
        found.matrix(f"{path}.q", n),
        found.matrix(f"{path}.commanded_m", n, 3),
        found.texts(f"{path}.pose", n),
        found.texts(f"{path}.target", n),
    )


def _grade(found: ResultDocument) -> str | None:
    grade = found.text("grade.grade")
    if grade is None:
        return None
    if found.root["command"] == "predict":
        return f"{grade}, predicted"
    return f"{grade}, demonstrated" if found.at("grade.demonstrated") is True else f"{grade}, not demonstrated"


def _scale(found: ResultDocument) -> tuple[Scale | None, str | None]:
    """The scale that the result was graded on, where its document has it whole, and its name."""
    name, statistic = found.text("grade.scale"), found.text("grade.statistic")
    steps, otherwise = found.at("grade.steps"), found.text("grade.otherwise")
    confidence = found.number("grade.confidence")
    if not isinstance(steps, list) or name is None or statistic not in STATISTICS or otherwise is None:
        return None, name
    read = []
    for i in range(len(steps)):
        grade, position = found.text(f"grade.steps.{i}.grade"), found.number(f"grade.steps.{i}.position_m")
        if grade is None or position is None:
            found.report(f"grade.steps.{i}", "a grade and its limit of position are expected here")
            return None, name
        read.append(GradeStep(grade, position, found.number(f"grade.steps.{i}.orientation_rad")))
    if confidence is None or not 0.5 <= confidence < 1.0 or not read:
        return None, name
    return Scale(name, statistic, confidence, tuple(read), otherwise), name  # type: ignore[arg-type]


def _made(found: ResultDocument, command: str, figures: Mapping[str, ComparedFigure]) -> Iterator[tuple[str, str]]:
    """How the result was made, in words: what differs between two results is warned of."""
    yield "command", command
    yield "robacc version", str(found.root["robacc"])
    frame = found.text("frame")
    if frame is not None:
        yield "frame", frame
    yield "alignment", _alignment(found, command)
    scale = found.text("grade.scale")
    if scale is not None:
        yield "grade scale", scale
    confidences = sorted({figure.confidence for figure in figures.values() if figure.confidence is not None})
    if confidences:
        yield "confidence", ", ".join(f"{one:g}" for one in confidences)
    if command in FITS:
        apart = found.at("poses_apart") is not None
        held = "poses of their own" if apart else f"{found.at('n_folds')} folds"
        yield "held out", held if found.at("after.held_out") is not None else "nothing (figures of poses fitted)"
    fitted = found.at("robot.fitted_to")
    if isinstance(fitted, list):
        inputs = [one for one in found.at("inputs") or () if isinstance(one, Mapping)]
        seen = any(one.get("sha256") in fitted for one in inputs if one.get("kind") == "poses")
        yield "robot file", "fitted to these very poses" if seen else "not fitted to these poses"
    targets = found.at("poses.target")
    if isinstance(targets, list):
        yield "targets", ", ".join(sorted({str(one) for one in targets}))


def _alignment(found: ResultDocument, command: str) -> str:
    if command in FITS:
        return "fitted with the model"
    what = found.at("alignment.what") if command != "iso9283" else found.at("alignment.0.what")
    if not isinstance(what, list) or not what:
        return "nothing aligned"
    return " and ".join(str(one) for one in what) + " aligned"
