"""Headlines of the results of ``estimate``, ``predict`` and ``iso9283``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robacc.render.html.blocks import Badge, ReportHeadline, Tile, angle, interval, length
from robacc.render.html.robot_title import of_robot
from robacc.render.plots.chart import Document
from robacc.render.plots.units import DEGREE, length_unit
from robacc.render.text.numbers import confirmation


def estimate_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``estimate``."""
    position, grade = document["position"], document["grade"]
    confirmed = confirmation(grade["demonstrated"], grade["confidence"])
    alignment = document["alignment"]
    registration = "none"
    if alignment is not None:
        registration = f"{' and '.join(alignment['what'])}, {alignment['n_parameters']} parameters"
    robot = document.get("robot") or {}
    modelled = robot.get("effects") or robot.get("fitted_to")
    reference = "the model's predictions" if modelled else "the commanded positions"
    summary = (
        f"The measured positions differ from {reference} by {length(position['rms_m'])} rms over {document['n_poses']} "
        f"poses; 95 % of the poses are within {length(position['p95_m'])}. This is grade {grade['grade']}, {confirmed}."
    )
    return ReportHeadline(
        f"Accuracy{of_robot(document)}",
        summary,
        _estimate_tiles(document),
        (Badge(f"grade {grade['grade']}, {confirmed}", "good" if grade["demonstrated"] else "open"),),
        [
            ("Registration", registration),
            ("Grade", f"{grade['grade']} on the scale {grade['scale']}"),
            ("Frame", "axes of the commanded target" if document["frame"] == "tool" else "axes of the measuring frame"),
        ],
    )


def _estimate_tiles(document: Document) -> list[Tile]:
    position, orientation = document["position"], document["orientation"]
    tiles = [
        _statistic("position, rms", position, "rms_m", "m"),
        _statistic("position, 95th percentile", position, "p95_m", "m"),
    ]
    if orientation is not None:
        tiles.append(_statistic("orientation, 95th percentile", orientation, "p95_rad", "rad"))
    return tiles


def _statistic(label: str, statistics: Mapping[str, Any], key: str, unit: str) -> Tile:
    value, bounds = statistics[key], statistics["intervals"][key]
    low, high = bounds["lower"], bounds["upper"]
    number = length(value, low, high) if unit == "m" else angle(value, low, high)
    interval_text = interval(value, low, high, bounds["confidence"], length_unit(value) if unit == "m" else DEGREE)
    return Tile(label, number, interval_text or bounds.get("why") or "no interval")


def predict_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``predict``."""
    position, grade = document["position"], document["grade"]
    first = document["budget"][0] if document["budget"] else None
    source = "The tolerances give" if document["tolerances"]["parameters"] else "The fit of the model gives"
    summary = (
        f"{source} an expected position error of {length(position['rms_m'])} rms over robots and poses, "
        f"95 % of the errors within {length(position['p95_m'])}: grade {grade['grade']}."
    )
    if first is not None:
        summary += (
            f" The largest share of the variance, {100 * first['share_position']:.0f} %, is from {first['parameter']}."
        )
    worst = position["worst"]
    tiles = [
        Tile("position, rms", length(position["rms_m"]), "over robots and poses"),
        Tile("position, 95th percentile", length(position["p95_m"]), "over robots and poses"),
        Tile("worst pose, rms", length(worst["rms_m"]), f"at {worst['label']}"),
    ]
    facts = [
        ("Configurations", document["configurations"]),
        ("Grade", f"{grade['grade']}, expected, on the scale {grade['scale']}"),
    ]
    if document["against"] is not None:
        facts.append(("Compared with measured poses", str(document["against"]["verdict"]).replace("_", " ")))
    if document["coverage"] is not None:
        facts.append(("Measured poses within their 95 % bound", _covered(document)))
    badge = Badge(f"grade {grade['grade']}, expected", "plain")
    return ReportHeadline(f"Predicted accuracy{of_robot(document)}", summary, tiles, (badge,), facts)


def _covered(document: Document) -> str:
    shares = [(name, document["coverage"][name]) for name in ("position", "orientation")]
    return ", ".join(f"{name} {100 * part['share']:.1f} %" for name, part in shares if part is not None)


def iso9283_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``iso9283``."""
    criteria = document["iso9283"]
    names = (("AP", "accuracy, AP"), ("RP", "repeatability, RP"), ("vAP", "multi-directional, vAP"))
    tiles = []
    for key, label in names:
        criterion = criteria[key]
        bounds = criterion["intervals"]["max_m"]
        value, low, high = criterion["max_m"], bounds["lower"], bounds["upper"]
        if value is None:
            continue
        interval_text = interval(value, low, high, bounds["confidence"], length_unit(value))
        tiles.append(
            Tile(
                label,
                length(value, low, high),
                f"at {criterion['max_at']}{f'; {interval_text}' if interval_text else ''}",
            )
        )
    met = sum(condition["status"] == "met" for condition in document["protocol"])
    summary = (
        f"{document['n_commanded_poses']} commanded poses in {document['n_poses']} visits; each criterion is the "
        f"largest value over the poses. The data meet {met} of {len(document['protocol'])} conditions of the "
        "standard's protocol."
    )
    registration = "none" if not document["alignment"] else " and ".join(document["alignment"][0]["what"])
    facts = [("Files", ", ".join(document["files"])), ("Registration", registration)]
    return ReportHeadline(f"ISO 9283 pose criteria{of_robot(document)}", summary, tiles, (), facts)
