"""Headlines of the results of ``trace`` and ``calibrate``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robacc.render.html.blocks import Badge, ReportHeadline, Tile, interval, length
from robacc.render.html.robot_title import of_robot
from robacc.render.plots.chart import Document
from robacc.render.plots.stage_errors import STAGE_LABELS
from robacc.render.plots.units import length_unit

VERDICTS = {
    "clean": ("clean", "good"),
    "explained": ("explained", "good"),
    "partly_explained": ("partly explained", "open"),
    "unexplained": ("unexplained", "bad"),
}
_UNSTRUCTURED = "the remaining error has no structure"
"""The text does not say noise: the size of the noise may be unknown."""


def trace_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``trace``."""
    label, tone = VERDICTS[document["verdict"]]
    declared = document["options"].get("declared") or "none"
    unexplained = document["unexplained"]
    facts = [("Declared effects", declared.replace(",", ", ")), ("Measurement noise", _noise(document))]
    if unexplained["structured"]:
        facts.append(("Remaining error", f"{length(unexplained['rms_m'])}, structured"))
    return ReportHeadline(
        f"Trace{of_robot(document)}: {label}", _trace_summary(document), _tiles(document), (Badge(label, tone),), facts
    )


def _trace_summary(document: Document) -> str:
    before, after, pose_set = _sides(document)
    structured = document["unexplained"]["structured"]
    start = f"With the declared effects fitted, the model predicts the measured poses to {length(before['rms_m'])} rms"
    arm = _arm_itself(document)
    names = [_effect(finding) for finding in document["findings"]]
    if not names:
        end = "the remaining error is structured, but no effect of the catalogue explains it"
        return f"{start} ({pose_set}). No effect was found; {end if structured else _UNSTRUCTURED}. {arm}"
    causes = f"cause is {names[0]}" if len(names) == 1 else f"causes are {', '.join(names[:-1])} and {names[-1]}"
    end = "the remaining error has a structure that no candidate explains" if structured else _UNSTRUCTURED
    return (
        f"{start} ({pose_set}). The identified {causes}. With {'it' if len(names) == 1 else 'them'} added, the model "
        f"predicts the measured poses to {length(after['rms_m'])} rms; {end}. {arm}"
    )


def _arm_itself(document: Document) -> str:
    """Return the error of the arm: a model changes no arm until it is used."""
    key = "fitted" if document["nominal"]["held_out"] is None else "held_out"
    rms = length(document["nominal"][key]["position"]["rms_m"])
    return (
        f"The arm itself keeps its error of {rms} rms, base and tool registered, until its controller uses the model."
    )


def _effect(finding: Mapping[str, Any]) -> str:
    where = f" on {', '.join(finding['joints'])}" if finding["joints"] else ""
    return f"{finding['effect'].replace('_', ' ')}{where}"


def calibrate_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``calibrate``."""
    before, after, pose_set = _sides(document)
    summary = (
        f"With {document['options'].get('fit', '').replace(',', ', ')} fitted, the model predicts the measured poses "
        f"to {length(after['rms_m'])} rms ({pose_set}); with only base and tool fitted, to {length(before['rms_m'])}. "
        f"{_arm_itself(document)}"
    )
    effects = ", ".join(effect["effect"] for effect in document["effects"])
    facts = [("Fitted effects", effects), ("Measurement noise", _noise(document))]
    return ReportHeadline(f"Calibration{of_robot(document)}", summary, _tiles(document), (), facts)


def _sides(document: Document) -> tuple[Mapping[str, Any], Mapping[str, Any], str]:
    """Return the position errors before and after, and the pose set."""
    key = "fitted" if document["after"]["held_out"] is None else "held_out"
    pose_set = "held-out poses" if key == "held_out" else "calibration poses"
    return document["before"][key]["position"], document["after"][key]["position"], pose_set


def _tiles(document: Document) -> list[Tile]:
    before, after, pose_set = _sides(document)
    labels = STAGE_LABELS[document["command"]]
    sides = ((labels["before"], before), (labels["after"], after))
    tiles = [_side(f"{label}, rms", metrics, pose_set) for label, metrics in sides]
    gain = document["gain_m"]
    if gain is not None:
        low, high = gain["low"], gain["high"]
        unit = length_unit(gain["value"])
        interval_text = interval(gain["value"], low, high, gain["confidence"], unit)
        tiles.append(Tile("rms reduction", length(gain["value"], low, high), interval_text))
    return tiles


def _side(name: str, metrics: Mapping[str, Any], pose_set: str) -> Tile:
    """Return the tile of one stage's rms error with its interval."""
    value, bounds = metrics["rms_m"], (metrics.get("intervals") or {}).get("rms_m") or {}
    low, high = bounds.get("lower"), bounds.get("upper")
    interval_text = interval(value, low, high, bounds.get("confidence", 0.95), length_unit(value))
    return Tile(name, length(value, low, high), f"{interval_text}; {pose_set}" if interval_text else pose_set)


def _noise(document: Document) -> str:
    noise = document["noise"]
    source = {"file": "the file's sigma columns", "repeats": "repeated poses", "residual": "the remaining error"}
    return f"{length(noise['position_m'])} along each axis, from {source.get(noise['source'], noise['source'])}"
