"""The sections of a `plan` report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.planning.power import InseparablePair
from robacc.render.html.blocks import (
    Badge,
    Block,
    Cell,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    ReportSection,
    Text,
    Tile,
    length,
    of_robot,
)
from robacc.render.plots.canvas import Document
from robacc.render.text.layout import three_digits
from robacc.render.text.plan import PURPOSES, pair_texts

_LISTED = 20
_VISITS = 200
"""Visits that the page lists."""


def plan_headline(document: Document) -> ReportHeadline:
    """Return the number of poses and visits, the predicted error, and whether earlier poses are enough."""
    accuracy, sufficiency = document["accuracy"], document["sufficiency"]
    planned = None if accuracy is None else accuracy["planned"]
    n, visits = document["n_poses"], document["n_visits"]
    summary = f"{n} poses in {visits} visits, chosen from {document['candidates']['feasible']} feasible poses."
    tiles = [Tile("different poses", Number(str(n), float(n))), Tile("visits", Number(str(visits), float(visits)))]
    if planned is not None:
        tiles.append(Tile("predicted error after the fit, rms", length(planned["rms_m"])))
        tiles.append(Tile("the same of random poses", length(planned["random_rms_m"])))
    power = document["power"]
    if power is not None:
        for label, key in (("effects found at their usual size", "found"), ("found and separated", "separated")):
            chance = f"random poses {100 * power[f'random_{key}']:.0f} %"
            tiles.append(Tile(label, Number(f"{100 * power[key]:.0f} %", power[key]), chance))
    badges = []
    if sufficiency is not None:
        summary += f" After {sufficiency['n_already']} poses: {sufficiency['why']}."
        badges.append(Badge("enough poses", "good") if sufficiency["enough"] else Badge("more poses needed", "open"))
    return ReportHeadline(
        f"Plan for the {PURPOSES[document['purpose']]}{of_robot(document)}", summary, tiles, badges, _facts(document)
    )


def _facts(document: Document) -> list[tuple[str, str]]:
    noise = document["noise"]
    facts = [
        ("Instrument", f"{length(noise['position_m'])} along each axis"),
        ("Repeatability", f"{length(noise['repeatability_m'])} along each axis at the target"),
        ("Source of the noise", str(noise["source"])),
    ]
    if document["fit"]:
        facts.append(("Free effects", ", ".join(document["fit"].split(","))))
    return facts


def plan_sections(document: Document) -> Iterator[ReportSection]:
    """Return the order of the visits, what was excluded, and what to expect."""
    yield _order(document)
    yield _exclusions(document)
    if document["needed_poses"]:
        yield _needed(document)
    if document["purpose"] in ("calibrate", "health"):
        yield _coefficients(document)
    if document["inseparable"]:
        yield _inseparable(document)
    if document["not_testable"]:
        rows = [[name, reason] for name, reason in document["not_testable"].items()]
        yield ReportSection("Effects that these poses cannot test", [Grid(("effect", "reason"), rows, is_text=True)])
    yield _visits(document)


def _order(document: Document) -> ReportSection:
    route = document["route"]
    least = min(route["rarer_direction_share"], default=0.0)
    texts = [
        f"Drive straight from visit to visit: {route['length']:.1f} joint ranges, {route['random_length']:.1f} in a "
        "random order.",
        f"Each joint is approached from its rarer direction in at least {100 * least:.0f} % of its moves.",
    ]
    if route["checks"]:
        texts.append(f"The drift check poses are visited {route['checks']} times: compare these rows for drift.")
    if route["repeats"]:
        texts.append(f"{route['repeats']} poses are visited twice: these rows show the repeatability.")
    blocks: list[Block] = [Listing(texts)]
    if document["payloads"]:
        rows: list[Sequence[Cell]] = [
            [
                f"{block['payload_kg']:g} kg",
                f"{block['first_visit']} to {block['first_visit'] + block['n_visits'] - 1}",
                str(block["n_poses"]),
            ]
            for block in document["payloads"]
        ]
        blocks.append(Grid(("payload", "visits", "different poses"), rows))
    worth = document["worth"]
    if worth is not None and worth["new_poses_rms_m"] is not None:
        blocks.append(Text(f"For the same number of measurements, {worth['verdict']}."))
    return ReportSection("Order of the visits", blocks)


def _exclusions(document: Document) -> ReportSection:
    candidates = document["candidates"]
    start = f"Chosen from {candidates['feasible']} feasible poses of {candidates['source']}."
    blocks: list[Block] = [Text(start)]
    if candidates["excluded"]:
        rows: list[Sequence[Cell]] = [
            [entry["reason"], str(entry["count"]), str(entry["alone"])] for entry in candidates["excluded"]
        ]
        blocks.append(Grid(("excluded by", "poses", "by this alone"), rows))
    blocks.append(Text(_collisions(document["collisions"])))
    return ReportSection("Feasible poses", blocks)


def _collisions(collisions: Mapping[str, Any] | None) -> str:
    if collisions is None:
        return "Collisions of the links were not checked: check every pose before you send it."
    text = f"{len(collisions['pairs'])} pairs of links were checked for collisions."
    if collisions["overlapping"]:
        pairs = ", ".join(" and ".join(pair) for pair in collisions["overlapping"])
        text += f" Not checked, as they touch at nearly all poses: {pairs}."
    return f"{text} The tool, the payload and cables have no shape here."


def _needed(document: Document) -> ReportSection:
    ratios = [f"{entry['true_over_limit']:g}" for entry in document["needed_poses"][0]["by_ratio"]]
    rows: list[Sequence[Cell]] = [
        [
            f"{entry['name']} ({entry['statistic']})",
            length(entry["limit_m"]),
            *("–" if each["n_poses"] is None else str(each["n_poses"]) for each in entry["by_ratio"]),
        ]
        for entry in document["needed_poses"]
    ]
    text = "Number of poses that decides with probability 0.9, by the true value over the limit."
    return ReportSection("Poses needed", [Text(text), Grid(("limit", "value", *ratios), rows)])


def _coefficients(document: Document) -> ReportSection:
    rows: list[Sequence[Cell]] = [
        [entry["name"], Number(three_digits(entry["std"]), entry["std"]), entry["unit"]]
        for entry in document["coefficients"]
        if entry["std"] is not None
    ]
    blocks: list[Block] = [Grid(("coefficient", "standard error", "unit"), rows)]
    missing = [entry["name"] for entry in document["coefficients"] if entry["std"] is None]
    if missing:
        blocks.append(Text(f"Not identifiable: {', '.join(missing)}."))
    if document["correlations"]:
        pairs = [f"{pair['first']} and {pair['second']} ({pair['value']:+.2f})" for pair in document["correlations"]]
        blocks += [Text("Estimates that stay strongly correlated:"), Listing(pairs[:_LISTED])]
    return ReportSection("Predicted standard errors", blocks)


def _inseparable(document: Document) -> ReportSection:
    texts = pair_texts([InseparablePair(**pair) for pair in document["inseparable"]])
    blocks: list[Block] = [
        Text("At its usual size, the second effect explains the first within the noise of these poses."),
        Listing(texts[:_LISTED]),
    ]
    if len(texts) > _LISTED:
        blocks.append(Text(f"The first {_LISTED} of {len(texts)} pairs; the JSON result has all of them."))
    return ReportSection("Effects that are not distinguishable", blocks)


def _visits(document: Document) -> ReportSection:
    visits, joints = document["visits"], document["robot"]["joints"]
    is_turning = [joint["type"] == "revolute" for joint in joints]
    has_payload = visits["payload_kg"] is not None
    header = [f"{joint['name']}, {'°' if turning else 'mm'}" for joint, turning in zip(joints, is_turning, strict=True)]
    rows: list[Sequence[Cell]] = []
    for i, q in enumerate(visits["q"][:_VISITS]):
        values = [
            f"{math.degrees(value):.2f}" if turning else f"{1e3 * value:.1f}"
            for value, turning in zip(q, is_turning, strict=True)
        ]
        payload = [f"{visits['payload_kg'][i]:g}"] if has_payload else []
        rows.append([str(i + 1), visits["pose"][i], visits["role"][i], *payload, *values])
    blocks: list[Block] = [
        Grid(("visit", "pose", "role", *(("payload, kg",) if has_payload else ()), *header), rows),
    ]
    if len(visits["q"]) > _VISITS:
        blocks.append(Text(f"The first {_VISITS} of {len(visits['q'])} visits; the CSV has all of them."))
    return ReportSection("Visits", blocks)
